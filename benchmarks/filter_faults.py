"""What faults do to a robot that follows the filter's commands within a stated error.

`python -m benchmarks.faults --tracking-error E` runs it. The robot has position drives
of finite stiffness and its own masses, and is simulated; the wanted motion is that of
the law without constraints, which goes through the robot. Like `serve`, the loop
compares the measured state with the command before, and brakes beyond E.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import PdControllerGains, PrismaticJoint
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from benchmarks.fault_cases import Fault, Judged, Moment
from benchmarks.page import Table
from crar_drake.judging.referee import Referee
from crar_drake.law.parameters import SafetyParameters
from crar_drake.law.safety_filter import SafetyFilter
from crar_drake.robot.description import add_robot, load_robot_description
from crar_drake.run import RunResult
from crar_drake.simulation.diagram import leave_out_contact, lift_limits
from crar_drake.simulation.disturbances import Disturbances, PushSource, ScaleMasses
from crar_drake.simulation.scenario import SimulatedRobot

ROBOT = "upper_body"
PERIOD, STEP = 5e-3, 1e-3  # of the filter, and of the plant [s]
# Of drives: stiffness [Nm/rad], damping [Nm s/rad]; of slides [N/m], [N s/m].
TURNING, SLIDING = (2e4, 600.0), (1e6, 4e4)
# Slides err by less: a share of E, in metres.
SLIDES_SHARE = 0.1
LEAD_IN = 1.0  # [s] of `wanted_of`


@dataclass(frozen=True)
class FilterOutcome(Judged):
    """A run of a filter under a fault.

    Attributes:
        error, joint: the largest of a joint to its command then, as a share of its E.
        braked: periods in which the loop braked, of
        periods: all.
    """

    error: float
    joint: str
    braked: int
    periods: int


def filter_faults(moment: Moment) -> list[Fault]:
    """The faults of the table."""
    late = range(2, 7, 2)  # periods
    milliseconds = [f"{1e3 * PERIOD * periods:g} ms" for periods in late]
    pushes = moment.pushes("link", (LEAD_IN, LEAD_IN, LEAD_IN))
    return [
        Fault("none"),
        *(
            Fault(f"masses, inertias {scale - 1.0:+.0%}", "", Disturbances(scale))
            for scale in (0.8, 1.2)
        ),
        *(
            Fault(f"noise {1e3 * x:g} mrad", "", Disturbances(position_noise=x))
            for x in (1e-3, 5e-3)
        ),
        *(
            Fault(f"measured state {ms} late", "", Disturbances(delay_periods=periods))
            for periods, ms in zip(late, milliseconds, strict=True)
        ),
        *(
            Fault(f"commands {ms} late", late_commands=PERIOD * periods)
            for periods, ms in zip(late, milliseconds, strict=True)
        ),
        *(
            Fault(name, "", Disturbances(pushes=[push]))
            for name, push in pushes.items()
        ),
        Fault(
            "masses +20%, noise 1 mrad, state and commands 10 ms late",
            "",
            Disturbances(1.2, position_noise=1e-3, delay_periods=2),
            late_commands=2 * PERIOD,
        ),
    ]


def make_filter(error: float, period: float = PERIOD) -> SafetyFilter:
    """The filter of the robot with a stated tracking error [rad]."""
    model = SafetyFilter(ROBOT, period).model
    slides = {
        plant_joint.name(): SLIDES_SHARE * error
        for plant_joint in map(model.plant.get_joint, model.plant.GetJointIndices())
        if isinstance(plant_joint, PrismaticJoint)
    }
    stated = SafetyParameters(tracking_error=error, tracking_errors=slides)
    return SafetyFilter(ROBOT, period, stated)


def stated_errors(filter: SafetyFilter, error: float) -> np.ndarray:
    """(n,) E of each joint of `make_filter`."""
    stated = filter.parameters.tracking_errors
    return np.array([stated.get(name, error) for name in filter.joint_names])


class DrivenRobot:
    """The simulated robot: drives of finite stiffness, masses of its own, no contact.

    Joints' limits are lifted: nothing may hide a violation.
    """

    def __init__(self, disturbances: Disturbances, q: np.ndarray) -> None:
        builder = DiagramBuilder()
        self.plant, scene_graph = AddMultibodyPlantSceneGraph(builder, STEP)
        plant = self.plant
        add_robot(plant, load_robot_description(ROBOT))
        lift_limits(plant, SimulatedRobot())
        for index in plant.GetJointActuatorIndices():
            actuator = plant.get_mutable_joint_actuator(index)
            slides = isinstance(actuator.joint(), PrismaticJoint)
            p, d = SLIDING if slides else TURNING
            actuator.set_controller_gains(PdControllerGains(p=p, d=d))
        plant.Finalize()
        leave_out_contact(plant, scene_graph)
        pushes = builder.AddSystem(PushSource(plant, {}, disturbances.pushes))
        builder.Connect(
            pushes.get_output_port(), plant.get_applied_spatial_force_input_port()
        )
        self._simulator = Simulator(builder.Build())
        root = self._simulator.get_mutable_context()
        self.context = plant.GetMyMutableContextFromRoot(root)
        ScaleMasses(plant, self.context, disturbances.mass_scale)
        plant.SetPositions(self.context, q)
        motor = plant.get_joint_actuator(plant.GetJointActuatorIndices()[0])
        self._target = plant.get_desired_state_input_port(motor.model_instance())

    def step(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The state (nq + nv,) after a step of the plant with these targets."""
        time = self._simulator.get_context().get_time()
        self._target.FixValue(self.context, np.concatenate((q, v)))
        self._simulator.AdvanceTo(time + STEP)
        return self.plant.GetPositionsAndVelocities(self.context)


