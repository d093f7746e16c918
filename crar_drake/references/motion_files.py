"""Reads and writes files of robots' motions, whatever their layout."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError, nearest
from crar_drake.motion.robots_own import SUFFIXES
from crar_drake.motion.text_files import refuse_pointer
from crar_drake.references.certificate_files import certificate_beside, robot_files
from crar_drake.references.contacts import (
    labels_beside,
    read_beside,
    remove_beside,
    write_beside,
)
from crar_drake.references.evidence import settled
from crar_drake.references.layout_reader import Reading, readings
from crar_drake.references.layout_writer import write_layout
from crar_drake.references.layouts import (
    LAYOUTS,
    Layout,
    layout_named,
    usual_suffix,
)
from crar_drake.references.robot_match import matched, reordered
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody

# An angle beyond this is none of a joint in radians [rad].
_DEGREES = 2.0 * np.pi + 0.5

# Nor does a robot climb so high [m].
_CENTIMETRES = 10.0


def read_motion(
    path: str | os.PathLike[str],
    layout: str | None = None,
    rate: float | None = None,
    joint_names: Sequence[str] | None = None,
    clip: str | None = None,
    robot: WholeBody | None = None,
) -> RobotMotion:
    """Reads the one motion of a file.

    Args:
        path: of the file.
        layout: its name (`layouts.LAYOUTS`); by default what the certificate beside
            the file says of it, else what it looks like.
        rate: samples per second [Hz]; by default what the file says, or its
            certificate, else the usual one of its layout, which is reported among the
            guesses.
        joint_names: (n,) names of its joints in its order, where the file has none.
        clip: which motion, where the file holds several.
        robot: that it is a motion of. With it the joints are checked, put into the
            robot's order (`WholeBody.joint_names`) and named.

    Raises:
        MotionError: the file is not there, damaged or of no known layout, is of
            another robot, or holds several motions and none was named; the message
            names the file.
    """
    motions = read_motions(path, layout, rate, joint_names, robot)
    if clip is not None:
        for motion in motions:
            if motion.clip == clip:
                return motion
        known = [motion.clip for motion in motions]
        raise MotionError(f"{path}: there is no clip {clip!r}{nearest(clip, known)}")
    if len(motions) > 1:
        names = ", ".join(motion.clip for motion in motions[:5])
        raise MotionError(
            f"{path}: holds {len(motions)} motions; name one of them ({names}"
            + (", ...)" if len(motions) > 5 else ")")
        )
    return motions[0]


def read_motions(
    path: str | os.PathLike[str],
    layout: str | None = None,
    rate: float | None = None,
    joint_names: Sequence[str] | None = None,
    robot: WholeBody | None = None,
) -> tuple[RobotMotion, ...]:
    """Reads all motions of a file, at least one; see `read_motion`."""
    same_robot = False
    if (told := certificate_beside(path)) is not None:
        of_file = told["motion"]
        layout = layout or of_file["layout"]
        rate = of_file["rate"] if rate is None else rate
        if robot is not None:
            same_robot = told["robot"]["files"] == robot_files(robot.description)
        if same_robot and layout == of_file["layout"]:
            joint_names = joint_names or _layouts_order(LAYOUTS[layout], robot)
    motions = []
    for possible in _read_file(Path(path), layout, rate, joint_names):
        motion = settled(possible, robot, trusted=same_robot)
        motions.append(_with_doubted_units(motion) if robot is None else motion)
    if len(motions) == 1 and not LAYOUTS[motions[0].layout].has_room:
        (motion,) = motions
        labels = read_beside(Path(path), motion.num_frames)
        motions = [replace(motion, extras={**motion.extras, **labels})]
    return tuple(motions)


def write_motions(
    path: str | os.PathLike[str],
    motions: Sequence[RobotMotion],
    layout: str,
    robot: WholeBody | None = None,
) -> None:
    """Writes a motion, or several if the layout can, whole or not at all.

    Args:
        path: of the file.
        motions: to be written. What they have in `extras` is written if the layout is
            the one that they were read from; labels of contacts are in all
            (`contacts`).
        layout: its name.
        robot: that moves; needed where a layout has what follows from the robot
            (poses of bodies), unless the motion is as it was read.

    Raises:
        MotionError: the layout needs a robot and there is none, the robot has other
            joints, or the layout has room for one motion.
        WriteError: the file cannot be written.
    """
    to = layout_named(layout)
    if not motions:
        raise MotionError(f"{path}: there is no motion to write")
    if len(motions) > 1 and not to.several:
        raise MotionError(
            f"{path}: {layout} holds one motion, and there are {len(motions)}; choose "
            "one (--clip), or motion-lib-pkl"
        )
    ordered = [_in_layouts_order(motion, to, robot) for motion in motions]
    write_layout(Path(path), ordered, to, robot)
    if labels_beside(motions, to):
        write_beside(Path(path), motions[0])
    else:
        remove_beside(Path(path))


def _with_doubted_units(motion: RobotMotion) -> RobotMotion:
    """The motion, with a guess where its numbers are hardly radians or metres."""
    doubts = []
    turned = np.abs(motion.joint_positions).max(initial=0.0)
    if turned > _DEGREES:
        doubts.append(f"a joint is at {turned:.1f} rad: are these degrees?")
    high = np.abs(motion.root_positions[:, 2]).max(initial=0.0)
    if high > _CENTIMETRES:
        doubts.append(f"the root is at {high:.0f} m: are these centimetres or mm?")
    doubts = [f"units as the layout has them, but {doubt}" for doubt in doubts]
    return replace(motion, guesses=(*motion.guesses, *doubts))


def _read_file(
    path: Path,
    layout: str | None,
    rate: float | None,
    joint_names: Sequence[str] | None,
) -> list[list[Reading]]:
    if path.is_dir():
        raise MotionError(f"{path}: this is a folder; name a file")
    if not path.is_file():
        raise MotionError(f"{path}: there is no such file")
    if path.stat().st_size == 0:
        raise MotionError(f"{path}: the file is empty")
    refuse_pointer(path)
    suffix = usual_suffix(path) if layout is None else layout_named(layout).suffix
    if suffix not in SUFFIXES.values():
        raise MotionError(
            f"{path}: {path.suffix or 'no suffix'} is of no layout that is read; robot "
            f"motions are {', '.join(sorted(set(SUFFIXES.values())))} files (of a "
            "person's motion `crar-drake retarget` makes one)"
        )
    return readings(path, suffix, layout, rate, joint_names)


def _in_layouts_order(
    motion: RobotMotion, to: Layout, robot: WholeBody | None
) -> RobotMotion:
    """The motion with its joints as the layout has them."""
    if robot is None:
        here = LAYOUTS.get(motion.layout)
        if here is not None and here.breadth_first != to.breadth_first:
            raise MotionError(
                f"{motion.source}: joints are in another order in {to.name} than in "
                f"{here.name}: say which robot it is (--robot)"
            )
        return motion
    named = matched(motion, robot) if motion.joint_names == () else motion
    return reordered(named, _layouts_order(to, robot))


def _layouts_order(layout: Layout, robot: WholeBody) -> tuple[str, ...]:
    return robot.breadth_first if layout.breadth_first else robot.joint_names
