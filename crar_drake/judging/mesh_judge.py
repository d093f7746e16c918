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

from crar_drake.judging.judged_pairs import pairs_by_joints, postures_as_built
from crar_drake.judging.mesh_distance import (
    HULL_MARGIN,
    TriangleMesh,
    distance_apart,
    hull_mesh,
    mesh_distance,
)
from crar_drake.robot.description import RobotDescription, robot_diagram
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
    """A pair whose shapes penetrate in some samples of a trajectory."""

    pair: tuple[str, str]  # the two links
    frames: list[int] = field(default_factory=list)  # those samples, from 0
    depths: list[float] = field(default_factory=list)  # how deep in each of them [m]

    @property
    def depth(self) -> float:
        """The deepest [m]."""
        return max(self.depths)

    @property
    def frame(self) -> int:
        """Of the deepest."""
        return self.frames[int(np.argmax(self.depths))]


@dataclass(frozen=True)
class MeshVerdict:
    """What the meshes say of a trajectory."""

    frames: np.ndarray  # (K,) numbers of the samples that were judged
    num_pairs: int  # that were judged
    nearest: Nearest  # the smallest distance of meshes
    penetrations: list[PairContact]  # pairs whose meshes penetrate, the deepest first
    # pairs whose meshes meet in the zero and in the rest posture: they do as they are
    # built
    left_out: list[tuple[str, str]]
    # links whose surface is not closed, so that what is inside of it is a matter of its
    # winding number
    open_links: list[str]

    @property
    def num_penetrating(self) -> int:
        """Samples with a pair of meshes in penetration."""
        return len({frame for each in self.penetrations for frame in each.frames})


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
        self._hulls = [
            [hull_mesh(part.vertices) for part in link.parts] for link in of_links
        ]
        beyond, _ = pairs_by_joints(self._plant, self._bodies)
        self._indices = np.array(beyond, dtype=int).reshape(-1, 2)
        self._context = self._plant.CreateDefaultContext()
        as_built = np.ones(len(beyond), dtype=bool)
        for q in postures_as_built(self._plant, description):
            meet = np.zeros_like(as_built)
            for row, motion in self._near(q, np.full(len(meet), HULL_MARGIN), {}):
                meet[row] = self._apart(row, motion) == 0.0
            as_built &= meet
        pairs = self.pairs
        self.left_out = [pairs[row] for row in np.flatnonzero(as_built)]
        self._indices = self._indices[~as_built]

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """(Nc) the pairs of links that are judged."""
        return [(self.links[i], self.links[j]) for i, j in self._indices]

    @property
    def open_links(self) -> list[str]:
        """Links whose surface has holes, or triangles that are the wrong way around."""
        meshes = zip(self.links, self._meshes, strict=True)
        return [name for name, mesh in meshes if not mesh.is_closed]

    def distances(self, q: np.ndarray) -> np.ndarray:
        """(Nc,) signed distances of all pairs [m]; slow.

        Args:
            q: (nq,) positions of the plant.
        """
        poses, rows = self._poses(q), range(len(self._indices))
        found = (self._apart(k, self._motion(poses, k), mesh_distance) for k in rows)
        return np.array(list(found))

    def judge(self, q_trajectory: np.ndarray, every: int = 1) -> MeshVerdict:
        """Judges each, or every so many, of the samples of a (T, nq) trajectory [rad or
        m]."""
        frames, pairs = np.arange(0, len(q_trajectory), every), self.pairs
        nearest, contacts = Nearest(), {}
        # What is beyond the nearest meshes so far is of no interest.
        least = np.full(len(pairs), np.inf)
        samples = ((q_trajectory[frame], least) for frame in frames)
        for index, row, d in self.nearer(samples):
            frame = int(frames[index])
            if d == 0.0:
                motion = self._motion(self._poses(q_trajectory[frame]), row)
                d = self._apart(row, motion, mesh_distance)
                contact = contacts.setdefault(row, PairContact(pairs[row]))
                contact.frames.append(frame)
                contact.depths.append(float(-d))
            if d < nearest.distance:
                nearest = Nearest(float(d), pairs[row], frame)
                least[:] = max(nearest.distance, 0.0)
        return MeshVerdict(
            frames=frames,
            num_pairs=len(pairs),
            nearest=nearest,
            penetrations=sorted(contacts.values(), key=lambda each: -each.depth),
            left_out=self.left_out,
            open_links=self.open_links,
        )

    def nearer(
        self, samples: Iterable[tuple[np.ndarray, np.ndarray]]
    ) -> Iterator[tuple[int, int, float]]:
        """Where meshes are nearer than somebody says.

        Args:
            samples: of each (nq,) the positions of the plant and (Nc,) what the pairs
                are said to be apart at least, 0 where they may touch [m]; that may be
                lessened while they are looked at.

        Yields:
            The sample, the pair's index, and the distance [m], 0 in penetration.
        """
        known: dict[int, tuple[_Motion, float]] = {}
        for index, (q, least) in enumerate(samples):
            for row, motion in self._near(q, least, known):
                d = self._apart(row, motion)
                known[row] = motion, d
                if d < least[row] or d == 0.0:
                    yield index, row, d

    def _near(
        self,
        q: np.ndarray,
        least: np.ndarray,
        known: dict[int, tuple[_Motion, float]],
    ) -> Iterator[tuple[int, _Motion]]:
        """Yields the row and the motion of those pairs that nothing shows to be farther
        apart than (Nc,) `least` [m]: neither the balls about them, nor how little they
        moved since they were measured, nor their hulls.

        Args:
            known: row to where the pair was measured last, and its distance there [m];
                what is measured of hulls is added. If that is positive, nothing was
                touched on the way since, so that neither is inside the other.
        """
        poses = self._poses(q)
        centres = np.array(
            [X.multiply(m.centre) for X, m in zip(poses, self._meshes, strict=True)]
        ).reshape(-1, 3)
        radii = np.array([mesh.radius for mesh in self._meshes])
        i, j = self._indices.T
        gaps = np.linalg.norm(centres[i] - centres[j], axis=1) - radii[i] - radii[j]
        for row in np.flatnonzero(gaps < least).tolist():
            motion = self._motion(poses, row)
            if row in known:
                before, d = known[row]
                if d - motion.since(before) > least[row]:
                    continue
            hulls = self._hulls_apart(row, motion)
            known[row] = motion, hulls
            if hulls <= least[row]:
                yield row, motion

    def _poses(self, q: np.ndarray) -> list[RigidTransform]:
        """Of each link in the world."""
        self._plant.SetPositions(self._context, q)
        return [
            self._plant.EvalBodyPoseInWorld(self._context, self._plant.get_body(body))
            for body in self._bodies
        ]

    def _motion(self, poses: list[RigidTransform], row: int) -> _Motion:
        i, j = self._indices[row]
        return _Motion(poses[i], poses[j], self._meshes[j])

    def _hulls_apart(self, row: int, motion: _Motion) -> float:
        """The smallest distance of the convex hulls of parts; 0 where they meet [m]."""
        i, j = self._indices[row]
        return min(
            distance_apart(a, b, motion.X_AB)
            for a in self._hulls[i]
            for b in self._hulls[j]
        )

    def _apart(self, row: int, motion: _Motion, distance=distance_apart) -> float:
        i, j = self._indices[row]
        return distance(self._meshes[i], self._meshes[j], motion.X_AB)


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
