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

*Near.* As long as d < h, the nearest points are in parts of the links that are near
each other, and for min(d, h) in place of d

    |dp/du| <= sum_j |x_j| rho'_j                                              (M4)

with rho'_j the distance from the axis of j of the farthest of these parts
(`near_parts`), which is found as rho_j is. So (M1) and (M2) hold of min(d, h), too. On
a way on which d is known to be h at least, min(d, h) stays h.

*Two joints.* The distance of links with two joints between them depends on both alone.
It is kept in tables of these (`pair_tables`), which say more than (M2) and cost less.

*Inside.* (M1) is of surfaces. As long as they do not meet, neither link gets into the
other; on each stretch of the motion on which a pair's surfaces do not meet it is clear
somewhere (a plane parts the hulls, or winding numbers say so), and so on all of it.

**Assumptions.** The links are rigid and are what their files of triangles say, the
joints are where the motion has them, and it goes straight in between. The distance of
hulls is shown by a plane, whoever found it; that of triangles is FCL's, a library's
that is trusted. A measured distance counts for a micrometre less (`ROUNDING`): doubles
are off by less than a thousandth of that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crar_drake.equations.compilation import compiled
from crar_drake.errors import MotionError
from crar_drake.references.mesh_pairs import CarriedMesh, MeshPairs, relative_poses
from crar_drake.references.near_parts import near_approach
from crar_drake.references.pair_tables import PairTable
from crar_drake.references.whole_body import WholeBody

# A bound is sought until it is half the distance, or so much [m]; those of tables are
# less close.
_ENOUGH = 5e-3

# Of pairs that are nearer, (M1) is asked of those parts alone that are near [m].
_NEAR = 3e-3

# Parts of a way on which two links come nearer by less are not halved [m].
_FINEST = 1e-4

# Where joints are farther from 0, sums of ways are too large for doubles [rad or m].
_FARTHEST = 1e5

# Configurations whose frames are placed at a time, and frames that are searched.
_BLOCK = 4096


@dataclass(frozen=True)
class MeshClearance:
    """What P pairs of links keep in T frames and on the ways between."""

    pairs: list[tuple[str, str]]  # (P) their names
    at_frames: np.ndarray  # (P, T) no distance is smaller [m]; 0 where they touch
    # (P, T - 1) no distance on the way to the next frame is smaller [m]; 0 where they
    # touch, or are not shown to be clear
    on_ways: np.ndarray
    # (P, T) whether they were found to touch, or one inside the other
    touch_at: np.ndarray
    touch_on: np.ndarray  # (P, T - 1) the same of ways, their ends among them
    num_measured: int  # distances that were measured

    @property
    def not_shown(self) -> np.ndarray:
        """(P, T - 1) ways that were not found to touch, nor shown to be clear."""
        return ~(self.on_ways > 0.0) & ~self.touch_on

    @property
    def num_touching(self) -> int:
        """Frames in which a pair touches."""
        return int(self.touch_at.any(axis=0).sum())

    @property
    def num_unclear(self) -> int:
        """Ways on which a pair touches, or is not shown to be clear."""
        return int((~(self.on_ways > 0.0)).any(axis=0).sum())


