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
    def of(state: State, n: int) -> ModelState:
        """The equations' state, with the n controlled joints apart."""
        q, v, R, p, J, Jdot_qdot, d, dd_dv = state
        return ModelState(
            q=q[:n],
            qdot=v[:n],
            q_p=q[n:],
            qdot_p=v[n:],
            R=R,
            p=p,
            v=J @ v,
            J=J[:, :n],
            J_p=J[:, n:],
            Jdot_qdot=Jdot_qdot,
            d=d[0],
            dd_dq=dd_dv[0][:, :n],
            dd_dq_p=dd_dv[0][:, n:],
        )


@dataclass(slots=True)
class Distances:
    """Signed distances of the watched pairs at one configuration."""

    d: np.ndarray  # (Nc,) [m]
    dd_dq: np.ndarray  # (Nc, n) Eq. (20), controlled joints.
    dd_dq_p: np.ndarray  # (Nc, n_p) Eq. (20), prescribed joints.


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
