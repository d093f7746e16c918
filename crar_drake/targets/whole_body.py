"""A performer's legs and head as ways of a robot's feet, knees and head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.multibody.tree import Joint
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import low_pass, spline
from crar_drake.motion.joint_centres import joint_centres
from crar_drake.motion.leg_shape import LegShape
from crar_drake.motion.performer import SIDES, Performer
from crar_drake.motion.quaternion_spline import QuaternionSpline
from crar_drake.motion.retarget import RetargetedMotion, SegmentLengths, retarget
from crar_drake.motion.retarget_legs import LegsMotion, retarget_legs
from crar_drake.motion.smooth_steps import soft_positive
from crar_drake.motion.travel import pinned_pelvis
from crar_drake.robot.model import ControlModel
from crar_drake.targets.ankle_limits import LegSolver
from crar_drake.targets.leg_room import LegClearance
from crar_drake.targets.leg_shapes import body_shapes
from crar_drake.targets.ways import CarriedTrajectory, PointTrajectory

FEET = tuple(f"{side}_foot" for side in SIDES)
KNEES = tuple(f"{side}_knee" for side in SIDES)
HEAD = "head"

# Elbows and hands have a thickness: their points stay so high above the floor [m].
_LEAST_HEIGHTS = {
    f"{side}_{joint}": height
    for side in SIDES
    for joint, height in (("elbow", 0.05), ("wrist", 0.08))
}
_SOFT = 0.01  # width of that bound [m]

# Below this neck and head have no direction worth keeping [m].
_SHORTEST_NECK = 1e-3


def follows_legs(model: ControlModel) -> bool:
    """Whether a task is a foot or a knee."""
    return any(task.frame in (*FEET, *KNEES) for task in model.tasks)


@dataclass(frozen=True, eq=False)
class WholeBodyMotion:
    """A motion for a whole robot.

    Attributes:
        upper: of what the waist carries.
        legs: of root and legs.
        shapes: of the robot's legs, by side.
        joints: of the robot's legs.
        positions: (T, n) that they have then [rad or m].
    """

    upper: RetargetedMotion
    legs: LegsMotion
    shapes: dict[str, LegShape]
    joints: list[Joint]
    positions: np.ndarray

    def way(self, frame: str) -> CarriedTrajectory | PointTrajectory:
        """The way of a foot or of a knee."""
        side, _, part = frame.partition("_")
        time = self.upper.time
        if part == "knee":
            return PointTrajectory(spline(time, self.legs.knees[side]))
        foot = self.legs.feet[side]
        turns = Rotation.from_quat(foot.turns)
        R_WF = turns * Rotation.from_matrix(self.shapes[side].foot)
        return CarriedTrajectory(
            PointTrajectory(spline(time, foot.positions)),
            QuaternionSpline(time, R_WF.as_quat()),
            np.zeros(3),
        )


def retarget_whole_body(
    model: ControlModel, performer: Performer, lengths: SegmentLengths, cutoff: float
) -> WholeBodyMotion:
    """A performer's whole body on a robot the root of which floats.

    Root and legs as `motion.retarget_legs` has them; what is above the waist is
    scaled as ever, and hangs on the waist where the root takes it.

    Args:
        model: the robot.
        performer: with legs.
        lengths: the robot's, above the waist.
        cutoff: of the low-pass [Hz].

    Raises:
        MotionError: the performer lacks something.
        ScenarioError: the robot does.
    """
    if pinned := pinned_pelvis(performer):
        raise MotionError(
            f"motion {performer.name}: {pinned}; a whole body needs a motion that says "
            "where the pelvis is in the room (experiments wrists and upper-body do not)"
        )
    shapes, trunk = body_shapes(model)
    solvers = {
        side: LegSolver(model, side, leg, performer.frame_rate)
        for side, leg in shapes.items()
    }

    def attainable(side, root_positions, root_turns, foot):
        return solvers[side].turns(root_positions, root_turns, foot)

    room = LegClearance(model, solvers, performer.frame_rate).room
    legs = retarget_legs(performer, shapes, cutoff, attainable, trunk, room)
    arm = Rotation.from_quat(legs.root_turns).apply(trunk.waist)
    waist = legs.root_positions + arm
    upper = retarget(joint_centres(performer), lengths, cutoff=cutoff, waist=waist)
    for name, height in _LEAST_HEIGHTS.items():
        p = upper.positions[name]
        p[:, 2] = height + soft_positive(p[:, 2] - height, _SOFT)
    joints = [joint for solver in solvers.values() for joint in solver.joints]
    positions = np.hstack([solver.positions for solver in solvers.values()])
    return WholeBodyMotion(upper, legs, shapes, joints, positions)


def head_way(
    performer: Performer, retargeted: RetargetedMotion, length: float, cutoff: float
) -> PointTrajectory:
    """The way of the head: from the neck as the performer's is.

    Args:
        performer: with a head.
        retargeted: where the neck is.
        length: from the robot's neck to its head [m].
        cutoff: of the low-pass [Hz].

    Raises:
        MotionError: the performer has no head, or it is where his neck is.
    """
    if "head" not in performer.positions:
        raise MotionError(f"motion {performer.name}: it has no head; leave that out")
    p = performer.positions
    way = low_pass(p["head"] - p["neck"], performer.frame_rate, cutoff)
    norm = np.linalg.norm(way, axis=1, keepdims=True)
    # Written so that a NaN fails, too.
    if not norm.min() >= _SHORTEST_NECK:
        raise MotionError(
            f"motion {performer.name}: neck and head coincide in frame "
            f"{int(norm.argmin()) + 1}, so that the neck has no direction"
        )
    return PointTrajectory(
        spline(retargeted.time, retargeted.positions["neck"] + length * way / norm)
    )
