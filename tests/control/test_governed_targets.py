"""The control law with a governor before it: `equations.governor` through the ports."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from small_robots import add_plant, chain_urdf, make_model

from crar_drake.control.law import ControlLaw
from crar_drake.control.lookahead_parameters import LookaheadParameters
from crar_drake.control.parameters import CrarParameters, TargetGovernor
from crar_drake.control.records import InputError, Memory
from crar_drake.equations.references import Targets
from crar_drake.errors import ScenarioError
from crar_drake.robot.description import RobotDescription, load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task, position_tasks
from crar_drake.simulation.diagram import AddCrarController
from crar_drake.simulation.scenario import parse_scenario

PERIOD = 5e-3  # [s]
SPEED, ACCELERATION = 1.0, 10.0
GOVERNOR = TargetGovernor(
    speed=SPEED, acceleration=ACCELERATION, angular_speed=3.0, angular_acceleration=30.0
)
START = np.array([0.3, 0.5, -0.4, 0.6, 0.2])
NOTHING = np.zeros(0)


@pytest.fixture(scope="module")
def model() -> ControlModel:
    return make_model(chain_urdf("zyzyz"), [Task(frame="tip", kind="pose")])


def parameters(governor=GOVERNOR, **changes) -> CrarParameters:
    return CrarParameters(
        **(
            {
                "constraints": "none",
                "blend_time": 0.0,
                "period": PERIOD,
                "governor": governor,
            }
            | changes
        )
    )


def solve(law: ControlLaw, memory: Memory, tick: int, q, v, tasks):
    return law.solve(
        law.model.MakeWorkspace(),
        memory,
        tick,
        tick * PERIOD,
        q,
        v,
        Targets(tasks, NOTHING, NOTHING),
    )


def shifted(model: ControlModel, by: float, q=START) -> np.ndarray:
    tasks = model.tasks_at(q)
    tasks[model.layout.position_entries[0]] += [0.0, by, 0.0]
    return tasks


@pytest.mark.parametrize(
    "constraints, share",
    [
        ({"constraints": "paper"}, 0.1),
        (
            {
                "constraints": "lookahead",
                "respect_effort_limits": False,
                "velocity_scale": np.inf,
                # Else a plan, or the wish's own bound, makes half a move of it.
                "lookahead": LookaheadParameters(
                    preview=0.0, nominal_speed_limit=150.0
                ),
            },
            0.3,
        ),
    ],
    ids=["paper", "lookahead"],
)
def test_a_teleport_of_both_wrists_of_a_metre_is_a_move(constraints, share):
    """The arms' peak torque is a fraction, and they come to the same place."""
    tasks = position_tasks(["left_wrist", "right_wrist"])
    model = ControlModel.FromDescription(load_robot_description("upper_body"), tasks)
    arms = np.setdiff1d(np.arange(model.plant.num_velocities()), model.prescribed)
    q_0 = model.rest_positions()
    begin = model.tasks_at(q_0)
    prescribed = np.r_[q_0[model.prescribed], np.zeros(2 * model.n_p)]
    jump = np.array([0.3, 0.1, 0.95, 0.3, -0.1, 0.95])
    end = begin.copy()
    end[:6] += jump
    peaks, lasts = [], []
    for governor in (TargetGovernor(), TargetGovernor(speed=2.0, acceleration=20.0)):
        law = ControlLaw(model, parameters(governor, **constraints))
        q, v = q_0, np.zeros_like(q_0)
        law.step(q, v, begin, prescribed)
        torques = []
        for _ in range(240):
            solution = law.step(q, v, end, prescribed)
            by_velocity = model.plant.MakeActuationMatrix() @ solution.actuation
            torques.append(np.abs(by_velocity[arms]).max())
            if len(torques) == 1:
                # It is the target as given whose error is told.
                np.testing.assert_allclose(solution.task_error, jump, atol=1e-9)
            q, v = np.split(solution.position_command, [len(q)])
        peaks.append(max(torques))
        lasts.append(q)
    assert peaks[0] > 1000.0
    assert peaks[1] < share * peaks[0]
    at_last = [model.tasks_at(q)[:6] for q in lasts]
    np.testing.assert_allclose(*at_last, atol=0.01)


