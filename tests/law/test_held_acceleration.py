"""Between control ticks the acceleration is held, not the torque."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import (
    ConstantVectorSource,
    LogVectorOutput,
    VectorLogSink,
)
from scipy.optimize import linprog
from small_robots import add_controller, add_plant, chain_urdf, make_model

from crar_drake.errors import InputError
from crar_drake.law import parameters
from crar_drake.law.compilation import hold
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.limits import JointLimits, velocity_bounds
from crar_drake.law.measured import fastest_asked
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.law.step import SCALED
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.simulation.diagram import MakeCrarDiagram
from crar_drake.simulation.disturbances import Disturbances
from crar_drake.simulation.scenario import load_scenario
from tests.controller_parts import part_port

STEP = 1e-3  # time step of the discrete plants [s]
PERIOD = 5 * STEP
TARGET = np.r_[0.5, 0.5, 0.2, np.zeros(6)]
START = np.array([0.3, 0.01, 0.9, -0.02])  # nearly stretched: velocities are large
URDF = chain_urdf("zyzy", damping=0.5)
LOGGED = ("actuation", "desired_acceleration", "torque_limit", "diagnostics")


class Loop:
    """A closed loop around a small robot that is drawn to a target."""

    def __init__(
        self, time_step: float = STEP, effort: float | None = None, **changes
    ) -> None:
        builder = DiagramBuilder()
        urdf = URDF
        if effort is not None:
            urdf = URDF.replace("<limit ", f'<limit effort="{effort}" ')
        self.plant, scene_graph = add_plant(builder, urdf, time_step=time_step)
        self.controller = add_controller(
            builder,
            self.plant,
            scene_graph,
            RobotDescription(pairs=[["l3", "post"]]),
            [Task(frame="tip")],
            LookaheadParameters(**({"period": PERIOD, "blend_time": 0.02} | changes)),
        )
        target = builder.AddSystem(ConstantVectorSource(TARGET))
        builder.Connect(
            target.get_output_port(), self.controller.get_input_port_desired_tasks()
        )
        self.logs: dict[str, VectorLogSink] = {
            port: LogVectorOutput(
                part_port(builder, self.controller, port), builder, STEP
            )
            for port in LOGGED
        }
        self.logs["state"] = LogVectorOutput(
            self.plant.get_state_output_port(), builder, STEP
        )
        self.diagram: Diagram = builder.Build()

    def start(self, time: float = 0.0, speeds: np.ndarray | None = None) -> Simulator:
        simulator = Simulator(self.diagram)
        context = simulator.get_mutable_context()
        context.SetTime(time)
        own = self.plant.GetMyMutableContextFromRoot(context)
        self.plant.SetPositions(own, START)
        if speeds is not None:
            self.plant.SetVelocities(own, speeds)
        simulator.Initialize()
        return simulator

    def state(self, context: Context) -> np.ndarray:
        return self.plant.GetPositionsAndVelocities(
            self.plant.GetMyContextFromRoot(context)
        )

    def out(self, port: str, context: Context) -> np.ndarray:
        own = self.controller.GetMyContextFromRoot(context)
        if port in self.controller.diagnostics_slices:
            return self.controller.diagnostics(own)[port]
        return self.controller.GetOutputPort(port).Eval(own).copy()

    def logged(self, simulator: Simulator) -> dict[str, np.ndarray]:
        return {
            name: log.FindLog(simulator.get_context()).data().T
            for name, log in self.logs.items()
        }


def count(monkeypatch: pytest.MonkeyPatch, owner: type, name: str) -> list[str]:
    """A list that grows with each call of the method."""
    calls: list[str] = []
    method = getattr(owner, name)

    def counted(*args, **kwargs):
        calls.append(name)
        return method(*args, **kwargs)

    monkeypatch.setattr(owner, name, counted)
    return calls


def torque_every(monkeypatch: pytest.MonkeyPatch, time: float) -> None:
    """Lets torques be computed so far apart at most [s], instead of a millisecond."""
    monkeypatch.setattr(parameters, "_TORQUE_PERIOD", time)


@pytest.mark.parametrize("ratio", [1, 2, 5, 10])
def test_position_command_is_the_state_a_period_later(ratio):
    loop = Loop(period=ratio * STEP)
    simulator = loop.start()
    context = simulator.get_context()
    fastest = 0.0
    for k in range(20):
        command = loop.out("position_command", context)
        simulator.AdvanceTo((k + 1) * ratio * STEP)
        np.testing.assert_allclose(loop.state(context), command, atol=1e-9)
        fastest = max(fastest, np.abs(command[4:]).max())
    assert fastest > 1.0


def test_position_command_of_a_continuous_plant(monkeypatch):
    """The nearer to the truth, the more often the torque is computed."""
    errors = {}
    for ticks in (1, 5, 50):
        torque_every(monkeypatch, PERIOD / ticks)
        loop = Loop(0.0, blend_time=0.5)
        simulator = loop.start()
        simulator.get_mutable_integrator().set_target_accuracy(1e-9)
        context, worst = simulator.get_context(), 0.0
        for k in range(20):
            simulator.AdvanceTo((k + 0.1 / ticks) * PERIOD)
            command = loop.out("position_command", context)
            simulator.AdvanceTo((k + 1) * PERIOD)
            worst = max(worst, np.abs(loop.state(context) - command).max())
        errors[ticks] = worst
    assert errors[5] < 0.35 * errors[1]
    assert errors[50] < 0.15 * errors[5]
    assert errors[50] < 1e-3


@pytest.mark.parametrize("time_step", [STEP, 0.0], ids=["discrete", "continuous"])
@pytest.mark.parametrize("ticks", [1, 5])
def test_every_torque_is_that_of_its_instant(time_step, ticks, monkeypatch):
    """Law first, then torque: as a loop of ControlLaw.step and ControlLaw.torque on the
    states of the log has it. A continuous plant's log is of just before the update."""
    torque_every(monkeypatch, PERIOD / ticks)
    loop = Loop(time_step)
    simulator = loop.start()
    simulator.AdvanceTo(0.1)
    data = loop.logged(simulator)
    law = ControlLaw(loop.controller.model, loop.controller.law.parameters)
    late = 0 if time_step else 1
    torques = []
    for j, (q, v) in enumerate(np.split(x, 2) for x in data["state"][: 101 - late]):
        if j % 5 == 0:
            solution = law.step(q, v, TARGET)
            torque = solution.actuation
        elif ticks > 1:
            torque = law.torque(q, v)
        close = dict(rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(data["actuation"][j + late], torque, **close)
        np.testing.assert_allclose(
            data["desired_acceleration"][j + late], solution.acceleration, **close
        )
        torques.append(torque)
    place = loop.controller.diagnostics_slices["actuation"]
    np.testing.assert_array_equal(data["diagnostics"][:, place], data["actuation"])
    changes = np.abs(np.diff(torques, axis=0)).max(axis=1) > 1e-6
    inside = np.arange(1, len(torques)) % 5 != 0
    inside[:5] = False  # it starts at rest
    assert (changes[inside] == (ticks > 1)).all()


@pytest.mark.parametrize("time_step", [STEP, 0.0], ids=["discrete", "continuous"])
@pytest.mark.parametrize(
    "period, solves", [(STEP, 100), (PERIOD, 20)], ids=["1 ms", "5 ms"]
)
def test_nothing_is_computed_twice(time_step, period, solves, monkeypatch):
    loop = Loop(time_step, period=period)
    solved = count(monkeypatch, ControlLaw, "solve")
    computed = count(monkeypatch, ControlModel, "inverse_dynamics")
    simulator = loop.start()
    simulator.AdvanceTo(0.1)
    # The last sample of a discrete plant's log is of a tick that is yet to come.
    last = 1 if time_step else 0
    assert (len(solved), len(computed)) == (solves + last, 100 + last)


@pytest.mark.parametrize(
    "step, ratio, apart", [(1 / 700, 3, 1), (1 / 6000, 30, 6), (7e-4, 9, 1)]
)
def test_periods_whose_multiples_round_differently(step, ratio, apart, monkeypatch):
    """Each torque once, of the state that the plant's step starts from."""
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, chain_urdf("zz"), time_step=step)
    gains = LookaheadParameters(period=ratio * step)
    controller = add_controller(
        builder, plant, scene_graph, RobotDescription(), [Task(frame="tip")], gains
    )
    target = builder.AddSystem(ConstantVectorSource(np.r_[0.3, 0.3, np.zeros(7)]))
    builder.Connect(target.get_output_port(), controller.get_input_port_desired_tasks())
    diagram = builder.Build()
    assert ratio // gains.torque_ticks(step)[0] == apart  # steps between two torques
    model, seen = controller.model, []
    inverse_dynamics = ControlModel.inverse_dynamics

    def recorded(self, workspace, vdot):
        seen.append(model.plant.GetPositionsAndVelocities(workspace.plant_context))
        return inverse_dynamics(self, workspace, vdot)

    monkeypatch.setattr(ControlModel, "inverse_dynamics", recorded)
    simulator = Simulator(diagram)
    context, states = simulator.get_context(), []
    for k in range(300):
        # Half a step before the tick the plant has the tick's state already.
        simulator.AdvanceTo(max(k * apart - 0.5, 0.0) * step)
        states.append(context.get_discrete_state_vector().CopyToVector())
    np.testing.assert_array_equal(seen[:299], states[:299])


