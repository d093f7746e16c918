"""A control law among obstacles that move: what is left of its accelerations.

That nothing is touched that is fast: `tests/acceptance/test_spheres.py`.
"""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
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


def waving(model: ControlModel, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Targets of both wrists, and of the waist, that swing."""
    q = model.rest_positions()
    tasks = model.tasks_at(q)
    swing = 0.15 * np.sin(5.0 * t + np.arange(6))
    tasks[:6] += swing
    prescribed = model.prescribed_at(q)
    prescribed[: model.n_p] += 0.1 * np.sin(3.0 * t + np.arange(model.n_p))
    return tasks, prescribed


def drive(law, person, steps):
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
        q, v = np.split(solution.position_command, [len(q)])
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
