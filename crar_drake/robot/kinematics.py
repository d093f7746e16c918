"""Drake's plant as the tree of frames that `law.kinematics` computes with."""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    Joint,
    PlanarJoint,
    PrismaticJoint,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RigidBody,
    ScrewJoint,
    UniversalJoint,
    WeldJoint,
)

from crar_drake.errors import ModelError
from crar_drake.law.kinematics import Tree

_X, _Y, _Z, _NONE = np.array([*np.eye(3), np.zeros(3)])


class JointTree:
    """The frames of a plant: the world, one for each velocity, two for a free joint.

    Attributes:
        tree: for the equations.
        turns, slides: (nv, 3) of each velocity, in the plant's order: the unit vector
            along its axis of rotation and its direction of sliding, in its own frame.
        frame_of_velocity: (nv,) the frame that each moves; of a free joint's, the one
            that does not turn.
        velocities: (N,) lists of the velocities that move each frame in its parent.
        moved_by: (N, nv) whether a velocity moves a frame.
    """

    def __init__(self, plant: MultibodyPlant) -> None:
        """
        Raises:
            ModelError: a joint is not free, and its velocities are not the rates of its
                positions.
        """
        nv = plant.num_velocities()
        self._parents, self._positions = [0], [0]
        self._poses = [RigidTransform()]  # in the parent, with the joint at 0
        self._axes = [(_NONE, _NONE)]
        self._free: list[tuple[int, int]] = []
        self.velocities: list[list[int]] = [[]]
        self.frame_of_velocity = np.zeros(nv, dtype=int)
        self.turns, self.slides = np.zeros((2, nv, 3))
        # Where each body is: its frame, and its pose there.
        self._at = {int(plant.world_body().index()): (0, RigidTransform())}
        joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
        while joints:
            ready = [j for j in joints if int(j.parent_body().index()) in self._at]
            if not ready:
                raise ModelError(
                    f"joint {joints[0].name()!r} is on a body that hangs on nothing"
                )
            for joint in ready:
                self._add(joint, plant)
            joints = [joint for joint in joints if joint not in ready]
        self.moved_by = np.zeros((len(self._parents), nv), dtype=bool)
        for frame in range(1, len(self._parents)):
            self.moved_by[frame] = self.moved_by[self._parents[frame]]
            self.moved_by[frame, self.velocities[frame]] = True
        self.tree = self._make_tree()

    def place(self, body: RigidBody) -> tuple[int, RigidTransform]:
        """The frame that a body is fixed to, and its pose X_FB in it."""
        return self._at[int(body.index())]

    def above(self, order: np.ndarray) -> np.ndarray:
        """(nv, nv) 1 where joint j carries joint i, i = j not included, by `order`."""
        own = self.frame_of_velocity[order]
        above = self.moved_by[own][:, order].astype(float, order="C")
        np.fill_diagonal(above, 0.0)
        return above

    def point(self, body: RigidBody, p_B: np.ndarray) -> tuple[int, np.ndarray]:
        """A point of a body, for `select`."""
        frame, X_FB = self.place(body)
        return frame, np.append(X_FB.multiply(p_B), 1.0)

    def vector(self, body: RigidBody, u_B: np.ndarray) -> tuple[int, np.ndarray]:
        """A vector that is fixed in a body, for `select`."""
        frame, X_FB = self.place(body)
        return frame, np.append(X_FB.rotation() @ u_B, 0.0)

    def axes(self, order: np.ndarray) -> list[tuple[int, np.ndarray]]:
        """The joints' axes by `order`, for `select`: as `joint_motion` takes them."""
        frames = self.frame_of_velocity[order]
        axes = [(frame, np.array([0.0, 0.0, 0.0, 1.0])) for frame in frames]
        for of in (self.turns[order], self.slides[order]):
            axes += [
                (frame, np.append(vector, 0.0))
                for frame, vector in zip(frames, of, strict=True)
            ]
        return axes

    def select(
        self, placed: Sequence[tuple[int, np.ndarray]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """What picks P points and vectors out of all frames' poses: (P, 4), (P,) of
        `place_points`.

        Args:
            placed: of each its frame, and (4,) homogeneous coordinates there: [p; 1]
                of a point, [u; 0] of a vector.
        """
        selection = np.array([coordinates for _, coordinates in placed])
        first = np.array([4 * frame for frame, _ in placed], dtype=int)
        return selection.reshape(-1, 4), first

    def _add(self, joint: Joint, plant: MultibodyPlant) -> None:
        """The frames of a joint, and where its child then is."""
        parent = int(joint.parent_body().index())
        frame, X = self._at[parent]
        X = X.multiply(joint.frame_on_parent().GetFixedPoseInBodyFrame())
        start, at = joint.velocity_start(), joint.position_start()
        if isinstance(joint, QuaternionFloatingJoint):
            turns, slides = range(start, start + 3), range(start + 3, start + 6)
            still = self._add_frame(frame, at, X, (_NONE, _NONE), slides)
            frame = self._add_frame(still, at, RigidTransform(), (_NONE, _NONE), turns)
            X = RigidTransform()
            self.frame_of_velocity[start : start + 6] = still
            self.turns[turns], self.slides[slides] = np.eye(3), np.eye(3)
            self._free.append((still, at))
        else:
            for i, motion in enumerate(_motions(joint, plant)):
                frame = self._add_frame(frame, at + i, X, motion, [start + i])
                X = RigidTransform()
                self.frame_of_velocity[start + i] = frame
                self.turns[start + i], self.slides[start + i] = motion
        if isinstance(joint, WeldJoint):
            X = X.multiply(joint.X_FM())
        X_BM = joint.frame_on_child().GetFixedPoseInBodyFrame()
        self._at[int(joint.child_body().index())] = frame, X.multiply(X_BM.inverse())

    def _add_frame(
        self,
        parent: int,
        position: int,
        X: RigidTransform,
        motion: tuple[np.ndarray, np.ndarray],
        velocities: Iterable[int],
    ) -> int:
        self._parents.append(parent)
        self._positions.append(position)
        self._poses.append(X)
        self._axes.append(motion)
        self.velocities.append(list(velocities))
        return len(self._parents) - 1

    def _make_tree(self) -> Tree:
        N = len(self._parents)
        fixed, sine, versine, slide = np.zeros((4, N, 4, 4))
        for i, (X, (turn, along)) in enumerate(
            zip(self._poses, self._axes, strict=True)
        ):
            R = X.rotation().matrix()
            fixed[i] = X.GetAsMatrix4().T
            cross = np.cross(turn, np.eye(3)).T  # a x b = cross b
            sine[i, :3, :3] = (R @ cross).T
            versine[i, :3, :3] = (R @ cross @ cross).T
            slide[i, 3, :3] = R @ along
        return Tree(
            np.array(self._parents),
            np.array(self._positions),
            fixed,
            sine,
            versine,
            slide,
            np.ones(N, dtype=bool),
            np.array(self._free, dtype=int).reshape(-1, 2),
        )


def screw_axis(joint: ScrewJoint, plant: MultibodyPlant) -> np.ndarray:
    """The axis that it was made with, which Drake's Python has no name for."""
    context = plant.CreateDefaultContext()
    q = plant.GetPositions(context)
    q[joint.position_start()] = 1.0
    plant.SetPositions(context, q)
    X_FM = plant.CalcRelativeTransform(
        context, joint.frame_on_parent(), joint.frame_on_child()
    )
    return X_FM.rotation().ToAngleAxis().axis()


def _motions(
    joint: Joint, plant: MultibodyPlant
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The turn and the slide of each of a joint's velocities, one after the other."""
    if isinstance(joint, RevoluteJoint):
        return [(joint.revolute_axis(), _NONE)]
    if isinstance(joint, PrismaticJoint):
        return [(_NONE, joint.translation_axis())]
    if isinstance(joint, ScrewJoint):
        axis = screw_axis(joint, plant)
        return [(axis, axis * joint.screw_pitch() / (2.0 * math.pi))]
    if isinstance(joint, UniversalJoint):
        return [(_X, _NONE), (_Y, _NONE)]
    if isinstance(joint, PlanarJoint):
        return [(_NONE, _X), (_NONE, _Y), (_Z, _NONE)]
    if not joint.num_velocities():
        return []
    raise ModelError(
        f"joint {joint.name()!r} is a {joint.type_name()} joint, whose velocities are "
        "not the rates of its positions; use revolute, prismatic, screw, universal or "
        "planar joints, or weld it"
    )