def test_time_set_back_within_a_control_period_starts_afresh():
    loop = Loop()
    simulator = loop.start()
    simulator.AdvanceTo(0.0538)
    context = simulator.get_mutable_context()
    x = loop.state(context)
    context.SetTime(0.0512)
    fresh = loop.diagram.CreateDefaultContext()
    fresh.SetTime(0.0512)
    loop.plant.SetPositionsAndVelocities(
        loop.plant.GetMyMutableContextFromRoot(fresh), x
    )
    assert loop.out("status", context) == 1.0  # it blends in again
    for port in LOGGED:
        np.testing.assert_array_equal(loop.out(port, context), loop.out(port, fresh))
    simulator.Initialize()
    simulator.AdvanceTo(0.06)
    assert np.isfinite(loop.state(context)).all()


@pytest.mark.parametrize("time_step", [STEP, 0.0], ids=["discrete", "continuous"])
def test_a_run_may_begin_between_control_ticks(time_step, monkeypatch):
    """It holds what it solved there until the next control tick; that one does not
    take the shorter time for a whole period."""
    loop = Loop(time_step)
    solve, calls = ControlLaw.solve, []

    def recorded(self, workspace, memory, tick, time, q, v, *rest):
        calls.append((tick, round(time, 6), memory.kept is None))
        return solve(self, workspace, memory, tick, time, q, v, *rest)

    monkeypatch.setattr(ControlLaw, "solve", recorded)
    simulator = loop.start(0.052)
    simulator.AdvanceTo(0.0615)
    # Until its first update a continuous plant's controller follows the state.
    once = list(dict.fromkeys(calls))
    assert once == [(10, 0.052, True), (11, 0.055, True), (12, 0.06, False)]
    assert time_step == 0.0 or len(calls) == 3


