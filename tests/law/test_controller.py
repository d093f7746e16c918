"""CrarController in diagrams: it does as the law by itself, and names bad inputs.

That the acceleration is held between solves: `test_held_acceleration.py`.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import (
    LogVectorOutput,
    TrajectorySource,
    VectorLogSink,
)
from pydrake.trajectories import PiecewisePolynomial
from small_robots import add_controller, add_plant, chain_urdf, make_model

from crar_drake.errors import InputError
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.controller import CrarController
from crar_drake.law.parameters import LookaheadParameters, PaperParameters
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.task import Task
from tests.controller_parts import part_port

STEP = 1e-3  # time step of the discrete plants [s]
START = np.array([-0.1, 0.2, 0.9, -0.6])  # rail, then three joints
OUTPUTS = (
    "actuation",
    "desired_acceleration",
    "task_error",
    "signed_distances",
    "constraint_weights",
    "position_command",
)
# Damped joints, transmissions in another order, a prescribed joint, a post.
URDF = chain_urdf(
    "zyz", rail="y", damping=2.0, actuated=["j2", "rail", "j0", "j1"], limits=(-2, 2)
)
DESCRIPTION = RobotDescription(
    prescribed_joints={"rail": "hold"}, pairs=[["l2", "post"], ["post", "l1"]]
)


@dataclass
class Loop:
    """A closed loop around a small robot, and how to look into it."""

    diagram: Diagram
    plant: MultibodyPlant
    controller: CrarController
    targets: PiecewisePolynomial
    prescribed: PiecewisePolynomial
    logs: dict[str, VectorLogSink]

    def start(self, q=START) -> Simulator:
        simulator = Simulator(self.diagram)
        self.plant.SetPositions(self.of(self.plant, simulator.get_context()), q)
        simulator.Initialize()
        return simulator

    def of(self, system, context: Context) -> Context:
        return system.GetMyMutableContextFromRoot(context)

    def state(self, context: Context) -> tuple[np.ndarray, np.ndarray]:
        plant_context = self.of(self.plant, context)
        return (
            self.plant.GetPositions(plant_context).copy(),
            self.plant.GetVelocities(plant_context).copy(),
        )

    def out(self, name: str, context: Context) -> np.ndarray:
        of_controller = self.of(self.controller, context)
        if name in self.controller.diagnostics_slices:
            return self.controller.diagnostics(of_controller)[name]
        return self.controller.GetOutputPort(name).Eval(of_controller).copy()

    def wanted(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """The targets at a time, from the trajectories."""
        return tuple(
            np.concatenate([way.EvalDerivative(t, k) for k in range(3)]).ravel()
            for way in (self.targets, self.prescribed)
        )


def trajectory(function, duration=1.0) -> PiecewisePolynomial:
    times = np.linspace(0.0, duration, 41)
    return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
        times, np.array([function(t) for t in times]).T
    )


def make_loop(time_step: float, sampled: bool, ratio: int, level: str) -> Loop:
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, URDF, time_step=time_step, sampled=sampled)
    controller = add_controller(
        builder,
        plant,
        scene_graph,
        DESCRIPTION,
        [Task(frame="tip")],
        PaperParameters(level=level, period=ratio * STEP, blend_time=0.1),
    )
    # The tip goes to the post and back, the rail to and fro.
    targets = trajectory(lambda t: [0.5, 0.35 + 0.25 * np.sin(12 * t), 0.1 * t])
    prescribed = trajectory(lambda t: [-0.1 + 0.05 * np.sin(9 * t)])
    for way, port in (
        (targets, controller.get_input_port_desired_tasks()),
        (prescribed, controller.get_input_port_desired_prescribed()),
    ):
        source = builder.AddSystem(TrajectorySource(way, 2))
        builder.Connect(source.get_output_port(), port)
    logs = {
        name: LogVectorOutput(
            part_port(builder, controller, name), builder, ratio * STEP
        )
        for name in OUTPUTS
    }
    logs["state"] = LogVectorOutput(
        plant.get_state_output_port(), builder, ratio * STEP
    )
    return Loop(builder.Build(), plant, controller, targets, prescribed, logs)


KINDS = {
    "sampled": (STEP, True),
    "unsampled": (STEP, False),
    "continuous": (0.0, False),
}
CASES = [(kind, ratio) for kind in KINDS for ratio in (1, 5)]


@pytest.fixture(
    scope="module", params=CASES, ids=[f"{kind}-{ratio}" for kind, ratio in CASES]
)
def case(request) -> tuple[Loop, str, int]:
    kind, ratio = request.param
    level = "velocity" if kind == "sampled" and ratio == 5 else "acceleration"
    return make_loop(*KINDS[kind], ratio, level), kind, ratio


@pytest.fixture(scope="module")
def loop() -> Loop:
    """The usual one: a discrete plant, equal periods."""
    return make_loop(STEP, True, 1, "acceleration")


def test_plant_accelerates_as_commanded(case):
    """Damping and all, until the next tick; and the command is that of the state at the
    tick, as ControlLaw.step has it in a loop of its own."""
    loop, kind, ratio = case
    law = ControlLaw(loop.controller.law.model, loop.controller.law.parameters)
    simulator = loop.start()
    context = simulator.get_context()
    for k in range(40):
        t = k * ratio * STEP
        if context.get_time() < t:
            # At t already it would handle the events that are due.
            simulator.AdvanceTo(t)
        commanded = law.step(*loop.state(context), *loop.wanted(t)).acceleration
        scale = np.abs(commanded).max()
        for j in range(k * ratio, (k + 1) * ratio):
            if context.get_time() < j * STEP:
                simulator.AdvanceTo(j * STEP)
            _, v = loop.state(context)
            if kind == "continuous":
                simulator.AdvancePendingEvents()
                port = loop.plant.get_generalized_acceleration_output_port()
                reached = port.Eval(loop.of(loop.plant, context))
            else:
                simulator.AdvanceTo((j + 1) * STEP)
                reached = (loop.state(context)[1] - v) / STEP
            np.testing.assert_allclose(reached, commanded, atol=1e-8 * max(scale, 1.0))
    assert scale > 1.0


def test_whole_run_is_that_of_step(case):
    """Every output at every tick; weights differ between approaching and leaving, so
    the changes of Eqs. (18) and (21) are seen."""
    loop, kind, ratio = case
    simulator = loop.start()
    simulator.AdvanceTo(0.6)
    data = {
        name: log.FindLog(simulator.get_context()).data()
        for name, log in loop.logs.items()
    }
    times = loop.logs["state"].FindLog(simulator.get_context()).sample_times()
    assert len(times) == round(0.6 / (ratio * STEP)) + 1
    law = ControlLaw(loop.controller.law.model, loop.controller.law.parameters)
    field = {name: name for name in OUTPUTS} | {"desired_acceleration": "acceleration"}
    # A continuous plant's controller changes its outputs just after the log's sample.
    late = 1 if kind == "continuous" else 0
    # There the log's torque is of the torque tick before, not of the control tick's.
    names = OUTPUTS[1:] if late and ratio > 1 else OUTPUTS
    rates, weights = [], []
    for k in range(len(times) - late):
        x = data["state"][:, k]
        solution = law.step(x[:4], x[4:], *loop.wanted(times[k]))
        for name in names:
            np.testing.assert_allclose(
                data[name][:, k + late],
                getattr(solution, field[name]),
                rtol=1e-7,
                atol=1e-7 * np.abs(data[name]).max(),
                err_msg=f"{name} at t = {times[k]}",
            )
        weights.append(solution.constraint_weights)
        rates.append(solution.signed_distances[0])
    weights, rates = np.array(weights)[1:], np.diff(rates)
    near = np.abs(rates) > 1e-5
    approaching, leaving = near & (rates < 0), near & (rates > 0)
    assert approaching.sum() > 5 and leaving.sum() > 5
    # The first joint swings the last link to the post and away from it.
    assert weights[approaching].max() > 1.5
    assert (weights[leaving] == 1.0).any()


def test_outputs_follow_the_state_before_the_first_tick(loop):
    """A controller that never ran answers from the state at hand."""
    context = loop.diagram.CreateDefaultContext()
    a = loop.out("actuation", context)
    loop.plant.SetPositions(loop.of(loop.plant, context), START)
    b = loop.out("actuation", context)
    assert np.abs(a - b).max() > 0.1


@pytest.fixture(scope="module")
def lone() -> CrarController:
    """A controller without a diagram, of a robot with a prescribed joint."""
    model = make_model(
        URDF,
        [Task(frame="tip", kind="pose")],
        prescribed_joints={"rail": "hold"},
        pairs=[["l2", "post"]],
    )
    return CrarController(model, PaperParameters())


def fixed_context(controller: CrarController, **changes) -> Context:
    context = controller.CreateDefaultContext()
    pose = [1.0, 0, 0, 0, 0.6, 0.3, 0.0]
    values = {
        "estimated_state": np.r_[START, np.zeros(4)],
        "desired_tasks": np.r_[pose, np.zeros(12)],
        "desired_prescribed": np.array([-0.1, 0.0, 0.0]),
    } | changes
    for name, value in values.items():
        if value is not None:
            controller.GetInputPort(name).FixValue(context, value)
    return context


def test_who_asks_for_a_former_port_reads_where_it_is(lone):
    with pytest.raises(AttributeError, match=r'diagnostics\(context\)\["status"\]'):
        lone.get_output_port_status()
    with pytest.raises(AttributeError, match="no attribute 'get_output_port_nothing'"):
        lone.get_output_port_nothing()


@pytest.mark.parametrize(
    "name", ["estimated_state", "desired_tasks", "desired_prescribed"]
)
def test_bad_inputs_are_named(lone, name):
    """A NaN with its port and the time; a port without a value."""
    good = fixed_context(lone)
    assert np.isfinite(lone.get_output_port_actuation().Eval(good)).all()
    value = lone.GetInputPort(name).Eval(good).copy()
    value[-1] = np.nan
    bad = fixed_context(lone, **{name: value})
    bad.SetTime(1.25)
    with pytest.raises(InputError, match=f"{name}.*t = 1.25 s"):
        lone.get_output_port_actuation().Eval(bad)
    absent = fixed_context(lone, **{name: None})
    with pytest.raises(InputError, match=f"{name}.*not connected"):
        lone.get_output_port_actuation().Eval(absent)


def test_without_a_nominal_posture_it_is_the_robots_own(lone):
    controller = CrarController(lone.law.model, LookaheadParameters())

    def torque(**given):
        context = fixed_context(controller, **given)
        return controller.get_output_port_actuation().Eval(context)

    rest = controller.law.default_posture(START)
    np.testing.assert_array_equal(torque(), torque(nominal_posture=rest))
