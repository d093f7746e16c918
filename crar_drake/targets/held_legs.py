"""What legs do to a foot while the accelerations of their joints are held."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.multibody.tree import Frame, JacobianWrtVariable, Joint

from crar_drake.equations.tasks import quaternion_from_rotation
from crar_drake.robot.model import ControlModel
from crar_drake.targets.ways import CarriedTrajectory, PointTrajectory


class HeldLegs:
    """A root and the joints of its legs on their ways, accelerations held for periods.

    Joints that turn evenly do not carry a foot evenly. Let joints have the velocities v
    at t and v' at t + h, and a foot the velocities V and V' then, and the acceleration
    A at t if the joints have (v' - v) / h. To have V' at t + h, its joints as they are
    then, a foot must be given A, not (V' - V) / h. They differ by

        A - (V' - V) / h = -h (J_dot v_dot + J_ddot v / 2) + ...,

    J the foot's Jacobian: of a leg that swings, a metre per second squared at a period
    of 5 ms.

    Velocities of a discrete plant are those of half a step s before (`HeldTrajectory`),
    at its positions of now: a foot that stands then has J(t) v(t - s), which is not 0.
    """

    def __init__(
        self,
        model: ControlModel,
        root: CarriedTrajectory,
        joints: Sequence[Joint],
        positions: PointTrajectory,
        frames: Mapping[str, Frame],
        hold: float,
    ) -> None:
        """
        Args:
            model: the robot, the root of which floats.
            root: the way of its base.
            joints: of the legs, with one position each.
            positions: their way [rad or m], in this order.
            frames: of the plant, that the legs carry, by name.
            hold: the period h [s].
        """
        self._plant = model.plant
        self._late = 0.5 * model.plant.time_step()
        self._context = model.MakeWorkspace().plant_context
        self._root, self._positions, self._hold = root, positions, hold
        self._frames = frames
        self._q = model.rest_positions()
        self._v = np.zeros(model.plant.num_velocities())
        self._root_q, self._root_v = model.root_positions, model.unactuated
        self._joint_q = [joint.position_start() for joint in joints]
        self._joint_v = [joint.velocity_start() for joint in joints]
        self._time, self._lack = np.nan, {}

    def lack(self, frame: str, time: float) -> tuple[np.ndarray, np.ndarray]:
        """(6,) velocity and (6,) acceleration that a frame must be given at `time` [s]
        besides those of its way, in W [rad/s, m/s; rad/s^2, m/s^2]; 0 after the end."""
        if time != self._time:
            self._time, self._lack = time, self._lacks(time)
        return self._lack[frame]

    def _lacks(self, time: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        if time + self._hold > self._positions.end:
            return {name: (np.zeros(6), np.zeros(6)) for name in self._frames}
        then = time + self._hold - self._late
        before = time - self._late
        of_then = self._velocities(then, then)
        v_then = self._v.copy()
        of_before = self._velocities(before, before)
        v_dot = (v_then - self._v) / self._hold
        found = {}
        for name, V in self._velocities(time, before).items():
            mean = (of_then[name] - of_before[name]) / self._hold
            A = self._acceleration(self._frames[name], v_dot)
            found[name] = V - of_before[name], A - mean
        return found

    def _velocities(self, time: float, late: float) -> dict[str, np.ndarray]:
        """(6,) of each frame, [angular; linear]; moves the plant to where it is at
        `time`, with its velocities at `late`."""
        q, v, context = self._q, self._v, self._context
        R, _, _ = self._root.orientation(time)
        q[self._root_q[:4]] = quaternion_from_rotation(R)
        q[self._root_q[4:]] = self._root.position(time)[0]
        q[self._joint_q] = self._positions.position(time)[0]
        v[self._root_v[:3]] = self._root.orientation(late)[1]
        v[self._root_v[3:]] = self._root.position(late)[1]
        v[self._joint_v] = self._positions.position(late)[1]
        self._plant.SetPositions(context, q)
        self._plant.SetVelocities(context, v)
        return {
            name: frame.CalcSpatialVelocityInWorld(context).get_coeffs()
            for name, frame in self._frames.items()
        }

    def _acceleration(self, frame: Frame, v_dot: np.ndarray) -> np.ndarray:
        """(6,) of a frame where the plant is, [angular; linear]."""
        plant, world = self._plant, self._plant.world_frame()
        of = JacobianWrtVariable.kV, frame, np.zeros(3), world, world
        J = plant.CalcJacobianSpatialVelocity(self._context, *of)
        bias = plant.CalcBiasSpatialAcceleration(self._context, *of)
        return J @ v_dot + bias.get_coeffs()
