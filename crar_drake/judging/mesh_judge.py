"""A second judge of a motion: the triangles of the robot's real meshes.

The controller and the referee know only capsules, and the pairs that somebody listed.
This judge asks for all links that more than one joint is between. Convex hulls of their
meshes bound the distances from below, which spares most questions; where hulls touch,
or might be nearer than the nearest meshes so far, the triangles decide.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from crar_drake.judging.judged_pairs import pairs_beyond_one_joint
from crar_drake.judging.mesh_distance import TriangleMesh, distance_apart, mesh_distance
from crar_drake.judging.mesh_hulls import HULL_MARGIN, Hulls
from crar_drake.robot.description import (
    RobotDescription,
    find_joint,
    robot_diagram,
    zero_positions,
)
from crar_drake.robot_import.link_meshes import read_link_meshes
from crar_drake.robot_import.meshes import triangles_of


@dataclass(frozen=True)
class Nearest:
    """Where two links come nearest."""

    distance: float = np.inf  # signed [m]; infinite without pairs
    pair: tuple[str, str] | None = None  # the two links; None without pairs
    index: int | None = None  # the first sample where it is reached; None without pairs


@dataclass
class PairContact:
    """A pair whose meshes penetrate in some samples of a trajectory."""

    pair: tuple[str, str]  # the two links
    num_samples: int = 0  # with contact
    index: int = 0  # the sample where it is deepest
    mesh_distance: float = np.inf  # in that sample [m]
    samples: list[int] = field(default_factory=list)  # all of them
    depths: list[float] = field(default_factory=list)  # how deep in each of them [m]


@dataclass(frozen=True)
class MeshVerdict:
    """What the meshes say of a trajectory."""

    num_samples: int  # that were judged
    num_pairs: int  # that were judged
    num_penetrating: int  # samples with a pair of meshes in penetration
    nearest: Nearest  # the smallest distance of meshes
    penetrations: list[PairContact]  # pairs whose meshes penetrate, the deepest first
    # pairs whose meshes meet in the zero and in the rest posture: they do as they are
    # built
    left_out: list[tuple[str, str]]
    # links whose surface is not closed, so that what is inside of it is a matter of its
    # winding number
    open_links: list[str]


class MeshJudge:
    """Signed distances between the meshes of all links that can meet.

    Attributes:
        links: names of the links that have a shape.
        pairs: (Nc) pairs of links that are judged.
        left_out: pairs whose meshes meet in the zero and in the rest posture.
    """

    def __init__(self, description: RobotDescription) -> None:
        """
        Raises:
            ModelError: its model or one of its meshes cannot be read, or there is no
                joint that the rest posture names.
        """
        self._diagram, self._plant, scene_graph = robot_diagram(description)
        of_links = read_link_meshes(self._plant, scene_graph)
        self.links = [link.name for link in of_links]
        self._bodies = [link.body for link in of_links]
        self._meshes = [TriangleMesh(*triangles_of(link.parts)) for link in of_links]
        self._indices = np.array(
            pairs_beyond_one_joint(self._plant, self._bodies), dtype=int
        ).reshape(-1, 2)
        self._context = self._plant.CreateDefaultContext()
        self._hulls = Hulls(of_links)
        self._set_left_out(description)

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """(Nc) the pairs of links that are judged."""
        return [(self.links[i], self.links[j]) for i, j in self._indices]

    @property
    def open_links(self) -> list[str]:
        """Links whose surface has holes, or triangles that are the wrong way around."""
        meshes = zip(self.links, self._meshes, strict=True)
        return [name for name, mesh in meshes if not mesh.is_closed]

    def distances(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distances of all pairs by hulls and by meshes; slow.

        Args:
            q: (nq,) positions of the plant.

        Returns:
            (Nc,) distances of the hulls and (Nc,) of the meshes [m].
        """
        poses = self._poses(q)
        self._hulls.place(poses)
        return (
            np.array([self._hulls.distance(i, j) for i, j in self._indices]),
            np.array([self._mesh_distance(poses, i, j) for i, j in self._indices]),
        )

    def judge(self, q_trajectory: np.ndarray) -> MeshVerdict:
        """Judges every sample of a (T, nq) trajectory [rad or m]."""
        tally = _Tally(self.pairs)
        for index, q in enumerate(q_trajectory):
            self._judge_sample(tally, index, q)
        return MeshVerdict(
            num_samples=len(q_trajectory),
            num_pairs=len(tally.pairs),
            num_penetrating=tally.num_penetrating,
            nearest=tally.meshes,
            penetrations=sorted(
                tally.penetrations.values(), key=lambda contact: contact.mesh_distance
            ),
            left_out=self.left_out,
            open_links=self.open_links,
        )

    def nearer(
        self, samples: Iterable[tuple[np.ndarray, np.ndarray]]
    ) -> Iterator[tuple[int, int, float]]:
        """Where meshes are nearer than somebody says.

        Args:
            samples: of each (nq,) the positions of the plant and (Nc,) what the pairs
                are said to be apart at least, 0 where they may touch [m].

        Yields:
            The sample, the pair's index, and the distance [m], 0 in penetration.
        """
        hulls, meshes = _Known(), _Known()
        for index, (q, bounds) in enumerate(samples):
            poses = self._poses(q)
            self._hulls.place(poses)
            for row in self._near_balls(poses, bounds):
                (i, j), least = self._indices[row], bounds[row]
                motion = _Motion(poses[i], poses[j], self._meshes[j])
                if max(hulls.bound(row, motion), meshes.bound(row, motion)) > least:
                    continue
                d = self._hulls.distance(i, j)
                hulls.tell(row, motion, d)
                if d > least:
                    continue
                d = distance_apart(self._meshes[i], self._meshes[j], motion.X_AB)
                meshes.tell(row, motion, d)
                if d < least or d == 0.0:
                    yield index, row, d

    def _judge_sample(self, tally: _Tally, index: int, q: np.ndarray) -> None:
        poses = self._poses(q)
        self._hulls.place(poses)
        # What is beyond the nearest meshes so far is of no interest.
        beyond, near = max(tally.meshes.distance, 0.0), []
        for row in self._near_balls(poses, beyond):
            i, j = self._indices[row]
            motion = _Motion(poses[i], poses[j], self._meshes[j])
            known = tally.hulls_known, tally.meshes_known
            if max(pairs.bound(row, motion) for pairs in known) <= beyond:
                distance = self._hulls.distance(i, j)
                tally.hulls_known.tell(row, motion, distance)
                near.append((distance, row, motion))
        near.sort(key=lambda each: each[:2])
        penetrating = False
        for hull_distance, row, motion in near:
            if hull_distance > max(tally.meshes.distance, 0.0):
                break
            i, j = self._indices[row]
            d = mesh_distance(self._meshes[i], self._meshes[j], motion.X_AB)
            tally.meshes_known.tell(row, motion, d)
            tally.meshes = tally.nearer(tally.meshes, d, row, index)
            if d < 0.0:
                penetrating = True
                tally.penetrate(row, index, d)
        tally.num_penetrating += penetrating

    def _poses(self, q: np.ndarray) -> list[RigidTransform]:
        """Of each link in the world."""
        self._plant.SetPositions(self._context, q)
        return [
            self._plant.EvalBodyPoseInWorld(self._context, self._plant.get_body(body))
            for body in self._bodies
        ]

    def _near_balls(
        self, poses: list[RigidTransform], bound: float | np.ndarray
    ) -> np.ndarray:
        """Rows of the pairs whose bounding balls are nearer than a bound, or theirs."""
        centres = np.array(
            [X.multiply(m.centre) for X, m in zip(poses, self._meshes, strict=True)]
        ).reshape(-1, 3)
        radii = np.array([mesh.radius for mesh in self._meshes])
        i, j = self._indices.T
        gaps = np.linalg.norm(centres[i] - centres[j], axis=1) - radii[i] - radii[j]
        return np.flatnonzero(gaps < bound)

    def _mesh_distance(self, poses: list[RigidTransform], i: int, j: int) -> float:
        X_AB = poses[i].InvertAndCompose(poses[j])
        return mesh_distance(self._meshes[i], self._meshes[j], X_AB)

    def _set_left_out(self, description: RobotDescription) -> None:
        zero = np.clip(
            zero_positions(self._plant),
            self._plant.GetPositionLowerLimits(),
            self._plant.GetPositionUpperLimits(),
        )
        rest = zero.copy()
        for name, value in description.rest_posture.items():
            rest[find_joint(self._plant, name).position_start()] = value
        meet = np.ones(len(self._indices), dtype=bool)
        for q in (rest, zero):
            poses = self._poses(q)
            self._hulls.place(poses)
            near = np.zeros_like(meet)
            near[self._near_balls(poses, HULL_MARGIN)] = True
            meet &= near
            for row in np.flatnonzero(meet):
                i, j = self._indices[row]
                meet[row] = (
                    self._hulls.distance(i, j) <= 0.0
                    and self._mesh_distance(poses, i, j) < 0.0
                )
        pairs = self.pairs
        self.left_out = [pairs[row] for row in np.flatnonzero(meet)]
        self._indices = self._indices[~meet]


