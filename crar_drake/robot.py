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
from pydrake.multibody.tree import Frame, JacobianWrtVariable, MultibodyForces
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from crar_drake.equations.collisions import distance_gradient_about_origin
from crar_drake.equations.tasks import (
    NO_ROTATIONS,
    TaskJacobian,
    TaskLayout,
    task_weights,
)
from crar_drake.errors import ModelError
from crar_drake.link_kinematics import LinkKinematics
from crar_drake.nearest import nearest
from crar_drake.robot_description import (
    RobotDescription,
    add_robot,
    find_body,
    find_frame,
    find_joint,
)
from crar_drake.task import Task
from crar_drake.watched_pairs import WatchedPairs


@dataclass(slots=True)
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


@dataclass(slots=True)
class Distances:
    """Signed distances of the watched pairs at one configuration, or several (...).

    Attributes:
        d: (..., Nc) [m].
        dd_dq: (..., Nc, n) Eq. (20), controlled joints.
        dd_dq_p: (..., Nc, n_p) Eq. (20), prescribed joints.
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
        weighs_rows: whether one of them is not 1.
        task_targets: per task its frame F and its point p_FT (3,) [m].
        kinematics: `LinkKinematics` of the tasks' points and the watched axes.
        pairs: the watched pairs.
        pair_moves: (Nc, nv) 1 where a velocity moves segment a alone, -1 where b alone.
        n, n_p, m: numbers of controlled joints, prescribed joints and task rows.
        controlled, prescribed: their indices in v (and q).
        position_names: (nq,) the joint of each position of the plant.
        joint_names, prescribed_names: (n,), (n_p,) those of controlled and
            prescribed joints.
        lower, upper: (n,) limits of the controlled joints [rad].
        effort_limits: (nv,) largest effort per joint, inf where there is none.
        actuator_limits: (nu,) the same per actuator, in their order.
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
        context = workspace.plant_context
        self.plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
        points, S = self.kinematics([context])
        near = self._distances(points, S, [workspace.scene_graph_context])
        return self._state(context, q, v, points[0], S[0], near)

    def evaluate_with_ahead(
        self, workspace: Workspace, q: np.ndarray, v: np.ndarray, q_ahead: np.ndarray
    ) -> tuple[ModelState, Distances]:
        """`evaluate`, and the distances at another configuration too, at once.

        Args:
            workspace: of this model.
            q, v: (nq,), (nv,) the state, at which it leaves the workspace.
            q_ahead: (nq,) where else the distances are wanted.

        Returns:
            The state, and the distances at the state and at q_ahead, in this order
            along the first axis.
        """
        here, ahead = workspace.plant_context, workspace.plant_context_ahead
        self.plant.SetPositionsAndVelocities(here, np.concatenate([q, v]))
        self.plant.SetPositions(ahead, q_ahead)
        points, S = self.kinematics([here, ahead])
        near = self._distances(
            points,
            S,
            [workspace.scene_graph_context, workspace.scene_graph_context_ahead],
        )
        return self._state(here, q, v, points[0], S[0], near), near

    def evaluate_distances(self, workspace: Workspace, q: np.ndarray) -> Distances:
        """Eq. (20) at a configuration other than the workspace's, which stays.

        Args:
            workspace: of this model.
            q: (nq,) positions of the whole plant.
        """
        context = workspace.plant_context_ahead
        self.plant.SetPositions(context, q)
        points, S = self.kinematics([context])
        near = self._distances(points, S, [workspace.scene_graph_context_ahead])
        return Distances(near.d[0], near.dd_dq[0], near.dd_dq_p[0])

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
        if self._is_damped:
            tau = tau + self._implicit_damping * vdot
        return self._actuators_from_efforts @ tau

    def join(self, controlled: np.ndarray, prescribed: np.ndarray) -> np.ndarray:
        """(nv,) of all joints, from (n,) controlled and (n_p,) prescribed ones."""
        joined = np.empty(self.n + self.n_p)
        joined[self._controlled] = controlled
        joined[self._prescribed] = prescribed
        return joined

    def inertia_matrix(self, workspace: Workspace) -> np.ndarray:
        """H of Eqs. (1), (2) for the controlled joints, at the workspace's state.

        Args:
            workspace: at the state of the last `evaluate`.

        Returns:
            (n, n) symmetric positive definite [kg m^2]; rotor inertias are in it.
        """
        H = self.plant.CalcMassMatrix(workspace.plant_context)
        return H[np.ix_(self.controlled, self.controlled)]

    def rest_positions(self) -> np.ndarray:
        """Positions (nq,) of the description's rest posture."""
        plant = self.plant
        q = plant.GetPositions(plant.CreateDefaultContext())
        for name, value in self.description.rest_posture.items():
            joint = find_joint(plant, name)
            q[joint.position_start()] = value
        return q

    def tasks_at(self, q: np.ndarray) -> np.ndarray:
        """The targets that the robot fulfils where it is, at rest.

        Args:
            q: (nq,) positions of the whole plant.

        Returns:
            (layout.size,) [x_d; v_d; a_d], see `TaskLayout`, with v_d = a_d = 0.
        """
        zero = np.zeros(self.plant.num_velocities())
        state = self.evaluate(self.MakeWorkspace(), np.asarray(q, dtype=float), zero)
        return self.layout.pack(state.R, state.p)

    def _state(
        self,
        context: Context,
        q: np.ndarray,
        v: np.ndarray,
        points: np.ndarray,
        S: np.ndarray,
        near: Distances,
    ) -> ModelState:
        """What `evaluate` returns, from points (3, P) and S (6, nv) of that state and
        the distances there, the first of `near`."""
        layout = self.layout
        p_WT = points[:, : len(self.tasks)]
        J = self._task_jacobian(p_WT, S)
        R_WT = NO_ROTATIONS
        if self._oriented_frames:
            R_WT = np.array(
                [
                    frame.CalcRotationMatrixInWorld(context).matrix()
                    for frame in self._oriented_frames
                ]
            )
        c, p = self._controlled, self._prescribed
        return ModelState(
            q=q[c],
            qdot=v[c],
            q_p=q[p],
            qdot_p=v[p],
            R=R_WT,
            p=p_WT.T[layout.linear_tasks],
            v=J @ v,
            J=J[:, c],
            J_p=J[:, p],
            Jdot_qdot=self.bias_accelerations(context),
            d=near.d[0],
            dd_dq=near.dd_dq[0],
            dd_dq_p=near.dd_dq_p[0],
        )

    def bias_accelerations(self, context: Context) -> np.ndarray:
        """Eq. (6): Jdot qdot (m,), at the plant context's state."""
        plant, W, kV = self.plant, self.plant.world_frame(), JacobianWrtVariable.kV
        parts = [
            plant.CalcBiasTranslationalAcceleration(context, kV, frame, p_FT, W, W)
            for frame, p_FT in self._points_of_frame
        ]
        parts += [
            plant.CalcBiasSpatialAcceleration(
                context, kV, frame, p_FT, W, W
            ).get_coeffs()[:, None]
            for frame, p_FT in self._oriented_targets
        ]
        stacked = [part.ravel(order="F") for part in parts]
        return np.concatenate(stacked)[self._bias_rows]

    def _distances(
        self,
        points: np.ndarray,
        S: np.ndarray,
        scene_graph_contexts: Sequence[Context],
    ) -> Distances:
        """Eq. (20) in K configurations, from points (K, 3, P) and S (K, 6, nv)."""
        queries = ()
        if self.pairs.needs_query:
            port = self.scene_graph.get_query_output_port()
            queries = [port.Eval(context) for context in scene_graph_contexts]
        near = self.pairs.proximity(points[:, :, len(self.tasks) :], queries)
        dd_dv = distance_gradient_about_origin(
            near.normal, near.p_WA, S, self.pair_moves
        )
        c, p = self._controlled, self._prescribed
        return Distances(near.d, dd_dv[:, :, c], dd_dv[:, :, p])

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
        names = names_by_joint(plant)
        if len(unactuated):
            raise ModelError(
                "every joint must be actuated, but these are not: "
                f"{', '.join(names[i] for i in unactuated)}; add actuators "
                "(transmissions in a URDF), or weld the joints"
            )
        self._actuators_from_efforts = (
            plant.MakeActuationMatrixPseudoinverse().toarray()
        )
        self.prescribed = np.array(prescribed, dtype=int)
        self.controlled = np.setdiff1d(np.arange(nv), self.prescribed)
        self.n, self.n_p = len(self.controlled), len(self.prescribed)
        self._controlled = _slice_if_contiguous(self.controlled)
        self._prescribed = _slice_if_contiguous(self.prescribed)
        if not self.n:
            raise ModelError("the plant has no joint left to control")
        self.position_names = names
        self.joint_names = [names[i] for i in self.controlled]
        self.prescribed_names = [names[i] for i in self.prescribed]
        self.lower = plant.GetPositionLowerLimits()[self.controlled]
        self.upper = plant.GetPositionUpperLimits()[self.controlled]
        self.effort_limits = np.zeros(nv)
        self.actuator_limits = np.full(plant.num_actuated_dofs(), np.inf)
        for index in plant.GetJointActuatorIndices():
            actuator = plant.get_joint_actuator(index)
            start = actuator.joint().velocity_start()
            self.effort_limits[start : start + actuator.num_inputs()] += (
                actuator.effort_limit()
            )
            inputs = slice(
                actuator.input_start(), actuator.input_start() + actuator.num_inputs()
            )
            self.actuator_limits[inputs] = actuator.effort_limit()
        self._implicit_damping = np.zeros(nv)
        if plant.time_step() > 0.0:
            for index in plant.GetJointIndices():
                joint = plant.get_joint(index)
                start = joint.velocity_start()
                self._implicit_damping[start : start + joint.num_velocities()] = (
                    plant.time_step() * joint.default_damping_vector()
                )
        self._is_damped = bool(self._implicit_damping.any())

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
        self.task_targets = []
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
            self.task_targets.append((frame, np.asarray(task.point, dtype=float)))
        names = tuple(task.name or task.frame for task in self.tasks)
        for name in names:
            if names.count(name) > 1:
                raise ModelError(f"two tasks are named {name!r}; name them apart")
        self.layout = TaskLayout(names, tuple(task.kind for task in self.tasks))
        self.m = self.layout.m
        self._set_bias_calls()
        self.row_weights = task_weights(
            self.layout,
            [task.position_weight for task in self.tasks],
            [task.orientation_weight for task in self.tasks],
        )
        self.weighs_rows = bool((self.row_weights != 1.0).any())

    def _set_bias_calls(self) -> None:
        """Which calls give Jdot qdot: one per frame for points, else one per task."""
        points: dict[int, tuple[Frame, list[np.ndarray]]] = {}
        places: dict[int, tuple[int, int]] = {}  # task to (frame, place in the call)
        self._oriented_targets = []
        for i, (frame, p_FT) in enumerate(self.task_targets):
            if self.layout.kinds[i] == "position":
                of_frame = points.setdefault(int(frame.index()), (frame, []))[1]
                places[i] = (int(frame.index()), len(of_frame))
                of_frame.append(p_FT)
            else:
                self._oriented_targets.append((frame, p_FT))
        self._points_of_frame = [(frame, np.array(p).T) for frame, p in points.values()]
        sizes = [3 * len(p) for _, p in points.values()]
        starts = dict(zip(points, np.cumsum([0, *sizes]), strict=False))
        rows: list[int] = []
        row = sum(sizes)
        for i, kind in enumerate(self.layout.kinds):
            if kind == "position":
                frame, place = places[i]
                first = int(starts[frame]) + 3 * place
                rows += range(first, first + 3)
            else:
                rows += range(row, row + (3 if kind == "orientation" else 6))
                row += 6
        self._bias_rows = np.array(rows)
        self._oriented_frames = [frame for frame, _ in self._oriented_targets]

    def _set_points(self) -> None:
        """Collects every point whose position a step needs, and what moves it."""
        tasks = [
            (frame.body(), frame.GetFixedPoseInBodyFrame().multiply(p_FT))
            for frame, p_FT in self.task_targets
        ]
        axes = [
            (body, axis)
            for body, axes in zip(self.pairs.bodies, self.pairs.axes, strict=True)
            for axis in axes
        ]
        starts = [(body, axis.p_B0) for body, axis in axes]
        vectors = [(body, axis.p_B1 - axis.p_B0) for body, axis in axes]
        bodies = self.pairs.bodies
        self.kinematics = LinkKinematics(self.plant, [*tasks, *starts], vectors, bodies)
        carried_by = self.kinematics.carried_by
        self._task_jacobian = TaskJacobian(
            self.layout, np.array([carried_by(body) for body, _ in tasks])
        )
        carried = np.array([carried_by(body) for body in bodies], dtype=float)
        carried = carried.reshape(-1, self.plant.num_velocities())
        self.pair_moves = carried[self.pairs.body_a] - carried[self.pairs.body_b]

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


def names_by_joint(plant: MultibodyPlant) -> list[str]:
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


def _slice_if_contiguous(indices: np.ndarray) -> slice | np.ndarray:
    """The same selection as a slice where it is one: views, not copies."""
    if len(indices) and (np.diff(indices) == 1).all():
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices
