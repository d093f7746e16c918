"""Inertias that are missing, zero or impossible, and what stands in for them."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import RotationalInertia

from crar_drake.robot_import.meshes import Part, convex_hulls
from crar_drake.robot_import.source_robot import Inertia, Link

_DENSITY = 500.0  # [kg/m^3] of a link without a mass: a hollow shell
_SMALL_MASS = 1e-3  # [kg]
_SMALL_INERTIA = 1e-6  # [kg m^2]


def read_inertia(link: Link) -> tuple[Inertia | None, str]:
    """The link's own inertia, and what is wrong with it ("" if nothing)."""
    inertia = link.inertia
    if inertia is None:
        return None, "has no inertia"
    if inertia.mass <= 0.0:
        return None, "has no mass"
    if not inertia.moments.any():
        return None, f"has {inertia.mass:g} kg but an inertia of zero"
    if not _is_possible(inertia.moments):
        return None, f"has an inertia that no body of {inertia.mass:g} kg can have"
    return inertia, ""


def stand_in(parts: list[Part], mass: float) -> Inertia:
    """An inertia from the link's convex hulls, with the given mass if there is one."""
    import trimesh

    hulls = convex_hulls(parts)
    if not hulls:
        mass = mass or _SMALL_MASS
        return Inertia(mass, RigidTransform(), np.eye(3) * _SMALL_INERTIA)
    hull = trimesh.util.concatenate([trimesh.Trimesh(*each) for each in hulls])
    hull.density = mass / hull.volume if mass else _DENSITY
    moments = np.asarray(hull.moment_inertia)
    return Inertia(float(hull.mass), RigidTransform(hull.center_mass), moments)


def _is_possible(moments: np.ndarray) -> bool:
    if not np.isfinite(moments).all():
        return False
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = moments
    try:
        inertia = RotationalInertia(ixx, iyy, izz, ixy, ixz, iyz)
        return bool(inertia.CouldBePhysicallyValid())
    except RuntimeError:
        return False
