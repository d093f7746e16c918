"""The motion of a run as a reference motion, and what of it was lowest."""

from dataclasses import replace

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.references.ground_contact import Outline
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import check_logged_robot

_MOST_RATE = 100.0  # [Hz] of samples that are looked at for the lowest point

# Samples of a log are evenly spaced but for this share of their period.
_UNEVEN = 1e-3


def motion_of_log(
    log: SimulationLog, robot: WholeBody, start: float = 0.0
) -> RobotMotion:
    """The root's poses and all joints of the simulated robot, sample by sample.

    Args:
        start: what is before is left out, such as blending in, unless it is all [s].

    Raises:
        MotionError: there are fewer samples, or they are not evenly spaced.
        CrarError: the log is of another robot.
    """
    check_logged_robot(log, robot.plant, robot.description)
    if len(log.time) < 2:
        raise MotionError("the log has fewer than two samples, and so no rate")
    steps = np.diff(log.time)
    period = float(np.median(steps))
    if np.abs(steps - period).max() > _UNEVEN * period:
        raise MotionError(
            f"the log's samples are between {steps.min():g} s and {steps.max():g} s "
            "apart; a reference motion has one rate"
        )
    first = int(np.searchsorted(log.time, start - 1e-9))
    first = first if first < len(log.time) - 1 else 0
    positions, quaternions, joints = robot.of_configurations(log.q[first:])
    return RobotMotion(
        joint_names=robot.joint_names,
        root_positions=positions,
        root_quaternions=quaternions,
        joint_positions=joints,
        # The period is a decimal number of milliseconds or so; its inverse need not be.
        rate=float(np.round(1.0 / period, 6)),
        layout="log",
    )


def lowest_point(
    log: SimulationLog, robot: WholeBody, start: float = 0.0
) -> tuple[float, str, float]:
    """Height over the floor z = 0 [m], link and time [s] of what was lowest in a run.

    Args:
        log: of a robot the root of which a motion moves.
        start: as of `motion_of_log`.

    Raises:
        MotionError, CrarError: as of `motion_of_log`.
    """
    motion = motion_of_log(log, robot, start)
    every = max(1, int(np.ceil(motion.rate / _MOST_RATE - 1e-9)))
    seen = replace(motion.frames(slice(None, None, every)), rate=motion.rate / every)
    contact = Outline(robot).ground_contact(seen, floor=0.0)
    low = int(contact.lowest.argmin())
    time = float(log.time[len(log.time) - motion.num_frames + low * every])
    return float(contact.lowest[low]), contact.lowest_links[low], time
