"""What the recorded page shows of a run, frame by frame.

`record_run` computes it from a log, without simulating again: where the links are,
the targets and the points that should be there, and where watched pairs are nearest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pydrake.geometry import (
    GeometryId,
    HalfSpace,
    Meshcat,
    Rgba,
    Role,
    SceneGraphInspector,
    Sphere,
)
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import DiagramBuilder

from crar_drake.errors import CrarError
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import check_logged_robot
from crar_drake.results.marks import NEARNESS_STEPS, OBSTACLE, marked_spans
from crar_drake.results.summary import task_layout
from crar_drake.robot.collision_pairs import WatchedPairs
from crar_drake.robot.description import RobotDescription, add_robot, find_body
from crar_drake.simulation.scenario import Scenario
from crar_drake.simulation.visuals import draw_collision_shapes, models_without_visuals

# Of the pairs that are near in a frame, this many nearest ones are kept.
MOST_NEAR = 8

# The curves of the time line have at most this many points.
_CURVE_POINTS = 1500

# What is welded to the world is in the view if it is not larger than this [m].
_LARGEST_FIXED = 2.0

# What moves by itself is seen through.
_OBSTACLE = Rgba(*(int(OBSTACLE[i : i + 2], 16) / 255.0 for i in (1, 3, 5)), 0.75)
# The view has them where they are so near to the robot [m].
_NEAR = 0.2

# So many directions are asked which points are the outermost.
_DIRECTIONS = 128


@dataclass(frozen=True)
class RecordedRun:
    """A run at F frames."""

    # at which links count as near each other, of its scenario; 0 if only those inside
    # each other do [m]
    warning_distance: float
    rate: float  # of the frames [Hz]
    time: np.ndarray  # (F,) from the first sample on [s]
    # (F, B, 7) of the links that are drawn and move, and then of the obstacles that do:
    # p_WB [m] and the quaternion (x, y, z, w) of R_WB
    poses: np.ndarray
    targets: np.ndarray  # (F, N, 3) p_WT, NaN where there is none [m]
    reached: np.ndarray  # (F, N, 3) where the points are that should be there [m]
    # (F, K, 8) of the nearest pairs, nearest first: the pair's number, its signed
    # distance [m], and a point on either surface [m]; NaN where fewer are near
    near: np.ndarray
    curve_time: np.ndarray  # (C,) of the curves [s]
    # (C,) the smallest of all signed distances around that time [m]; empty without
    # watched pairs
    distance_curve: np.ndarray
    # (C,) the largest of all target errors around it [m or rad], NaN without targets;
    # empty without tasks
    error_curve: np.ndarray
    error_unit: str  # "m", "rad" if only orientations are tracked, "" without tasks
    # see `marks.marked_spans`, from the first sample on
    spans: dict[str, list[tuple[float, float]]]
    pair_names: list[str]
    target_names: list[str]
    outline: np.ndarray  # (P, 3) outermost points of all frames [m]
    # link, as its number among those that are drawn and move, to the first and last of
    # frames in a row in which it is inside another
    penetrating: dict[int, list[tuple[int, int]]] = field(default_factory=dict)


class DrawnRobot:
    """A robot by itself, drawn into Meshcat once and then posed by the page.

    Attributes:
        description: of the robot.
        plant: with the robot in it and nothing else.
        scene_graph: where it is registered.
        unseen: the models whose collision shapes are drawn, for want of anything else.
        paths: (B,) in Meshcat of the links that are drawn and move, and of the spheres.
        bodies: of the plant that these links are.
        spheres: (N,) radii of the obstacles that are drawn beside it [m].
    """

    def __init__(
        self,
        description: RobotDescription,
        meshcat: Meshcat,
        prefix: str,
        colour: Rgba,
        spheres: Sequence[float] = (),
    ) -> None:
        """
        Args:
            meshcat: to draw into.
            prefix: the path in Meshcat under which its links are.
            colour: of what has none.
            spheres: (N,) radii of obstacles that move [m].

        Raises:
            ModelError: the robot's model cannot be loaded.
        """
        self.description = description
        builder = DiagramBuilder()
        self.plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        add_robot(self.plant, description)
        self.plant.Finalize()
        inspector = scene_graph.model_inspector()
        self.unseen = models_without_visuals(self.plant, inspector)
        draw_collision_shapes(self.plant, scene_graph)
        self.scene_graph = scene_graph
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        self._plant_context = self.plant.GetMyMutableContextFromRoot(self._context)
        self._pairs = WatchedPairs(
            self.plant,
            inspector,
            [
                (find_body(self.plant, a), find_body(self.plant, b))
                for a, b in description.pairs
            ],
        )
        self.paths: list[str] = []
        self._moving: list[tuple[RigidBody, np.ndarray]] = []
        fixed = [np.empty((0, 3))]
        anchored = self.plant.GetBodiesWeldedTo(self.plant.world_body())
        for body in map(
            self.plant.get_body, map(BodyIndex, range(self.plant.num_bodies()))
        ):
            frame = self.plant.GetBodyFrameIdOrThrow(body.index())
            shown = inspector.GetGeometries(frame, Role.kIllustration)
            name = inspector.GetName(frame).replace("::", "/")
            X_WB = self.plant.EvalBodyPoseInWorld(self._plant_context, body)
            _draw(meshcat, f"{prefix}/{name}", inspector, shown, colour)
            meshcat.SetTransform(f"{prefix}/{name}", X_WB)
            if body in anchored:
                corners = _corners(inspector, shown, _LARGEST_FIXED)
                fixed.append(X_WB.multiply(corners.T).T)
            elif shown:
                self._moving.append((body, _corners(inspector, shown, np.inf)))
                self.paths.append(f"{prefix}/{name}")
        self.bodies = [body.index() for body, _ in self._moving]
        self._fixed = np.vstack(fixed)
        self.spheres = tuple(spheres)
        for i, radius in enumerate(self.spheres):
            path = f"{prefix}/obstacle {i}"
            meshcat.SetObject(path, Sphere(radius), _OBSTACLE)
            self.paths.append(path)

    def pose_links(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the links are, and what of them could be outermost.

        Args:
            q: (nq,) positions.

        Returns:
            (B, 7) poses of the links as in `RecordedRun`; (P, 3) corners of their boxes
            in W [m].
        """
        self.plant.SetPositions(self._plant_context, q)
        poses, points = np.empty((len(self._moving), 7)), [self._fixed]
        for i, (body, box) in enumerate(self._moving):
            X_WB = self.plant.EvalBodyPoseInWorld(self._plant_context, body)
            w, x, y, z = X_WB.rotation().ToQuaternion().wxyz()
            poses[i] = *X_WB.translation(), x, y, z, w
            points.append(X_WB.multiply(box.T).T)
        return poses, np.vstack(points)

    def nearest_points(self, pairs: np.ndarray) -> np.ndarray:
        """Where watched pairs are nearest, in the pose that was set last.

        Args:
            pairs: (K,) their numbers.

        Returns:
            (K, 6) a point on the surface of either link, in W [m].
        """
        query = self.scene_graph.get_query_output_port().Eval(
            self.scene_graph.GetMyContextFromRoot(self._context)
        )
        points = np.empty((len(pairs), 6))
        for i, answers in enumerate(self._pairs.ask_pairs(query, pairs)):
            d, normal, p_a = np.split(answers[np.argmin(answers[:, 0])], [1, 4])
            points[i] = *p_a, *(p_a - d * normal)
        return points


