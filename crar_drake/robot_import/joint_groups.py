"""Which part of the body each joint moves, and by that which joints are locked."""

from collections.abc import Sequence

import numpy as np

from crar_drake.robot_import.anatomy import (
    Arms,
    chain_ends,
    find_leg_chains,
    longest_chains,
)
from crar_drake.robot_import.meshes import vertices_of
from crar_drake.robot_import.source_robot import Joint, SourceRobot

# What is locked unless the import file says otherwise: all that no arm needs.
DEFAULT_LOCK = ("legs", "hands", "head", "other")

# Shares of the height of the shoulders above the lowest point.
_LEG_LENGTH = 0.3  # that a leg hangs down, at least
_LEG_START = 0.7  # that a leg starts at, at most
_HEAD_START = 0.5  # that a neck starts at, at least


def joint_groups(robot: SourceRobot, anatomy: Arms | None) -> dict[str, str]:
    """Each joint that is not fixed, to one of `choices.GROUPS`.

    Arms are those of the anatomy, the trunk is what carries both. Two mirrored legs are
    legs. What else branches off the trunk is a leg if it hangs down far from below the
    shoulders, the head if it reaches above them, else it is other; what branches off an
    arm's end is a hand. Of a robot without a pair of arms the longest chain is the arm,
    or all are if several are as long; what is beyond is a hand, all else is other.
    Without looks a link is a point.
    """
    if anatomy is None:
        return _of_one_arm(robot)
    groups: dict[str, str] = {}
    ends = [arm.joints[-1] for arm in anatomy]
    way = {j.name for end in ends for j in robot.path_to(end.child)}
    last = {end.name for end in ends}
    legs = find_leg_chains(robot, anatomy)
    in_arms, in_legs = anatomy.joints, legs.joints if legs else set()
    extents = _Extents(robot, anatomy)
    for link in robot.below(robot.root):
        joint = robot.parent_joint(link)
        if joint is None or joint.kind == "fixed":
            continue
        way_down = [j for j in robot.path_to(joint.parent) if j.kind != "fixed"]
        above = way_down[-1] if way_down else None
        if joint.name in way:
            group = "arms" if joint.name in in_arms else "trunk"
        elif joint.name in in_legs:
            group = "legs"
        elif above is not None and above.name not in way:
            group = groups[above.name]  # farther out on a branch
        elif above is not None and above.name in in_arms:
            group = "hands" if above.name in last else "other"
        else:
            group = extents.group(joint)
        groups[joint.name] = group
    return groups


def _of_one_arm(robot: SourceRobot) -> dict[str, str]:
    """The groups of a robot without a pair of arms."""
    ends = longest_chains(robot)
    arms = {joint.name for end in ends for joint in robot.path_to(end)}
    limbs = {j.name for end in chain_ends(robot) for j in robot.path_to(end)}
    beyond = {
        joint.name
        for end in ends
        for link in robot.below(end)
        for joint in robot.children(link)
    }
    groups = {}
    for name, joint in robot.joints.items():
        if joint.kind != "fixed":
            other = "other" if name in limbs and name not in beyond else "hands"
            groups[name] = "arms" if name in arms else other
    return groups


def guess_locked(
    robot: SourceRobot,
    anatomy: Arms | None,
    lock: Sequence[str] = DEFAULT_LOCK,
) -> dict[str, float]:
    """The joints of some groups (`choices.GROUPS`), at zero or where their limits let
    them be nearest, and those that cannot be controlled; of arms those are in the
    middle of their range [rad or m]."""
    groups = joint_groups(robot, anatomy)
    bound = uncontrollable(robot)

    def place(joint: Joint) -> float:
        lower, upper = _range_with_followers(robot, joint)
        in_arm = groups[joint.name] == "arms" and "arms" not in lock
        if in_arm and not joint.mimic and np.isfinite(upper - lower):
            return (lower + upper) / 2.0
        return float(np.clip(0.0, lower, upper))

    return {
        joint.name: place(joint)
        for joint in robot.joints.values()
        if joint.kind != "fixed" and (groups[joint.name] in lock or joint.name in bound)
    }


def _range_with_followers(robot: SourceRobot, joint: Joint) -> tuple[float, float]:
    """Where a joint and all that follow it are within their limits; its own range if
    there is no such place."""
    lower, upper = joint.lower, joint.upper
    for other in robot.joints.values():
        if other.mimic == joint.name and other.multiplier and np.isfinite(other.lower):
            ends = np.sort(
                (np.array([other.lower, other.upper]) - other.offset) / other.multiplier
            )
            lower, upper = max(lower, float(ends[0])), min(upper, float(ends[1]))
    return (lower, upper) if lower <= upper else (joint.lower, joint.upper)


def uncontrollable(robot: SourceRobot) -> set[str]:
    """Joints without a single axis, that follow others or are followed, or in loops."""
    found = {name for loop in robot.loops for name in loop.joints}
    for joint in robot.joints.values():
        if joint.mimic:
            found |= {joint.name, joint.mimic}
        if not joint.moves:
            found.add(joint.name)
    return {name for name in found if robot.joints[name].kind != "fixed"}


class _Extents:
    """From where to where the branches of a trunk reach."""

    def __init__(self, robot: SourceRobot, anatomy: Arms) -> None:
        self._robot = robot
        X = robot.poses()
        self._start = {link: X[link].translation()[2] for link in robot.links}
        self._ends = {}  # of each link, its lowest and its highest place
        for link, z in self._start.items():
            look = robot.looks.get(link)
            heights = np.append(vertices_of(look, X[link])[:, 2] if look else [], z)
            self._ends[link] = heights.min(), heights.max()
        self._neck = float(np.mean([self._start[a.joints[0].child] for a in anatomy]))
        self._floor = float(min(bottom for bottom, _ in self._ends.values()))

    def group(self, joint: Joint) -> str:
        """legs, head or other, of a joint that the trunk carries."""
        ends = [self._ends[link] for link in self._robot.below(joint.child)]
        bottom, top = min(low for low, _ in ends), max(high for _, high in ends)
        start, tall = self._start[joint.child], self._neck - self._floor
        down, up = start - bottom, top - start
        share = (start - self._floor) / tall if tall > 0.0 else 1.0
        if share < _LEG_START and down > max(2.0 * up, _LEG_LENGTH * tall):
            return "legs"
        if share > _HEAD_START and top > self._neck and up > 0.5 * down:
            return "head"
        return "other"
