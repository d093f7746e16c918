"""One step of a safety filter: from the joint command that is wanted to a safe one.

The filter's state moves from command to command, a control period apart, by steps of
that length: q' = q + period q_dot'. A wanted command is taken as it is, to the last
bit, if it leads to a clear state on a clear way (`equations.admission`). Else the
nominal s_0 brings q_s to where the wanted motion would come to rest,

    q'_s = q_d + T q_dot_d,       so that      q_d - q decays with the time constant T,

and guard and admission choose the s that is taken, (L7) and (L8).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from crar_drake.equations.admission import (
    AS_NOMINAL,
    CORRECTED,
    examine_present,
    path_bounds,
)
from crar_drake.equations.capsule_distances import nearest_of_pairs
from crar_drake.equations.collisions import distance_gradient_about_origin
from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.kinematics import (
    Measured,
    Robot,
    joint_motion,
    link_poses,
    place_points,
    row_distances,
)
from crar_drake.equations.lookahead_guard import (
    LookaheadNumbers,
    admit,
    guard,
    step_bounds,
)
from crar_drake.equations.lookahead_rows import (
    BOUNDING_WEIGHT,
    Constraints,
    join_constraints,
    margin_curvature,
    pair_constraints,
    pair_margins,
)
from crar_drake.equations.nearby import some_reaches, some_shapes
from crar_drake.equations.path_balls import Balls, curvature, near_on_ways
from crar_drake.equations.vectors import identity, largest, times

# What is wanted.
POSITION, VELOCITY, ACCELERATION = 0, 1, 2

# Why a wanted command was not taken.
NOTHING, BY_PAIR, BY_LIMIT, BY_SPEED, CATCHING_UP = 0.0, 1.0, 2.0, 3.0, 4.0

# Entries of what `filter_step` reports.
HOW, SHARE, CLEARANCE, HELD, WHY, JOINT, PAIR = range(7)
REPORTED = 7

# The rows of a step are made again if it comes near others than it was made with; from
# then on all count.
_AGAIN = 3


class FilterLaw(NamedTuple):
    """All that stays from step to step."""

    robot: Held  # of a `Robot` with a row for each pair of shapes
    mode: Held  # of `LookaheadNumbers`
    balls: Held  # of `Balls`


class Desired(NamedTuple):
    """Where a wanted command leads: q' = q + period q_dot'."""

    q: np.ndarray  # (n,) [rad or m]
    v: np.ndarray  # (n,) [rad/s or m/s]
    s: np.ndarray  # (n,) the velocity of q_s that leads there


@compiled
def desired_state(
    q: np.ndarray, v: np.ndarray, kind: int, wish: np.ndarray, T: float, period: float
) -> Desired:
    """The state that is wanted for the end of the period.

    Args:
        q, v: (n,), (n,) state.
        kind: POSITION, VELOCITY or ACCELERATION, of
        wish: (n,) what is wanted.
        T: braking horizon [s].
        period: of the filter [s].
    """
    if kind == POSITION:
        q_next = wish.copy()
        v_next = (q_next - q) / period
    else:
        v_next = wish.copy() if kind == VELOCITY else v + period * wish
        q_next = q + period * v_next
    return Desired(q_next, v_next, v + (T / period) * (v_next - v))


@compiled(loops=True)
def beyond_bounds(
    q: np.ndarray,
    v: np.ndarray,
    q_next: np.ndarray,
    v_next: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    fastest: np.ndarray,
    T: float,
    period: float,
) -> tuple[float, int]:
    """(A2) of a state that is wanted: which joint it takes beyond its limits.

    As `velocity_bounds` has it, limits that the present braking path passes count as
    where it ends, and speeds that are exceeded as what braking leaves of them.

    Args:
        q, v: (n,), (n,) state.
        q_next, v_next: (n,), (n,) that is wanted.
        lower, upper, fastest: (n,), (n,), (n,) as of `velocity_bounds`.
        T, period: likewise.

    Returns:
        BY_LIMIT, BY_SPEED or NOTHING; the joint that is farthest beyond, measured by
        what it moves in T, or -1.
    """
    why, joint, most = NOTHING, -1, 0.0
    for i in range(len(q)):
        end, end_next = q[i] + T * v[i], q_next[i] + T * v_next[i]
        low = min(lower[i], min(q[i], end))
        high = max(upper[i], max(q[i], end))
        far = max(
            max(low - q_next[i], low - end_next), max(q_next[i] - high, end_next - high)
        )
        speed = max(fastest[i], abs(v[i]) * (1.0 - period / T))
        fast = T * (abs(v_next[i]) - speed)
        if far > most:
            why, joint, most = BY_LIMIT, i, far
        if fast > most:
            why, joint, most = BY_SPEED, i, fast
    return why, joint


class Near(NamedTuple):
    """Pairs of shapes that are near on some ways, and the equations on these alone."""

    rows: np.ndarray  # (k,) which
    on: np.ndarray  # (k, W) whether on each way
    low: np.ndarray  # (W,) no distance of the others is smaller on it [m]


@compiled
def find_near(
    q: np.ndarray,
    ways: np.ndarray,
    bends: np.ndarray,
    enough: float,
    r: Robot,
    balls: Balls,
) -> Near:
    """`near_on_ways` of configurations.

    Args:
        q: (K, n) configurations.
        ways, bends, enough, balls: as there.
        r: of the robot.
    """
    tree = r.tree.value
    X = link_poses(q, tree, tree.every)
    return Near(
        *near_on_ways(
            place_points(X, balls.centre, balls.first),
            place_points(X, r.selection, r.first),
            ways,
            bends,
            enough,
            r.pairs.value,
            balls,
        )
    )


@compiled
def step_near(
    q: np.ndarray, v: np.ndarray, to: Desired, known: bool, r: Robot, law: FilterLaw
) -> Near:
    """The pairs that a step is to be examined for: on the next braking path, on the way
    to it, and on the present path unless it is known to be clear.

    Args:
        q, v: (n,), (n,) state.
        to: where the step leads.
        known: whether the present path is clear.
        r, law: of the robot.
    """
    mode, balls = law.mode.value, law.balls.value
    T, period = mode.admission.T, mode.admission.period
    count = 3 if known else 4
    at = np.empty((count, len(q)))
    at[0], at[1], at[2] = q, to.q, to.q + T * to.v
    ways = np.array([[1, 2], [0, 1], [0, 3]])[: count - 1]
    bends = np.empty((count - 1, len(balls.radius)))
    bends[0] = curvature(T * to.v, balls)
    # The parabola and its chord, see `check_step`.
    fastest = period * np.maximum(np.abs(v), np.abs(2.0 * to.v - v))
    bends[1] = curvature(fastest, balls)
    bends[1] += period * times(balls.reach, np.abs(to.v - v))
    if not known:
        at[3] = q + T * v
        bends[2] = curvature(T * v, balls)
    return find_near(at, ways, 0.125 * bends, mode.admission.floor, r, balls)


@compiled
def with_reaches(numbers: LookaheadNumbers, reaches: Held) -> LookaheadNumbers:
    """The numbers of the mode for some pairs."""
    return LookaheadNumbers(
        numbers.tasks,
        numbers.limits,
        numbers.gains,
        numbers.admission,
        reaches,
        numbers.members,
        numbers.preview,
    )


@compiled
def check_desired(
    q: np.ndarray, v: np.ndarray, to: Desired, known: bool, law: FilterLaw
) -> tuple[int, float, bool]:
    """Whether a step that is wanted leads to a clear state on a clear way.

    The same as `examine_present` and `check_step` ask, of the pairs that are near.

    Args:
        q, v: (n,), (n,) state.
        to: where the step leads.
        known: whether the present path is clear.
        law: of the robot.

    Returns:
        A pair of shapes that is not clear, or -1; no distance on the next path is
        smaller [m]; whether the present path is clear.
    """
    mode, robot = law.mode.value, law.robot
    gains, straight = mode.admission, np.zeros(len(q))
    T, period = gains.T, gains.period
    near = step_near(q, v, to, known, robot.value, law)
    clearance = near.low[0]
    if not len(near.rows):
        return -1, clearance, True
    r, reaches = (
        some_shapes(robot, near.rows).value,
        some_reaches(mode.reaches, near.rows),
    )
    level, held = np.full(len(near.rows), gains.floor), True
    if not known:
        both = np.empty((2, len(q)))
        both[0], both[1] = q, q + T * v
        d = row_distances(Measured(both, v, np.zeros((0, 7))), r)
        present = examine_present(q, v, to.s, d, r, reaches, gains)
        level, held = present.level, present.held
    path = path_bounds(
        to.q, T * to.v, straight, level, near.on[:, 0].copy(), r, reaches
    )
    worst, smallest = -1, np.inf
    for k in range(len(near.rows)):
        clearance = min(clearance, path.low[k])
        if path.at[k] >= 0.0 and path.d[k] - level[k] < smallest:
            worst, smallest = near.rows[k], path.d[k] - level[k]
    if worst >= 0:
        return worst, clearance, held
    # A pair that is not clear now may be nearest where the way begins.
    on_way = near.on[:, 1] & (level >= gains.floor)
    if on_way.any():
        bend = 0.5 * period * (to.v - v)
        way = path_bounds(q, period * to.v - bend, bend, level, on_way, r, reaches)
        chord = path_bounds(q, to.q - q, straight, level, on_way, r, reaches)
        for k in range(len(near.rows)):
            if way.at[k] >= 0.0 or chord.at[k] >= 0.0:
                return near.rows[k], clearance, held
    return -1, clearance, held


@compiled
def nominal_of_wish(
    q: np.ndarray,
    v: np.ndarray,
    kind: int,
    wish: np.ndarray,
    rate: np.ndarray,
    numbers: LookaheadNumbers,
) -> np.ndarray:
    """s_0 (n,) of a wish that cannot be taken as it is, each joint within the nominal
    speed limit.

    Of a position, q'_s = q_d + T q_dot_d by (A1), with e = period^2 / T. Of a velocity
    it is this velocity, and of an acceleration (L2).

    Args:
        q, v: (n,), (n,) state.
        kind, wish: as of `desired_state`.
        rate: (n,) q_dot_d of a position [rad/s].
        numbers: of the mode.
    """
    T, period = numbers.admission.T, numbers.admission.period
    fastest = numbers.gains.nominal_speed_limit
    if kind == VELOCITY:
        s_0 = wish
    elif kind == ACCELERATION:
        s_0 = v + T * wish
    else:
        e = period * period / T
        ahead = np.minimum(np.maximum(rate, -fastest), fastest)
        s_0 = (wish + T * ahead - (q + (T - e) * v)) / (period + e)
    return np.minimum(np.maximum(s_0, -fastest), fastest)


@compiled
def box_constraints(lowest: np.ndarray, highest: np.ndarray) -> Constraints:
    """The bounds (A2) on s, (n,) each, as rows."""
    n = len(lowest)
    g = np.zeros((2 * n, n))
    retreat = np.empty(2 * n)
    for i in range(n):
        g[i, i], g[n + i, i] = 1.0, -1.0
        retreat[i], retreat[n + i] = lowest[i], -highest[i]
    zero = np.zeros(2 * n)
    return Constraints(zero, g, zero, np.full(2 * n, BOUNDING_WEIGHT), retreat)


@compiled
def changed_step(
    q: np.ndarray, v: np.ndarray, s_0: np.ndarray, law: FilterLaw
) -> tuple[Desired, np.ndarray, int]:
    """(L7), (L8): the step that is taken where the wanted one is not clear.

    Args:
        q, v: (n,), (n,) state.
        s_0: (n,) the nominal velocity of q_s.
        law: of the robot.

    Returns:
        Where it leads; (4,) of `admit`; the pair of shapes that holds s back the most,
        or -1.
    """
    robot, numbers, balls = law.robot, law.mode.value, law.balls.value
    r, admission, gains = robot.value, numbers.admission, numbers.gains
    n, T, period = len(q), admission.T, admission.period
    limits = numbers.limits.value
    lowest, highest = step_bounds(q, v, n, limits, admission)
    box, norm = box_constraints(lowest, highest), identity(n)
    both = np.empty((2, n))
    both[0], both[1] = q, q + T * v
    X = link_poses(both, r.tree.value, r.tree.value.every)
    points = place_points(X, r.selection, r.first)
    S = joint_motion(points[:, : 3 * n])
    bends = 0.125 * curvature(T * v, balls).reshape(1, -1)
    near = near_on_ways(
        place_points(X, balls.centre, balls.first),
        points,
        np.array([[0, 1]]),
        bends,
        gains.influence_distance,
        r.pairs.value,
        balls,
    )
    rows, nowhere = near[0], np.zeros(0)
    to = Desired(q, v, v)
    reported, tightest = np.zeros(4), -1
    for again in range(_AGAIN + 1):
        some, reaches = some_shapes(robot, rows), some_reaches(numbers.reaches, rows)
        pairs = some.value.pairs.value
        d, normal, p_WA = nearest_of_pairs(points, np.zeros((0, 7)), pairs)
        dd_dv = distance_gradient_about_origin(normal, p_WA, S, pairs.moves)
        d = d.reshape(2, -1)
        h = pair_margins(d, dd_dv, v, T)
        of_pairs = pair_constraints(
            h,
            h,
            dd_dv.reshape(len(h), n),
            margin_curvature(dd_dv, v),
            np.zeros(n),
            gains,
        )
        constraints = join_constraints(of_pairs, box)
        s_1, _ = guard(s_0, constraints, norm)
        s, _, reported = admit(
            s_0,
            nowhere,
            s_1,
            q,
            v,
            d,
            constraints,
            norm,
            some.value,
            with_reaches(numbers, reaches),
        )
        v_next = v + period * ((s - v) / T)
        to = Desired(q + period * v_next, v_next, s)
        tightest = _tightest(of_pairs, s, h, gains.influence_distance, rows)
        if again == _AGAIN:
            break
        # What it has come near to may be a pair that was not among these.
        known = np.zeros(balls.shapes[-1], dtype=np.bool_)
        for row in rows:
            known[row] = True
        missing = False
        for row in step_near(q, v, to, True, r, law).rows:
            missing = missing or not known[row]
            known[row] = True
        if not missing:
            break
        if again == _AGAIN - 1:
            known[:] = True
        rows = np.flatnonzero(known)
    return to, reported, tightest


@compiled
def _tightest(pairs, s, h, influence, rows):
    """Of the rows of pairs that the guard had, the pair of shapes of the one that s
    gives way to the most; -1 if there is none."""
    lacks = pairs.retreat - pairs.drift - times(pairs.g, s)
    among, worst, most = 0, -1, 0.0
    for k in range(len(h)):
        if h[k] < influence:
            if lacks[among] > most:
                worst, most = rows[k % len(rows)], lacks[among]
            among += 1
    return worst


@compiled
def filter_step(
    q: np.ndarray,
    v: np.ndarray,
    kind: int,
    wish: np.ndarray,
    rate: np.ndarray,
    following: bool,
    known: bool,
    law: Held,
) -> np.ndarray:
    """The command of one control period.

    Args:
        q, v: (n,), (n,) state: the command before.
        kind, wish: as of `desired_state`; finite.
        rate: (n,) how fast a wanted position moves [rad/s], as far as known.
        following: whether the command before was the wanted one. Else a wanted one is
            taken as it is only within the nominal speed limit, so that a robot which
            has been held back does not leap.
        known: whether the present path is known to be clear.
        law: holds `FilterLaw`.

    Returns:
        One after the other: (7,) what is reported, at HOW, ...; (n,) positions, (n,)
        velocities a period on, and (n,) the acceleration. HOW is AS_NOMINAL if the
        wanted command was taken, else CORRECTED or SCALED; PAIR is a pair of shapes.
    """
    of = law.value
    numbers = of.mode.value
    T, period, limits = (
        numbers.admission.T,
        numbers.admission.period,
        numbers.limits.value,
    )
    reported = np.zeros(REPORTED)
    to = desired_state(q, v, kind, wish, T, period)
    why, joint = beyond_bounds(
        q, v, to.q, to.v, limits.lower, limits.upper, limits.fastest, T, period
    )
    if joint < 0 and not following:
        if largest(to.s) > numbers.gains.nominal_speed_limit:
            why, joint = CATCHING_UP, np.argmax(np.abs(to.s))
    pair = -1
    taken = False
    if joint < 0:
        pair, clearance, held = check_desired(q, v, to, known, of)
        taken = pair < 0
        if taken:
            reported[HOW], reported[SHARE] = AS_NOMINAL, 1.0
            reported[CLEARANCE], reported[HELD] = clearance, 1.0 if held else 0.0
    if not taken:
        s_0 = nominal_of_wish(q, v, kind, wish, rate, numbers)
        to, admission, tightest = changed_step(q, v, s_0, of)
        reported[HOW] = max(admission[0], CORRECTED)
        reported[SHARE], reported[CLEARANCE] = admission[1], admission[2]
        reported[HELD] = admission[3]
        if pair >= 0:
            why = BY_PAIR
        elif tightest >= 0 and why == CATCHING_UP:
            pair, why = tightest, BY_PAIR
        elif tightest >= 0:
            pair = tightest
    reported[WHY], reported[JOINT], reported[PAIR] = why, joint, pair
    return np.concatenate((reported, to.q, to.v, (to.v - v) / period))
