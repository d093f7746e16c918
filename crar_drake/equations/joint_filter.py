"""One step of a safety filter: from the joint command that is wanted to a safe one.

The filter's state moves from command to command, a control period apart, by steps of
that length: q' = q + period q_dot'. A wanted command is taken as it is, to the last
bit, if it leads to a clear state on a clear way (`equations.admission`). Else the
nominal s_0 brings q_s to where the wanted motion would come to rest,

    q'_s = q_d + T q_dot_d,       so that      q_d - q decays with the time constant T,

and guard and admission choose the s that is taken, (L7) and (L8).
"""

from typing import NamedTuple

import numpy as np

from crar_drake.equations.admission import (
    AS_NOMINAL,
    BISECTIONS,
    CORRECTED,
    ROUNDING,
    SCALED,
    AdmissionGains,
    Bounds,
    examine_present,
    gradients_at,
    path_bounds,
)
from crar_drake.equations.capsule_distances import nearest_of_pairs, nearest_points
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
    CORRECTIONS,
    LESS,
    SPARE,
    LookaheadNumbers,
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
from crar_drake.equations.one_sided import one_sided_nearest
from crar_drake.equations.path_balls import Balls, curvature, near_on_way
from crar_drake.equations.vectors import largest, put_at, times

# What is wanted.
POSITION, VELOCITY, ACCELERATION = 0, 1, 2

# Why a wanted command was not taken.
NOTHING, BY_PAIR, BY_LIMIT, BY_SPEED, CATCHING_UP = 0.0, 1.0, 2.0, 3.0, 4.0

# Entries of what `filter_step` reports.
HOW, SHARE, CLEARANCE, HELD, WHY, JOINT, PAIR = range(7)
REPORTED = 7


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


