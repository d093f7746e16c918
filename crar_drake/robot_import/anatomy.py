"""A first guess at what is what on a robot: arms, trunk, and the points of a motion.

It looks at the structure, not at names: arms are the highest pair of mirrored chains
with at least four joints. It assumes the URDF's usual frame, x forward and z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crar_drake.robot_import.choices import FrameChoice
from crar_drake.robot_import.source_urdf import Joint, SourceRobot

_FEWEST_JOINTS = 4  # of an arm
_AWAY = 0.25  # [rad] of an arm from the trunk, at rest
_BENT = 0.6  # [rad] of an elbow, at rest
_MIRROR_TOLERANCE = 0.03  # [m]


@dataclass(frozen=True)
class Arm:
    """A chain from the trunk to a hand.

    Attributes:
        joints: moving joints, from the trunk outwards.
        hand: the last link before fingers, if there are any.
        trunk: the link that both arms hang on.
    """

    joints: tuple[Joint, ...]
    hand: str
    trunk: str


@dataclass(frozen=True)
class Anatomy:
    """Both arms of a humanoid; `left` is at +y."""

    left: Arm
    right: Arm


def find_anatomy(robot: SourceRobot) -> Anatomy | None:
    """The robot's arms; None where there is no mirrored pair of chains."""
    X = robot.poses()
    ends = _chain_ends(robot)
    ways = {end: [j for j in robot.path_to(end) if j.moves] for end in ends}
    found = []
    for a in ends:
        for b in ends:
            p_a, p_b = X[a].translation(), X[b].translation()
            if not p_a[1] > p_b[1] or p_a[1] < 0.0:
                continue
            if np.abs(p_a - p_b * [1, -1, 1]).max() > _MIRROR_TOLERANCE:
                continue
            common = 0
            for joint_a, joint_b in zip(ways[a], ways[b], strict=False):
                if joint_a.name != joint_b.name:
                    break
                common += 1
            arm_a, arm_b = ways[a][common:], ways[b][common:]
            if len(arm_a) != len(arm_b) or len(arm_a) < _FEWEST_JOINTS:
                continue
            height = X[arm_a[0].child].translation()[2]
            found.append((height, a, b, arm_a, arm_b))
    if not found:
        return None
    _, a, b, arm_a, arm_b = max(found, key=lambda entry: entry[0])
    return Anatomy(
        Arm(tuple(arm_a), a, arm_a[0].parent), Arm(tuple(arm_b), b, arm_b[0].parent)
    )


def _chain_ends(robot: SourceRobot) -> list[str]:
    """Links where a chain stops: at its tip, or at a hand that carries fingers."""

    def moving_below(link: str) -> list[Joint]:
        found = []
        for joint in robot.children(link):
            found += [joint] if joint.moves else moving_below(joint.child)
        return found

    def is_finger(joint: Joint) -> bool:
        words = ("finger", "thumb")
        return bool(joint.mimic) or any(word in joint.name.lower() for word in words)

    ends = []

    def walk(link: str, depth: int) -> None:
        onward = moving_below(link)
        fingers = any(is_finger(joint) for joint in onward)
        spread = len(onward) > 1 and depth >= _FEWEST_JOINTS
        # A spread that still has long chains behind it is a trunk, not a hand.
        long_behind = any(_depth(robot, j.child) >= _FEWEST_JOINTS - 1 for j in onward)
        if not onward or fingers or (spread and not long_behind):
            ends.append(_hand_link(robot, link))
            return
        for joint in onward:
            walk(joint.child, depth + 1)

    walk(robot.root, 0)
    return ends


def _depth(robot: SourceRobot, link: str) -> int:
    """Moving joints on the longest way down from a link."""
    return max(
        (j.moves + _depth(robot, j.child) for j in robot.children(link)), default=0
    )


def _hand_link(robot: SourceRobot, link: str) -> str:
    """The link with geometry farthest down the welds, else the link itself."""
    best = link
    for joint in robot.children(link):
        if joint.kind == "fixed" and not robot.is_bare(joint.child):
            best = _hand_link(robot, joint.child)
            break
    return best


