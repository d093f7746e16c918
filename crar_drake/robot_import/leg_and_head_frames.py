"""A first guess at a motion's points on legs and head, and at knees that are bent."""

import numpy as np

from crar_drake.robot_import.anatomy import (
    Arm,
    Arms,
    axes_crossing,
    find_leg_chains,
    frame_at,
    joint_axis,
    welded_below,
)
from crar_drake.robot_import.choices import FrameChoice
from crar_drake.robot_import.meshes import Looks, vertices_of
from crar_drake.robot_import.source_robot import Joint, Poses, Positions, SourceRobot

LEG_POINTS = ("hip", "knee", "foot")

_UNEVEN = 2.0  # thigh over shank, or the other way
_LATERAL = 0.8  # of a knee's axis, along the left; of a roll's, ahead
_BENT = 0.4  # [rad] of a knee, at rest
_STRAIGHT = 0.2  # [rad] that a knee is bent by at zero, at most, to be bent further
_ABOVE = 0.03  # [m] above the shoulders that a head reaches, at least


def guess_leg_and_head_frames(
    robot: SourceRobot, anatomy: Arms, parts: Looks | None = None
) -> tuple[dict[str, FrameChoice], list[str]]:
    """Hips, knees, feet and head, and which of them were not found.

    Knee: origin of the joint with a lateral axis that divides the leg most evenly.
    Hip: where the axes of the two joints before the knee come nearest.
    Foot: origin of the last joint, the ankle.
    Head: middle of what one link has above the shoulders, on both sides of the middle;
    the link is neither an arm's nor the trunk, and called head or else the largest.
    """
    frames: dict[str, FrameChoice] = {}
    legs = find_leg_chains(robot, anatomy)
    for side, leg in zip(("left", "right"), legs or (), strict=False):
        frames |= {f"{side}_{name}": at for name, at in _of_leg(robot, leg).items()}
    head = _head(robot, anatomy, parts or {})
    if head is not None:
        frames["head"] = head
    wanted = [f"{side}_{name}" for side in ("left", "right") for name in LEG_POINTS]
    return frames, [name for name in (*wanted, "head") if name not in frames]


def has_feet(robot: SourceRobot, anatomy: Arms, parts: Looks) -> bool:
    """Whether there are two legs, each with something at its end to stand on."""
    legs = find_leg_chains(robot, anatomy)
    ends = [leg.joints[-1].child for leg in legs or ()]
    return bool(ends) and all(
        any(parts.get(link) for link in (end, *welded_below(robot, end)))
        for end in ends
    )


def _of_leg(robot: SourceRobot, leg: Arm) -> dict[str, FrameChoice]:
    X, joints = robot.poses(), leg.joints
    frames = {"foot": FrameChoice(joints[-1].child)}
    knee = _knee_index(X, leg)
    if knee is None:
        return frames
    frames["knee"] = FrameChoice(joints[knee].child)
    p_hip = X[joints[0].child].translation()
    if knee >= 2:
        p_hip = axes_crossing(X, joints[knee - 2], joints[knee - 1])
    frames["hip"] = frame_at(X, joints[knee - 1].child, p_hip)
    return frames


def _knee_index(X: Poses, leg: Arm) -> int | None:
    """Which joint of a leg is the knee; None if none divides it like one."""
    p = [X[joint.child].translation() for joint in leg.joints]
    uneven = {}
    for index in range(1, len(p) - 1):
        thigh = np.linalg.norm(p[index] - p[0])
        shank = np.linalg.norm(p[-1] - p[index])
        lateral = abs(joint_axis(X, leg.joints[index])[1]) > _LATERAL
        if lateral and min(thigh, shank) > 1e-3:
            uneven[index] = abs(np.log(thigh / shank))
    if not uneven:
        return None
    best = min(uneven, key=uneven.get)
    return best if uneven[best] < np.log(_UNEVEN) else None


def bent_knees(
    robot: SourceRobot, anatomy: Arms, locked: Positions, spread: float = 0.0
) -> dict[str, float]:
    """Joint to position [rad] of two legs that stand with their knees a little bent.

    A straight leg is singular: no step of a foot bends it, and what does may bend it
    either way. The ankle stays where it is from the hip but for its distance, the sole
    as it is turned. Each hip rolls outwards by `spread` [rad], and the ankle back.
    Empty where legs have no such joints, or are bent at zero already.
    """
    rest: dict[str, float] = {}
    legs = find_leg_chains(robot, anatomy) or ()
    for leg, outwards in zip(legs, (1.0, -1.0), strict=False):
        bent = _bent(robot, leg, locked)
        if bent is None:
            return {}
        rest |= bent | _rolled(robot, leg, locked, outwards * spread)
    return rest


