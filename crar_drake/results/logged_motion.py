"""The motion of a run as a reference motion: a file of any layout, its lowest point."""

import os
from dataclasses import replace

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.references.ground_contact import Outline
from crar_drake.references.layouts import LAYOUTS, layout_named
from crar_drake.references.motion_files import write_motion
from crar_drake.references.resampling import resampled
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import check_logged_robot

_MOST_RATE = 100.0  # [Hz] of samples that are looked at for the lowest point

# Samples of a log are evenly spaced but for this share of their period.
_UNEVEN = 1e-3


def motion_of_log(log: SimulationLog, robot: WholeBody) -> RobotMotion:
    """The root's poses and all joints of the simulated robot, sample by sample.

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
    positions, quaternions, joints = robot.of_configurations(log.q)
    return RobotMotion(
        joint_names=robot.joint_names,
        root_positions=positions,
        root_quaternions=quaternions,
        joint_positions=joints,
        # The period is a decimal number of milliseconds or so; its inverse need not be.
        rate=float(np.round(1.0 / period, 6)),
    )


def export_target(text: str) -> tuple[str, str]:
    """Layout and file of an option LAYOUT[:FILE]; the file is "" where it is not said.

    Raises:
        MotionError: there is no such layout, or the file has another suffix than it.
    """
    name, _, file = text.partition(":")
    layout = layout_named(name)
    if file and not file.lower().endswith(layout.suffix):
        raise MotionError(
            f"{file}: {name} is a {layout.suffix} file; name it so (layouts: "
            f"{', '.join(LAYOUTS)})"
        )
    return name, file


def export_log(
    log: SimulationLog,
    robot: WholeBody,
    path: str | os.PathLike[str],
    layout: str,
    rate: float | None = None,
    start: float = 0.0,
) -> RobotMotion:
    """Writes the motion of a log into a file, whole or not at all, and returns it.

    Args:
        layout: its name.
        rate: samples per second, along splines [Hz]; by default the log's.
        start: what is before is left out, such as blending in, unless it is all [s].

    Raises:
        MotionError: the log is no reference motion, or the layout cannot hold it.
        WriteError: the file cannot be written.
    """
    motion = motion_of_log(log, robot)
    first = int(np.searchsorted(log.time, start - 1e-9))
    if first < motion.num_frames - 1:
        motion = motion.frames(slice(first, None))
    if rate is not None:
        motion, _ = resampled(motion, rate)
    write_motion(path, motion, layout, robot)
    return motion


def lowest_point(
    log: SimulationLog, robot: WholeBody, start: float = 0.0
) -> tuple[float, str, float]:
    """Height over the floor z = 0 [m], link and time [s] of what was lowest in a run.

    Args:
        log: of a robot the root of which a motion moves.
        start: what is before is left out, such as blending in [s].

    Raises:
        MotionError, CrarError: as of `motion_of_log`.
    """
    motion = motion_of_log(log, robot)
    first = int(np.searchsorted(log.time, start - 1e-9))
    first = min(first, motion.num_frames - 2)
    every = max(1, int(np.ceil(motion.rate / _MOST_RATE - 1e-9)))
    rows = slice(first, None, every)
    seen = replace(motion.frames(rows), rate=motion.rate / every)
    contact = Outline(robot).ground_contact(seen, floor=0.0)
    low = int(contact.lowest.argmin())
    time = float(log.time[rows][low])
    return float(contact.lowest[low]), contact.lowest_links[low], time