def test_targets_are_looked_at_in_control_ticks_only_and_the_state_in_all():
    """A NaN in the state is told at the torque tick that meets it."""
    loop = Loop()
    simulator = loop.start()
    simulator.AdvanceTo(0.0515)
    context = simulator.get_mutable_context()
    context.get_mutable_discrete_state_vector().SetAtIndex(5, np.nan)
    with pytest.raises(InputError, match=r"estimated_state.*0\.052 s.*entries 5"):
        simulator.AdvanceTo(0.06)


def test_a_torque_that_will_pass_its_limit_is_lowered_from_what_it_is():
    """The limit does not bind at the control tick, but would be passed after it. From
    starts from which the motors can brake over T, as the theorem asks."""
    period = 10 * STEP
    law = Loop(effort=60.0, period=period).controller.law
    plant, workspace = law.model.plant, law.model.MakeWorkspace()
    rng, grows, judged = np.random.default_rng(0), 0, 0
    for _ in range(200):
        q = START + 0.3 * rng.standard_normal(len(START))
        v = rng.uniform(-4.0, 4.0, len(START))
        law.reset()
        solution = law.step(q, v, TARGET)
        a = solution.acceleration
        plant.SetPositionsAndVelocities(workspace.plant_context, np.r_[q, v])
        braking = law.model.inverse_dynamics(workspace, -v / solution.T)
        if np.abs(braking).max() > 0.9 * 60.0:
            continue
        judged += 1
        for ticks in range(1, 10):
            # Semi-implicit, as the plant steps: after so many tenths of the period.
            t = ticks * STEP
            then = np.concatenate([q + t * v + 0.5 * t * (t + STEP) * a, v + t * a])
            plant.SetPositionsAndVelocities(workspace.plant_context, then)
            torque = np.abs(law.model.inverse_dynamics(workspace, a))
            assert torque.max() <= 60.0 + 1e-9, (ticks, torque.max())
        grows += torque.max() > np.abs(solution.actuation).max() + 1.0
    assert grows > 5 and judged > 80


