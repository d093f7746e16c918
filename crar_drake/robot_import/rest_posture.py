"""The posture that a robot rests in, and how high it stands."""

import itertools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.errors import ModelError
from crar_drake.robot.description import RootPose, find_joint
from crar_drake.robot_import.anatomy import (
    LATERAL,
    Arm,
    Arms,
    elbow_index,
    find_anatomy,
    find_leg_chains,
    joint_axis,
    knee_index,
)
from crar_drake.robot_import.capsule_fitting import Capsules
from crar_drake.robot_import.choices import FrameChoice
from crar_drake.robot_import.import_report import ImportReport
from crar_drake.robot_import.meshes import lowest_points
from crar_drake.robot_import.pair_sampling import CLEAR, gaps
from crar_drake.robot_import.source_robot import WORLD, Joint, Positions, SourceRobot

# How far arms are from the trunk at rest and how far hips roll outwards, tried in turn
# until nothing touches [rad].
_AWAY = (0.25, 0.4, 0.6)
_SPREAD = (0.0, 0.1, 0.2)
_ELBOW = 0.6  # [rad] that an elbow is bent by
_EVEN = 0.05  # by which an elbow's ranges both ways differ that are as large
_MOVES = 1e-3  # [m] a wrist, at least, if it says which way an elbow is to bend
_KNEE = 0.4  # [rad] that a knee is bent by
_STRAIGHT = 0.2  # [rad] that a knee is bent by at zero, at most, to be bent further
_SOCKET = 3  # joints of a hip or a shoulder, which what they join is built around


def rest_root_pose(robot: SourceRobot, height: float) -> RootPose:
    """Where the root link rests when it is so high above the ground [m]."""
    X_WR = RigidTransform(np.array([0.0, 0.0, height])) @ robot.X_FR
    return RootPose(
        [round(float(x), 9) for x in X_WR.translation()],
        [round(float(x), 9) for x in RollPitchYaw(X_WR.rotation()).vector()],
    )


def guess_rest_posture(robot: SourceRobot, report: ImportReport) -> None:
    """Fills in the rest posture where the import file leaves it out."""
    choices = report.choices
    if choices.rest_posture is not None:
        return
    anatomy = find_anatomy(robot)
    own = bool(choices.srdf and robot.posture)
    if anatomy and not own:
        rest, knees = _clear_rest(robot, anatomy, report.capsules(), choices.frames)
        also = " and knees" if knees else ""
        how = f"zero, arms a little out, elbows{also} bent, standing on the ground"
    else:
        rest = guess_rest(robot, None)
        if own:
            how = f"a posture of {Path(choices.srdf).name}"
        elif robot.posture:
            how = "a keyframe of the file"
        else:
            how = "the middle of each joint's range"
    if choices.base == "prescribed" or (anatomy and robot.root != WORLD):
        bottoms = lowest_points(robot, rest)
        height = -min(bottoms.values(), default=0.0)
        rest = {"waist_z": round(height, 4)} | rest
    choices.rest_posture = rest
    report.guessed["rest_posture"] = how


def _clear_rest(
    robot: SourceRobot,
    anatomy: Arms,
    capsules: Capsules,
    frames: dict[str, FrameChoice],
) -> tuple[dict[str, float], bool]:
    """The first of some rest postures, arms ever farther out and legs farther apart, in
    which the fewest capsules touch that no hip or shoulder joins; and if knees bend."""
    links = [name for name in capsules if capsules[name]]
    pairs = [
        pair
        for pair in itertools.combinations(links, 2)
        if len(robot.between(*pair)) > _SOCKET
    ]
    found = []
    for away, spread in itertools.product(_AWAY, _SPREAD):
        arms = guess_rest(robot, anatomy, away, frames)
        legs = bent_knees(robot, anatomy, spread)
        rest = arms | legs
        distances = gaps(capsules, pairs, robot.posed(rest))
        touching = np.count_nonzero(distances < CLEAR)
        found.append((touching, rest, bool(legs)))
    _, rest, knees = min(found, key=lambda each: each[0])
    return rest, knees


