"""What the ground would have to give for a motion: force and centre of pressure.

Newton and Euler ask for one force f and one moment on the root of a robot that moves as
it does; there is nothing but the ground that could give them. The *centre of pressure*
is the point of the floor about which their moment has no horizontal part. A ground that
can only push needs f_z > 0 and this point inside the support polygon, the hull of what
the feet stand on (M. Vukobratovic and B. Borovac, "Zero-moment point: thirty-five
years of its life", Int. J. Humanoid Robotics 1(1), 2004). That it is so is a note on
feasibility: nothing here asks for friction, for the strength of the ankles, or whether
a controller would keep the robot up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces, QuaternionFloatingJoint

_LEAST_FORCE = 0.05  # of the weight, below which there is no centre of pressure


@dataclass(frozen=True, eq=False)
class GroundWrench:
    """What acts on the robot from outside besides gravity, in the world."""

    force: np.ndarray  # (T, 3) [N]
    moment: np.ndarray  # (T, 3) about the world's origin [Nm]
    weight: float  # of the robot [N]

    def centres(self, floor: float = 0.0) -> np.ndarray:
        """(T, 2) centres of pressure on the floor, at a height [m]; NaN where hardly
        anything pushes upwards."""
        f, n = self.force, self.moment
        up = np.where(f[:, 2] > _LEAST_FORCE * self.weight, f[:, 2], np.nan)
        # n - c x f has no x and no y, with c on the floor.
        return np.column_stack(
            [(floor * f[:, 0] - n[:, 1]) / up, (floor * f[:, 1] + n[:, 0]) / up]
        )


def ground_wrench(
    plant: MultibodyPlant, q: np.ndarray, v: np.ndarray, vdot: np.ndarray
) -> GroundWrench:
    """The force and the moment on the root that a motion takes.

    Args:
        plant: finalized; its only robot floats by a quaternion.
        q: (T, nq), v: (T, nv), vdot: (T, nv) of the motion.
    """
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    floating = [j for j in joints if isinstance(j, QuaternionFloatingJoint)]
    (root,) = floating
    at = root.velocity_start()
    context = plant.CreateDefaultContext()
    forces, moments = np.empty((len(q), 3)), np.empty((len(q), 3))
    external = MultibodyForces(plant)
    for t in range(len(q)):
        plant.SetPositions(context, q[t])
        plant.SetVelocities(context, v[t])
        plant.CalcForceElementsContribution(context, external)
        efforts = plant.CalcInverseDynamics(context, vdot[t], external)
        p_WR = plant.EvalBodyPoseInWorld(context, root.child_body()).translation()
        forces[t] = efforts[at + 3 : at + 6]
        moments[t] = efforts[at : at + 3] + np.cross(p_WR, forces[t])
    mass = plant.CalcTotalMass(context)
    gravity = float(np.linalg.norm(plant.gravity_field().gravity_vector()))
    return GroundWrench(forces, moments, mass * gravity)
