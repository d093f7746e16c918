"""The figures of one run: what `summary.json` holds and the table shows."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from crar_drake.judging.obstacle_judge import ObstacleFigures
from crar_drake.law.solution import STATUS_BRAKING, STATUS_IMPLAUSIBLE
from crar_drake.law.step import AS_NOMINAL, CORRECTED, SCALED
from crar_drake.law.tasks import TaskLayout
from crar_drake.motion.report import MotionReport
from crar_drake.results.controlled_joints import controlled_joints
from crar_drake.results.limb_directions import LimbDirection
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import load_logged_scenario
from crar_drake.results.remarks import clipped_line, remarks
from crar_drake.results.standing_run import Stance
from crar_drake.robot.description import LIMIT_TOLERANCE, SPEED_TOLERANCE
from crar_drake.version import __version__


@dataclass(frozen=True)
class TaskErrors:
    """The errors of one task."""

    kind: str  # "position", "orientation" or "pose"
    # root of the mean over time of |p_d - p|^2 [m]; None if the task has no position
    rms_error: float | None
    # the same of Eq. (11)'s orientation error [rad]; None if the task has no
    # orientation.
    rms_orientation_error: float | None


@dataclass(frozen=True)
class Summary:
    """The figures of one run, in the definitions that all runs share.

    `summary.json` is one JSON object with these attributes as its keys, in this
    order; None is null, and so is what is not a finite number. No number is
    rounded. Means over time are means over the log's samples.
    """

    version: str  # of crar_drake that made the summary
    robot: str  # name or path in the scenario
    motion: str  # name or path in the scenario; "" for keyframes
    experiment: str  # "wrists" or "upper-body"; "" for tasks of the scenario's own
    level: str  # "velocity" or "acceleration"
    constraints: str  # "none", "paper" or "lookahead"
    period: float  # of the controller [s]
    duration: float  # from the first to the last sample [s]
    samples: int  # number of samples in the log
    # root of the mean over time and tasks of |p_d - p|^2 [m]; None if no task has a
    # position
    rms_task_error: float | None
    # root of the mean over time and tasks of the squared orientation error of Eq. (11)
    # [rad]; None if no task has one.
    rms_orientation_error: float | None
    tasks: dict[str, TaskErrors]  # the task's name to its own errors, see `TaskErrors`
    # over time and watched pairs [m], negative inside one another; None if no pair is
    # watched
    smallest_distance: float | None
    smallest_distance_pair: str  # that pair, "link a - link b"; "" if none
    smallest_distance_time: float | None  # when [s]; None if no pair is watched
    violated_samples: int  # samples with a penetrating pair or a joint beyond a limit
    # violated limits plus penetrating pairs, mean over time (Fig. 2 counts them per
    # frame).
    mean_violations: float
    penetrating_samples: int  # samples with any pair at d < 0
    penetrating_pairs: dict[str, int]  # each such pair to its number of samples
    # samples with any controlled joint beyond a limit by more than 1e-6 rad
    beyond_limit_samples: int
    joints_beyond_limits: dict[str, int]  # each such joint to its number of samples
    # the farthest that a controlled joint is beyond a limit, 0 if none is [rad]
    largest_excess: float
    largest_excess_joint: str  # that joint; "" if none
    # samples with any controlled joint faster than its limit by more than 1e-6 rad/s;
    # they are no part of `violated_samples`
    beyond_speed_samples: int
    joints_beyond_speed: dict[str, int]  # each such joint to its number of samples
    # by how much a controlled joint is too fast at most, 0 if none is [rad/s]
    largest_speed_excess: float
    largest_speed_excess_joint: str  # that joint; "" if none
    # mean over time of the sum of |tau_i qdot_i| over the controlled joints, gravity
    # included in tau [W]
    mean_power: float
    peak_torque: float  # largest |tau_i| over time and controlled joints [Nm]
    peak_torque_joint: str  # that joint
    peak_torque_time: float  # when it occurred [s]
    # root of the mean over time and controlled joints of the squared commanded
    # acceleration [rad/s^2]
    rms_acceleration: float
    # control steps in the log that tell how they were admitted; 0 unless constraints
    # are "lookahead"
    admitted_steps: int
    corrected_steps: int  # those among them that more constraints had to correct
    scaled_steps: int  # those that were scaled towards braking
    # those that began with a braking path that was not known to be clear: the invariant
    # did not hold
    unclear_steps: int
    # no distance on a braking path was smaller, as the controller says, or saw where
    # the path was not clear [m]; None without such steps
    path_clearance: float | None
    longest_held_back: float  # time spent in corrected or scaled steps in a row [s]
    balanced_steps: int  # control steps in the log that were asked for balance
    changed_for_balance: int  # those among them that had to be corrected or scaled
    # what the ground had left on any next braking path, at least [m of the weight's
    # arm]; None without such steps
    smallest_balance: float | None
    # samples where the effort limits took more than a tenth of what was nominal, see
    # `SimulationLog`; 0 unless they are respected
    torque_limited_samples: int
    # those among them where not even braking was within the limits, so that torques
    # were clipped, by more than rounding
    torque_clipped_samples: int
    braking_samples: int  # samples without targets, which count in no error
    # samples with a measured state that no robot has, see `law.measured`; the
    # robot braked, and they count in no error
    implausible_samples: int
    frame_rate: float | None  # of the motion [Hz]; None for keyframes, or if not known
    # "given" by the user, stated by the "file", that of the CMU "database", or
    # "assumed"; "" if there is none
    frame_rate_source: str
    motion_findings: list[str]  # what looks bad in the motion, see `crar-drake show`
    warnings: list[str]  # what the user may not have meant, a line each
    wall_time: float | None  # that the simulation took [s]; None if not known
    real_time_factor: float | None  # duration / wall_time; None if not known
    # why the run ended before its time, "interrupted" or an error; "" if it did not, or
    # if it is not known
    stopped: str = ""
    # controlled joints whose positions are in m: what is reported of them is in m, m/s
    # and N where rad, rad/s and Nm stand here
    sliding_joints: list[str] = field(default_factory=list)
    # limb to the angle between its direction and the performer's, see
    # `limb_directions`; empty with keyframes, and where it was not computed
    limb_directions: dict[str, LimbDirection] = field(default_factory=dict)
    # the name of each that moves by itself to what it did, see `ObstacleFigures`
    obstacles: dict[str, ObstacleFigures] = field(default_factory=dict)
    # how the robot stood, see `Stance`; None unless it stands by itself
    stance: Stance | None = None
    # what is bad, though it may violate nothing, a line each, see `remarks`
    remarks: list[str] = field(default_factory=list)

    @property
    def title(self) -> str:
        """What was run, in two lines."""
        motion = motion_name(self.motion)
        tracked = self.experiment or "its own tasks"
        return (
            f"{robot_name(self.robot)} following {motion}: {tracked}\n"
            f"{self.level} level, constraints {self.constraints}, {self.duration:.2f} s"
        )

    @property
    def fast_contacts(self) -> int:
        """Samples in which an obstacle touches a link that is faster than is harmless;
        of several obstacles one after the other."""
        return sum(of.fast_contacts for of in self.obstacles.values())

    def unit_of(self, joint: str) -> str:
        """ "rad" or "m": of a controlled joint's positions."""
        return "m" if joint in self.sliding_joints else "rad"

    @property
    def peak_torque_unit(self) -> str:
        """ "Nm", or "N" if that joint slides."""
        return "N" if self.peak_torque_joint in self.sliding_joints else "Nm"

    def to_json(self) -> str:
        """The summary as JSON text, see the class documentation."""
        text = json.dumps(_finite(asdict(self)), indent=2, allow_nan=False)
        return text + "\n"


