"""What faults do to a robot that follows the filter's commands within a stated error.

`python -m benchmarks.faults --tracking-error E` runs it. The robot has position drives
of finite stiffness and its own masses, and is simulated; the wanted motion is that of
the law without constraints, which goes through the robot. Like `serve`, the loop
compares the measured state with the command before, and brakes beyond E.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ExternallyAppliedSpatialForce,
)
from pydrake.multibody.tree import PdControllerGains, PrismaticJoint
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from benchmarks.page import Table
from crar_drake.judging.referee import Referee
from crar_drake.law.parameters import SafetyParameters
from crar_drake.law.safety_filter import SafetyFilter
from crar_drake.robot.description import add_robot, load_robot_description
from crar_drake.run import RunResult
from crar_drake.simulation.diagram import leave_out_contact
from crar_drake.simulation.disturbances import Push, ScaleMasses, applied_force

ROBOT = "upper_body"
PERIOD, STEP = 5e-3, 1e-3  # of the filter, and of the plant [s]
# Of drives: stiffness [Nm/rad], damping [Nm s/rad]; of slides [N/m], [N s/m].
TURNING, SLIDING = (2e4, 600.0), (1e6, 4e4)
# Slides err by less: a share of E, in metres.
SLIDES_SHARE = 0.1
_PUSHED = 0.2  # [s]


@dataclass(frozen=True)
class FilterFault:
    """How the robot differs from one that is where its command is.

    Attributes:
        name: of the table's row.
        mass_scale: factor on all masses and inertias.
        noise: standard deviation of measured positions [rad or m].
        late_state: how late the measured state is [s].
        late_commands: how late drives get their commands [s].
        pushes: forces on the robot.
    """

    name: str
    mass_scale: float = 1.0
    noise: float = 0.0
    late_state: float = 0.0
    late_commands: float = 0.0
    pushes: tuple[Push, ...] = field(default_factory=tuple)


@dataclass(frozen=True)
class FilterOutcome:
    """A run of a fault, judged on the true state at each step of the plant.

    Attributes:
        fault, where: names, of the fault and of the motion.
        error, joint: the largest of a joint to its command then, as a share of its E.
        braked: periods in which the loop braked, of
        periods: all.
        smallest_distance, pair: over watched pairs and steps [m].
        violated: steps with a penetration or a joint beyond its limit, of
        steps: all.
    """

    fault: str
    where: str
    error: float
    joint: str
    braked: int
    periods: int
    smallest_distance: float
    pair: str
    violated: int
    steps: int


def filter_faults(time: float, hand: str, towards: np.ndarray) -> list[FilterFault]:
    """The faults of the table.

    Args:
        time: when a hand comes nearest to something [s].
        hand: which link, and
        towards: (3,) where it then is pushed to.
    """
    up = np.array([0.0, 0.0, 1.0])
    sideways = np.cross(towards, up)
    sideways /= max(np.linalg.norm(sideways), 1e-9)
    pushes = {"towards the nearest link": towards, "sideways": sideways, "up": up}
    return [
        FilterFault("none"),
        *(
            FilterFault(f"masses, inertias {scale - 1.0:+.0%}", mass_scale=scale)
            for scale in (0.8, 1.2)
        ),
        *(FilterFault(f"noise {1e3 * x:g} mrad", noise=x) for x in (1e-3, 5e-3)),
        *(
            FilterFault(f"measured state {1e3 * x:g} ms late", late_state=x)
            for x in (0.01, 0.02, 0.03)
        ),
        *(
            FilterFault(f"commands {1e3 * x:g} ms late", late_commands=x)
            for x in (0.01, 0.02, 0.03)
        ),
        *(
            FilterFault(
                f"50 N on a hand, {name}",
                pushes=(Push(hand, (50.0 * n).tolist(), max(time, 0.0), _PUSHED),),
            )
            for name, n in pushes.items()
        ),
        FilterFault(
            "masses +20%, noise 1 mrad, state and commands 10 ms late",
            mass_scale=1.2,
            noise=1e-3,
            late_state=0.01,
            late_commands=0.01,
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

    def __init__(self, fault: FilterFault, q: np.ndarray) -> None:
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, STEP)
        plant = self.plant
        self.description = load_robot_description(ROBOT)
        add_robot(plant, self.description)
        for index in plant.GetJointIndices():
            joint = plant.get_joint(index)
            unlimited = np.full(joint.num_positions(), np.inf)
            joint.set_position_limits(-unlimited, unlimited)
        plant.RemoveAllJointActuatorEffortLimits()
        for index in plant.GetJointActuatorIndices():
            actuator = plant.get_mutable_joint_actuator(index)
            slides = isinstance(actuator.joint(), PrismaticJoint)
            p, d = SLIDING if slides else TURNING
            actuator.set_controller_gains(PdControllerGains(p=p, d=d))
        plant.Finalize()
        leave_out_contact(plant, self.scene_graph)
        self._simulator = Simulator(builder.Build())
        root = self._simulator.get_mutable_context()
        self.context = plant.GetMyMutableContextFromRoot(root)
        ScaleMasses(plant, self.context, fault.mass_scale)
        plant.SetPositions(self.context, q)
        self._instance = plant.GetModelInstanceByName(
            plant.GetModelInstanceName(
                plant.get_joint_actuator(plant.GetJointActuatorIndices()[0])
                .joint()
                .model_instance()
            )
        )
        self._target = plant.get_desired_state_input_port(self._instance)
        self._pushes = [
            (p.start, p.start + p.duration, applied_force(plant, {}, p))
            for p in fault.pushes
        ]

    def step(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The state (nq + nv,) after a step of the plant with these targets."""
        time = self._simulator.get_context().get_time()
        self._target.FixValue(self.context, np.concatenate((q, v)))
        if self._pushes:
            now = [f for start, end, f in self._pushes if start <= time + 1e-9 < end]
            self.plant.get_applied_spatial_force_input_port().FixValue(
                self.context, Value[list[ExternallyAppliedSpatialForce]](now)
            )
        self._simulator.AdvanceTo(time + STEP)
        return self.plant.GetPositionsAndVelocities(self.context)


