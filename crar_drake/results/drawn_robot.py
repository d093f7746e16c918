"""A robot by itself, drawn into Meshcat once and then posed by a page.

The recorded pages and that of `crar-drake play` pose it; what they need of each pose
is here as well: where watched pairs are nearest, and what the camera has to show.
"""

from collections.abc import Sequence

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
from pydrake.multibody.tree import BodyIndex, RigidBody

from crar_drake.results.marks import OBSTACLE
from crar_drake.robot.collision_pairs import WatchedPairs
from crar_drake.robot.description import RobotDescription, find_body, robot_diagram
from crar_drake.simulation.visuals import draw_collision_shapes, models_without_visuals

# What is welded to the world is in the view if it is not larger than this [m].
_LARGEST_FIXED = 2.0

# What moves by itself is seen through.
_OBSTACLE = Rgba(*(int(OBSTACLE[i : i + 2], 16) / 255.0 for i in (1, 3, 5)), 0.75)

# Of the pairs that are near in a pose, this many nearest ones are shown.
MOST_NEAR = 8

# So many directions are asked which points are the outermost.
_DIRECTIONS = 128

_NO_SPHERES = np.empty((0, 3))


class DrawnRobot:
    """A robot by itself, drawn into Meshcat once and then posed by the page.

    Attributes:
        description: of the robot.
        prefix: the path in Meshcat under which its links are.
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
            prefix: see above.
            colour: of what has none.
            spheres: (N,) radii of obstacles that move, drawn beside it [m].

        Raises:
            ModelError: the robot's model cannot be loaded.
        """
        self.description, self.prefix = description, prefix
        self._diagram, self.plant, scene_graph = robot_diagram(description)
        inspector = scene_graph.model_inspector()
        self.unseen = models_without_visuals(self.plant, inspector)
        draw_collision_shapes(self.plant, scene_graph)
        self.scene_graph = scene_graph
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

    def pose_links(
        self, q: np.ndarray, spheres: np.ndarray = _NO_SPHERES
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where links and spheres are, and what of the links could be outermost.

        Args:
            q: (nq,) positions.
            spheres: (N, 3) their centres [m].

        Returns:
            (B, 7) p_WB [m] and the quaternion (x, y, z, w) of R_WB of what `paths`
            names; (P, 3) corners of the links' boxes in W [m].
        """
        self.plant.SetPositions(self._plant_context, q)
        links, points = np.empty((len(self._moving), 7)), [self._fixed]
        for i, (body, box) in enumerate(self._moving):
            X_WB = self.plant.EvalBodyPoseInWorld(self._plant_context, body)
            w, x, y, z = X_WB.rotation().ToQuaternion().wxyz()
            links[i] = *X_WB.translation(), x, y, z, w
            points.append(X_WB.multiply(box.T).T)
        upright = np.zeros((len(spheres), 7))
        upright[:, :3], upright[:, 6] = spheres, 1.0
        return np.vstack([links, upright]), np.vstack(points)

    def near_pairs(self, distances: np.ndarray, below: float) -> np.ndarray:
        """Where the nearest pairs are nearest, in the pose that was set last.

        Args:
            distances: (P,) signed distances of the watched pairs [m].
            below: farther ones are left out [m].

        Returns:
            (K, 8) of at most `MOST_NEAR` pairs, nearest first: the pair's number, its
            signed distance [m], and a point on the surface of either link, in W [m].
        """
        order = np.argsort(distances, kind="stable")[:MOST_NEAR]
        order = order[distances[order] < below]
        query = self.scene_graph.get_query_output_port().Eval(
            self.scene_graph.GetMyContextFromRoot(self._context)
        )
        rows = np.empty((len(order), 8))
        for row, pair in zip(rows, order, strict=True):
            shapes = np.unique(self._pairs.shape_pairs[pair])
            answers = self._pairs.ask(query, shapes.tolist())
            d, normal, p_a = np.split(answers[np.argmin(answers[:, 0])], [1, 4])
            row[:] = pair, distances[pair], *p_a, *(p_a - d * normal)
        return rows

    def record(
        self,
        q: np.ndarray,
        distances: np.ndarray,
        below: float,
        spheres: np.ndarray | None = None,
    ) -> dict[str, np.ndarray]:
        """What a recording has of F frames.

        Args:
            q: (F, nq) positions.
            distances: (F, P) of the watched pairs, see `near_pairs` [m].
            below: as of `near_pairs`.
            spheres: (F, N, 3) their centres [m]; None if there are none.

        Returns:
            `poses`, `near` and `outline` of `recorded_page.RecordedRun`.
        """
        spheres = np.empty((len(q), 0, 3)) if spheres is None else spheres
        poses, outline = [], [np.empty((0, 3))]
        near = np.full((len(q), min(MOST_NEAR, distances.shape[1]), 8), np.nan)
        for i in range(len(q)):
            at, points = self.pose_links(q[i], spheres[i])
            poses.append(at)
            outline.append(outermost(points))
            rows = self.near_pairs(distances[i], below)
            near[i, : len(rows)] = rows
        outline = outermost(np.vstack(outline))
        return {"poses": np.array(poses), "near": near, "outline": outline}


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
