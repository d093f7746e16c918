"""The controller's model of the robot: the hats of Eq. (2).

`ControlModel` owns a plant and a SceneGraph of its own and turns one state into
the numbers that the equations need. It knows names and indices; it has no opinion
about control.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces, RigidBody
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from crar_drake.equations.collisions import distance_gradient_from_links
from crar_drake.equations.tasks import TaskLayout, task_weights
from crar_drake.errors import ModelError
from crar_drake.robot_description import (
    RobotDescription,
    add_robot,
    find_body,
    find_frame,
    find_joint,
    nearest,
)
from crar_drake.task import Task
from crar_drake.watched_pairs import WatchedPairs

_ORIGIN = np.zeros(3)


@dataclass(frozen=True)
class ModelState:
    """What the equations need to know of one state, all in the world frame W.

    n controlled and n_p prescribed joints, m task rows, Nc watched pairs.

    Attributes:
        qdot: (n,) velocities of the controlled joints [rad/s].
        q_p, qdot_p: (n_p,) positions and velocities of the prescribed joints.
        q: (n,) positions of the controlled joints [rad].
        R: (Na, 3, 3) orientations R_WT of the tasks that have one.
        p: (Nl, 3) positions p_WT of the tasks that have one [m].
        v: (m,) task velocities, Eq. (5) with all joints [rad/s, m/s].
        J: (m, n) task Jacobian with respect to the controlled joints.
        J_p: (m, n_p) task Jacobian with respect to the prescribed joints.
        Jdot_qdot: (m,) bias acceleration of Eq. (6), all joints.
        d: (Nc,) signed distances [m].
        dd_dq: (Nc, n) Eq. (20), controlled joints.
        dd_dq_p: (Nc, n_p) Eq. (20), prescribed joints.
    """

    q: np.ndarray
    qdot: np.ndarray
    q_p: np.ndarray
    qdot_p: np.ndarray
    R: np.ndarray
    p: np.ndarray
    v: np.ndarray
    J: np.ndarray
    J_p: np.ndarray
    Jdot_qdot: np.ndarray
    d: np.ndarray
    dd_dq: np.ndarray
    dd_dq_p: np.ndarray


@dataclass(frozen=True)
class Distances:
    """Signed distances of the watched pairs at some configuration.

    Attributes:
        d: (Nc,) [m].
        dd_dq: (Nc, n) Eq. (20), controlled joints.
        dd_dq_p: (Nc, n_p) Eq. (20), prescribed joints.
    """

    d: np.ndarray
    dd_dq: np.ndarray
    dd_dq_p: np.ndarray


class Workspace:
    """The contexts that a ControlModel computes in. A copy is an independent one."""

    def __init__(self, model: ControlModel) -> None:
        self._model = model
        # The roots must be kept alive: the others are parts of them.
        self._roots = [model.diagram.CreateDefaultContext() for _ in range(2)]
        here, ahead = self._roots
        self.plant_context: Context = model.plant.GetMyMutableContextFromRoot(here)
        self.scene_graph_context: Context = model.scene_graph.GetMyContextFromRoot(here)
        # For distances elsewhere, so that asking them disturbs nothing.
        self.plant_context_ahead: Context = model.plant.GetMyMutableContextFromRoot(
            ahead
        )
        self.scene_graph_context_ahead: Context = (
            model.scene_graph.GetMyContextFromRoot(ahead)
        )
        self.forces = MultibodyForces(model.plant)

    def __deepcopy__(self, memo: dict) -> Workspace:
        return Workspace(self._model)


class ControlModel:
    """Kinematics, distances and inverse dynamics of a robot, by index.

    The joints of the plant are either *prescribed* (their acceleration is known)
    or *controlled* (the paper's q, in the plant's order of velocities). Each must
    have as many velocities as positions and be actuated.

    Attributes:
        plant, scene_graph, diagram: the model itself.
        description: the robot description it was made with.
        tasks, layout: the tasks and their rows.
        row_weights: (m,) per-task weights, see `equations.tasks.task_weights`.
        pairs: the watched pairs.
        n, n_p, m: numbers of controlled joints, prescribed joints and task rows.
        controlled, prescribed: their indices in v (and q).
        position_names: (nq,) the joint of each position of the plant.
        joint_names, prescribed_names: (n,), (n_p,) those of controlled and
            prescribed joints.
        lower, upper: (n,) limits of the controlled joints [rad].
        effort_limits: (nv,) largest effort per joint, inf where there is none.
    """

    def __init__(
        self,
        diagram: Diagram,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        description: RobotDescription,
        tasks: Sequence[Task],
        distances: str = "closed_form",
    ) -> None:
        """
        Args:
            diagram: root diagram that contains `plant` and `scene_graph`, and
                whose every port is connected or has a default.
            plant: finalized.
            scene_graph: where the plant's geometry is registered.
            description: the names in the plant.
            tasks: what is tracked; at least one.
            distances: "closed_form" or "scene_graph", see `WatchedPairs`.

        Raises:
            ModelError: the plant is not finalized, a name is not in it, a joint is
                not actuated, or a shape has no distance.
        """
        if not plant.is_finalized():
            raise ModelError("the plant is not finalized: call plant.Finalize() first")
        self.diagram, self.plant, self.scene_graph = diagram, plant, scene_graph
        self.description = description
        description.validate()
        self._set_joints()
        self._set_tasks(tasks)
        self.pairs = WatchedPairs(
            plant,
            scene_graph.model_inspector(),
            [(find_body(plant, a), find_body(plant, b)) for a, b in description.pairs],
            distances,
        )
        self._set_points()
        self._check_distances()

    @staticmethod
    def FromDescription(
        description: RobotDescription,
        tasks: Sequence[Task],
        *,
        distances: str = "closed_form",
        time_step: float = 1e-3,
    ) -> ControlModel:
        """Parses the robot's own model file.

        Args:
            description: from `load_robot_description`.
            tasks: what is tracked.
            distances: "closed_form" or "scene_graph".
            time_step: of the plant that will be controlled [s], 0 if continuous;
                used only to make up for its implicit joint damping.

        Raises:
            ModelError: as the constructor, and if the file cannot be parsed.
        """
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step)
        add_robot(plant, description)
        plant.Finalize()
        return ControlModel(
            builder.Build(), plant, scene_graph, description, tasks, distances
        )

    @staticmethod
    def FromPlant(
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        description: RobotDescription,
        tasks: Sequence[Task],
        *,
        distances: str = "closed_form",
    ) -> ControlModel:
        """Clones a user's plant and SceneGraph as they are now.

        Raises:
            ModelError: as the constructor.
        """
        if not plant.is_finalized():
            raise ModelError("the plant is not finalized: call plant.Finalize() first")
        builder = DiagramBuilder()
        plant_clone = builder.AddNamedSystem("plant", plant.Clone())
        scene_graph_clone = builder.AddNamedSystem("scene_graph", scene_graph.Clone())
        builder.Connect(
            plant_clone.get_geometry_pose_output_port(),
            scene_graph_clone.get_source_pose_port(plant.get_source_id()),
        )
        builder.Connect(
            scene_graph_clone.get_query_output_port(),
            plant_clone.get_geometry_query_input_port(),
        )
        return ControlModel(
            builder.Build(),
            plant_clone,
            scene_graph_clone,
            description,
            tasks,
            distances,
        )

    def MakeWorkspace(self) -> Workspace:
        """Allocates contexts to compute in; one per thread or system context."""
        return Workspace(self)

    def evaluate(
        self, workspace: Workspace, q: np.ndarray, v: np.ndarray
    ) -> ModelState:
        """Eqs. (5), (6), (20): kinematics and distances at a state.

        Leaves the workspace at that state, which `inverse_dynamics` then uses.

        Args:
            workspace: of this model.
            q: (nq,) positions of the whole plant.
            v: (nv,) velocities of the whole plant.
        """
        plant, context = self.plant, workspace.plant_context
        W = plant.world_frame()
        plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))

        p_W, J_WL = self._links(context)

        # Tasks: shift each link's Jacobian to the task's point.
        layout = self.layout
        p_WT = p_W[self._task_points]
        J_LT = J_WL[self._task_links]
        J_angular = J_LT[:, :3]
        J_linear = J_LT[:, 3:] - _skew(p_WT) @ J_angular
        J = np.empty((self.m, plant.num_velocities()))
        Jdot_qdot = np.empty(self.m)
        J[layout.angular_rows] = J_angular[layout.angular_tasks]
        J[layout.linear_rows] = J_linear[layout.linear_tasks]
        for i, (frame, p_FT) in enumerate(self._task_targets):
            bias = plant.CalcBiasSpatialAcceleration(
                context, JacobianWrtVariable.kV, frame, p_FT, W, W
            ).get_coeffs()
            Jdot_qdot[layout.rows_of(i)] = bias[self._bias_rows[i]]
        R_WT = np.empty((len(layout.angular_tasks), 3, 3))
        for i, task in enumerate(layout.angular_tasks):
            frame, _ = self._task_targets[task]
            R_WT[i] = frame.CalcRotationMatrixInWorld(context).matrix()

        near = self._distances(p_W, J_WL, workspace.scene_graph_context)
        c, p = self.controlled, self.prescribed
        return ModelState(
            q=q[c],
            qdot=v[c],
            q_p=q[p],
            qdot_p=v[p],
            R=R_WT,
            p=p_WT[layout.linear_tasks],
            v=J @ v,
            J=J[:, c],
            J_p=J[:, p],
            Jdot_qdot=Jdot_qdot,
            d=near.d,
            dd_dq=near.dd_dq,
            dd_dq_p=near.dd_dq_p,
        )

    def evaluate_distances(self, workspace: Workspace, q: np.ndarray) -> Distances:
        """Eq. (20) at a configuration other than the workspace's, which stays.

        Args:
            workspace: of this model.
            q: (nq,) positions of the whole plant.
        """
        context = workspace.plant_context_ahead
        self.plant.SetPositions(context, q)
        p_W, J_WL = self._links(context)
        return self._distances(p_W, J_WL, workspace.scene_graph_context_ahead)

    def inverse_dynamics(self, workspace: Workspace, vdot: np.ndarray) -> np.ndarray:
        """Eqs. (2), (29): tau = H alpha + C qdot + tau_g, at the workspace's state.

        A discrete plant treats joint damping implicitly, at the end of its step;
        the control model's time step says whether and by how much to make up for
        it, so that the plant realises `vdot` exactly.

        Args:
            workspace: at the state of the last `evaluate`.
            vdot: (nv,) accelerations of all joints of the plant.

        Returns:
            (nu,) efforts in the order of the plant's actuators [Nm or N].
        """
        plant, context = self.plant, workspace.plant_context
        plant.CalcForceElementsContribution(context, workspace.forces)
        tau = plant.CalcInverseDynamics(context, vdot, workspace.forces)
        return self._actuators_from_efforts @ (tau + self._implicit_damping * vdot)

    def rest_positions(self) -> np.ndarray:
        """Positions (nq,) of the description's rest posture."""
        plant = self.plant
        q = plant.GetPositions(plant.CreateDefaultContext())
        for name, value in self.description.rest_posture.items():
            joint = find_joint(plant, name)
            q[joint.position_start()] = value
        return q

    def _links(self, context: Context) -> tuple[np.ndarray, np.ndarray]:
        """All points (num_points, 3) and link Jacobians (links, 6, nv), in W.

        The Jacobians are of the link's point that is at the world's origin.
        """
        plant = self.plant
        W = plant.world_frame()
        p_W = np.empty((self._num_points, 3))
        J_WL = np.empty((len(self._links_points), 6, plant.num_velocities()))
        for i, (frame, p_L, points) in enumerate(self._links_points):
            p_W[points] = plant.CalcPointsPositions(context, frame, p_L, W).T
            J_WL[i] = plant.CalcJacobianSpatialVelocity(
                context, JacobianWrtVariable.kV, frame, _ORIGIN, W, W
            )
        J_WL[:, 3:] += _skew(p_W[self._origin_points]) @ J_WL[:, :3]
        return p_W, J_WL

    def _distances(
        self, p_W: np.ndarray, J_WL: np.ndarray, scene_graph_context: Context
    ) -> Distances:
        query = None
        if self.pairs.needs_query:
            query = self.scene_graph.get_query_output_port().Eval(scene_graph_context)
        near = self.pairs.proximity(
            p_W[self._axis_points[:, 0]], p_W[self._axis_points[:, 1]], query
        )
        dd_dv = distance_gradient_from_links(
            near.normal, near.p_WA, self._pair_links_a, self._pair_links_b, J_WL
        )
        return Distances(near.d, dd_dv[:, self.controlled], dd_dv[:, self.prescribed])

    def _set_joints(self) -> None:
        plant, description = self.plant, self.description
        if plant.num_positions() != plant.num_velocities():
            raise ModelError(
                "the plant has a joint with more positions than velocities (a floating "
                "base or a ball joint); weld the base, or use single-axis joints"
            )
        prescribed = [
            joint.velocity_start() + i
            for joint in (find_joint(plant, j) for j in description.prescribed_joints)
            for i in range(joint.num_velocities())
        ]
        self._check_described_joints()
        nv = plant.num_velocities()
        B = plant.MakeActuationMatrix()
        unactuated = np.flatnonzero(~B.any(axis=1))
        names = _names_by_joint(plant)
        if len(unactuated):
            raise ModelError(
                "every joint must be actuated, but these are not: "
                f"{', '.join(names[i] for i in unactuated)}; add actuators "
                "(transmissions in a URDF), or weld the joints"
            )
        self._actuators_from_efforts = plant.MakeActuationMatrixPseudoinverse()
        self.prescribed = np.array(prescribed, dtype=int)
        self.controlled = np.setdiff1d(np.arange(nv), self.prescribed)
        self.n, self.n_p = len(self.controlled), len(self.prescribed)
        if not self.n:
            raise ModelError("the plant has no joint left to control")
        self.position_names = names
        self.joint_names = [names[i] for i in self.controlled]
        self.prescribed_names = [names[i] for i in self.prescribed]
        self.lower = plant.GetPositionLowerLimits()[self.controlled]
        self.upper = plant.GetPositionUpperLimits()[self.controlled]
        self.effort_limits = np.zeros(nv)
        for index in plant.GetJointActuatorIndices():
            actuator = plant.get_joint_actuator(index)
            start = actuator.joint().velocity_start()
            self.effort_limits[start : start + actuator.num_inputs()] += (
                actuator.effort_limit()
            )
        self._implicit_damping = np.zeros(nv)
        if plant.time_step() > 0.0:
            for index in plant.GetJointIndices():
                joint = plant.get_joint(index)
                start = joint.velocity_start()
                self._implicit_damping[start : start + joint.num_velocities()] = (
                    plant.time_step() * joint.default_damping_vector()
                )

    def _check_described_joints(self) -> None:
        """Welds have no position to prescribe or to rest in, others not just one."""
        description = self.description
        for name in description.prescribed_joints:
            if not find_joint(self.plant, name).num_velocities():
                raise ModelError(
                    f"robot {description.name}: prescribed_joints: {name!r} is fixed; "
                    "leave it out"
                )
        for name, value in description.rest_posture.items():
            positions = find_joint(self.plant, name).num_positions()
            if positions != 1 or not np.isfinite(value):
                raise ModelError(
                    f"robot {description.name}: rest_posture: {name}: {value} for a "
                    f"joint with {positions} positions; give finite values, to joints "
                    "with one"
                )

    def _set_tasks(self, tasks: Sequence[Task]) -> None:
        if not tasks:
            raise ModelError("give at least one task")
        self.tasks = tuple(tasks)
        self._task_targets = []
        for task in self.tasks:
            task.validate()
            known = self.description.task_frames
            name = known.get(task.frame, task.frame)
            try:
                frame = find_frame(self.plant, name)
            except ModelError as error:
                if task.frame in known:
                    raise
                raise ModelError(
                    f"task {task.name or task.frame}: {error}"
                    f"{nearest(task.frame, known) if known else ''}"
                ) from error
            self._task_targets.append((frame, np.asarray(task.point, dtype=float)))
        names = tuple(task.name or task.frame for task in self.tasks)
        for name in names:
            if names.count(name) > 1:
                raise ModelError(f"two tasks are named {name!r}; name them apart")
        self.layout = TaskLayout(names, tuple(task.kind for task in self.tasks))
        self.m = self.layout.m
        rows = {
            "position": slice(3, 6),
            "orientation": slice(0, 3),
            "pose": slice(0, 6),
        }
        self._bias_rows = [rows[task.kind] for task in self.tasks]
        self.row_weights = task_weights(
            self.layout,
            [task.position_weight for task in self.tasks],
            [task.orientation_weight for task in self.tasks],
        )

    def _set_points(self) -> None:
        """Collects, link by link, every point whose position a step needs.

        Bodies that are welded together count as one link: a hand is a segment of its
        own, but moves with its forearm.
        """
        plant = self.plant
        context = plant.CreateDefaultContext()
        bodies: list[RigidBody] = []  # one per link
        points: list[list[np.ndarray]] = []  # per link, its origin first

        def link_of(body: RigidBody) -> int:
            welded = plant.GetBodiesWeldedTo(body)
            first = min(welded, key=lambda other: int(other.index()))
            for link, known in enumerate(bodies):
                if known.index() == first.index():
                    return link
            bodies.append(first)
            points.append([np.zeros(3)])
            return len(bodies) - 1

        def add(body: RigidBody, p_B: np.ndarray) -> tuple[int, int]:
            """Adds a point of a body; returns its link and its place there."""
            link = link_of(body)
            X_LB = plant.CalcRelativeTransform(
                context, bodies[link].body_frame(), body.body_frame()
            )
            points[link].append(X_LB.multiply(p_B))
            return link, len(points[link]) - 1

        tasks = [
            add(frame.body(), frame.GetFixedPoseInBodyFrame().multiply(p_FT))
            for frame, p_FT in self._task_targets
        ]
        axes = [
            (add(body, axis.p_B0), add(body, axis.p_B1))
            for body, body_axes in zip(self.pairs.bodies, self.pairs.axes, strict=True)
            for axis in body_axes
        ]
        of_body = np.array([link_of(body) for body in self.pairs.bodies], dtype=int)

        starts = np.cumsum([0] + [len(of_link) for of_link in points])
        self._num_points = int(starts[-1])
        self._origin_points = starts[:-1]
        self._links_points = [
            (body.body_frame(), np.array(of_link).T, slice(start, start + len(of_link)))
            for body, of_link, start in zip(bodies, points, starts[:-1], strict=True)
        ]
        self._task_links = np.array([link for link, _ in tasks])
        self._task_points = np.array([starts[link] + i for link, i in tasks])
        self._axis_points = np.array(
            [[starts[k0] + i0, starts[k1] + i1] for (k0, i0), (k1, i1) in axes],
            dtype=int,
        ).reshape(-1, 2)
        self._pair_links_a = of_body[self.pairs.body_a]
        self._pair_links_b = of_body[self.pairs.body_b]

    def _check_distances(self) -> None:
        """Some shapes have no distance; better to say so now than at run time."""
        workspace = self.MakeWorkspace()
        q = self.plant.GetPositions(workspace.plant_context)
        try:
            self.evaluate(workspace, q, np.zeros(self.plant.num_velocities()))
        except RuntimeError as error:
            raise ModelError(
                "a watched pair has shapes whose distance SceneGraph cannot compute; "
                f"use spheres, capsules or convex shapes: {error}"
            ) from error


def _names_by_joint(plant: MultibodyPlant) -> list[str]:
    """Per velocity the joint's name; scoped where two models share a name."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    plain = [joint.name() for joint in joints]
    names = [""] * plant.num_velocities()
    for joint in joints:
        name = joint.name()
        if plain.count(name) > 1:
            name = f"{plant.GetModelInstanceName(joint.model_instance())}::{name}"
        for i in range(joint.num_velocities()):
            suffix = (
                f".{joint.velocity_suffix(i)}" if joint.num_velocities() > 1 else ""
            )
            names[joint.velocity_start() + i] = name + suffix
    return names


def _skew(r: np.ndarray) -> np.ndarray:
    """Matrices S (N, 3, 3) with S x = r cross x, of vectors (N, 3)."""
    S = np.zeros((len(r), 3, 3))
    S[:, 0, 1], S[:, 0, 2] = -r[:, 2], r[:, 1]
    S[:, 1, 0], S[:, 1, 2] = r[:, 2], -r[:, 0]
    S[:, 2, 0], S[:, 2, 1] = -r[:, 1], r[:, 0]
    return S
