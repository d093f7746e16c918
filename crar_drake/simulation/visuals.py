"""What is drawn of a robot whose model has nothing to be drawn, and what around it."""

import numpy as np
from pydrake.geometry import (
    HalfSpace,
    IllustrationProperties,
    Meshcat,
    PerceptionProperties,
    Rgba,
    Role,
    SceneGraph,
    SceneGraphInspector,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex

COLLISION_COLOR = Rgba(0.75, 0.78, 0.82, 1.0)


def models_without_visuals(
    plant: MultibodyPlant, inspector: SceneGraphInspector
) -> list[str]:
    """Names of the models that have collision shapes and nothing else to be seen."""
    return [plant.GetModelInstanceName(i) for i in _unseen(plant, inspector)]


def draw_collision_shapes(plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
    """Lets collision shapes be drawn where a model has nothing else.

    Half-spaces are left out, since they have no end. Models with any visual geometry
    stay as they are: a link that has none may be meant to be unseen.

    Args:
        plant: finalized.
        scene_graph: where the plant's geometry is registered; there must be no
            context of it yet.
    """
    inspector = scene_graph.model_inspector()
    illustration, perception = IllustrationProperties(), PerceptionProperties()
    for properties in (illustration, perception):
        properties.AddProperty("phong", "diffuse", COLLISION_COLOR)
    source = plant.get_source_id()
    for instance in _unseen(plant, inspector):
        for geometry in _shapes(plant, inspector, instance, Role.kProximity):
            scene_graph.AssignRole(source, geometry, illustration)
            if inspector.GetPerceptionProperties(geometry) is None:
                scene_graph.AssignRole(source, geometry, perception)


def _unseen(
    plant: MultibodyPlant, inspector: SceneGraphInspector
) -> list[ModelInstanceIndex]:
    return [
        instance
        for instance in map(ModelInstanceIndex, range(plant.num_model_instances()))
        if _shapes(plant, inspector, instance, Role.kProximity)
        and not _shapes(plant, inspector, instance, Role.kIllustration)
    ]


def _shapes(
    plant: MultibodyPlant,
    inspector: SceneGraphInspector,
    instance: ModelInstanceIndex,
    role: Role,
) -> list:
    """The geometries of a model in that role; none of the world itself."""
    world = plant.world_body().index()
    return [
        geometry
        for index in map(BodyIndex, range(plant.num_bodies()))
        if index != world and plant.get_body(index).model_instance() == instance
        for geometry in inspector.GetGeometries(
            plant.GetBodyFrameIdOrThrow(index), role
        )
        if not isinstance(inspector.GetShape(geometry), HalfSpace)
    ]


GRID_COLOR = Rgba(0.52, 0.58, 0.62, 1.0)
GRID = "/crar/grid"

# Three-quarter front view: azimuth about z from the robot's x, and elevation [rad].
VIEW_YAW, VIEW_PITCH = np.deg2rad(-32.0), np.deg2rad(12.0)
_FLOOR, _CELL = 6.0, 0.5  # half the floor's width, and a cell of its grid [m]


def set_surroundings(meshcat: Meshcat) -> None:
    """Background and a grid on the floor (z = 0); no axes."""
    meshcat.SetProperty("/Background/<object>", "top_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.66, 0.72, 0.76])
    meshcat.SetProperty("/Axes", "visible", False)
    # Else the dark side of a dark robot is black.
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 0.9)
    # Meshcat's own grid is made of long lines, and browsers without a graphics card
    # drop a line that passes the camera: so one of short lines, a cell each.
    meshcat.SetProperty("/Grid", "visible", False)
    n = round(2.0 * _FLOOR / _CELL)
    along, across = np.meshgrid(np.arange(n), np.arange(n + 1))
    start = np.vstack([along.ravel(), across.ravel(), np.zeros(along.size)])
    end = start + np.array([[1.0], [0.0], [0.0]])
    corner = np.array([[_FLOOR], [_FLOOR], [0.0]])
    meshcat.SetLineSegments(
        GRID,
        _CELL * np.hstack([start, start[[1, 0, 2]]]) - corner,
        _CELL * np.hstack([end, end[[1, 0, 2]]]) - corner,
        1.0,
        GRID_COLOR,
    )
