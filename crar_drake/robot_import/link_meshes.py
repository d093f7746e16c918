"""The real shape of each link of a plant, as triangles."""

from dataclasses import dataclass, replace

import numpy as np
from pydrake.geometry import HalfSpace, Mesh, Role, SceneGraph, SceneGraphInspector
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody

from crar_drake.errors import ModelError
from crar_drake.resources import require_packages
from crar_drake.robot_import.meshes import GREY, Part, link_parts, read_obj
from crar_drake.robot_import.robot_folder import triangles_file
from crar_drake.robot_import.source_robot import Geometry, Link, Shape

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
        shape.path is not None
        for body in _bodies(plant)
        for shape in _shapes(plant, inspector, body)
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
        name = body.name()
        if plant.NumBodiesWithName(name) > 1:
            name = str(body.scoped_name())
        parts = []
        for shape in _shapes(plant, inspector, body):
            if not isinstance(shape.geometry, HalfSpace):
                parts += _parts(shape, name)
        if parts:
            meshes.append(LinkMesh(name, body.index(), parts))
    return meshes


def _bodies(plant: MultibodyPlant) -> list[RigidBody]:
    return [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]


def _shapes(plant, inspector: SceneGraphInspector, body: RigidBody) -> list[Shape]:
    """What is drawn of a body, else what collides, of whatever kind."""
    frame = plant.GetBodyFrameIdOrThrow(body.index())
    found = inspector.GetGeometries(frame, Role.kIllustration)
    return [
        Shape(inspector.GetPoseInFrame(each), inspector.GetShape(each))
        for each in found or inspector.GetGeometries(frame, Role.kProximity)
    ]


def _parts(shape: Shape, link: str) -> list[Part]:
    of = shape.geometry
    if isinstance(of, Mesh) and shape.path is None:
        raise ModelError(f"link {link!r}: its mesh is not in a file")
    if not isinstance(of, Geometry):
        raise ModelError(
            f"link {link!r}: cannot be judged by meshes: it has a {type(of).__name__} "
            "(judge by the collision shapes alone: --no-meshes)"
        )
    if (path := shape.path) is None:
        return link_parts(Link(link, (shape,)))
    imported = path.parent.name == "meshes"
    imported &= (path.parent.parent / "import.yaml").is_file()
    if imported:
        path = triangles_file(path)
    if not path.is_file():
        raise ModelError(
            f"link {link!r}: its mesh {path} is not there; of an imported robot, "
            "import it again"
        )
    # A file that the import wrote is read sooner than others.
    plain = imported and (of.scale3() == 1.0).all()
    if plain and (found := read_obj(path)) is not None:
        # By rows: of another order, functions are compiled anew.
        p_LV = np.ascontiguousarray(shape.X_LG.multiply(found[0].T).T)
        return [Part(p_LV, found[1], GREY)]
    there = replace(shape, geometry=Mesh(str(path), of.scale3()))
    return link_parts(Link(link, (there,)))
