"""What in an import looks wrong, or leaves the robot unprotected: said aloud."""

from collections.abc import Mapping, Sequence

import numpy as np

from crar_drake.robot_import.anatomy import Arms, find_leg_chains, joint_axis
from crar_drake.robot_import.choices import FrameChoice
from crar_drake.robot_import.meshes import Looks, Surfaces, lowest_points
from crar_drake.robot_import.source_robot import Positions, SourceRobot

# Ratios of lengths that the limbs of a person, and of the robots that are like one,
# are far inside of.
_LIMBS = (
    ("{}_shoulder", "{}_elbow", "{}_elbow", "{}_wrist", 0.5, 2.0),
    ("waist", "neck", "{}_shoulder", "{}_elbow", 0.5, 4.0),
    ("neck", "{}_shoulder", "{}_shoulder", "{}_elbow", 0.1, 1.8),
)
# What joints of robots turn to, at most: three times round [rad].
_MOST_TURNED = 20.0
_SHORTEST = 0.01  # [m] of a limb
_APART = 0.02  # [m] that left and right may differ by
_PARALLEL = 0.95  # cosine between a left axis' mirror image and the right one
_ALIKE = 0.5  # of the shorter range of two such joints, that they have in common
_BELOW = 0.01  # [m] that a foot may be below the floor
_TOUCH = 0.01  # [m] between points on two surfaces that touch
NEIGHBOURS = 2  # joints apart, at most
_REMEDY = "change rest_posture, lower excess, or list the pair"


def limb_alarms(robot: SourceRobot, frames: Mapping[str, FrameChoice]) -> list[str]:
    """Limb lengths between the motion's points that no body has, one line each.

    Points that are missing are not asked about.
    """
    X = robot.poses()
    p = {name: frame.place(X) for name, frame in frames.items()}
    found = []
    for side in ("left", "right"):
        for *ends, least, most in _LIMBS:
            a, b, c, d = (end.format(side) for end in ends)
            if not {a, b, c, d} <= set(p):
                continue
            one, other = np.linalg.norm(p[b] - p[a]), np.linalg.norm(p[d] - p[c])
            if min(one, other) < _SHORTEST or not least < one / other < most:
                found.append(
                    f"frames: {a} to {b} is {one:.3f} m, {c} to {d} {other:.3f} m: no "
                    "body is like that; correct the points"
                )
    for name in p:
        twin = name.replace("left_", "right_")
        if twin != name and twin in p:
            if np.abs(p[name] * [1, -1, 1] - p[twin]).max() > _APART:
                found.append(f"frames: {name} and {twin} are not each other's mirror")
    if "left_shoulder" in p and p["left_shoulder"][1] < 0.0:
        found.append(
            "frames: the left shoulder is on the right of what `facing` calls ahead"
        )
    return found


def number_alarms(robot: SourceRobot) -> list[str]:
    """Numbers of a robot's file that are read, and hardly meant."""
    moving = robot.controlled
    still = [joint.name for joint in moving if joint.lower == joint.upper]
    turns = [
        f"{joint.name} ({joint.lower:g} to {joint.upper:g})"
        for joint in moving
        if joint.kind != "prismatic" and _MOST_TURNED < joint.upper < np.inf
    ]
    masses = {name: link.mass for name, link in robot.links.items()}
    negative = [f"{name} ({mass:g} kg)" for name, mass in masses.items() if mass < 0.0]
    found = []
    if still:
        which = "all joints" if len(still) == len(moving) else ", ".join(still)
        found.append(
            f"limits: lower = upper of {which}: they cannot move; correct the file, or "
            "list them in locked"
        )
    if turns:
        found.append(
            f"limits: {', '.join(turns)} rad, several turns each: are these degrees? "
            "They were taken for radians"
        )
    if negative:
        found.append(
            f"masses: negative of {', '.join(negative)}: taken for none; correct the "
            "file"
        )
    return found


