"""A control law among obstacles that move: what is left of its accelerations, and that
a simulated robot does so.

Distances and speeds are those of `tests.people`, by Drake's poses; the plant is
Drake's.
"""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from crar_drake import (
    AddCrarController,
    AddRobot,
    ControlLaw,
    ControlModel,
    InputError,
    LookaheadParameters,
    Obstacles,
    PaperParameters,
    ScenarioError,
    Task,
    load_robot_description,
)
from crar_drake.judging.obstacle_judge import ObstacleJudge
from crar_drake.law.step import AS_NOMINAL
from tests.people import Tally

PERIOD = 0.01
PARAMETERS = LookaheadParameters(period=PERIOD).among_obstacles()
TASKS = [Task("left_wrist", "position"), Task("right_wrist", "position")]


@pytest.fixture(scope="module")
def model() -> ControlModel:
    """The torso with its waist, which is prescribed."""
    description = load_robot_description("upper_body")
    return ControlModel.FromDescription(description, TASKS, time_step=PERIOD)


@pytest.fixture(scope="module")
def law(model) -> ControlLaw:
    made = ControlLaw(model, PARAMETERS)
    made.compile(obstacles=True)
    return made


@pytest.fixture(scope="module")
def witness(law) -> ObstacleJudge:
    return ObstacleJudge(law.model.plant, law.model.scene_graph, law.among.links)


