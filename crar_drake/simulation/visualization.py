"""What is drawn of a diagram while it runs: the robot, its targets and its warnings.

`AddVisualization` draws them into Meshcat. The page of a run that is over is made of
its log, see `results.playback`.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Meshcat,
    Rgba,
    Role,
    SceneGraph,
    SceneGraphInspector,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    EventStatus,
    InputPort,
    LeafSystem,
)
from pydrake.systems.lcm import ApplyLcmBusConfig
from pydrake.visualization import ApplyVisualizationConfig, VisualizationConfig

from crar_drake.errors import CrarError
from crar_drake.robot.description import find_body
from crar_drake.simulation.visuals import draw_collision_shapes

TARGET_COLOR = Rgba(0.55, 0.27, 1.0, 1.0)  # violet: neither robot nor warning
WARNING_COLOR = Rgba(1.0, 0.24, 0.05, 0.6)
GRID_COLOR = Rgba(0.52, 0.58, 0.62, 1.0)
TARGET_RADIUS = 0.018  # [m]
SHELL_THICKNESS = 0.006  # by which a warning shell is larger than the segment [m]

# Where ApplyVisualizationConfig draws the links, and what it calls the visualiser.
_ILLUSTRATION = "/drake/illustration"
_VISUALIZER = "meshcat_visualizer(illustration)"
_TARGETS = "/crar/targets"
GRID = "/crar/grid"
_SHELL = "near"  # under the path of a link, so that it moves along

# Three-quarter front view: azimuth about z from the robot's x, and elevation [rad].
VIEW_YAW, VIEW_PITCH = np.deg2rad(-32.0), np.deg2rad(12.0)
_CAMERA = "/Cameras/default/rotated/<object>"
_ZOOM = 2.0
# Meshcat's camera opens 75 degrees vertically; zooming narrows that.
_TAN_HALF_VIEW = np.tan(np.deg2rad(37.5)) / _ZOOM
_ASPECT = 1.3  # width over height that the scene is fitted into; windows are wider
_FLOOR, _CELL = 6.0, 0.5  # half the floor's width, and a cell of its grid [m]
# Links are known by their origins: this much of them may lie beyond [m].
_FRAME_MARGIN = 0.15


@dataclass(frozen=True)
class _Segment:
    """A watched link that can be seen.

    Attributes:
        path: of its warning shells in Meshcat.
        shells: pose X_BG in the link's frame, and shape, of each shell.
        pairs: (Nc,) whether it belongs to each watched pair.
    """

    path: str
    shells: list[tuple[RigidTransform, Shape]]
    pairs: np.ndarray


class PlaybackOverlay(LeafSystem):
    """Draws targets and warnings into Meshcat, beside Drake's MeshcatVisualizer.

    Each target is a small sphere. The segments of a watched pair that is nearer
    than the warning distance wear a shell: their collision shapes, slightly larger.
    (In a recording, visibility can change with time; colour cannot.) The camera
    is placed so that everything that moved so far is in the picture.

    Input ports:
        target_positions: (3 N,) p_WT of each target [m]; open if there are none.
        signed_distances: (Nc,) of the watched pairs, in their order [m].
        body_poses: the plant's; `AddPlaybackOverlay` connects it.

    It publishes periodically, when initialised and when forced. As with
    MeshcatVisualizer, what was drawn is kept with the system and not in its
    context: two simulators should not run one diagram at a time with it.
    """

    def __init__(
        self,
        meshcat: Meshcat,
        plant: MultibodyPlant,
        inspector: SceneGraphInspector,
        pairs: Sequence[tuple[str, str]],
        target_names: Sequence[str],
        publish_period: float,
        warning_distance: float,
    ) -> None:
        """See `AddPlaybackOverlay`."""
        super().__init__()
        self.set_name("playback_overlay")
        self._meshcat = meshcat
        self._target_paths = [
            f"{_TARGETS}/{name.replace('::', '/')}" for name in target_names
        ]
        self._warning_distance = warning_distance
        self._segments = _segments(plant, inspector, pairs)
        self._links = [
            index
            for index in map(BodyIndex, range(1, plant.num_bodies()))
            if _is_drawn(inspector, plant.GetBodyFrameIdOrThrow(index))
        ]
        self._forget()
        self.DeclareVectorInputPort("target_positions", 3 * len(target_names))
        self.DeclareVectorInputPort("signed_distances", len(pairs))
        self.DeclareAbstractInputPort(
            "body_poses", AbstractValue.Make([RigidTransform()])
        )
        self.DeclareInitializationPublishEvent(self._Initialize)
        self.DeclarePeriodicPublishEvent(publish_period, 0.0, self._Publish)
        self.DeclareForcedPublishEvent(self._Publish)

    def get_input_port_target_positions(self) -> InputPort:
        """(3 N,) p_WT of each target [m]."""
        return self.GetInputPort("target_positions")

    def get_input_port_signed_distances(self) -> InputPort:
        """(Nc,) signed distances of the watched pairs [m]."""
        return self.GetInputPort("signed_distances")

    def _forget(self) -> None:
        """A new run draws its objects again: the visualiser deletes its links."""
        self._shown: np.ndarray | None = None  # (number of segments,), visibility
        # Box of all that was drawn, and the one that the camera was placed for [m].
        self._box = np.array([np.full(3, np.inf), np.full(3, -np.inf)])
        self._framed = self._box.copy()

    def _Initialize(self, context: Context) -> EventStatus:
        self._forget()
        return EventStatus.Succeeded()

    def _Publish(self, context: Context) -> EventStatus:
        time = context.get_time()
        p_WT = np.empty((0, 3))
        if self._target_paths:  # else there is nothing to connect the port to
            p_WT = self.get_input_port_target_positions().Eval(context).reshape(-1, 3)
        distances = self.get_input_port_signed_distances().Eval(context)
        if self._shown is None:
            self._draw_objects()
        for path, p in zip(self._target_paths, p_WT, strict=True):
            self._meshcat.SetTransform(path, RigidTransform(p), time)
        self._show_near(distances < self._warning_distance, time)

        X_WB = self.GetInputPort("body_poses").Eval(context)
        origins = [X_WB[int(index)].translation() for index in self._links]
        self._keep_in_view(np.vstack([p_WT, *origins]))
        return EventStatus.Succeeded()

    def _draw_objects(self) -> None:
        meshcat = self._meshcat
        meshcat.Delete(_TARGETS)
        for path in self._target_paths:
            meshcat.SetObject(path, Sphere(TARGET_RADIUS), TARGET_COLOR)
        for segment in self._segments:
            for i, (X_BG, shape) in enumerate(segment.shells):
                path = f"{segment.path}/{i}"
                meshcat.SetObject(path, shape, WARNING_COLOR)
                meshcat.SetTransform(path, X_BG)
            meshcat.SetProperty(segment.path, "visible", False)
        set_surroundings(meshcat)

    def _show_near(self, near: np.ndarray, time: float) -> None:
        """Writes the visibility of those shells that change; near: (Nc,)."""
        show = np.array([near[s.pairs].any() for s in self._segments], dtype=bool)
        for i, segment in enumerate(self._segments):
            if self._shown is None or show[i] != self._shown[i]:
                self._meshcat.SetProperty(segment.path, "visible", bool(show[i]), time)
        self._shown = show

    def _keep_in_view(self, points: np.ndarray) -> None:
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            return
        lower, upper = points.min(axis=0), points.max(axis=0)
        self._box = np.array(
            [np.minimum(self._box[0], lower), np.maximum(self._box[1], upper)]
        )
        if (self._box[0] < self._framed[0]).any() or (
            self._box[1] > self._framed[1]
        ).any():
            set_camera(self._meshcat, *self._box)
            # The camera waits until something leaves the margin that it has.
            self._framed = self._box + 0.5 * _FRAME_MARGIN * np.array([[-1], [1]])


def AddPlaybackOverlay(
    builder: DiagramBuilder,
    meshcat: Meshcat,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    pairs: Sequence[tuple[str, str]],
    target_names: Sequence[str],
    publish_period: float,
    warning_distance: float = 0.02,
) -> PlaybackOverlay:
    """Adds "playback_overlay"; call it after ApplyVisualizationConfig.

    What remains to be connected are `target_positions` and `signed_distances`.

    Args:
        builder: of the diagram that owns the plant.
        meshcat: where the MeshcatVisualizer of the diagram draws.
        plant: finalized.
        scene_graph: where the plant's geometry is registered.
        pairs: the watched segment pairs, two links each.
        target_names: of the targets, in the order of `target_positions`.
        publish_period: that of the visualiser [s]; a binary fraction keeps recorded
            frames evenly spaced.
        warning_distance: segments nearer than this wear a shell [m].

    Raises:
        CrarError: the diagram has no visualiser of illustration geometry yet.
        ModelError: the plant has no such link.
    """
    # The visualiser deletes its links when a run starts, and systems publish in the
    # order in which they were added: shells that come first would be lost.
    if not builder.HasSubsystemNamed(_VISUALIZER):
        raise CrarError(
            "the robot is not drawn: set visualization.publish_illustration, and call "
            "ApplyVisualizationConfig with the Meshcat before AddPlaybackOverlay"
        )
    overlay = builder.AddSystem(
        PlaybackOverlay(
            meshcat,
            plant,
            scene_graph.model_inspector(),
            pairs,
            target_names,
            publish_period,
            warning_distance,
        )
    )
    builder.Connect(
        plant.get_body_poses_output_port(), overlay.GetInputPort("body_poses")
    )
    return overlay


def AddVisualization(
    builder: DiagramBuilder,
    config: VisualizationConfig,
    meshcat: Meshcat,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    pairs: Sequence[tuple[str, str]],
    target_names: Sequence[str],
    warning_distance: float = 0.02,
) -> PlaybackOverlay:
    """Adds Drake's visualiser and the overlay; nothing goes to a network.

    Of a model without visual geometry it draws the collision shapes.

    Args:
        config: Drake's own.
        builder, meshcat, plant, scene_graph, pairs, target_names, warning_distance:
            as `AddPlaybackOverlay`.

    Raises:
        CrarError, ModelError: as `AddPlaybackOverlay`.
    """
    draw_collision_shapes(plant, scene_graph)
    ApplyVisualizationConfig(
        config,
        builder,
        # A bus that goes nowhere. (A DrakeLcm of our own would have to outlive the
        # diagram, which does not keep it.)
        lcm_buses=ApplyLcmBusConfig({config.lcm_bus: None}, builder),
        plant=plant,
        scene_graph=scene_graph,
        meshcat=meshcat,
    )
    return AddPlaybackOverlay(
        builder,
        meshcat,
        plant,
        scene_graph,
        pairs,
        target_names,
        config.publish_period,
        warning_distance,
    )


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


def set_camera(meshcat: Meshcat, lower: np.ndarray, upper: np.ndarray) -> None:
    """Looks at a box from three-quarter front, so that all of it is seen.

    Args:
        meshcat: whose camera to place.
        lower, upper: (3,) corners of the box in W [m]; links whose origins are in
            it may be larger by the margin that is added.
    """
    center = 0.5 * (np.asarray(lower) + upper)
    half = 0.5 * (np.asarray(upper) - lower) + _FRAME_MARGIN
    cos_yaw, sin_yaw = np.cos(VIEW_YAW), np.sin(VIEW_YAW)
    cos_pitch, sin_pitch = np.cos(VIEW_PITCH), np.sin(VIEW_PITCH)
    towards = np.array([cos_pitch * cos_yaw, cos_pitch * sin_yaw, sin_pitch])
    across = np.array([-sin_yaw, cos_yaw, 0.0])
    upward = np.cross(towards, across)
    corners = half * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    # A point is in the picture if its height over its depth is below the tangent.
    height = np.maximum(np.abs(corners @ upward), np.abs(corners @ across) / _ASPECT)
    distance = np.max(height / _TAN_HALF_VIEW + corners @ towards)
    meshcat.SetCameraPose(center + distance * towards, center)
    meshcat.SetProperty(_CAMERA, "zoom", _ZOOM)


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


def _segments(
    plant: MultibodyPlant,
    inspector: SceneGraphInspector,
    pairs: Sequence[tuple[str, str]],
) -> list[_Segment]:
    """The watched links that are drawn; the visualiser moves no others."""
    bodies = [(find_body(plant, a), find_body(plant, b)) for a, b in pairs]
    segments = []
    for body in {int(b.index()): b for pair in bodies for b in pair}.values():
        frame = plant.GetBodyFrameIdOrThrow(body.index())
        shells = _shells(plant, inspector, body)
        if not shells or not _is_drawn(inspector, frame):
            continue
        path = _ILLUSTRATION
        if frame != inspector.world_frame_id():
            path += "/" + inspector.GetName(frame).replace("::", "/")
        member = [body.index() in (a.index(), b.index()) for a, b in bodies]
        segments.append(_Segment(f"{path}/{_SHELL}", shells, np.array(member)))
    return segments


def _shells(
    plant: MultibodyPlant, inspector: SceneGraphInspector, body: RigidBody
) -> list[tuple[RigidTransform, Shape]]:
    shells = []
    for geometry in plant.GetCollisionGeometriesForBody(body):
        shape = inflated(inspector.GetShape(geometry), SHELL_THICKNESS)
        if shape is not None:
            shells.append((inspector.GetPoseInFrame(geometry), shape))
    return shells


def _is_drawn(inspector: SceneGraphInspector, frame) -> bool:
    return inspector.NumGeometriesForFrameWithRole(frame, Role.kIllustration) > 0