def motion_name(motion: str) -> str:
    """A motion's name; of a path the file's is enough. "keyframes" if it has none."""
    return Path(motion).stem if motion else "keyframes"


def robot_name(robot: str) -> str:
    """A robot's name, or of its path the folder's."""
    path = Path(robot)
    return (path.parent if path.suffix in (".yaml", ".yml") else path).name or robot


def summarize(
    log: SimulationLog,
    wall_time: float | None = None,
    *,
    motion: MotionReport | None = None,
    warnings: Sequence[str] = (),
    limbs: Mapping[str, LimbDirection] | None = None,
    lowest: tuple[float, str, float] | None = None,
    obstacles: Mapping[str, ObstacleFigures] | None = None,
    stance: Stance | None = None,
) -> Summary:
    """Computes the figures of a run.

    Args:
        log: of at least one sample.
        wall_time: that the simulation took [s], if it is known.
        motion: the report of the motion, if there is one at hand.
        warnings: lines to keep with the figures.
        limbs: how far they are off in direction, if it is known.
        lowest: height over the floor [m], link and time [s] of what was lowest, if it
            is known.
        stance: how it stood, of a robot that stands by itself.

    Raises:
        ScenarioError: the scenario in the log is not one of this version.
    """
    scenario = load_logged_scenario(log)
    layout = log.layout
    joints = controlled_joints(log)
    duration = float(log.time[-1] - log.time[0])

    penetrating = log.signed_distances < 0.0
    beyond = joints.excess > LIMIT_TOLERANCE
    violations = penetrating.sum(axis=1) + beyond.sum(axis=1)

    distance, distance_pair, distance_time = None, "", None
    if log.signed_distances.size:
        links = np.flatnonzero(log.between_links)
        sample, pair = _argmax(-log.signed_distances[:, links])
        distance = float(log.signed_distances[sample, links[pair]])
        distance_pair = str(log.pair_names[links[pair]])
        distance_time = float(log.time[sample])
    sample, joint = _argmax(joints.excess)
    excess = max(float(joints.excess[sample, joint]), 0.0)
    excess_joint = joints.names[joint] if excess > 0.0 else ""
    too_fast = joints.speed_excess > SPEED_TOLERANCE
    sample, joint = _argmax(joints.speed_excess)
    speed_excess = max(float(joints.speed_excess[sample, joint]), 0.0)
    speed_joint = joints.names[joint] if speed_excess > 0.0 else ""
    torque_sample, torque_joint = _argmax(np.abs(joints.torque))

    summary = Summary(
        version=__version__,
        robot=scenario.robot,
        motion=scenario.motion,
        experiment=scenario.experiment,
        level=scenario.controller.level,
        constraints=scenario.controller.constraints,
        period=scenario.controller.period,
        duration=duration,
        samples=len(log.time),
        rms_task_error=_rms_length(log.task_error[:, layout.linear_rows]),
        rms_orientation_error=_rms_length(log.task_error[:, layout.angular_rows]),
        tasks=_errors_per_task(log, layout),
        smallest_distance=distance,
        smallest_distance_pair=distance_pair,
        smallest_distance_time=distance_time,
        violated_samples=int(np.count_nonzero(violations)),
        mean_violations=float(violations.mean()),
        penetrating_samples=int(penetrating.any(axis=1).sum()),
        penetrating_pairs=_counts(log.pair_names.tolist(), penetrating),
        beyond_limit_samples=int(beyond.any(axis=1).sum()),
        joints_beyond_limits=_counts(joints.names, beyond),
        largest_excess=excess,
        largest_excess_joint=excess_joint,
        beyond_speed_samples=int(too_fast.any(axis=1).sum()),
        joints_beyond_speed=_counts(joints.names, too_fast),
        largest_speed_excess=speed_excess,
        largest_speed_excess_joint=speed_joint,
        mean_power=float(joints.power.mean()),
        peak_torque=float(np.abs(joints.torque[torque_sample, torque_joint])),
        peak_torque_joint=joints.names[torque_joint],
        peak_torque_time=float(log.time[torque_sample]),
        rms_acceleration=float(np.sqrt(np.mean(joints.acceleration**2))),
        **_admission(log, scenario.controller.period),
        **_balance(log, scenario.controller.period),
        torque_limited_samples=int(np.count_nonzero(log.torque_limited)),
        torque_clipped_samples=int(np.count_nonzero(log.torque_clipped)),
        braking_samples=int(np.count_nonzero(log.status == STATUS_BRAKING)),
        implausible_samples=int(np.count_nonzero(log.status == STATUS_IMPLAUSIBLE)),
        frame_rate=motion.performer.frame_rate if motion else None,
        frame_rate_source=motion.performer.rate_source if motion else "",
        motion_findings=list(motion.findings) if motion else [],
        warnings=list(warnings),
        wall_time=wall_time,
        real_time_factor=duration / wall_time if wall_time else None,
        sliding_joints=[
            name
            for name, unit in zip(joints.names, joints.units, strict=True)
            if unit == "m"
        ],
        limb_directions=dict(limbs or {}),
        obstacles=dict(obstacles or {}),
        stance=stance,
    )
    # Where balance had its say afterwards, motors alone are not the reason.
    for_balance = _for_balance(log)
    limited = log.torque_limited & ~for_balance
    implausible = log.time[log.status[:, 0] == STATUS_IMPLAUSIBLE]
    found = remarks(
        joints,
        float(limited.mean()),
        summary.limb_directions,
        lowest,
        implausible,
        clipped_line(log),
        float(for_balance.mean()),
    )
    return replace(summary, remarks=found)


