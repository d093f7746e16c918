"""A first guess at a motion's points on a robot, and at a single arm's tool."""

from collections.abc import Sequence

import numpy as np

from crar_drake.robot_import.anatomy import (
    FEWEST_JOINTS,
    MIRROR_TOLERANCE,
    Arm,
    Arms,
    axes_crossing,
    elbow_index,
    find_leg_chains,
    frame_at,
    joint_axis,
    knee_index,
    longest_chains,
    shoulder_point,
    welded_below,
    wrist_joint,
)
from crar_drake.robot_import.choices import FrameChoice
from crar_drake.robot_import.meshes import lowest_points, vertices_of
from crar_drake.robot_import.source_robot import Joint, Poses, SourceRobot

LEG_POINTS = ("hip", "knee", "foot")

_TOOLS = ("tcp", "tool", "grasp", "end_effector", "ee_link", "eef")  # best first
_ON_FLOOR = 0.2  # [m] that a root link on wheels is above the floor, at most
_WAIST_SHARE = 0.62  # of a person's neck's height
_ABOVE = 0.03  # [m] above the shoulders that a head reaches, at least
_TRUNK_SHARE = 0.9  # of a person's arm, from shoulder to wrist


def guess_frames(robot: SourceRobot, anatomy: Arms) -> dict[str, FrameChoice]:
    """The points that a motion of joint centres needs, on the robot.

    Shoulder: where the axes of the arm's second and third joint come nearest, or of
    its first and second where those are parallel.
    Elbow: origin of the joint after the shoulder's three, or of that named elbow, if
    it bends the arm between two parts of similar length; else of one that does.
    Wrist: origin of the last joint but one after the elbow, if there are two. Where
    the forearm is the last link, at 80 % of its reach.
    An origin may lie anywhere along its axis: where left and right do not mirror each
    other it is the axes' points that are nearest to the shoulder.
    Neck: between the shoulders. Waist: the root link, or where a body has it if that is
    on wheels, below all of the robot or elsewhere far from there.
    """
    X, frames = robot.poses(), {}
    shoulders = [shoulder_point(X, arm) for arm in anatomy]
    numbers = [elbow_index(X, arm) for arm in anatomy]
    elbows = [arm.joints[i] for arm, i in zip(anatomy, numbers, strict=True)]
    wrists = [wrist_joint(X, *each) for each in zip(anatomy, numbers, strict=True)]
    p_elbows = _on_axes(X, elbows, shoulders)
    p_wrists = [wrist and X[wrist.child].translation() for wrist in wrists]
    if all(wrists):
        p_wrists = _on_axes(X, wrists, shoulders)
    for i, (side, arm) in enumerate(anatomy._asdict().items()):
        frames[f"{side}_shoulder"] = frame_at(X, arm.joints[1].parent, shoulders[i])
        frames[f"{side}_elbow"] = frame_at(X, elbows[i].child, p_elbows[i])
        at_wrist = at_hand = FrameChoice(arm.hand)
        if wrists[i] is not None:
            at_wrist = frame_at(X, wrists[i].parent, p_wrists[i])
        elif (tip := _forearm_tip(robot, arm, numbers[i])) is not None:
            # A forearm without a hand has its own at the wrist, too, not at the elbow.
            at_wrist = at_hand = frame_at(X, arm.hand, tip)
        frames[f"{side}_wrist"], frames[f"{side}_hand"] = at_wrist, at_hand
    p_neck = np.mean(shoulders, axis=0)
    frames["neck"] = frame_at(X, anatomy.left.trunk, p_neck)
    p_waist = _waist_above_wheels(robot, anatomy, p_neck)
    if p_waist is None:
        limbs = [("shoulder", "elbow"), ("elbow", "wrist")]
        p = {name: frame.place(X) for name, frame in frames.items()}
        arm_length = sum(
            np.linalg.norm(p[f"left_{a}"] - p[f"left_{b}"]) for a, b in limbs
        )
        p_waist = _waist_far_from_root(robot, anatomy, p_neck, arm_length)
        # A body's waist is above what it stands on, a table, too.
        floor = min(lowest_points(robot).values(), default=-np.inf)
        if (robot.X_FR.translation() if p_waist is None else p_waist)[2] <= floor:
            p_waist = _waist_above(floor, p_neck)
    frames["waist"] = (
        FrameChoice(robot.root) if p_waist is None else frame_at(X, robot.root, p_waist)
    )
    order = ("waist", "neck")
    return {name: frames[name] for name in (*order, *sorted(set(frames) - set(order)))}