@compiled
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
    """Which joint a wanted state takes beyond its limits, as (A2) has them.

    As `velocity_bounds` has it, limits that the present braking path passes count as
    where it ends, and speeds that are exceeded as what braking leaves of them.

    Args:
        q, v: (n,), (n,) state.
        q_next, v_next: (n,), (n,) that is wanted.
        lower, upper, fastest: (n,), (n,), (n,) as of `velocity_bounds`.

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


class Placed(NamedTuple):
    """The links in two configurations, where a way begins and ends."""

    points: np.ndarray  # (2, P, 3) of `place_points`
    centres: np.ndarray  # (2, B, 3) of the balls about the links [m]


@compiled
def place_ends(start: np.ndarray, end: np.ndarray, r: Robot, balls: Balls) -> Placed:
    """The links where a way begins and ends, (n,), (n,)."""
    both = np.empty((2, len(start)))
    for i in range(len(start)):
        both[0, i], both[1, i] = start[i], end[i]
    X = link_poses(both, r.tree.value, r.tree.value.every)
    return Placed(
        place_points(X, r.selection, r.first),
        place_points(X, balls.centre, balls.first),
    )


class Level(NamedTuple):
    """What pairs of shapes are to keep."""

    # (Np,) the floor, or where a pair is below it on the present path, the smallest
    # distance there [m]; (0,) if that is none
    of: np.ndarray
    held: bool  # whether there is none


@compiled
def present_level(q: np.ndarray, v: np.ndarray, law: FilterLaw) -> Level:
    """The level of a state (n,), (n,) of which nothing is known: `examine_present`."""
    mode, robot = law.mode.value, law.robot
    gains, x = mode.admission, mode.admission.T * v
    balls, every = law.balls.value, robot.value.pairs.value
    placed = place_ends(q, q + x, robot.value, balls)
    bend = 0.125 * curvature(x, balls)
    rows, _ = near_on_way(
        placed.centres, placed.points, bend, gains.floor, every, balls
    )
    if not len(rows):
        return Level(np.zeros(0), True)
    r, reaches = some_shapes(robot, rows).value, some_reaches(mode.reaches, rows)
    both = np.empty((2, len(q)))
    for i in range(len(q)):
        both[0, i], both[1, i] = q[i], q[i] + x[i]
    d = row_distances(Measured(both, v, np.zeros((0, 7))), r)
    present = examine_present(q, v, np.zeros(len(q)), d, r, reaches, gains)
    if present.held:
        return Level(np.zeros(0), True)
    level = np.full(law.balls.value.shapes[-1], gains.floor)
    put_at(level, rows, present.level)
    return Level(level, False)


class Checked(NamedTuple):
    """What is found of a step."""

    clear: bool  # whether every pair keeps its level
    clearance: float  # no distance on the next braking path is smaller, if clear [m]
    rows: np.ndarray  # (k,) the pairs of shapes that were examined
    level: np.ndarray  # (k,) what they are to keep [m]
    bounds: Bounds  # of these, on the way and the next path as one


@compiled
def check_line(
    q: np.ndarray, v_next: np.ndarray, level: Level, quick: bool, law: FilterLaw
) -> Checked:
    """Whether a step leads to a clear state on a clear way, as `check_step` asks it.

    Since q' = q + period q_dot', the way to q' and the next braking path, from there by
    T q_dot', are one straight line: from q by (period + T) q_dot'. Of a pair that is
    not clear now only the next path is asked: it may be nearest where the way begins.

    Args:
        q: (n,) the present position.
        v_next: (n,) the velocity q_dot'.
        level: that pairs are to keep.
        quick: whether a pair that is too near at the end of the line is enough to know;
            else the worst place of each is sought.
    """
    mode, robot, balls = law.mode.value, law.robot, law.balls.value
    gains, straight = mode.admission, np.zeros(len(q))
    T, period = gains.T, gains.period
    x = (period + T) * v_next
    # What is below the floor by rounding alone is clear, and may leave it.
    floor = gains.floor - ROUNDING
    every = robot.value.pairs.value
    placed = place_ends(q, q + x, robot.value, balls)
    bend = 0.125 * curvature(x, balls)
    rows, clearance = near_on_way(
        placed.centres, placed.points, bend, floor, every, balls
    )
    count = len(rows)
    if quick and level.held:
        d, _, _, _ = nearest_points(placed.points[1], every, rows)
        for k in range(count):
            if d[k] < floor:
                at, keep = np.full(1, 1.0), np.full(1, floor)
                failed = Bounds(d[k : k + 1], at, d[k : k + 1])
                return Checked(False, d[k], rows[k : k + 1], keep, failed)
    r, reaches = some_shapes(robot, rows).value, some_reaches(mode.reaches, rows)
    keep, asked = np.full(count, floor), np.ones(count, dtype=np.bool_)
    if not level.held:
        keep = np.minimum(level.of[rows], floor)
        asked = keep >= floor
    bounds = path_bounds(q, x, straight, keep, asked, r, reaches)
    if not level.held:
        start = q + period * v_next
        path = path_bounds(start, T * v_next, straight, keep, ~asked, r, reaches)
        for k in range(count):
            if not asked[k]:
                bounds.low[k], bounds.d[k] = path.low[k], path.d[k]
                if path.at[k] >= 0.0:
                    bounds.at[k] = (period + T * path.at[k]) / (period + T)
    clear = True
    for k in range(count):
        clear = clear and not bounds.at[k] >= 0.0
        clearance = min(clearance, bounds.low[k])
    return Checked(clear, clearance, rows, keep, bounds)


@compiled
def worst_of(checked: Checked) -> int:
    """The pair of shapes that is farthest below its level where a step leads; -1 if
    none is."""
    worst, most = -1, -np.inf
    for k in range(len(checked.rows)):
        lacks = checked.level[k] - checked.bounds.d[k]
        if checked.bounds.at[k] >= 0.0 and lacks > most:
            worst, most = checked.rows[k], lacks
    return worst


@compiled
def line_correction(
    q: np.ndarray, s: np.ndarray, v_next: np.ndarray, checked: Checked, law: FilterLaw
) -> Constraints:
    """A row for each pair that a step is not clear of, as `correction` has it.

    At the share u of the line of `check_line`, q_f = q + u (period + T) q_dot', and
    dq_f/ds = u (period + T) period / T, since q_dot' = q_dot + (s - q_dot) period / T.

    Args:
        q: (n,) the present position.
        s: (n,) the velocity of q_s that was checked.
        v_next: (n,) what it leads to.
    """
    mode, rows = law.mode.value, checked.rows
    T, period = mode.admission.T, mode.admission.period
    x = (period + T) * v_next
    r, reaches = some_shapes(law.robot, rows).value, some_reaches(mode.reaches, rows)
    failed, g = gradients_at(q, x, checked.bounds, r, reaches)
    zero = np.zeros(len(failed))
    missing = checked.level[failed] + SPARE - checked.bounds.d[failed]
    missing /= checked.bounds.at[failed] * ((period + T) * period / T)
    weight = np.full(len(failed), BOUNDING_WEIGHT)
    return Constraints(zero, g, zero, weight, times(g, s) + missing)


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
def guard_rows(
    q: np.ndarray, v: np.ndarray, s_0: np.ndarray, law: FilterLaw
) -> tuple[Constraints, np.ndarray]:
    """The rows (L3), (L4) of the pairs that s_0 could bring to their bounds.

    A row binds at h = d_min - g s / approach_rate, and |g s| is at most
    sum_i rho_i |s_i| of both links.

    Args:
        q, v: (n,), (n,) state.
        s_0: (n,) the nominal velocity.

    Returns:
        The rows; (C,) the pair of shapes of each.
    """
    numbers, balls, r = law.mode.value, law.balls.value, law.robot.value
    gains, n = numbers.gains, len(q)
    T = gains.T
    placed = place_ends(q, q + T * v, r, balls)
    S = joint_motion(placed.points[:, : 3 * n])
    ahead = times(balls.reach, np.abs(s_0)) / gains.approach_rate
    # Of both links together no more than the influence distance.
    ahead = np.minimum(ahead, 0.5 * (gains.influence_distance - gains.distance_margin))
    bend = 0.125 * curvature(T * v, balls) + ahead
    margin = gains.distance_margin
    rows, _ = near_on_way(
        placed.centres, placed.points, bend, margin, r.pairs.value, balls
    )
    pairs = some_shapes(law.robot, rows).value.pairs.value
    d, normal, p_WA = nearest_of_pairs(placed.points, np.zeros((0, 7)), pairs)
    dd_dv = distance_gradient_about_origin(normal, p_WA, S, pairs.moves)
    h = pair_margins(d.reshape(2, -1), dd_dv, v, T)
    constraints = pair_constraints(
        h, h, dd_dv.reshape(len(h), n), margin_curvature(dd_dv, v), np.zeros(n), gains
    )
    near = np.flatnonzero(h < gains.influence_distance)
    return constraints, np.concatenate((rows, rows))[near]


@compiled
def velocity_after(s: np.ndarray, v: np.ndarray, admission: AdmissionGains):
    """q_dot' (n,) after a step of s (n,) from q_dot (n,)."""
    return v + admission.period * ((s - v) / admission.T)


