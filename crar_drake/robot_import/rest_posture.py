"""The posture that a robot rests in, and how high it stands."""

import itertools
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.errors import ModelError
from crar_drake.robot.description import RootPose, find_joint
from crar_drake.robot_import.alarms import joints_between
from crar_drake.robot_import.anatomy import AWAY, Arms, find_anatomy, guess_rest
from crar_drake.robot_import.capsule_fitting import Capsules
from crar_drake.robot_import.choices import FrameChoice
from crar_drake.robot_import.import_report import ImportReport
from crar_drake.robot_import.leg_and_head_frames import bent_knees
from crar_drake.robot_import.meshes import Looks, lowest_points
from crar_drake.robot_import.pair_sampling import CLEAR, gaps
from crar_drake.robot_import.source_robot import WORLD, Positions, SourceRobot

# How far arms are from the trunk at rest and how far hips roll outwards, tried in turn
# until nothing touches [rad].
_AWAY = (AWAY, 0.4, 0.6)
_SPREAD = (0.0, 0.1, 0.2)
_SOCKET = 3  # joints of a hip or a shoulder, which what they join is built around


def rest_root_pose(robot: SourceRobot, height: float) -> RootPose:
    """Where the root link rests when it is so high above the ground [m]."""
    X_WR = RigidTransform(np.array([0.0, 0.0, height])) @ robot.X_FR
    return RootPose(
        [round(float(x), 9) for x in X_WR.translation()],
        [round(float(x), 9) for x in RollPitchYaw(X_WR.rotation()).vector()],
    )


def guess_rest_posture(
    robot: SourceRobot, locked: Positions, parts: Looks, report: ImportReport
) -> None:
    """Fills in the rest posture where the import file leaves it out."""
    choices = report.choices
    if choices.rest_posture is not None:
        return
    anatomy = find_anatomy(robot)
    own = bool(choices.srdf and robot.posture)
    if anatomy and not own:
        rest, knees = _clear_rest(
            robot, anatomy, locked, report.capsules(), choices.frames
        )
        also = " and knees" if knees else ""
        how = f"arms a little out, elbows{also} bent, standing on the ground"
    else:
        rest = guess_rest(robot, None, locked)
        if own:
            how = f"a posture of {Path(choices.srdf).name}"
        elif robot.posture:
            how = "a keyframe of the file"
        else:
            how = "the middle of each joint's range"
    if choices.base == "prescribed" or (anatomy and robot.root != WORLD):
        bottoms = lowest_points(robot, parts, {**locked, **rest})
        height = -min(bottoms.values(), default=0.0)
        rest = {"waist_z": round(height, 4)} | rest
    choices.rest_posture = rest
    report.guessed["rest_posture"] = how


def _clear_rest(
    robot: SourceRobot,
    anatomy: Arms,
    locked: Positions,
    capsules: Capsules,
    frames: dict[str, FrameChoice],
) -> tuple[dict[str, float], bool]:
    """The first of some rest postures, arms ever farther out and legs farther apart, in
    which the fewest capsules touch that no hip or shoulder joins; and if knees bend."""
    links = [name for name in capsules if capsules[name]]
    pairs = [
        pair
        for pair in itertools.combinations(links, 2)
        if joints_between(robot, locked, *pair) > _SOCKET
    ]
    found = []
    for away, spread in itertools.product(_AWAY, _SPREAD):
        arms = guess_rest(robot, anatomy, locked, away, frames)
        legs = bent_knees(robot, anatomy, locked, spread)
        rest = arms | legs
        distances = gaps(capsules, pairs, robot.poses({**locked, **rest}))
        touching = np.count_nonzero(distances < CLEAR)
        found.append((touching, rest, bool(legs)))
    _, rest, knees = min(found, key=lambda each: each[0])
    return rest, knees


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
