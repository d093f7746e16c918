"""What is bad about a run, though it may violate nothing.

Every threshold stands here, with its reason. What penetrates, or is beyond a limit, is
a violation, and no matter of a threshold: the figures have it.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from crar_drake.errors import few
from crar_drake.results.controlled_joints import ControlledJoints
from crar_drake.results.limb_directions import LimbDirection
from crar_drake.results.log import SimulationLog
from crar_drake.robot.description import FLOOR_TOLERANCE

# No motor of a joint of a robot of human size gives more [Nm]: the strongest ones
# there are, hydraulic hips and knees, give about that.
MOST_TORQUE = 1000.0

# More than its own limit no motor gives. A run that respects limits is at them to
# rounding.
MOST_EFFORT = 1.01

# A robot the motors of which hold it back for a tenth of the time does not follow.
MOST_LIMITED = 0.1

# A joint so near its limit is at it: the lookahead keeps joints no farther away. For a
# tenth of the time that is a posture that the robot cannot take, or a wrong branch.
AT_LIMIT = 0.01  # [rad]
MOST_AT_LIMIT = 0.1

# A direction within 30 degrees is read as the same gesture. Beyond a right angle the
# limb points away from where the performer's does.
MOST_MEDIAN_ANGLE = np.pi / 6.0
MOST_ANGLE = np.pi / 2.0

# Who is farther from a target than this all the time does not follow it.
_FAR = 0.1  # [m]
_TURNED = 0.5  # [rad]
_LEAST_TIME = 1.0  # [s] that is looked at, at least

# A torque of this share of its limit is at it [1]; so many motors are named.
_MOTOR_AT_LIMIT = 0.999
_MOST_MOTORS = 2


def remarks(
    joints: ControlledJoints,
    torque_limited: float,
    limb_directions: Mapping[str, LimbDirection],
    lowest: tuple[float, str, float] | None = None,
    implausible: Sequence[float] = (),
    clipped: str = "",
    for_balance: float = 0.0,
) -> list[str]:
    """A line for each thing that is bad about a run; most often none.

    Args:
        torque_limited: share of the samples in which torque limits alone hold it back.
        lowest: height over the floor [m], link and time [s] of what was lowest; None
            of a robot that does not stand on a floor.
        implausible: times of samples with a measured state that no robot has [s].
        clipped: `clipped_line`.
        for_balance: share of the samples that balance changed.
    """
    return [
        *_of_implausible_states(implausible),
        *([clipped] if clipped else []),
        *_of_torque(joints),
        *_held_back(
            torque_limited,
            "torque limits hold",
            "it is too weak for this motion at this speed, or "
            "controller.braking_time too short",
        ),
        *_held_back(
            for_balance,
            "balance holds",
            "on its feet it cannot follow this motion at this speed",
        ),
        *_of_joints_at_limits(joints),
        *_of_the_floor(lowest),
        *_of_limbs(limb_directions),
    ]


def lasting_error_warnings(log: SimulationLog, start: float) -> list[str]:
    """One line for each task whose error never falls below what following is.

    Args:
        start: what is before is left out: the targets are blended in [s].
    """
    rows = (log.time >= log.time[0] + start) & np.isfinite(log.task_error).all(axis=1)
    times = log.time[rows]
    if not len(times) or times[-1] - times[0] < _LEAST_TIME:
        return []
    layout, errors = log.layout, log.task_error[rows]
    kinds = (
        (layout.linear_tasks, layout.linear_rows, _FAR, 1e3, "mm"),
        (layout.angular_tasks, layout.angular_rows, _TURNED, 180.0 / np.pi, "deg"),
    )
    found = []
    for tasks, columns, most, scale, unit in kinds:
        for task, of_task in zip(tasks, columns, strict=True):
            least = float(np.linalg.norm(errors[:, of_task], axis=1).min())
            if least > most:
                found.append(
                    f"{layout.names[task]} is never nearer to its target than "
                    f"{scale * least:.0f} {unit}: it may be the wrong point of the "
                    "robot, or the target is out of its reach"
                )
    return found


def clipped_line(log: SimulationLog) -> str:
    """Says in how many samples of a log torques were clipped, since when, and of which
    motors; "" if none was.

    The theorem of `docs/theory/theorem.md` assumes that the plant does what is
    commanded. Where not even braking is within the effort limits, torques are clipped,
    and it does not.
    """
    clipped = log.torque_clipped
    if not clipped.any():
        return ""
    at_limit = np.abs(log.actuation[clipped]) >= _MOTOR_AT_LIMIT * log.effort_limits
    often = at_limit.sum(axis=0)
    motors = [
        f"{log.actuator_names[i]} ({log.effort_limits[i]:g})"
        for i in np.argsort(-often, kind="stable")
        if often[i]
    ]
    of = f" of {few(motors, _MOST_MOTORS)}" if motors else ""
    return (
        f"torques were clipped in {np.count_nonzero(clipped)} samples, the first at "
        f"{log.time[clipped][0]:.3f} s: not even braking was within the effort limits"
        f"{of}. The robot did not do there what was commanded, and from then on "
        "nothing is proved of it; are these the limits of the real motors, and has it "
        "springs that the model has not?"
    )


def _of_implausible_states(times: Sequence[float]) -> list[str]:
    if not len(times):
        return []
    return [
        f"{len(times)} samples with a measured state that no robot has, the first at "
        f"{times[0]:.3f} s: the robot braked; check sensors, units and the order of "
        "joints"
    ]


def _of_torque(joints: ControlledJoints) -> list[str]:
    found = []
    for i in np.argsort(-np.abs(joints.torque).max(axis=0), kind="stable"):
        peak, limit = np.abs(joints.torque[:, i]).max(), joints.effort_limits[i]
        unit = "N" if joints.units[i] == "m" else "Nm"
        if np.isfinite(limit):
            if peak > MOST_EFFORT * limit:
                found.append(
                    f"peak torque of {joints.names[i]} {peak:.0f} {unit}, where its "
                    f"motor gives {limit:.0f}"
                )
        elif joints.units[i] == "rad" and peak > MOST_TORQUE:
            found.append(
                f"peak torque of {joints.names[i]} {peak:.0f} Nm; no motor of a "
                f"robot's joint gives more than {MOST_TORQUE:.0f}"
            )
    return _first(found)


def _held_back(share: float, what: str, why: str) -> list[str]:
    if share <= MOST_LIMITED:
        return []
    return [f"{what} the robot back in {100 * share:.0f} % of the samples: {why}"]


def _of_joints_at_limits(joints: ControlledJoints) -> list[str]:
    turning = np.array([unit == "rad" for unit in joints.units], dtype=bool)
    # What can hardly move is always there.
    turning &= joints.upper - joints.lower > 4.0 * AT_LIMIT
    shares = ((joints.excess > -AT_LIMIT) & turning).mean(axis=0)
    return _first(
        [
            f"{joints.names[i]} is at its limit for {100 * shares[i]:.0f} % of the time"
            for i in np.argsort(-shares, kind="stable")
            if shares[i] > MOST_AT_LIMIT
        ]
    )


def _of_the_floor(lowest: tuple[float, str, float] | None) -> list[str]:
    if lowest is None or not lowest[0] < -FLOOR_TOLERANCE:
        return []
    depth, link, time = lowest
    return [
        f"{-1e3 * depth:.0f} mm BELOW THE FLOOR: {link} at {time:.2f} s, and no "
        "distance or limit tells of it; crar-drake retarget makes feet that stand"
    ]


def _of_limbs(limb_directions: Mapping[str, LimbDirection]) -> list[str]:
    found = []
    for name, angle in limb_directions.items():
        near = angle.median <= MOST_MEDIAN_ANGLE and angle.most <= MOST_ANGLE
        if angle.followed and not near:
            found.append(
                f"{name.replace('_', ' ')} points {np.degrees(angle.median):.0f}° away "
                "from where the person's does, in the median; for 5 % of the time "
                f"{np.degrees(angle.most):.0f}° or more"
            )
    return _first(found)


def _first(found: list[str]) -> list[str]:
    """The first two, and how many more there are."""
    if len(found) <= 2:
        return found
    return [found[0], f"{found[1]}; and {len(found) - 2} more so"]