class ClearanceOfMeshes:
    """Finds what the meshes of a robot keep on its motions.

    Attributes:
        robot: whose they are.
        meshes: the pairs, and what they are not.
        tables: of the pairs with two joints between them, by number.
    """

    def __init__(self, robot: WholeBody) -> None:
        """
        Raises:
            ModelError: a mesh cannot be read, or a joint is of no known kind.
        """
        self.robot, self.meshes = robot, MeshPairs(robot)
        tree = self.meshes.joints
        frames = np.array([mesh.frame for mesh in self.meshes.meshes], dtype=int)
        moved_by = tree.moved_by[frames]
        a, b = self.meshes.rows.T
        self._a_alone = moved_by[a] & ~moved_by[b]  # (P, nv)
        self._b_alone = moved_by[b] & ~moved_by[a]
        self.tables = self._find_tables()
        # What was asked last is often asked again. None is equal to nothing.
        self._last: tuple[np.ndarray | None, MeshClearance | None] = None, None

    def _find_tables(self) -> dict[int, PairTable]:
        """Of the pairs with two joints between them, by number."""
        joints, found = self.meshes.joints, {}
        rest = self.robot.configurations(np.zeros((1, self.robot.n)))[0]
        for row, (a, b) in enumerate(self.meshes.rows):
            links = self.meshes.meshes[a], self.meshes.meshes[b]
            from_a = self._outward(links[0], self._a_alone[row])
            from_b = self._outward(links[1], self._b_alone[row])
            between = [int(v) for v in (*from_a, *from_b[::-1])]
            # Each in a frame of its own: a free joint's are in one.
            moved = [joints.velocities[joints.frame_of_velocity[v]] for v in between]
            if len(between) == 2 and all(len(each) == 1 for each in moved):
                found[row] = PairTable(
                    self.meshes, row, (between[0], between[1]), rest, _NEAR
                )
        return found

    def from_tables(self, q: np.ndarray) -> tuple[np.ndarray, ...]:
        """What is known of pairs with two joints between them: (M5).

        Args:
            q: (T, nq) positions of the plant.

        Returns:
            (P, T) and (P, T - 1) no distance at a frame, or on the way to the next, is
            smaller [m]: -inf of other pairs. And, as often, whether that is positive,
            and close enough.
        """
        shape = len(self.meshes.rows), len(q)
        at, at_done = np.full(shape, -np.inf), np.zeros(shape, dtype=bool)
        on, on_done = at[:, 1:].copy(), at_done[:, 1:].copy()
        for row, table in self.tables.items():
            at[row], at_done[row] = table.bounds(q, q)
            on[row], on_done[row] = table.bounds(q[:-1], q[1:])
            table.keep()
        return at, on, at_done, on_done

    def one_inside(self, row: int, q: np.ndarray) -> bool:
        """Whether one link of a pair is inside the other, where they do not touch.

        Args:
            row: which pair.
            q: (nq,) positions of the plant.
        """
        if row in self.tables:
            return self.tables[row].one_inside(q)
        a, b = self.meshes.rows[row]
        frames = [self.meshes.meshes[k].frame for k in (a, b)]
        R, p = self.meshes.poses(q[None])
        return self.meshes.one_inside(a, b, *relative_poses(R[0], p[0], *frames))

    @property
    def num_in_tables(self) -> int:
        """Distances that were measured for tables."""
        return sum(table.num_measured for table in self.tables.values())

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
        if np.array_equal(q, self._last[0]):
            return self._last[1]
        asked = q.copy()
        q, parts, measured = self.robot.configurations(q), [], 0
        for start in range(0, max(1, len(q) - 1), _BLOCK):
            part = _Search(self, q[start : start + _BLOCK + 1]).clearance()
            # A frame in which one part ends and the next begins is in both.
            inner = slice(None, None if start + _BLOCK >= len(q) - 1 else -1)
            of_frames = part.at_frames[:, inner], part.touch_at[:, inner]
            parts.append((of_frames[0], part.on_ways, of_frames[1], part.touch_on))
            measured += part.num_measured
        arrays = (np.concatenate(each, axis=1) for each in zip(*parts, strict=True))
        self._last = asked, MeshClearance(self.meshes.pairs, *arrays, measured)
        return self._last[1]

    def advance(self, q: np.ndarray, R: np.ndarray, p: np.ndarray) -> np.ndarray:
        """(P, T - 1) by how much each pair can come nearer on each way: of (M1) [m].

        Args:
            q: (T, nq) positions of the plant.
            R, p: R_WF (T, N, 3, 3) and p_WF (T, N, 3) of all frames [m].
        """
        joints, steps = self.meshes.joints, self._joint_steps(q)
        slides = np.linalg.norm(joints.slides, axis=1)
        every = np.ones(steps.shape[1], dtype=bool)
        of_links = [
            swept(
                *(R, p, mesh.frame, mesh.corners, self._outward(mesh, every)),
                *(joints.frame_of_velocity, joints.turns, slides, steps),
            )
            for mesh in self.meshes.meshes
        ]
        found = np.zeros((len(self.meshes.rows), len(steps)))
        for row, (a, b) in enumerate(self.meshes.rows):
            found[row] = self._a_alone[row] @ of_links[a]
            found[row] += self._b_alone[row] @ of_links[b]
        return found

    def advance_of_near(
        self, row: int, q, R, p, advance: np.ndarray, asked: np.ndarray
    ) -> np.ndarray:
        """(T - 1,) by how much min(d, h) of a pair can change on each way, with
        h = `_NEAR`: of (M4) [m].

        Args:
            row: which pair.
            q, R, p: as of `advance`.
            advance: (T - 1,) what that found.
            asked: (T - 1,) on which ways d is not known to be at least h; on others
                min(d, h) does not change.
        """
        joints, links = self.meshes.joints, self.meshes.meshes
        a, b = (links[k] for k in self.meshes.rows[row])
        frames = joints.frame_of_velocity
        approach = near_approach(
            R,
            p,
            np.array([a.frame, b.frame]),
            a.parts,
            b.parts,
            self._outward(a, self._a_alone[row]),
            self._outward(b, self._b_alone[row]),
            p[:, frames],
            (R[:, frames] @ joints.turns[..., None])[..., 0],
            np.linalg.norm(joints.slides, axis=1),
            self._joint_steps(q),
            np.ascontiguousarray(advance),
            asked,
            _NEAR,
        )
        return approach.sum(axis=1)

    def _outward(self, mesh: CarriedMesh, some: np.ndarray) -> np.ndarray:
        """Which velocities of a mask move a link, the one next to it first."""
        joints, found, frame = self.meshes.joints, [], mesh.frame
        while frame:
            found += [v for v in reversed(joints.velocities[frame]) if some[v]]
            frame = int(joints.tree.parent[frame])
        return np.array(found, dtype=int)

    def _joint_steps(self, q: np.ndarray) -> np.ndarray:
        """(T - 1, nv) by how much joints move on each way [rad or m]."""
        joints = self.meshes.joints
        steps = np.abs(np.diff(q, axis=0))[:, joints.tree.position]
        # A root that floats stands still: its quaternion has no velocity of its own.
        return steps[:, joints.frame_of_velocity]


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
    """(nv, T - 1) how far each joint can move a point of a link on each way: (M3) [m].

    Args:
        R, p: R_WF (T, N, 3, 3) and p_WF (T, N, 3) of all frames [m].
        frame: which carries the link.
        corners: (8, 3) of its box, in that frame [m].
        joints: that move it, the one that is next to it first.
        frames: (nv,) which frame each joint is of.
        turns: (nv, 3) axis of each in that frame, 0 of one that slides.
        slides: (nv,) how far each slides [m/rad or 1].
        steps: (T - 1, nv) by how much each joint moves [rad or m].
    """
    found, rho = np.zeros((steps.shape[1], len(steps))), np.zeros((len(R), len(joints)))
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
        below = 0.0
        for j in range(len(joints)):
            v = joints[j]
            farthest = slides[v]
            if turns[v].any():
                farthest += (rho[k, j] + rho[k + 1, j] + below) / 2.0
            found[v, k] = steps[k, v] * farthest
            below += found[v, k]
    return found


