"""A first guess at what is what on a robot: arms, trunk, and the points of a motion.

It looks at the structure, not at names: arms are the highest pair of mirrored chains
with at least four joints. The robot is to be given in a frame with x forward and z up
(`facing`).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from crar_drake.robot_import.choices import FrameChoice
from crar_drake.robot_import.source_robot import Joint, Poses, SourceRobot

FEWEST_JOINTS = 4  # of an arm
_ENOUGH = 6  # joints of an arm, for any pose of its hand
_LEG_WORDS = ("leg", "hip", "knee", "ankle", "foot", "thigh", "calf", "shank")
_ARM_WORDS = ("arm", "shoulder", "elbow", "wrist", "hand")
MIRROR_TOLERANCE = 0.03  # [m]
_SAME = 2e-3  # [m] between a link's origin and that of its twin's image
MIRROR, HALF_TURN = (1, -1, 1), (-1, -1, 1)
_GRIPS, _TURNS = ("grip", "jaw", "claw"), ("yaw", "roll", "pitch", "wrist", "rot")
_HAND_SHARE = 0.5  # of the way from the root that fingers reach beyond it, at most
_ASIDE = 0.02  # [m] between the first joints of two arms, at least
_UNEVEN = 2.0  # upper arm over forearm, or thigh over shank, or the other way
LATERAL = 0.8  # of a knee's axis, along the left; of a roll's, ahead


@dataclass(frozen=True)
class Arm:
    """A chain from the trunk to a hand, or to a foot."""

    joints: tuple[Joint, ...]  # moving joints, from the trunk outwards
    hand: str  # the last link before fingers, if there are any
    trunk: str  # the link that both arms hang on


class Arms(NamedTuple):
    """Two arms or legs that mirror each other; `left` is at +y."""

    left: Arm
    right: Arm

    @property
    def joints(self) -> set[str]:
        """Names of both sides' joints."""
        return {joint.name for arm in self for joint in arm.joints}


def find_anatomy(robot: SourceRobot) -> Arms | None:
    """The robot's arms; None where no mirrored pair of chains is one of arms.

    Where none is, two equal arms may be mounted back to back: a half turn about the
    vertical takes one to the other, with all joints at zero.
    """
    X = robot.poses()
    for image in (MIRROR, HALF_TURN):
        pairs = [
            pair
            for pair in mirrored_chains(robot, FEWEST_JOINTS, image)
            if not _are_legs(robot, pair)
        ]
        if pairs:
            break
    else:
        return None

    return max(pairs, key=lambda pair: X[pair.left.joints[0].child].translation()[2])


def _are_legs(robot: SourceRobot, pair: Arms) -> bool:
    """Whether a pair of chains, although the highest one, is one of legs.

    That is so of a robot that ends at its hips. Its joints say so, or, if they say
    nothing, that the chains hang down from below the root link, farther than anything.
    """
    names = " ".join(joint.name.lower() for arm in pair for joint in arm.joints)
    legs, arms = (any(w in names for w in words) for words in (_LEG_WORDS, _ARM_WORDS))
    if legs or arms:
        return legs and not arms
    X = robot.poses()
    height = {link: X[link].translation()[2] for link in robot.links}
    root, start = height[robot.root], height[pair.left.joints[0].child]
    return start < root - 0.01 and height[pair.left.hand] <= min(height.values()) + 0.05


def find_leg_chains(robot: SourceRobot, anatomy: Arms | None) -> Arms | None:
    """The left leg and the right one, as chains; None where there are none, or four.

    Legs are the lowest pair of mirrored chains with three or more joints that are
    not the arms and end below where they begin. Who has another such pair, which
    reaches half as far down, goes on four legs.
    """
    X = robot.poses()
    arms = anatomy.joints if anatomy else set()
    root = X[robot.root].translation()[2]
    found = []
    for pair in mirrored_chains(robot, fewest=3):
        if pair.joints & arms:
            continue
        first, *_, last = pair.left.joints
        height = X[last.child].translation()[2]
        if height < X[first.child].translation()[2] - 0.1:
            found.append((height, pair))
    if not found:
        return None
    lowest, legs = min(found, key=lambda each: each[0])
    for height, pair in found:
        deep = height - root < 0.5 * (lowest - root) < 0.0
        if deep and not legs.joints & pair.joints:
            return None
    return legs


def link_twins(robot: SourceRobot) -> dict[str, str]:
    """Link to the same one of the other side: of an arm, a leg, and what they carry.

    What hangs on a pair of such links, fingers and what is welded, is a pair if exactly
    one of each has its origin where the mirror image of the other's is.
    """
    twins = mirrored_links(robot, find_anatomy(robot))
    p = {link: X.translation() for link, X in robot.poses().items()}
    queue = list(twins)
    for link in queue:  # grows as it goes
        twin = twins[link]
        own, others = (
            [j.child for j in robot.children(side) if j.child not in twins]
            for side in (link, twin)
        )
        if link == twin:
            continue
        like = [
            (a, b)
            for a, b in itertools.product(own, others)
            if any(
                np.abs((p[a] - p[link]) * image - (p[b] - p[twin])).max() < _SAME
                for image in (MIRROR, HALF_TURN)
            )
        ]
        for a, b in like:
            if sum(a == one or b == other for one, other in like) == 1:
                twins |= {a: b, b: a}
                queue.append(a)
    return twins


