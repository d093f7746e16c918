"""Meshes of any common format, as what Drake reads: OBJ, in metres, one colour each.

A glTF file has y up, always, and is turned before its scale counts, as Drake does. What
a DAE file says is up counts if `up_axis` says so.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, Sphere
from pydrake.math import RigidTransform

from crar_drake.errors import ModelError
from crar_drake.files import write_whole
from crar_drake.judging.mesh_distance import TriangleMesh, triangle_distance
from crar_drake.robot.mesh_files import Y_UP, Z_UP, read_meshes
from crar_drake.robot_import.source_robot import (
    Link,
    Poses,
    Positions,
    Shape,
    SourceRobot,
)

if TYPE_CHECKING:
    import trimesh

_HEAD = 20_000  # bytes of a DAE file, which its asset element is within
GREY = (0.7, 0.7, 0.7, 1.0)


@dataclass(frozen=True)
class Part:
    """One colour of a visual element, in its link's frame L."""

    vertices: np.ndarray  # (N, 3) p_LV [m]
    faces: np.ndarray  # (M, 3) indices of vertices
    rgba: tuple[float, ...]  # its colour

    def moved(self, X_AL: RigidTransform) -> Part:
        """The same in another frame A."""
        vertices = self.vertices @ X_AL.rotation().matrix().T + X_AL.translation()
        return Part(vertices, self.faces, self.rgba)


Looks = Mapping[str, Sequence[Part]]  # link to its real look, in its frame


def vertices_of(
    parts: Sequence[Part], X_AL: RigidTransform | None = None
) -> np.ndarray:
    """(N, 3) all vertices of a link's parts, in its frame or in another one A [m]."""
    vertices = np.concatenate([part.vertices for part in parts])
    return vertices if X_AL is None else X_AL.multiply(vertices.T).T


