"""A log's columns of the controlled joints."""

from dataclasses import dataclass

import numpy as np

from crar_drake.results.log import SimulationLog


@dataclass(frozen=True)
class ControlledJoints:
    """A log's columns of the controlled joints: T samples, n joints."""

    names: tuple[str, ...]  # (n,) the joints
    units: tuple[str, ...]  # (n,) of their positions, "rad" or "m"
    q: np.ndarray  # (T, n) positions [rad or m]
    v: np.ndarray  # (T, n) velocities [rad/s or m/s]
    torque: np.ndarray  # (T, n) efforts [Nm or N]
    acceleration: np.ndarray  # (T, n) commanded accelerations [rad/s² or m/s²]
    lower: np.ndarray  # (n,) limits, minus infinity where there is none [rad or m]
    upper: np.ndarray  # (n,) and infinity [rad or m]
    # (T, n) how far beyond the nearer limit, negative inside, -inf for an unlimited
    # joint [rad or m]
    excess: np.ndarray
    velocity_limits: np.ndarray  # (n,) infinite where there is none [as v]
    speed_excess: np.ndarray  # (T, n) beyond these, negative where slower [as v]
    effort_limits: np.ndarray  # (n,) infinite where there is none [as torque]

    @property
    def power(self) -> np.ndarray:
        """(T,) sum over the joints of |tau_i qdot_i| [W]."""
        return np.abs(self.torque * self.v).sum(axis=1)


def controlled_joints(log: SimulationLog) -> ControlledJoints:
    """Picks the columns of the controlled joints out of a log, by name."""
    positions = log.position_names.tolist()
    columns = [positions.index(name) for name in log.controlled_names]
    q, lower, upper = log.q[:, columns], log.lower[columns], log.upper[columns]
    torque = [
        # More than one actuator may move a joint.
        log.actuation[:, log.actuator_names == name].sum(axis=1)
        for name in log.controlled_names
    ]
    strongest = [
        log.effort_limits[log.actuator_names == name].sum()
        for name in log.controlled_names
    ]
    velocities = log.velocity_names.tolist()
    columns = [velocities.index(name) for name in log.controlled_names]
    v, fastest = log.v[:, columns], log.velocity_limits[columns]
    return ControlledJoints(
        names=tuple(log.controlled_names.tolist()),
        units=tuple(log.controlled_units.tolist()),
        q=q,
        v=v,
        torque=np.stack(torque, axis=1),
        acceleration=log.desired_acceleration[:, columns],
        lower=lower,
        upper=upper,
        excess=np.maximum(q - upper, lower - q),
        velocity_limits=fastest,
        speed_excess=np.abs(v) - fastest,
        effort_limits=np.array(strongest),
    )