def _on_axes(
    X: Poses, joints: Sequence[Joint], p_shoulders: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """The origins of a left joint and a right one if they mirror each other, else the
    points of their axes that are nearest to the shoulders; in the root's frame."""
    left, right = (X[joint.child].translation() for joint in joints)
    if np.abs(left - right * [1, -1, 1]).max() <= MIRROR_TOLERANCE:
        return [left, right]
    axes = [joint_axis(X, joint) for joint in joints]
    return [
        origin + axis * (axis @ (p_shoulder - origin))
        for origin, axis, p_shoulder in zip(
            (left, right), axes, p_shoulders, strict=True
        )
    ]


def _forearm_tip(robot: SourceRobot, arm: Arm, elbow: int) -> np.ndarray | None:
    """Where a forearm's wrist would be that has no hand: 80 % of the way to its tip.

    None where the hand is a link of its own, away from the elbow, or has no look.
    """
    X, look = robot.poses(), robot.looks.get(arm.hand)
    p_elbow = X[arm.joints[elbow].child].translation()
    if np.linalg.norm(X[arm.hand].translation() - p_elbow) > 0.03 or not look:
        return None
    from_elbow = vertices_of(look, X[arm.hand]) - p_elbow
    reach = np.linalg.norm(from_elbow, axis=1)
    # The middle of what is near the tip, not its outermost corner.
    tip = from_elbow[reach > 0.9 * reach.max()].mean(axis=0)
    return p_elbow + 0.8 * tip


def on_wheels(robot: SourceRobot) -> bool:
    """Whether the root link is on the floor, with wheels around it or a name so."""
    bottoms = lowest_points(robot).values()
    if not bottoms:
        return False
    near = [robot.root, *(j.child for j in robot.joints.values())]
    words = ("wheel", "footprint", "caster", "mobile_base")
    named = any(word in link.lower() for link in near for word in words)
    return named and robot.X_FR.translation()[2] - min(bottoms) < _ON_FLOOR


def _waist_above(floor: float, p_neck: np.ndarray) -> np.ndarray:
    """A person's share of the way up from the floor to the neck."""
    return np.array([*p_neck[:2], floor + _WAIST_SHARE * (p_neck[2] - floor)])


def _waist_above_wheels(
    robot: SourceRobot, anatomy: Arms, p_neck: np.ndarray
) -> np.ndarray | None:
    """The waist of a robot whose root is on wheels; None for others.

    It is where the trunk turns, if that is at a waist's height, else at a person's
    share of the neck's height.
    """
    if not on_wheels(robot):
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
    return _waist_above(bottom, p_neck)


def _waist_far_from_root(
    robot: SourceRobot, anatomy: Arms, p_neck: np.ndarray, arm_length: float
) -> np.ndarray | None:
    """The waist of a robot whose root link is not near where a body has it; else None.

    On legs it is between the hips, if the root is not about there. Without legs it is
    as far below the neck as a person's is, by the length from shoulder to wrist, if the
    root is much nearer to the neck or farther from it.
    """
    X = robot.poses()
    legs = find_leg_chains(robot, anatomy)
    if legs is not None:
        p_hips = np.mean([X[leg.joints[0].child].translation() for leg in legs], axis=0)
        trunk = p_neck[2] - p_hips[2]
        if -0.6 * trunk < X[robot.root].translation()[2] - p_hips[2] < 0.6 * trunk:
            return None
        return p_hips
    trunk = p_neck[2] - X[robot.root].translation()[2]
    if 0.25 * arm_length < trunk < 1.5 * arm_length:
        return None
    return p_neck - [0.0, 0.0, _TRUNK_SHARE * arm_length]


def guess_leg_and_head_frames(
    robot: SourceRobot, anatomy: Arms
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
    head = _head(robot, anatomy)
    if head is not None:
        frames["head"] = head
    wanted = [f"{side}_{name}" for side in ("left", "right") for name in LEG_POINTS]
    return frames, [name for name in (*wanted, "head") if name not in frames]


def has_feet(robot: SourceRobot, anatomy: Arms) -> bool:
    """Whether there are two legs, each with something at its end to stand on."""
    legs = find_leg_chains(robot, anatomy)
    ends = [leg.joints[-1].child for leg in legs or ()]
    return bool(ends) and all(
        any(robot.looks.get(link) for link in (end, *welded_below(robot, end)))
        for end in ends
    )


def _of_leg(robot: SourceRobot, leg: Arm) -> dict[str, FrameChoice]:
    X, joints = robot.poses(), leg.joints
    frames = {"foot": FrameChoice(joints[-1].child)}
    knee = knee_index(X, leg)
    if knee is None:
        return frames
    frames["knee"] = FrameChoice(joints[knee].child)
    p_hip = X[joints[0].child].translation()
    if knee >= 2:
        p_hip = axes_crossing(X, joints[knee - 2], joints[knee - 1])
    frames["hip"] = frame_at(X, joints[knee - 1].child, p_hip)
    return frames


def _head(robot: SourceRobot, anatomy: Arms) -> FrameChoice | None:
    X = robot.poses()
    _, middle, shoulders = np.mean(
        [X[arm.joints[0].child].translation() for arm in anatomy], axis=0
    )
    # Neither the arms nor what carries them.
    apart = {link for arm in anatomy for link in robot.below(arm.joints[0].child)}
    apart |= {joint.parent for arm in anatomy for joint in robot.path_to(arm.hand)}
    found = {}
    for link in robot.below(robot.root):
        if link in apart or not robot.looks.get(link):
            continue
        p = vertices_of(robot.looks[link], X[link])
        above = p[p[:, 2] > shoulders + _ABOVE]
        if len(above) and above[:, 1].min() < middle < above[:, 1].max():
            size = float(np.prod(np.ptp(above, axis=0)))
            centre = (above.min(axis=0) + above.max(axis=0)) / 2.0
            found["head" in link.lower(), size] = (link, centre)
    if not found:
        return None
    return frame_at(X, *found[max(found)])


def guess_tool(robot: SourceRobot) -> dict[str, FrameChoice]:
    """The tool of a robot with one arm: the end of its only longest chain.

    It is what is welded there and named so, else the last link without geometry,
    else the hand. Robots without such a chain of four or more joints have none.
    """
    end, *others = longest_chains(robot)
    way = robot.moving_to(end)
    if len(way) < FEWEST_JOINTS or others:
        return {}
    welded = welded_below(robot, way[-1].child)
    for word in _TOOLS:
        for link in welded:
            if word in link.lower():
                return {"tool": FrameChoice(link)}
    bare = [link for link in welded if robot.is_bare(link)]
    return {"tool": FrameChoice(bare[-1] if bare else end)}
