"""A robot as reference motions see it: a root that is posed, and all its joints.

Frames: W the world, z up; R the root link; B another link.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cached_property

import numpy as np
from pydrake.multibody.tree import Joint, RevoluteJoint, RigidBody
from scipy.spatial.transform import Rotation

from crar_drake.errors import ModelError
from crar_drake.judging.referee import Referee
from crar_drake.motion.quaternion_spline import sign_continuous
from crar_drake.robot.description import (
    RobotDescription,
    find_frame,
    robot_diagram,
)
from crar_drake.robot.joints import speed_limits
from crar_drake.robot_import.link_meshes import (
    LinkMesh,
    has_meshes,
    read_link_meshes,
)
from crar_drake.robot_import.link_outlines import LinkOutline, link_outlines

# What moves the root link follows the motion's waist; joints that are only held do not.
_HELD = "hold"


class WholeBody:
    """Kinematics of a robot below its root link, which stands still here.

    Whatever carries the root (prescribed joints, a floating base, a weld) is left where
    it is at zero: a motion says where the root is.

    Attributes:
        description: of the robot.
        plant, scene_graph: of its model, finalized.
        root: name of the root link R.
        joint_names: (n,) of all joints with one position that the root carries, depth
            first, branches in the order of the model: the order of MuJoCo and of files
            without names.
        breadth_first: (n,) the same joints, breadth first: the order of Isaac Lab.
        n: number of these joints.
        lower, upper: (n,) position limits [rad or m].
        speed_limits: (n,) largest speeds [rad/s or m/s], infinite where there is none.
    """

    def __init__(self, description: RobotDescription) -> None:
        """
        Raises:
            ModelError: the model cannot be read, or has no joint below its root.
        """
        self.description = description
        self._diagram, self.plant, self.scene_graph = robot_diagram(description)
        self._context = self.plant.CreateDefaultContext()
        self._rest = self.plant.GetPositions(self._context)
        self._children = self._find_children()
        self._root = self._find_root()
        self.root = self._root.name()
        self._joints = self._below(self._root, depth_first=True)
        if not self._joints:
            raise ModelError(
                f"robot {description.name}: no joint moves what hangs on its root link "
                f"{self.root!r}"
            )
        self.joint_names = tuple(joint.name() for joint in self._joints)
        self.n = len(self._joints)
        self.breadth_first = self.order_without((), breadth_first=True)
        self._columns = np.array([joint.position_start() for joint in self._joints])
        self._v_columns = np.array([joint.velocity_start() for joint in self._joints])
        self.lower = self.plant.GetPositionLowerLimits()[self._columns]
        self.upper = self.plant.GetPositionUpperLimits()[self._columns]
        self.speed_limits = speed_limits(self.plant, description)[self._v_columns]

    def links_of(self, joint_names: tuple[str, ...]) -> tuple[str, ...]:
        """(1 + n,) the root, then the link that each of the joints moves."""
        links = {joint.name(): joint.child_body().name() for joint in self._joints}
        return (self.root, *(links[name] for name in joint_names))

    def links_at(self, frames: Sequence[str]) -> list[str]:
        """The links of task frames, of those that the robot has."""
        there = self.description.task_frames
        found = (find_frame(self.plant, there[x]) for x in frames if x in there)
        return [frame.body().name() for frame in found]

    def order_without(
        self, locked: Collection[str], breadth_first: bool
    ) -> tuple[str, ...]:
        """Names of the joints of a version of the robot that has some of them locked.

        Args:
            locked: names of those.
            breadth_first: whether the others are in that order, and not depth first.
        """
        joints = self._below(self._root, not breadth_first, locked)
        return tuple(joint.name() for joint in joints)

    def columns_in(self, joint_names: Sequence[str]) -> list[int]:
        """(n,) for each joint of this robot its column where they are in that order."""
        column = {name: i for i, name in enumerate(joint_names)}
        return [column[name] for name in self.joint_names]

    def configurations(self, joint_positions: np.ndarray) -> np.ndarray:
        """(T, nq) positions of the plant, its root at rest.

        Args:
            joint_positions: (T, n), in the order of `joint_names` [rad or m].
        """
        q = np.tile(self._rest, (len(joint_positions), 1))
        q[:, self._columns] = joint_positions
        return q

    def of_configurations(
        self, q: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The inverse of `configurations`, with the root where q has it.

        Args:
            q: (T, nq) positions of the plant.

        Returns:
            p_WR (T, 3) [m], quaternions (T, 4) of R_WR, order w x y z, of continuous
            sign, and joint positions (T, n) [rad or m].
        """
        poses = np.empty((len(q), 3, 4))
        for t, positions in enumerate(q):
            self.plant.SetPositions(self._context, positions)
            X_WR = self.plant.EvalBodyPoseInWorld(self._context, self._root)
            poses[t] = X_WR.GetAsMatrix34()
        quaternions = Rotation.from_matrix(poses[:, :, :3]).as_quat()
        return (
            poses[:, :, 3],
            sign_continuous(quaternions)[:, [3, 0, 1, 2]],
            q[:, self._columns],
        )

    def velocities(self, joint_velocities: np.ndarray) -> np.ndarray:
        """(T, nv) velocities of the plant, from (T, n) of the joints."""
        v = np.zeros((len(joint_velocities), self.plant.num_velocities()))
        v[:, self._v_columns] = joint_velocities
        return v

    def referee(self) -> Referee:
        """Of watched pairs and of the joints; what carries the root has no speed limit.

        Raises:
            ModelError: as `Referee`.
        """
        fastest = np.full(self.plant.num_velocities(), np.inf)
        fastest[self._v_columns] = self.speed_limits
        pairs = self.description.pairs
        return Referee(self.plant, self.scene_graph, pairs, fastest)

    def has_link(self, name: str) -> bool:
        """Whether there is a link of that name."""
        return self.plant.NumBodiesWithName(name) == 1

    def poses_in_root(
        self, joint_positions: np.ndarray, links: Sequence[str]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where links are in the root's frame.

        Args:
            joint_positions: (T, n) [rad or m].
            links: (L) names.

        Returns:
            p_RB (T, L, 3) [m] and R_RB (T, L, 3, 3).
        """
        bodies = [self.plant.GetBodyByName(name) for name in links]
        p_RB = np.empty((len(joint_positions), len(links), 3))
        R_RB = np.empty((len(joint_positions), len(links), 3, 3))
        for t, q in enumerate(self.configurations(joint_positions)):
            self.plant.SetPositions(self._context, q)
            X_RM = self.plant.EvalBodyPoseInWorld(self._context, self._root).inverse()
            for i, body in enumerate(bodies):
                X_MB = self.plant.EvalBodyPoseInWorld(self._context, body)
                X_RB = (X_RM @ X_MB).GetAsMatrix34()
                p_RB[t, i], R_RB[t, i] = X_RB[:, 3], X_RB[:, :3]
        return p_RB, R_RB

    def poses_in_world(
        self,
        root_positions: np.ndarray,
        root_rotations: Rotation,
        joint_positions: np.ndarray,
        links: Sequence[str],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where links are in the world.

        Args:
            root_positions: (T, 3) p_WR [m].
            root_rotations: (T) R_WR.
            joint_positions: (T, n) [rad or m].
            links: (L) names.

        Returns:
            p_WB (T, L, 3) [m] and R_WB (T, L, 3, 3).
        """
        p_RB, R_RB = self.poses_in_root(joint_positions, links)
        R_WR = root_rotations.as_matrix()
        p_WB = root_positions[:, None] + np.einsum("tij,tlj->tli", R_WR, p_RB)
        return p_WB, np.einsum("tij,tljk->tlik", R_WR, R_RB)

    def lowest(
        self, links: Sequence[str], p_WB: np.ndarray, R_WB: np.ndarray
    ) -> np.ndarray:
        """(T, L) heights of the lowest points of links that have a shape [m].

        Args:
            links, p_WB, R_WB: (L), (T, L, 3), (T, L, 3, 3) as of `poses_in_world`.
        """
        low = np.empty(p_WB.shape[:2])
        for i, link in enumerate(links):
            outline = self.outlines[link]
            z = p_WB[:, i, 2:] + R_WB[:, i, 2] @ outline.points.T
            low[:, i] = (z - outline.radii).min(axis=1)
        return low

    def velocities_in_root(
        self,
        joint_positions: np.ndarray,
        joint_velocities: np.ndarray,
        links: tuple[str, ...],
    ) -> tuple[np.ndarray, np.ndarray]:
        """How links move as seen from the root, in its frame.

        Args:
            joint_positions: (T, n) [rad or m].
            joint_velocities: (T, n) [rad/s or m/s].
            links: (L) names.

        Returns:
            v_RB (T, L, 3) of the links' origins [m/s] and w_RB (T, L, 3) [rad/s].
        """
        bodies = [self.plant.GetBodyByName(name) for name in links]
        shape = (len(joint_positions), len(links), 3)
        v_RB, w_RB = np.empty(shape), np.empty(shape)
        states = zip(
            self.configurations(joint_positions),
            self.velocities(joint_velocities),
            strict=True,
        )
        for t, (q, v) in enumerate(states):
            self.plant.SetPositionsAndVelocities(self._context, np.concatenate([q, v]))
            X_MR = self.plant.EvalBodyPoseInWorld(self._context, self._root)
            R_RM = X_MR.rotation().matrix().T
            for i, body in enumerate(bodies):
                V = self.plant.EvalBodySpatialVelocityInWorld(self._context, body)
                v_RB[t, i] = R_RM @ V.translational()
                w_RB[t, i] = R_RM @ V.rotational()
        return v_RB, w_RB

    @cached_property
    def link_meshes(self) -> list[LinkMesh]:
        """As of `read_link_meshes`: reading them takes a second."""
        return read_link_meshes(self.plant, self.scene_graph)

    @cached_property
    def outlines(self) -> dict[str, LinkOutline]:
        """Link to its outermost points, of those that have a shape."""
        plant, scene_graph = self.plant, self.scene_graph
        meshes = self.link_meshes if has_meshes(plant, scene_graph) else None
        return link_outlines(plant, scene_graph, meshes)

    @cached_property
    def joint_axes(self) -> np.ndarray:
        """(n, 3) the joints' unit axes, in their own links' frames.

        Raises:
            ModelError: a joint does not turn.
        """
        axes = []
        for joint in self._joints:
            if not isinstance(joint, RevoluteJoint):
                raise ModelError(
                    f"robot {self.description.name}: joint {joint.name()!r} does not "
                    "turn about an axis"
                )
            X_BM = joint.frame_on_child().GetFixedPoseInBodyFrame()
            axes.append(X_BM.rotation() @ joint.revolute_axis())
        return np.array(axes)

    def _find_children(self) -> dict[int, list[Joint]]:
        """Each body to the joints that it carries, in the order of the model."""
        children: dict[int, list[Joint]] = {}
        for index in self.plant.GetJointIndices():
            joint = self.plant.get_joint(index)
            children.setdefault(int(joint.parent_body().index()), []).append(joint)
        return children

    def _carries_root(self, joint: Joint) -> bool:
        source = self.description.prescribed_joints.get(joint.name(), _HELD)
        return source != _HELD or joint.num_velocities() == 6

    def _find_root(self) -> RigidBody:
        body = self.plant.world_body()
        while True:
            carried = self._children.get(int(body.index()), [])
            moved = [joint for joint in carried if self._carries_root(joint)]
            if not moved:
                break
            body = moved[0].child_body()
        if body.index() != self.plant.world_body().index():
            return body
        if self.description.base:
            return find_frame(self.plant, self.description.base).body()
        welded = [
            joint.child_body()
            for joint in self._children.get(int(body.index()), [])
            if joint.num_velocities() == 0
        ]
        # Beside the robot other things may stand in the world.
        return max(welded, key=lambda b: len(self._below(b, True)), default=body)

    def _below(
        self, body: RigidBody, depth_first: bool, locked: Collection[str] = ()
    ) -> list[Joint]:
        """Joints that move and that a body carries; welded links are one with it."""
        found, queue = [], self._moving(body, locked)
        while queue:
            joint = queue.pop(0)
            found.append(joint)
            further = self._moving(joint.child_body(), locked)
            queue = further + queue if depth_first else queue + further
        for joint in found:
            if joint.num_positions() != 1:
                raise ModelError(
                    f"robot {self.description.name}: joint {joint.name()!r} has "
                    f"{joint.num_positions()} positions; only joints with one are "
                    "in reference motions"
                )
        return found

    def _moving(self, body: RigidBody, locked: Collection[str]) -> list[Joint]:
        moving = []
        for joint in self._children.get(int(body.index()), []):
            if joint.num_velocities() == 0 or joint.name() in locked:
                moving += self._moving(joint.child_body(), locked)
            else:
                moving.append(joint)
        return moving
