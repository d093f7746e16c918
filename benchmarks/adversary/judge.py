"""The adversary's judge: whole trajectories at once, in NumPy, and nothing shared.

It reads joints and shapes from the plant, and computes everything else itself: where
the links are, how far watched shapes are apart, and what that violates. Neither the
controller's kinematics and distances nor Drake's take part;
`tests/benchmarks/test_adversary.py` compares it with SceneGraph.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise
from operator import add

import numpy as np
from pydrake.geometry import Box, Capsule, Convex, SceneGraph, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint, RigidBody, WeldJoint
from scipy.spatial import ConvexHull

from crar_drake.errors import ModelError
from crar_drake.robot.description import LIMIT_TOLERANCE, find_body

SPEED_TOLERANCE = 1e-6  # share of a speed limit that rounding may exceed it by
STRIDE = 4e-3  # [m] that a shape's ends move at most between two points of a path,
PATH_POINTS = 80  # of a start's braking path
FEWEST, MOST = 8, 500  # but so many points at least, and at most.
COARSE = 3  # points of every braking path; the paths of those
NEAREST = 8  # states whose distance there is the smallest are sampled, too.
DISTANCE_TOLERANCE = 1e-6  # [m] below the floor that counts as at it
CHUNK = 512  # configurations at a time, so that arrays stay in the caches

# Axes whose sine is below this have their distance at an end of one of them.
_PARALLEL = 1e-6


# How figures of several episodes become one; of all others it is the sum.
_OF_SEVERAL = {
    **dict.fromkeys(("clearance", "path_clearance"), min),
    **dict.fromkeys(("excess", "overspeed", "acceleration", "slip"), max),
    "admitted": lambda mine, its: list(map(add, mine, its)),
}


@dataclass
class Counts:
    """What trajectories violate.

    Attributes:
        states: how many were judged.
        penetrating: states with a pair at d < 0.
        below: states with a pair nearer than the floor that the law vouches for.
        beyond_limit: states with a controlled joint beyond its limit.
        too_fast: states with a controlled joint faster than its speed limit.
        ahead: control steps whose braking path ends with a joint beyond its limit.
        paths: braking paths, and ways from state to state, that were sampled.
        blocked: those of them on which a pair is nearer than that floor.
        clearance: the smallest distance at a state [m].
        path_clearance: the same on the sampled paths.
        excess: the farthest beyond a limit, on paths too [rad or m].
        overspeed: the largest |v| over its limit; 0 where nothing has one.
    """

    states: int = 0
    penetrating: int = 0
    below: int = 0
    beyond_limit: int = 0
    too_fast: int = 0
    ahead: int = 0
    paths: int = 0
    blocked: int = 0
    clearance: float = np.inf
    path_clearance: float = np.inf
    excess: float = 0.0
    overspeed: float = 0.0

    @property
    def unsafe(self) -> bool:
        """Whether a pair or a joint limit is violated, at a state or on a path."""
        return bool(self.below + self.beyond_limit + self.ahead + self.blocked)

    def add(self, other: object, names: Iterable[str] = ()) -> None:
        """Takes others in: sums, and the worst of distances, excess and speed.

        Args:
            other: has the figures.
            names: of them; by default those of the class of `other`, a dataclass, that
                this has, too.
        """
        mine = {f.name for f in fields(self)}
        for name in names or [f.name for f in fields(other) if f.name in mine]:
            of_both = getattr(self, name), getattr(other, name)
            setattr(self, name, _OF_SEVERAL.get(name, add)(*of_both))


@dataclass
class Verdict(Counts):
    """What a trajectory violates, and where.

    Attributes:
        pair, path_pair: those of the smallest distances.
        joint: that of the largest excess.
        first: the first state that violates anything but speed; None if none does.
    """

    pair: str = ""
    path_pair: str = ""
    joint: str = ""
    first: int | None = None

    @property
    def violated(self) -> bool:
        """Whether anything is violated, speed limits included."""
        return self.unsafe or self.too_fast > 0


@dataclass(frozen=True)
class _Joint:
    """How a body hangs on another: X_PC(q) = before * motion(q) * after."""

    parent: int
    child: int
    before: tuple[np.ndarray, np.ndarray]  # (3, 3), (3,)
    after: tuple[np.ndarray, np.ndarray]
    column: int  # of q; -1 for a weld
    axis: np.ndarray  # (3,) in the frame on the parent
    turns: bool


@dataclass
class _Shapes:
    """All watched shapes, in their bodies' frames; a box or a convex piece has its
    middle for an axis."""

    body: list[int] = field(default_factory=list)
    start: list[np.ndarray] = field(default_factory=list)
    end: list[np.ndarray] = field(default_factory=list)
    radius: list[float] = field(default_factory=list)
    turn: list[np.ndarray] = field(default_factory=list)
    half: list[np.ndarray] = field(default_factory=list)  # edges of a box; else 0
    corners: list[np.ndarray] = field(default_factory=list)  # (V, 3) of a convex piece,
    # from its middle; else none


class Judge:
    """Judges configurations and states of a plant whose joints have one position each.

    Attributes:
        pair_names: per shape pair "link a - link b".
        controlled: columns of q and v that limits count for.
        joint_names: their joints.
        lower, upper, fastest: (n,) their limits [rad, rad/s], infinite if none.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        pairs: Sequence[Sequence[str]],
        prescribed: Sequence[str] = (),
    ) -> None:
        """
        Args:
            plant: finalized.
            scene_graph: where it is registered.
            pairs: watched links, two each.
            prescribed: joints whose limits do not count.

        Raises:
            ModelError: a joint has several positions, or a watched shape is neither a
                capsule nor a sphere nor a box nor a convex piece; or such a piece is
                watched against anything but capsules and spheres.
        """
        self._joints = _read_joints(plant)
        shapes, of_body = _Shapes(), {}
        for name in (name for pair in pairs for name in pair):
            if name not in of_body:
                of_body[name] = _read_shapes(
                    plant, scene_graph, find_body(plant, name), shapes
                )
        together = [
            (a, b, f"{first} - {second}")
            for first, second in pairs
            for a in of_body[first]
            for b in of_body[second]
        ]
        self.pair_names = [name for _, _, name in together]
        self._a = np.array([a for a, _, _ in together], dtype=int)
        self._b = np.array([b for _, b, _ in together], dtype=int)
        self._body = np.array(shapes.body, dtype=int)
        self._start = np.array(shapes.start).reshape(-1, 3)
        self._end = np.array(shapes.end).reshape(-1, 3)
        self._radius = np.array(shapes.radius)
        self._turn = np.array(shapes.turn).reshape(-1, 3, 3)
        self._half = np.array(shapes.half).reshape(-1, 3)
        self._is_box = self._half.any(axis=1)
        self._triangles = {
            k: corners[ConvexHull(corners).simplices]
            for k, corners in enumerate(shapes.corners)
            if len(corners)
        }
        self._is_hull = np.isin(np.arange(len(shapes.body)), list(self._triangles))
        solid = self._is_box | self._is_hull
        if (
            solid[self._a]
            & solid[self._b]
            & (self._is_hull[self._a] | self._is_hull[self._b])
        ).any():
            raise ModelError(
                "a convex piece is watched against a box or another one: the judge "
                "knows its distance to capsules and spheres alone"
            )
        ball = 0.5 * np.linalg.norm(self._end - self._start, axis=1) + self._radius
        ball += np.linalg.norm(self._half, axis=1)
        for k, corners in enumerate(shapes.corners):
            ball[k] += np.linalg.norm(corners, axis=1).max(initial=0.0)
        self._radii = self._radius[self._a] + self._radius[self._b]
        self._balls = ball[self._a] + ball[self._b]
        self._num_bodies = plant.num_bodies()
        self.controlled, self.joint_names = _columns(plant, prescribed)
        c = self.controlled
        self.lower = plant.GetPositionLowerLimits()[c]
        self.upper = plant.GetPositionUpperLimits()[c]
        self.fastest = np.minimum(
            plant.GetVelocityUpperLimits(), -plant.GetVelocityLowerLimits()
        )[c]

    def axes(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ends of all watched axes in the world, (T, A, 3) each [m], for q (T, nq)."""
        return self._placed(np.asarray(q, dtype=float))[:2]

    def _placed(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same, and rotations (T, A, 3, 3) of boxes and pieces (others have
        none)."""
        T = len(q)
        R = np.zeros((self._num_bodies, T, 3, 3))
        p = np.zeros((self._num_bodies, T, 3))
        R[0] = np.eye(3)
        for joint in self._joints:
            (R_before, p_before), (R_after, p_after) = joint.before, joint.after
            R_P, p_P = R[joint.parent], p[joint.parent]
            R_F = R_P @ R_before
            p_F = p_P + R_P @ p_before
            if joint.column >= 0:
                x = q[:, joint.column]
                if joint.turns:
                    R_F = R_F @ _rotations(joint.axis, x)
                else:
                    p_F = p_F + (R_F @ joint.axis) * x[:, None]
            p[joint.child] = p_F + R_F @ p_after
            R[joint.child] = R_F @ R_after
        start = np.empty((T, len(self._body), 3))
        end = np.empty_like(start)
        for k, body in enumerate(self._body):
            start[:, k] = p[body] + R[body] @ self._start[k]
            end[:, k] = p[body] + R[body] @ self._end[k]
        solid = np.flatnonzero(self._is_box | self._is_hull)
        turned = np.zeros((T, len(self._body) if len(solid) else 0, 3, 3))
        for k in solid:
            turned[:, k] = R[self._body[k]] @ self._turn[k]
        return start, end, turned

    def distances(self, q: np.ndarray) -> np.ndarray:
        """(T, N) signed distance of every watched shape pair [m], for q (T, nq)."""
        placed = self._placed(np.asarray(q, dtype=float))
        row, column = np.indices((len(q), len(self._a))).reshape(2, -1)
        return self._exact(placed, row, column).reshape(len(q), -1)

    def nearest(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The smallest distance (T,) [m] of each configuration, and its shape pair.

        Exact: a shape pair is left out only where its enclosing balls are farther
        apart than the distance of another pair.
        """
        q = np.asarray(q, dtype=float)
        d, pair = np.full(len(q), np.inf), np.zeros(len(q), dtype=int)
        if len(self._a):
            for low in range(0, len(q), CHUNK):
                part = slice(low, low + CHUNK)
                d[part], pair[part] = self._nearest(q[part])
        return d, pair

    def _nearest(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        placed = self._placed(q)
        middle = 0.5 * (placed[0] + placed[1])
        apart = middle[:, self._a] - middle[:, self._b]
        bound = np.sqrt(np.einsum("tni,tni->tn", apart, apart)) - self._balls
        rows = np.arange(len(q))
        guess = bound.argmin(axis=1)
        best = self._exact(placed, rows, guess)
        row, column = np.nonzero(bound <= best[:, None])
        d = self._exact(placed, row, column)
        table = np.full(bound.shape, np.inf)
        table[row, column] = d
        pair = table.argmin(axis=1)
        return table[rows, pair], pair

    def _exact(self, placed, row, column) -> np.ndarray:
        """Distances of some pairs (columns) at some configurations (rows)."""
        start, end, turned = placed
        a, b = self._a[column], self._b[column]
        d = segment_distances(start[row, a], end[row, a], start[row, b], end[row, b])
        d -= self._radii[column]
        k = np.flatnonzero(self._is_box[a] & self._is_box[b])
        if len(k):
            both = (
                (start[row[k], x[k]], turned[row[k], x[k]], self._half[x[k]])
                for x in (a, b)
            )
            d[k] = box_distances(*both)
        for box, other in ((a, b), (b, a)):
            k = np.flatnonzero(self._is_box[box] & ~self._is_box[other])
            at, i, j = row[k], box[k], other[k]
            if len(k):
                ends = (
                    np.einsum("nji,nj->ni", turned[at, i], x[at, j] - start[at, i])
                    for x in (start, end)
                )
                d[k] = segments_to_boxes(*ends, self._half[i]) - self._radius[j]
            for i, triangles in self._triangles.items():
                k = np.flatnonzero(box == i)
                at, j = row[k], other[k]
                if len(k):
                    ends = (
                        np.einsum("nji,nj->ni", turned[at, i], x[at, j] - start[at, i])
                        for x in (start, end)
                    )
                    d[k] = segments_to_hull(*ends, triangles) - self._radius[j]
        return d

    def excess(self, q: np.ndarray) -> np.ndarray:
        """(T, n) by how much controlled joints are beyond their limits, 0 within."""
        x = q[:, self.controlled]
        return np.maximum(0.0, np.maximum(self.lower - x, x - self.upper))

    def path_is_clear(
        self, q: np.ndarray, v: np.ndarray, horizon: float, margin: float = 0.0
    ) -> bool:
        """Whether braking from a state (nq,), (nv,) keeps `margin` [m], and limits."""
        path = q + np.linspace(0.0, horizon, PATH_POINTS)[:, None] * v
        within = self.excess(path).max(initial=0.0) == 0.0
        slow = np.all(np.abs(v[self.controlled]) <= self.fastest)
        return bool(within and slow and self.nearest(path)[0].min() >= margin)

    def judge(
        self,
        q: np.ndarray,
        v: np.ndarray,
        horizon: float | np.ndarray,
        rng: np.random.Generator,
        share: float = 0.02,
        per_step: int = 1,
        floor: float = 0.0,
    ) -> Verdict:
        """Judges a trajectory.

        Where a braking path ends is judged at control steps, where it is claimed to be
        clear. In between it may bulge by |q_ddot| period^2 / 8 beyond both ends; the
        robot does not go there, for at the next control step it is back. A joint that
        starts beyond its limit may stay there, and come back, but go no farther.

        Args:
            q, v: (K + 1, nq), (K + 1, nv) states.
            horizon: T of braking [s], or (K + 1,) of each state.
            rng: chooses the states whose paths are sampled.
            share: of the control steps; those are added that are nearest to a contact,
                there or at a few places of their braking path.
            per_step: states a control step.
            floor: that pairs are to keep [m], but where the start's braking path does
                not, which is then the floor.
        """
        horizon = np.broadcast_to(horizon, len(q))
        with np.errstate(all="ignore"):
            d, pair = self.nearest(q)
            here, there = self._farther(q, v, horizon, per_step)
            rates = np.abs(v[:, self.controlled]) / self.fastest
        beyond = (here > LIMIT_TOLERANCE).any(axis=1)
        ahead = (there > LIMIT_TOLERANCE).any(axis=1)
        fast = (rates > 1.0 + SPEED_TOLERANCE).any(axis=1)
        coarse = self._coarse_paths(q[::per_step], v[::per_step], horizon[::per_step])
        chosen = np.unique(
            np.concatenate(
                [
                    np.flatnonzero(rng.random(len(there)) < share),
                    np.argsort(d[::per_step], kind="stable")[:3],
                    np.argsort(coarse, kind="stable")[:NEAREST],
                ]
            )
        )
        chosen *= per_step
        path_d, path_pair = self._sampled_paths(q, v, horizon, chosen)
        if v[0].any():
            first = np.linspace(0.0, horizon[0], 2000)[:, None] * v[0]
            floor = min(floor, self.nearest(q[0] + first)[0].min())
        floor = min(floor, d[0]) - DISTANCE_TOLERANCE
        k, j = int(d.argmin()), int(path_d.argmin())
        worst = here if here.max() >= there.max() else there
        joint = int(worst.max(axis=0).argmax())
        bad = (d < floor) | beyond
        bad[::per_step] |= ahead
        bad[chosen] |= path_d < floor
        return Verdict(
            states=len(q),
            penetrating=int((d < 0.0).sum()),
            below=int((d < floor).sum()),
            beyond_limit=int(beyond.sum()),
            too_fast=int(fast.sum()),
            ahead=int(ahead.sum()),
            paths=len(chosen),
            blocked=int((path_d < floor).sum()),
            clearance=float(d[k]),
            pair=self._name(pair[k]),
            path_clearance=float(path_d[j]),
            path_pair=self._name(path_pair[j]),
            excess=float(worst.max()),
            joint=self.joint_names[joint] if worst.max() > 0.0 else "",
            overspeed=float(rates.max()),
            first=int(bad.argmax()) if bad.any() else None,
        )

    def _farther(self, q, v, horizon, per_step) -> tuple[np.ndarray, np.ndarray]:
        """By how much joints are beyond their limits, and beyond the least that they
        were before: (K + 1, n) at states, and (K' + 1, n) where braking paths end."""
        x = q[:, self.controlled]
        steps = slice(None, None, per_step)
        rest = x[steps] + horizon[steps, None] * v[steps][:, self.controlled]
        far = []
        for sign, limit in ((1.0, self.upper), (-1.0, -self.lower)):
            reached = np.maximum(sign * x[steps], sign * rest)
            least = np.minimum.accumulate(reached, axis=0)
            allowed = np.maximum(limit, np.concatenate([reached[:1], least[:-1]]))
            every = np.repeat(allowed, per_step, axis=0)[: len(x)]
            far.append((sign * x - every, sign * rest - allowed))
        return tuple(
            np.maximum(0.0, np.maximum(*each)) for each in zip(*far, strict=True)
        )

    def _coarse_paths(self, q, v, horizon) -> np.ndarray:
        """Per state the smallest distance at a few places of its braking path."""
        shares = np.linspace(0.0, 1.0, COARSE + 1)[1:, None]
        path = q[:, None] + shares * (horizon[:, None] * v)[:, None]
        d, _ = self.nearest(path.reshape(-1, q.shape[1]))
        return d.reshape(len(q), -1).min(axis=1)

    def _sampled_paths(self, q, v, horizon, chosen) -> tuple[np.ndarray, np.ndarray]:
        """Per chosen state the smallest distance on its braking path and on the way
        to the next state, and the shape pair."""
        following = q[np.minimum(chosen + 1, len(q) - 1)]
        points, owner = [], []
        for k, k_next in zip(chosen, following, strict=True):
            for way in (horizon[k] * v[k], k_next - q[k]):
                ends = np.array(
                    self.axes(q[k] + np.linspace(0.0, 1.0, 9)[:, None] * way)
                )
                length = np.linalg.norm(np.diff(ends, axis=1), axis=3).sum(axis=1)
                count = int(np.clip(length.max(initial=0.0) / STRIDE, FEWEST, MOST))
                points.append(q[k] + np.linspace(0.0, 1.0, count)[:, None] * way)
                owner.append(np.full(count, len(owner) // 2))
        d, pair = self.nearest(np.concatenate(points))
        edges = np.searchsorted(np.concatenate(owner), np.arange(len(chosen) + 1))
        at = [low + d[low:high].argmin() for low, high in pairwise(edges)]
        return d[at], pair[at]

    def _name(self, pair: int) -> str:
        return self.pair_names[pair] if self.pair_names else ""


def segment_distances(
    a0: np.ndarray, a1: np.ndarray, b0: np.ndarray, b1: np.ndarray
) -> np.ndarray:
    """Distances (N,) of segments a0 a1 and b0 b1, (N, 3) ends each.

    The smallest of five candidates: each end against the other segment, and the
    common normal of both lines where it meets both of them inside.
    """
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    squared = np.minimum(
        np.minimum(_point_to_segment(a0, b0, v), _point_to_segment(a1, b0, v)),
        np.minimum(_point_to_segment(b0, a0, u), _point_to_segment(b1, a0, u)),
    )
    normal = np.cross(u, v)
    length = np.einsum("ni,ni->n", normal, normal)
    sizes = np.einsum("ni,ni->n", u, u) * np.einsum("ni,ni->n", v, v)
    crossing = length > _PARALLEL**2 * sizes
    per_length = np.divide(1.0, length, out=np.zeros_like(length), where=crossing)
    s = np.einsum("ni,ni->n", np.cross(v, w), normal) * per_length
    t = np.einsum("ni,ni->n", np.cross(u, w), normal) * per_length
    inside = crossing & (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
    across = np.einsum("ni,ni->n", w, normal) ** 2 * per_length
    return np.sqrt(np.where(inside, np.minimum(across, squared), squared))


def segments_to_boxes(p0: np.ndarray, p1: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Distances (N,) of segments p0 p1 (N, 3) in boxes' frames from boxes +-half.

    The slope of the squared distance along a segment is piecewise linear and grows; it
    bends where the segment enters or leaves the slab between two faces.
    """
    way = p1 - p0
    with np.errstate(divide="ignore", invalid="ignore"):
        bends = np.concatenate([(half - p0) / way, (-half - p0) / way], axis=1)
    t = np.clip(np.nan_to_num(bends), 0.0, 1.0)
    t = np.sort(np.concatenate([t, np.zeros((len(t), 1)), np.ones((len(t), 1))], 1), 1)

    def outside(t: np.ndarray) -> np.ndarray:
        x = p0[:, None] + t[:, :, None] * way[:, None]
        return x - np.clip(x, -half[:, None], half[:, None])

    slope = np.einsum("nki,ni->nk", outside(t), way)
    high = np.where((slope >= 0.0).any(axis=1), (slope >= 0.0).argmax(axis=1), 7)
    low, rows = np.maximum(high - 1, 0), np.arange(len(t))
    rise = slope[rows, high] - slope[rows, low]
    share = np.divide(-slope[rows, low], rise, out=np.zeros(len(t)), where=rise > 0.0)
    start, end = t[rows, low], t[rows, high]
    best = start + np.clip(share, 0.0, 1.0) * (end - start)
    best = np.where(slope[rows, high] < 0.0, 1.0, best)
    return np.linalg.norm(outside(best[:, None])[:, 0], axis=1)


def segments_to_hull(
    p0: np.ndarray, p1: np.ndarray, triangles: np.ndarray
) -> np.ndarray:
    """Distances (N,) of segments p0 p1 (N, 3) from a hull of F triangles (F, 3, 3); 0
    where they meet.

    Of each triangle: its sides against the segment, and what is straight above it of
    the ends. A segment that meets the hull passes through a triangle, or is inside.
    """
    d = np.full(len(p0), np.inf)
    inside = np.ones(len(p0), dtype=bool)
    middle = triangles.mean(axis=(0, 1))
    for a, b, c in triangles:
        n = np.cross(b - a, c - a)
        n *= np.sign(n @ (a - middle)) / np.linalg.norm(n)
        high_0, high_1 = (p0 - a) @ n, (p1 - a) @ n
        inside &= high_0 <= 0.0
        for start, end in ((a, b), (b, c), (c, a)):
            both = np.broadcast_to(start, p0.shape), np.broadcast_to(end, p0.shape)
            d = np.minimum(d, segment_distances(p0, p1, *both))
        for p, high in ((p0, high_0), (p1, high_1)):
            over = _straight_above(p, a, b, c)
            d = np.where(over, np.minimum(d, np.abs(high)), d)
        crosses = high_0 * high_1 <= 0.0
        drop = np.where(crosses, high_0 - high_1, 1.0)
        share = np.divide(high_0, drop, out=np.zeros(len(p0)), where=drop != 0.0)
        crosses &= _straight_above(p0 + share[:, None] * (p1 - p0), a, b, c)
        d[crosses] = 0.0
    d[inside] = 0.0
    return d


def _straight_above(p: np.ndarray, a, b, c) -> np.ndarray:
    """(N,) whether points are above or below a triangle."""
    e, f = b - a, c - a
    n = np.cross(e, f)
    s = np.cross(p - a, f) @ n
    t = np.cross(e, p - a) @ n
    return (s >= 0.0) & (t >= 0.0) & (s + t <= n @ n)


_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
_EDGES = np.array([(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit])


def box_distances(first: tuple, second: tuple) -> np.ndarray:
    """Distances (N,) of boxes: middles (N, 3), rotations (N, 3, 3), half edges (N, 3).

    Apart, an edge of one of them ends the shortest way; together, it is minus the
    least that parts them along a normal of a face or of two edges.
    """
    least = []
    for (p, R, half), (p_other, R_other, half_other) in (
        (first, second),
        (second, first),
    ):
        corners = np.einsum("nij,nkj->nki", R_other, _CORNERS * half_other[:, None])
        corners = np.einsum("nji,nkj->nki", R, corners + (p_other - p)[:, None])
        ends = corners[:, _EDGES].reshape(-1, 2, 3)
        d = segments_to_boxes(ends[:, 0], ends[:, 1], np.repeat(half, 12, axis=0))
        least.append(d.reshape(-1, 12).min(axis=1))
    apart = np.minimum(*least)
    (p, R, half), (p_other, R_other, half_other) = first, second
    A, B = R.swapaxes(1, 2), R_other.swapaxes(1, 2)  # their rows are the axes
    across = np.cross(A[:, :, None], B[:, None]).reshape(-1, 9, 3)
    normals = np.concatenate([A, B, across], axis=1)
    lengths = np.linalg.norm(normals, axis=2, keepdims=True)
    # A pair of edges in line says nothing that the faces do not.
    normals = np.where(lengths > _PARALLEL, normals, A[:, :1])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    gaps = np.abs(np.einsum("nki,ni->nk", normals, p_other - p))
    for turn, size in ((R, half), (R_other, half_other)):
        gaps -= np.einsum("nkj,nj->nk", np.abs(normals @ turn), size)
    return np.where(apart > 0.0, apart, gaps.max(axis=1))


def _point_to_segment(x, start, along) -> np.ndarray:
    """Squared distances (N,) of points to segments."""
    from_start = x - start
    length = np.einsum("ni,ni->n", along, along)
    share = np.divide(
        np.einsum("ni,ni->n", from_start, along),
        length,
        out=np.zeros_like(length),
        where=length > 0.0,
    )
    gap = from_start - np.clip(share, 0.0, 1.0)[:, None] * along
    return np.einsum("ni,ni->n", gap, gap)


def _rotations(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(T, 3, 3) rotations about a unit axis: Rodrigues' formula."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + s * K + (1.0 - c) * (K @ K)


def _parts(X: RigidTransform) -> tuple[np.ndarray, np.ndarray]:
    return X.rotation().matrix(), X.translation()


def _read_joints(plant: MultibodyPlant) -> list[_Joint]:
    """All joints, those of the world's children first."""
    waiting = [plant.get_joint(index) for index in plant.GetJointIndices()]
    known, joints = {0}, []
    while waiting:
        ready = [j for j in waiting if int(j.parent_body().index()) in known]
        if not ready:
            names = ", ".join(j.name() for j in waiting)
            raise ModelError(f"these joints do not hang on the world: {names}")
        for joint in ready:
            waiting.remove(joint)
            known.add(int(joint.child_body().index()))
            column, axis, turns = -1, np.zeros(3), False
            if isinstance(joint, RevoluteJoint):
                column, turns = joint.position_start(), True
                axis = joint.revolute_axis()
            elif isinstance(joint, PrismaticJoint):
                column, axis = joint.position_start(), joint.translation_axis()
            elif not isinstance(joint, WeldJoint):
                raise ModelError(
                    f"joint {joint.name()!r} is a {type(joint).__name__}; the judge "
                    "knows revolute, prismatic and fixed ones"
                )
            after = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
            if column < 0:
                after = joint.X_FM().multiply(after)
            joints.append(
                _Joint(
                    int(joint.parent_body().index()),
                    int(joint.child_body().index()),
                    _parts(joint.frame_on_parent().GetFixedPoseInBodyFrame()),
                    _parts(after),
                    column,
                    np.asarray(axis, dtype=float),
                    turns,
                )
            )
    return joints


def _read_shapes(
    plant: MultibodyPlant, scene_graph: SceneGraph, body: RigidBody, shapes: _Shapes
) -> range:
    """Adds the shapes of a body, and returns their numbers."""
    inspector = scene_graph.model_inspector()
    first = len(shapes.body)
    for geometry in plant.GetCollisionGeometriesForBody(body):
        shape = inspector.GetShape(geometry)
        if not isinstance(shape, (Capsule, Sphere, Box, Convex)):
            raise ModelError(
                f"link {body.name()!r} has a {type(shape).__name__}; the judge knows "
                "capsules, spheres, boxes and convex pieces"
            )
        is_box, corners = isinstance(shape, Box), np.zeros((0, 3))
        half = 0.5 * shape.length() if isinstance(shape, Capsule) else 0.0
        R, p = _parts(inspector.GetPoseInFrame(geometry))
        if isinstance(shape, Convex):
            hull = shape.GetConvexHull()
            corners = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
            middle = corners.mean(axis=0)
            corners, p = corners - middle, p + R @ middle
        shapes.body.append(int(body.index()))
        shapes.start.append(p - half * R[:, 2])
        shapes.end.append(p + half * R[:, 2])
        shapes.radius.append(0.0 if is_box or len(corners) else shape.radius())
        shapes.corners.append(corners)
        shapes.turn.append(R)
        shapes.half.append(0.5 * shape.size() if is_box else np.zeros(3))
    return range(first, len(shapes.body))


def _columns(
    plant: MultibodyPlant, prescribed: Sequence[str]
) -> tuple[np.ndarray, list[str]]:
    """Columns of q of the joints that are not prescribed, and the joints' names."""
    found = {}
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        if joint.num_positions() and joint.name() not in prescribed:
            found[joint.position_start()] = joint.name()
    columns = sorted(found)
    return np.array(columns, dtype=int), [found[c] for c in columns]
