"""A motion against the ground z = 0: how low the robot gets, and how its feet slip.

A foot is *planted* while it is low and still. It becomes so when its lowest point is
within `HEIGHT_ON` of the floor and slower than `SPEED_ON`, and stays so until it is
higher than `HEIGHT_OFF` or faster than `SPEED_OFF`: without two thresholds, a foot at
rest would be lifted and set down again by noise. The floor is where the feet are when
they are lowest, since motions may float or sink as a whole, which is told apart.

The *slip* of a planted foot from one frame to the next is the smallest horizontal way
of its points near the floor: a foot that rolls over its toes, or turns on its ball, has
one that stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Capsule, Role, Sphere
from pydrake.multibody.tree import BodyIndex, RigidBody
from scipy.spatial import ConvexHull, QhullError

from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.results.link_meshes import has_meshes, read_link_meshes
from crar_drake.robot.description import find_frame

HEIGHT_ON, HEIGHT_OFF = 0.015, 0.03  # [m]
SPEED_ON, SPEED_OFF = 0.2, 0.5  # [m/s]

# Points of a foot within this of its lowest one are those that it may stand on [m].
_SOLE = 0.01

# The feet's lowest heights of this share of the frames are the floor's.
_FLOOR_SHARE = 0.1

# A contact that is shorter is none [s].
_SHORTEST = 0.1


@dataclass(frozen=True, eq=False)
class FootSlip:
    """What a foot does on the floor.

    Attributes:
        foot: name of the motion's point, such as left_foot.
        planted: (T,) whether it is.
        num_contacts: stretches in which it is planted.
        total: way that it slips while planted, in all of them [m].
        worst: the longest of one contact [m].
        worst_start, worst_end: first and last frame of that contact; None without any.
        top_speed: of slipping, from one frame to the next [m/s].
    """

    foot: str
    planted: np.ndarray
    num_contacts: int
    total: float
    worst: float
    worst_start: int | None
    worst_end: int | None
    top_speed: float


@dataclass(frozen=True, eq=False)
class GroundContact:
    """A motion against the ground.

    Attributes:
        lowest: (T,) height of the robot's lowest point [m].
        lowest_links: (T) the link it is on.
        floor: height of the feet when they are lowest [m]; 0 without feet.
        feet: an entry a foot; empty where the robot has no frames of that name.
    """

    lowest: np.ndarray
    lowest_links: tuple[str, ...]
    floor: float
    feet: tuple[FootSlip, ...]


class Outline:
    """The robot's links as balls: vertices of hulls, or the ends of capsules."""

    def __init__(self, robot: WholeBody) -> None:
        """
        Args:
            robot: whose links have meshes, or else capsules and spheres.
        """
        self._robot = robot
        plant, graph = robot.plant, robot.scene_graph
        self._points: dict[str, np.ndarray] = {}  # (V, 3) p_BV [m]
        self._radii: dict[str, np.ndarray] = {}  # (V,) [m]
        if has_meshes(plant, graph):
            for link in read_link_meshes(plant, graph):
                vertices = np.concatenate([part.vertices for part in link.parts])
                self._points[link.name] = _hull(vertices)
                self._radii[link.name] = np.zeros(len(self._points[link.name]))
        else:
            self._take_capsules()
        self._points.pop("world", None)
        self.feet = {
            point: _outward(robot, frame)
            for point, frame in robot.description.task_frames.items()
            if point in ("left_foot", "right_foot")
        }

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links that have a shape."""
        return tuple(self._points)

    def ground_contact(self, motion: RobotMotion) -> GroundContact:
        """A motion against the ground.

        Args:
            motion: with its joints in the order of the robot.
        """
        links = self.links
        if not links:
            zeros = np.zeros(motion.num_frames)
            return GroundContact(zeros, ("",) * motion.num_frames, 0.0, ())
        p_RB, R_RB = self._robot.poses_in_root(motion.joint_positions, links)
        R_WR = motion.root_rotations.as_matrix()
        p_WB = motion.root_positions[:, None] + np.einsum("tij,tlj->tli", R_WR, p_RB)
        R_WB = np.einsum("tij,tljk->tlik", R_WR, R_RB)
        low = np.empty((motion.num_frames, len(links)))
        for i, link in enumerate(links):
            z = p_WB[:, i, 2:] + R_WB[:, i, 2] @ self._points[link].T
            low[:, i] = (z - self._radii[link]).min(axis=1)
        soles = {
            foot: self._sole([links.index(b) for b in of if b in links], p_WB, R_WB)
            for foot, of in self.feet.items()
        }
        soles = {foot: sole for foot, sole in soles.items() if sole.shape[1]}
        floor = 0.0
        if soles:
            heights = np.min([p[..., 2].min(axis=1) for p in soles.values()], axis=0)
            floor = float(np.quantile(heights, _FLOOR_SHARE))
        return GroundContact(
            lowest=low.min(axis=1),
            lowest_links=tuple(links[i] for i in low.argmin(axis=1)),
            floor=floor,
            feet=tuple(
                foot_slip(foot, p_WS, floor, motion.rate)
                for foot, p_WS in soles.items()
            ),
        )

    def _sole(self, rows: list[int], p_WB: np.ndarray, R_WB: np.ndarray) -> np.ndarray:
        """(T, V, 3) lowest points of the balls of some links, in the world."""
        points = [np.empty((len(p_WB), 0, 3))]
        for i in rows:
            link = self.links[i]
            p = p_WB[:, i, None] + np.einsum(
                "tij,vj->tvi", R_WB[:, i], self._points[link]
            )
            p[..., 2] -= self._radii[link]
            points.append(p)
        return np.concatenate(points, axis=1)

    def _take_capsules(self) -> None:
        plant = self._robot.plant
        inspector = self._robot.scene_graph.model_inspector()
        for index in range(plant.num_bodies()):
            body = plant.get_body(BodyIndex(index))
            points, radii = [], []
            frame = plant.GetBodyFrameIdOrThrow(body.index())
            for geometry in inspector.GetGeometries(frame, Role.kProximity):
                shape = inspector.GetShape(geometry)
                if not isinstance(shape, Sphere | Capsule):
                    continue
                half = shape.length() / 2.0 if isinstance(shape, Capsule) else 0.0
                X_BG = inspector.GetPoseInFrame(geometry)
                points += [X_BG.multiply(np.array([0, 0, s * half])) for s in (-1, 1)]
                radii += [shape.radius()] * 2
            if points:
                self._points[body.name()] = np.array(points)
                self._radii[body.name()] = np.array(radii)


def foot_slip(foot: str, p_WS: np.ndarray, floor: float, rate: float) -> FootSlip:
    """When a foot is planted, and how far it slips then.

    Args:
        foot: its name.
        p_WS: (T, V, 3) points of its surface in the world [m].
        floor: height of the floor [m].
        rate: frames per second [Hz].
    """
    z = p_WS[..., 2]
    height = z.min(axis=1) - floor  # (T,)
    # Points that are low in both frames of a step are what it could stand on.
    low = z <= z.min(axis=1)[:, None] + _SOLE
    both = low[1:] & low[:-1]
    ways = np.linalg.norm(np.diff(p_WS[..., :2], axis=0), axis=2)
    slips = np.where(both, ways, np.inf).min(axis=1, initial=np.inf)  # (T - 1,)
    # A foot that stands on other points than before has rolled from one to the other;
    # the point that moves least tells.
    slips = np.where(both.any(axis=1), slips, ways.min(axis=1, initial=np.inf))
    standing = _standing(np.maximum(height[1:], height[:-1]), slips * rate)
    planted = np.zeros(len(z), dtype=bool)
    contacts, total, worst, place, top = 0, 0.0, 0.0, None, 0.0
    for start, end in _runs(standing):  # steps start, ..., end - 1
        if (end - start) / rate < _SHORTEST:
            continue
        planted[start : end + 1] = True
        way = float(slips[start:end].sum())
        contacts, total = contacts + 1, total + way
        top = max(top, float(slips[start:end].max() * rate))
        if place is None or way > worst:
            worst, place = way, (start, end)
    first, last = place or (None, None)
    return FootSlip(foot, planted, contacts, total, worst, first, last, top)


def _standing(height: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """(T - 1,) whether the foot is planted in each step, with hysteresis."""
    on = (height <= HEIGHT_ON) & (speed <= SPEED_ON)
    off = (height > HEIGHT_OFF) | (speed > SPEED_OFF)
    standing, now = np.zeros(len(height), dtype=bool), False
    for step in range(len(height)):
        now = bool(on[step] or (now and not off[step]))
        standing[step] = now
    return standing


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    edges = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    return list(
        zip(
            np.flatnonzero(edges == 1).tolist(),
            np.flatnonzero(edges == -1).tolist(),
            strict=True,
        )
    )


def _outward(robot: WholeBody, frame: str) -> tuple[str, ...]:
    """Names of the link that a frame is on, and of all that hang on it."""
    plant = robot.plant
    first: RigidBody = find_frame(plant, frame).body()
    found, queue = [], [first]
    while queue:
        body = queue.pop()
        found.append(body.name())
        for index in plant.GetJointIndices():
            joint = plant.get_joint(index)
            if joint.parent_body().index() == body.index():
                queue.append(joint.child_body())
    return tuple(found)


def _hull(vertices: np.ndarray) -> np.ndarray:
    try:
        return vertices[ConvexHull(vertices).vertices]
    except QhullError:  # it is flat, or a needle
        return vertices
