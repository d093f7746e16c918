"""CrarController in diagrams: no delay, no aliasing, one solve a period.

That the acceleration is held between solves: `test_held_acceleration.py`.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import (
    ConstantVectorSource,
    LogVectorOutput,
    TrajectorySource,
    VectorLogSink,
)
from pydrake.trajectories import PiecewisePolynomial
from small_robots import add_plant, chain_urdf, make_model

from crar_drake.control.controller import CrarController
from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import CrarParameters
from crar_drake.control.records import InputError
from crar_drake.errors import ScenarioError
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.task import Task
from crar_drake.simulation.diagram import AddCrarController
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
    controller = AddCrarController(
        builder,
        plant,
        scene_graph,
        DESCRIPTION,
        [Task(frame="tip")],
        CrarParameters(
            constraints="paper", level=level, period=ratio * STEP, blend_time=0.1
        ),
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


def test_remembered_proximities_change_while_moving(case):
    """What Eqs. (18), (21) compare with is of the step before, not of this one."""
    loop, _, ratio = case
    simulator = loop.start()
    seen = []
    index = loop.controller._held_index
    for k in range(30):
        simulator.AdvanceTo(k * ratio * STEP + 0.5 * STEP)
        context = loop.of(loop.controller, simulator.get_context())
        memory = context.get_abstract_state(int(index)).get_value()
        assert memory.tick == k
        # The proximities, and then q_dot_c of the step.
        seen.append(memory.solution.kept[: -loop.controller.model.n])
    changes = np.abs(np.diff(seen[2:], axis=0)).max(axis=1)
    assert (changes > 0.0).all()


def test_one_solve_per_period(case, monkeypatch):
    """However many outputs are read, and however often the plant asks."""
    loop, kind, ratio = case
    calls = []
    solve = ControlLaw.solve

    def counted(self, *args, **kwargs):
        calls.append(args[2])
        return solve(self, *args, **kwargs)

    monkeypatch.setattr(ControlLaw, "solve", counted)
    simulator = loop.start()
    simulator.AdvanceTo(20 * ratio * STEP)
    # The last sample of a discrete plant's log is of a tick that is yet to come.
    assert calls == list(range(20 if kind == "continuous" else 21))


@pytest.mark.parametrize("step, ratio", [(1 / 700, 3), (1 / 600, 5), (7e-4, 9)])
def test_periods_whose_multiples_round_differently(step, ratio, monkeypatch):
    """k (3 h) and (3 k) h are not always the same number: still one solve a tick, of
    the state that the plant's step starts from."""
    assert any(k * (ratio * step) != (ratio * k) * step for k in range(100))
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, chain_urdf("zz"), time_step=step)
    controller = AddCrarController(
        builder,
        plant,
        scene_graph,
        RobotDescription(),
        [Task(frame="tip")],
        CrarParameters(constraints="paper", period=ratio * step),
    )
    target = builder.AddSystem(ConstantVectorSource(np.r_[0.3, 0.3, np.zeros(7)]))
    builder.Connect(target.get_output_port(), controller.get_input_port_desired_tasks())
    diagram = builder.Build()
    calls = {}
    solve = ControlLaw.solve

    def recorded(self, workspace, memory, tick, time, q, v, *rest):
        calls.setdefault(tick, []).append(np.r_[q, v])
        return solve(self, workspace, memory, tick, time, q, v, *rest)

    monkeypatch.setattr(ControlLaw, "solve", recorded)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    states = {}
    for k in range(100):
        # Half a step before the tick the plant has the tick's state already.
        simulator.AdvanceTo(max(k * ratio - 0.5, 0.0) * step)
        states[k] = context.get_discrete_state_vector().CopyToVector()
    for k in range(99):
        assert len(calls[k]) == 1
        np.testing.assert_array_equal(calls[k][0], states[k])


def test_cloned_contexts_do_not_alias(loop):
    """Evaluated in turns at different states, as if each were alone."""
    rng = np.random.default_rng(0)
    states = rng.uniform(-0.5, 0.5, (3, 8))
    first = loop.diagram.CreateDefaultContext()
    loop.out("actuation", first)  # so that there is a cache to clone
    contexts = [first, first.Clone(), first.Clone()]

    def look(context, x):
        loop.plant.SetPositionsAndVelocities(loop.of(loop.plant, context), x)
        return {name: loop.out(name, context) for name in OUTPUTS}

    for turn in range(3):
        for i, context in enumerate(contexts):
            x = states[(i + turn) % 3]
            seen = look(context, x)
            alone = look(loop.diagram.CreateDefaultContext(), x)
            for name in OUTPUTS:
                np.testing.assert_array_equal(seen[name], alone[name])
    # Nor does a clone of a running context: it goes on from where it was taken.
    simulator = loop.start()
    simulator.AdvanceTo(0.05)
    taken = simulator.get_context().Clone()
    simulator.AdvanceTo(0.1)
    other = Simulator(loop.diagram, taken)
    other.AdvanceTo(0.1)
    np.testing.assert_array_equal(
        loop.state(simulator.get_context()), loop.state(other.get_context())
    )


