"""Whether a motion is one of a robot: its joints by name, by number, by evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from crar_drake.errors import MotionError, few
from crar_drake.references.held_values import texts
from crar_drake.references.layout_reader import ORDER_UNKNOWN
from crar_drake.references.layouts import LAYOUTS
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.standing import Standing
from crar_drake.references.whole_body import WholeBody

# Links may be off by this where a motion says where they are: models of one robot have
# versions. Beyond, it is another robot, or joints in another order [m].
_SAME_LINK = 0.03

# Links that a simulator recorded late are no farther off [m].
_LATE = 0.3

# Turns of joints are the same to this; files have seven digits [rad].
_SAME_TURN = 1e-4

# Layouts that differ by the order of the joints alone: depth first, breadth first.
KNOWN_BY_ORDER = ("mjlab-npz", "beyondmimic-npz")

# What a reader says of the order, which counts no more beside what a robot tells.
_ORDER_GUESSES = ("joints are ", ORDER_UNKNOWN)

# How much worse a reading's `Standing.cost` is than that of one which refutes it.
_WORSE = 1.0

# Joints that versions of a robot lock, by what is in their names, and how it is said.
_LOCKED = {
    "its {} of the wrists": ("wrist",),
    "{} of waist and wrists, with one of each": (
        *("waist_roll", "waist_pitch"),
        *("wrist_pitch", "wrist_yaw"),
    ),
}

# Frames whose links are compared.
_FRAMES = 8


@dataclass(frozen=True)
class _Order:
    """Which joints columns without a name may be."""

    names: tuple[str, ...]
    breadth_first: bool
    locked: tuple[str, ...] = ()  # the robot's others, which the motion has at 0
    lacks: str = ""  # those in words

    @property
    def words(self) -> str:
        """What it is."""
        order = "breadth first" if self.breadth_first else "depth first"
        return f"{order}, without {self.lacks}" if self.lacks else order

    def named(self, motion: RobotMotion, guess: str) -> RobotMotion:
        """A motion of these joints, in any order; its others are at 0."""
        names = motion.joint_names or self.names
        known = [g for g in motion.guesses if not g.startswith(_ORDER_GUESSES)]
        named = replace(motion, joint_names=names, guesses=(*known, guess))
        if not self.locked:
            return named.as_read() if motion.is_as_read else named
        still = np.zeros((motion.num_frames, len(self.locked)))
        return replace(
            named,
            joint_names=(*names, *self.locked),
            joint_positions=np.hstack([motion.joint_positions, still]),
            computed={},
        )


def reordered(motion: RobotMotion, joint_names: tuple[str, ...]) -> RobotMotion:
    """The same motion with its joints in another order.

    Args:
        motion: whose joints have names.
        joint_names: the same names.

    Raises:
        MotionError: they are others.
    """
    if joint_names == motion.joint_names:
        return motion
    if set(joint_names) != set(motion.joint_names):
        missing = sorted(set(joint_names) - set(motion.joint_names))
        unknown = sorted(set(motion.joint_names) - set(joint_names))
        raise MotionError(
            f"{motion.source}: its joints are of another robot: "
            + "; ".join(
                f"{what} {few(names, 4)}"
                for what, names in (("it lacks", missing), ("it has", unknown))
                if names
            )
        )
    order = [motion.joint_names.index(name) for name in joint_names]
    computed = dict(motion.computed)
    # What has a column a joint goes with them; what has a row a link stays, and is
    # written only in the layout that it was read from.
    for key in {"joint_vel", "rows"} & computed.keys():
        values = np.asarray(computed[key])
        root = values.shape[1] - motion.num_joints
        computed[key] = values[:, [*range(root), *(root + i for i in order)]]
    computed.pop("pose_aa", None)
    changed = replace(
        motion,
        joint_names=joint_names,
        joint_positions=motion.joint_positions[:, order],
        computed=computed,
    )
    return changed.as_read() if motion.is_as_read else changed


def matched(motion: RobotMotion, robot: WholeBody) -> RobotMotion:
    """The motion with the robot's joint names, in their order.

    Names in the file are taken at their word. Without, the number of joints has to be
    right, and the order is that of the layout unless evidence refutes it: where the
    links are, about which axes joints turn, limits, soles on the floor. A motion
    without joints that versions of the robot lock (the wrists; of a G1's waist and
    wrists all but one each) has these at 0.

    Raises:
        MotionError: it is a motion of another robot, or two readings fit alike; the
            message says what is expected.
    """
    names = set(motion.joint_names)
    possible = [
        order
        for order in _orders(robot)
        if len(order.names) == motion.num_joints and names in (set(), set(order.names))
    ]
    if names:
        if set(robot.joint_names) < names:
            raise MotionError(f"{motion.source}: {_wrong_number(motion, robot)}")
        if possible and possible[0].locked:
            motion = possible[0].named(motion, _how(possible[0], robot))
        orders = robot.joint_names, robot.breadth_first
        if motion.layout in KNOWN_BY_ORDER and motion.joint_names in orders:
            layout = KNOWN_BY_ORDER[orders.index(motion.joint_names)]
            known = [g for g in motion.guesses if not g.startswith(_ORDER_GUESSES)]
            motion = replace(motion, layout=layout, guesses=tuple(known))
        return _links_checked(reordered(motion, robot.joint_names), robot)
    if not possible:
        raise MotionError(f"{motion.source}: {_wrong_number(motion, robot)}")
    order, how = _best(motion, robot, possible)
    if motion.layout in KNOWN_BY_ORDER:
        motion = replace(motion, layout=KNOWN_BY_ORDER[order.breadth_first])
    return reordered(order.named(motion, how), robot.joint_names)


def _orders(robot: WholeBody) -> list[_Order]:
    """What a file without names may have, the usual ones first."""
    found = [_Order(robot.joint_names, False), _Order(robot.breadth_first, True)]
    for lacks, parts in _LOCKED.items():
        locked = tuple(x for x in robot.joint_names if any(part in x for part in parts))
        for breadth_first in (False, True) if 0 < len(locked) < robot.n else ():
            names = robot.order_without(locked, breadth_first)
            if names not in [other.names for other in found]:
                lacking = lacks.format(len(locked))
                found.append(_Order(names, breadth_first, locked, lacking))
    return found


def _how(order: _Order, robot: WholeBody) -> str:
    """What was guessed of the joints, in words."""
    name, n = robot.description.name, len(order.names)
    if order.locked:
        return f"it has {n} joints, {name}'s without {order.lacks}: those at 0"
    return f"joints have no names: {n} as {name}, {order.words}"


def _best(
    motion: RobotMotion, robot: WholeBody, possible: list[_Order]
) -> tuple[_Order, str]:
    """The order that evidence prefers, and what it is.

    Raises:
        MotionError: it refutes all, or several fit alike; or only one that the layout
            does not have.
    """
    layout, n, name = motion.layout, motion.num_joints, robot.description.name
    breadth_first = layout in LAYOUTS and LAYOUTS[layout].breadth_first
    told = {o: replace(motion, joint_names=o.names) for o in possible}
    kept = [o for o in possible if _turns_fit(told[o], robot)]
    if not kept:
        other = "its joints turn about other axes (pose_aa) than the robot's"
        raise MotionError(f"{motion.source}: {other}; {_wrong_number(motion, robot)}")
    off = {o: links_off(told[o], robot, robot.links_of(o.names)) for o in kept}
    links = {o: error for o, error in off.items() if error is not None}
    if links:
        best = min(links, key=links.get)
        if links[best] > _SAME_LINK:
            raise MotionError(
                f"{motion.source}: its links are up to {1e3 * links[best]:.0f} mm from "
                f"where those of {name} are: it is of another robot"
            )
        others = [error for o, error in links.items() if o != best]
        than = f" (else {1e3 * min(others):.0f} mm)" if others else ""
        how = (
            f"joints have no names: {best.words}, since then links are where the file "
            f"says to {1e3 * links[best]:.1f} mm{than}"
        )
        return best, how
    usual = [o for o in kept if o.breadth_first == breadth_first] or kept
    costs = {o: Standing(o.named(motion, ""), robot).cost for o in kept}
    least = min(costs, key=costs.get)
    fit = [o for o in usual if costs[o] <= costs[least] + _WORSE]
    if not fit and layout not in KNOWN_BY_ORDER:
        raise MotionError(
            f"{motion.source}: its {n} joints fit {name} {least.words}, by limits and "
            f"soles, and not {usual[0].words}, as {layout} has them: put them "
            "into that order, or write their names into the file (docs/guides/"
            "reference-motions.md#layouts)"
        )
    fit = fit or [least]
    if len(fit) > 1:
        both = ", or ".join(f"{name}'s {o.words} ({_some(o, fit)})" for o in fit)
        raise MotionError(
            f"{motion.source}: its {n} joints may be {both}, and nothing in the file "
            "tells which: write their names into it (docs/guides/reference-motions.md"
            "#layouts), or import the robot that has these joints alone"
        )
    return fit[0], _how(fit[0], robot)


def _some(order: _Order, others: list[_Order]) -> str:
    """Where an order's names differ from another's first."""
    other = next(o for o in others if o != order)
    first = next(i for i, name in enumerate(order.names) if name != other.names[i])
    return f"column {first + 1} of the joints is {order.names[first]}"


def _turns_fit(motion: RobotMotion, robot: WholeBody) -> bool:
    """Whether the joints' turns in the file (`pose_aa`) are about their axes."""
    n = motion.num_joints
    if "pose_aa" not in motion.computed:
        return True
    axes = robot.joint_axes[[robot.joint_names.index(x) for x in motion.joint_names]]
    turns = np.asarray(motion.computed["pose_aa"], dtype=float)[:, 1 : 1 + n]
    expected = axes * motion.joint_positions[:, :, None]
    return (
        turns.shape == expected.shape and np.abs(turns - expected).max() <= _SAME_TURN
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
    what = {".csv": "columns", ".npz": "columns of joint_pos"}
    fits = (
        f"{other.name} ({n + other.root_columns} "
        f"{what.get(other.suffix, 'columns of its joints')})"
        for other in LAYOUTS.values()
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
    off = links_off(motion, robot, tuple(str(name) for name in np.asarray(names)))
    if off is None or off <= _SAME_LINK:
        return motion
    where = (
        f"its links are up to {1e3 * off:.0f} mm from where those of "
        f"{robot.description.name} are"
    )
    if motion.layout != "amp-npz" or off > _LATE:
        raise MotionError(f"{motion.source}: {where}: it is of another robot")
    doubt = f"{where}: another version of it, or recorded late, and the joints count"
    return replace(motion, guesses=(*motion.guesses, doubt))


def links_off(
    motion: RobotMotion, robot: WholeBody, links: tuple[str, ...]
) -> float | None:
    """How far links are at most from where a file says [m]; None if it cannot be seen.

    Args:
        motion: with names, of the robot's joints or some of them; the others are at 0.
        robot: to compare with.
        links: (B) names of the links in the file's order, where it does not say them;
            those that the robot does not have are not compared.
    """
    R_WR, p_WR = motion.root_rotations.as_matrix(), motion.root_positions
    named = texts(motion.computed.get("link_body_list"))
    if named:  # GMR's are seen from the root
        links, R_WR, p_WR = named, np.broadcast_to(np.eye(3), R_WR.shape), 0.0 * p_WR
    key = "local_body_pos" if named else "body_pos_w"
    p_WB = np.asarray(motion.computed.get(key, ()), dtype=float)
    if p_WB.ndim != 3 or p_WB.shape[1] != len(links) or len(p_WB) != motion.num_frames:
        return None
    rows = np.unique(np.linspace(0, motion.num_frames - 1, _FRAMES).astype(int))
    known = [
        i for i, name in enumerate(links) if name != "world" and robot.has_link(name)
    ]
    if len(known) < 2:
        return None
    q = np.zeros((len(rows), robot.n))
    for name, values in zip(motion.joint_names, motion.joint_positions.T, strict=True):
        q[:, robot.joint_names.index(name)] = values[rows]
    p_RB, _ = robot.poses_in_root(q, tuple(links[i] for i in known))
    expected = p_WR[rows, None] + np.einsum("tij,tlj->tli", R_WR[rows], p_RB)
    return float(np.linalg.norm(p_WB[rows][:, known] - expected, axis=2).max())
