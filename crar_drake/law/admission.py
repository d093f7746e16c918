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
from crar_drake.law.compilation import Held, compiled, hold
from crar_drake.law.hull_distances import corners_of, shadow_rates
from crar_drake.law.kinematics import Robot
from crar_drake.law.placed_shapes import distances_at, own_velocities, place_pairs
from crar_drake.law.prediction import next_state
from crar_drake.law.vectors import put, put_at, transposed_times

# A path is halved so often before a pair that is not shown to be clear counts as not.
# Each halving leaves a quarter of what curvature takes from a part's bound, (A4): seven
# leave less than 1/10,000 of it.
_HALVINGS = 7
# Where a pair is known not to be clear, the worst place is sought among so many halves:
# to a sixteenth of the path, which is all that a row needs to point the right way.
_SEARCHED = 4
# A distance below the floor by less than this is at the floor [m]: rounding, of doubles
# and robots' sizes, comes nowhere near it.
ROUNDING = 1e-9


class Reaches(NamedTuple):
    """How far each joint can move the shapes of pairs; joints as in `Robot.order`.

    Of Np pairs, Np' are looked at: all, or some (`nearby.some_reaches`).

    Made by `robot.reach.find_reaches`, from the robot's shapes and joints alone. A
    slide between a turning joint and a shape makes the joint's reach longer. So the
    reaches hold while no such slide is farther from its zero than its extent; beyond,
    those of `reaching` do.
    """

    a_alone: np.ndarray  # (Np, nv) 1 where a joint moves the pair's first shape alone
    b_alone: np.ndarray  # (Np, nv) and its second
    a: np.ndarray  # (Np, nv) farthest that a's axis can be from the joint's [m/rad, 1]
    b: np.ndarray  # (Np, nv) both 0 where the joint does not move the shape alone
    farthest: np.ndarray  # (nv, Np') a + b
    above: np.ndarray  # (nv, nv) 1 where joint j carries joint i, i = j not included
    own: np.ndarray  # (Np',) the row of each pair among those above
    slides: np.ndarray  # (K,) the joints that slide between a turn and a shape
    extents: np.ndarray  # (K,) how far from zero they are at most [m]
    a_by: np.ndarray  # (K, Np, nv) what a metre of each adds to `a` [1/rad]
    b_by: np.ndarray  # (K, Np, nv) and to `b`


class Bounds(NamedTuple):
    """What `path_bounds` found of Np pairs."""

    # (Np,) no distance on the path is smaller [m]; what is below the level asked for is
    # a guess; infinite where nobody asks
    low: np.ndarray
    # (Np,) where on the path, in [0, 1], a pair is not shown to be clear; -1 where it
    # is, or nobody asks
    at: np.ndarray
    d: np.ndarray  # (Np,) the distance there [m]; minus infinite if it is none (NaN)


@compiled
def reaching(start: np.ndarray, x: np.ndarray, bend: np.ndarray, reaches: Held) -> Held:
    """Holds `Reaches` that hold on the path that leads from `start` by t x + t^2 bend,
    t from 0 to 1: the given ones where no slide leaves its extents.

    Between its ends a parabola is off its chord by at most |bend| / 4.

    Args:
        start, x, bend: (nv,), (nv,), (nv,) see `path_bounds`.
        reaches: holds `Reaches`.
    """
    of = reaches.value
    if not len(of.slides):
        return reaches
    extents = of.extents.copy()
    for k in range(len(extents)):
        j = of.slides[k]
        end = start[j] + x[j] + bend[j]
        farthest = max(abs(start[j]), abs(end)) + 0.25 * abs(bend[j])
        extents[k] = max(extents[k], farthest)
    if (extents == of.extents).all():
        return reaches
    return extended(extents, reaches)


@compiled
def extended(extents: np.ndarray, reaches: Held) -> Held:
    """Holds `Reaches` for slides that are farther from zero, (K,) [m]."""
    of = reaches.value
    a, b = of.a.copy(), of.b.copy()
    for k in range(len(extents)):
        a += (extents[k] - of.extents[k]) * of.a_by[k]
        b += (extents[k] - of.extents[k]) * of.b_by[k]
    farthest = np.ascontiguousarray((a + b)[of.own].T)
    return hold(
        Reaches(
            of.a_alone,
            of.b_alone,
            a,
            b,
            farthest,
            of.above,
            of.own,
            of.slides,
            extents,
            of.a_by,
            of.b_by,
        )
    )


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
def velocity_bounds(
    q: np.ndarray,
    v: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    fastest: np.ndarray,
    T: float,
    period: float,
    step: float,
) -> tuple[np.ndarray, np.ndarray]:
    """(A2): the s that keep q'_s within the joint limits and q_dot' within the speeds.

    Limits that the braking path passes already count as where it ends, speeds that
    are exceeded as what braking leaves of them: s = 0 is always among these.

    Args:
        q, v: (n,) state of the controlled joints.
        lower, upper: (n,) limits [rad], infinite where there is none.
        fastest: (n,) speed limits [rad/s], infinite where there is none.
        T, period, step: see `next_path`.

    Returns:
        (n,), (n,) smallest and largest s, of either sign [rad/s].
    """
    e = 0.5 * period * (period + step) / T
    ends = q + T * v
    lower = np.minimum(lower, np.minimum(q, ends))
    upper = np.maximum(upper, np.maximum(q, ends))
    base = q + (T - e) * v
    fastest = np.maximum(fastest, np.abs(v) * (1.0 - period / T))
    per_speed = T / period
    low = np.maximum((lower - base) / (period + e), v - per_speed * (fastest + v))
    high = np.minimum((upper - base) / (period + e), v + per_speed * (fastest - v))
    return np.minimum(low, 0.0), np.maximum(high, 0.0)