def mirrored_links(robot: SourceRobot, anatomy: Arms | None) -> dict[str, str]:
    """Link of an arm or a leg to the same one of the other side."""
    twins: dict[str, str] = {}
    for left, right in filter(None, (anatomy, find_leg_chains(robot, anatomy))):
        links = [[*(j.child for j in arm.joints), arm.hand] for arm in (left, right)]
        twins |= dict(zip(*links, strict=True)) | dict(zip(*links[::-1], strict=True))
    return twins


def mirrored_chains(
    robot: SourceRobot, fewest: int, image: tuple[int, int, int] = MIRROR
) -> list[Arms]:
    """Pairs of chains of so many joints, or more, that mirror each other: a place of
    one times `image` is that of the other.

    What tells is where their last joints are: what is welded beyond them, a camera on
    one hand, is often not there twice.
    """
    X = robot.poses()
    ends = chain_ends(robot)
    ways = {end: robot.moving_to(end) for end in ends}
    found = []
    for a, b in itertools.permutations(ends, 2):
        if not ways[a] or not ways[b]:
            continue
        p_a, p_b = (X[ways[end][-1].child].translation() for end in (a, b))
        if np.abs(p_a - p_b * image).max() > MIRROR_TOLERANCE:
            continue
        if image == HALF_TURN and abs(p_a[0]) > abs(p_a[1]):
            continue  # one is ahead of the other
        common = _common([ways[a], ways[b]])
        arm_a, arm_b = ways[a][common:], ways[b][common:]
        if len(arm_a) != len(arm_b) or len(arm_a) < fewest:
            continue
        # Arms may cross at zero: it counts where they begin, if that is aside.
        start = [X[arm[0].child].translation()[1] for arm in (arm_a, arm_b)]
        aside = abs(start[0] - start[1]) > _ASIDE
        if start[0] > start[1] if aside else p_a[1] > p_b[1]:
            chains = ((arm_a, a), (arm_b, b))
            found.append(
                Arms(*(Arm(tuple(arm), end, arm[0].parent) for arm, end in chains))
            )
    return found


def own_joints(robot: SourceRobot) -> dict[str, list[Joint]]:
    """The end of each chain to its moving joints beyond those that all have."""
    ways = {end: robot.moving_to(end) for end in chain_ends(robot)}
    common = _common(list(ways.values())) if len(ways) > 1 else 0
    return {end: way[common:] for end, way in ways.items()}


def _common(ways: Sequence[Sequence[Joint]]) -> int:
    """How many of their first joints some ways have in common."""
    steps = zip(*ways, strict=False)
    same = itertools.takewhile(lambda step: len({j.name for j in step}) == 1, steps)
    return len(list(same))


def chain_ends(robot: SourceRobot) -> list[str]:
    """Links where a chain stops: at its tip, or at a hand that carries fingers."""

    def moving_below(link: str) -> list[Joint]:
        found = []
        for joint in robot.children(link):
            found += [joint] if joint.moves else moving_below(joint.child)
        return found

    followers: dict[str, list[Joint]] = {}
    for joint in robot.joints.values():
        if joint.mimic:
            followers.setdefault(joint.mimic, []).append(joint)

    def is_finger(joint: Joint) -> bool:
        # What moves a gripper's other parts is followed by them; none carries a chain,
        # as what a motor's gear drives in the midst of an arm.
        group = [joint, *followers.get(joint.name, ())]
        leads = len(group) > 1 and all(_depth(robot, j.child) < 2 for j in group)
        name = joint.name.lower()
        grips = any(word in name for word in _GRIPS)
        turns = any(word in name for word in _TURNS)
        last = grips and not turns and not _depth(robot, joint.child)
        # A jaw opens one way from closed, at zero, at the end of an arm that needs no
        # more joints.
        opens = joint.lower == 0.0 or joint.upper == 0.0
        before = len(robot.moving_to(joint.parent))
        jaw = opens and not _depth(robot, joint.child) and before >= _ENOUGH
        named = "finger" in name or "thumb" in name
        # A telescope's joints follow each other, too, or a forearm's its elbow's, and
        # carry a wrist.
        follows = bool(joint.mimic) and not _depth(robot, joint.child, own=True)
        return follows or leads or last or jaw or named

    X, ends = robot.poses(), []

    def walk(link: str, depth: int) -> None:
        onward = moving_below(link)
        fingers = any(is_finger(joint) for joint in onward)
        spread = len(onward) > 1 and depth >= FEWEST_JOINTS
        # A spread that still has long chains behind it is a trunk, not a hand.
        long_behind = any(
            _depth(robot, j.child) >= FEWEST_JOINTS - 1
            and _reach(robot, X, link, j.child) > _HAND_SHARE * _way(robot, X, link)
            for j in onward
        )
        if not onward or fingers or (spread and not long_behind):
            ends.append(_hand_link(robot, link))
            return
        for joint in onward:
            walk(joint.child, depth + 1)

    walk(robot.root, 0)
    return ends


