"""What an MJCF's bodies look like and collide with: their geoms, as shapes."""

from __future__ import annotations

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from crar_drake.robot_import.source_robot import Shape

_HIDDEN_GROUP = 3  # MuJoCo's viewer shows the geoms of groups below it
_DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)  # of a geom without a colour


def body_shapes(
    model, body: int, link: str, notes: list[str]
) -> tuple[tuple[Shape, ...], tuple[Shape, ...]]:
    """What is seen of a body, and what collides, in the body's frame.

    Args:
        model: compiled by MuJoCo.
        body: its index in the model.
        link: the name it has here.
        notes: gets a line for each geom that has no volume of its own.
    """
    first = int(model.body_geomadr[body])
    seen, hidden, colliding = {}, {}, {}
    for geom in range(first, first + int(model.body_geomnum[body])):
        shape = _shape(model, geom, link, notes)
        if shape is None:
            continue
        # The same mesh is often there twice, to be seen and to collide.
        key = (
            shape.kind,
            int(model.geom_dataid[geom]),
            *np.round(model.geom_size[geom], 6),
            *np.round(shape.X_LG.GetAsMatrix34().ravel(), 6),
        )
        group, alpha = model.geom_group[geom], (shape.rgba or _DEFAULT_RGBA)[3]
        if group < _HIDDEN_GROUP and alpha > 0.0:
            seen.setdefault(key, shape)
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        (colliding if collides else hidden).setdefault(key, shape)
    if not seen and not colliding:
        seen = hidden
    return tuple(seen.values()), tuple(colliding.values())


def _shape(model, geom: int, link: str, notes: list[str]) -> Shape | None:
    """A geom; None where it has no volume of its own."""
    import mujoco

    kind = mujoco.mjtGeom(int(model.geom_type[geom])).name
    kind = kind.removeprefix("mjGEOM_").lower()
    a, b, c = (float(v) for v in model.geom_size[geom])
    sizes = {
        "sphere": (a,),
        "capsule": (a, 2 * b),
        "cylinder": (a, 2 * b),
        "box": (2 * a, 2 * b, 2 * c),
        "ellipsoid": (a, b, c),
        "mesh": (),
    }
    if kind not in sizes:
        notes.append(f"link {link}: a shape of kind {kind} is left out")
        return None
    X, rgba = pose_of(model, "geom", geom), _colour(model, geom)
    if kind == "mesh":
        return Shape(X, "triangles", triangles=_triangles(model, geom), rgba=rgba)
    return Shape(X, kind, size=sizes[kind], rgba=rgba)


def _triangles(model, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """A mesh as MuJoCo has it: scaled, in its own inertial frame."""
    mesh = int(model.geom_dataid[geom])
    vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    vertices = model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[mesh])]
    faces = model.mesh_face[face : face + int(model.mesh_facenum[mesh])]
    return np.array(vertices, dtype=float), np.array(faces)


def _colour(model, geom: int) -> tuple[float, ...] | None:
    """A geom's own colour, else its material's."""
    material = int(model.geom_matid[geom])
    rgba = tuple(float(v) for v in model.geom_rgba[geom])
    if np.allclose(rgba, _DEFAULT_RGBA):
        if material < 0:
            return None
        rgba = tuple(float(v) for v in model.mat_rgba[material])
    return tuple(round(min(max(v, 0.0), 1.0), 4) for v in rgba)


def pose_of(model, kind: str, index: int) -> RigidTransform:
    """Of a body, geom or site, in its body's (a body: its parent's) frame."""
    wxyz = np.array(getattr(model, f"{kind}_quat")[index])
    p = np.array(getattr(model, f"{kind}_pos")[index])
    R = RotationMatrix(Quaternion(wxyz / np.linalg.norm(wxyz)))
    return RigidTransform(R, p)
