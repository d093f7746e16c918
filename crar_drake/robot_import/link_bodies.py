"""What links are made of: capsules that others enclose, inertias that dynamics need."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import RotationalInertia

from crar_drake.errors import few
from crar_drake.robot_import.capsule_fitting import coverage
from crar_drake.robot_import.covering import covered
from crar_drake.robot_import.import_report import ImportReport
from crar_drake.robot_import.meshes import Looks, Part, convex_hulls, vertices_of
from crar_drake.robot_import.source_robot import (
    WORLD,
    Inertia,
    Link,
    SourceRobot,
)
from crar_drake.robot_import.structure import welded_groups

_DENSITY = 500.0  # [kg/m^3] of a link without a mass: a hollow shell
_SMALL_MASS = 1e-3  # [kg]
_SMALL_INERTIA = 1e-6  # [kg m^2]
_MOST = 5  # links without mass that are named


def find_covered(robot: SourceRobot, segments: Looks, report: ImportReport) -> None:
    """Links that lie inside another link's capsules need none of their own."""
    group = welded_groups(robot)
    X = robot.posed()
    by_size = sorted(
        report.fits, key=lambda name: np.ptp(vertices_of(segments[name]), axis=0).max()
    )
    for name in by_size:
        for other in report.fits:
            if other == name or other in report.covered or group[other] != group[name]:
                continue
            p_O = vertices_of(segments[name], X[other].inverse() @ X[name])
            if coverage(report.fits[other].capsules, p_O) >= 0.995:
                report.covered[name] = other
                break


def cover_triangles(robot: SourceRobot, segments: Looks, report: ImportReport) -> None:
    """Grows each link's capsules to hold its triangles, and those of links inside."""
    X, grown = robot.posed(), {}
    for name in report.fits:
        if name in report.covered:
            continue
        parts = list(segments[name])
        for other in (o for o, of in report.covered.items() if of == name):
            X_LO = X[name].inverse() @ X[other]
            parts += [part.moved(X_LO) for part in segments[other]]
        report.fits[name], grown[name] = covered(report.fits[name], parts)
    report.note(
        "capsules were grown until they hold all triangles, the radii by at most [mm]",
        [f"{name} {1e3 * by:.1f}" for name, by in grown.items()],
    )


def find_inertias(robot: SourceRobot, report: ImportReport) -> dict[str, Inertia]:
    """The URDF's inertias, and a stand-in where the dynamics need one."""
    group = welded_groups(robot)
    inertias: dict[str, Inertia] = {}
    wrong: dict[str, str] = {}
    for name, link in robot.links.items():
        inertia, complaint = read_inertia(link)
        if inertia is not None:
            inertias[name] = inertia
        elif link.mass > 0.0:
            inertias[name] = stand_in(robot.looks[name], link.mass)
            report.notes.append(
                f"inertia: link {name} {complaint}: taken from its convex hull"
            )
        else:
            wrong[name] = complaint
    massive = {group[name] for name in inertias}
    left_alone, bare = [], []
    for name, complaint in wrong.items():
        if group[name] in massive or group[name] == robot.root:
            left_alone.append(name)
            continue
        inertias[name] = stand_in(robot.looks[name], 0.0)
        massive.add(group[name])
        if not robot.looks[name]:
            bare.append(name)
            continue
        report.notes.append(
            f"inertia: link {name} {complaint} but moves: given "
            f"{inertias[name].mass:.3g} kg from its convex hull"
        )
    if bare:
        report.notes.append(
            "inertia: without mass and geometry but moving, given "
            f"{inertias[bare[0]].mass:g} kg each: {few(bare, _MOST)}"
        )
    if left_alone:
        report.notes.append(
            "inertia: without mass, and left so since they are welded to links that "
            f"have one: {few(left_alone, _MOST)}"
        )
    # Drake's own world, which a link of that name is, takes no mass.
    if robot.root not in massive and robot.root != WORLD:
        inertias[robot.root] = stand_in([], 0.0)
    return inertias


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
    hull = trimesh.util.concatenate(hulls)
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
