"""What a control model computes in, and what of a state it tells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces
from pydrake.systems.framework import Context, Diagram

from crar_drake.law.kinematics import State


@dataclass(slots=True)
class ModelState:
    """What the equations need to know of one state, all in the world frame W.

    n controlled and n_p prescribed joints, m task rows, Nc watched pairs.
    """

    q: np.ndarray  # (n,) positions of the controlled joints [rad]
    qdot: np.ndarray  # (n,) velocities of the controlled joints [rad/s]
    q_p: np.ndarray  # (nq_p,) positions of the prescribed joints
    qdot_p: np.ndarray  # (n_p,) and their velocities
    R: np.ndarray  # (Na, 3, 3) orientations R_WT of the tasks that have one
    p: np.ndarray  # (Nl, 3) positions p_WT of the tasks that have one [m]
    v: np.ndarray  # (m,) task velocities, Eq. (5) with all joints [rad/s, m/s].
    J: np.ndarray  # (m, n) task Jacobian with respect to the controlled joints
    J_p: np.ndarray  # (m, n_p) task Jacobian with respect to the prescribed joints
    Jdot_qdot: np.ndarray  # (m,) bias acceleration of Eq. (6), all joints.
    d: np.ndarray  # (Nc,) signed distances [m]
    dd_dq: np.ndarray  # (Nc, n) Eq. (20), controlled joints.
    dd_dq_p: np.ndarray  # (Nc, n_p) Eq. (20), prescribed joints.

    @staticmethod
    def of(state: State, d: np.ndarray, dd_dv: np.ndarray, n: int) -> ModelState:
        """The equations' numbers, with the n controlled joints apart."""
        return ModelState(
            q=state.q[:n],
            qdot=state.v[:n],
            q_p=state.q[n:],
            qdot_p=state.v[n:],
            R=state.R,
            p=state.p,
            v=state.J @ state.v,
            J=state.J[:, :n],
            J_p=state.J[:, n:],
            Jdot_qdot=state.Jdot_qdot,
            d=d,
            dd_dq=dd_dv[:, :n],
            dd_dq_p=dd_dv[:, n:],
        )


class Workspace:
    """The contexts that a ControlModel computes in. A copy is an independent one."""

    def __init__(
        self, diagram: Diagram, plant: MultibodyPlant, scene_graph: SceneGraph
    ) -> None:
        self._systems = diagram, plant, scene_graph
        # The root must be kept alive: the others are parts of it.
        self._root = diagram.CreateDefaultContext()
        self.plant_context: Context = plant.GetMyMutableContextFromRoot(self._root)
        self.scene_graph_context: Context = scene_graph.GetMyContextFromRoot(self._root)
        self.forces = MultibodyForces(plant)

    def __deepcopy__(self, memo: dict) -> Workspace:
        return Workspace(*self._systems)