def _draw(
    meshcat: Meshcat,
    path: str,
    inspector: SceneGraphInspector,
    shown: Sequence[GeometryId],
    colour: Rgba,
) -> None:
    """A link's shapes.

    Drake's MeshcatVisualizer would do it, too, but as part of a diagram. Diagrams are
    cycles, which are collected by whatever thread comes by; and a Meshcat that another
    thread destroys than made it aborts the process.
    """
    for geometry in shown:
        properties = inspector.GetIllustrationProperties(geometry)
        rgba = properties.GetPropertyOrDefault("phong", "diffuse", colour)
        of_shape = f"{path}/{geometry.get_value()}"
        meshcat.SetObject(of_shape, inspector.GetShape(geometry), rgba)
        meshcat.SetTransform(of_shape, inspector.GetPoseInFrame(geometry))


def record_run(
    log: SimulationLog, robot: DrawnRobot, scenario: Scenario, frames_per_second: float
) -> RecordedRun:
    """Computes the frames of a run.

    Args:
        log: of the run; interpolated to the frames.

    Raises:
        CrarError: the log is empty, does not fit the robot, or has no finite
            positions; or `frames_per_second` is not positive.
    """
    if not len(log.time):
        raise CrarError("the log is empty: there is nothing to play back")
    if not 0.0 < frames_per_second < np.inf:
        raise CrarError(f"frames_per_second: {frames_per_second} must be positive")
    check_logged_robot(log, robot.plant, robot.description)
    known = np.isfinite(log.q).all(axis=1)
    if not known.any():
        raise CrarError("the log has no finite positions: there is nothing to draw")
    layout = task_layout(log)
    time = log.time - log.time[0]
    frames = np.arange(np.floor(time[-1] * frames_per_second + 1e-6) + 1.0)
    frames /= frames_per_second
    # Where a simulation went to infinity, the last pose that can be drawn stays.
    q = _resample(frames, time[known], log.q[known])
    wanted = log.desired_tasks[:, layout.position_entries.ravel()]
    error = log.task_error[:, layout.linear_rows.ravel()]
    targets = _resample(frames, time, wanted).reshape(len(frames), -1, 3)
    reached = targets - _resample(frames, time, error).reshape(len(frames), -1, 3)
    targets[np.isnan(reached)] = np.nan
    distances = _resample(frames, time, log.signed_distances)
    distances[:, ~log.between_links] = np.inf

    spheres = _resample(frames, time, log.obstacles).reshape(len(frames), -1, 4)
    poses, outline = [], [np.empty((0, 3))]
    most = min(MOST_NEAR, distances.shape[1])
    near = np.full((len(frames), most, 8), np.nan)
    shown_below = NEARNESS_STEPS[0] * scenario.warning_distance
    for i in range(len(frames)):
        at, points = robot.pose_links(q[i])
        poses.append(np.vstack([at, poses_of(spheres[i, :, :3])]))
        outline.append(outermost(points))
        order = np.argsort(distances[i], kind="stable")[:most]
        order = order[distances[i, order] < shown_below]
        near[i, : len(order), 0] = order
        near[i, : len(order), 1] = distances[i, order]
        near[i, : len(order), 2:] = robot.nearest_points(order)
    seen = np.vstack([*outline, *targets])
    seen = seen[np.isfinite(seen).all(axis=1)]
    seen = np.vstack([seen, _near_spheres(seen, spheres.reshape(-1, 4))])

    curve_time, (distance_curve, error_curve), unit = _curves(log)
    return RecordedRun(
        warning_distance=scenario.warning_distance,
        rate=frames_per_second,
        time=frames,
        poses=np.array(poses),
        targets=targets,
        reached=reached,
        near=near,
        curve_time=curve_time,
        distance_curve=distance_curve,
        error_curve=error_curve,
        error_unit=unit,
        spans={
            name: [(a - log.time[0], b - log.time[0]) for a, b in spans]
            for name, spans in marked_spans(log).items()
        },
        pair_names=log.pair_names.tolist(),
        target_names=[layout.names[i] for i in layout.linear_tasks],
        outline=outermost(seen),
    )


