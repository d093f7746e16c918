"""A first guess at what is what on a robot: arms, trunk, and the points of a motion.

It looks at the structure, not at names: arms are the highest pair of mirrored chains
with at least four joints. The robot is to be given in a frame with x forward and z up
(`facing`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from crar_drake.robot_import.choices import FrameChoice
from crar_drake.robot_import.meshes import Part
from crar_drake.robot_import.source_urdf import Joint, SourceRobot

_FEWEST_JOINTS = 4  # of an arm
_TOOLS = ("tcp", "tool", "grasp", "end_effector", "ee_link", "eef")  # best first
_AWAY = 0.25  # [rad] of an arm from the trunk, at rest
_BENT = 0.6  # [rad] of an elbow, at rest
_MIRROR_TOLERANCE = 0.03  # [m]
_UNEVEN = 2.0  # upper arm over forearm, or the other way
_ON_FLOOR = 0.2  # [m] that a root link on wheels is above the floor, at most
_WAIST_SHARE = 0.62  # of a person's neck's height


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
    pairs = mirrored_chains(robot, _FEWEST_JOINTS)
    if not pairs:
        return None

    def height(pair: tuple[Arm, Arm]) -> float:
        return X[pair[0].joints[0].child].translation()[2]

    return Anatomy(*max(pairs, key=height))


def find_leg_chains(
    robot: SourceRobot, anatomy: Anatomy | None
) -> tuple[Arm, Arm] | None:
    """The left leg and the right one, as chains; None where there are none.

    Legs are the lowest pair of mirrored chains with three or more joints that are
    not the arms and end below where they begin.
    """
    X = robot.poses()
    arms = set()
    if anatomy is not None:
        arms = {j.name for arm in (anatomy.left, anatomy.right) for j in arm.joints}
    found = {}
    for pair in mirrored_chains(robot, fewest=3):
        if any(joint.name in arms for chain in pair for joint in chain.joints):
            continue
        height = X[pair[0].joints[-1].child].translation()[2]
        if height < X[pair[0].joints[0].child].translation()[2] - 0.1:
            found[height] = pair
    return found[min(found)] if found else None


def mirrored_chains(robot: SourceRobot, fewest: int) -> list[tuple[Arm, Arm]]:
    """Pairs of chains that mirror each other, that at +y first.

    Args:
        robot: in a frame whose x axis is its front.
        fewest: joints that each has at least.
    """
    X = robot.poses()
    ends = chain_ends(robot)
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
            if len(arm_a) != len(arm_b) or len(arm_a) < fewest:
                continue
            chains = ((arm_a, a), (arm_b, b))
            found.append(
                tuple(Arm(tuple(arm), end, arm[0].parent) for arm, end in chains)
            )
    return found


def chain_ends(robot: SourceRobot) -> list[str]:
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


def guess_frames(
    robot: SourceRobot,
    anatomy: Anatomy,
    parts: Mapping[str, Sequence[Part]] | None = None,
) -> dict[str, FrameChoice]:
    """The points that a motion of joint centres needs, on the robot.

    Shoulder: where the axes of the arm's second and third joint come nearest.
    Elbow: origin of the joint after the shoulder's three, or of that named elbow, if
    it bends the arm between two parts of similar length; else of one that does.
    Wrist: origin of the last joint but one after the elbow, if there are two. Where
    the forearm is the last link, at 80 % of its reach.
    Neck: between the shoulders. Waist: the root link, or above it where that one is on
    wheels.

    Args:
        robot: in a frame whose x axis is its front.
        anatomy: its arms.
        parts: link to its real look, in its frame; without it, floor and tips are
            unknown.
    """
    X, parts = robot.poses(), parts or {}
    frames = {}
    shoulders = []
    for side, arm in (("left", anatomy.left), ("right", anatomy.right)):
        joints = arm.joints
        elbow = elbow_index(X, arm)
        p_shoulder = axes_crossing(X, joints[1], joints[2])
        wrist = _wrist(X, arm, elbow)
        shoulders.append(p_shoulder)
        frames[f"{side}_shoulder"] = frame_at(X, joints[1].parent, p_shoulder)
        frames[f"{side}_elbow"] = FrameChoice(joints[elbow].child)
        if wrist is not None:
            p_wrist = X[wrist.child].translation()
            frames[f"{side}_wrist"] = frame_at(X, wrist.parent, p_wrist)
        elif (tip := _forearm_tip(X, arm, elbow, parts)) is not None:
            frames[f"{side}_wrist"] = frame_at(X, arm.hand, tip)
        else:
            frames[f"{side}_wrist"] = FrameChoice(arm.hand)
        frames[f"{side}_hand"] = FrameChoice(arm.hand)
    p_neck = np.mean(shoulders, axis=0)
    frames["neck"] = frame_at(X, anatomy.left.trunk, p_neck)
    p_waist = _waist_above_wheels(robot, anatomy, p_neck, parts)
    frames["waist"] = (
        FrameChoice(robot.root) if p_waist is None else frame_at(X, robot.root, p_waist)
    )
    order = ("waist", "neck")
    return {name: frames[name] for name in (*order, *sorted(set(frames) - set(order)))}


def guess_tool(robot: SourceRobot) -> dict[str, FrameChoice]:
    """The tool of a robot with one arm: the end of its only longest chain.

    It is what is welded there and named so, else the last link without geometry,
    else the hand. Robots without such a chain of four or more joints have none.
    """
    ways = {
        end: [joint for joint in robot.path_to(end) if joint.moves]
        for end in chain_ends(robot)
    }
    longest = max(map(len, ways.values()))
    ends = [end for end, way in ways.items() if len(way) == longest]
    if longest < _FEWEST_JOINTS or len(ends) != 1:
        return {}
    (end,) = ends
    welded = welded_below(robot, ways[end][-1].child)
    for word in _TOOLS:
        for link in welded:
            if word in link.lower():
                return {"tool": FrameChoice(link)}
    bare = [link for link in welded if robot.is_bare(link)]
    return {"tool": FrameChoice(bare[-1] if bare else end)}


def welded_below(robot: SourceRobot, link: str) -> list[str]:
    """Links that hang on a link by fixed joints."""
    found = []
    for joint in robot.children(link):
        if joint.kind == "fixed":
            found += [joint.child, *welded_below(robot, joint.child)]
    return found


def guess_rest(
    robot: SourceRobot, anatomy: Anatomy | None, locked: dict[str, float]
) -> dict[str, float]:
    """Arms a little away from the trunk and elbows bent: clear of limits, of the
    trunk, and of the singular pose of a straight arm. A robot without a pair of arms
    has its joints in the middle of their ranges."""
    rest = {}
    for joint in robot.joints.values():
        if not joint.moves or joint.name in locked:
            continue
        if anatomy is None and np.isfinite(joint.upper - joint.lower):
            rest[joint.name] = (joint.lower + joint.upper) / 2.0
        else:
            inside = min(0.05, (joint.upper - joint.lower) / 4.0)
            rest[joint.name] = float(
                np.clip(0.0, joint.lower + inside, joint.upper - inside)
            )
    X_zero = robot.poses()
    arms = () if anatomy is None else (anatomy.left, anatomy.right)
    for arm, outwards in zip(arms, (1.0, -1.0), strict=False):
        elbow = elbow_index(X_zero, arm)
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


def elbow_index(X: Mapping[str, RigidTransform], arm: Arm) -> int:
    """Which joint of an arm is the elbow.

    It is the one named so, else the fourth, if its axis is across the forearm and
    neither of upper arm and forearm is more than twice as long as the other. If not,
    it is the joint that divides the arm most evenly, among those that pass.

    Args:
        X: pose of each link at position zero.
        arm: with three or more joints.
    """
    joints = arm.joints
    named = [i for i, j in enumerate(joints) if "elbow" in j.name.lower() and i >= 2]
    usual = [*named, min(3, len(joints) - 1)]
    p_shoulder = axes_crossing(X, joints[1], joints[2])
    uneven = {}
    for index in range(2, len(joints)):
        p_elbow = X[joints[index].child].translation()
        wrist = _wrist(X, arm, index)
        end = arm.hand if wrist is None else wrist.child
        forearm = X[end].translation() - p_elbow
        lengths = np.linalg.norm(p_elbow - p_shoulder), np.linalg.norm(forearm)
        if min(lengths) < 1e-3:
            continue
        ratio = abs(np.log(lengths[0] / lengths[1]))
        across = abs(joint_axis(X, joints[index]) @ forearm) < 0.5 * lengths[1]
        if across and ratio < np.log(_UNEVEN):
            uneven[index] = ratio
    for index in usual:
        if index in uneven:
            return index
    return min(uneven, key=uneven.get) if uneven else usual[0]


def _wrist(X, arm: Arm, elbow: int) -> Joint | None:
    """The joint whose origin is the wrist; None where fewer than two are left."""
    after = arm.joints[elbow + 1 :]
    if len(after) < 2:
        return None
    wrist, last = after[-2:]
    p_wrist, p_last = (X[joint.child].translation() for joint in (wrist, last))
    along = p_last - p_wrist
    far = np.linalg.norm(along) > 0.03
    # A joint that twists the forearm may sit anywhere along it.
    if far and abs(joint_axis(X, wrist) @ along) > 0.9 * np.linalg.norm(along):
        if abs(joint_axis(X, last) @ along) < 0.5 * np.linalg.norm(along):
            return last
    return wrist


def _forearm_tip(X, arm: Arm, elbow: int, parts) -> np.ndarray | None:
    """Where a forearm's wrist would be that has no hand: 80 % of the way to its tip.

    None where the hand is a link of its own, away from the elbow, or has no look.
    """
    p_elbow = X[arm.joints[elbow].child].translation()
    points = [
        X[arm.hand].multiply(part.vertices.T).T for part in parts.get(arm.hand, ())
    ]
    if np.linalg.norm(X[arm.hand].translation() - p_elbow) > 0.03 or not points:
        return None
    from_elbow = np.concatenate(points) - p_elbow
    reach = np.linalg.norm(from_elbow, axis=1)
    # The middle of what is near the tip, not its outermost corner.
    tip = from_elbow[reach > 0.9 * reach.max()].mean(axis=0)
    return p_elbow + 0.8 * tip


def on_wheels(robot: SourceRobot, parts: Mapping[str, Sequence[Part]]) -> bool:
    """Whether the root link is on the floor, with wheels around it or a name so."""
    X = robot.poses()
    heights = [
        X[link].multiply(part.vertices.T)[2].min()
        for link, of_link in parts.items()
        for part in of_link
    ]
    if not heights:
        return False
    near = [robot.root, *(j.child for j in robot.joints.values())]
    words = ("wheel", "footprint", "caster", "mobile_base")
    named = any(word in link.lower() for link in near for word in words)
    return named and X[robot.root].translation()[2] - min(heights) < _ON_FLOOR


def _waist_above_wheels(robot, anatomy: Anatomy, p_neck, parts) -> np.ndarray | None:
    """The waist of a robot whose root is on wheels; None for others.

    It is where the trunk turns, if that is at a waist's height, else at a person's
    share of the neck's height.
    """
    if not on_wheels(robot, parts):
        return None
    X = robot.poses()
    turns = [
        X[joint.child].translation()
        for joint in robot.path_to(anatomy.left.trunk)
        if joint.moves and joint.kind != "prismatic"
    ]
    bottom = X[robot.root].translation()[2]
    tall = p_neck[2] - bottom
    waists = [p for p in turns if 0.4 < (p[2] - bottom) / tall < 0.8]
    if waists:
        return waists[-1]
    return np.array([p_neck[0], p_neck[1], bottom + _WAIST_SHARE * tall])


def axes_crossing(X: dict, a: Joint, b: Joint) -> np.ndarray:
    """The point on b's axis that is nearest to a's, in the root's frame."""
    p_a, p_b = X[a.child].translation(), X[b.child].translation()
    u, v = joint_axis(X, a), joint_axis(X, b)
    matrix = np.stack([u, -v], axis=1)
    (_, t), *_ = np.linalg.lstsq(matrix, p_b - p_a, rcond=None)
    # Parallel axes cross nowhere in particular.
    return p_b if np.linalg.norm(np.cross(u, v)) < 0.1 else p_b + t * v


def joint_axis(X, joint: Joint) -> np.ndarray:
    """A joint's axis in the root's frame."""
    return X[joint.child].rotation().multiply(joint.axis)


def frame_at(X: dict, link: str, p_root: np.ndarray) -> FrameChoice:
    point = X[link].inverse().multiply(p_root)
    return FrameChoice(link, [float(c) for c in np.round(point, 5)])
