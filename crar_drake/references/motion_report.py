"""What is in a robot's motion, in words and as a picture."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from crar_drake.errors import few
from crar_drake.figures import save_figure
from crar_drake.references.layouts import LAYOUTS
from crar_drake.references.reference_judge import beyond, frames_of, limit_excess
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.smoothness import (
    find_jumps,
    joint_jerks,
    joint_label,
    rms,
    step_speeds,
)
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import LIMIT_TOLERANCE, SPEED_TOLERANCE

# Things that are reported one by one.
_MOST = 5


def describe_motion(
    motion: RobotMotion, robot: WholeBody | None = None
) -> Iterator[str]:
    """Yields lines for a person to read.

    Args:
        motion: with the robot's names, if there is a robot.
        robot: whose limits count.
    """
    layout = LAYOUTS.get(motion.layout)
    clip = f", clip {motion.clip}" if motion.clip else ""
    yield (
        f"{motion.source}{clip}: {motion.num_frames} frames at {motion.rate:g} Hz, "
        f"{motion.duration:.2f} s, {motion.num_joints} joints"
    )
    if layout is not None:
        precision = f", {motion.precision}" if motion.precision else ""
        yield f"layout {layout.name} ({layout.used_by}){precision}"
    for guess in motion.guesses:
        yield f"guessed: {guess}"
    if not motion.joint_names:
        yield "joints have no names; --robot ROBOT tells whose they are"
    if motion.extras:
        yield f"besides: {', '.join(motion.extras)}"
    yield from _root_lines(motion)
    yield from _joint_lines(motion)
    if robot is not None:
        yield from _limit_lines(motion, robot)
    jumps = find_jumps(motion)
    for jump in jumps[:_MOST]:
        yield (
            f"{jump.what} jumps by {jump.size:.3g} {jump.unit} to frame "
            f"{jump.frame + 1} ({jump.frame / motion.rate:.2f} s)"
        )
    if len(jumps) > _MOST:
        yield f"and {len(jumps) - _MOST} more jumps"
    if not jumps:
        yield "nothing jumps"


def _root_lines(motion: RobotMotion) -> Iterator[str]:
    p = motion.root_positions
    up = motion.root_rotations.apply([0.0, 0.0, 1.0])[:, 2]
    tilt = np.degrees(np.arccos(np.clip(up, -1.0, 1.0)))
    way = np.linalg.norm(np.diff(p[:, :2], axis=0), axis=1).sum()
    yield (
        f"root: height {p[:, 2].min():.3f} to {p[:, 2].max():.3f} m, tilted by up to "
        f"{tilt.max():.0f} degrees, {way:.2f} m of way"
    )


def _joint_lines(motion: RobotMotion) -> Iterator[str]:
    q = motion.joint_positions
    if not q.size:
        return
    column = int(np.abs(q).max(axis=0).argmax())
    text = (
        f"joints: {q.min():.3f} to {q.max():.3f} rad, farthest "
        f"{joint_label(motion, column)}"
    )
    speeds = np.abs(step_speeds(motion))
    if len(speeds):
        frame, fastest = np.unravel_index(speeds.argmax(), speeds.shape)
        text += (
            f"; fastest {joint_label(motion, int(fastest))}, {speeds.max():.2f} rad/s "
            f"at {frame / motion.rate:.2f} s"
        )
    jerks = joint_jerks(motion)
    if len(jerks):
        text += f"; rms jerk {rms(jerks):.0f} rad/s³"
    yield text


def _limit_lines(motion: RobotMotion, robot: WholeBody) -> Iterator[str]:
    over, fast = limit_excess(motion, robot)
    for what, excess, tolerance, unit in (
        ("its limits", over, LIMIT_TOLERANCE, "rad"),
        ("its speed limit", fast, SPEED_TOLERANCE, "rad/s"),
    ):
        joints = beyond(robot.joint_names, excess, tolerance)
        if not joints:
            yield f"no joint is beyond {what}"
            continue
        reported = [f"{each.joint} by {each.excess:.3g} {unit}" for each in joints]
        some = few(reported, _MOST)
        yield f"beyond {what} in {len(frames_of(joints))} frames: {some}"


def plot_robot_motion(motion: RobotMotion, path: str | os.PathLike[str]) -> None:
    """Draws the root's position and tilt, the joints, and their speeds, over time.

    Args:
        motion: to be drawn.
        path: the figure's file; its suffix (.png, .pdf, .svg) chooses the format.

    Raises:
        CrarError: there is no such format, or the file cannot be written.
    """
    figure = Figure(figsize=(8.3, 11.7), layout="constrained")
    root, joints, speeds = figure.subplots(3, 1, sharex=True)
    figure.suptitle(next(describe_motion(motion)), fontsize="small", wrap=True)
    for name, values in zip("xyz", motion.root_positions.T, strict=True):
        root.plot(motion.times, values, label=name)
    root.set_ylabel("root [m]")
    root.legend(ncols=3, fontsize="x-small")
    joints.plot(motion.times, motion.joint_positions, linewidth=0.7)
    joints.set_ylabel("joints [rad]")
    speeds.plot(motion.times[1:], step_speeds(motion), linewidth=0.7)
    speeds.set_ylabel("speeds [rad/s]")
    speeds.set_xlabel("time [s]")
    for jump in find_jumps(motion):
        for axes in (root, joints, speeds):
            axes.axvline(jump.frame / motion.rate, color="tab:red", linewidth=0.6)
    save_figure(figure, path)
