"""Targets that are lost at run time: brake, say so, and pick up again."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput
from small_robots import add_controller, add_plant, chain_urdf

from crar_drake.errors import InputError
from crar_drake.judging.referee import Referee
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.controller import CrarController
from crar_drake.law.parameters import LookaheadParameters, PaperParameters
from crar_drake.results.summary import summarize
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.task import Task
from crar_drake.run import make_log
from crar_drake.simulation.diagram import (
    MakeCrarDiagram,
    PrepareScenario,
)
from crar_drake.simulation.scenario import Scenario, load_scenario
from crar_drake.targets.desired_motion import DesiredMotion
from tests.controller_parts import part_port

STEP = 1e-3
BLENDING = 0.2  # [s]
HORIZON = 0.05  # [s]
START = np.array([-0.1, 0.2, 0.9, -0.6])  # rail, then three joints
URDF = chain_urdf("zyz", rail="y", limits=(-2, 2))
PAIRS = [["l2", "post"], ["l1", "post"]]
DESCRIPTION = RobotDescription(prescribed_joints={"rail": "hold"}, pairs=PAIRS)


class Stream(LeafSystem):
    """A target that moves, and is NaN while it is lost."""

    def __init__(self, function, size: int, lost: Sequence[tuple[float, float]]):
        super().__init__()
        self._function, self._lost = function, lost
        self.DeclareVectorOutputPort("y", size, self._Calc, {self.time_ticket()})

    def _Calc(self, context: Context, output: BasicVector) -> None:
        time = context.get_time()
        value = np.array(self._function(time), dtype=float)
        if is_lost(time, self._lost):
            value[-1] = np.nan  # one entry is enough
        output.SetFromVector(value)


def is_lost(time: float, lost: Sequence[tuple[float, float]]) -> bool:
    return any(start - 1e-9 <= time < end - 1e-9 for start, end in lost)


def tip_target(t: float) -> np.ndarray:
    """To the post (at x = 0.2, y = 0.5, z = 0.1), into it, and back."""
    y, rate = 0.35 + 0.25 * np.sin(6.0 * t), 1.5 * np.cos(6.0 * t)
    return np.r_[0.45, y, 0.1 * t, 0.0, rate, 0.1, 0.0, -9.0 * np.sin(6.0 * t), 0.0]


def rail_target(t: float) -> np.ndarray:
    return 0.05 * np.array([np.sin(9 * t), 9 * np.cos(9 * t), -81 * np.sin(9 * t)])


@dataclass
class Run:
    """Samples of a closed loop, at every control step."""

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    status: np.ndarray
    acceleration: np.ndarray
    actuation: np.ndarray
    controller: CrarController
    referee: Referee

    @property
    def braking(self) -> np.ndarray:
        return self.status == 2.0


def simulate(
    lost_tip=(), lost_rail=(), *, duration: float = 2.0, kind=LookaheadParameters
) -> Run:
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, URDF)
    parameters = kind(blend_time=BLENDING)
    if kind is LookaheadParameters:
        parameters.braking_time = HORIZON
    controller = add_controller(
        builder, plant, scene_graph, DESCRIPTION, [Task(frame="tip")], parameters
    )
    for stream, port in (
        (Stream(tip_target, 9, lost_tip), controller.get_input_port_desired_tasks()),
        (
            Stream(rail_target, 3, lost_rail),
            controller.get_input_port_desired_prescribed(),
        ),
    ):
        builder.AddSystem(stream)
        builder.Connect(stream.get_output_port(), port)
    logs = {
        name: LogVectorOutput(port, builder, STEP)
        for name, port in {
            "state": plant.get_state_output_port(),
            "status": part_port(builder, controller, "status"),
            "acceleration": part_port(builder, controller, "desired_acceleration"),
            "actuation": controller.get_output_port_actuation(),
        }.items()
    }
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetPositions(context, START)
    simulator.AdvanceTo(duration)
    found = {
        name: log.FindLog(simulator.get_context()).data().T.copy()
        for name, log in logs.items()
    }
    return Run(
        time=logs["state"].FindLog(simulator.get_context()).sample_times().copy(),
        q=found["state"][:, :4],
        v=found["state"][:, 4:],
        status=found["status"][:, 0],
        acceleration=found["acceleration"],
        actuation=found["actuation"],
        controller=controller,
        referee=Referee(plant, scene_graph, PAIRS),
    )


LONG, SHORT = (0.7, 1.2), (1.61, 1.64)


@pytest.fixture(scope="module")
def run() -> Run:
    """A long gap, and a short one in full motion."""
    return simulate([LONG, SHORT])


def at(run: Run, time: float) -> int:
    return int(round(time / STEP))


def test_braking_is_exactly_that(run):
    """q_ddot = -q_dot / T of every joint, the prescribed one as well."""
    assert np.abs(run.v[run.braking]).max() > 0.5
    np.testing.assert_allclose(
        run.acceleration[run.braking], -run.v[run.braking] / HORIZON, rtol=1e-12
    )
    # And the plant does so: v falls by 1 - STEP / T each step.
    rows = np.flatnonzero(run.braking & (run.time < LONG[1] - STEP / 2))
    np.testing.assert_allclose(
        run.v[rows + 1], (1.0 - STEP / HORIZON) * run.v[rows], atol=1e-7
    )


def test_it_comes_to_rest_where_it_said(run):
    """At q + T q_dot of the moment in which the targets were lost."""
    lost, back = at(run, LONG[0]), at(run, LONG[1])
    assert np.abs(run.v[lost]).max() > 0.5
    assert np.abs(run.v[back]).max() < 1e-3
    # The discrete plant moves by its next velocity: a step of the series less.
    resting = run.q[lost] + (HORIZON - STEP) * run.v[lost]
    np.testing.assert_allclose(run.q[back], resting, atol=2e-5)


@pytest.mark.parametrize("gap", [LONG, SHORT], ids=["long", "short"])
def test_it_picks_up_as_it_started(run, gap):
    """The first command after a gap is that of a start in that state: no jump beyond
    a normal start's."""
    back = at(run, gap[1])
    law = ControlLaw(run.controller.law.model, run.controller.law.parameters)
    fresh = law.step(
        run.q[back],
        run.v[back],
        tip_target(run.time[back]),
        rail_target(run.time[back]),
    )
    np.testing.assert_allclose(run.acceleration[back], fresh.acceleration, rtol=1e-9)
    if gap == SHORT:
        return
    # From rest there is no jump beyond that of the first steps of the run.
    change = np.abs(np.diff(run.acceleration, axis=0)).max(axis=1)
    assert change[back - 1] <= change[:10].max()
    abrupt = ControlLaw(
        run.controller.law.model,
        replace(run.controller.law.parameters, blend_time=0.0),
    ).step(
        run.q[back],
        run.v[back],
        tip_target(run.time[back]),
        rail_target(run.time[back]),
    )
    assert np.abs(abrupt.acceleration).max() > 10.0 * change[back - 1]