def test_motion_within_the_bounds_is_as_without(model):
    """Bit for bit, once the governed target is on it."""
    rest = model.tasks_at(START)
    entry = model.layout.position_entries[0, 0]
    row = model.layout.linear_rows[0, 0]

    def target(t: float) -> np.ndarray:
        tasks = rest.copy()
        x = 0.05 * np.array(
            [1.0 - np.cos(9 * t), 9 * np.sin(9 * t), 81 * np.cos(9 * t)]
        )
        tasks[entry] += x[0]
        tasks[model.layout.size_x + row] = x[1]
        tasks[model.layout.size_x + model.m + row] = x[2]
        return tasks

    q, v = START, np.zeros(5)
    governed = ControlLaw(model, parameters())
    free = ControlLaw(model, parameters(TargetGovernor()))
    for k in range(60):
        solution = governed.step(q, v, target(k * PERIOD))
        expected = free.step(q, v, target(k * PERIOD))
        for name in ("acceleration", "actuation", "task_error", "position_command"):
            np.testing.assert_array_equal(
                getattr(solution, name), getattr(expected, name)
            )
        q, v = np.split(solution.position_command, [5])
    assert np.abs(v).max() > 0.1


def test_without_bounds_there_is_no_governor(model):
    law = ControlLaw(model, parameters(TargetGovernor()))
    step = solve(law, Memory(), 0, START, np.zeros(5), shifted(model, 1.0))
    assert step.governed is None


def test_it_starts_at_the_measured_pose_and_velocity(model):
    """In the first step, after a gap in time, and after lost targets."""
    law = ControlLaw(model, parameters(constraints="lookahead"))
    layout, far = model.layout, shifted(model, 0.5)
    v = np.array([0.1, -0.2, 0.1, 0.2, -0.1])
    state = model.evaluate(model.MakeWorkspace(), START, v)
    first = solve(law, Memory(), 0, START, v, far)
    governed = layout.unpack(first.governed)
    np.testing.assert_allclose(governed.p, state.p, atol=1e-12)
    np.testing.assert_allclose(governed.R, state.R, atol=1e-12)
    J = np.array(state.J)
    np.testing.assert_allclose(governed.v, J @ v, atol=1e-12)
    assert 0.1 < np.abs(governed.v).max() < SPEED

    moved = START + 0.05
    then = layout.unpack(solve(law, first, 1, moved, v, far).governed)
    # On, from where it was: the robot's own place has no say.
    np.testing.assert_allclose(
        then.p,
        governed.p
        + PERIOD * governed.v[layout.linear_rows]
        + PERIOD**2 / 2 * governed.a[layout.linear_rows],
        atol=1e-12,
    )
    there = model.evaluate(model.MakeWorkspace(), moved, v).p
    assert np.abs(there - then.p).max() > 0.01
    gap = solve(law, first, 2, moved, v, far).governed
    np.testing.assert_allclose(layout.unpack(gap).p, there, atol=1e-12)

    lost = far.copy()
    lost[0] = np.nan
    braking = solve(law, first, 1, moved, v, lost)
    assert braking.solution.status[0] == 2.0 and braking.governed is None
    back = solve(law, braking, 2, moved, v, far).governed
    np.testing.assert_allclose(layout.unpack(back).p, there, atol=1e-12)


def test_a_step_changes_nothing_that_it_was_given(model):
    law = ControlLaw(model, parameters())
    tasks = shifted(model, 0.5)
    first = solve(law, Memory(), 0, START, np.zeros(5), tasks)
    kept = first.governed.copy()
    one = solve(law, first, 1, START, np.zeros(5), tasks)
    tasks[:] = shifted(model, -0.5)
    solve(law, first, 1, START, np.zeros(5), tasks)
    np.testing.assert_array_equal(first.governed, kept)
    tasks = shifted(model, 0.5)
    again = solve(law, first, 1, START, np.zeros(5), tasks)
    np.testing.assert_array_equal(again.solution.actuation, one.solution.actuation)


@pytest.mark.parametrize("constraints", ["none", "lookahead"])
def test_a_quaternion_of_zero_length_is_refused_as_ever(model, constraints):
    law = ControlLaw(model, parameters(constraints=constraints))
    tasks = shifted(model, 0.5)
    tasks[model.layout.quaternion_entries[0]] = 0.0
    if constraints == "none":
        with pytest.raises(InputError, match="quaternion of zero length"):
            law.step(START, np.zeros(5), tasks)
    else:
        assert law.step(START, np.zeros(5), tasks).status[0] == 2.0


@pytest.mark.parametrize("level", ["velocity", "acceleration"])
def test_the_governed_target_is_blended_in_as_any(model, level):
    """At the start it asks for what a target at the measured pose would ask for."""
    governed = parameters(level=level, blend_time=0.3)
    law, free = (
        ControlLaw(model, p) for p in (governed, replace(governed, governor=GOVERNOR))
    )
    far, here = shifted(model, 0.5), model.tasks_at(START)
    solution = law.step(START, np.zeros(5), far)
    assert solution.status[0] == 1.0
    expected = free.step(START, np.zeros(5), here)
    np.testing.assert_allclose(solution.acceleration, expected.acceleration, atol=1e-9)