@compiled
def changed_step(
    q: np.ndarray, v: np.ndarray, s_0: np.ndarray, level: Level, law: FilterLaw
) -> tuple[np.ndarray, np.ndarray]:
    """The step that is taken where the wanted one is not clear: (L7), (L8).

    As `lookahead_guard.admit` has it: of the guard, else corrected, else scaled
    towards braking, or what the guard makes of less. The bounds (A2) are rows, too.

    Args:
        q, v: (n,), (n,) state.
        s_0: (n,) the nominal velocity of q_s.
        level: that pairs are to keep.

    Returns:
        (n,) the velocity q_dot' that it leads to; (4,) CORRECTED or SCALED, the share,
        the clearance of the next path [m], and the pair of shapes that holds it back
        the most, or -1.
    """
    numbers = law.mode.value
    admission = numbers.admission
    lowest, highest = step_bounds(q, v, len(q), numbers.limits.value, admission)
    of_pairs, shapes = guard_rows(q, v, s_0, law)
    given = join_constraints(of_pairs, box_constraints(lowest, highest))
    constraints, how, share, failed = given, CORRECTED, 1.0, -1
    s = guarded(s_0, constraints, lowest, highest)
    after = velocity_after(s, v, admission)
    checked = check_line(q, after, level, False, law)
    for _ in range(CORRECTIONS):
        if checked.clear:
            break
        failed = worst_of(checked)
        row = line_correction(q, s, after, checked, law)
        constraints = join_constraints(constraints, row)
        s = guarded(s_0, constraints, lowest, highest)
        after = velocity_after(s, v, admission)
        checked = check_line(q, after, level, False, law)
    clearance = checked.clearance
    if not checked.clear:
        how, failed = SCALED, worst_of(checked)
        share, clearance = scale_line(q, v, s, level, law)
        after = velocity_after(share * s, v, admission)
        if share < LESS[0]:
            # What the guard asks for, a way out among it, would be scaled as well.
            for less in LESS:
                s = guarded(less * s_0, given, lowest, highest)
                other = velocity_after(s, v, admission)
                checked = check_line(q, other, level, True, law)
                if checked.clear:
                    share, clearance, after = less, checked.clearance, other
                    break
    tightest, most = failed, 0.0
    if failed < 0:
        lacks = of_pairs.retreat - of_pairs.drift - times(of_pairs.g, s)
        for k in range(len(lacks)):
            if lacks[k] > most:
                tightest, most = shapes[k], lacks[k]
    return after, np.array([how, share, clearance, float(tightest)])


