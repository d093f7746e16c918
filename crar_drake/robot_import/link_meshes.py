"""The real shape of each link of a plant, as triangles."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydrake.geometry import (
    Convex,
    HalfSpace,
    Mesh,
    Role,
    SceneGraph,
    SceneGraphInspector,
    Shape as DrakeShape,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody

from crar_drake.errors import ModelError
from crar_drake.resources import require_packages
from crar_drake.robot_import.meshes import GREY, Part, link_parts, read_obj
from crar_drake.robot_import.robot_folder import TRIANGLES, triangles_file
from crar_drake.robot_import.source_robot import Link, Shape, drake_shape

# Module to the package that brings it.
_PACKAGES = {"trimesh": "trimesh", "fcl": "python-fcl", "coal": "coal"}


@dataclass(frozen=True)
class LinkMesh:
    """What a link looks like."""

    name: str  # of the link; `model::link` where several models have one of that name
    body: BodyIndex  # of the plant
    parts: list[Part]  # triangles by mesh file or primitive, in the link's frame


def has_meshes(plant: MultibodyPlant, scene_graph: SceneGraph) -> bool:
    """Whether a link of a finalized plant has a mesh of a file; primitives and convex
    points alone are what the referee knows."""
    inspector = scene_graph.model_inspector()
    return any(
        _is_of_file(inspector.GetShape(geometry))
        for body in _bodies(plant)
        for geometry in _geometries(plant, inspector, body)
    )


def check_installed() -> None:
    """Asks for what meshes are read and compared with, before a long judgement.

    Meshes of an imported robot are read without trimesh, and judged without Coal, which
    take a while to import.

    Raises:
        ModelError: a package of the extra `robots` is not installed, or is broken;
            that trimesh or Coal is broken is told when it is used.
    """
    require_packages(
        _PACKAGES,
        "judging by meshes",
        " (or judge by the collision shapes alone: --no-meshes)",
        later=("trimesh", "coal"),
    )


def read_link_meshes(plant: MultibodyPlant, scene_graph: SceneGraph) -> list[LinkMesh]:
    """Reads the visual shapes of each link of a finalized plant, or if it has none its
    collision shapes.

    Of a robot that `crar-drake import-robot` made, all triangles of its meshes are
    read, not the simplified ones that are drawn. Primitives become triangles as the
    import makes them. A half space has none and is left out.

    Returns:
        One entry for each link that has a shape, the world among them.

    Raises:
        ModelError: a mesh file is not there, cannot be read, or has no triangles; the
            message names link and file.
    """
    inspector = scene_graph.model_inspector()
    meshes = []
    for body in _bodies(plant):
        name = _name(plant, body)
        parts = []
        for geometry in _geometries(plant, inspector, body):
            pose = inspector.GetPoseInFrame(geometry)
            shape = _shape(inspector.GetShape(geometry), pose, name)
            if shape is not None:
                parts += _of_import(shape) or link_parts(Link(name, (shape,)))
        if parts:
            meshes.append(LinkMesh(name, body.index(), parts))
    return meshes


def _of_import(shape: Shape) -> list[Part]:
    """Of a file that the import wrote, which is read sooner than others."""
    if shape.path is None or shape.path.parent.name != TRIANGLES:
        return []
    found = read_obj(shape.path) if shape.scale == (1.0, 1.0, 1.0) else None
    if found is None:
        return []
    # By rows: of another order, functions are compiled anew.
    p_LV = np.ascontiguousarray(shape.X_LG.multiply(found[0].T).T)
    return [Part(p_LV, found[1], tuple(shape.rgba or GREY))]


def _is_of_file(shape: DrakeShape) -> bool:
    return isinstance(shape, Mesh | Convex) and shape.source().is_path()


def _bodies(plant: MultibodyPlant) -> list[RigidBody]:
    return [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]


def _geometries(plant, inspector: SceneGraphInspector, body: RigidBody) -> list:
    frame = plant.GetBodyFrameIdOrThrow(body.index())
    for role in (Role.kIllustration, Role.kProximity):
        found = inspector.GetGeometries(frame, role)
        if found:
            return found
    return []


def _name(plant: MultibodyPlant, body: RigidBody) -> str:
    if plant.NumBodiesWithName(body.name()) > 1:
        return str(body.scoped_name())
    return body.name()


def _shape(shape: DrakeShape, X_LG: RigidTransform, link: str) -> Shape | None:
    """What the import calls the shape."""
    if isinstance(shape, HalfSpace):
        return None
    if isinstance(shape, Mesh) and not _is_of_file(shape):
        raise ModelError(f"link {link!r}: its mesh is not in a file")
    path = _file(shape, link) if _is_of_file(shape) else None
    found = drake_shape(X_LG, shape)
    if found is None:
        raise ModelError(
            f"link {link!r}: cannot be judged by meshes: it has a "
            f"{type(shape).__name__} (judge by the collision shapes alone: --no-meshes)"
        )
    return found if path is None else replace(found, path=path)


def _file(shape: Mesh | Convex, link: str) -> Path:
    """The file of a mesh with all its triangles."""
    path = Path(shape.source().path())
    if path.parent.name == "meshes" and (path.parent.parent / "import.yaml").is_file():
        path = triangles_file(path)
    if not path.is_file():
        raise ModelError(
            f"link {link!r}: its mesh {path} is not there; of an imported robot, "
            "import it again"
        )
    return path
