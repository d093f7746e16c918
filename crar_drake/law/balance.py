"""Whether the ground can give what a robot that stands takes: (B1)-(B5).

The base of the robot is fixed, and stands on the ground by soles. The ground pushes it
with the wrench

    w(q, q_dot, q_ddot) = [moment about the world's origin; force],

by Newton and Euler that of all masses: sum m [x x (x_ddot + g e_z); x_ddot + g e_z]. It
can give those of a cone K = {w : R w <= 0}, see `robot.soles`.

From (q, q_dot) the robot may brake with q_ddot = -q_dot / T. On its braking path, at
q + u T q_dot, it then has a share kappa of its velocity and brakes with a share a of
q_dot / T. With x = T q_dot and h = period / T,

    w(u, kappa, a) = weight(u) + (kappa^2 turning(u) - a momentum(u)) / T^2,      (B1)

where `weight` is m g at the centre of mass, `turning` what velocities x alone take
(centripetal and gyroscopic), and `momentum` that of the velocities x. A state is
*balanced* if (B1) is in K for all

    0 <= u <= 1,  0 <= kappa <= 1 - u,  kappa <= a <= min(1, kappa / (1 - h)).    (B2)

Braking leads through these alone, and from one of them to a state whose (B2) is among
them: `docs/theory/balance.md` has the proof.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import Held, compiled
from crar_drake.law.wrenches import (
    MOMENTUM_Q,
    MOMENTUM_X,
    TURNING_Q,
    TURNING_X,
    WEIGHT_Q,
    Masses,
    wrench_slopes,
    wrenches,
)

# More pieces of a path than this are not worth their time, a power of 2; a path that
# would need more is taken for less balanced than it is.
_PIECES = 64
# Of how far a face is from its level, the share that a piece of the path may add; and
# where all that counts is whether it is below.
_CLOSE, _UNASKED = 0.1, 1e9


class Ground(NamedTuple):
    """K = {w : R w <= 0}, what the ground can give; F faces."""

    rows: np.ndarray  # (F, 6) R: on the moment about the world's origin, and the force
    moment: np.ndarray  # (F,) norms of the rows' first halves
    force: np.ndarray  # (F,) and of what they are on forces through
    about: np.ndarray  # (3,) a point amid the soles [m]


class Bends(NamedTuple):
    """By what the faces' values may bend over a motion, see `bends`.

    |d^2 (r . w)| <= |r_M| moment + |r_F| force, for a face r with r_F on forces through
    `Ground.about`: of what stays as fast as it is, and of what grows with the speed.
    """

    still: float  # by the weight, on moments [Nm]
    moment: float  # [Nm]
    force: float  # [N]


@compiled
def bends(
    q: np.ndarray,
    x: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    T: float,
    about: np.ndarray,
    masses: Masses,
) -> Bends:
    """(B3): how much r . w bends while the robot moves.

    The k-th derivative of a chain of frames that turn by angles whose k-th derivatives
    are at most r_k in all is at most B_k(r_1, ..., r_k) times its length, with the
    complete Bell polynomials, in which r_3 = r_4 = 0,

        B_1 = r_1,  B_2 = r_1^2 + r_2,  B_3 = r_1^3 + 3 r_1 r_2,
        B_4 = r_1^4 + 6 r_1^2 r_2 + 3 r_2^2;

    that of a slide follows by Leibniz. A frame's mass counts at the root mean square of
    its distance: all that is summed is at most quadratic in it. With X_k of a mass, D
    its largest distance from `about`, and Y_k the bound of the k-th derivative of its
    acceleration,

        |d^2 (r . w)| <= sum m [|r_M| (X_2 (g + Y_0) + 2 X_1 Y_1 + D Y_2) + |r_F| Y_2].

    Args:
        q, x: (nq,), (nv,) where the motion begins and what each joint moves [rad, m].
        v, a: (nv,), (nv,) bounds of the joints' rates, and of the rates' rates, by the
            parameter of the motion.
        T: 0, if the parameter is time, so that Y_k = X_(k+2); else the motion is a path
            over u, on which Y_k = (X_(k+2) + X_(k+1)) / T^2 [s].
        about: (3,) [m].
    """
    tree = masses.tree.value
    N = len(masses.mass)
    r, far = np.zeros((N, 2)), np.zeros(N)
    X = np.zeros((N, 5))
    B, Y = np.empty(5), np.empty(3)
    far[0] = np.sqrt(about[0] ** 2 + about[1] ** 2 + about[2] ** 2)
    still, moment, force = 0.0, 0.0, 0.0
    for i in range(N):
        if i:
            up, j = tree.parent[i], masses.velocity[i]
            slides = masses.slide[i].any()
            turns = masses.turn[i].any()
            at = tree.position[i]
            out = masses.offset[i]
            if slides:
                out += max(abs(q[at]), abs(q[at] + x[j]))
            _bell(r[up], B)
            far[i] = far[up] + out
            for k in range(1, 5):
                X[i, k] = X[up, k] + out * B[k]
                if slides:
                    X[i, k] += k * B[k - 1] * v[j]
                    if k > 1:
                        X[i, k] += 0.5 * k * (k - 1) * B[k - 2] * a[j]
            r[i, 0] = r[up, 0] + (v[j] if turns else 0.0)
            r[i, 1] = r[up, 1] + (a[j] if turns else 0.0)
        m, out = masses.mass[i], masses.radius[i]
        if m == 0.0 or not (X[i].any() or r[i].any()):
            continue
        _bell(r[i], B)
        x_1, x_2 = X[i, 1] + out * B[1], X[i, 2] + out * B[2]
        x_3, x_4 = X[i, 3] + out * B[3], X[i, 4] + out * B[4]
        if T > 0.0:
            Y[0], Y[1], Y[2] = x_2 + x_1, x_3 + x_2, x_4 + x_3
            Y /= T * T
        else:
            Y[0], Y[1], Y[2] = x_2, x_3, x_4
        still += m * masses.g * x_2
        moment += m * (x_2 * Y[0] + 2.0 * x_1 * Y[1] + (far[i] + out) * Y[2])
        force += m * Y[2]
    return Bends(still, moment, force)


@compiled
def _bell(r: np.ndarray, B: np.ndarray) -> None:
    """Writes B_0 to B_4 of (2,) bounds."""
    B[0], B[1] = 1.0, r[0]
    B[2] = r[0] ** 2 + r[1]
    B[3] = r[0] ** 3 + 3.0 * r[0] * r[1]
    B[4] = r[0] ** 4 + 6.0 * r[0] ** 2 * r[1] + 3.0 * r[1] ** 2


class BalanceLaw(NamedTuple):
    """What the admission of balance needs of a robot and its law."""

    masses: Masses
    ground: Ground
    controlled: np.ndarray  # (n,) velocities of the controlled joints, in the plant's
    T: float  # braking horizon [s]
    period: float  # [s]
    step: float  # of the plant [s]; 0 if it is continuous
    finest: float  # of a face's value, what pieces of a way may always add to it [Nm]
    near: float  # rows are of faces that are less below their level [Nm]


class Balanced(NamedTuple):
    """What is found of a braking path, or of a step."""

    # (F,) upper bounds of what R w comes to [Nm]; balanced where none is above 0
    values: np.ndarray
    seen: np.ndarray  # (F,) the largest of the places that were looked at
    at: np.ndarray  # (F,) u, where it is largest
    share: np.ndarray  # (F,) at which kappa
    brake: np.ndarray  # (F,) and at which a


@compiled
def examine_braking(
    q: np.ndarray, v: np.ndarray, level: np.ndarray, close: float, law: BalanceLaw
) -> Balanced:
    """The largest of R w over (B2), by a bound that holds for every point of it.

    (B1) is a parabola over kappa for each a / kappa, and a enters it linearly, so the
    worst of both is one of three numbers. Between two places of the path, a piece of
    the length l apart, a face's value is at most the larger of both ends' and an eighth
    of l^2 times (B3), of which what moves shrinks with the speed that is left.

    The path is one piece at first. A piece is halved while it adds too much to a face
    that may be the worst there: more than `finest`, and than a share of how far the
    face is then from its level.

    Args:
        q, v: (nq,), (nv,) state, in the plant's order; prescribed joints at rest.
        level: (F,) what the faces' values may come to.
        close: of how far a face is from its level, the share that pieces may add.
    """
    x, still = law.T * v, np.zeros(len(v))
    bend = bends(q, x, np.abs(x), still, law.T, law.ground.about, law.masses)
    return _largest(q, x, still, True, bend, level, close, law)


@compiled
def examine_step(
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    level: np.ndarray,
    close: float,
    law: BalanceLaw,
) -> Balanced:
    """The largest of R w while an acceleration is held for a period.

    As `examine_braking` of the path, with u the share of the period.

    Args:
        q, v, a: (nq,), (nv,), (nv,) state and acceleration, in the plant's order.
    """
    period = law.period
    along = period * v + 0.5 * period * (period + law.step) * a
    fastest = np.abs(v) + (period + 0.5 * law.step) * np.abs(a)
    bend = bends(q, along, fastest, np.abs(a), 0.0, law.ground.about, law.masses)
    square = period**2
    bend = Bends(square * bend.still, square * bend.moment, square * bend.force)
    return _largest(q, v, a, False, bend, level, close, law)


@compiled
def _largest(
    q: np.ndarray,
    x: np.ndarray,
    a: np.ndarray,
    brakes: bool,
    bend: Bends,
    level: np.ndarray,
    close: float,
    law: BalanceLaw,
) -> Balanced:
    """Of a braking path q + u x, or of the step from (q, x) by a."""
    ground, F = law.ground, len(law.ground.rows)
    h = law.period / law.T
    values, seen = np.full(F, -np.inf), np.full(F, -np.inf)
    at, share, braked = np.zeros((3, F))
    # Of each place u: R weight, R turning / T^2, - R momentum / T^2; and of the pieces
    # that are left, the first on top, their ends.
    places, where = np.empty((_PIECES + 1, 3, F)), np.empty(_PIECES + 1)
    ends, left, count = np.empty((_PIECES, 2), dtype=np.int64), 1, 2
    bounds, kappas = np.empty((2, F)), np.empty((2, F))
    for end in range(2):
        where[end], ends[0, end] = end, end
        _look(q, x, a, brakes, where[end], law, places[end], seen)
    while left:
        left -= 1
        first, last = ends[left, 0], ends[left, 1]
        u, length = where[first], where[last] - where[first]
        fast = 1.0 - u if brakes else 1.0  # the largest kappa
        hardest = min(1.0, fast / (1.0 - h)) if h < 1.0 else 1.0
        done = True
        for f in range(F):
            adds = 0.125 * length**2
            adds *= _bent(bend, hardest, ground.moment[f], ground.force[f])
            largest = -np.inf
            for end in range(2):
                place = places[ends[left, end]]
                value, kappa = _worst(place[0, f], place[1, f], place[2, f], fast, h)
                bounds[end, f], kappas[end, f] = value + adds, kappa
                largest = max(largest, value + adds)
            if adds > max(law.finest, close * abs(level[f] - largest)):
                done = done and largest <= seen[f] + law.finest
        if done or length * _PIECES < 1.5:
            for f in range(F):
                for end in range(2):
                    if bounds[end, f] > values[f]:
                        kappa, place = kappas[end, f], last if end else first
                        most = min(1.0, kappa / (1.0 - h)) if h < 1.0 else 1.0
                        values[f], at[f], share[f] = bounds[end, f], where[place], kappa
                        braked[f] = most if places[place, 2, f] > 0.0 else kappa
            continue
        where[count] = u + 0.5 * length
        _look(q, x, a, brakes, where[count], law, places[count], seen)
        ends[left, 0], ends[left, 1] = count, last
        ends[left + 1, 0], ends[left + 1, 1] = first, count
        left += 2
        count += 1
    return Balanced(values, seen, at, share, braked)


@compiled
def _look(
    q: np.ndarray,
    x: np.ndarray,
    a: np.ndarray,
    brakes: bool,
    u: float,
    law: BalanceLaw,
    place: np.ndarray,
    seen: np.ndarray,
) -> None:
    """Writes a place (3, F) of `_largest`; `seen` is gone on with."""
    rows, T, h = law.ground.rows, law.T, law.period / law.T
    t = u * law.period
    if brakes:
        found = wrenches(q + u * x, x, law.masses)
        momentum = found.momentum
    else:
        there = q + t * x + 0.5 * t * (t + law.step) * a
        found = wrenches(there, x + t * a, law.masses)
        momentum = wrenches(there, a, law.masses).momentum
    for f in range(len(seen)):
        still, quick, brake = 0.0, 0.0, 0.0
        for c in range(6):
            still += rows[f, c] * found.weight[c]
            quick += rows[f, c] * found.turning[c]
            brake -= rows[f, c] * momentum[c]
        if brakes:
            place[0, f], place[1, f], place[2, f] = still, quick / T**2, brake / T**2
            value, _ = _worst(still, place[1, f], place[2, f], 1.0 - u, h)
        else:
            value = still + quick - brake
            place[0, f], place[1, f], place[2, f] = value, 0.0, 0.0
        seen[f] = max(seen[f], value)


@compiled
def _bent(bend: Bends, hardest: float, moment: float, force: float) -> float:
    return moment * (bend.still + hardest * bend.moment) + hardest * force * bend.force


@compiled
def _worst(
    still: float, quick: float, brake: float, left: float, h: float
) -> tuple[float, float]:
    """The largest of still + kappa^2 quick + a brake over (B2), and its kappa, for
    kappa up to `left`.

    If `brake` is positive, the largest a counts, else the smallest. With the largest
    the function has a kink at kappa = 1 - h, where a comes to 1.
    """
    best, at = still, 0.0
    kink = min(left, 1.0 - h)
    slope = brake
    if brake > 0.0:
        slope = brake / (1.0 - h) if h < 1.0 else 0.0
    # From 0 to the kink the parabola still + quick kappa^2 + slope kappa.
    end = left if brake <= 0.0 else kink
    top = end
    if quick < 0.0 and slope > 0.0:
        top = min(end, -0.5 * slope / quick)
    value = still + quick * top * top + slope * top
    if value > best:
        best, at = value, top
    if brake > 0.0 and left > kink:  # from there on, a = 1
        for kappa in (kink, left):
            value = still + quick * kappa * kappa + brake
            if value > best:
                best, at = value, kappa
    return best, at


@compiled
def next_state(
    q: np.ndarray, v: np.ndarray, a: np.ndarray, law: BalanceLaw
) -> tuple[np.ndarray, np.ndarray]:
    """The state (nq,), (nv,) a period on, in which a (nv,) is held."""
    period = law.period
    bend = 0.5 * period * (period + law.step)
    return q + period * v + bend * a, v + period * a


@compiled
def balance_level(q: np.ndarray, v: np.ndarray, held: Held) -> np.ndarray:
    """What R w may come to in a step from (nq,), (nv,), (F,) [Nm].

    It is 0, or where the state is not balanced the largest that is seen on its braking
    path. Nothing then gets worse.
    """
    law = held.value
    none = np.zeros(len(law.ground.rows))
    found = examine_braking(q, v, none, _UNASKED, law)
    return np.maximum(found.seen, 0.0)


@compiled
def balance_excess(
    q: np.ndarray, v: np.ndarray, a: np.ndarray, level: np.ndarray, held: Held
) -> float:
    """(B4): by how much a step is not balanced; admitted if that is not above 0.

    The wrench of the step, and of all (B2) of the state that it leads to, is in the
    cone, up to the level.

    Args:
        q, v, a: (nq,), (nv,), (nv,) state and acceleration, in the plant's order.
        level: (F,) of the state.
        held: holds the `BalanceLaw`.

    Returns:
        The largest R w above its level [Nm]; negative is what is left of it. Where the
        step itself is above it, of the step alone.
    """
    law = held.value
    way = (examine_step(q, v, a, level, _CLOSE, law).values - level).max()
    if way > 0.0:
        return way
    at, speed = next_state(q, v, a, law)
    path = examine_braking(at, speed, level, _CLOSE, law)
    return max(way, (path.values - level).max())


@compiled
def balance_rows(
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    level: np.ndarray,
    enough: float,
    held: Held,
) -> tuple[float, np.ndarray, np.ndarray]:
    """(B5): rows g and bounds b with g . q_ddot <= b, for the accelerations of the
    controlled joints, linear about a: of each face where it is largest in the step, and
    on the next braking path.

    The wrenches change with an acceleration as the step's own forces do, and as the
    next path's place, velocities and braking do.

    Args:
        q, v, a, level, held: as of `balance_excess`.
        enough: nobody asks for rows where the excess is not above it [Nm].

    Returns:
        `balance_excess`; and (2 F, n) and (2 F,), or none of either.
    """
    law = held.value
    ground, masses, T = law.ground, law.masses, law.T
    n, F = len(law.controlled), len(ground.rows)
    way = examine_step(q, v, a, level, _CLOSE, law)
    q_next, v_next = next_state(q, v, a, law)
    path = examine_braking(q_next, v_next, level, _CLOSE, law)
    excess = max((way.values - level).max(), (path.values - level).max())
    if excess <= enough:
        return excess, np.zeros((0, n)), np.zeros(0)
    g, b = np.zeros((2 * F, n)), np.full(2 * F, np.inf)
    on_way, on_path = way.values > level - law.near, path.values > level - law.near
    change = np.empty((n, 6))
    done = ~on_way
    for first in range(F):
        if done[first]:
            continue
        u = way.at[first]
        t = u * law.period
        of_q = 0.5 * t * (t + law.step)
        at = q + t * v + of_q * a
        moving = wrench_slopes(at, v + t * a, law.controlled, masses)
        # What the acceleration is for itself.
        pushed = wrench_slopes(at, a, law.controlled, masses)
        for j in range(n):
            for c in range(6):
                change[j, c] = (
                    of_q * (moving[j, WEIGHT_Q, c] + moving[j, TURNING_Q, c])
                    + t * moving[j, TURNING_X, c]
                    + of_q * pushed[j, MOMENTUM_Q, c]
                    + pushed[j, MOMENTUM_X, c]
                )
        for f in range(F):
            if not done[f] and way.at[f] == u:
                done[f] = True
                _project(ground.rows[f], change, g[f])
    x = T * v_next
    bend, of_x = 0.5 * law.period * (law.period + law.step), T * law.period
    done = ~on_path
    for first in range(F):
        if done[first]:
            continue
        u = path.at[first]
        slopes = wrench_slopes(q_next + u * x, x, law.controlled, masses)
        of_q = bend + u * of_x
        for f in range(F):
            if done[f] or path.at[f] != u:
                continue
            done[f] = True
            turns, brakes = (path.share[f] / T) ** 2, path.brake[f] / T**2
            for j in range(n):
                for c in range(6):
                    change[j, c] = of_q * (
                        slopes[j, WEIGHT_Q, c]
                        + turns * slopes[j, TURNING_Q, c]
                        - brakes * slopes[j, MOMENTUM_Q, c]
                    ) + of_x * (
                        turns * slopes[j, TURNING_X, c]
                        - brakes * slopes[j, MOMENTUM_X, c]
                    )
            _project(ground.rows[f], change, g[F + f])
    for f in range(F):
        if on_way[f]:
            b[f] = level[f] - way.values[f]
        if on_path[f]:
            b[F + f] = level[f] - path.values[f]
    for row in range(2 * F):
        for j in range(n):
            b[row] += g[row, j] * a[law.controlled[j]]
    return excess, g, b


@compiled
def _project(row: np.ndarray, change: np.ndarray, g: np.ndarray) -> None:
    """Writes how a face's value (6,) changes where the wrench does by (n, 6), (n,)."""
    for j in range(len(g)):
        g[j] = 0.0
        for c in range(6):
            g[j] += row[c] * change[j, c]