def test_two_simulators_of_one_diagram(case):
    """Advanced in turns, from different poses, as if each were alone."""
    loop, _, ratio = case
    poses = [START, START + 0.2]
    alone = []
    for q in poses:
        simulator = loop.start(q)
        simulator.AdvanceTo(0.1)
        alone.append(np.r_[loop.state(simulator.get_context())])
    together = [loop.start(q) for q in poses]
    for k in range(1, 21):
        for simulator in together:
            simulator.AdvanceTo(k * 0.005)
    for simulator, expected in zip(together, alone, strict=True):
        got = np.r_[loop.state(simulator.get_context())]
        np.testing.assert_allclose(got, expected, rtol=1e-9)
    assert np.abs(alone[0] - alone[1]).max() > 0.01


def test_time_set_back_starts_afresh(case):
    """The second run is the first one again, blending and differences included."""
    loop, _, _ = case
    simulator = loop.start()
    context = simulator.get_mutable_context()

    def run():
        runs = []
        for t in (0.0, 0.004, 0.03, 0.1):
            simulator.AdvanceTo(t)
            runs.append(np.concatenate([*loop.state(context)]))
        return np.array(runs)

    first = run()
    context.SetTime(0.0)
    loop.plant.SetPositions(loop.of(loop.plant, context), START)
    loop.plant.SetVelocities(loop.of(loop.plant, context), np.zeros(4))
    # Asked before the first event already, the outputs are those of a first step.
    fresh = loop.diagram.CreateDefaultContext()
    loop.plant.SetPositions(loop.of(loop.plant, fresh), START)
    np.testing.assert_array_equal(
        loop.out("actuation", context), loop.out("actuation", fresh)
    )
    simulator.Initialize()
    np.testing.assert_allclose(run(), first, rtol=1e-9, atol=1e-12)


def test_outputs_follow_the_state_before_the_first_tick(loop):
    """A controller that never ran answers from the state at hand."""
    context = loop.diagram.CreateDefaultContext()
    a = loop.out("actuation", context)
    loop.plant.SetPositions(loop.of(loop.plant, context), START)
    b = loop.out("actuation", context)
    assert np.abs(a - b).max() > 0.1


def test_late_start_is_blended_in(loop):
    """A run that begins at another time blends in from there."""
    simulator = Simulator(loop.diagram)
    simulator.get_mutable_context().SetTime(0.25)
    context = simulator.get_mutable_context()
    loop.plant.SetPositions(loop.of(loop.plant, context), START)
    np.testing.assert_allclose(
        loop.out("desired_acceleration", context), 0.0, atol=1e-9
    )
    assert loop.out("status", context) == 1.0
    simulator.Initialize()
    simulator.AdvanceTo(0.35 + 1e-9)
    assert loop.out("status", simulator.get_context()) == 0.0


@pytest.fixture(scope="module")
def lone() -> CrarController:
    """A controller without a diagram, of a robot with a prescribed joint."""
    model = make_model(
        URDF,
        [Task(frame="tip", kind="pose")],
        prescribed_joints={"rail": "hold"},
        pairs=[["l2", "post"]],
    )
    return CrarController(
        model, CrarParameters(constraints="paper", nominal_posture_gain=1.0)
    )


def fixed_context(controller: CrarController, **changes) -> Context:
    context = controller.CreateDefaultContext()
    pose = [1.0, 0, 0, 0, 0.6, 0.3, 0.0]
    values = {
        "estimated_state": np.r_[START, np.zeros(4)],
        "desired_tasks": np.r_[pose, np.zeros(12)],
        "desired_prescribed": np.array([-0.1, 0.0, 0.0]),
        "nominal_posture": np.zeros(3),
    } | changes
    for name, value in values.items():
        if value is not None:
            controller.GetInputPort(name).FixValue(context, value)
    return context