def test_lost_prescribed_motion_brakes_as_well():
    run = simulate(lost_rail=[(0.3, 0.5)], duration=0.6)
    assert run.braking.sum() == 200
    np.testing.assert_allclose(
        run.acceleration[run.braking], -run.v[run.braking] / HORIZON, rtol=1e-12
    )
    assert np.isfinite(run.actuation).all()


@pytest.mark.parametrize(
    "lost, port",
    [(dict(lost_tip=[(0.1, 0.2)]), "tasks"), (dict(lost_rail=[(0.1, 0.2)]), "presc")],
)
def test_the_papers_law_raises_with_port_and_time(lost, port):
    with pytest.raises(InputError, match=rf"desired_{port}.* t = 0\.1 s"):
        simulate(**lost, duration=0.3, kind=PaperParameters)


@pytest.mark.parametrize("kind", [LookaheadParameters, PaperParameters])
@pytest.mark.parametrize("entry", [0, 7])
def test_state_that_is_not_a_number_is_an_error(run, kind, entry):
    """There is no state to brake from."""
    controller = CrarController(run.controller.law.model, kind())
    context = controller.CreateDefaultContext()
    state = np.r_[START, np.zeros(4)]
    state[entry] = np.nan
    controller.get_input_port_estimated_state().FixValue(context, state)
    controller.get_input_port_desired_tasks().FixValue(context, tip_target(0.0))
    controller.get_input_port_desired_prescribed().FixValue(context, rail_target(0.0))
    with pytest.raises(InputError, match="estimated_state"):
        controller.get_output_port_actuation().Eval(context)


def test_log_and_summary_count_the_samples_without_targets():
    """And those samples count in no task error."""
    shipped = load_scenario("obstacle_arm")
    controller = LookaheadParameters(period=5e-3)
    scenario: Scenario = replace(shipped, controller=controller)
    setup = PrepareScenario(scenario)
    motion: DesiredMotion = setup.motion
    size = setup.model.layout.size
    lost = [(0.2, 0.3)]
    gappy = replace(motion, MakeTaskSource=lambda: Stream(motion.tasks_at, size, lost))
    diagram = MakeCrarDiagram(scenario, setup=replace(setup, motion=gappy))
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.4)
    log = make_log(scenario, setup, diagram, simulator.get_context())
    expected = [is_lost(t, lost) for t in log.time]
    assert sum(expected) == 20
    np.testing.assert_array_equal(log.status[:, 0] == 2.0, expected)
    np.testing.assert_array_equal(np.isnan(log.task_error).all(axis=1), expected)
    summary = summarize(log)
    assert summary.braking_samples == 20
    assert 0.0 < summary.rms_task_error < 1.0
