"""Nearest points of two meshes, and how they move, whether they are apart or meet.

Of two surfaces that are apart, d is the distance of their nearest points P of A and Q
of B. With n the direction from P to Q

    d = n . (p_Q - p_P),    dd/dq = n . (J_Q - J_P).

Of two that meet there is no such pair. B is then moved out of A along some direction m,
until they are hardly apart. The nearest points there, moved back with B, have d and the
gradient, and d is negative. As m the direction n of a neighbour on the motion is taken,
where it is known, and then the n that was found, while the way out becomes shorter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from crar_drake.references.mesh_pairs import MeshPairs, relative_poses
from crar_drake.references.surfaces import HullsOfPairs

# Nearest points stay while no point of B moved farther in A [m], or than this share of
# the distance.
_SAME, _SAME_SHARE = 2e-4, 0.25
# Surfaces that are nearer are taken as if they met, and moved as far out [m].
_APART = 1e-4
# A way out is sought so far, then twice as far and so on [m].
_FIRST, _FARTHEST = 1e-3, 0.128
_TURNS = 3  # of the direction of a way out, at most
_ADVANCES = 30  # back on it, at most
# What is farther than half the way out, and than this, is not told from each other [m].
_LEAST = 5e-4
_ROUNDED = 1e-6  # what doubles are off by, and more [m]
_AXES = np.vstack([np.eye(3), -np.eye(3)])
_ONE = np.zeros(1, dtype=int)


class _Points(NamedTuple):
    """Nearest points of A and B: with B where they were found, R_AB and p_AB, the
    points p_AP and p_BQ [m], and n in A."""

    R: np.ndarray
    p: np.ndarray
    P: np.ndarray
    Q: np.ndarray
    n: np.ndarray


class NearestPoints:
    """Of a pair of meshes, at places on a motion."""

    def __init__(self, meshes: MeshPairs, i: int, j: int) -> None:
        """
        Args:
            meshes: of the robot; i, j: which of them A and B are.
        """
        self._joints = meshes.joints
        self._surfaces = meshes.meshes[i], meshes.meshes[j]
        self._a, self._b = (surface.frame for surface in self._surfaces)
        self._hulls = HullsOfPairs([self._surfaces])
        self._known: dict[tuple[int, float], _Points] = {}

    def find(
        self,
        places: Sequence[tuple[int, float]],
        R: np.ndarray,
        p: np.ndarray,
        enough: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What is nearer than enough.

        Args:
            places: (S,) on the motion, one after the other, by which points are known
                from a call to the next.
            R, p: R_WF (S, N, 3, 3) and p_WF (S, N, 3) of all frames there [m].
            enough: [m].

        Returns:
            (K,) which of the places; (K,) distances, negative where they meet [m]; and
            (K, nv) the gradients. Meshes that meet without a way out are left out.
        """
        R_AB, p_AB = relative_poses(R, p, self._a, self._b)
        self._measure(places, R_AB, p_AB, enough)
        known = [k for k, place in enumerate(places) if place in self._known]
        points = [self._known[places[k]][2:] for k in known]
        P, Q, n = np.array(points).reshape(-1, 3, 3).swapaxes(0, 1)
        Q = (R_AB[known] @ Q[..., None])[..., 0] + p_AB[known]
        d = np.sum(n * (Q - P), axis=1)
        near = d < enough
        k = np.array(known, dtype=int)[near]
        R, p = R[k], p[k]
        P, Q, n = ((R[:, self._a] @ x[near, :, None])[..., 0] for x in (P, Q, n))
        joints = self._joints
        frames = joints.frame_of_velocity
        turns, slides = (
            (R[:, frames] @ x[..., None])[..., 0] for x in (joints.turns, joints.slides)
        )
        gradient = np.zeros((len(k), len(frames)))
        for point, frame, sign in ((P, self._a, -1.0), (Q, self._b, 1.0)):
            arms = (p[:, self._a] + point)[:, None] - p[:, frames]
            moves = (np.cross(turns, arms) + slides) @ n[..., None]
            gradient += sign * joints.moved_by[frame] * moves[..., 0]
        return k, d[near], gradient

    def _measure(
        self, places: Sequence, R: np.ndarray, p: np.ndarray, enough: float
    ) -> None:
        """Finds the points anew where B has moved, if A and B can be near.

        Args:
            places, enough: as of `find`.
            R, p: R_AB (S, 3, 3) and p_AB (S, 3) [m].
        """
        meet = []
        for k, place in enumerate(places):
            farther = enough
            if place in self._known:
                was = self._known[place]
                d, moved = self._moved(was, R[k], p[k])
                if moved < max(_SAME, _SAME_SHARE * d):
                    continue
                now = R[k] @ was.Q + p[k] - was.P
                farther = min(enough, np.linalg.norm(now) + _ROUNDED)
            d, P, Q = self._nearest(R[k], p[k], farther)
            if P is None:
                self._known.pop(place, None)
            elif d > _APART:
                n = (Q - P) / d
                self._known[place] = _Points(R[k], p[k], P, (Q - p[k]) @ R[k], n)
            else:
                meet.append(k)
        # From what is known on into what meets.
        known = np.flatnonzero([place in self._known for place in places])
        meet.sort(key=lambda k: np.abs(known - k).min(initial=len(places)))
        for k in meet:
            near = places[k : k + 1]
            if places[k] not in self._known:
                near = places[max(k - 1, 0) : k + 2]
            along = [self._known[x].n for x in near if x in self._known]
            ways = [self._way_out(R[k], p[k], m) for m in along or _AXES]
            ways = [way for way in ways if way is not None]
            if ways:
                _, P, Q, n = min(ways, key=lambda way: way[0])
                self._known[places[k]] = _Points(R[k], p[k], P, (Q - p[k]) @ R[k], n)

    def _moved(self, was: _Points, R, p) -> tuple[float, float]:
        """The distance that was found, and by how much no point of B has moved more in
        A since [m]."""
        moves = self._surfaces[1].corners @ (R - was.R).T + (p - was.p)
        farthest = np.sqrt((moves * moves).sum(axis=1).max())
        return was.n @ (was.R @ was.Q + was.p - was.P), farthest

    def _nearest(self, R: np.ndarray, p: np.ndarray, enough: float) -> tuple:
        a, b = self._surfaces
        d = self._hulls.apart(_ONE, R[None], p[None])[0]
        return (d, None, None) if d >= enough else a.nearest(b, R, p, enough)

    def _way_out(self, R: np.ndarray, p: np.ndarray, m: np.ndarray) -> tuple | None:
        """How far B is moved out of A, along m or on a shorter way from there [m], with
        p_AP, p_AQ and n; None if no way is found."""
        best = None
        for _ in range(_TURNS):
            s, d = _FIRST, 0.0
            while s <= _FARTHEST:
                d, P, Q = self._nearest(R, p + s * m, max(0.5 * s, _LEAST))
                if d > 0.0:
                    break
                s *= 2.0
            if not d > 0.0:
                break
            # Less far by as much as they are apart they do not meet yet.
            for _ in range(_ADVANCES):
                if d < 2.0 * _APART:
                    break
                s -= d - _APART
                d, P, Q = self._nearest(R, p + s * m, max(0.5 * s, _LEAST))
            if P is None or (best is not None and s >= best[0]):
                break
            n = (Q - P) / d
            best, m = (s, P, Q - s * m, n), n
        return best