def waving(model: ControlModel, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Targets of both wrists, and of the waist, that swing."""
    q = model.rest_positions()
    tasks = model.tasks_at(q)
    swing = 0.15 * np.sin(5.0 * t + np.arange(6))
    tasks[:6] += swing
    prescribed = model.prescribed_at(q)
    prescribed[: model.n_p] += 0.1 * np.sin(3.0 * t + np.arange(model.n_p))
    return tasks, prescribed


def drive(law, person, steps, judge=None, tally=None):
    """Accelerations and solutions of a law that runs on its own command."""
    law.reset()
    model = law.model
    q, v = model.rest_positions(), np.zeros(model.plant.num_velocities())
    found = []
    for k in range(steps):
        tasks, prescribed = waving(model, k * PERIOD)
        now = person(k * PERIOD)
        given = None
        if now is not None:
            given = Obstacles(now[None, :3], now[3], 1.5, ["Ann"])
        solution = law.step(q, v, tasks, prescribed, obstacles=given)
        found.append(solution)
        q_next, v_next = np.split(solution.position_command, [len(q)])
        if judge is not None:
            for share in (0.25, 0.5, 0.75, 1.0):
                at = person((k + share) * PERIOD)
                where = q + share * (q_next - q)
                seen = judge.look(where, v_next, at[None, :3], at[3:])
                tally.judge(*seen, 0.05)
        q, v = q_next, v_next
    return found


def runner(t: float) -> np.ndarray:
    """Somebody who runs into the left arm, stays, and leaves."""
    far = np.interp(t, [0.0, 0.4, 1.0, 1.6, 2.2], [1.6, 1.0, 0.35, 0.35, 1.25])
    return np.array([far, 0.25, 1.1, 0.15])


def test_what_is_far_changes_nothing_to_the_last_bit(law, model):
    without = drive(ControlLaw(model, PARAMETERS), lambda t: None, 60)
    far = drive(law, lambda t: np.array([3.0, 0.0, 1.0, 0.2]), 60)
    for one, other in zip(without, far, strict=True):
        np.testing.assert_array_equal(one.acceleration, other.acceleration)
        np.testing.assert_array_equal(one.actuation, other.actuation)
        np.testing.assert_array_equal(one.admission, other.admission)
        assert other.obstacle is None


def test_whoever_runs_at_it_touches_nothing_that_is_fast(law, witness):
    tally = Tally()
    found = drive(law, runner, 260, witness, tally)
    assert tally.violations == 0
    changed = [s for s in found if s.obstacle is not None]
    assert len(changed) > 10
    assert all(s.admission[0] != AS_NOMINAL for s in changed)
    assert {s.obstacle[0] for s in changed} == {"Ann"}
    assert all(s.admission[3] == 1.0 for s in found)
    # Once she has left, the law has its way again.
    assert found[-1].obstacle is None
    # And without anybody's notice, the same person is run into.
    blind = Tally()
    blind_law = ControlLaw(law.model, PaperParameters(period=PERIOD))
    drive(blind_law, runner, 260, witness, blind)
    assert blind.violations > 0


def test_torque_and_command_are_those_of_the_changed_accelerations(law, model):
    found = drive(law, runner, 120)
    q, v = model.rest_positions(), np.zeros(model.plant.num_velocities())
    workspace, changed = model.MakeWorkspace(), 0
    for solution in found:
        model.evaluate(workspace, q, v)
        tau = model.inverse_dynamics(workspace, solution.acceleration)
        np.testing.assert_allclose(solution.actuation, tau, atol=1e-9)
        v_next = v + PERIOD * solution.acceleration
        q, v = q + PERIOD * v_next, v_next
        np.testing.assert_allclose(solution.position_command, [*q, *v], atol=1e-12)
        changed += solution.obstacle is not None
    assert changed


def test_without_news_it_grows_and_the_robot_stops(law):
    """Somebody who was seen once, and may be anywhere since."""
    found = drive(law, lambda t: runner(0.4) if t == 0.0 else None, 150)
    assert found[-1].obstacle == ("Ann", found[-1].obstacle[1])
    speeds = [np.abs(s.position_command[-law.model.n :]).max() for s in found]
    assert max(speeds[20:50]) > 10 * max(speeds[-5:])


def test_a_simulated_robot_does_as_it_was_told(model):
    """In Drake's own plant, with the controller in a diagram: nothing is touched that
    is fast, each state is the one commanded, and each begins clear."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=PERIOD)
    robot = AddRobot(plant, "upper_body")
    plant.Finalize()
    controller = AddCrarController(
        *(builder, plant, scene_graph, TASKS, PARAMETERS),
        model_instance=robot,
        prescribed=model.prescribed_names,
        obstacle_speeds=[1.5],
    )
    diagram = builder.Build()
    simulator = Simulator(diagram)
    root = simulator.get_mutable_context()
    context = controller.GetMyMutableContextFromRoot(root)
    own = plant.GetMyMutableContextFromRoot(root)
    judge = ObstacleJudge(plant, scene_graph, controller.law.among.links)
    tally = Tally()
    ports = (
        controller.get_input_port_desired_tasks(),
        controller.get_input_port_desired_prescribed(),
    )
    off, told, hows = 0.0, None, set()
    for k in range(160):
        for port, value in zip(ports, waving(model, k * PERIOD), strict=True):
            port.FixValue(context, value)
        controller.get_input_port_obstacles().FixValue(context, runner(k * PERIOD))
        state = plant.GetPositionsAndVelocities(own)
        if told is not None:
            off = max(off, np.abs(state - told).max())
        parts = controller.diagnostics(context)
        told, admission = parts["position_command"], parts["admission"]
        assert admission[3] == 1.0
        hows.add(admission[0])
        q, v = np.split(state, 2)
        now = runner(k * PERIOD)
        tally.judge(*judge.look(q, v, now[None, :3], now[3:]), 0.05)
        simulator.AdvanceTo((k + 1) * PERIOD)
    assert off < 1e-9
    assert tally.violations == 0
    assert len(hows) > 1


def test_what_does_not_go_with_obstacles_is_refused(model):
    once = Obstacles([[1.0, 0.0, 1.0]], 0.1, 1.0)
    q, v = model.rest_positions(), np.zeros(model.plant.num_velocities())

    def step(gains):
        tasks, prescribed = waving(model, 0.0)
        ControlLaw(model, gains).step(q, v, tasks, prescribed, obstacles=once)

    with pytest.raises(ScenarioError, match="time step, 0.01 s"):
        step(LookaheadParameters(period=0.005, braking_time=0.05))
    with pytest.raises(ScenarioError, match="controller.braking_time: with moving"):
        step(LookaheadParameters(period=PERIOD))
    with pytest.raises(ScenarioError, match="controller.braking_time"):
        step(replace(PARAMETERS, braking_time=PERIOD))
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=PERIOD)
    AddRobot(plant, "upper_body")
    plant.Finalize()
    controller = AddCrarController(builder, plant, scene_graph, TASKS, PARAMETERS)
    with pytest.raises(InputError, match="obstacle_speeds"):
        controller.get_input_port_obstacles()


def test_the_papers_constraints_take_no_notice(model):
    gains = PaperParameters(period=PERIOD)
    without = drive(ControlLaw(model, gains), lambda t: None, 30)
    among = drive(ControlLaw(model, gains), runner, 30)
    for one, other in zip(without, among, strict=True):
        np.testing.assert_array_equal(one.acceleration, other.acceleration)