def poses_of(centres: np.ndarray) -> np.ndarray:
    """(N, 7) poses of spheres at (N, 3), as in `RecordedRun`."""
    upright = np.zeros((len(centres), 7))
    upright[:, :3], upright[:, 6] = centres, 1.0
    return upright


def _near_spheres(points: np.ndarray, spheres: np.ndarray) -> np.ndarray:
    """(P, 3) the corners of the boxes about those of (N, 4) spheres, centre and radius,
    that are near the box about (P, 3) points [m]."""
    if not len(points) or not len(spheres):
        return np.empty((0, 3))
    centres, radii = spheres[:, :3], spheres[:, 3:]
    low, high = points.min(axis=0) - _NEAR, points.max(axis=0) + _NEAR
    near = ((centres + radii > low) & (centres - radii < high)).all(axis=1)
    corners = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    boxes = centres[near, None] + radii[near, None] * corners
    return boxes.reshape(-1, 3)


def _corners(
    inspector: SceneGraphInspector, geometries: Sequence[GeometryId], largest: float
) -> np.ndarray:
    """(8 G, 3) corners of the boxes around a frame's geometries, in that frame [m];
    those that are larger are left out."""
    signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1)
    corners = [np.empty((0, 3))]
    for geometry in geometries:
        if isinstance(inspector.GetShape(geometry), HalfSpace):
            continue
        box = inspector.GetObbInGeometryFrame(geometry)
        half = box.half_width()
        if np.max(half) <= 0.5 * largest:
            X_FB = inspector.GetPoseInFrame(geometry).multiply(box.pose())
            corners.append(X_FB.multiply(half[:, np.newaxis] * signs).T)
    return np.vstack(corners)


def outermost(points: np.ndarray) -> np.ndarray:
    """Those of (P, 3) points that are the farthest in some direction."""
    if len(points) <= 8:
        return points
    # Directions as evenly spread as the seeds of a sunflower.
    i = np.arange(_DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * i / _DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * i
    r = np.sqrt(1.0 - z * z)
    directions = np.array([r * np.cos(turn), r * np.sin(turn), z])
    return points[np.unique(np.argmax(points @ directions, axis=0))]


def _resample(frames: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolates the columns of `values` (T, k), sampled at `time` (T,)."""
    columns = [np.interp(frames, time, column) for column in values.T]
    return np.column_stack(columns) if columns else np.empty((len(frames), 0))


def _curves(
    log: SimulationLog,
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray], str]:
    """The time line's curves: their times, values, and the error's unit.

    Of each piece of time the smallest distance and the largest error are kept, so
    that no peak is lost.
    """
    layout = task_layout(log)
    rows, unit = layout.linear_rows, "m"
    if not rows.size:
        rows, unit = layout.angular_rows, "rad"
    error = distance = np.empty((len(log.time), 0))
    if rows.size:
        error = np.linalg.norm(log.task_error[:, rows], axis=2).max(axis=1)
    if log.signed_distances.size:
        distance = log.signed_distances[:, log.between_links].min(axis=1)
    pieces = min(_CURVE_POINTS, len(log.time))
    starts = np.arange(pieces) * len(log.time) // pieces
    return (
        log.time[starts] - log.time[0],
        (
            np.minimum.reduceat(distance, starts) if distance.size else np.empty(0),
            np.fmax.reduceat(error, starts) if error.size else np.empty(0),
        ),
        unit if rows.size else "",
    )
