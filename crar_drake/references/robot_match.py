"""Whether a motion is one of a robot: its joints by name, by count, by its links."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.references.layouts import LAYOUTS, reordered
from crar_drake.references.robot_motion import (
    ORDER_UNKNOWN,
    UNKNOWN_ORDER,
    RobotMotion,
)
from crar_drake.references.whole_body import WholeBody

# Links may be off by this where a motion says where they are: models of one robot have
# versions. Beyond, it is another robot, or joints in another order [m].
_SAME_LINK = 0.03

# Turns of joints are the same to this; files have seven digits [rad].
_SAME_TURN = 1e-4

# Layouts that differ by the order of the joints alone: depth first, breadth first, and
# one of these.
_KNOWN_BY_LINKS = ("mjlab-npz", "beyondmimic-npz", UNKNOWN_ORDER)

# What a reader says of the order, which counts no more beside what a robot tells.
_ORDER_GUESSES = ("joints are ", ORDER_UNKNOWN)

# Frames that are compared.
_FRAMES = 8


def matched(motion: RobotMotion, robot: WholeBody) -> RobotMotion:
    """The motion with the robot's joint names, in their order.

    Names in the file are taken at their word. Without, the number of joints has to
    be right, and the order is that of the layout; where the file says where the links
    are, that has to fit, and decides between depth first and breadth first. A motion of
    all joints but the wrists has these at 0, where such files lock them.

    Raises:
        MotionError: it is a motion of another robot; the message says what is expected.
    """
    motion = _with_wrists(motion, robot)
    if set(robot.joint_names) < set(motion.joint_names):
        raise MotionError(f"{motion.source}: {_wrong_number(motion, robot)}")
    if motion.joint_names:
        ordered = reordered(motion, robot.joint_names)
        return _links_checked(ordered, robot)
    if motion.num_joints != robot.n:
        raise MotionError(f"{motion.source}: {_wrong_number(motion, robot)}")
    layout = LAYOUTS.get(motion.layout)
    orders = {"depth first": robot.joint_names, "breadth first": robot.breadth_first}
    settled = robot.joint_names == robot.breadth_first
    order = "breadth first" if layout and layout.breadth_first else "depth first"
    how = f"joints have no names: {robot.n} as {robot.description.name}, {order}"
    if "body_pos_w" in motion.computed and robot.joint_names != robot.breadth_first:
        errors = {
            name: _links_off(
                replace(motion, joint_names=names), robot, robot.links_of(names)
            )
            for name, names in orders.items()
        }
        if None not in errors.values():
            order = min(errors, key=errors.get)
            if errors[order] > _SAME_LINK:
                raise MotionError(
                    f"{motion.source}: its links are up to "
                    f"{1e3 * errors[order]:.0f} mm from where those of "
                    f"{robot.description.name} are: it is of another robot"
                )
            other = next(name for name in orders if name != order)
            how = (
                f"joints have no names; {order}, since then links are where the file "
                f"says to {1e3 * errors[order]:.1f} mm ({other}: "
                f"{1e3 * errors[other]:.0f} mm)"
            )
            settled = True
    if motion.layout == UNKNOWN_ORDER and not settled:
        raise motion.untold_order()
    guesses = tuple(
        guess for guess in motion.guesses if not guess.startswith(_ORDER_GUESSES)
    )
    named = replace(motion, joint_names=orders[order], guesses=(*guesses, how))
    if motion.layout in _KNOWN_BY_LINKS:
        named = replace(named, layout=_KNOWN_BY_LINKS[order == "breadth first"])
    named = named.as_read() if motion.is_as_read else named
    return reordered(named, robot.joint_names)


def _with_wrists(motion: RobotMotion, robot: WholeBody) -> RobotMotion:
    """The motion; one that lacks the wrists alone, as the G1's of ASAP and PBHC with 23
    of its 29 joints do, gets them.

    Where the file has the joints' turns (`pose_aa`), they have to be about the axes of
    the robot's other joints.
    """
    layout = LAYOUTS.get(motion.layout)
    order = (
        robot.breadth_first if layout and layout.breadth_first else robot.joint_names
    )
    wrists = tuple(name for name in order if "wrist" in name)
    others = tuple(name for name in order if name not in wrists)
    if not wrists or motion.layout == UNKNOWN_ORDER or motion.num_joints != len(others):
        return motion
    if motion.joint_names and set(motion.joint_names) != set(others):
        return motion
    if not motion.joint_names and "pose_aa" in motion.computed:
        axes = robot.joint_axes[[robot.joint_names.index(name) for name in others]]
        turns = np.asarray(motion.computed["pose_aa"])[:, 1 : 1 + len(others)]
        expected = axes * motion.joint_positions[:, :, None]
        if turns.shape != expected.shape or np.abs(turns - expected).max() > _SAME_TURN:
            return motion
    still = np.zeros((motion.num_frames, len(wrists)))
    said = f"it has {len(others)} joints, which are {robot.description.name}'s without"
    return replace(
        motion,
        joint_names=(*(motion.joint_names or others), *wrists),
        joint_positions=np.hstack([motion.joint_positions, still]),
        guesses=(
            *motion.guesses,
            f"{said} its {len(wrists)} of the wrists: those at 0",
        ),
        computed={},
    )


def _wrong_number(motion: RobotMotion, robot: WholeBody) -> str:
    name, n, has = robot.description.name, robot.n, motion.num_joints
    layout = LAYOUTS.get(motion.layout)
    columns = layout.root_columns if layout else 0
    text = f"{has} joints"
    if columns:
        text = f"{has + columns} columns, {columns} of the root and {has} joints"
    text += f"; robot {name} has {n} joints"
    if n < has:
        text += (
            ". If some of its joints are locked, import the whole robot: "
            "crar-drake import-robot FILE --whole-body --out FOLDER"
        )
    fits = []
    for other in LAYOUTS.values():
        what = {".csv": "columns", ".npz": "columns of joint_pos"}.get(other.suffix)
        fits.append(
            f"{other.name} ({n + other.root_columns} {what or 'columns of its joints'})"
        )
    return f"{text}. A motion of it is {', '.join(fits)}"


def _links_checked(motion: RobotMotion, robot: WholeBody) -> RobotMotion:
    """The motion; of a file with names of links: if they are where the robot has them.

    In an `amp-npz` they may be of another version of the robot, or come late behind the
    joints, as a simulator recorded them: that is reported.

    Raises:
        MotionError: they are elsewhere.
    """
    names = motion.extras.get("body_names")
    if names is None or "body_pos_w" not in motion.computed or not motion.is_as_read:
        return motion
    off = _links_off(motion, robot, tuple(str(name) for name in np.asarray(names)))
    if off is None or off <= _SAME_LINK:
        return motion
    where = (
        f"its links are up to {1e3 * off:.0f} mm from where those of "
        f"{robot.description.name} are"
    )
    if motion.layout != "amp-npz":
        raise MotionError(f"{motion.source}: {where}: it is of another robot")
    doubt = f"{where}: another version of it, or recorded late; the joints count"
    return replace(motion, guesses=(*motion.guesses, doubt))


def _links_off(
    motion: RobotMotion, robot: WholeBody, links: tuple[str, ...]
) -> float | None:
    """How far links are at most from where a file says [m]; None if it cannot be seen.

    Args:
        motion: with names.
        robot: to compare with.
        links: (B) names of the links in the file's order; those that the robot does
            not have are not compared.
    """
    p_WB = np.asarray(motion.computed["body_pos_w"], dtype=float)
    if p_WB.ndim != 3 or p_WB.shape[1] != len(links) or len(p_WB) != motion.num_frames:
        return None
    rows = np.unique(np.linspace(0, motion.num_frames - 1, _FRAMES).astype(int))
    known = [
        i for i, name in enumerate(links) if name != "world" and robot.has_link(name)
    ]
    if len(known) < 2:
        return None
    q = motion.joint_positions[rows][:, robot.columns_in(motion.joint_names)]
    p_RB, _ = robot.poses_in_root(q, tuple(links[i] for i in known))
    R_WR = motion.root_rotations[rows].as_matrix()
    expected = motion.root_positions[rows, None] + np.einsum("tij,tlj->tli", R_WR, p_RB)
    return float(np.linalg.norm(p_WB[rows][:, known] - expected, axis=2).max())
