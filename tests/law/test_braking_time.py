"""The braking time: longer where motors are weak and the longer path is clear, too.

With 12 ms the motors of a torso cannot brake it at speed. They may take longer wherever
nothing is in the way.
"""

from dataclasses import replace

import numpy as np
import pytest
from exact_loop import follow
from pydrake.multibody.tree import MultibodyForces

from crar_drake import (
    ControlLaw,
    ControlModel,
    Obstacles,
    SafetyFilter,
    load_robot_description,
    position_tasks,
)
from crar_drake.judging.referee import Referee
from crar_drake.law.parameters import LookaheadParameters

PERIOD, T = 5e-3, 0.012
PARAMETERS = LookaheadParameters(period=PERIOD, blend_time=0.0)
DESCRIPTION = load_robot_description("upper_body")
NO_ROTATIONS = np.empty((0, 3, 3))


@pytest.fixture(scope="module")
def model() -> ControlModel:
    tasks = position_tasks(["left_wrist", "right_wrist"])
    return ControlModel.FromDescription(DESCRIPTION, tasks, time_step=PERIOD)


def turned(model: ControlModel, seconds: float) -> np.ndarray:
    """Both wrists' targets, turned about the vertical, in the end at 9 rad/s."""
    p = model.layout.unpack(model.tasks_at(model.rest_positions())).p + [0.15, 0, 0.15]
    time = np.arange(0.0, seconds, PERIOD)
    angle = 9.0 * np.where(time < 0.5, time**2, time - 0.25)
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0 * c], [s, c, 0 * c], [0 * c, 0 * c, 1 + 0 * c]])
    places = np.einsum("ijt,kj->tki", R, p)
    v = np.gradient(places, PERIOD, axis=0)
    a = np.gradient(v, PERIOD, axis=0)
    flat = (places, v.reshape(len(time), -1), a.reshape(len(time), -1))
    return np.array(
        [model.layout.pack(NO_ROTATIONS, *each) for each in zip(*flat, strict=True)]
    )


def jumping(model: ControlModel, seed: int) -> np.ndarray:
    """Targets that jump through the body and about, every 60 ms."""
    jumps, rng = 15, np.random.default_rng(seed)
    p = model.layout.unpack(model.tasks_at(model.rest_positions())).p.mean(axis=0)
    places = p + rng.uniform(-0.6, 0.6, (jumps, 2, 3))
    packed = [model.layout.pack(NO_ROTATIONS, each) for each in places]
    return np.repeat(packed, 12, axis=0)


def braking_use(model: ControlModel, x: np.ndarray, horizon: float) -> float:
    """Drake's braking torque over the limit, of the worst actuator [1]."""
    plant = model.plant
    context, nq = plant.CreateDefaultContext(), plant.num_positions()
    plant.SetPositionsAndVelocities(context, x)
    forces = MultibodyForces(plant)
    plant.CalcForceElementsContribution(context, forces)
    tau = plant.CalcInverseDynamics(context, -x[nq:] / horizon, forces)
    limits = np.array([a.effort_limit() for a in actuators(plant)])
    of_joints = np.array([a.joint().velocity_start() for a in actuators(plant)])
    controlled = np.isin(of_joints, model.controlled)
    return np.max(np.abs(tau[of_joints]) / limits, where=controlled, initial=0.0)


def actuators(plant):
    return [plant.get_joint_actuator(i) for i in plant.GetJointActuatorIndices()]


def is_clear(referee: Referee, model: ControlModel, x, horizon: float) -> bool:
    """Whether 40 places of the braking path keep 4 mm, by the referee, and its end the
    limits."""
    nq = model.plant.num_positions()
    q, v = x[:nq], x[nq:]
    path = q + np.linspace(0.0, horizon, 40)[:, np.newaxis] * v
    ends = path[-1][model.controlled_positions]
    inside = (ends > model.lower - 1e-9) & (ends < model.upper + 1e-9)
    return inside.all() and referee.violations(path).smallest_distance >= 4e-3 - 1e-9