def guess_rest(
    robot: SourceRobot,
    anatomy: Arms | None,
    away: float = _AWAY[0],
    frames: Mapping[str, FrameChoice] | None = None,
) -> dict[str, float]:
    """Arms a little `away` [rad] from the trunk and elbows bent: clear of limits, of
    the trunk, and of the singular pose of a straight arm. A robot without a pair of
    arms has its joints as the file's own posture, else in the middle of their ranges.

    An elbow bends to where its range is larger; if that is as large both ways, as a
    person's: the wrist goes ahead or, where it moves more that way, up. Wrists are
    where the motion's points `frames` say, else at the hands.
    """
    rest = {}
    for joint in robot.controlled:
        if anatomy is None and robot.posture:
            own = robot.posture.get(joint.name, 0.0)
            rest[joint.name] = float(np.clip(own, joint.lower, joint.upper))
        elif anatomy is None and np.isfinite(joint.upper - joint.lower):
            rest[joint.name] = (joint.lower + joint.upper) / 2.0
        else:
            rest[joint.name] = _inside(joint, 0.0)
    X_zero = robot.poses()
    straight = dict(rest)
    sides = zip(anatomy or (), ("left", "right"), (1.0, -1.0), strict=False)
    for arm, side, outwards in sides:
        elbow = elbow_index(X_zero, arm)
        moved = {}
        for joint in (j for j in arm.joints[:elbow] if j.name in rest):
            for angle in (-away, away):
                there = rest[joint.name] + angle
                if joint.lower < there < joint.upper:
                    X = robot.posed({**straight, joint.name: there})
                    y = X[arm.joints[elbow].child].translation()[1]
                    moved[outwards * y] = (joint.name, there)
        if moved:
            name, there = moved[max(moved)]
            rest[name] = there
        bend = arm.joints[elbow]
        if bend.name not in rest:
            continue
        wrist = (frames or {}).get(f"{side}_wrist", FrameChoice(arm.hand))
        rest[bend.name] = _bent_elbow(robot, rest, bend, wrist)
    return {name: round(value, 4) for name, value in rest.items() if value}


def _bent_elbow(
    robot: SourceRobot, posture: Positions, elbow: Joint, wrist: FrameChoice
) -> float:
    """Where an elbow is bent [rad], see `guess_rest`."""
    here = posture[elbow.name]
    fewer, more = np.clip([here - _ELBOW, here + _ELBOW], elbow.lower, elbow.upper)
    to_more = elbow.upper > -elbow.lower
    if np.isclose(elbow.upper, -elbow.lower, rtol=_EVEN):
        places = [
            wrist.place(robot.posed({**posture, elbow.name: angle}))
            for angle in (fewer, more)
        ]
        x, _, z = places[1] - places[0]
        ahead = x if abs(x) > abs(z) else z
        if abs(ahead) > _MOVES:
            to_more = ahead > 0.0
    return float(more if to_more else fewer)


def bent_knees(
    robot: SourceRobot, anatomy: Arms, spread: float = 0.0
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
        bent = _bent(robot, leg)
        if bent is None:
            return {}
        rest |= bent | _rolled(robot, leg, outwards * spread)
    return rest


def _bent(robot: SourceRobot, leg: Arm) -> dict[str, float] | None:
    X, joints = robot.posed(), leg.joints
    index = knee_index(X, leg)
    pitching = _turning(robot, leg, 1)
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
    turned = sign[knee.name] * np.clip(sign[knee.name] * _KNEE, knee.lower, knee.upper)
    c, s = np.cos(turned), np.sin(turned)
    bent_shank = [c * shank[0] + s * shank[2], 0.0, c * shank[2] - s * shank[0]]
    by_hip = _pitch(thigh + shank) - _pitch(thigh + bent_shank)
    turns = (by_hip, turned, -by_hip - turned)
    return {
        joint.name: round(_inside(joint, float(sign[joint.name] * by)), 4)
        for joint, by in zip((hip, knee, ankle), turns, strict=True)
    }


def _rolled(robot: SourceRobot, leg: Arm, angle: float) -> dict[str, float]:
    """Hip and ankle, rolled against each other about the axis ahead."""
    X = robot.posed()
    knee = knee_index(X, leg)
    rolls = _turning(robot, leg, 0)
    if not angle or not rolls or not rolls[0] < knee < rolls[-1]:
        return {}
    turns = ((leg.joints[rolls[0]], angle), (leg.joints[rolls[-1]], -angle))
    return {
        joint.name: round(_inside(joint, np.sign(joint_axis(X, joint)[0]) * by), 4)
        for joint, by in turns
    }


def _turning(robot: SourceRobot, leg: Arm, axis: int) -> list[int]:
    """Which of a leg's joints are free to turn about an axis of the robot."""
    X = robot.posed()
    return [
        i
        for i, joint in enumerate(leg.joints)
        if abs(joint_axis(X, joint)[axis]) > LATERAL and not robot.is_weld(joint)
    ]


def _pitch(v: np.ndarray) -> float:
    """The angle about +y from straight down to a vector [rad]."""
    return float(np.arctan2(-v[0], -v[2]))


def _inside(joint: Joint, position: float) -> float:
    """Where a joint is nearest to a position with something left to its limits."""
    inside = min(0.05, (joint.upper - joint.lower) / 4.0)
    return float(np.clip(position, joint.lower + inside, joint.upper - inside))


def rest_positions(
    plant: MultibodyPlant, rest_posture: Positions, file: Path
) -> np.ndarray:
    """(nq,) a rest posture in the plant; ModelError if it has no such joint."""
    q = plant.GetPositions(plant.CreateDefaultContext())
    for name, value in rest_posture.items():
        try:
            joint = find_joint(plant, name)
        except ModelError as error:
            raise ModelError(f"{file}: rest_posture: {error}") from error
        if joint.num_positions() != 1:
            raise ModelError(f"{file}: rest_posture: joint {name!r} is locked")
        q[joint.position_start()] = value
    return q