class _Search:
    """Of one motion: what is known of the pairs' distances so far."""

    def __init__(self, robot: ClearanceOfMeshes, q: np.ndarray) -> None:
        """
        Args:
            robot: whose motion it is.
            q: (T, nq) positions of the plant.
        """
        self._robot, self._meshes, self._q = robot, robot.meshes, q
        self._rows, links = self._meshes.rows, self._meshes.meshes
        frames = np.array([mesh.frame for mesh in links], dtype=int)
        self._frames = frames[self._rows]  # (P, 2)
        self._R, self._p = self._meshes.poses(q)
        self._steps = robot.advance(q, self._R, self._p)
        self._L = _added_up(self._steps)
        # Of pairs that were found to be near: (M4).
        self._near = np.zeros(len(self._rows), dtype=bool)
        self._near_steps, self._near_L = self._steps.copy(), self._L.copy()
        # Balls about the links bound all distances from below.
        centres = np.array([mesh.centre for mesh in links]).reshape(-1, 3)
        radii = np.array([mesh.radius for mesh in links])
        centres = self._p[:, frames] + (self._R[:, frames] @ centres[..., None])[..., 0]
        a, b = self._rows.T
        apart = np.linalg.norm(centres[:, a] - centres[:, b], axis=2).T
        self._low = apart - (radii[a] + radii[b])[:, None] - 1e-9
        self._parted = self._low > 0.0
        before = robot.num_in_tables
        at, self._on, self._at_done, self._on_done = robot.from_tables(q)
        self._low = np.maximum(self._low, at)
        self._found = np.full_like(self._low, np.inf)  # that was measured
        self._num_measured = robot.num_in_tables - before

    def clearance(self) -> MeshClearance:
        """The bounds, each close enough or of distances that were measured."""
        between, some = np.empty_like(self._on), np.arange(len(self._on))
        way_open = np.empty(between.shape, dtype=bool)
        # Of pairs of which nothing is measured, nothing more is known.
        while len(some):
            aim, low = self._spread(some), self._low[some]
            steps = self._steps[some], self._near_steps[some]
            of_ways = self._on_parts(low[:, :-1], low[:, 1:], *steps)
            between[some] = of_ways = np.maximum(of_ways, self._on[some])
            open_ = of_ways < np.minimum(aim[:, :-1], aim[:, 1:])
            open_ &= ~self._on_done[some]
            way_open[some] = open_
            asked = (low < aim) & ~self._at_done[some]
            asked[:, :-1] |= open_
            asked[:, 1:] |= open_
            pair, frame = _middles(asked & np.isinf(self._found[some]))
            pair = some[pair]
            d, parted = self._measure(pair, frame, np.zeros(len(pair)))
            self._low[pair, frame] = np.maximum(self._low[pair, frame], d)
            self._found[pair, frame] = d
            self._parted[pair, frame] |= parted
            self._look_closer(np.unique(pair[d < _NEAR]), between)
            some = np.unique(pair)
        touch_at = self._found <= 0.0
        touch_on = touch_at[:, :-1] | touch_at[:, 1:]
        on_ways = self._halve(np.maximum(between, 0.0), way_open, touch_on)
        self._look_inside(on_ways, touch_at, touch_on)
        at_frames = np.where(touch_at, 0.0, np.maximum(self._low, 0.0))
        on_ways[touch_on] = 0.0
        names, measured = self._meshes.pairs, self._num_measured
        return MeshClearance(names, at_frames, on_ways, touch_at, touch_on, measured)

    def _look_closer(self, pairs: np.ndarray, between: np.ndarray) -> None:
        """Finds (M4) of pairs, where that was not done yet; `between`: (P, T - 1)
        bounds of ways."""
        for row in pairs[~self._near[pairs]]:
            steps = self._robot.advance_of_near(
                row, self._q, self._R, self._p, self._steps[row], between[row] < _NEAR
            )
            self._near_steps[row] = np.minimum(steps, self._steps[row])
            self._near_L[row] = _added_up(self._near_steps[row])
            self._near[row] = True

    def _spread(self, some: np.ndarray) -> np.ndarray:
        """What is known of a frame says something of all others: (M1) and (M4).

        Args:
            some: (K,) of which pairs.

        Returns:
            (K, T) how close each frame's bound is to be [m].
        """
        low, high = _spread(self._low[some], self._found[some], self._L[some])
        near = self._near[some]
        nearest, farthest = _spread(
            *(np.minimum(x[near], _NEAR) for x in (low, high)),
            self._near_L[some[near]],
        )
        low[near] = np.maximum(low[near], nearest)
        # Sums are rounded: what is not clearly nearer than `_NEAR` may be far.
        high[near] = np.where(farthest < 0.999 * _NEAR, farthest, high[near])
        self._low[some] = low
        return np.minimum(_ENOUGH, 0.5 * high)

    def _on_parts(self, first, last, nearer, nearer_if_near) -> np.ndarray:
        """(M2) from the distances at the ends of parts of ways, of both advances."""
        of_near = np.minimum(first, _NEAR) + np.minimum(last, _NEAR) - nearer_if_near
        return np.maximum(first + last - nearer, of_near) / 2.0

    def _measure(self, pair, frame, part) -> tuple[np.ndarray, np.ndarray]:
        """(M) distances [m], and whether hulls are apart.

        Args:
            pair, frame, part: (M) which pair, and where: the part of the way from a
                frame to the next.
        """
        d, parted = np.empty(len(pair)), np.empty(len(pair), dtype=bool)
        for start in range(0, len(pair), _BLOCK):
            some = slice(start, start + _BLOCK)
            X = self._placed(pair[some], frame[some], part[some])
            d[some], parted[some] = self._meshes.distances(self._rows[pair[some]], *X)
        self._num_measured += len(pair)
        return d, parted

    def _placed(self, pair, frame, part) -> tuple[np.ndarray, np.ndarray]:
        """R_AB and p_AB of pairs."""
        a, b = self._frames[pair].T
        if part.any():
            u = part[:, None]
            after = self._q[np.minimum(frame + 1, len(self._q) - 1)]
            poses = self._meshes.poses((1.0 - u) * self._q[frame] + u * after)
            at = np.arange(len(pair))
        else:
            poses, at = (self._R, self._p), frame
        R_A, R_B = poses[0][at, a].swapaxes(1, 2), poses[0][at, b]
        offset = poses[1][at, b] - poses[1][at, a]
        return R_A @ R_B, (R_A @ offset[..., None])[..., 0]

    def _halve(self, bounds, way_open, touch) -> np.ndarray:
        """Ways whose ends do not show enough are halved.

        Args:
            bounds: (P, T - 1) of all ways [m].
            way_open: (P, T - 1) whose are to be replaced: both ends are measured.
            touch: (P, T - 1) on which ways a pair touches; more are found.

        Returns:
            The bounds of all ways.
        """
        pair, way = np.nonzero(way_open & ~touch)
        first, last = self._found[pair, way], self._found[pair, way + 1]
        bounds[pair, way] = np.inf
        begin, width = np.zeros(len(pair)), 1.0
        while len(pair):
            nearer, of_near = (
                width * steps[pair, way] for steps in (self._steps, self._near_steps)
            )
            bound = self._on_parts(first, last, nearer, of_near)
            enough = bound >= np.minimum(_ENOUGH, 0.5 * np.minimum(first, last))
            nearer = np.where(np.minimum(first, last) < _NEAR, of_near, nearer)
            done = enough | (nearer < _FINEST) | touch[pair, way]
            at = pair[done], way[done]
            np.minimum.at(bounds, at, np.maximum(bound[done], 0.0))
            pair, way, begin, first, last = (
                each[~done] for each in (pair, way, begin, first, last)
            )
            width /= 2.0
            middle, _ = self._measure(pair, way, begin + width)
            np.logical_or.at(touch, (pair, way), middle <= 0.0)
            pair, way = np.tile(pair, 2), np.tile(way, 2)
            begin = np.concatenate([begin, begin + width])
            first, last = np.concatenate([[first, middle], [middle, last]], axis=1)
        return bounds

    def _look_inside(self, on_ways, touch_at, touch_on) -> None:
        """One link inside the other touches it, in all frames until surfaces meet.

        Args:
            on_ways, touch_at, touch_on: as of `MeshClearance`; what is found is added
                to the last two.
        """
        decided = self._parted | touch_at
        for row in np.flatnonzero(~decided.all(axis=1)):
            ends = np.flatnonzero(touch_on[row] | (on_ways[row] <= 0.0)) + 1
            for stretch in np.split(np.arange(decided.shape[1]), ends):
                k = int(stretch[0])
                if not decided[row, stretch].any() and self._robot.one_inside(
                    row, self._q[k]
                ):
                    touch_at[row, stretch] = touch_on[row, stretch[:-1]] = True


def _added_up(steps: np.ndarray) -> np.ndarray:
    """(..., T) sums of all steps (..., T - 1) before."""
    return np.cumsum(np.insert(steps, 0, 0.0, axis=-1), axis=-1)


def _spread(low: np.ndarray, high: np.ndarray, L: np.ndarray) -> tuple:
    """Bounds (P, T) of distances, and what those of all other frames say of them: (M1)
    with L (P, T)."""
    low = np.maximum(low, np.maximum.accumulate(low + L, axis=1) - L)
    low = np.maximum(low, _backward(np.maximum, low - L) + L)
    high = np.minimum(high, np.minimum.accumulate(high - L, axis=1) + L)
    return low, np.minimum(high, _backward(np.minimum, high + L) - L)


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