@compiled
def path_curvature(x: np.ndarray, pairs: np.ndarray, reaches: Reaches) -> np.ndarray:
    """(A3): the largest acceleration of a pair's shapes to each other, (k,) [m].

    If all joints move at the constant rates x, a point that joints i carry moves with
    the acceleration sum x_i^2 a_i x (a_i x r_i) + 2 sum_(j above i) x_j x_i a_j x
    (a_i x r_i), r_i from joint i's axis to the point: at most

        sum_i |x_i| rho_i (|x_i| + 2 sum_(j above i) |x_j|),    rho_i >= |a_i x r_i|.

    Seen from what carries both shapes only the joints count that move one alone.

    Args:
        x: (nv,) what each joint moves on the path [rad, m].
        pairs: (k,) which.
    """
    curvature = np.empty(len(pairs))
    of_shape = np.empty(2)
    own = np.empty(len(x), dtype=np.int64)  # the joints that move the shape alone
    for k in range(len(pairs)):
        pair = reaches.own[pairs[k]]
        for shape in range(2):
            alone = reaches.b_alone[pair] if shape else reaches.a_alone[pair]
            rho = reaches.b[pair] if shape else reaches.a[pair]
            count = 0
            for j in range(len(x)):
                if alone[j] != 0.0:
                    own[count] = j
                    count += 1
            of_shape[shape] = 0.0
            for i in range(len(x)):
                if rho[i] == 0.0:
                    continue
                before = 0.0
                for j in own[:count]:
                    before += abs(x[j]) * reaches.above[i, j]
                of_shape[shape] += rho[i] * abs(x[i]) * (abs(x[i]) + 2.0 * before)
        curvature[k] = of_shape[0] + of_shape[1]
    return curvature


@compiled
def _end_shadows(n, p, u, a, half):
    """Of one segment of (A4): the shadows of both ends, and what they move by."""
    w_0, w_1, w_2 = a[0], a[1], a[2]
    start = n[0] * p[0] + n[1] * p[1] + n[2] * p[2]
    along = n[0] * u[0] + n[1] * u[1] + n[2] * u[2]
    moves = half * (
        n[0] * (a[3] + (w_1 * p[2] - w_2 * p[1]))
        + n[1] * (a[4] + (w_2 * p[0] - w_0 * p[2]))
        + n[2] * (a[5] + (w_0 * p[1] - w_1 * p[0]))
    )
    turns = half * (
        n[0] * (w_1 * u[2] - w_2 * u[1])
        + n[1] * (w_2 * u[0] - w_0 * u[2])
        + n[2] * (w_0 * u[1] - w_1 * u[0])
    )
    return start, start + along, moves, moves + turns


@compiled
def shadow_gap(
    n: np.ndarray,
    at: np.ndarray,
    pairs: ShapePairs,
    some: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    half: float,
) -> np.ndarray:
    """(A4): how far the shadows of two moving segments on n are apart, less curvature.

    Each end's shadow n . p moves at n . p_dot to the first order. The gap between two
    segments, the smallest of four differences, is then concave in time, and smallest
    where the time begins or ends. So is that of two hulls, the smallest of as many as
    they have pairs of corners. A half space that stands still, n its normal, has the
    shadow of its axis, and all of it is behind.

    Args:
        n: (k, 3) unit directions.
        at: (P, 3) points, where the axes start and from there to their ends among
            them [m].
        some: (k,) which pairs.
        a, b: (k, 6) spatial velocities of both shapes about the world's origin, for a
            unit of time.
        half: the time is within [-half, half].

    Returns:
        (k,) a bound from below, to the first order [m].
    """
    gap, hulls = np.empty(len(n)), pairs.hulls.value
    for k in range(len(n)):
        of = some[k]
        if pairs.hull_a[of] >= 0 or pairs.hull_b[of] >= 0:
            corners = corners_of(
                at, pairs.start_a[of], pairs.vector_a[of], pairs.hull_a[of], hulls
            )
            low_0, low_1, _, _ = shadow_rates(n[k], corners, a[k], half)
            corners = corners_of(
                at, pairs.start_b[of], pairs.vector_b[of], pairs.hull_b[of], hulls
            )
            _, _, high_0, high_1 = shadow_rates(n[k], corners, b[k], half)
            gap[k] = min(low_0 - high_0, low_1 - high_1)
            continue
        p, u = at[pairs.start_a[some[k]]], at[pairs.vector_a[some[k]]]
        a_0, a_1, da_0, da_1 = _end_shadows(n[k], p, u, a[k], half)
        p, u = at[pairs.start_b[some[k]]], at[pairs.vector_b[some[k]]]
        b_0, b_1, db_0, db_1 = _end_shadows(n[k], p, u, b[k], half)
        gap[k] = min(
            min(a_0 - da_0, a_1 - da_1) - max(b_0 - db_0, b_1 - db_1),
            min(a_0 + da_0, a_1 + da_1) - max(b_0 + db_0, b_1 + db_1),
        )
    return gap