def test_a_torso_is_not_slowed_where_nothing_is_in_the_way(model):
    """Its targets are followed several times as closely, at speeds that its motors
    cannot brake from within the short horizon."""
    targets = turned(model, 2.0)
    states, answers = follow(model, PARAMETERS, targets)
    _, short = follow(model, replace(PARAMETERS, braking_time=T), targets)
    error, before = (
        np.sqrt(np.mean([each.task_error**2 for each in of])) for of in (answers, short)
    )
    assert error < 0.5 * before
    assert max(braking_use(model, x, T) for x in states) > 1.5
    assert max(braking_use(model, x, PARAMETERS.longest_T) for x in states) < 1.0


@pytest.mark.parametrize(
    ("targets", "given"), [(turned, 0.9), (jumping, 3), (jumping, 11)]
)
def test_over_the_time_that_is_told_braking_is_clear_and_within_the_limits(
    model, targets, given
):
    """Of each state: Drake's torques, the referee's path."""
    states, answers = follow(model, PARAMETERS, targets(model, given))
    assert all(each.admission[3] == 1.0 for each in answers)
    referee, slower = Referee(model.plant, model.scene_graph, DESCRIPTION.pairs), 0
    for x, answer in zip(states, answers, strict=True):
        (time,) = answer.T
        slower += time > T
        assert braking_use(model, x, time) <= 1.0
        assert is_clear(referee, model, x, time)
    assert slower > 5
    # What was admitted is done: nothing of it is clipped, not even by rounding.
    assert max(each.torque_limit[1] for each in answers) == 0.0


# Starts of an arm at up to 8 rad/s: the braking path over 83 ms penetrates, but not
# that over 17 or 28 ms.
FAST_STARTS = (4, 7, 47)


def fast_start(arm: SafetyFilter, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng, n = np.random.default_rng(seed), len(arm.joint_names)
    q = arm.model.rest_positions() + rng.uniform(-0.6, 0.6, n)
    return q, rng.uniform(-8.0, 8.0, n)


def nearest(arm: SafetyFilter, v: np.ndarray, **told) -> tuple[float, list[float]]:
    """The smallest distance while it is to keep a velocity, and T of each step."""
    distances, times = [], []
    for k in range(60):
        command = arm(v=v, **(told if k else {}))
        distances.append(arm.model.signed_distances(command.q).min())
        times.append(command.report.T)
    return min(distances), times


@pytest.fixture(scope="module")
def arm() -> SafetyFilter:
    return SafetyFilter("obstacle_arm", PERIOD)


@pytest.mark.parametrize("seed", FAST_STARTS)
def test_it_does_not_grow_since_an_obstacle_appears(arm, seed):
    """50 m away; among obstacles it is 83 ms, once that path is clear."""
    q, v = fast_start(arm, seed)
    arm.reset(q, v)
    far = Obstacles([[50.0, 0.0, 0.0]], 0.1, 0.0, ("far",))
    distance, times = nearest(arm, v, obstacles=far)
    assert times[0] < 0.03 and times[1] < 0.05
    assert distance > 3.9e-3


@pytest.mark.parametrize("beyond", [-1e-6, 1e-6])
@pytest.mark.parametrize("seed", FAST_STARTS)
def test_a_joint_that_rests_beyond_its_limit_does_not_lengthen_it(arm, seed, beyond):
    q, v = fast_start(arm, seed)
    q[-1], v[-1] = arm.model.upper[-1] + beyond, 0.0
    arm.reset(q, v)
    wanted = v.copy()
    wanted[-1] = -0.1
    distance, times = nearest(arm, wanted)
    assert times[0] < 0.03
    assert distance > 3.9e-3


def test_lost_targets_ask_no_motor_for_more_while_prescribed_joints_brake(model):
    """The waist moves at 0.5 m/s, and brakes along."""
    law = ControlLaw(model, PARAMETERS)
    q, tasks = model.rest_positions(), model.tasks_at(model.rest_positions())
    v = np.zeros(model.n + model.n_p)
    v[model.prescribed] = 0.5
    motors = np.isfinite(law.effort_limits)
    for k in range(40):
        prescribed = np.concatenate((q[model.prescribed], v[model.prescribed], 0.0 * v))
        prescribed = prescribed[: 3 * model.n_p]
        lost = k >= 10
        found = law.step(q, v, np.nan * tasks if lost else tasks, prescribed)
        assert found.torque_limit[1] == 0.0, k
        use = np.abs(found.actuation[motors]) / law.effort_limits[motors]
        assert use.max() <= 1.0
        q, v = np.split(found.position_command, [len(q)])
    assert np.abs(v).max() < 0.1
