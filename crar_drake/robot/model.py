"""The controller's model of the robot: the hats of Eq. (2).

`ControlModel` owns a plant and a SceneGraph of its own and turns one state into
the numbers that the equations need. It knows names and indices; it has no opinion
about control.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Diagram

from crar_drake.errors import ModelError
from crar_drake.law.compilation import Held
from crar_drake.law.kinematics import State, find_state, watched_distances
from crar_drake.law.tasks import task_weights
from crar_drake.robot.actuators import Actuators
from crar_drake.robot.collision_pairs import WatchedPairs
from crar_drake.robot.control_plant import Part, control_plant, refuse_constraints
from crar_drake.robot.description import (
    RobotDescription,
    find_body,
    find_joint,
    find_root,
    robot_diagram,
)
from crar_drake.robot.dynamics import find_dynamics
from crar_drake.robot.joints import (
    check_described_joints,
    find_places,
    names_by_joint,
    speed_limits,
)
from crar_drake.robot.kinematics import JointTree
from crar_drake.robot.points import numbers_of_robot
from crar_drake.robot.task import Task, check_tasks
from crar_drake.robot.task_targets import find_targets
from crar_drake.robot.workspace import ModelState, Workspace


class ControlModel:
    """Kinematics, distances and inverse dynamics of a robot, by index.

    The joints of the plant are either *prescribed* (their acceleration is known)
    or *controlled* (the paper's q, in the plant's order of velocities). Each must
    have as many velocities as positions and be actuated. Only the root may float, by
    a quaternion: its pose then is among what is prescribed, and the model tells where
    the robot is, but no law takes it (`RobotDescription.refuse_floating`).

    Attributes:
        plant, scene_graph, diagram: the model itself.
        description: the robot description it was made with.
        tasks, layout: the tasks and their rows.
        row_weights: (m,) per-task weights, see `law.tasks.task_weights`.
        weighs_rows: whether one of them is not 1.
        task_targets: per task its frame F and its point p_FT (3,) [m]; of a joint the
            world's, which no row uses.
        joints: the plant's frames and what moves them.
        pairs: the watched pairs.
        robot: holds the `law.kinematics.Robot`.
        n, n_p, m: numbers of controlled joints, prescribed joints and task rows; the
            six velocities of a root that floats are among the prescribed.
        controlled, prescribed: (n,), (n_p,) their indices in v, of a root that floats
            at the end.
        controlled_positions, prescribed_positions: (n,), (nq_p,) their indices in q.
            All are those in v, unless the root floats, whose quaternion is one more.
        root_positions: (7,) the root's indices in q if it floats, else (0,).
        order, positions: (nv,), (nq,) both, one after the other, in v and in q.
        floats: whether the root floats.
        position_names, velocity_names: (nq,), (nv,) the joint of each position and
            velocity of the plant.
        joint_names, prescribed_names: (n,), (n_p,) those of the velocities of
            controlled and prescribed joints.
        lower, upper: (n,) limits of the controlled joints [rad].
        effort_limits: (nv,) largest effort per joint, inf where there is none.
        actuator_limits: (nu,) the same per actuator, in their order.
        border: what it sees of a user's plant, and `said` of it; None of a file.
        velocity_limits: (nv,) largest speed per joint, inf where there is none: the
            plant's (the smaller magnitude, where they differ by the direction; 0 says
            that none is stated) or, where it names the joint, the description's
            [rad/s or m/s].
    """

    def __init__(
        self,
        diagram: Diagram,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        description: RobotDescription,
        tasks: Sequence[Task],
    ) -> None:
        """
        Args:
            diagram: root diagram that contains `plant` and `scene_graph`, and
                whose every port is connected or has a default.
            plant: finalized.
            scene_graph: where the plant's geometry is registered.
            description: the names in the plant.
            tasks: what is tracked; none for a filter of joints.

        Raises:
            ModelError: the plant is not finalized, has constraints between its joints
                or bodies, a name is not in it, a joint is not actuated, or a shape has
                no distance.
        """
        if not plant.is_finalized():
            raise ModelError("the plant is not finalized: call plant.Finalize() first")
        refuse_constraints(plant)
        self.diagram, self.plant, self.scene_graph = diagram, plant, scene_graph
        self.description, self.border = description, None
        description.validate()
        self._set_joints()
        self.joints = JointTree(plant)
        self._set_tasks(tasks)
        self.pairs = WatchedPairs(
            plant,
            scene_graph.model_inspector(),
            [(find_body(plant, a), find_body(plant, b)) for a, b in description.pairs],
        )
        self.robot = numbers_of_robot(
            self.joints,
            self.pairs,
            self.layout,
            self.task_targets,
            self.order,
            self.positions,
            self.n,
        )
        self._check_distances()

    @staticmethod
    def FromDescription(
        description: RobotDescription,
        tasks: Sequence[Task],
        *,
        time_step: float = 1e-3,
    ) -> ControlModel:
        """Parses the robot's own model file.

        Args:
            description: from `load_robot_description`.
            tasks: what is tracked.
            time_step: of the plant that will be controlled [s], 0 if continuous;
                it tells the joint damping to make up for, the torque's instants, and
                the state that a period leads to.

        Raises:
            ModelError: as the constructor, and if the file cannot be parsed.
        """
        return ControlModel(*robot_diagram(description, time_step), description, tasks)

    @staticmethod
    def FromPlant(
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        description: RobotDescription,
        tasks: Sequence[Task],
        part: Part | None = None,
    ) -> ControlModel:
        """Copies a user's plant and SceneGraph as they are now.

        Args:
            part: of the plant; by default all of it.

        Raises:
            ModelError: as the constructor, and as `control_plant`.
        """
        if not plant.is_finalized():
            raise ModelError("the plant is not finalized: call plant.Finalize() first")
        if part is None:
            part = Part(
                plant, map(ModelInstanceIndex, range(plant.num_model_instances()))
            )
        copy = control_plant(plant, scene_graph, part)
        return ControlModel(*copy, description, tasks)

    def MakeWorkspace(self) -> Workspace:
        """Allocates contexts to compute in; one per thread or system context."""
        return Workspace(self.diagram, self.plant, self.scene_graph)

    def evaluate(
        self, workspace: Workspace, q: np.ndarray, v: np.ndarray
    ) -> ModelState:
        """Eqs. (5), (6), (20): kinematics and distances at a state.

        Leaves the workspace at that state, which `inverse_dynamics` then uses.

        Args:
            q: (nq,) positions of the whole plant.
            v: (nv,) velocities of the whole plant.
        """
        self.plant.SetPositionsAndVelocities(
            workspace.plant_context, np.concatenate((q, v))
        )
        # What may not be written to is compiled for anew.
        q, v = (np.array(x, dtype=float) for x in (q, v))
        state, asked = self.task_state(q, v), self.asked_here(workspace)
        of_pairs = watched_distances(state, asked, self.robot)
        return ModelState.of(state, *of_pairs, self.n)

    def task_state(self, q: np.ndarray, v: np.ndarray) -> State:
        """The numbers of a state (nq,), (nv,), without any pair."""
        return find_state(q, v, self.robot)

    def signed_distances(self, q: np.ndarray) -> np.ndarray:
        """(Nc,) signed distance of each watched pair, as SceneGraph measures it [m].

        Args:
            q: (nq,) positions of the whole plant.
        """
        workspace, q = self._own_workspace, np.array(q, dtype=float)
        self.plant.SetPositions(workspace.plant_context, q)
        port = self.scene_graph.get_query_output_port()
        asked = self.pairs.ask_distances(port.Eval(workspace.scene_graph_context))
        state = self.task_state(q, self._still)
        return watched_distances(state, asked, self.robot)[0]

    @cached_property
    def dynamics(self) -> Held:
        """Holds `law.dynamics.Dynamics`: what `inverse_dynamics` computes, of a
        robot whose base is fixed.

        Raises:
            ModelError: the plant has a force that is not known.
        """
        return find_dynamics(self.plant, self.joints, self._implicit_damping)

    @property
    def effort_of_joints(self) -> np.ndarray:
        """(nu, nv) actuators' efforts by the joints' torques."""
        return self._actuators.of_joints

    @cached_property
    def _own_workspace(self) -> Workspace:
        return self.MakeWorkspace()

    def asked_here(self, workspace: Workspace) -> np.ndarray:
        """What SceneGraph answers at the workspace's state, see `WatchedPairs.ask`."""
        port = self.scene_graph.get_query_output_port()
        return self.pairs.ask(port.Eval(workspace.scene_graph_context))

    def inverse_dynamics(self, workspace: Workspace, vdot: np.ndarray) -> np.ndarray:
        """Eqs. (2), (29): tau = H alpha + C qdot + tau_g, (nu,) [Nm or N].

        A discrete plant treats joint damping implicitly, at the end of its step;
        the control model's time step says whether and by how much to make up for
        it, so that the plant realises `vdot` exactly.

        Args:
            workspace: at the state of the last `evaluate`.
            vdot: (nv,) accelerations of all joints of the plant.
        """
        plant, context = self.plant, workspace.plant_context
        plant.CalcForceElementsContribution(context, workspace.forces)
        tau = plant.CalcInverseDynamics(context, vdot, workspace.forces)
        if self._is_damped:
            tau = tau + self._implicit_damping * vdot
        return self._actuators.of_joints @ tau

    def in_order(self, q: np.ndarray, *v: np.ndarray) -> tuple[np.ndarray, ...]:
        """Positions (nq,) and velocities (nv,) of the plant in the equations' order."""
        return q[self.positions], *(x[self.order] for x in v)

    def in_plant(self, q: np.ndarray, *v: np.ndarray) -> tuple[np.ndarray, ...]:
        """The way back from `in_order`."""
        plain = np.empty(len(q))
        plain[self.positions] = q
        return plain, *(x[self._places] for x in v)

    def prescribed_at(self, q: np.ndarray) -> np.ndarray:
        """[q_p; 0; 0] (3 n_p,), which asks the prescribed joints to stay.

        Args:
            q: (nq,) positions of the whole plant.
        """
        return np.concatenate((q[self.prescribed_positions], np.zeros(2 * self.n_p)))

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
        if self.floats:
            X_WB = self.description.rest_pose()
            q[self.root_positions[:4]] = X_WB.rotation().ToQuaternion().wxyz()
            q[self.root_positions[4:]] = X_WB.translation()
        return q

    def moved(self, q: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Positions after a displacement of the controlled joints.

        Args:
            q: (nq,) of the whole plant.
            by: (n,) displacements [rad or m].
        """
        q = q.copy()
        q[self.controlled_positions] += by
        return q

    def tasks_at(self, q: np.ndarray) -> np.ndarray:
        """The targets that the robot fulfils where it is, at rest.

        Args:
            q: (nq,) positions of the whole plant.

        Returns:
            (layout.size,) [x_d; v_d; a_d], see `TaskLayout`, with v_d = a_d = 0.
        """
        state = self.task_state(np.array(q, dtype=float), self._still)
        return self.layout.pack(state.R, state.p, q=state.q[self.layout.rows.joints])

    def _set_joints(self) -> None:
        plant, description = self.plant, self.description
        check_described_joints(plant, description)
        root = find_root(plant, description)
        moved = [find_joint(plant, name) for name in description.prescribed_joints]
        self.floats = root is not None
        of_root = [root] if root else []
        known = moved + of_root
        self.controlled, self.prescribed = find_places(plant, known)
        self.controlled_positions, self.prescribed_positions = find_places(
            plant, known, of_positions=True
        )
        _, unactuated = find_places(plant, of_root)
        _, self.root_positions = find_places(plant, of_root, of_positions=True)
        names = names_by_joint(plant)
        try:
            self._actuators = Actuators(plant, names, unactuated)
        except ModelError as error:
            raise ModelError(f"robot {description.name}: {error}") from None
        self.n, self.n_p = len(self.controlled), len(self.prescribed)
        self.order = np.concatenate([self.controlled, self.prescribed])
        self._places = np.argsort(self.order)
        self.positions = np.concatenate(
            [self.controlled_positions, self.prescribed_positions]
        )
        nv = plant.num_velocities()
        self._still = np.zeros(nv)
        if not self.n:
            raise ModelError("the plant has no joint left to control")
        self.velocity_names = names
        self.position_names = names_by_joint(plant, of_positions=True)
        self.joint_names = [names[i] for i in self.controlled]
        self.prescribed_names = [names[i] for i in self.prescribed]
        self.lower = plant.GetPositionLowerLimits()[self.controlled_positions]
        self.upper = plant.GetPositionUpperLimits()[self.controlled_positions]
        self.effort_limits = self._actuators.joint_limits
        self.actuator_limits = self._actuators.limits
        self.velocity_limits = speed_limits(plant, self.description)
        self._implicit_damping = np.zeros(nv)
        if plant.time_step() > 0.0:
            for index in plant.GetJointIndices():
                joint = plant.get_joint(index)
                start = joint.velocity_start()
                self._implicit_damping[start : start + joint.num_velocities()] = (
                    plant.time_step() * joint.default_damping_vector()
                )
        self._is_damped = bool(self._implicit_damping.any())

    def _set_tasks(self, tasks: Sequence[Task]) -> None:
        self.tasks = check_tasks(tasks)
        self.task_targets, self.layout = find_targets(
            self.plant,
            self.description,
            self.tasks,
            self.joint_names,
        )
        self.m = self.layout.m
        self.row_weights = task_weights(
            self.layout,
            [task.position_weight for task in self.tasks],
            [task.orientation_weight for task in self.tasks],
        )
        self.weighs_rows = bool((self.row_weights != 1.0).any())

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
