"""What is in a motion file, and what in it looks bad."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from crar_drake.errors import MotionError
from crar_drake.figures import save_figure
from crar_drake.motion.asf_amc import BonePoses, Clip, forward_kinematics
from crar_drake.motion.joint_centres import JointCentres, joint_centres, robot_frame

# A bone turns by more than this against its parent in one frame: a flip. In the CMU
# files the fastest limbs of dances and karate turn by 20 to 50 degrees in 1/120 s
# and flips by 60 to 180. At lower rates honest motion turns further in one frame.
_FLIP_ANGLE = 60.0  # at 120 Hz and above [deg]
_FLIP_ANGLE_CAP = 120.0  # [deg]
_FLIP_RATE = 120.0  # [Hz]

# One step differs by more than this speed from both its neighbours: a jump. That is
# 25 mm in 1/120 s; the waist of honest CMU clips stays below 2 m/s.
_JUMP_SPEED = 3.0  # [m/s]

# All values equal for longer than this: a gap somebody filled by holding.
_FROZEN_TIME = 0.05  # [s]


@dataclass(frozen=True)
class Flip:
    """A bone's rotation about its parent jumps from one frame to the next."""

    bone: str
    frame: int  # number in the file of the frame after the jump
    angle: float  # [rad]


@dataclass(frozen=True)
class Jump:
    """A joint centre leaps for one frame."""

    point: str
    frame: int  # number in the file of the frame after the leap
    distance: float  # by which the step departs from the steps beside it [m]


@dataclass(frozen=True)
class FrozenStretch:
    """Frames first..last hold the very same values."""

    first: int  # number in the file
    last: int  # number in the file


@dataclass(frozen=True)
class MotionReport:
    """What a motion file holds.

    Attributes:
        name: the motion's name.
        frames: number of frames.
        frame_rate: samples per second [Hz].
        duration: from the first to the last frame [s].
        bones: the skeleton's number of bones.
        peak_speeds: joint centre to its largest speed in the raw data [m/s]; empty
            if the skeleton has no joint centres.
        flips: jumps of a bone's rotation, in frame order.
        jumps: jumps of joint centres (at least of the root), in frame order.
        frozen: stretches of identical frames.
        obstacle: why the motion cannot drive a robot, or "".
    """

    name: str
    frames: int
    frame_rate: float  # [Hz]
    duration: float  # [s]
    bones: int
    peak_speeds: dict[str, float]  # [m/s]
    flips: tuple[Flip, ...] = ()
    jumps: tuple[Jump, ...] = ()
    frozen: tuple[FrozenStretch, ...] = ()
    obstacle: str = ""

    @property
    def looks_clean(self) -> bool:
        """Whether nothing in the file looks bad."""
        return not (self.flips or self.jumps or self.frozen or self.obstacle)


def inspect(clip: Clip) -> MotionReport:
    """Returns a report of the clip. Nothing that it finds is an error."""
    poses = forward_kinematics(clip)
    obstacle = ""
    try:
        points = joint_centres(clip).positions
    except MotionError as error:
        points, obstacle = {}, str(error)
    steps = {name: _steps(samples) for name, samples in points.items()}
    watched = points or {"waist": robot_frame(poses.start["root"])}
    return MotionReport(
        name=clip.name,
        frames=clip.num_frames,
        frame_rate=clip.frame_rate,
        duration=clip.duration,
        bones=len(clip.skeleton.bones),
        peak_speeds={
            name: float(step.max() * clip.frame_rate) for name, step in steps.items()
        },
        flips=_find_flips(clip, poses),
        jumps=_find_jumps(watched, clip.frame_rate),
        frozen=_find_frozen(clip),
        obstacle=obstacle,
    )


def _steps(samples: np.ndarray) -> np.ndarray:
    """Returns the (T - 1,) distances from each sample to the next."""
    return np.linalg.norm(np.diff(samples, axis=0), axis=1)


def _find_flips(clip: Clip, poses: BonePoses) -> tuple[Flip, ...]:
    """Compares rotations, not angles: 359 degrees beside -1 degree is no flip."""
    threshold = np.radians(
        np.clip(
            _FLIP_ANGLE * _FLIP_RATE / clip.frame_rate, _FLIP_ANGLE, _FLIP_ANGLE_CAP
        )
    )
    flips = []
    for name, R_WB in poses.rotation.items():
        R_PB = R_WB
        if name != "root":
            R_WP = poses.rotation[clip.skeleton.bones[name].parent]
            R_PB = np.swapaxes(R_WP, 1, 2) @ R_WB
        # trace(RᵀS) is the sum of the products of the elements.
        trace = np.einsum("tij,tij->t", R_PB[:-1], R_PB[1:])
        angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
        for step in np.flatnonzero(angle > threshold):
            flips.append(Flip(name, int(step) + 2, float(angle[step])))
    return tuple(sorted(flips, key=lambda flip: (flip.frame, flip.bone)))


