"""Pictures of a robot in given poses, some of its segments tinted.

Drake's VTK renderer draws them; it needs no display.
"""

from collections.abc import Collection

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import (
    Box,
    Capsule,
    ClippingRange,
    ColorRenderCamera,
    Cylinder,
    Ellipsoid,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    LightParameter,
    MakeRenderEngineVtk,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    Rgba,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from crar_drake.robot.description import RobotDescription, add_robot, find_body
from crar_drake.simulation.visuals import draw_collision_shapes, look_from

TINT = Rgba(1.0, 0.82, 0.05, 1.0)  # the paper's yellow
_SHELL = 0.004  # by which a tint is larger than the segment's collision shape [m]
_AWAY = RigidTransform([0.0, 0.0, -1e3])  # where tints wait
_OVERSAMPLING = 2  # rendered larger and averaged: smooth edges
_FIELD_OF_VIEW = np.deg2rad(26.0)
# Azimuth of the camera from the robot's x about z, elevation [rad].
_YAW, _PITCH = np.deg2rad(15.0), np.deg2rad(10.0)


class SnapshotRenderer:
    """Renders a robot in one pose after the other.

    Of a model without visual geometry it shows the collision shapes.

    Attributes:
        size: width and height of a picture [pixels].
    """

    def __init__(
        self,
        description: RobotDescription,
        *,
        size: tuple[int, int] = (230, 260),
        height: float = 1.2,
    ) -> None:
        """
        Args:
            description: of the robot; the links of its watched pairs can be tinted.
            size: width and height of a picture [pixels].
            height: that a picture shows, at the robot [m].

        Raises:
            ModelError: the robot's model cannot be loaded.
        """
        self.size = size
        self._distance = 0.5 * height / np.tan(0.5 * _FIELD_OF_VIEW)
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        add_robot(plant, description)
        plant.Finalize()
        draw_collision_shapes(plant, scene_graph)
        scene_graph.AddRenderer("vtk", _make_engine())
        # Each link that may be tinted has shells in a frame of their own, which is
        # either at the link or far away: colours cannot change from pose to pose.
        source = scene_graph.RegisterSource("tints")
        inspector = scene_graph.model_inspector()
        properties = PerceptionProperties()
        properties.AddProperty("phong", "diffuse", TINT)
        self._tints = {}
        for link in sorted({link for pair in description.pairs for link in pair}):
            body = find_body(plant, link)
            frame = scene_graph.RegisterFrame(source, GeometryFrame(f"tint::{link}"))
            self._tints[link] = (body, frame)
            for geometry in plant.GetCollisionGeometriesForBody(body):
                shape = inflated(inspector.GetShape(geometry), _SHELL)
                if shape is None:
                    continue
                shell = GeometryInstance(
                    inspector.GetPoseInFrame(geometry),
                    shape,
                    inspector.GetName(geometry),
                )
                shell.set_perception_properties(properties)
                scene_graph.RegisterGeometry(source, frame, shell)
        self._plant, self._scene_graph = plant, scene_graph
        self._source = source
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        width, pixels = (_OVERSAMPLING * n for n in size)
        self._core = RenderCameraCore(
            "vtk",
            CameraInfo(width=width, height=pixels, fov_y=_FIELD_OF_VIEW),
            ClippingRange(0.05, 100.0),
            RigidTransform(),
        )

    def render(self, q: np.ndarray, tinted: Collection[str] = ()) -> np.ndarray:
        """One picture, its middle where the links that can be tinted are on average.

        Args:
            q: (nq,) positions of the robot.
            tinted: links to tint.

        Returns:
            (height, width, 3) in [0, 1], white where there is no robot.
        """
        plant = self._plant
        plant_context = plant.GetMyMutableContextFromRoot(self._context)
        plant.SetPositions(plant_context, q)
        poses, origins = FramePoseVector(), []
        for link, (body, frame) in self._tints.items():
            X_WB = plant.EvalBodyPoseInWorld(plant_context, body)
            poses.set_value(frame, X_WB if link in tinted else _AWAY)
            origins.append(X_WB.translation())
        scene_graph_context = self._scene_graph.GetMyMutableContextFromRoot(
            self._context
        )
        self._scene_graph.get_source_pose_port(self._source).FixValue(
            scene_graph_context, AbstractValue.Make(poses)
        )
        query = self._scene_graph.get_query_output_port().Eval(scene_graph_context)
        image = query.RenderColorImage(
            ColorRenderCamera(self._core),
            self._scene_graph.world_frame_id(),
            look_from(_YAW, _PITCH, self._distance, np.mean(origins, axis=0)),
        )
        width, height = self.size
        blocks = (image.data[:, :, :3] / 255.0).reshape(
            height, _OVERSAMPLING, width, _OVERSAMPLING, 3
        )
        return blocks.mean(axis=(1, 3))


def _make_engine():
    """White around the robot, light from both sides, from above and from the eye."""
    lights = [
        LightParameter(
            type="directional",
            frame="world",
            direction=-look_from(
                _YAW + turn, elevation, 1.0, np.zeros(3)
            ).translation(),
            intensity=intensity,
        )
        for turn, elevation, intensity in (
            (0.7, 0.95, 0.55),
            (-0.8, 0.7, 0.35),
            (0.0, 1.5, 0.3),
            (0.0, _PITCH, 0.45),
        )
    ]
    return MakeRenderEngineVtk(
        RenderEngineVtkParams(default_clear_color=np.ones(3), lights=lights)
    )


def inflated(shape: Shape, by: float) -> Shape | None:
    """The shape with its surface moved outwards by `by` [m]; None for shapes that
    have no simple one."""
    if isinstance(shape, Sphere):
        return Sphere(shape.radius() + by)
    if isinstance(shape, Capsule):
        return Capsule(shape.radius() + by, shape.length())
    if isinstance(shape, Cylinder):
        return Cylinder(shape.radius() + by, shape.length() + 2.0 * by)
    if isinstance(shape, Box):
        return Box(shape.size() + 2.0 * by)
    if isinstance(shape, Ellipsoid):
        return Ellipsoid(shape.a() + by, shape.b() + by, shape.c() + by)
    return None
