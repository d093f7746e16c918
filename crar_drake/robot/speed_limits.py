"""How fast a robot's joints may be: as its model says, or its description instead."""

from __future__ import annotations

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.errors import ModelError
from crar_drake.robot.description import RobotDescription, find_joint


def speed_limits(plant: MultibodyPlant, description: RobotDescription) -> np.ndarray:
    """(nv,) largest speed of each velocity, inf where there is none [rad/s or m/s].

    Args:
        plant: finalized. Of two different limits of a joint the smaller magnitude
            counts; 0 says that none is stated.
        description: its `velocity_limits` count instead, for the joints they name.

    Raises:
        ModelError: it names a joint that does not exist or is fixed.
    """
    limits = np.minimum(
        np.abs(plant.GetVelocityLowerLimits()),
        np.abs(plant.GetVelocityUpperLimits()),
    )
    limits[limits == 0.0] = np.inf  # what many exporters write for "unknown"
    for name, limit in description.velocity_limits.items():
        try:
            joint = find_joint(plant, name)
        except ModelError as error:
            raise ModelError(
                f"robot {description.name}: velocity_limits: {error}"
            ) from error
        if not joint.num_velocities():
            raise ModelError(
                f"robot {description.name}: velocity_limits: {name!r} is fixed; "
                "leave it out"
            )
        start = joint.velocity_start()
        limits[start : start + joint.num_velocities()] = limit
    return limits
