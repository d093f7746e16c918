"""Inertias that are missing, zero or impossible, and what stands in for them."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.tree import RotationalInertia

from crar_drake.robot_import.meshes import Part, convex_hulls
from crar_drake.robot_import.source_robot import Link
from crar_drake.robot_import.xml_numbers import one_number, vector_of

_DENSITY = 500.0  # [kg/m^3] of a link without a mass: a hollow shell
_SMALL_MASS = 1e-3  # [kg]
_SMALL_INERTIA = 1e-6  # [kg m^2]


@dataclass(frozen=True)
class Inertia:
    """Mass and central inertia of a link.

    Attributes:
        mass: [kg].
        X_LB: pose of the central frame in the link's.
        moments: (3, 3) central inertia in that frame [kg m^2].
    """

    mass: float
    X_LB: RigidTransform
    moments: np.ndarray


def read_inertia(link: Link) -> tuple[Inertia | None, str]:
    """The link's own inertia, and what is wrong with it ("" if nothing)."""
    element = link.inertial
    mass_element = None if element is None else element.find("mass")
    if mass_element is None:
        return None, "has no inertia"
    mass = one_number(mass_element.get("value", "0"))
    if mass <= 0.0:
        return None, "has no mass"
    origin, matrix = element.find("origin"), element.find("inertia")
    xyz = rpy = np.zeros(3)
    if origin is not None:
        xyz, rpy = (vector_of(origin.get(key, "0 0 0")) for key in ("xyz", "rpy"))
    X = RigidTransform(RollPitchYaw(rpy), xyz)
    ixx, iyy, izz, ixy, ixz, iyz = (
        one_number(matrix.get(key, "0")) if matrix is not None else 0.0
        for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    moments = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    if not moments.any():
        return None, f"has {mass:g} kg but an inertia of zero"
    if not _is_possible(moments):
        return None, f"has an inertia that no body of {mass:g} kg can have"
    return Inertia(mass, X, moments), ""


def inertial_element(
    mass: float, p_LC: np.ndarray, moments: np.ndarray
) -> ElementTree.Element:
    """A link's mass and central inertia as a URDF has them, all digits.

    Args:
        mass: [kg].
        p_LC: (3,) the centre of mass in the link's frame [m].
        moments: (3, 3) about that, in the link's axes [kg m^2].
    """
    element = ElementTree.Element("inertial")
    p = " ".join(repr(float(v)) for v in p_LC)
    ElementTree.SubElement(element, "origin", xyz=p)
    ElementTree.SubElement(element, "mass", value=repr(mass))
    ElementTree.SubElement(
        element,
        "inertia",
        **{
            f"i{a}{b}": repr(float(moments["xyz".index(a), "xyz".index(b)]))
            for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")
        },
    )
    return element


def own_mass(link: Link) -> float:
    """The mass that the URDF gives [kg]; 0 if none."""
    mass = None if link.inertial is None else link.inertial.find("mass")
    return 0.0 if mass is None else one_number(mass.get("value", "0"))


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