class _Motion:
    """Where link B is in the frame of link A, and how far that is from elsewhere."""

    def __init__(self, X_WA: RigidTransform, X_WB: RigidTransform, b: TriangleMesh):
        self.X_AB = X_WA.InvertAndCompose(X_WB)
        self._p_AC = self.X_AB.multiply(b.centre)
        self._radius = b.radius + HULL_MARGIN  # the hull's points are within, too

    def since(self, other: _Motion) -> float:
        """How far any point of B has moved in A at most [m]."""
        turn: RotationMatrix = self.X_AB.rotation().InvertAndCompose(
            other.X_AB.rotation()
        )
        # The chord of an angle t at radius r is 2 r sin(t / 2); trace R = 1 + 2 cos t.
        sine = np.sqrt(max(0.0, (3.0 - np.trace(turn.matrix())) / 4.0))
        return float(
            np.linalg.norm(self._p_AC - other._p_AC) + 2.0 * self._radius * sine
        )


class _Known:
    """Where pairs, by their rows, were measured last, and their distance there."""

    def __init__(self) -> None:
        self._last: dict[int, tuple[_Motion, float]] = {}

    def tell(self, row: int, motion: _Motion, distance: float) -> None:
        self._last[row] = (motion, distance)

    def bound(self, row: int, motion: _Motion) -> float:
        """What a pair is apart at least [m]; -inf if it was not measured.

        Where it is positive, nothing was touched on the way, so that neither is inside
        the other.
        """
        if row not in self._last:
            return -np.inf
        before, distance = self._last[row]
        return distance - motion.since(before)


@dataclass
class _Tally:
    """What is known of the samples so far, with pairs by their rows."""

    pairs: list[tuple[str, str]]
    num_penetrating: int = 0
    meshes: Nearest = Nearest()
    penetrations: dict[int, PairContact] = field(default_factory=dict)
    # Where pairs were measured last.
    hulls_known: _Known = field(default_factory=_Known)
    meshes_known: _Known = field(default_factory=_Known)

    def nearer(self, known: Nearest, distance: float, row: int, index: int) -> Nearest:
        """What is nearest, with one distance more."""
        if distance < known.distance:
            return Nearest(float(distance), self.pairs[row], index)
        return known

    def penetrate(self, row: int, index: int, mesh_distance: float) -> None:
        contact = self.penetrations.setdefault(row, PairContact(self.pairs[row]))
        contact.num_samples += 1
        contact.samples.append(index)
        contact.depths.append(float(-mesh_distance))
        if mesh_distance < contact.mesh_distance:
            contact.index, contact.mesh_distance = index, mesh_distance