# --- in a diagram -----------------------------------------------------------------


class Jumping(LeafSystem):
    """A tip's target that jumps to and fro."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareVectorOutputPort("y", 9, self._Calc, {self.time_ticket()})

    def _Calc(self, context, output) -> None:
        y = 0.5 if context.get_time() % 0.2 < 0.1 - 1e-9 else -0.3
        output.SetFromVector([0.7, y, 0.1, *np.zeros(6)])


class Loop:
    def __init__(self) -> None:
        builder = DiagramBuilder()
        plant, scene_graph = add_plant(builder, chain_urdf("zyz"))
        self.plant = plant
        self.controller = AddCrarController(
            builder,
            plant,
            scene_graph,
            RobotDescription(),
            [Task(frame="tip")],
            parameters(),
        )
        jumping = builder.AddSystem(Jumping())
        builder.Connect(
            jumping.get_output_port(), self.controller.get_input_port_desired_tasks()
        )
        self.diagram = builder.Build()

    def start(self, q) -> Simulator:
        simulator = Simulator(self.diagram)
        self.place(simulator.get_mutable_context(), q)
        simulator.Initialize()
        return simulator

    def place(self, context, q) -> None:
        own = self.plant.GetMyMutableContextFromRoot(context)
        self.plant.SetPositionsAndVelocities(own, np.r_[q, np.zeros(3)])

    def state(self, simulator: Simulator) -> np.ndarray:
        own = self.plant.GetMyContextFromRoot(simulator.get_context())
        return self.plant.GetPositionsAndVelocities(own).copy()


@pytest.fixture(scope="module")
def loop() -> Loop:
    return Loop()


def test_several_simulators_and_a_time_set_back(loop):
    """Each has a governor of its own, and begins anew where its time does."""
    starts = [[0.2, 0.4, -0.5], [-0.3, 0.6, 0.5]]
    alone = []
    for q in starts:
        simulator = loop.start(q)
        simulator.AdvanceTo(0.25)
        alone.append(loop.state(simulator))
    assert np.abs(alone[0] - alone[1]).max() > 0.01
    together = [loop.start(q) for q in starts]
    for k in range(1, 51):
        for simulator in together:
            simulator.AdvanceTo(k * 0.005)
    for simulator, expected in zip(together, alone, strict=True):
        np.testing.assert_allclose(loop.state(simulator), expected, rtol=1e-9)
    context = together[0].get_mutable_context()
    context.SetTime(0.0)
    loop.place(context, starts[0])
    together[0].Initialize()
    together[0].AdvanceTo(0.25)
    np.testing.assert_allclose(loop.state(together[0]), alone[0], rtol=1e-9)


def test_the_tip_keeps_to_the_bounds_while_the_target_jumps(loop):
    """But for what the loop makes of corners in the acceleration."""
    simulator = loop.start([0.2, 0.4, -0.5])
    model = loop.controller.model
    speeds = []
    for k in range(1, 120):
        simulator.AdvanceTo(k * PERIOD)
        q, v = np.split(loop.state(simulator), 2)
        state = model.evaluate(model.MakeWorkspace(), q, v)
        speeds.append(np.linalg.norm(np.array(state.J) @ v))
    assert 0.5 * SPEED < max(speeds) < 1.2 * SPEED


# --- parameters -------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["speed", "acceleration", "angular_speed", "angular_acceleration"]
)
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_bounds_out_of_range_are_refused(name, value):
    governor = TargetGovernor(**{name: value})
    with pytest.raises(
        ScenarioError, match=rf"controller.governor.{name}: .* positive and finite"
    ):
        CrarParameters(governor=governor).validate()


def test_a_scenario_can_have_a_governor():
    scenario = parse_scenario(
        "motion: dance\nexperiment: wrists\n"
        "controller:\n  governor: {speed: 1.5, angular_acceleration: 20}\n"
    )
    assert scenario.controller.governor.bounds() == (1.5, np.inf, np.inf, 20.0)
    assert parse_scenario(scenario.to_yaml()).controller == scenario.controller
    with pytest.raises(ScenarioError, match="governor.*fast"):
        parse_scenario(
            "motion: dance\nexperiment: wrists\ncontroller: {governor: {fast: 1}}\n"
        )
