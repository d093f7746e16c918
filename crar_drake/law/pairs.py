"""Watched pairs of links keep the safety distance d_0 on the whole braking path.

Lemma: braking keeps it. Under q_ddot = -q_dot / T the robot moves on the segment from q
to q_s = q + T q_dot. A period on, the braking path is a part of this segment.

A step s leads to q', and on to q'_s = q' + T q_dot' by (A1). It is safe if every pair
keeps its distance on the way to q' and on the segment from q' to q'_s, which bounds
show for the whole of both (`law.path_bounds`, (A3) to (A6)). Where the plant moves
in steps of the period the two are one segment. A pair that is nearer than d_0 on the
present braking path keeps the smallest distance that it has there, its *relaxed*
distance: so nothing gets worse.

Rows (L3), (L4): of each pair of shapes, at both ends of the braking path, the distance
h where the robot would come to rest grows at least by

    g s >= min(gamma max(d_min - h, 0) - kappa max(h - d_min, 0), speed),

the velocity damper of Faverjon and Tournassoud (1987) outside of the margin d_min, a
retreat inside.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from crar_drake.law.approach import Approach, distance_rows
from crar_drake.law.capsule_distances import (
    distance_gradient_about_origin,
    nearest_points,
)
from crar_drake.law.compilation import Held, compiled, hold
from crar_drake.law.kinematics import joint_motion
from crar_drake.law.path_balls import (
    MANY,
    Shapes,
    curvature,
    near_on_way,
    near_segment,
    place_ways,
)
from crar_drake.law.path_bounds import (
    FALLING,
    FIRST,
    LOWEST,
    ROUNDING,
    gradients_at,
    next_path,
    path_bounds,
)
from crar_drake.law.projection import Rows, hard_rows
from crar_drake.law.step import SafetyCheck, State
from crar_drake.law.vectors import times

# A correction aims so far above the distance that a pair must keep [m], since a row is
# linear and the distance is not; it is a part of the 1 mm between d_0 and the margin.
_SPARE = 3e-4


class PathNumbers(NamedTuple):
    """The numbers of a step and its braking path, see `LookaheadParameters`."""

    T: float  # braking time constant [s]
    period: float  # of the controller [s]
    step: float  # of the plant [s], 0 if it moves continuously
    floor: float  # d_0, which pairs keep [m]


class Pairs:
    """The constraint of watched pairs.

    Attributes:
        shapes: holds `Shapes`.
        names: of the two links of each pair of shapes.
        present_is_clear: whether the braking path of the state that the step began with
            keeps the safety distance.
        least_kept: the smallest distance that braking keeps [m].
    """

    name = "pair"

    def __init__(
        self,
        shapes: Shapes,
        names: Sequence[tuple[str, str]],
        distance: float,
        approach: Approach,
    ) -> None:
        """
        Args:
            shapes: of all pairs.
            names: (Np,) of each pair of shapes its links.
            distance: d_0, to be kept [m].
            approach: of the rows.
        """
        self.shapes, self._approach = hold(shapes), hold(approach)
        self.names = list(names)
        self._distance = float(distance)

    def is_safe(self, q: np.ndarray, v: np.ndarray, T: float) -> bool:
        """Whether the braking path from a state (nv,), (nv,) keeps the safety distance,
        over a braking time constant [s]."""
        return not len(relaxed_distances(q, v, T, self._distance, self.shapes))

    def begin(self, state: State) -> None:
        self._numbers = PathNumbers(
            state.T, state.period, state.plant_step, self._distance
        )
        self._kept = np.zeros(0)
        if not state.known:
            self._kept = relaxed_distances(
                state.q, state.v, state.T, self._distance, self.shapes
            )
            state.keep_rows |= len(self._kept) > 0
        self.present_is_clear, self.least_kept = True, self._distance
        if len(self._kept):
            self.present_is_clear, self.least_kept = False, float(self._kept.min())

    def rows(self, state: State) -> Rows:
        s, n = state.whole(state.nominal), state.n
        of = state.T, self._approach, self.shapes
        g, least = pair_rows(state.q, state.v, s, *of)
        return hard_rows(g, least, s[n:])

    def examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        given = state.q, state.v, s, self._kept, self._numbers, self.shapes
        if not correct:
            safe, clearance, worst = keep_distance(*given)
            return SafetyCheck(safe, clearance, index=worst)
        safe, clearance, worst, g, least, moved = check_pairs(*given, True)
        if safe or not len(least):
            return SafetyCheck(safe, clearance, index=worst)
        rows = hard_rows(g, least, s[state.n :])
        return SafetyCheck(False, clearance, rows, moved > 0.0, worst)


@compiled
def relaxed_distances(
    q: np.ndarray, v: np.ndarray, T: float, distance: float, held: Held
) -> np.ndarray:
    """What pairs of shapes are to keep, (Np,) [m]; (0,) if all keep the safety distance
    on the braking path of a state.

    Args:
        q, v: (nv,), (nv,) state.
        T: [s].
        distance: d_0 [m].
        held: holds `Shapes`.
    """
    shapes, x = held.value, T * v
    rows, parts, _, _ = near_segment(q, x, distance, MANY, shapes)
    if not len(rows):
        return np.zeros(0)
    keep, straight = np.full(len(rows), distance - ROUNDING), np.zeros(len(x))
    of = shapes.robot.value, shapes.reaches
    found = path_bounds(q, x, straight, rows, keep, *of, parts, LOWEST)
    if not (found.at >= 0.0).any():
        return np.zeros(0)
    kept = np.full(shapes.balls.value.shapes[-1], distance)
    for k in range(len(rows)):
        if found.at[k] >= 0.0 and np.isfinite(found.d[k]):
            kept[rows[k]] = min(found.d[k], distance)
    return kept


@compiled
def pair_rows(
    q: np.ndarray, v: np.ndarray, s: np.ndarray, T: float, approach: Held, held: Held
) -> tuple[np.ndarray, np.ndarray]:
    """g (C, nv), least (C,): the rows of the pairs that s could bring to bind.

    A row binds at h = d_min - g s / kappa, and |g s| is at most sum_i rho_i |s_i| of
    both links. What (L4) leaves out of its rate, T q_dot^T hess(d) q_dot, is estimated
    by the secant.

    Args:
        q, v, s: (nv,), (nv,), (nv,) state and nominal.
        T: [s].
        approach: holds `Approach`.
        held: holds `Shapes`.
    """
    shapes, numbers = held.value, approach.value
    r, balls = shapes.robot.value, shapes.balls.value
    nv, margin = len(v), numbers.distance_margin
    points, centres = place_ways(q, T * v, 1, r, balls)
    ahead = times(balls.reach, np.abs(s)) / numbers.approach_rate
    # Of both links together no more than the influence distance.
    ahead = np.minimum(ahead, 0.5 * (numbers.influence_distance - margin))
    bend = 0.125 * curvature(T * v, balls.reach, balls.above) + ahead
    rows, _ = near_on_way(centres, points, bend, margin, r.pairs.value, balls)
    if not len(rows):
        return np.zeros((0, nv)), np.zeros(0)
    pairs, S = r.pairs.value, joint_motion(points[:, : 3 * nv])
    d, normal, p, _ = nearest_points(points[0], pairs, rows)
    moves = pairs.moves[rows]
    g = distance_gradient_about_origin(normal, p, S[0], moves)
    ends, normal, p, _ = nearest_points(points[1], pairs, rows)
    # The others have no row.
    most = numbers.influence_distance
    near = (d + T * times(g, v) < most) | (ends < most)
    ahead = distance_gradient_about_origin(normal[near], p[near], S[1], moves[near])
    both = np.stack((d[near], ends[near])), np.stack((g[near], ahead))
    return distance_rows(*both, np.zeros(len(ahead)), v, T, numbers)


@compiled
def check_pairs(
    q: np.ndarray,
    v: np.ndarray,
    s: np.ndarray,
    kept: np.ndarray,
    of: PathNumbers,
    held: Held,
    correct: bool,
) -> tuple[bool, float, int, np.ndarray, np.ndarray, np.ndarray]:
    """Whether a step, and the braking path that it leads to, keep all distances.

    Args:
        q, v, s: (nv,), (nv,), (nv,) state and step.
        kept: (Np,) relaxed distances [m]; (0,) for d_0 of all.
        of: times, and d_0.
        held: holds `Shapes`.
        correct: whether rows are asked for.

    Returns:
        Whether they do; no distance is smaller, if they do [m]; the pair of shapes that
        is farthest below, or -1; where asked for g (k, nv), least (k,) of those below;
        (nv,) above 0 for the joints that move these.
    """
    shapes, nv = held.value, len(v)
    T, period, floor = of.T, of.period, of.floor - ROUNDING
    q_next, x = next_path(q, v, s, T, period, of.step)
    # Of q'_s, and of where the braking path begins, the change with s.
    k_0, k_1 = 0.5 * period * (period + of.step) / T, period
    start = q_next
    one_segment = of.step >= period * (1.0 - 1e-9) and not len(kept)
    if one_segment:
        start, x, k_0 = q, (q_next + x) - q, 0.0
        k_1 = (period + T) * period / T
    straight, every = np.zeros(nv), shapes.robot.value.pairs.value
    rows, parts, clearance, points = near_segment(start, x, floor, MANY, shapes)
    none = np.zeros((0, nv)), np.zeros(0), np.zeros(nv)
    ends = np.full(len(rows), np.inf)
    if len(rows) and one_segment:
        # Of a pair that is too near at the end no more need be known.
        ends, _, _, _ = nearest_points(points[1], every, rows)
        for k in range(len(rows)):
            if ends[k] < floor:
                if not correct:
                    return False, ends[k], rows[k], *none
                parts[:, k] = False
    if len(rows):
        keep = np.full(len(rows), floor)
        if len(kept):
            keep = np.minimum(kept[rows], floor)
        r, wanted = shapes.robot.value, FALLING if correct else FIRST
        of_path = start, x, straight, rows, keep, r, shapes.reaches
        bounds = path_bounds(*of_path, parts, wanted)
        worst, most = -1, -np.inf
        for k in range(len(rows)):
            if ends[k] < floor:
                bounds.low[k], bounds.at[k], bounds.d[k] = ends[k], 1.0, ends[k]
            clearance = min(clearance, bounds.low[k])
            if bounds.at[k] >= 0.0 and keep[k] - bounds.d[k] > most:
                worst, most = rows[k], keep[k] - bounds.d[k]
        if worst >= 0:
            if not correct:
                return False, clearance, worst, *none
            failed, g = gradients_at(start, x, rows, bounds, r)
            d, at = bounds.d[failed], bounds.at[failed]
            missing = (keep[failed] + _SPARE - d) / (k_0 + at * k_1)
            moved = np.abs(every.moves[rows[failed]]).sum(axis=0)
            good = np.flatnonzero(np.isfinite(missing))
            below = g[good], times(g[good], s) + missing[good], moved
            return False, clearance, worst, *below
    if not one_segment and not _keeps_way(q, v, s, kept, floor, of, shapes):
        return False, clearance, -1, *none
    return True, clearance, -1, *none


@compiled
def keep_distance(
    q: np.ndarray,
    v: np.ndarray,
    s: np.ndarray,
    kept: np.ndarray,
    of: PathNumbers,
    held: Held,
) -> tuple[bool, float, int]:
    """What `check_pairs` finds first, without rows: arrays take time to hand out."""
    safe, clearance, worst, _, _, _ = check_pairs(q, v, s, kept, of, held, False)
    return safe, clearance, worst


@compiled
def _keeps_way(q, v, s, kept, floor, of, shapes):
    """Whether the parabola to the next state, and its chord, on which a robot moves
    that interpolates between commands, keep the safety distance; of pairs that are
    below it nothing is asked, lest they stay there."""
    r, balls = shapes.robot.value, shapes.balls.value
    period, T = of.period, of.T
    bend = (0.5 * period * period / T) * (s - v)
    along = period * v + (0.5 * period * of.step / T) * (s - v)
    points, centres = place_ways(q, along + bend, 1, r, balls)
    fastest = np.maximum(np.abs(along), np.abs(along + 2.0 * bend))
    off = curvature(fastest, balls.reach, balls.above)
    off = 0.125 * (off + 2.0 * times(balls.reach, np.abs(bend)))
    rows, _ = near_on_way(centres, points, off, floor, r.pairs.value, balls)
    if len(kept):
        rows = rows[kept[rows] >= floor]
    if not len(rows):
        return True
    keep, reaches = np.full(len(rows), floor), shapes.reaches
    whole = np.ones((1, len(rows)), np.bool_)
    way = path_bounds(q, along, bend, rows, keep, r, reaches, whole, FIRST)
    if (way.at >= 0.0).any():
        return False
    of = q, along + bend, 0.0 * bend, rows, keep, r, reaches, whole
    chord = path_bounds(*of, FIRST)
    return not (chord.at >= 0.0).any()
