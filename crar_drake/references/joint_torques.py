"""How strong joints must be for a motion, by Drake's inverse dynamics.

Of joints that carry no foot alone, such as those of arms and waist: what they take
follows from how the root and they move. Legs share what the ground gives, and how they
do, no motion says. Hands are taken to touch nothing.

A motion that is played f times as slowly takes, in each of its postures,

    tau = tau_gravity + (tau - tau_gravity) / f^2

where the tempo is even. So f = sqrt((tau - tau_gravity) / (limit - tau_gravity)) brings
a joint to its limit. What gravity takes no tempo changes.

Velocities and accelerations are differences of neighbouring frames.
"""

from __future__ import annotations

import numpy as np
from pydrake.multibody.tree import MultibodyForces

from crar_drake.errors import ModelError
from crar_drake.references.ground_contact import FEET
from crar_drake.references.ground_demand import plant_motion
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import find_frame, find_root
from crar_drake.robot_import.link_outlines import links_outward

# Beyond this share of its limit by gravity alone, a joint is not helped by any tempo.
_BY_GRAVITY = 0.95


class JointTorques:
    """What a robot's joints must give for motions.

    Attributes:
        joints: (J,) names of those that are looked at.
        limits: (J,) their efforts, at most [Nm or N].
    """

    def __init__(self, robot: WholeBody) -> None:
        """
        Args:
            robot: that moves.

        Raises:
            ModelError: none of its joints that carry no foot has an effort limit.
        """
        self._robot, plant = robot, robot.plant
        description = robot.description
        self._root = find_root(plant, description)
        feet = {
            find_frame(plant, frame).body().name()
            for point, frame in description.task_frames.items()
            if point in FEET
        }
        limits = np.zeros(plant.num_velocities())
        for index in plant.GetJointActuatorIndices():
            actuator = plant.get_joint_actuator(index)
            limits[actuator.joint().velocity_start()] += actuator.effort_limit()
        self.joints, columns = [], []
        for name in robot.joint_names:
            joint = plant.GetJointByName(name)
            column, tip = joint.velocity_start(), joint.frame_on_child()
            if np.isfinite(limits[column]) and limits[column] > 0.0:
                if feet.isdisjoint(links_outward(plant, tip)):
                    self.joints.append(name)
                    columns.append(column)
        if not columns:
            raise ModelError(
                f"robot {description.name}: no joint that carries no foot has an "
                "effort limit, so that no torque can be too large; use --retime"
            )
        self._columns = np.array(columns)
        self.limits = limits[self._columns]

    def find(self, motion: RobotMotion) -> tuple[np.ndarray, np.ndarray]:
        """(T, J) what the joints must give, and what of it gravity takes [Nm or N].

        Args:
            motion: with its joints in the robot's order.
        """
        plant = self._robot.plant
        context, external = plant.CreateDefaultContext(), MultibodyForces(plant)
        still = np.zeros(plant.num_velocities())
        found = np.empty((2, motion.num_frames, len(self._columns)))
        states = zip(*plant_motion(self._robot, self._root, motion), strict=True)
        for t, (q, v, vdot) in enumerate(states):
            plant.SetPositions(context, q)
            for kind, (speed, change) in enumerate(((v, vdot), (still, still))):
                plant.SetVelocities(context, speed)
                plant.CalcForceElementsContribution(context, external)
                efforts = plant.CalcInverseDynamics(context, change, external)
                found[kind, t] = efforts[self._columns]
        return found[0], found[1]

    def shares(self, motion: RobotMotion) -> np.ndarray:
        """(T,) the largest share of its limit that a joint takes.

        Args:
            motion: as of `find`.
        """
        needed, _ = self.find(motion)
        return (np.abs(needed) / self.limits).max(axis=1)

    def slower(self, motion: RobotMotion) -> np.ndarray:
        """(T - 1,) how many times as slowly each step to the next frame must be played.

        Args:
            motion: as of `find`.
        """
        needed, gravity = self.find(motion)
        sense = np.sign(needed - gravity)
        room = self.limits - sense * gravity
        # Near it, a tempo that would do is none.
        room = np.maximum(room, (1.0 - _BY_GRAVITY) * self.limits)
        by = np.sqrt(np.abs(needed - gravity) / room)
        by[np.abs(gravity) > _BY_GRAVITY * self.limits] = 0.0
        most = by.max(axis=1)
        return np.maximum(most[1:], most[:-1])