def longest_chains(robot: SourceRobot) -> list[str]:
    """The ends of the chains that have the most joints."""
    count = {end: len(robot.moving_to(end)) for end in chain_ends(robot)}
    longest = max(count.values())
    return [end for end, joints in count.items() if joints == longest]


def _depth(robot: SourceRobot, link: str, own: bool = False) -> int:
    """Moving joints, or those that follow no other, on the longest way down."""
    return max(
        (
            (j.moves and not (own and j.mimic)) + _depth(robot, j.child, own)
            for j in robot.children(link)
        ),
        default=0,
    )


def _reach(robot: SourceRobot, X: Poses, link: str, first: str) -> float:
    """How far from a link the chains below one of its children end, at most [m]."""
    p = X[link].translation()
    below = (X[other].translation() for other in robot.below(first))
    return max(float(np.linalg.norm(end - p)) for end in below)


def _way(robot: SourceRobot, X: Poses, link: str) -> float:
    """The way from the root link to a link, from joint to joint [m]."""
    steps = [joint.child for joint in robot.path_to(link)]
    p = [X[each].translation() for each in (robot.root, *steps)]
    return float(np.linalg.norm(np.diff(p, axis=0), axis=1).sum())


def _hand_link(robot: SourceRobot, link: str) -> str:
    """The link with geometry farthest down the welds, else the link itself.

    Where several are welded to one link, none of them is the hand: cameras are among
    them, and soles' corners.
    """
    welded = [
        joint.child
        for joint in robot.children(link)
        if joint.kind == "fixed" and not robot.is_bare(joint.child)
    ]
    return _hand_link(robot, welded[0]) if len(welded) == 1 else link


def welded_below(robot: SourceRobot, link: str) -> list[str]:
    """Links that hang on a link by fixed joints."""
    found = []
    for joint in robot.children(link):
        if joint.kind == "fixed":
            found += [joint.child, *welded_below(robot, joint.child)]
    return found


def elbow_index(X: Poses, arm: Arm) -> int:
    """Which joint of an arm is the elbow.

    It is the one named so, else the fourth, if its axis is across the forearm and
    neither of upper arm and forearm is more than twice as long as the other. If not,
    it is the joint that divides the arm most evenly, among those that pass.
    """
    joints = arm.joints
    named = [i for i, j in enumerate(joints) if "elbow" in j.name.lower() and i >= 2]
    usual = [*named, min(3, len(joints) - 1)]
    p_shoulder = shoulder_point(X, arm)
    uneven = {}
    for index in range(2, len(joints)):
        p_elbow = X[joints[index].child].translation()
        wrist = wrist_joint(X, arm, index)
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


def knee_index(X: Poses, leg: Arm) -> int | None:
    """Which joint of a leg is the knee; None if none divides it like one."""
    p = [X[joint.child].translation() for joint in leg.joints]
    uneven = {}
    for index in range(1, len(p) - 1):
        thigh = np.linalg.norm(p[index] - p[0])
        shank = np.linalg.norm(p[-1] - p[index])
        lateral = abs(joint_axis(X, leg.joints[index])[1]) > LATERAL
        if lateral and min(thigh, shank) > 1e-3:
            uneven[index] = abs(np.log(thigh / shank))
    if not uneven:
        return None
    best = min(uneven, key=uneven.get)
    return best if uneven[best] < np.log(_UNEVEN) else None


def wrist_joint(X: Poses, arm: Arm, elbow: int) -> Joint | None:
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


def shoulder_point(X: Poses, arm: Arm) -> np.ndarray:
    """Where an arm turns in all directions, in the root's frame."""
    first, second, third = arm.joints[:3]
    if _are_parallel(X, second, third):
        return axes_crossing(X, first, second)
    return axes_crossing(X, second, third)


def _are_parallel(X: Poses, a: Joint, b: Joint) -> bool:
    return bool(np.linalg.norm(np.cross(joint_axis(X, a), joint_axis(X, b))) < 0.1)


def axes_crossing(X: Poses, a: Joint, b: Joint) -> np.ndarray:
    """The point on b's axis that is nearest to a's, in the root's frame."""
    p_a, p_b = X[a.child].translation(), X[b.child].translation()
    u, v = joint_axis(X, a), joint_axis(X, b)
    matrix = np.stack([u, -v], axis=1)
    (_, t), *_ = np.linalg.lstsq(matrix, p_b - p_a, rcond=None)
    # Parallel axes cross nowhere in particular.
    return p_b if _are_parallel(X, a, b) else p_b + t * v


def joint_axis(X: Poses, joint: Joint) -> np.ndarray:
    """A joint's axis in the root's frame."""
    return X[joint.child].rotation().multiply(joint.axis)


def frame_at(X: Poses, link: str, p_root: np.ndarray) -> FrameChoice:
    point = X[link].inverse().multiply(p_root)
    return FrameChoice(link, [float(c) for c in np.round(point, 5)])