def mirrored_range_alarms(robot: SourceRobot, anatomy: Arms | None) -> list[str]:
    """Joints of a left limb whose range is not that of the right one's mirror image.

    Either both limbs are of one make, or one of the two bends to the wrong side, by a
    sign of its axis or of its limits.
    """
    pairs = filter(None, (anatomy, find_leg_chains(robot, anatomy)))
    twins = [twin for a, b in pairs for twin in zip(a.joints, b.joints, strict=True)]
    X, found = robot.poses(), []
    for left, right in twins:
        p_left, p_right = (X[j.child].translation() for j in (left, right))
        apart = np.abs(p_left * [1, -1, 1] - p_right).max()
        still = robot.is_weld(left) or robot.is_weld(right)
        if still or "prismatic" in (left.kind, right.kind) or apart > _APART:
            continue
        # The mirror image of a turn about an axis is one about the axis' image, back.
        sense = float(joint_axis(X, right) @ (joint_axis(X, left) * [-1, 1, -1]))
        if abs(sense) < _PARALLEL:
            continue
        lower, upper = sorted(np.sign(sense) * np.array([left.lower, left.upper]))
        common = min(upper, right.upper) - max(lower, right.lower)
        if common < _ALIKE * min(upper - lower, right.upper - right.lower):
            found.append(
                f"limits: {left.name} ({left.lower:g} to {left.upper:g}) and "
                f"{right.name} ({right.lower:g} to {right.upper:g} rad) do not mirror "
                "each other: if both sides are not of one make, one of them turns to "
                "the wrong side; check axes and limits in the file"
            )
    return found


def coupling_alarms(
    robot: SourceRobot, anatomy: Arms | None, locked: Positions
) -> list[str]:
    """Joints of arms that are locked since they follow another, or one follows them."""
    arms = anatomy.joints if anatomy else set()
    return [
        f"locked: {joint.name} follows {joint.mimic} (mimic), and the controller has "
        f"no coupled joints: both are locked, {joint.mimic} at {locked[joint.mimic]:g} "
        f"{robot.joints[joint.mimic].unit}; hold them there on the robot, too"
        for joint in robot.joints.values()
        if joint.mimic in locked and arms & {joint.name, joint.mimic}
    ]


def floor_alarms(
    robot: SourceRobot, rest: Positions, height: float, anatomy: Arms
) -> list[str]:
    """What of a robot with arms is below the floor in its rest posture, the root link
    so high above it [m]; or that it stands on its hands."""
    bottoms = lowest_points(robot, rest)
    lowest = {link: bottom + height for link, bottom in bottoms.items()}
    if not lowest:
        return []
    link = min(lowest, key=lowest.get)
    if lowest[link] < -_BELOW:
        return [
            f"rest_posture: {link} is {-1e3 * lowest[link]:.0f} mm below the floor; "
            "correct waist_z"
        ]
    hands = {below for arm in anatomy for below in robot.below(arm.joints[0].child)}
    if link in hands and abs(lowest[link]) < _BELOW:
        return [
            f"rest_posture: nothing is lower than {link}, so that the robot stands on "
            "its hands; set waist_z to the height of a waist"
        ]
    return []


def pair_alarms(
    robot: SourceRobot,
    segments: Looks,
    rest: Positions,
    pairs: Sequence[Sequence[str]],
    overlapping: Sequence[Sequence[str]],
) -> list[str]:
    """Pairs that nobody watches although they could hurt.

    Links one joint apart always touch, and neighbours two joints apart may, if their
    real shapes do. All others of those that are `overlapping`, not watched since their
    capsules touch in the rest posture, are named here.
    """
    found = []
    if not pairs:
        found.append(
            "pairs: no pair of links is watched: nothing keeps the robot from running "
            "into itself"
        )
    X, surfaces = robot.posed(rest), Surfaces(segments)
    thick = []
    for a, b in overlapping:
        count = len(robot.between(a, b))
        if count < NEIGHBOURS:
            continue
        touch = surfaces.gap(X, a, b) < _TOUCH
        if count == NEIGHBOURS:
            thick += [] if touch else [f"{a} - {b}"]
            continue
        why = (
            "their real shapes touch, too: change rest_posture"
            if touch
            else f"their real shapes do not: {_REMEDY}"
        )
        found.append(
            f"pairs: {a} - {b} is NOT watched, {count} joints apart: their capsules "
            f"touch in the rest posture; {why}"
        )
    if thick:
        found.append(
            f"pairs: {', '.join(thick)}: NOT watched, {NEIGHBOURS} joints apart: "
            "their capsules touch in the rest posture; their real shapes do not: "
            f"{_REMEDY}"
        )
    return found
