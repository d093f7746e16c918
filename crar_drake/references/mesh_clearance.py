"""How far the meshes of a robot keep from each other on a whole motion: bounds.

Pairs are those of links with more than one joint between them. The motion is given by
frames, and goes straight in joint space from each to the next. A pair's distance is
measured where it must be; from there a bound on how fast two links can come nearer
says how long it stays positive (conservative advancement).

**Theorem.** Let C be the frame that carries both links A and B of a pair and moves with
neither alone. On the way q + u x, 0 <= u <= 1, every point p of A moves in C at

    |dp/du| <= sum_j |x_j| rho_j

over the joints j between C and A, where rho_j is the distance of A's farthest point
from the axis of joint j, and 1 for a slide; for B alike. The distance d of the two
surfaces changes no faster than both together: with L(s) the sum of both, added up from
the first frame to the time s (of frames and parts of ways),

    |d(s) - d(t)| <= |L(s) - L(t)|.                                            (M1)

So on a part [s, t] of the motion, d >= (d(s) + d(t) - L(t) + L(s)) / 2.       (M2)

*rho.* The farthest point of a link is within a box, and a distance from a line is
convex, so that a corner of the box is as far from the axis at least. While the way is
gone, the joints i between j and the link move it against the axis of j, and rho_j
changes no faster than sum_i |x_i| rho_i. So on the whole way

    rho_j <= (rho_j(0) + rho_j(1) + sum_i |x_i| rho_i) / 2,                    (M3)

from the joint next to the link upward, with the bound of each rho_i put in.

*Near.* A link's farthest point moves the fastest, but where two links are near is often
beside an axis. So links whose hulls are not apart are divided into pieces: (M1) to (M3)
hold of each two pieces, with rho_j of their own, and d is the smallest of their
distances.

*Inside.* (M1) is of surfaces. As long as they do not meet, neither link gets into the
other; on each stretch of the motion on which a pair's surfaces do not meet it is clear
somewhere (a plane parts the hulls, or winding numbers say so), and so on all of it.

**Assumptions.** The links are rigid and are what their files of triangles say, the
joints are where the motion has them, and it goes straight in between. The distance of
hulls is shown by a plane, whoever found it; that of triangles is Coal's, a library's
that is trusted. A measured distance counts for a micrometre less (`ROUNDING`): doubles
are off by less than a thousandth of that.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.judging.judged_pairs import postures_as_built
from crar_drake.law.compilation import compiled
from crar_drake.motion.planted_feet import runs
from crar_drake.references.mesh_pairs import (
    ROUNDING,
    MeshPairs,
    relative_poses,
)
from crar_drake.references.surfaces import HullsOfPairs, Surface
from crar_drake.references.whole_body import WholeBody

# A bound is sought until it is this share of the distance, or so much [m]: of hulls,
# and of triangles.
_OF_HULLS, _OF_TRIANGLES = (0.5, 5e-3), (0.1, 1e-3)

# Where hulls are farther apart than this, the triangles are not asked [m]; triangles
# that are farther apart are not told from each other.
_HULLS_ENOUGH, _CAP = 3e-4, 1.2e-3

# Parts of a way on which two links come nearer by less are not halved [m].
_FINEST = 1e-4

# Where joints are farther from 0, sums of ways are too large for doubles [rad or m].
_FARTHEST = 1e5

# Pairs that come no nearer are far from each other: no closer bound is sought [m].
_NEAR = _OF_HULLS[1]

# Configurations whose frames are placed at a time, and frames that are searched.
_BLOCK = 512

Pair = tuple[Surface, Surface]  # A and B


class _Bounds(NamedTuple):
    """What P pairs keep in T frames; no distance is smaller."""

    at: np.ndarray  # (P, T) at the frames, 0 where they touch [m]
    # (P, T - 1) on the ways to the next; 0 where they touch, or are not shown to be
    # clear [m]
    on: np.ndarray
    # (P, T) and (P, T - 1) whether they were found to touch, or one inside the other;
    # on ways, at their ends as well
    touch_at: np.ndarray
    touch_on: np.ndarray


@dataclass
class MeshClearance:
    """What P pairs of links keep in T frames and on the ways between.

    Of pairs that come near frames and ways are told, of all others the smallest bounds
    alone: a motion may be long, and most pairs are far from each other.
    """

    pairs: list[tuple[str, str]]  # (P) their names
    least_at: np.ndarray  # (P,) no distance at a frame is smaller [m],
    least_on: np.ndarray  # (P,) and none on a way; infinite of a single frame
    near: np.ndarray  # (K,) those that come near
    # of these:
    at_frames: np.ndarray  # (K, T)
    on_ways: np.ndarray  # (K, T - 1)
    touch_at: np.ndarray  # (K, T)
    touch_on: np.ndarray  # (K, T - 1), as of `_Bounds`

    @property
    def not_shown(self) -> np.ndarray:
        """(K, T - 1) ways that were not found to touch, nor shown to be clear."""
        return ~(self.on_ways > 0.0) & ~self.touch_on

    @property
    def num_touching(self) -> int:
        """Frames in which a pair touches."""
        return int(self.touch_at.any(axis=0).sum())

    @property
    def num_unclear(self) -> int:
        """Ways on which a pair touches, or is not shown to be clear."""
        return int((~(self.on_ways > 0.0)).any(axis=0).sum())

    def with_bounds(self, blocks: Iterable[tuple[int, _Bounds]]) -> MeshClearance:
        """The same with what was found of some frames.

        Args:
            blocks: of each the first frame, and the bounds.
        """
        found = replace(self, **{name: getattr(self, name).copy() for name in _OF_NEAR})
        for first, bounds in blocks:
            found._put(first, bounds)
        rows, near = (found.at_frames, found.on_ways), found.near
        for least, of_near in zip((found.least_at, found.least_on), rows, strict=True):
            least[near] = of_near.min(axis=1, initial=np.inf)
        return found

    def _put(self, first: int, bounds: _Bounds) -> None:
        least = [x.min(axis=1, initial=np.inf) for x in (bounds.at, bounds.on)]
        more = np.flatnonzero(np.minimum(*least) < _NEAR)
        more = more[~np.isin(more, self.near)]
        self.near = np.concatenate([self.near, more])
        # What is known of their other frames.
        fill = self.least_at, self.least_on, np.zeros(len(self.pairs), dtype=bool)
        for name, values in zip(_OF_NEAR[2:], (*fill, fill[-1]), strict=True):
            rows = getattr(self, name)
            new = np.repeat(values[more, None], rows.shape[1], axis=1)
            setattr(self, name, np.concatenate([rows, new]))
        for name, x in zip(_OF_NEAR[2:], bounds, strict=True):
            getattr(self, name)[:, first : first + x.shape[1]] = x[self.near]
        self.least_at = np.minimum(self.least_at, least[0])
        self.least_on = np.minimum(self.least_on, least[1])


_OF_NEAR = "least_at", "least_on", "at_frames", "on_ways", "touch_at", "touch_on"


class ClearanceOfMeshes:
    """Finds what the meshes of a robot keep on its motions.

    Attributes:
        robot: whose they are.
        meshes: the pairs, and what they are not.
    """

    def __init__(self, robot: WholeBody) -> None:
        """
        Raises:
            ModelError: a mesh cannot be read, or a joint is of no known kind.
        """
        self.robot, self.meshes = robot, MeshPairs(robot)
        # What was asked last is often asked again, with some frames changed.
        self._last: tuple[np.ndarray | None, MeshClearance | None] = None, None
        built = postures_as_built(robot.plant, robot.description)
        touch = [self._find(q[None]).touch_at for q in built]
        self.meshes.leave_out(np.concatenate(touch, axis=1).all(axis=1))

    def find(self, joint_positions: np.ndarray) -> MeshClearance:
        """What the pairs keep on a motion.

        Args:
            joint_positions: (T, n), in the order of the robot's `joint_names` [rad or
                m].

        Raises:
            MotionError: there is no frame, or a position is no number, or beyond 1e5.
        """
        q = np.asarray(joint_positions, dtype=float)
        if not len(q):
            raise MotionError("a motion without frames")
        bad = np.argwhere(~(np.abs(q) <= _FARTHEST))
        if len(bad):
            frame, joint = bad[0]
            name = self.robot.joint_names[joint]
            raise MotionError(f"frame {frame + 1}: joint {name!r} is {q[frame, joint]}")
        before, found = self._last
        if before is None or before.shape != q.shape:
            found, changed = _nothing(self.meshes.pairs, len(q)), np.ones(len(q), bool)
        else:
            changed = (q != before).any(axis=1)
        if changed.any():
            found = found.with_bounds(self._blocks(q, changed))
            self._last = q.copy(), found
        return found

    def _blocks(
        self, q: np.ndarray, changed: np.ndarray
    ) -> Iterator[tuple[int, _Bounds]]:
        """Yields the first frame of each stretch of no more than so many frames that
        changed, with the ways from and to its neighbours, and its bounds.

        Args:
            q: (T, n) as of `find`.
            changed: (T,) which did.
        """
        for first, last in runs(changed):
            for start in range(first, last, _BLOCK):
                begin, end = max(start - 1, 0), min(start + _BLOCK, last) + 1
                yield begin, self._find(self.robot.configurations(q[begin:end]))

    def _find(self, q: np.ndarray) -> _Bounds:
        """As `find`, of positions (T, nq) of the plant and of all pairs."""
        links, rows = self.meshes.meshes, self.meshes.rows
        motion = _Motion(self.meshes, q)
        pairs = [(links[i], links[j]) for i, j in rows]
        low = motion.balls_apart(links, links)[rows[:, 0], rows[:, 1]]
        hulls = _Search(motion, pairs, low)
        at, on, _, _ = hulls.bounds(*_OF_HULLS, _HULLS_ENOUGH)
        parted = at > 0.0
        enough = _OF_TRIANGLES[1]
        touch_at, touch_on = np.zeros_like(parted), np.zeros(on.shape, dtype=bool)
        near = (at < _HULLS_ENOUGH).any(axis=1) | ~(on > 0.0).all(axis=1)
        for row in np.flatnonzero(near):
            of_a, of_b = (x.pieces for x in pairs[row])
            low = np.maximum(motion.balls_apart(of_a, of_b), at[row])
            ways = _on_parts(low[..., :-1], low[..., 1:], hulls.steps[row])
            far = (low >= enough).all(axis=2)
            far &= (np.maximum(ways, on[row]) >= enough).all(axis=2)
            pieces = [(of_a[i], of_b[j]) for i, j in np.argwhere(~far)]
            every = np.tile(on[row], (len(pieces), 1))
            search = _Search(motion, pieces, low[~far], every)
            found = search.bounds(*_OF_TRIANGLES, _FINEST)
            touch_at[row], touch_on[row] = (x.any(axis=0) for x in found[2:])
            for bounds, each in ((at, found[0]), (on, found[1])):
                least = each.min(axis=0, initial=enough)
                bounds[row] = np.maximum(bounds[row], least)
            at[row, touch_at[row]] = on[row, touch_on[row]] = 0.0
        self._look_inside(q, parted, on, touch_at, touch_on)
        at[touch_at], on[touch_on] = 0.0, 0.0
        return _Bounds(at, on, touch_at, touch_on)

    def _look_inside(self, q, parted, on, touch_at, touch_on) -> None:
        """One link inside the other touches it, in all frames until surfaces meet.

        Args:
            q: (T, nq) positions of the plant.
            parted: (P, T) where hulls are apart.
            on, touch_at, touch_on: as of `_Bounds`; what is found is added to the
                last two.
        """
        decided = parted | touch_at
        for row in np.flatnonzero(~decided.all(axis=1)):
            a, b = (self.meshes.meshes[k] for k in self.meshes.rows[row])
            ends = np.flatnonzero(touch_on[row] | (on[row] <= 0.0)) + 1
            for stretch in np.split(np.arange(decided.shape[1]), ends):
                k = int(stretch[0])
                if decided[row, stretch].any():
                    continue
                R, p = self.meshes.poses(q[k : k + 1])
                if a.one_inside(b, *relative_poses(R[0], p[0], a.frame, b.frame)):
                    touch_at[row, stretch] = touch_on[row, stretch[:-1]] = True

    def advance(self, q: np.ndarray) -> np.ndarray:
        """(P, T - 1) by how much each pair can come nearer on each way: of (M1) [m].

        Args:
            q: (T, nq) positions of the plant.
        """
        links = self.meshes.meshes
        pairs = [(links[i], links[j]) for i, j in self.meshes.rows]
        return _Motion(self.meshes, q).advance(pairs)


@compiled
def swept(
    R: np.ndarray,
    p: np.ndarray,
    frame: int,
    corners: np.ndarray,
    joints: np.ndarray,
    frames: np.ndarray,
    turns: np.ndarray,
    slides: np.ndarray,
    steps: np.ndarray,
) -> np.ndarray:
    """(T - 1,) how far joints can move a point of a surface on each way: (M3) [m].

    Args:
        R, p: R_WF (T, N, 3, 3) and p_WF (T, N, 3) of all frames [m].
        frame: which carries the surface.
        corners: (8, 3) of its box, in that frame [m].
        joints: that move it, the one that is next to it first.
        frames: (nv,) which frame each joint is of.
        turns: (nv, 3) axis of each in that frame, 0 of one that slides.
        slides: (nv,) how far each slides [m/rad or 1].
        steps: (T - 1, nv) by how much each joint moves [rad or m].
    """
    found, rho = np.zeros(len(steps)), np.zeros((len(R), len(joints)))
    placed = np.empty((len(corners), 3))
    for k in range(len(R)):
        for i in range(len(corners)):
            for x in range(3):
                placed[i, x] = p[k, frame, x]
                for y in range(3):
                    placed[i, x] += R[k, frame, x, y] * corners[i, y]
        for j in range(len(joints)):
            v = joints[j]
            of = frames[v]
            a, b, c = 0.0, 0.0, 0.0
            for y in range(3):
                a += R[k, of, 0, y] * turns[v, y]
                b += R[k, of, 1, y] * turns[v, y]
                c += R[k, of, 2, y] * turns[v, y]
            for i in range(len(corners)):
                x = placed[i, 0] - p[k, of, 0]
                y = placed[i, 1] - p[k, of, 1]
                z = placed[i, 2] - p[k, of, 2]
                arm = (b * z - c * y) ** 2 + (c * x - a * z) ** 2 + (a * y - b * x) ** 2
                rho[k, j] = max(rho[k, j], np.sqrt(arm))
    for k in range(len(steps)):
        for j in range(len(joints)):
            v = joints[j]
            farthest = slides[v]
            if turns[v].any():
                farthest += (rho[k, j] + rho[k + 1, j] + found[k]) / 2.0
            found[k] += steps[k, v] * farthest
    return found


@compiled
def _balls_apart(a, radii_a, b, radii_b):
    """(A, B, T) how far balls about a (A, T, 3) and b (B, T, 3) are apart [m]."""
    found = np.empty((len(a), len(b), a.shape[1]))
    for i in range(len(a)):
        for j in range(len(b)):
            radii = radii_a[i] + radii_b[j] + 1e-9  # that doubles are off by
            for k in range(a.shape[1]):
                x, y = a[i, k, 0] - b[j, k, 0], a[i, k, 1] - b[j, k, 1]
                z = a[i, k, 2] - b[j, k, 2]
                found[i, j, k] = np.sqrt(x * x + y * y + z * z) - radii
    return found


def _nothing(pairs: list[tuple[str, str]], frames: int) -> MeshClearance:
    """Of a motion before it is looked at."""
    at, on = np.zeros((0, frames)), np.zeros((0, frames - 1))
    least, none = np.full(len(pairs), np.inf), np.zeros(0, dtype=int)
    return MeshClearance(pairs, least, least, none, at, on, at > 0.0, on > 0.0)


class _Motion:
    """Where the frames of a robot are, and how far surfaces go.

    Attributes:
        q: (T, nq) positions of the plant.
    """

    def __init__(self, meshes: MeshPairs, q: np.ndarray) -> None:
        self.q, self._meshes, self._joints = q, meshes, meshes.joints
        self._R, self._p = meshes.poses(q)
        steps = np.abs(np.diff(q, axis=0))[:, self._joints.tree.position]
        # A root that floats stands still: its quaternion has no velocity of its own.
        self._steps = steps[:, self._joints.frame_of_velocity]
        self._swept: dict[tuple[int, bytes], np.ndarray] = {}

    def advance(self, pairs: Sequence[Pair]) -> np.ndarray:
        """(P, T - 1) by how much each pair can come nearer on each way: of (M1) [m]."""
        moved_by = self._joints.moved_by
        found = np.zeros((len(pairs), len(self._steps)))
        for row, (a, b) in enumerate(pairs):
            of_a, of_b = moved_by[a.frame], moved_by[b.frame]
            found[row] = self._sweep(a, of_a & ~of_b) + self._sweep(b, of_b & ~of_a)
        return found

    def _sweep(self, surface: Surface, by: np.ndarray) -> np.ndarray:
        """(T - 1,) how far the velocities of a mask can move its points [m]."""
        key = id(surface), by.tobytes()
        if key not in self._swept:
            joints, outward, frame = self._joints, [], surface.frame
            while frame:
                outward += [v for v in reversed(joints.velocities[frame]) if by[v]]
                frame = int(joints.tree.parent[frame])
            self._swept[key] = swept(
                *(self._R, self._p, surface.frame, surface.corners),
                *(np.array(outward, dtype=int), joints.frame_of_velocity),
                *(joints.turns, np.linalg.norm(joints.slides, axis=1), self._steps),
            )
        return self._swept[key]

    def balls_apart(
        self, some: Sequence[Surface], others: Sequence[Surface]
    ) -> np.ndarray:
        """(A, B, T) how far the balls about surfaces and about others are apart [m]."""
        return _balls_apart(*self._balls(some), *self._balls(others))

    def _balls(self, surfaces: Sequence[Surface]) -> tuple[np.ndarray, np.ndarray]:
        """Their centres (A, T, 3) and radii (A,) [m]."""
        frames = np.array([x.frame for x in surfaces], dtype=int)
        centres = np.array([x.centre for x in surfaces]).reshape(-1, 3, 1)
        placed = self._p[:, frames] + (self._R[:, frames] @ centres)[..., 0]
        radii = np.array([x.radius for x in surfaces])
        return np.ascontiguousarray(placed.swapaxes(0, 1)), radii

    def placed(self, a, b, frame, part) -> tuple[np.ndarray, np.ndarray]:
        """R_AB (M, 3, 3) and p_AB (M, 3) [m].

        Args:
            a, b: (M,) numbers of A and B.
            frame, part: (M,) the part of the way from a frame to the next.
        """
        if not part.any():
            R, p, at = self._R, self._p, frame
        else:
            u = part[:, None]
            after = self.q[np.minimum(frame + 1, len(self.q) - 1)]
            R, p = self._meshes.poses((1.0 - u) * self.q[frame] + u * after)
            at = np.arange(len(part))
        R_AW = R[at, a].swapaxes(1, 2)
        return R_AW @ R[at, b], (R_AW @ (p[at, b] - p[at, a])[..., None])[..., 0]


class _Search:
    """Of one motion: what is known of the distances of P pairs of surfaces so far."""

    def __init__(
        self,
        motion: _Motion,
        pairs: Sequence[Pair],
        low: np.ndarray,
        on: np.ndarray | None = None,
    ) -> None:
        """
        Args:
            motion: it.
            pairs: of surfaces A and B.
            low, on: (P, T) and (P, T - 1) no distance at a frame, or on the way to the
                next, is smaller [m]; without `on` only hulls are asked.
        """
        self._motion, self._pairs, self._hulls = motion, pairs, HullsOfPairs(pairs)
        self._of_triangles = on is not None
        self._frames = np.array([[x.frame for x in pair] for pair in pairs], dtype=int)
        self._frames = self._frames.reshape(-1, 2)
        self.steps = motion.advance(pairs)
        self._L = _added_up(self.steps)
        self._low = low
        self._on = np.full_like(self.steps, -np.inf) if on is None else on
        self._found = np.full_like(low, np.inf)  # that was measured

    def bounds(
        self, share: float, enough: float, finest: float
    ) -> tuple[np.ndarray, ...]:
        """The bounds, each close enough or of distances that were measured.

        Args:
            share, enough: a bound is close if it is such a share of the distance, or
                so much [m].
            finest: parts of a way on which surfaces come nearer by less are not halved
                [m].

        Returns:
            As of `_Bounds`.
        """
        some = np.arange(len(self._low))
        between, way_open = self._on.copy(), np.zeros(self._on.shape, dtype=bool)
        # Of pairs of which nothing is measured, nothing more is known.
        while len(some):
            aim = np.minimum(enough, share * self._spread(some))
            low = self._low[some]
            of_ways = _on_parts(low[:, :-1], low[:, 1:], self.steps[some])
            between[some] = of_ways = np.maximum(of_ways, self._on[some])
            way_open[some] = open_ = of_ways < np.minimum(aim[:, :-1], aim[:, 1:])
            asked = low < aim
            asked[:, :-1] |= open_
            asked[:, 1:] |= open_
            pair, frame = _middles(asked & np.isinf(self._found[some]))
            pair = some[pair]
            d = self._measure(pair, frame, np.zeros(len(pair)))
            self._low[pair, frame] = np.maximum(self._low[pair, frame], d)
            self._found[pair, frame] = d
            some = np.unique(pair)
        touch_at = self._found <= 0.0
        touch_on = touch_at[:, :-1] | touch_at[:, 1:]
        bounds = np.maximum(between, 0.0)
        on = self._halve(bounds, way_open, touch_on, share, enough, finest)
        on[touch_on] = 0.0
        at = np.where(touch_at, 0.0, np.maximum(self._low, 0.0))
        return at, on, touch_at, touch_on

    def _spread(self, some: np.ndarray) -> np.ndarray:
        """What is known of a frame says something of all others: (M1).

        Args:
            some: (K,) of which pairs.

        Returns:
            (K, T) no distance is larger [m].
        """
        low, high, L = self._low[some], self._found[some], self._L[some]
        low = np.maximum(low, np.maximum.accumulate(low + L, axis=1) - L)
        low = np.maximum(low, _backward(np.maximum, low - L) + L)
        high = np.minimum(high, np.minimum.accumulate(high - L, axis=1) + L)
        high = np.minimum(high, _backward(np.minimum, high + L) - L)
        self._low[some] = low
        return high

    def _measure(self, pair, frame, part) -> np.ndarray:
        """(M,) distances [m].

        Args:
            pair, frame, part: (M,) which pair, and where: the part of the way from a
                frame to the next.
        """
        d = np.empty(len(pair))
        for start in range(0, len(pair), _BLOCK):
            some = slice(start, start + _BLOCK)
            at = frame[some], part[some]
            R, p = self._motion.placed(*self._frames[pair[some]].T, *at)
            d[some] = self._hulls.apart(pair[some], R, p)
            if self._of_triangles:
                for k in np.flatnonzero(d[some] < _HULLS_ENOUGH):
                    a, b = self._pairs[pair[start + k]]
                    d[start + k] = a.distance(b, R[k], p[k], _CAP)
        return np.maximum(0.0, d - ROUNDING)

    def _halve(
        self, bounds, way_open, touch, share: float, enough: float, finest: float
    ) -> np.ndarray:
        """Ways whose ends do not show enough are halved.

        Args:
            bounds: (P, T - 1) of all ways [m].
            way_open: (P, T - 1) whose are to be replaced: both ends are measured.
            touch: (P, T - 1) on which ways a pair touches; more are found.
            share, enough, finest: as of `bounds`.

        Returns:
            The bounds of all ways.
        """
        pair, way = np.nonzero(way_open & ~touch)
        first, last = self._found[pair, way], self._found[pair, way + 1]
        bounds[pair, way] = np.inf
        begin, width = np.zeros(len(pair)), 1.0
        while len(pair):
            nearer = width * self.steps[pair, way]
            bound = _on_parts(first, last, nearer)
            close = bound >= np.minimum(enough, share * np.minimum(first, last))
            done = close | (nearer < finest) | touch[pair, way]
            at = pair[done], way[done]
            np.minimum.at(bounds, at, np.maximum(bound[done], 0.0))
            pair, way, begin, first, last = (
                each[~done] for each in (pair, way, begin, first, last)
            )
            width /= 2.0
            middle = self._measure(pair, way, begin + width)
            np.logical_or.at(touch, (pair, way), middle <= 0.0)
            pair, way = np.tile(pair, 2), np.tile(way, 2)
            begin = np.concatenate([begin, begin + width])
            first, last = np.concatenate([[first, middle], [middle, last]], axis=1)
        return bounds


def _on_parts(first, last, nearer) -> np.ndarray:
    """(M2) from the distances at the ends of parts of ways [m]."""
    return (first + last - nearer) / 2.0


def _added_up(steps: np.ndarray) -> np.ndarray:
    """(..., T) sums of all steps (..., T - 1) before."""
    return np.cumsum(np.insert(steps, 0, 0.0, axis=-1), axis=-1)


def _backward(of: np.ufunc, values: np.ndarray) -> np.ndarray:
    """The largest or smallest of each frame and all after it."""
    return of.accumulate(values[:, ::-1], axis=1)[:, ::-1]


def _middles(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the middle of each run of True in the rows of a mask."""
    padded = np.zeros((len(mask), mask.shape[1] + 2), dtype=np.int8)
    padded[:, 1:-1] = mask
    change = np.diff(padded, axis=1)
    row, start = np.nonzero(change > 0)
    _, end = np.nonzero(change < 0)
    return row, (start + end - 1) // 2
