"""What kind of body a robot has, where it is none that a person's motion fits."""

import itertools
from collections.abc import Mapping

import numpy as np
from pydrake.math import RollPitchYaw, RotationMatrix

from crar_drake.errors import ModelError
from crar_drake.robot_import.anatomy import (
    FEWEST_JOINTS,
    Arms,
    mirrored_chains,
    own_joints,
)
from crar_drake.robot_import.body_frames import LEG_POINTS
from crar_drake.robot_import.choices import FrameChoice
from crar_drake.robot_import.source_robot import Joint, Poses, SourceRobot

_SIDES = ("left", "right")
_UPPER = ("waist", "neck") + tuple(
    f"{side}_{point}" for side in _SIDES for point in ("shoulder", "elbow", "wrist")
)
_LIMB = 3  # joints of a limb, or of a finger, at least
_LONGEST_FINGER = 0.2  # [m], from the palm
_FINGERS = 3  # of a hand, at least
_DOWN = 0.1  # [m] that a leg hangs down, at least
_LARGEST_ANGLE = np.radians(45.0)
_QUADRUPED = "four legs and no arms, a quadruped"
_TO_DO = (
    "list them as frames in import.yaml (docs/guides/your-robot.md) and import again"
)


def refuse_hand(robot: SourceRobot) -> None:
    """Raises ModelError if the robot is a hand alone: all its limbs are fingers."""
    X, limbs = robot.poses(), own_joints(robot)
    reaches = [
        np.linalg.norm(X[end].translation() - X[joints[0].parent].translation())
        for end, joints in limbs.items()
        if len(joints) >= _LIMB
    ]
    if len(reaches) >= _FINGERS and max(reaches) < _LONGEST_FINGER:
        raise ModelError(
            f"{robot.path}: a hand with {len(reaches)} fingers, and neither a humanoid "
            "nor an arm; import the robot that carries it"
        )


def frame_alarms(
    robot: SourceRobot,
    anatomy: Arms | None,
    frames: Mapping[str, FrameChoice],
    floating: bool,
) -> list[str]:
    """Frames that a motion of a person needs and that are not there, and why; of a root
    that floats those of legs, too."""
    missing = [name for name in _UPPER if name not in frames]
    if missing:
        told = _why_no_arms(robot) if anatomy is None else "not all of it was found"
        if not told:
            return []
        if told == _QUADRUPED:
            return [f"frames: {told}: keyframes can be run, no motion of a person"]
        return [
            f"frames: {told}. Without {', '.join(missing)} no motion of a person can "
            f"be run, only keyframes; {_TO_DO}"
        ]
    wanted = [f"{side}_{point}" for side in _SIDES for point in LEG_POINTS]
    missing = [name for name in wanted if name not in frames]
    if not floating or not missing:
        return []
    return [
        f"frames: without {', '.join(missing)} no motion can be retargeted; {_TO_DO}"
    ]


def _why_no_arms(robot: SourceRobot) -> str:
    """Why a robot with several limbs has no left and right arm; "" of a single arm."""
    limbs = [joints for joints in own_joints(robot).values() if len(joints) >= _LIMB]
    if len(limbs) < 2:
        return ""
    X = robot.poses()
    pairs = mirrored_chains(robot, _LIMB)
    legs = [
        pair
        for pair in pairs
        if X[pair.left.joints[0].child].translation()[2]
        - X[pair.left.hand].translation()[2]
        > _DOWN
    ]
    if len(legs) > 1 and len(legs) == len(pairs):
        return _QUADRUPED
    for left, right in pairs:
        if len(left.joints) < FEWEST_JOINTS:
            return (
                f"the chains that end in {left.hand} and {right.hand} mirror each "
                f"other with {len(left.joints)} joints; arms are found that have "
                f"{FEWEST_JOINTS} or more"
            )
    for a, b in itertools.combinations(limbs, 2):
        if len(a) == len(b) >= FEWEST_JOINTS and _are_copies(X, a, b):
            return (
                f"the chains that end in {a[-1].child} and {b[-1].child} are alike, "
                "side by side: arms are found that mirror each other"
            )
    return "no pair of arms that mirror each other was found"


def _are_copies(X: Poses, a: list[Joint], b: list[Joint]) -> bool:
    """Whether one chain is the other in another place, turned or not."""

    def lengths(chain: list[Joint]) -> np.ndarray:
        p = np.array([X[joint.child].translation() for joint in chain])
        return np.linalg.norm(np.diff(p, axis=0), axis=1)

    return np.allclose(lengths(a), lengths(b), atol=1e-3)


def turned_hands(robot: SourceRobot, frames: Mapping[str, FrameChoice]) -> list[str]:
    """Hands whose x axis is not to the fingertips, as a motion's hands have it."""
    X, found = robot.poses(), []
    for side in _SIDES:
        if not {f"{side}_hand", f"{side}_wrist", f"{side}_elbow"} <= set(frames):
            continue
        forearm = frames[f"{side}_wrist"].place(X) - frames[f"{side}_elbow"].place(X)
        hand = frames[f"{side}_hand"]
        turned = RotationMatrix(RollPitchYaw(hand.rpy))
        x = X[hand.link].rotation().multiply(turned).matrix()[:, 0]
        angle = np.arccos(np.clip(x @ forearm / np.linalg.norm(forearm), -1.0, 1.0))
        if angle > _LARGEST_ANGLE:
            found.append(f"{side}_hand ({np.degrees(angle):.0f}°)")
    if not found:
        return []
    return [
        f"frames: x of {', '.join(found)} does not point along the forearm to the "
        "fingertips. Points follow all the same; before you use its orientation turn "
        "it: rpy in import.yaml"
    ]
