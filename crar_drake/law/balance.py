"""Whether the ground can give what a robot that stands takes, by bounds of its wrench
on a whole braking path: (B1)-(B5) of `docs/theory/balance.md`.

At q + u T q_dot a robot that has the share kappa of its velocity left, and brakes with
a share a of q_dot / T, needs the wrench [moment about the world's origin; force]

    w(u, kappa, a) = weight(u) + (kappa^2 turning(u) - a momentum(u)) / T^2.      (B1)

The ground can give a cone K = {w : R w <= 0}, see `robot.soles`. With h = period / T a
state is *balanced* if (B1) is in K for all

    0 <= u <= 1,  0 <= kappa <= 1 - u,  kappa <= a <= min(1, kappa / (1 - h)).    (B2)
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import Held, compiled
from crar_drake.law.dynamics import Masses, wrench_slopes, wrenches
from crar_drake.law.prediction import state_within
from crar_drake.law.vectors import dot, times

# More pieces of a path than this are not worth their time, a power of 2; a path that
# would need more is taken for less balanced than it is.
_PIECES = 64
# Of how far a face is from its level, the share that a piece of the path may add; and
# where all that counts is whether it is below.
_CLOSE, _UNASKED = 0.1, 1e9


class WrenchCone(NamedTuple):
    """K = {w : R w <= 0}, what the ground can give; F faces."""

    rows: np.ndarray  # (F, 6) R: on the moment about the world's origin, and the force
    moment: np.ndarray  # (F,) norms of the rows' first halves
    force: np.ndarray  # (F,) and of what they are on forces through
    about: np.ndarray  # (3,) a point amid the soles [m]


class BalanceLaw(NamedTuple):
    """What the admission of balance needs of a robot and its law."""

    masses: Masses
    cone: WrenchCone
    controlled: np.ndarray  # (n,) velocities of the controlled joints, in the plant's
    T: float  # braking time constant [s]
    period: float  # [s]
    step: float  # of the plant [s]; 0 if it is continuous
    finest: float  # of a face's value, what pieces of a path may always add [Nm]
    near: float  # rows are of faces that are less below their level [Nm]


class Examined(NamedTuple):
    """What is found of a braking path, or of a step."""

    # (F,) upper bounds of what R w comes to [Nm]; balanced where none is above 0
    values: np.ndarray
    seen: np.ndarray  # (F,) the largest of the places that were looked at
    at: np.ndarray  # (F, 3) u, kappa and a where it is largest; of a step u alone


@compiled
def bends(
    q: np.ndarray, v: np.ndarray, a: np.ndarray, brakes: bool, law: BalanceLaw
) -> tuple[np.ndarray, np.ndarray]:
    """(B3): how much r . w bends while the robot moves; of each face (F,) [Nm].

    The parameter is time, in units of T. The k-th derivative of a chain of frames that
    turn by angles whose k-th derivatives are at most r_k in all is at most B_k(r_1,
    ..., r_k) times its length, with the complete Bell polynomials, in which r_3 = r_4 =
    0,

        B_1 = r_1,  B_2 = r_1^2 + r_2,  B_3 = r_1^3 + 3 r_1 r_2,
        B_4 = r_1^4 + 6 r_1^2 r_2 + 3 r_2^2;

    that of a slide follows by Leibniz. A frame's mass counts at the root mean square of
    its distance: all that is summed is at most quadratic in it. With X_k of a mass, D
    its largest distance from `WrenchCone.about`, and Y_k the bound of the k-th
    derivative of its acceleration,

        |d^2 (r . w)| <= sum m [|r_M| (X_2 (g + Y_0) + 2 X_1 Y_1 + D Y_2) + |r_F| Y_2].

    Args:
        q, v, a: (nq,), (nv,), (nv,) of `examine`.
        brakes: as there. On a braking path Y_k = (X_(k+2) + X_(k+1)) / T^2, else Y_k =
            X_(k+2) / T^2.

    Returns:
        The share of the weight; and that which shrinks with the speed that is left.
    """
    masses, cone, fastest, bent = law.masses, law.cone, np.abs(v), np.zeros(len(v))
    if not brakes:
        fastest += (law.period + 0.5 * law.step) * np.abs(a)
        bent = law.T**2 * np.abs(a)
    fastest *= law.T
    tree = masses.tree.value
    N = len(masses.inertia)
    r, X = np.zeros((N, 2)), np.zeros((N, 5))
    B, x, Y = np.empty(5), np.empty(5), np.empty(3)
    X[0, 0] = np.sqrt(dot(cone.about, cone.about))  # the farthest that it is from there
    still, moment, force = 0.0, 0.0, 0.0
    for i in range(N):
        if i:
            up, j = tree.parent[i], masses.velocity[i]
            out = np.sqrt(dot(tree.fixed[i, 3], tree.fixed[i, 3]))
            slides = masses.slide[i].any()
            if slides:
                out += abs(q[tree.position[i]]) + fastest[j]
            _bell(r[up], B)
            for k in range(5):
                X[i, k] = X[up, k] + out * B[k]
            if slides:
                X[i, 1] += B[0] * fastest[j]
                for k in range(2, 5):
                    X[i, k] += k * B[k - 1] * fastest[j]
                    X[i, k] += 0.5 * k * (k - 1) * B[k - 2] * bent[j]
            turns = masses.turn[i].any()
            r[i, 0] = r[up, 0] + (fastest[j] if turns else 0.0)
            r[i, 1] = r[up, 1] + (bent[j] if turns else 0.0)
        P = masses.inertia[i]
        m = P[3, 3]
        if m == 0.0:
            continue
        out = np.sqrt((P[0, 0] + P[1, 1] + P[2, 2]) / m)
        _bell(r[i], B)
        for k in range(5):
            x[k] = X[i, k] + out * B[k]
        for k in range(3):
            Y[k] = (x[k + 2] + (x[k + 1] if brakes else 0.0)) / law.T**2
        still += m * masses.g * x[2]
        moment += m * (x[2] * Y[0] + 2.0 * x[1] * Y[1] + x[0] * Y[2])
        force += m * Y[2]
    return cone.moment * still, cone.moment * moment + cone.force * force


@compiled
def _bell(r: np.ndarray, B: np.ndarray) -> None:
    """Writes B_0 to B_4 of (2,) bounds."""
    B[0], B[1] = 1.0, r[0]
    B[2] = r[0] ** 2 + r[1]
    B[3] = r[0] ** 3 + 3.0 * r[0] * r[1]
    B[4] = r[0] ** 4 + 6.0 * r[0] ** 2 * r[1] + 3.0 * r[1] ** 2


@compiled
def examine(
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    brakes: bool,
    level: np.ndarray,
    close: float,
    law: BalanceLaw,
) -> Examined:
    """The largest of R w over (B2), or while an acceleration is held for a period, by a
    bound that holds for every instant.

    (B1) is a parabola over kappa for each a / kappa, and a enters it linearly, so the
    worst of both is one of a few numbers. Between two places of the path, a piece of
    the length l apart, a face's value is at most the larger of both ends' and an eighth
    of l^2 times (B3), of which what moves shrinks with the speed that is left.

    The path is one piece at first. A piece is halved while it adds too much to a face
    that may be the worst there: more than `finest`, and than a share of how far the
    face is then from its level. Of a step u is the share of the period.

    Args:
        q, v, a: (nq,), (nv,), (nv,) state and acceleration, in the plant's order.
        brakes: whether the robot brakes over T, so that a is -v / T and prescribed
            joints are at rest; else a is held.
        level: (F,) what the faces' values may come to.
        close: of how far a face is from its level, the share that pieces may add.
    """
    F, h = len(level), law.period / law.T
    still, moving = bends(q, v, a, brakes, law)
    unit = 1.0 if brakes else h  # of u, in those of `bends`
    values, seen, at = np.full(F, -np.inf), np.full(F, -np.inf), np.zeros((F, 3))
    # Of each place u: (3, F) of `_look`; of the pieces that are left, the first on top,
    # their ends; of a piece's ends the bounds, and where and at which kappa and a.
    places, where = np.empty((_PIECES + 1, 3, F)), np.empty(_PIECES + 1)
    ends, left, count = np.empty((_PIECES, 2), dtype=np.int64), 1, 2
    bounds, spots = np.empty((2, F)), np.empty((2, F, 3))
    for end in range(2):
        where[end], ends[0, end] = end, end
        _look(q, v, a, brakes, where[end], law, places[end], seen)
    while left:
        left -= 1
        first, last = ends[left, 0], ends[left, 1]
        u, length = where[first], where[last] - where[first]
        fast = 1.0 - u if brakes else 1.0  # the largest kappa
        done = True
        for f in range(F):
            adds = still[f] + _most_braking(fast, h) * moving[f]
            adds *= 0.125 * (unit * length) ** 2
            for end in range(2):
                k = ends[left, end]
                R_w = places[k, 0, f], places[k, 1, f], places[k, 2, f]
                value, kappa, braking = _worst(*R_w, fast, h)
                bounds[end, f], spots[end, f, 0] = value + adds, where[k]
                spots[end, f, 1], spots[end, f, 2] = kappa, braking
            largest = max(bounds[0, f], bounds[1, f])
            if adds > max(law.finest, close * abs(level[f] - largest)):
                done = done and largest <= seen[f] + law.finest
        if done or length * _PIECES < 1.5:
            for f in range(F):
                for end in range(2):
                    if not bounds[end, f] <= values[f]:  # a NaN is not safe
                        values[f], at[f] = bounds[end, f], spots[end, f]
            continue
        where[count] = u + 0.5 * length
        _look(q, v, a, brakes, where[count], law, places[count], seen)
        ends[left, 0], ends[left, 1] = count, last
        ends[left + 1, 0], ends[left + 1, 1] = first, count
        left += 2
        count += 1
    return Examined(values, seen, at)


@compiled
def _look(
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    brakes: bool,
    u: float,
    law: BalanceLaw,
    place: np.ndarray,
    seen: np.ndarray,
) -> None:
    """Writes R w (3, F) at a place u of `examine`: what stays, what goes with kappa^2,
    and what with a; `seen` is gone on with."""
    if brakes:
        w = wrenches(q + u * law.T * v, v, a, law.masses)
    else:
        there, rate = state_within(q, v, a, u * law.period, law.step)
        w = wrenches(there, rate, a, law.masses)
        w[0] += w[1] + w[2]
        w[1:] = 0.0
    h = law.period / law.T
    for k in range(3):
        place[k] = times(law.cone.rows, w[k])
    for f in range(len(seen)):
        value, _, _ = _worst(place[0, f], place[1, f], place[2, f], 1.0 - u, h)
        seen[f] = max(seen[f], value)


@compiled
def _most_braking(kappa: float, h: float) -> float:
    """The largest a of (B2)."""
    return kappa / (1.0 - h) if kappa < 1.0 - h else 1.0


@compiled
def _worst(
    still: float, quick: float, brake: float, left: float, h: float
) -> tuple[float, float, float]:
    """The largest of still + kappa^2 quick + a brake over (B2), its kappa, and its a,
    for kappa up to `left`.

    If `brake` is positive, the largest a counts, else the smallest. With the largest
    the function has a kink at kappa = 1 - h, where a comes to 1; up to there, or else
    up to `left`, it is a parabola.
    """
    kink = min(left, 1.0 - h)
    end, slope = (kink, brake / (1.0 - h)) if brake > 0.0 else (left, brake)
    top = min(max(-0.5 * slope / quick, 0.0), end) if quick < 0.0 else 0.0
    best, at, braking = still, 0.0, 0.0
    for kappa in (top, kink, left):
        a = _most_braking(kappa, h) if brake > 0.0 else kappa
        value = still + quick * kappa * kappa + brake * a
        if value > best:
            best, at, braking = value, kappa, a
    return best, at, braking


@compiled
def balance_level(q: np.ndarray, v: np.ndarray, held: Held) -> np.ndarray:
    """What R w may come to in a step from (nq,), (nv,), (F,) [Nm].

    It is 0, or where the state is not balanced the largest that is seen on its braking
    path. Nothing then gets worse.
    """
    law = held.value
    none = np.zeros(len(law.cone.rows))
    found = examine(q, v, v / -law.T, True, none, _UNASKED, law)
    return np.maximum(found.seen, 0.0)


@compiled
def examine_balance(
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    level: np.ndarray,
    enough: float,
    held: Held,
) -> tuple[float, np.ndarray, np.ndarray]:
    """(B4), (B5): by how much a step is not balanced, and rows that correct it.

    The wrench of the step, and of all (B2) of the state that it leads to, is to be in
    the cone, up to the level. Rows are of each face where it is largest in the step,
    and on the next braking path, linear about a, for the accelerations of the
    controlled joints.

    Args:
        q, v, a: (nq,), (nv,), (nv,) state and acceleration, in the plant's order.
        level: (F,) of the state.
        enough: nobody asks for rows where the excess is not above it [Nm].
        held: holds the `BalanceLaw`.

    Returns:
        The largest R w above its level [Nm], admitted if not above 0; negative is what
        is left of it. Where nobody asks for rows, and the step itself is above it, of
        the step alone. And g (2 F, n), b (2 F,) with g . q_ddot <= b; none of either if
        nobody asks for them.
    """
    law = held.value
    n, F = len(law.controlled), len(level)
    none = np.zeros((0, n)), np.zeros(0)
    of_step = examine(q, v, a, False, level, _CLOSE, law)
    excess = (of_step.values - level).max()
    if excess > 0.0 and enough == np.inf:
        return excess, *none
    q_next, v_next = state_within(q, v, a, law.period, law.step)
    of_path = examine(q_next, v_next, v_next / -law.T, True, level, _CLOSE, law)
    excess = max(excess, (of_path.values - level).max())
    if excess <= enough:
        return excess, *none
    g, b = np.zeros((2 * F, n)), np.full(2 * F, np.inf)
    for on_path in range(2):
        found = of_path if on_path else of_step
        left = found.values > level - law.near
        for first in range(F):
            if not left[first]:
                continue
            place = found.at[first]
            change = _changes(q, v, a, place, on_path == 1, law)
            for f in range(first, F):
                if left[f] and (found.at[f] == place).all():
                    left[f], row = False, f + F * on_path
                    b[row] = level[f] - found.values[f]
                    g[row] = times(change, law.cone.rows[f])
                    for j in range(n):
                        b[row] += g[row, j] * a[law.controlled[j]]
    return excess, g, b


@compiled
def _changes(
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    place: np.ndarray,
    on_path: bool,
    law: BalanceLaw,
) -> np.ndarray:
    """(n, 6) how the wrench at a place of a step by a, or of the braking path after it,
    changes with that acceleration: as where the robot is, how fast and how it
    accelerates do there."""
    u, kappa, braking = place[0], place[1], place[2]
    t = law.period if on_path else u * law.period
    there, rate = state_within(q, v, a, t, law.step)
    pushed, by_q, by_v, by_a = a, 0.5 * t * (t + law.step), t, 1.0
    if on_path:
        there = there + u * law.T * rate
        by_q += u * law.T * t
        by_v, by_a = kappa * t, -braking * t / law.T
        rate, pushed = kappa * rate, (-braking / law.T) * rate
    slopes = wrench_slopes(there, rate, pushed, law.controlled, law.masses)
    return by_q * slopes[:, 0] + by_v * slopes[:, 1] + by_a * slopes[:, 2]
