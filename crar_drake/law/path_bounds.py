"""Bounds of distances on a whole path, (A1)-(A6).

Under q_ddot = -q_dot/T the robot moves on the straight line in joint space from q to
q_s = q + T q_dot: its *braking path*. `docs/theory/theorem.md` has what follows.

That a pair keeps a distance is found for the whole of a path, by bounds and not by
samples: two capsules or convex hulls are at least as far apart as their shadows on any
fixed direction, and how a shadow moves is known to the second order.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.capsule_distances import ShapePairs, nearest_points
from crar_drake.law.compilation import Held, compiled
from crar_drake.law.kinematics import Robot
from crar_drake.law.placed_shapes import distances_at, own_velocities, place_pairs
from crar_drake.law.prediction import next_state
from crar_drake.law.vectors import put, times

# A path is halved so often before a pair that is not shown to be clear counts as not.
# Each halving leaves a quarter of what curvature takes from a part's bound, (A4): seven
# leave less than 1/10,000 of it.
_HALVINGS = 7
# Where a pair is known not to be clear, the worst place is sought among so many halves:
# to a sixteenth of the path, which is all that a row needs to point the right way.
_SEARCHED = 4
# What is wanted of pairs that are not clear: one is enough to know; a place of each, in
# those halves into which its distance falls; the lowest place of each.
FIRST, FALLING, LOWEST = 0, 1, 2
# A distance below the floor by less than this is at the floor [m]: rounding, of doubles
# and robots' sizes, comes nowhere near it.
ROUNDING = 1e-9


class Reaches(NamedTuple):
    """How far each joint can move the shapes of Np pairs; joints as in `Robot.order`.

    Made by `robot.reach.find_reaches`, from the robot's shapes and joints alone. A
    slide between a turning joint and a shape makes the joint's reach longer. So the
    reaches hold while no such slide is farther from its zero than its extent; beyond,
    those of `reaching` do.
    """

    # (Np, nv) rho: of a joint that moves one of the shapes alone, the farthest that
    # this one's axis can be from the joint [m/rad, 1]; 0 of others
    reach: np.ndarray
    above: np.ndarray  # (nv, nv) 1 where joint j carries joint i, i = j not included
    slides: np.ndarray  # (K,) the joints that slide between a turn and a shape
    extents: np.ndarray  # (K,) how far from zero they are at most [m]
    by: np.ndarray  # (K, Np, nv) what a metre of each adds to `reach` [1/rad]


class Bounds(NamedTuple):
    """What `path_bounds` found of k pairs."""

    # (k,) no distance on the path is smaller [m]; what is below the level asked for is
    # a guess
    low: np.ndarray
    # (k,) where on the path, in [0, 1], a pair is not shown to be clear; -1 where it is
    at: np.ndarray
    d: np.ndarray  # (k,) the distance there [m]; minus infinite if it is none (NaN)


@compiled
def reaching(
    start: np.ndarray, x: np.ndarray, bend: np.ndarray, pairs: np.ndarray, of: Reaches
) -> np.ndarray:
    """The reaches of some pairs (k,) that hold on the path that leads from `start` by
    t x + t^2 bend, t from 0 to 1: (k, nv).

    Between its ends a parabola is off its chord by at most |bend| / 4.

    Args:
        start, x, bend: (nv,), (nv,), (nv,) see `path_bounds`.
        pairs: which.
        of: all reaches.
    """
    reach = of.reach[pairs]
    for k in range(len(of.slides)):
        j = of.slides[k]
        end = start[j] + x[j] + bend[j]
        farthest = max(abs(start[j]), abs(end)) + 0.25 * abs(bend[j])
        if farthest > of.extents[k]:
            reach += (farthest - of.extents[k]) * of.by[k][pairs]
    return reach


@compiled
def next_path(
    q: np.ndarray,
    v: np.ndarray,
    s: np.ndarray,
    T: float,
    period: float,
    step: float,
) -> tuple[np.ndarray, np.ndarray]:
    """(A1): q' and T q_dot', one period on, if q_ddot = (s - q_dot)/T is held.

    The next braking path begins at q' (nv,), and leads by T q_dot' (nv,) to q'_s. With
    e = period (period + step) / (2 T), where the plant moves in steps of that length
    by the semi-implicit Euler rule (0: it moves continuously),

        q' = q + (period - e) q_dot + e s,
        q'_s = q + (T - e) q_dot + (period + e) s.

    Args:
        q, v, s: (nv,), (nv,), (nv,) state, and velocity of q_s.
        T: braking horizon [s].
        period: of the controller [s].
        step: of the plant [s], at most the period.
    """
    q_next, v_next = next_state(q, v, (s - v) / T, period, step)
    return q_next, T * v_next


@compiled
def path_curvature(
    x: np.ndarray, moves: np.ndarray, reach: np.ndarray, above: np.ndarray
) -> np.ndarray:
    """(A3): the largest acceleration of a pair's shapes to each other, (k,) [m].

    If all joints move at the constant rates x, a point that joints i carry moves with
    the acceleration sum x_i^2 a_i x (a_i x r_i) + 2 sum_(j above i) x_j x_i a_j x
    (a_i x r_i), r_i from joint i's axis to the point: at most

        sum_i |x_i| rho_i (|x_i| + 2 sum_(j above i) |x_j|),    rho_i >= |a_i x r_i|.

    Seen from what carries both shapes only the joints count that move one alone.

    Args:
        x: (nv,) what each joint moves on the path [rad, m].
        moves: (k, nv) of `ShapePairs`.
        reach: (k, nv) rho.
        above: of `Reaches`.
    """
    # The joints above i that move the shape alone are all above i, less those above
    # the first that does.
    curvature, speed = np.zeros(len(moves)), np.abs(x)
    before, same = times(above, speed), alike(moves)
    joints, own, count = np.empty(len(x), np.int64), np.empty(len(x)), 0
    for k in range(len(moves)):
        if not same[k]:
            count = 0
            for shape in (1.0, -1.0):
                common, begun = np.inf, count
                for i in range(len(x)):
                    if moves[k, i] == shape:
                        joints[count], common = i, min(common, before[i])
                        count += 1
                for j in range(begun, count):
                    own[j] = speed[joints[j]] + 2.0 * (before[joints[j]] - common)
        for j in range(count):
            i = joints[j]
            curvature[k] += reach[k, i] * speed[i] * own[j]
    return curvature


@compiled
def alike(A: np.ndarray) -> np.ndarray:
    """(k,) bool, which rows of A (k, n) are as the one before: the pairs of shapes of
    two links are side by side, and moved by the same joints."""
    found = np.zeros(len(A), np.bool_)
    for k in range(1, len(A)):
        i = 0
        while i < A.shape[1] and A[k, i] == A[k - 1, i]:
            i += 1
        found[k] = i == A.shape[1]
    return found


@compiled
def _shadow(x, y, z, at, first, count, to_vector, V, k, half):
    """How low a moving shape's shadow on n, (x, y, z), begins and ends [m].

    A point's shadow n . p moves at n . (v + w x p) to the first order, so that at t it
    is (n + t n x w) . p + t n . v: that of a resting shape on another direction. From
    `first` on are its `count` corners, or an axis (0); its velocity is V[k]. To hand on
    arrays of these would take longer than all the rest.
    """
    moved = half * (x * V[k, 3] + y * V[k, 4] + z * V[k, 5])
    turned_0 = half * (y * V[k, 2] - z * V[k, 1])
    turned_1 = half * (z * V[k, 0] - x * V[k, 2])
    turned_2 = half * (x * V[k, 1] - y * V[k, 0])
    begins = ends = np.inf
    a = b = c = 0.0
    for i in range(max(count, 2)):
        j = np.uintp(first + (i if count else i * to_vector))
        if count:
            a = b = c = 0.0
        a, b, c = a + at[j, 0], b + at[j, 1], c + at[j, 2]
        here = x * a + y * b + z * c
        more = moved + (turned_0 * a + turned_1 * b + turned_2 * c)
        begins, ends = min(begins, here - more), min(ends, here + more)
    return begins, ends


@compiled
def shadow_gap(
    n: np.ndarray,
    at: np.ndarray,
    pairs: ShapePairs,
    some: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    half: float,
) -> tuple[np.ndarray, np.ndarray]:
    """(A4): how far the shadows of two moving axes or hulls on n are apart, less
    curvature.

    Each corner's shadow n . p moves at n . p_dot to the first order. The gap between
    two shapes, the smallest of the differences of their corners, is then concave in
    time, and smallest where the time begins or ends. A half space that stands still, n
    its normal, has the shadow of its axis, and all of it is behind.

    Args:
        n: (k, 3) unit directions.
        at: (P, 3) points, where the axes start and from there to their ends among
            them [m].
        some: (k,) which pairs.
        a, b: (k, 6) spatial velocities of both shapes about the world's origin, for a
            unit of time.
        half: the time is within [-half, half].

    Returns:
        (k,) bounds from below, to the first order, of where the time begins and of
        where it ends [m].
    """
    begins, ends = np.empty(len(n)), np.empty(len(n))
    hulls, vector = pairs.hulls.value, pairs.to_vector
    after, corners = hulls.after, hulls.corners
    for k in range(len(n)):
        x, y, z, of = n[k, 0], n[k, 1], n[k, 2], np.uintp(some[k])
        first, hull, count = pairs.start_a[of], pairs.hull_a[of], 0
        if hull >= 0:
            first, count = first + after[hull], corners[hull]
        a_0, a_1 = _shadow(x, y, z, at, first, count, vector, a, k, half)
        first, hull, count = pairs.start_b[of], pairs.hull_b[of], 0
        if hull >= 0:
            first, count = first + after[hull], corners[hull]
        # The highest of b along n, as the lowest against it.
        b_0, b_1 = _shadow(-x, -y, -z, at, first, count, vector, b, k, half)
        begins[k], ends[k] = a_0 + b_0, a_1 + b_1
    return begins, ends


@compiled
def path_bounds(
    start: np.ndarray,
    x: np.ndarray,
    bend: np.ndarray,
    rows: np.ndarray,
    level: np.ndarray,
    r: Robot,
    reaches: Held,
    parts: np.ndarray,
    wanted: int,
) -> Bounds:
    """(A5): whether pairs keep a level on the whole path that leads from `start` by
    t x + t^2 bend, t from 0 to 1.

    In the middle of the path, and where that does not say it in the middle of its
    halves and so on, the gap of a pair's shadows on the line of its shortest distance,
    (A4), less curvature times half^2 / 2, bounds all distances of that part. The
    curvature is (A3) of the fastest rates, and rho_i times 2 |bend_i| of each joint.

    A pair that is not decided in the shortest parts, or has no distance (NaN), is not
    clear.

    Args:
        start, x: (nq,), (nv,) where the path begins, and where it leads from there.
        bend: (nv,) and what it leads farther by, as t^2; 0 for a straight one.
        rows: (k,) which of the robot's pairs of shapes.
        level: (k,) distances to be kept [m].
        r: the robot.
        reaches: holds `Reaches` of all its pairs.
        parts: (2^j, k) bool, in which of so many equal parts of the path pairs are not
            known to keep the level; (1, k) for all of it.
        wanted: `FIRST`, `FALLING` or `LOWEST`.
    """
    count = len(rows)
    low, seen = np.full(count, np.inf), np.full(count, np.inf)
    at = np.full(count, -1.0)
    pairs, above = r.pairs.value, reaches.value.above
    reach = reaching(start, x, bend, rows, reaches.value)
    moves = pairs.moves[rows]
    fastest = np.maximum(np.abs(x), np.abs(x + 2.0 * bend))
    curvature = path_curvature(fastest, moves, reach, above)
    curvature += 2.0 * travel(bend, reach)
    points, links = np.zeros((len(r.first), 3)), np.cumsum(~alike(moves))
    open_, begun = parts, round(np.log2(len(parts)))
    for halving in range(begun, _HALVINGS + 1):
        half = 0.5 / len(open_)
        below = np.zeros((2 * len(open_), count), dtype=np.bool_)
        for part in range(len(open_)):
            some = np.flatnonzero(open_[part])
            if not len(some):
                continue
            t = (2 * part + 1) * half
            shapes, moved = rows[some], t * x + (t * t) * bend
            rate = x + (2.0 * t) * bend
            S = place_pairs(points, start + moved, shapes, r)
            d, n, _, _ = nearest_points(points, pairs, shapes)
            a, b = own_velocities(S, rate, moves, links, some)
            begins, ends = shadow_gap(n, points, pairs, shapes, a, b, half)
            for k in range(len(some)):
                pair = some[k]
                radii = pairs.radii[shapes[k]]
                least = min(begins[k], ends[k])
                bound = least - (radii + 0.5 * half * half * curvature[pair])
                if bound >= level[pair]:
                    low[pair] = min(low[pair], bound)
                    continue
                last = halving == _HALVINGS
                there = -np.inf if np.isnan(d[k]) else d[k]
                fails = there < level[pair]
                if fails or last:
                    low[pair] = min(low[pair], there)
                    if at[pair] < 0.0 or there < seen[pair]:
                        at[pair], seen[pair] = t, there
                    if fails and wanted == FIRST:
                        return Bounds(low, at, seen)
                    last = last or halving >= _SEARCHED
                if not last:
                    either = not fails or wanted == LOWEST
                    below[2 * part, pair] = either or begins[k] < ends[k]
                    below[2 * part + 1, pair] = either or not begins[k] < ends[k]
        # Where a pair is known to fail, only the worst place is still of interest.
        if halving >= _SEARCHED:
            for pair in range(count):
                if at[pair] >= 0.0:
                    below[:, pair] = False
        open_ = below
        if not open_.any():
            break
    return Bounds(low, at, seen)


@compiled
def gradients_at(
    start: np.ndarray, x: np.ndarray, rows: np.ndarray, bounds: Bounds, r: Robot
) -> tuple[np.ndarray, np.ndarray]:
    """Eq. (20) of the pairs that are not clear, where they are not: (k,), (k, nv).

    Args:
        rows, r: as in `path_bounds`.

    Returns:
        Which of the rows, and their gradients [m/rad or 1].
    """
    failed = np.flatnonzero(bounds.at >= 0.0)
    g, points = np.zeros((len(failed), len(x))), np.zeros((len(r.first), 3))
    for t in np.unique(bounds.at[failed]):
        some = np.flatnonzero(bounds.at[failed] == t)
        _, found = distances_at(points, start + t * x, rows[failed[some]], r)
        for k in range(len(some)):
            put(g[some[k]], 0, found[k])
    return failed, g


@compiled
def travel(x: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """(A6): how much joints that move by |x_j| can change the distances, (k,) [m].

    Args:
        x: (nv,) [rad, m].
        reach: (k, nv) of `reaching`.
    """
    return times(reach, np.abs(x))