@compiled
def guarded(
    s_0: np.ndarray, constraints: Constraints, lowest: np.ndarray, highest: np.ndarray
) -> np.ndarray:
    """What `guard` finds in the norm of the joints, within the bounds (A2): (L7)."""
    root = np.sqrt(constraints.weight)
    s = one_sided_nearest(
        s_0,
        root[:, np.newaxis] * constraints.g,
        root * (constraints.retreat - constraints.drift),
    )
    return np.minimum(np.maximum(s, lowest), highest)


@compiled
def scale_line(
    q: np.ndarray, v: np.ndarray, s: np.ndarray, level: Level, law: FilterLaw
) -> tuple[float, float]:
    """As `scale_step`: the largest share of s that is found to be clear, and the
    clearance that goes with it [m]; of braking, which is clear, the floor's."""
    admission = law.mode.value.admission
    clear, failed, clearance = 0.0, 1.0, admission.floor
    if not level.held:
        clearance = level.of.min()
    for _ in range(BISECTIONS):
        share = 0.5 * (clear + failed)
        after = velocity_after(share * s, v, admission)
        checked = check_line(q, after, level, True, law)
        if checked.clear:
            clear, clearance = share, checked.clearance
        else:
            failed = share
    return clear, clearance


@compiled
def filter_step(
    q: np.ndarray,
    v: np.ndarray,
    kind: int,
    wish: np.ndarray,
    rate: np.ndarray,
    last: np.ndarray,
    following: bool,
    pushed: bool,
    known: bool,
    law: Held,
) -> np.ndarray:
    """The command of one control period.

    Args:
        q, v: (n,), (n,) state: the command before.
        kind, wish: as of `desired_state`; finite.
        rate: (n,) how fast a wanted position moves [rad/s]; (0,) if nobody says so.
        last: (n,) the position that was wanted a period ago; (0,) if none was.
        following: whether the command before was the wanted one. Else a wanted one is
            taken as it is only within the nominal speed limit, so that a robot which
            has been held back does not leap.
        pushed: whether a pair held back the command before, and probably does so now.
        known: whether the present path is known to be clear.
        law: holds `FilterLaw`.

    Returns:
        One after the other: (7,) what is reported, at HOW, ...; (n,) positions, (n,)
        velocities a period on, and (n,) the acceleration. HOW is AS_NOMINAL if the
        wanted command was taken, else CORRECTED or SCALED; PAIR is a pair of shapes.
    """
    of = law.value
    numbers = of.mode.value
    limits, admission = numbers.limits.value, numbers.admission
    T, period = admission.T, admission.period
    to = desired_state(q, v, kind, wish, T, period)
    why, joint = beyond_bounds(
        q, v, to.q, to.v, limits.lower, limits.upper, limits.fastest, T, period
    )
    if joint < 0 and not following:
        if largest(to.s) > numbers.gains.nominal_speed_limit:
            why, joint = CATCHING_UP, np.argmax(np.abs(to.s))
    level = Level(np.zeros(0), True) if known else present_level(q, v, of)
    pair, how, share, clearance = -1, AS_NOMINAL, 1.0, np.inf
    q_next, v_next = to.q, to.v
    taken = joint < 0
    if taken:
        checked = check_line(q, to.v, level, not following, of)
        clearance, taken = checked.clearance, checked.clear
        pair = worst_of(checked)
    if not taken:
        if not len(rate):
            rate = (wish - last) / period if len(last) else np.zeros(len(q))
        s_0 = nominal_of_wish(q, v, kind, wish, rate, numbers)
        how = CORRECTED
        if pair < 0 and not pushed:
            # Limits and speeds alone may be what is in the way.
            lowest, highest = step_bounds(q, v, len(q), limits, admission)
            s = np.minimum(np.maximum(s_0, lowest), highest)
            v_next = velocity_after(s, v, admission)
            checked = check_line(q, v_next, level, True, of)
            clearance, taken = checked.clearance, checked.clear
        if not taken:
            v_next, found = changed_step(q, v, s_0, level, of)
            how, share, clearance = found[0], found[1], found[2]
            if pair < 0:
                pair = int(found[3])
            if pair >= 0 and (why == NOTHING or why == CATCHING_UP):
                why = BY_PAIR
        q_next = q + period * v_next
    held = 1.0 if level.held else 0.0
    reported = np.array([how, share, clearance, held, why, float(joint), float(pair)])
    return np.concatenate((reported, q_next, v_next, (v_next - v) / period))