def triangles_of(parts: Sequence[Part]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (N, 3) and faces (M, 3) of all parts together."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + n for part, n in zip(parts, first, strict=False)]
    return vertices_of(parts), np.concatenate(faces)


class Surfaces:
    """How far links are apart by their triangles, which are prepared when they are
    first asked for."""

    def __init__(self, segments: Looks) -> None:
        self._segments = segments
        self._meshes: dict[str, TriangleMesh] = {}

    def gap(self, X: Poses, a: str, b: str) -> float:
        """Distance of two links' nearest triangles; 0 where some intersect [m]."""
        for name in {a, b} - set(self._meshes):
            self._meshes[name] = TriangleMesh(*triangles_of(self._segments[name]))
        X_AB = X[a].InvertAndCompose(X[b])
        return max(0.0, triangle_distance(self._meshes[a], self._meshes[b], X_AB))


def link_parts(link: Link, up_axis: str = "z") -> list[Part]:
    """The link's real look: its visual elements, else its collision elements.

    Args:
        up_axis: "z" if all DAE files have z up, whatever they say; "file" if each is
            to be turned as its up_axis says.

    Raises:
        ModelError: a mesh cannot be read.
    """
    shapes = link.visual or link.collision
    return [
        part for shape in shapes for part in _shape_parts(shape, link.name, up_axis)
    ]


def with_looks(robot: SourceRobot, up_axis: str = "z") -> SourceRobot:
    """The robot with the looks of its links; arguments and errors as `link_parts`."""
    looks = {name: link_parts(link, up_axis) for name, link in robot.links.items()}
    return replace(robot, looks=looks)


def lowest_points(
    robot: SourceRobot, positions: Positions | None = None
) -> dict[str, float]:
    """How low each link that has a look reaches [m], joints being where they are
    locked, at zero or where `positions` says."""
    X = robot.posed(positions)
    return {
        link: float(vertices_of(of_link, X[link])[:, 2].min())
        for link, of_link in robot.looks.items()
        if of_link
    }


def dae_up_axis(path: Path) -> str:
    """What a DAE file says is up: "x", "y" or "z"; "z" for other files."""
    if path.suffix.lower() != ".dae":
        return "z"
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    found = re.search(rb"<up_axis>\s*([XYZ])_UP", head)
    return found.group(1).decode().lower() if found else "y"  # COLLADA's default


def guess_up_axis(robot: SourceRobot) -> tuple[str, str] | None:
    """Whether DAE files tell the truth about what is up.

    A link's mesh reaches from its own joint to those that it carries: of both readings
    that one is taken whose meshes are nearer to the joints.

    Returns:
        "file" or "z" (`link_parts`), and how that was found; None where no mesh says
        anything but z.
    """
    apart = {"z": 0.0, "file": 0.0}
    told = False
    for name, link in robot.links.items():
        files = [s.path for s in link.visual or link.collision if s.path is not None]
        if all(dae_up_axis(path) == "z" for path in files):
            continue
        told = True
        joints = [joint.X_PC.translation() for joint in robot.children(name)]
        p_L = np.array([np.zeros(3), *joints])
        for reading in apart:
            vertices = vertices_of(link_parts(link, reading))
            lower, upper = vertices.min(axis=0), vertices.max(axis=0)
            outside = np.maximum(np.maximum(lower - p_L, p_L - upper), 0.0)
            apart[reading] += float(np.linalg.norm(outside, axis=1).sum())
    if not told:
        return None
    reading = "file" if apart["file"] < 0.9 * apart["z"] else "z"
    why = "turned as they say" if reading == "file" else "whatever they say"
    return reading, (
        f"DAE meshes are nearest to their joints {why}: "
        f"{apart['file']:.2f} m turned, {apart['z']:.2f} m not"
    )


def _shape_parts(shape: Shape, link: str, up_axis: str) -> list[Part]:
    import trimesh

    of, make = shape.geometry, trimesh.creation
    if shape.path is not None:
        pieces = _load(shape.path, of.scale3(), link, up_axis)
    elif isinstance(of, Convex):
        hull = of.GetConvexHull()
        corners = [hull.vertex(i) for i in range(hull.num_vertices())]
        pieces = [(trimesh.convex.convex_hull(corners), None)]
    elif isinstance(of, tuple):
        pieces = [(trimesh.Trimesh(*of), None)]
    else:
        makers = {
            Box: lambda: make.box(extents=of.size()),
            Sphere: lambda: make.icosphere(3, radius=of.radius()),
            Cylinder: lambda: make.cylinder(
                radius=of.radius(), height=of.length(), sections=48
            ),
            Capsule: lambda: make.capsule(radius=of.radius(), height=of.length()),
            Ellipsoid: lambda: make.icosphere(3).apply_scale([of.a(), of.b(), of.c()]),
        }
        pieces = [(makers[type(of)](), None)]
    X_LG = shape.X_LG.GetAsMatrix4()
    parts = []
    for mesh, colour in pieces:
        mesh.apply_transform(X_LG)
        parts.append(
            Part(
                np.asarray(mesh.vertices, dtype=float),
                np.asarray(mesh.faces),
                tuple(shape.rgba or colour or GREY),
            )
        )
    return parts


def _load(path: Path, scale: np.ndarray, link: str, up_axis: str) -> list[tuple]:
    """The file's meshes, turned z up, scaled, one for each colour, with that colour."""
    import trimesh

    up = dae_up_axis(path) if up_axis == "file" else "z"
    up = "y" if path.suffix.lower() in Y_UP else up
    where = f"link {link!r}: mesh {path}"
    by_colour: dict[tuple, list] = {}
    for body in read_meshes(path, where):
        if len(bad := np.flatnonzero(~np.isfinite(body.vertices).all(axis=1))):
            p = ", ".join(f"{x:g}" for x in body.vertices[bad[0]])
            raise ModelError(f"{where}: vertex {bad[0] + 1} is ({p})")
        body.apply_scale(_metres(body.units))
        colour = _colour(body)
        by_colour.setdefault(colour, []).append(body)
    if not by_colour:
        raise ModelError(f"{where} has no triangles")
    pieces = []
    for colour, members in by_colour.items():
        mesh = trimesh.util.concatenate(
            [trimesh.Trimesh(m.vertices, m.faces, process=False) for m in members]
        )
        if up != "z":
            mesh.apply_transform(Z_UP[up])
        # A mirroring scale turns triangles inside out; trimesh turns them back.
        mesh.apply_transform(np.diag([*scale, 1.0]))
        mesh.merge_vertices(merge_norm=True, merge_tex=True)
        pieces.append((mesh, colour))
    return pieces


def _metres(units: str | None) -> float:
    """A COLLADA file's unit, which trimesh reads but does not apply."""
    if units is None or units == "meters":
        return 1.0
    return float(units.partition("*")[0])


def _colour(mesh) -> tuple[float, ...] | None:
    material = getattr(mesh.visual, "material", None)
    if material is None:
        return None
    colour = np.asarray(material.main_color, dtype=float) / 255.0
    return tuple(round(float(c), 4) for c in colour)


def convex_hulls(parts: Sequence[Part]) -> list[trimesh.Trimesh]:
    """Each part's convex hull; flat parts have none."""
    import trimesh
    from scipy.spatial import QhullError

    hulls = []
    for part in parts:
        mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
        try:
            # trimesh asks for the centre of mass, which a flat hull does not have.
            with np.errstate(invalid="ignore", divide="ignore"):
                hull = mesh.convex_hull
                volume = hull.volume
        except QhullError:
            continue
        if volume > 1e-9:
            hulls.append(hull)
    return hulls


def simplified(part: Part, faces: int) -> Part:
    """The part with at most about `faces` triangles (quadric decimation)."""
    if len(part.faces) <= faces:
        return part
    import trimesh

    mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
    small = mesh.simplify_quadric_decimation(face_count=faces)
    return Part(np.asarray(small.vertices), np.asarray(small.faces), part.rgba)


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices (N, 3) and faces (M, 3) of a file as `write_obj` writes it, in half the
    time that trimesh takes; None if it is another one."""
    head, _, tail = path.read_bytes().partition(b"f")
    if not head.startswith(b"v ") or not tail.strip():
        return None
    try:
        vertices = np.loadtxt(BytesIO(head.replace(b"v", b"")), ndmin=2)
        faces = np.loadtxt(BytesIO(tail.replace(b"f", b"")), dtype=int, ndmin=2) - 1
    except ValueError:
        return None
    if not vertices.shape[1:] == faces.shape[1:] == (3,):
        return None
    known = 0 <= faces.min() and faces.max() < len(vertices)
    return (vertices, faces) if known and np.isfinite(vertices).all() else None


def write_obj(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Writes an OBJ without normals, so that edges stay sharp when drawn."""
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in np.asarray(faces) + 1]
    write_whole(path, "\n".join(lines) + "\n")