def run_filter_fault(
    filter: SafetyFilter,
    error: float,
    wanted: np.ndarray,
    fault: FilterFault,
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
    robot = DrivenRobot(fault, start)
    rng = np.random.default_rng(0)
    state = np.concatenate((start, np.zeros(n)))
    late = round(fault.late_commands / STEP)
    commands = deque([(start, np.zeros(n))] * (late + 1), maxlen=late + 1)
    past = deque([state] * (round(fault.late_state / STEP) + 1))
    before, path, worst, joint, braked, beyond = start, [], 0.0, "", 0, False
    for wish in wanted:
        measured = past[0][:n] + fault.noise * rng.normal(size=n)
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
    return FilterOutcome(
        fault.name,
        where,
        worst,
        joint,
        braked,
        len(wanted),
        verdict.smallest_distance,
        " - ".join(verdict.smallest_distance_pair or ()),
        verdict.num_violated,
        verdict.num_samples,
    )


def wanted_of(run: RunResult, filter: SafetyFilter) -> np.ndarray:
    """(K, n) the positions of a run, one a period of the filter, led in from rest."""
    every = round(filter.period / (run.log.time[1] - run.log.time[0]))
    rest = filter.model.rest_positions()
    q = run.log.q[::every]
    steps = round(1.0 / filter.period)
    share = np.linspace(0.0, 1.0, steps)[:, None]
    smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return np.concatenate([rest + smooth * (q[0] - rest), q])


LEAD_IN = 1.0  # [s] of `wanted_of`


def filter_table(
    outcomes: Sequence[FilterOutcome], error: float, floor: float
) -> Table:
    """Each fault over all motions, the worst of them."""
    rows = []
    for name in dict.fromkeys(o.fault for o in outcomes):
        runs = [o for o in outcomes if o.fault == name]
        far = max(runs, key=lambda o: o.error)
        near = min(runs, key=lambda o: o.smallest_distance)
        braked = sum(o.braked for o in runs)
        rows.append(
            [
                name,
                f"{far.error:.2f} E ({far.joint})",
                f"{1e3 * near.smallest_distance:.1f} mm ({near.pair})",
                "kept" if near.smallest_distance >= floor else "NOT KEPT",
                f"{braked} of {sum(o.periods for o in runs)}" if braked else "never",
                f"{sum(o.violated for o in runs)} of {sum(o.steps for o in runs)}",
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
    moments: dict[str, tuple[float, str, np.ndarray]],
) -> list[FilterOutcome]:
    """Every fault on the motions of some runs; prints each.

    Args:
        error: E [rad].
        runs: by the motion's name, without constraints.
        moments: of each, when a hand is nearest, which, and where it is pushed to.
    """
    filter, outcomes = make_filter(error), []
    for where, run in runs.items():
        wanted = wanted_of(run, filter)
        time, hand, towards = moments[where]
        for fault in filter_faults(time + LEAD_IN, hand, towards):
            outcome = run_filter_fault(filter, error, wanted, fault, where)
            print(f"{where}: {fault.name}: {outcome.error:.2f} E", flush=True)
            outcomes.append(outcome)
    return outcomes