def _find_jumps(points: dict[str, np.ndarray], frame_rate: float) -> tuple[Jump, ...]:
    jumps = []
    for name, samples in points.items():
        step = np.diff(samples, axis=0)
        if len(step) < 3:
            continue
        index = np.arange(len(step))
        # The first and the last step are compared with the two beside them.
        before = np.where(index > 0, index - 1, 2)
        after = np.where(index < len(step) - 1, index + 1, len(step) - 3)
        excess = frame_rate * np.minimum(
            np.linalg.norm(step - step[before], axis=1),
            np.linalg.norm(step - step[after], axis=1),
        )
        for step_index in np.flatnonzero(excess > _JUMP_SPEED):
            distance = float(excess[step_index] / frame_rate)
            jumps.append(Jump(name, int(step_index) + 2, distance))
    return tuple(sorted(jumps, key=lambda jump: (jump.frame, jump.point)))


def _find_frozen(clip: Clip) -> tuple[FrozenStretch, ...]:
    values = np.hstack([clip.root_position, clip.root_rotation, *clip.joints.values()])
    same = np.all(values[1:] == values[:-1], axis=1)
    # Edges of the runs of True.
    edges = np.diff(np.concatenate([[0], same.astype(int), [0]]))
    stretches = []
    for begin, end in zip(
        np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True
    ):
        if (end - begin) / clip.frame_rate > _FROZEN_TIME:
            stretches.append(FrozenStretch(int(begin) + 1, int(end) + 1))
    return tuple(stretches)


def describe(report: MotionReport) -> Iterator[str]:
    """Yields the report as lines for a person to read."""

    def at(frame: int) -> str:
        return f"frame {frame} ({(frame - 1) / report.frame_rate:.2f} s)"

    yield (
        f"{report.name}: {report.frames} frames at {report.frame_rate:g} Hz, "
        f"{report.duration:.2f} s, {report.bones} bones"
    )
    if report.peak_speeds:
        yield "largest speeds: " + ", ".join(
            f"{name} {speed:.1f} m/s" for name, speed in report.peak_speeds.items()
        )
    for bone in dict.fromkeys(flip.bone for flip in report.flips):
        flips = [flip for flip in report.flips if flip.bone == bone]
        worst = max(flips, key=lambda flip: flip.angle)
        yield (
            f"{bone} flips {_times(len(flips))}, first in {at(flips[0].frame)}, by up "
            f"to {np.degrees(worst.angle):.0f} degrees in {at(worst.frame)}"
        )
    for point in dict.fromkeys(jump.point for jump in report.jumps):
        jumps = [jump for jump in report.jumps if jump.point == point]
        worst = max(jumps, key=lambda jump: jump.distance)
        yield (
            f"{point} jumps {_times(len(jumps))}, first in {at(jumps[0].frame)}, by up "
            f"to {100.0 * worst.distance:.0f} cm in {at(worst.frame)}"
        )
    for stretch in report.frozen:
        yield f"nothing moves from {at(stretch.first)} to {at(stretch.last)}"
    if report.obstacle:
        yield f"no robot can follow it: {report.obstacle}"
    if report.looks_clean:
        yield "nothing looks bad"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def plot_motion(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Draws heights, paths and speeds of the joint centres on one page.

    Frames with a flip or a jump are marked by vertical lines.

    Args:
        clip: the motion.
        path: the figure's file; its suffix (.png, .pdf, .svg) chooses the format.

    Raises:
        MotionError: the clip has no joint centres.
        CrarError: there is no such format, or the file cannot be written.
    """
    centres = joint_centres(clip)
    report = inspect(clip)
    figure = Figure(figsize=(8.3, 11.7), layout="constrained")
    heights, paths, speeds = figure.subplots(3, 1, height_ratios=[1.0, 1.4, 1.0])
    figure.suptitle(next(describe(report)))
    _draw_points(centres, heights, paths, speeds)
    flip_frames = sorted({flip.frame for flip in report.flips})
    jump_frames = sorted({jump.frame for jump in report.jumps})
    for axes in (heights, speeds):
        for frames, colour, label in (
            (flip_frames, "tab:red", "flip"),
            (jump_frames, "tab:orange", "jump"),
        ):
            for index, frame in enumerate(frames):
                axes.axvline(
                    (frame - 1) / clip.frame_rate,
                    color=colour,
                    linewidth=0.6,
                    alpha=0.6,
                    zorder=0,
                    label=label if index == 0 else None,
                )
        axes.set_xlabel("time [s]")
        axes.margins(x=0.0)
    heights.set_ylabel("height [m]")
    heights.legend(ncols=5, fontsize="x-small")
    speeds.set_ylabel("speed [m/s]")
    paths.set_xlabel("y, to the left [m]")
    paths.set_ylabel("x, forward [m]")
    paths.set_title("from above", fontsize="small")
    paths.set_aspect("equal", adjustable="datalim")
    paths.invert_xaxis()  # the left is on the left
    save_figure(figure, path)


def _draw_points(centres: JointCentres, heights, paths, speeds) -> None:
    colours = {"waist": "black", "neck": "tab:gray", "shoulder": "tab:purple"}
    colours |= {"elbow": "tab:green", "wrist": "tab:blue"}
    for name, p_WC in centres.positions.items():
        style = {
            "color": colours[name.rpartition("_")[2]],
            "linestyle": "--" if name.startswith("right") else "-",
            "linewidth": 0.9,
            "label": name.replace("_", " "),
        }
        heights.plot(centres.time, p_WC[:, 2], **style)
        paths.plot(p_WC[:, 1], p_WC[:, 0], **style)
        speeds.plot(centres.time[1:], _steps(p_WC) * centres.frame_rate, **style)
