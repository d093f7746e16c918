"""What stands fixed in the world and is given as meshes: a table, a shelf.

Distances are those of convex pieces. A mesh file is taken apart into its connected
pieces, as boards of a shelf are, and of each its hull counts.
"""

# YAML loading reads the types of the fields, so no postponed annotations here.
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydrake.geometry import Convex, ReadObjToTriangleSurfaceMesh
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from crar_drake.errors import ModelError, check_vector
from crar_drake.resources import install_command
from crar_drake.robot.mesh_files import Y_UP, Z_UP, read_meshes

# A piece is convex if its hull is nowhere farther beyond it [m].
CONVEX_TOLERANCE = 1e-3

# What is read with the extra `robots`.
_OTHER_FORMATS = (".stl", ".ply", *Y_UP)

# A scale nearer to 0 leaves nothing.
_SMALLEST_SCALE = 1e-8

_COLOUR = np.array([0.75, 0.72, 0.66, 1.0])


@dataclass
class Fixture:
    """A thing that stands in the world."""

    # files, by their paths from robot.yaml on: OBJ; STL, PLY and glTF with the extra
    # `robots`
    meshes: list[str] = field(default_factory=list)
    scale: float = 1.0  # to metres
    # where its origin is in the world [m]
    xyz: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    # how it is turned, as a URDF's origin [rad]
    rpy: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    hull: bool = False  # whether of pieces that are not convex the hull counts as well

    def validate(self, where: str) -> None:
        """Raises ModelError where a value is none; `where` is what it begins with."""
        if not self.meshes:
            raise ModelError(f"{where}: meshes: there is none; name a mesh file")
        if not math.isfinite(self.scale) or abs(self.scale) < _SMALLEST_SCALE:
            raise ModelError(f"{where}: scale: {self.scale} must be a number, not 0")
        for name in ("xyz", "rpy"):
            check_vector(f"{where}: {name}", getattr(self, name), ModelError)


def add_environment(
    plant: MultibodyPlant, fixtures: Mapping[str, Fixture], folder: Path
) -> None:
    """Adds links that are welded to the world, with a shape for each convex piece.

    Args:
        plant: not finalized.
        fixtures: by name, which is that of the link.
        folder: where their files are looked for.

    Raises:
        ModelError: there is such a link already; or a file cannot be read, or has a
            piece that is flat, or not convex where it has to be.
    """
    for name, fixture in fixtures.items():
        if plant.HasBodyNamed(name):
            raise ModelError(
                f"environment: {name}: there is a link of that name already; give it "
                "another one"
            )
        instance = plant.AddModelInstance(f"environment_{name}")
        body = plant.AddRigidBody(name, instance)
        X_WB = RigidTransform(RollPitchYaw(fixture.rpy), fixture.xyz)
        plant.WeldFrames(plant.world_frame(), body.body_frame(), X_WB)
        count = 0
        for file in fixture.meshes:
            for points in convex_pieces(folder / file, fixture.scale, fixture.hull):
                shape = Convex(points.T, f"{name}_{count}")
                of = body, RigidTransform(), shape, f"{name}_{count}"
                plant.RegisterCollisionGeometry(*of, CoulombFriction(1.0, 1.0))
                plant.RegisterVisualGeometry(*of, _COLOUR)
                count += 1


def convex_pieces(
    path: Path, scale: float = 1.0, hull: bool = False
) -> list[np.ndarray]:
    """The corners (V, 3) of each connected piece's hull, in the mesh's frame [m].

    Args:
        hull: whether a piece need not be convex.

    Raises:
        ModelError: names the file, the piece and what to do.
    """
    pieces = []
    for vertices, faces in _read(path):
        if not np.isfinite(vertices).all():
            raise ModelError(f"{path}: a vertex is no number")
        found = _connected(vertices, faces)
        if any(_flat(vertices, piece) for piece in found):
            # Formats that repeat the corners of each triangle connect nothing.
            vertices, places = np.unique(vertices, axis=0, return_inverse=True)
            found = _connected(vertices, places.reshape(-1)[faces])
        pieces += [vertices[piece] * scale for piece in found]
    if not pieces:
        raise ModelError(f"{path}: the mesh has no triangles")
    corners = []
    for number, triangles in enumerate(pieces, 1):
        points, where = triangles.reshape(-1, 3), f"{path}: piece {number}"
        where += f" of {len(pieces)}"
        try:
            of_hull = ConvexHull(points)
        except QhullError as error:
            raise ModelError(f"{where} is flat; give it a thickness") from error
        # How deep its surface is inside: corners, and middles of triangles.
        looked_at = np.concatenate([points, triangles.mean(axis=1)])
        n, offset = of_hull.equations[:, :3], of_hull.equations[:, 3]
        depth = -(looked_at @ n.T + offset).max(axis=1).min()
        if depth > CONVEX_TOLERANCE and not hull:
            raise ModelError(
                f"{where} is not convex: its hull is at least {1e3 * depth:.0f} mm "
                "beyond it; save it as several pieces that are (a library that "
                "decomposes meshes does that), or write hull: true for the robot to "
                "keep off the hull"
            )
        corners.append(points[of_hull.vertices])
    return corners


def _connected(vertices: np.ndarray, faces: np.ndarray) -> list[np.ndarray]:
    """The faces (M, 3) of each connected piece."""
    if not len(faces):
        return []
    a, b, c = faces.T
    sides = np.concatenate([a, b]), np.concatenate([b, c])
    graph = coo_array((np.ones(len(sides[0])), sides), shape=2 * (len(vertices),))
    _, piece = connected_components(graph, directed=False)
    return [faces[piece[a] == of] for of in np.unique(piece[a])]


def _flat(vertices: np.ndarray, faces: np.ndarray) -> bool:
    points = vertices[np.unique(faces)]
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return len(extents) < 3 or extents[2] < 1e-9 * extents[0]


def _read(path: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """Vertices (N, 3) and faces (M, 3) of each of the file's meshes, z up."""
    if not path.is_file():
        raise ModelError(f"{path}: there is no such mesh file")
    if path.suffix.lower() == ".obj":
        try:
            mesh = ReadObjToTriangleSurfaceMesh(path)
        except RuntimeError as error:
            raise ModelError(f"{path}: cannot be read: {error}") from error
        faces = [[t.vertex(i) for i in range(3)] for t in mesh.triangles()]
        return [(np.array(mesh.vertices()), np.array(faces, dtype=int))]
    suffix = path.suffix.lower()
    if suffix not in _OTHER_FORMATS:
        raise ModelError(
            f"{path}: a mesh is read from {', '.join(('.obj', *_OTHER_FORMATS))}; save "
            "it as one of these"
        )
    try:
        meshes = read_meshes(path, f"{path}:")
    except ImportError as error:
        raise ModelError(
            f"{path}: only OBJ files are read without the extra robots; run "
            f"`{install_command('robots')}`, or save the mesh as OBJ"
        ) from error
    turn = Z_UP["y" if suffix in Y_UP else "z"][:3, :3]
    return [
        (np.asarray(mesh.vertices, dtype=float) @ turn.T, np.asarray(mesh.faces))
        for mesh in meshes
    ]