def _bent(robot: SourceRobot, leg: Arm, locked: Positions) -> dict[str, float] | None:
    X, joints = robot.poses(locked), leg.joints
    index = _knee_index(X, leg)
    pitching = [
        i
        for i, joint in enumerate(joints)
        if abs(joint_axis(X, joint)[1]) > _LATERAL and joint.name not in locked
    ]
    if index not in pitching or pitching[0] == index or pitching[-1] == index:
        return None
    place = pitching.index(index)
    hip, knee, ankle = (joints[i] for i in pitching[place - 1 : place + 2])
    p_hip, p_knee, p_ankle = (X[j.child].translation() for j in (hip, knee, ankle))
    thigh, shank = p_knee - p_hip, p_ankle - p_knee
    straight = _pitch(thigh)
    if abs(_pitch(shank) - straight) > _STRAIGHT:
        return None
    sign = {j.name: np.sign(joint_axis(X, j)[1]) for j in (hip, knee, ankle)}
    # Knees bend ahead of the leg, so that the shank turns to the back, about +y.
    turned = sign[knee.name] * np.clip(sign[knee.name] * _BENT, knee.lower, knee.upper)
    c, s = np.cos(turned), np.sin(turned)
    bent_shank = [c * shank[0] + s * shank[2], 0.0, c * shank[2] - s * shank[0]]
    by_hip = _pitch(thigh + shank) - _pitch(thigh + bent_shank)
    turns = (by_hip, turned, -by_hip - turned)
    return {
        joint.name: round(_inside(joint, float(sign[joint.name] * by)), 4)
        for joint, by in zip((hip, knee, ankle), turns, strict=True)
    }


def _rolled(
    robot: SourceRobot, leg: Arm, locked: Positions, angle: float
) -> dict[str, float]:
    """Hip and ankle, rolled against each other about the axis ahead."""
    X = robot.poses(locked)
    knee = _knee_index(X, leg)
    axes = [joint_axis(X, joint)[0] for joint in leg.joints]
    rolls = [
        i
        for i, (joint, along) in enumerate(zip(leg.joints, axes, strict=True))
        if abs(along) > _LATERAL and joint.name not in locked
    ]
    if not angle or not rolls or not rolls[0] < knee < rolls[-1]:
        return {}
    return {
        leg.joints[i].name: round(_inside(leg.joints[i], np.sign(axes[i]) * by), 4)
        for i, by in ((rolls[0], angle), (rolls[-1], -angle))
    }


def _pitch(v: np.ndarray) -> float:
    """The angle about +y from straight down to a vector [rad]."""
    return float(np.arctan2(-v[0], -v[2]))


def _inside(joint: Joint, position: float) -> float:
    inside = min(0.05, (joint.upper - joint.lower) / 4.0)
    return float(np.clip(position, joint.lower + inside, joint.upper - inside))


def _head(robot: SourceRobot, anatomy: Arms, parts: Looks) -> FrameChoice | None:
    X = robot.poses()
    _, middle, shoulders = np.mean(
        [X[arm.joints[0].child].translation() for arm in anatomy], axis=0
    )
    # Neither the arms nor what carries them.
    apart = {link for arm in anatomy for link in robot.below(arm.joints[0].child)}
    apart |= {joint.parent for arm in anatomy for joint in robot.path_to(arm.hand)}
    found = {}
    for link in robot.below(robot.root):
        if link in apart or not parts.get(link):
            continue
        p = vertices_of(parts[link], X[link])
        above = p[p[:, 2] > shoulders + _ABOVE]
        if len(above) and above[:, 1].min() < middle < above[:, 1].max():
            size = float(np.prod(np.ptp(above, axis=0)))
            centre = (above.min(axis=0) + above.max(axis=0)) / 2.0
            found["head" in link.lower(), size] = (link, centre)
    if not found:
        return None
    return frame_at(X, *found[max(found)])