@pytest.mark.parametrize("target", [TARGET, np.full_like(TARGET, np.nan)])
def test_a_torque_is_clipped_only_where_no_acceleration_is_within_the_limits(target):
    """Even where neither the wish nor braking is, nor anything between them, and where
    the wish is to brake, since the targets are lost. What there is within is found by a
    linear program, of Drake's own inverse dynamics."""
    effort = 8.0
    law = Loop(effort=effort, period=STEP).controller.law
    model, workspace = law.model, law.model.MakeWorkspace()
    rng, n, far = np.random.default_rng(0), len(START), 0
    fastest = np.minimum(law.speed_limits, fastest_asked(model))
    for _ in range(600):
        q = START + 0.5 * rng.standard_normal(n)
        v = rng.uniform(-1.0, 1.0, n) * rng.choice([0.5, 2.0, 6.0])
        law.reset()
        solution = law.step(q, v, target)
        model.evaluate(workspace, q, v)
        still = model.inverse_dynamics(workspace, np.zeros(n))
        unit = [model.inverse_dynamics(workspace, e) for e in np.eye(n)]
        inertia = np.array(unit).T - still[:, None]
        T = solution.T[0]
        limits = hold(JointLimits(model.lower, model.upper, fastest, STEP, STEP))
        bounds = velocity_bounds(q, v, T, limits)
        lowest, highest = ((s - v) / T for s in bounds)
        within = linprog(
            np.zeros(n),
            np.vstack((inertia, -inertia)),
            np.concatenate((0.999 * effort - still, 0.999 * effort + still)),
            bounds=np.column_stack((lowest, highest)),
        )
        braking = still - inertia @ v / T
        # What is scaled to keep clear has braking's torque, whatever it is.
        scaled = solution.admission[0] == SCALED
        if within.status == 0 and not scaled:
            assert solution.torque_limit[1] < 1e-4
            far += np.abs(braking).max() > 1.05 * effort
    assert far > 10


# --- a user's own loop ------------------------------------------------------------


@pytest.mark.parametrize(
    "q, v, words",
    [
        (START[:3], START, r"q has shape \(3,\)"),
        (START, np.r_[START, 0.0], r"v has shape \(5,\)"),
        (START + np.nan, START, "q has a NaN"),
        (START, np.r_[START[:3], np.inf], "v has a NaN or infinite.*entries 3"),
    ],
)
def test_bad_states_are_named(q, v, words):
    law = ControlLaw(make_model(chain_urdf("zyzy")))
    law.step(START, np.zeros(4), TARGET)
    with pytest.raises(InputError, match=words):
        law.torque(q, v)


def test_torque_within_effort_limits():
    urdf = chain_urdf("zyzy").replace("<limit ", '<limit effort="100" ')
    model = make_model(urdf)
    q, v = START, np.full(4, 20.0)
    torques, excesses = [], []
    for respect in (True, False):
        law = ControlLaw(model, LookaheadParameters(effort_limits=respect))
        share = law.step(START, np.zeros(4), TARGET).torque_limit[0]
        torques.append(law.torque(q, v))
        told = law._memory.solution.torque_limit
        assert told[0] == share  # it is decided in the control step
        excesses.append(told[1])
    limited, free = torques
    assert excesses == pytest.approx([np.abs(free).max() / 100.0 - 1.0, 0.0])
    assert np.abs(free).max() > 150.0
    np.testing.assert_array_equal(limited, np.clip(free, -100.0, 100.0))


# --- how often ----------------------------------------------------------------


@pytest.mark.parametrize(
    "period, plant_step, expected",
    [
        (1e-3, 1e-3, 1e-3),
        (5e-3, 1e-3, 1e-3),
        (5e-3, 0.0, 1e-3),
        (0.5e-3, 0.0, 0.5e-3),
        (0.5e-3, 1e-4, 0.5e-3),
        (10e-3, 2e-3, 2e-3),  # a coarse plant's own step
        (5e-3, 1e-4, 1e-3),
        (2.5e-3, 0.0, 2.5e-3 / 3),  # no 1 ms: it must divide the period
        (2.5e-3, 5e-4, 5e-4),
        (6.3e-3, 7e-4, 7e-4),
        (1.1e-3, 1e-4, 1e-4),  # eleven steps can be parted into single ones only
        (20e-3, 20e-3, 20e-3),
    ],
)
def test_a_torque_each_millisecond_or_step(period, plant_step, expected):
    gains = LookaheadParameters(period=period)
    gains.validate()
    ticks, time = gains.torque_ticks(plant_step)
    assert time == pytest.approx(expected, rel=1e-9)
    assert ticks * expected == pytest.approx(period, rel=1e-9)


def test_measurements_come_at_torque_ticks():
    """A late state is late by whole control periods, and yet moves in between."""
    scenario = load_scenario("obstacle_arm")
    scenario.controller.period, scenario.log_period = PERIOD, STEP
    scenario.disturbances = Disturbances(delay_periods=2)
    diagram = MakeCrarDiagram(scenario)
    measured = diagram.GetSubsystemByName("measurement").get_output_port()
    simulator = Simulator(diagram)
    context = simulator.get_context()
    states, seen = [], []
    for k in range(200):
        simulator.AdvanceTo((k + 0.5) * STEP)
        seen.append(measured.Eval(measured.get_system().GetMyContextFromRoot(context)))
        states.append(diagram.GetOutputPort("state").Eval(context))
    # Half a step after a tick the plant is one step on.
    np.testing.assert_array_equal(seen[20:], states[10:-10])
    assert (np.abs(np.diff(states[20:], axis=0)).max(axis=1) > 0.0).all()