@compiled
def path_bounds(
    start: np.ndarray,
    x: np.ndarray,
    bend: np.ndarray,
    level: np.ndarray,
    asked: np.ndarray,
    r: Robot,
    reaches: Held,
    quick: bool,
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
        level: (Np,) distances to be kept [m].
        asked: (Np,) bool, of which pairs.
        r: with the pairs of shapes in the first half of its `pairs`.
        reaches: holds `Reaches` of the pairs.
        quick: whether one pair that is seen below its level is enough to know.
    """
    count = len(level)
    low, seen = np.full(count, np.inf), np.full(count, np.inf)
    at = np.full(count, -1.0)
    if not asked.any():
        return Bounds(low, at, seen)
    reaches = reaching(start, x, bend, reaches)
    pairs, of = r.pairs.value, reaches.value
    curvature = np.zeros(count)
    examined = np.flatnonzero(asked)
    fastest = np.maximum(np.abs(x), np.abs(x + 2.0 * bend))
    put_at(curvature, examined, path_curvature(fastest, examined, of))
    if bend.any():
        curvature += 2.0 * travel(bend, reaches)
    points = np.zeros((len(r.first), 3))
    open_ = asked.reshape(1, -1)
    for halving in range(_HALVINGS + 1):
        parts, half = len(open_), 0.5 / len(open_)
        below = np.zeros((2 * parts, count), dtype=np.bool_)
        for part in range(parts):
            some = np.flatnonzero(open_[part])
            if not len(some):
                continue
            t = (2 * part + 1) * half
            shapes, own = pairs.shapes[some], of.own[some]
            moved, rate = t * x + (t * t) * bend, x + (2.0 * t) * bend
            S = place_pairs(points, start + moved, shapes, r)
            d, n, _, _ = nearest_points(points, pairs, shapes)
            gap = shadow_gap(
                n,
                points,
                pairs,
                shapes,
                own_velocities(S, rate, of.a_alone, own),
                own_velocities(S, rate, of.b_alone, own),
                half,
            )
            for k in range(len(some)):
                pair = some[k]
                radii = pairs.sizes.radii[shapes[k]]
                bound = gap[k] - (radii + 0.5 * half * half * curvature[pair])
                if bound >= level[pair]:
                    low[pair] = min(low[pair], bound)
                    continue
                last = halving == _HALVINGS
                there = -np.inf if np.isnan(d[k]) else d[k]
                if there < level[pair] or last:
                    low[pair] = min(low[pair], there)
                    if at[pair] < 0.0 or there < seen[pair]:
                        at[pair], seen[pair] = t, there
                    if quick and there < level[pair]:
                        return Bounds(low, at, seen)
                    last = last or halving >= _SEARCHED
                if not last:
                    below[2 * part, pair] = True
                    below[2 * part + 1, pair] = True
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
    start: np.ndarray, x: np.ndarray, bounds: Bounds, r: Robot
) -> tuple[np.ndarray, np.ndarray]:
    """Eq. (20) of the pairs that are not clear, where they are not: (k,), (k, nv).

    Args:
        r: as in `path_bounds`.

    Returns:
        The pairs, and their gradients [m/rad or 1].
    """
    pairs = r.pairs.value
    failed = np.flatnonzero(bounds.at >= 0.0)
    g, points = np.zeros((len(failed), len(x))), np.zeros((len(r.first), 3))
    for k in range(len(failed)):
        some = failed[k : k + 1]
        there = start + bounds.at[some[0]] * x
        shapes = pairs.shapes[some]
        _, found = distances_at(points, there, shapes, pairs.moves[some], r)
        put(g[k], 0, found[0])
    return failed, g


@compiled
def travel(x: np.ndarray, reaches: Held) -> np.ndarray:
    """(A6): how much joints that move by |x_j| can change the distances, (Np,) [m]."""
    return transposed_times(reaches.value.farthest, np.abs(x))


class AdmissionGains(NamedTuple):
    """The numbers of the admission, see `LookaheadParameters`."""

    T: float  # braking horizon [s]
    period: float  # of the controller [s]
    step: float  # of the plant [s], 0 if it moves continuously
    floor: float  # the distance that pairs keep on every braking path [m]