def test_ports(lone):
    sizes = {
        "estimated_state": (lone.get_input_port_estimated_state(), 8),
        "desired_tasks": (lone.get_input_port_desired_tasks(), 19),
        "desired_prescribed": (lone.get_input_port_desired_prescribed(), 3),
        "nominal_posture": (lone.get_input_port_nominal_posture(), 3),
        "actuation": (lone.get_output_port_actuation(), 4),
        "desired_acceleration": (lone.get_output_port_desired_acceleration(), 4),
        "position_command": (lone.get_output_port_position_command(), 8),
        "diagnostics": (lone.get_output_port_diagnostics(), 38),
    }
    for name, (port, size) in sizes.items():
        assert (port.get_name(), port.size()) == (name, size)
    assert lone.num_input_ports() + lone.num_output_ports() == len(sizes)


def test_diagnostics_have_names(lone):
    context = fixed_context(lone)
    everything = lone.get_output_port_diagnostics().Eval(context)
    parts = lone.diagnostics(context)
    sizes = {name: len(part) for name, part in parts.items()}
    assert sizes == {
        "actuation": 4,
        "desired_acceleration": 4,
        "task_error": 6,
        "signed_distances": 1,
        "constraint_weights": 3,
        "position_command": 8,
        "status": 1,
        "torque_limit": 2,
        "resting_margins": 2,
        "admission": 4,
        "balance": 3,
    }
    np.testing.assert_array_equal(np.concatenate(list(parts.values())), everything)
    for name in ("actuation", "desired_acceleration", "position_command"):
        np.testing.assert_array_equal(
            parts[name], lone.GetOutputPort(name).Eval(context)
        )


def test_who_asks_for_a_former_port_reads_where_it_is(lone):
    with pytest.raises(AttributeError, match=r'diagnostics\(context\)\["status"\]'):
        lone.get_output_port_status()
    with pytest.raises(AttributeError, match="no attribute 'get_output_port_nothing'"):
        lone.get_output_port_nothing()


def test_no_ports_without_need():
    model = make_model(chain_urdf("zz"))
    controller = CrarController(model, CrarParameters(nominal_posture_gain=0.0))
    assert controller.get_input_port_desired_prescribed() is None
    assert controller.get_input_port_nominal_posture() is None
    assert controller.num_input_ports() == 2
    context = controller.CreateDefaultContext()
    controller.get_input_port_estimated_state().FixValue(context, [0.3, 0.4, 0, 0])
    controller.get_input_port_desired_tasks().FixValue(context, np.zeros(9))
    assert controller.diagnostics(context)["signed_distances"].shape == (0,)
    assert np.isfinite(controller.get_output_port_actuation().Eval(context)).all()


@pytest.mark.parametrize(
    "name",
    ["estimated_state", "desired_tasks", "desired_prescribed", "nominal_posture"],
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
    if name == "nominal_posture":  # that of the robot
        torque = lone.get_output_port_actuation().Eval(absent)
        rest = lone.law.default_posture(START)
        there = fixed_context(lone, nominal_posture=rest)
        np.testing.assert_array_equal(
            torque, lone.get_output_port_actuation().Eval(there)
        )
        return
    with pytest.raises(InputError, match=f"{name}.*not connected"):
        lone.get_output_port_actuation().Eval(absent)


def test_zero_quaternion_is_named(lone):
    context = fixed_context(lone, desired_tasks=np.zeros(19))
    with pytest.raises(InputError, match="desired_tasks.*quaternion"):
        lone.get_output_port_actuation().Eval(context)


def test_nan_in_the_middle_of_a_simulation():
    """From the exception of Simulator.AdvanceTo."""
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, chain_urdf("zz"))
    controller = AddCrarController(
        builder,
        plant,
        scene_graph,
        RobotDescription(),
        [Task(frame="tip")],
        CrarParameters(constraints="paper"),
    )
    builder.ExportInput(controller.get_input_port_desired_tasks(), "targets")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    port = diagram.GetInputPort("targets")
    port.FixValue(context, np.r_[0.5, 0.2, np.zeros(7)])
    simulator.AdvanceTo(0.01)
    port.FixValue(context, np.r_[0.5, np.nan, np.zeros(7)])
    with pytest.raises(InputError, match=r"desired_tasks.*t = 0\.01 s.*entries 1"):
        simulator.AdvanceTo(0.02)
    port.FixValue(context, np.r_[0.5, 0.2, np.zeros(7)])
    # The plant itself refuses a NaN; its state vector does not.
    x = context.get_mutable_discrete_state_vector()
    x.SetAtIndex(2, np.nan)
    with pytest.raises(InputError, match=r"estimated_state.*entries 2"):
        simulator.AdvanceTo(0.03)


def test_bad_parameters_are_refused():
    with pytest.raises(ScenarioError, match="controller.damping"):
        CrarController(
            make_model(chain_urdf("zz")),
            CrarParameters(constraints="paper", damping=0.0),
        )