def _smallest(values: np.ndarray) -> float | None:
    """The smallest of the finite values, None if there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.min()) if finite.size else None


def _admission(log: SimulationLog, period: float) -> dict[str, int | float | None]:
    """What the summary says of how steps were admitted."""
    steps = log.control_steps(period)
    time, (how, _, clearance, clear) = log.time[steps], log.admission[steps].T
    reported = np.isfinite(how)
    held_back = reported & (how != AS_NOMINAL)
    longest, since = 0.0, None
    # A step lasts until the next; the last one is taken for as long as a period.
    ends = np.append(time[1:], time[-1] + period)
    for start, end, held in zip(time, ends, held_back, strict=True):
        since = (start if since is None else since) if held else None
        if since is not None:
            longest = max(longest, float(end - since))
    return dict(
        admitted_steps=int(np.count_nonzero(reported)),
        corrected_steps=int(np.count_nonzero(how == CORRECTED)),
        scaled_steps=int(np.count_nonzero(how == SCALED)),
        unclear_steps=int(np.count_nonzero(clear == 0.0)),
        path_clearance=_smallest(clearance),
        longest_held_back=longest,
    )


def _for_balance(log: SimulationLog) -> np.ndarray:
    """(T,) whether balance changed the step, by correction or scaling."""
    how = log.balance[:, 0]
    return np.isfinite(how) & (how != AS_NOMINAL)


def _balance(log: SimulationLog, period: float) -> dict[str, int | float | None]:
    """What the summary says of balance."""
    steps = log.control_steps(period)
    return dict(
        balanced_steps=int(np.count_nonzero(np.isfinite(log.balance[steps, 0]))),
        changed_for_balance=int(np.count_nonzero(_for_balance(log)[steps])),
        smallest_balance=_smallest(log.balance[steps, 2]),
    )


def _errors_per_task(log: SimulationLog, layout: TaskLayout) -> dict[str, TaskErrors]:
    linear = dict(zip(layout.linear_tasks, layout.linear_rows, strict=True))
    angular = dict(zip(layout.angular_tasks, layout.angular_rows, strict=True))

    def rms(rows: dict, task: int) -> float | None:
        return _rms_length(log.task_error[:, rows[task]]) if task in rows else None

    return {
        name: TaskErrors(layout.kinds[i], rms(linear, i), rms(angular, i))
        for i, name in enumerate(layout.names)
    }


def _rms_length(vectors: np.ndarray) -> float | None:
    """Root of the mean of |x|^2 over vectors (..., 3); None if there are none. NaN
    vectors, of samples without targets, do not count."""
    squares = np.sum(vectors**2, axis=-1)
    squares = squares[np.isfinite(squares)]
    return float(np.sqrt(np.mean(squares))) if squares.size else None


def _argmax(values: np.ndarray) -> tuple[int, int]:
    """Row and column of the largest of (T, N) values."""
    row, column = np.unravel_index(np.argmax(values), values.shape)
    return int(row), int(column)


def _counts(names, violated: np.ndarray) -> dict[str, int]:
    """Name to its number of samples, where that is not zero."""
    counts = violated.sum(axis=0).tolist()
    return {name: n for name, n in zip(names, counts, strict=True) if n}


def _finite(value):
    """Replaces what JSON has no number for by None."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