def run_filter_fault(
    filter: SafetyFilter,
    error: float,
    wanted: np.ndarray,
    fault: Fault,
    where: str,
) -> FilterOutcome:
    """One run.

    Args:
        filter: of `make_filter`.
        error: E [rad].
        wanted: (K, n) joint positions, one a period, from the rest posture on.
        fault: of the robot.
        where: the motion's name.
    """
    n, per_period = len(filter.joint_names), round(filter.period / STEP)
    allowed = stated_errors(filter, error)
    start = filter.model.rest_positions()
    filter.reset(start)
    disturbances = fault.disturbances
    robot = DrivenRobot(disturbances, start)
    rng = np.random.default_rng(0)
    state = np.concatenate((start, np.zeros(n)))
    late = round(fault.late_commands / STEP)
    commands = deque([(start, np.zeros(n))] * (late + 1), maxlen=late + 1)
    past = deque([state] * (disturbances.delay_periods * per_period + 1))
    before, path, worst, joint, braked, beyond = start, [], 0.0, "", 0, False
    for wish in wanted:
        measured = past[0][:n] + disturbances.position_noise * rng.normal(size=n)
        off = np.abs(measured - before) / allowed
        beyond = bool((off > 1.0).any())
        both = measured, past[0][n:]
        if beyond:
            command = filter(v=np.zeros(n), measured=both)
            braked += 1
        else:
            command = filter(wish, measured=both)
        for i in range(1, per_period + 1):
            q = before + (i / per_period) * (command.q - before)
            commands.append((q, command.v))
            state = robot.step(*commands[0])
            past.append(state)
            past.popleft()
            path.append(state)
            share = np.abs(state[:n] - q) / allowed
            if share.max() > worst:
                worst, joint = float(share.max()), filter.joint_names[share.argmax()]
        before = command.q
    path = np.array(path)
    model = filter.model
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    verdict = referee.violations(path[:, :n])
    return FilterOutcome(fault, where, verdict, worst, joint, braked, len(wanted))


def wanted_of(run: RunResult, filter: SafetyFilter) -> np.ndarray:
    """(K, n) the positions of a run, one a period of the filter, led in from rest."""
    every = round(filter.period / (run.log.time[1] - run.log.time[0]))
    rest = filter.model.rest_positions()
    q = run.log.q[::every]
    steps = round(LEAD_IN / filter.period)
    share = np.linspace(0.0, 1.0, steps)[:, None]
    smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return np.concatenate([rest + smooth * (q[0] - rest), q])


def filter_table(
    outcomes: Sequence[FilterOutcome], error: float, floor: float
) -> Table:
    """Each fault over all motions, the worst of them."""
    rows = []
    for name in dict.fromkeys(o.fault.name for o in outcomes):
        runs = [o for o in outcomes if o.fault.name == name]
        far = max(runs, key=lambda o: o.error)
        near = min(runs, key=lambda o: o.smallest_distance)
        pair = " - ".join(near.verdict.smallest_distance_pair or ())
        braked = sum(o.braked for o in runs)
        rows.append(
            [
                name,
                f"{far.error:.2f} E ({far.joint})",
                f"{1e3 * near.smallest_distance:.1f} mm ({pair})",
                "kept" if near.smallest_distance >= floor else "NOT KEPT",
                f"{braked} of {sum(o.periods for o in runs)}" if braked else "never",
                f"{sum(o.violated for o in runs)} of {sum(o.samples for o in runs)}",
            ]
        )
    return Table(
        [
            "fault",
            "largest error of a joint",
            "smallest distance",
            f"floor, {1e3 * floor:g} mm",
            "periods braked",
            "samples violated",
        ],
        rows,
        f"E = {error:g} rad, {SLIDES_SHARE * error:g} m of slides",
    )


def run_filter_faults(
    error: float,
    runs: dict[str, RunResult],
    moments: dict[str, Moment],
) -> list[FilterOutcome]:
    """Every fault on the motions of some runs; prints each.

    Args:
        error: E [rad].
        runs: by the motion's name, without constraints.
        moments: of each, when a hand is nearest.
    """
    filter, outcomes = make_filter(error), []
    for where, run in runs.items():
        wanted = wanted_of(run, filter)
        for fault in filter_faults(moments[where]):
            outcome = run_filter_fault(filter, error, wanted, fault, where)
            print(f"{where}: {fault.name}: {outcome.error:.2f} E", flush=True)
            outcomes.append(outcome)
    return outcomes
