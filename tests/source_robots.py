"""Positions and inertias of robots that were read from a file."""

import numpy as np
from pydrake.multibody.tree import RotationalInertia, SpatialInertia

from crar_drake.robot_import.source_robot import Inertia, SourceRobot


def random_positions(robot: SourceRobot) -> dict[str, float]:
    """Of the joints that move, within their limits; the same at every call."""
    rng = np.random.default_rng(7)
    return {
        joint.name: rng.uniform(max(joint.lower, -3.0), min(joint.upper, 3.0))
        for joint in robot.joints.values()
        if joint.moves
    }


def spatial_inertia(inertia: Inertia) -> SpatialInertia:
    """The inertia as Drake's, about the link's origin, in its frame."""
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = inertia.moments
    central = RotationalInertia(ixx, iyy, izz, ixy, ixz, iyz)
    return SpatialInertia.MakeFromCentralInertia(
        inertia.mass,
        inertia.X_LB.translation(),
        central.ReExpress(inertia.X_LB.rotation()),
    )