def guess_frames(robot: SourceRobot, anatomy: Anatomy) -> dict[str, FrameChoice]:
    """The points that a motion of joint centres needs, on the robot.

    Shoulder: where the axes of the arm's second and third joint come nearest.
    Elbow: origin of the joint after the shoulder's three, or of that named elbow.
    Wrist: origin of the last joint but one after the elbow, if there are two.
    Neck: between the shoulders. Waist: the root link.
    """
    X = robot.poses()
    frames = {"waist": FrameChoice(robot.root)}
    shoulders = []
    for side, arm in (("left", anatomy.left), ("right", anatomy.right)):
        joints = arm.joints
        elbow = _elbow(joints)
        p_shoulder = _crossing(X, joints[1], joints[2])
        after = joints[elbow + 1 :]
        wrist = after[-2] if len(after) >= 2 else None
        shoulders.append(p_shoulder)
        frames[f"{side}_shoulder"] = _at(X, joints[1].parent, p_shoulder)
        frames[f"{side}_elbow"] = FrameChoice(joints[elbow].child)
        if wrist is not None:
            p_wrist = X[wrist.child].translation()
            frames[f"{side}_wrist"] = _at(X, wrist.parent, p_wrist)
        else:
            frames[f"{side}_wrist"] = FrameChoice(arm.hand)
        frames[f"{side}_hand"] = FrameChoice(arm.hand)
    frames["neck"] = _at(X, anatomy.left.trunk, np.mean(shoulders, axis=0))
    order = ("waist", "neck")
    return {name: frames[name] for name in (*order, *sorted(set(frames) - set(order)))}


def guess_locked(robot: SourceRobot, anatomy: Anatomy | None) -> dict[str, float]:
    """Joints that no arm needs, at zero or where their limits let them be nearest."""
    needed = set()
    if anatomy is not None:
        for arm in (anatomy.left, anatomy.right):
            needed |= {j.name for j in robot.path_to(arm.joints[-1].child)}
    else:
        for end in _chain_ends(robot):
            needed |= {joint.name for joint in robot.path_to(end)}
    return {
        joint.name: float(np.clip(0.0, joint.lower, joint.upper))
        for joint in robot.joints.values()
        if joint.kind != "fixed" and (joint.name not in needed or not joint.moves)
    }


def guess_rest(
    robot: SourceRobot, anatomy: Anatomy | None, locked: dict[str, float]
) -> dict[str, float]:
    """Arms a little away from the trunk and elbows bent: clear of limits, of the
    trunk, and of the singular pose of a straight arm."""
    rest = {}
    for joint in robot.joints.values():
        if joint.moves and joint.name not in locked:
            inside = min(0.05, (joint.upper - joint.lower) / 4.0)
            rest[joint.name] = float(
                np.clip(0.0, joint.lower + inside, joint.upper - inside)
            )
    arms = () if anatomy is None else (anatomy.left, anatomy.right)
    for arm, outwards in zip(arms, (1.0, -1.0), strict=False):
        elbow = _elbow(arm.joints)
        moved = {}
        for joint in arm.joints[:elbow]:
            for angle in (-_AWAY, _AWAY):
                there = rest[joint.name] + angle
                if joint.lower < there < joint.upper:
                    X = robot.poses({**rest, joint.name: there})
                    y = X[arm.joints[elbow].child].translation()[1]
                    moved[outwards * y] = (joint.name, there)
        if moved:
            name, there = moved[max(moved)]
            rest[name] = there
        bend = arm.joints[elbow]
        forward = bend.upper > -bend.lower
        there = rest[bend.name] + (_BENT if forward else -_BENT)
        rest[bend.name] = float(np.clip(there, bend.lower, bend.upper))
    return {name: round(value, 4) for name, value in rest.items() if value}


def _elbow(joints: tuple[Joint, ...]) -> int:
    """Which joint of an arm is the elbow: the one named so, else the fourth."""
    return next(
        (i for i, j in enumerate(joints) if "elbow" in j.name.lower() and i >= 2),
        min(3, len(joints) - 1),
    )


def _crossing(X: dict, a: Joint, b: Joint) -> np.ndarray:
    """The point on b's axis that is nearest to a's, in the root's frame."""
    p_a, p_b = X[a.child].translation(), X[b.child].translation()
    u = X[a.child].rotation().multiply(a.axis)
    v = X[b.child].rotation().multiply(b.axis)
    matrix = np.stack([u, -v], axis=1)
    (_, t), *_ = np.linalg.lstsq(matrix, p_b - p_a, rcond=None)
    # Parallel axes cross nowhere in particular.
    return p_b if np.linalg.norm(np.cross(u, v)) < 0.1 else p_b + t * v


def _at(X: dict, link: str, p_root: np.ndarray) -> FrameChoice:
    point = X[link].inverse().multiply(p_root)
    return FrameChoice(link, [float(c) for c in np.round(point, 5)])
