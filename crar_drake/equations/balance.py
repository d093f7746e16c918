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

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.kinematics import link_poses
from crar_drake.equations.moving_legs import Legs, leg_bounds, leg_motion

# More pieces of a path than this are not worth their time; a path that would need more
# is taken as if it bent more, and so for less balanced than it is.
_PIECES = 40
_PART = 0.05  # of an acceleration of 1, that rows are differences by
_STEP_PIECES = 8  # likewise of a step


class Masses(NamedTuple):
    """The masses of a robot whose base is fixed; all that is welded is one frame.

    Of the N frames of `Tree`, the world's, 0, has the base. Each other moves by one
    velocity.
    """

    tree: Held  # of a `Tree`
    velocity: (
        np.ndarray
    )  # (N,) which of the plant's velocities moves the frame; 0's any
    turn: np.ndarray  # (N, 3) its axis of rotation in the frame, 0 if it only slides
    slide: np.ndarray  # (N, 3) the direction of its slide in the frame, 0 if it turns
    mass: np.ndarray  # (N,) [kg]
    centre: np.ndarray  # (N, 3) of mass, in the frame [m]
    inertia: np.ndarray  # (N, 3, 3) about the centre, in the frame's axes [kg m^2]
    offset: np.ndarray  # (N,) how far the frame is from its parent, joints at 0 [m]
    radius: np.ndarray  # (N,) root mean square distance of its masses from it [m]
    g: float  # [m/s^2], downwards
    legs: Legs  # what follows the base, if that moves


class Ground(NamedTuple):
    """K = {w : R w <= 0}, what the ground can give; F faces."""

    rows: np.ndarray  # (F, 6) R: on the moment about the world's origin, and the force
    moment: np.ndarray  # (F,) norms of the rows' first halves
    force: np.ndarray  # (F,) and of what they are on forces through
    about: np.ndarray  # (3,) a point amid the soles [m]


class Wrenches(NamedTuple):
    """The three terms of (B1) at a configuration, (6,) each, for displacements x."""

    weight: np.ndarray
    turning: np.ndarray
    momentum: np.ndarray


@compiled(loops=True)
def wrenches(q: np.ndarray, x: np.ndarray, masses: Masses) -> Wrenches:
    """The terms of (B1) by a pass from the base outwards (Featherstone, Rigid Body
    Dynamics Algorithms, 2008, chapter 5), about the world's origin.

    Args:
        q: (nq,) positions, in the plant's order.
        x: (nv,) velocities, or displacements of a path, likewise.
        masses: of the robot; of legs that follow the base, what `q` and `x` say of them
            does not count.
    """
    tree, legs = masses.tree.value, masses.legs
    N = len(masses.mass)
    bent = np.zeros(len(x))  # accelerations of the legs' joints by x alone
    if len(legs.leg_q):
        q, x = q.copy(), x.copy()
        at, rate_of, bend_of = leg_motion(q[legs.slide_q], x[legs.slide_v], legs)
        for j in range(len(at)):
            q[legs.leg_q[j]], x[legs.leg_v[j]] = at[j], rate_of[j]
            bent[legs.leg_v[j]] = bend_of[j]
    X = link_poses(q.reshape(1, -1), tree, tree.every)[0]
    # Velocity and acceleration of what passes the world's origin, with each frame.
    w, u = np.zeros((N, 3)), np.zeros((N, 3))
    alpha, a = np.zeros((N, 3)), np.zeros((N, 3))
    weight, turning, momentum = np.zeros(6), np.zeros(6), np.zeros(6)
    s, t, c, v, acc = np.empty((5, 3))
    own_w, own_alpha, spin, change = np.empty((4, 3))
    for i in range(N):
        R, p = X[4 * i : 4 * i + 3], X[4 * i + 3]  # R transposed
        if i:
            up, rate = tree.parent[i], x[masses.velocity[i]]
            for k in range(3):
                s[k], t[k] = 0.0, 0.0
                for j in range(3):
                    s[k] += rate * masses.turn[i, j] * R[j, k]
                    t[k] += rate * masses.slide[i, j] * R[j, k]
            for k in range(3):
                m, n = (k + 1) % 3, (k + 2) % 3
                v[k] = t[k] + p[m] * s[n] - p[n] * s[m]
            for k in range(3):
                w[i, k] = w[up, k] + s[k]
                u[i, k] = u[up, k] + v[k]
            for k in range(3):
                m, n = (k + 1) % 3, (k + 2) % 3
                # d/dt of the joint's own motion [s; v], as of `task_bias`.
                alpha[i, k] = alpha[up, k] + w[i, m] * s[n] - w[i, n] * s[m]
                a[i, k] = a[up, k] + (w[i, m] * v[n] - w[i, n] * v[m])
                a[i, k] += u[i, m] * s[n] - u[i, n] * s[m]
            bend = bent[masses.velocity[i]]
            if bend != 0.0:
                for k in range(3):
                    s[k] = 0.0
                    for j in range(3):
                        s[k] += bend * masses.turn[i, j] * R[j, k]
                for k in range(3):
                    m, n = (k + 1) % 3, (k + 2) % 3
                    alpha[i, k] += s[k]
                    a[i, k] += p[m] * s[n] - p[n] * s[m]
        mass = masses.mass[i]
        if mass == 0.0:
            continue
        for k in range(3):
            c[k] = p[k]
            for j in range(3):
                c[k] += masses.centre[i, j] * R[j, k]
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            v[k] = u[i, k] + w[i, m] * c[n] - w[i, n] * c[m]
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            acc[k] = a[i, k] + alpha[i, m] * c[n] - alpha[i, n] * c[m]
            acc[k] += w[i, m] * v[n] - w[i, n] * v[m]
        # In the frame's axes, I w and I alpha + w x I w.
        for j in range(3):
            own_w[j], own_alpha[j] = 0.0, 0.0
            for k in range(3):
                own_w[j] += R[j, k] * w[i, k]
                own_alpha[j] += R[j, k] * alpha[i, k]
        for j in range(3):
            spin[j], change[j] = 0.0, 0.0
            for k in range(3):
                spin[j] += masses.inertia[i, j, k] * own_w[k]
                change[j] += masses.inertia[i, j, k] * own_alpha[k]
        for j in range(3):
            m, n = (j + 1) % 3, (j + 2) % 3
            change[j] += own_w[m] * spin[n] - own_w[n] * spin[m]
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            momentum[k] += mass * (c[m] * v[n] - c[n] * v[m])
            turning[k] += mass * (c[m] * acc[n] - c[n] * acc[m])
            momentum[3 + k] += mass * v[k]
            turning[3 + k] += mass * acc[k]
            for j in range(3):
                momentum[k] += spin[j] * R[j, k]
                turning[k] += change[j] * R[j, k]
        weight[0] += mass * masses.g * c[1]
        weight[1] -= mass * masses.g * c[0]
        weight[5] += mass * masses.g
    return Wrenches(weight, turning, momentum)


class Bends(NamedTuple):
    """By what the faces' values may bend over a motion, see `bends`.

    |d^2 (r . w)| <= |r_M| moment + |r_F| force, for a face r with r_F on forces through
    `Ground.about`: of what stays as fast as it is, and of what grows with the speed.
    """

    still: float  # by the weight, on moments [Nm]
    moment: float  # [Nm]
    force: float  # [N]


@compiled(loops=True)
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
    complete Bell polynomials

        B_1 = r_1,  B_2 = r_1^2 + r_2,  B_3 = r_1^3 + 3 r_1 r_2 + r_3,
        B_4 = r_1^4 + 6 r_1^2 r_2 + 3 r_2^2 + 4 r_1 r_3 + r_4;

    that of a slide follows by Leibniz. Joints have r_3 = r_4 = 0 but for legs that
    follow the base (`leg_bounds`). A frame's mass counts at the root mean square of
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
        masses: of the robot.
    """
    tree = masses.tree.value
    N = len(masses.mass)
    legs = masses.legs
    D = np.zeros((len(v), 4))  # bounds of the joints' derivatives
    D[:, 0], D[:, 1] = v, a
    if len(legs.leg_q):
        D[legs.leg_v] = leg_bounds(v[legs.slide_v], a[legs.slide_v], legs)
    r, far = np.zeros((N, 4)), np.zeros(N)
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
            r[i] = r[up]
            if turns:
                r[i] += D[j]
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
    """Writes B_0 to B_4 of (4,) bounds."""
    B[0], B[1] = 1.0, r[0]
    B[2] = r[0] ** 2 + r[1]
    B[3] = r[0] ** 3 + 3.0 * r[0] * r[1] + r[2]
    B[4] = r[0] ** 4 + 6.0 * r[0] ** 2 * r[1] + 3.0 * r[1] ** 2
    B[4] += 4.0 * r[0] * r[2] + r[3]


class Balanced(NamedTuple):
    """What is found of a braking path, or of a step.

    Attributes:
        values: (F,) upper bounds of what R w comes to [Nm]; balanced where none is
            above 0.
        seen: (F,) the largest that it comes to at the places that were looked at.
        at, share: (F,), (F,) where, u, and at which kappa it is largest.
    """

    values: np.ndarray
    seen: np.ndarray
    at: np.ndarray
    share: np.ndarray


@compiled(loops=True)
def examine_braking(
    q: np.ndarray,
    v: np.ndarray,
    T: float,
    h: float,
    finest: float,
    ground: Ground,
    masses: Masses,
) -> Balanced:
    """The largest of R w over (B2), by a bound that holds for every point of it.

    (B1) is a parabola over kappa for each a / kappa, and a enters it linearly, so the
    worst of both is one of three numbers. Between two places of the path, a piece of
    the length l apart, a face's value is at most the larger of both ends' and an eighth
    of l^2 times (B3), of which what moves shrinks with the speed that is left.

    Args:
        q, v: (nq,), (nv,) state, in the plant's order; prescribed joints at rest.
        T: braking horizon [s].
        h: control period / T.
        finest: of a face's value, what pieces may add to it; it decides how many there
            are.
        ground, masses: of the robot.
    """
    x = T * v
    speed = np.abs(x)
    bend = bends(q, x, speed, np.zeros(len(v)), T, ground.about, masses)
    F = len(ground.rows)
    most = 0.0
    for f in range(F):
        most = max(most, _bent(bend, 1.0, ground.moment[f], ground.force[f]))
    pieces = min(max(1, int(np.ceil(np.sqrt(most / (8.0 * finest))))), _PIECES)
    values, seen = np.full(F, -np.inf), np.full(F, -np.inf)
    at, share = np.zeros((2, F))
    length = 1.0 / pieces
    for k in range(pieces + 1):
        u = k * length
        # The fastest that the pieces on both sides are passed.
        left = min(1.0, 1.0 - u + length)
        found = wrenches(q + u * x, x, masses)
        for f in range(F):
            still, quick, brake = 0.0, 0.0, 0.0
            for c in range(6):
                r = ground.rows[f, c]
                still += r * found.weight[c]
                quick += r * found.turning[c]
                brake -= r * found.momentum[c]
            value, kappa = _worst(still, quick / T**2, brake / T**2, left, h)
            seen[f] = max(
                seen[f], _worst(still, quick / T**2, brake / T**2, 1.0 - u, h)[0]
            )
            hardest = min(1.0, left / (1.0 - h)) if h < 1.0 else 1.0
            value += (
                0.125
                * length**2
                * _bent(bend, hardest, ground.moment[f], ground.force[f])
            )
            if value > values[f]:
                values[f], at[f], share[f] = value, u, kappa
    return Balanced(values, seen, at, share)


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


@compiled(loops=True)
def examine_step(
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    period: float,
    step: float,
    finest: float,
    ground: Ground,
    masses: Masses,
) -> Balanced:
    """The largest of R w while an acceleration is held for a period.

    Of each piece of it, of the length l, the larger of both ends' and an eighth of l^2
    times (B3). `at` is the share of the period.

    Args:
        q, v, a: (nq,), (nv,), (nv,) state and acceleration, in the plant's order.
        period: [s].
        step: of the plant [s]; 0 if it is continuous.
        finest: as of `examine_braking`.
        ground, masses: of the robot.
    """
    along = period * v + 0.5 * period * (period + step) * a
    fastest = np.abs(v) + (period + 0.5 * step) * np.abs(a)
    bend = bends(q, along, fastest, np.abs(a), 0.0, ground.about, masses)
    F = len(ground.rows)
    most = 0.0
    for f in range(F):
        most = max(most, _bent(bend, 1.0, ground.moment[f], ground.force[f]))
    pieces = int(np.ceil(period * np.sqrt(most / (8.0 * finest))))
    pieces = min(max(1, pieces), _STEP_PIECES)
    values, seen = np.full(F, -np.inf), np.full(F, -np.inf)
    at = np.zeros(F)
    for k in range(pieces + 1):
        u = k / pieces
        t = u * period
        there, speed = q + t * v + 0.5 * t * (t + step) * a, v + t * a
        found = wrenches(there, speed, masses)
        pushed = wrenches(there, a, masses).momentum
        for f in range(F):
            value = 0.0
            for c in range(6):
                value += ground.rows[f, c] * (
                    found.weight[c] + found.turning[c] + pushed[c]
                )
            seen[f] = max(seen[f], value)
            value += (
                0.125
                * (period / pieces) ** 2
                * _bent(bend, 1.0, ground.moment[f], ground.force[f])
            )
            if value > values[f]:
                values[f], at[f] = value, u
    return Balanced(values, seen, at, np.ones(F))


class BalanceLaw(NamedTuple):
    """What the admission of balance needs of a robot and its law."""

    masses: Masses
    ground: Ground
    controlled: np.ndarray  # (n,) velocities of the controlled joints, in the plant's
    T: float  # braking horizon [s]
    period: float  # [s]
    step: float  # of the plant [s]; 0 if it is continuous
    finest: float  # of `examine_braking` [Nm]


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
    h = law.period / law.T
    found = examine_braking(q, v, law.T, h, law.finest, law.ground, law.masses)
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
        The largest R w above its level [Nm]; negative is what is left of it.
    """
    way, path = _examined(q, v, a, held.value)
    return max((way.values - level).max(), (path.values - level).max())


@compiled
def _examined(
    q: np.ndarray, v: np.ndarray, a: np.ndarray, law: BalanceLaw
) -> tuple[Balanced, Balanced]:
    """A step, and the braking path of the state that it leads to."""
    ground, masses = law.ground, law.masses
    way = examine_step(q, v, a, law.period, law.step, law.finest, ground, masses)
    q_next, v_next = next_state(q, v, a, law)
    h = law.period / law.T
    path = examine_braking(q_next, v_next, law.T, h, law.finest, ground, masses)
    return way, path


@compiled(loops=True)
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
    next path's place, velocities and braking do: by differences, of one acceleration
    after the other.

    Args:
        q, v, a, level, held: as of `balance_excess`.
        enough: nobody asks for rows where the excess is not above it [Nm].

    Returns:
        `balance_excess`; and (2 F, n) and (2 F,), or none of either.
    """
    law = held.value
    ground, masses, T = law.ground, law.masses, law.T
    n, F = len(law.controlled), len(ground.rows)
    way, path = _examined(q, v, a, law)
    excess = max((way.values - level).max(), (path.values - level).max())
    if excess <= enough:
        return excess, np.zeros((0, n)), np.zeros(0)
    h = law.period / T
    q_next, v_next = next_state(q, v, a, law)
    g, b = np.zeros((2 * F, n)), np.empty(2 * F)
    bend = 0.5 * law.period * (law.period + law.step)
    done = np.zeros(F, dtype=np.bool_)
    for first in range(F):
        if done[first]:
            continue
        t = way.at[first] * law.period
        of_q = 0.5 * t * (t + law.step)
        at, speed = q + t * v + of_q * a, v + t * a
        change = _changes(at, speed, of_q, t, law)
        pushed = wrenches(at, a, masses).momentum
        for j in range(n):
            # What the acceleration is for the place, and for itself.
            moved, more = at.copy(), a.copy()
            moved[law.controlled[j]] += of_q
            more[law.controlled[j]] += 1.0
            push = wrenches(moved, more, masses).momentum
            for f in range(F):
                if way.at[f] != way.at[first]:
                    continue
                done[f] = True
                for c in range(6):
                    g[f, j] += ground.rows[f, c] * (
                        change[j, 0, c] + change[j, 1, c] + push[c] - pushed[c]
                    )
    done[:] = False
    for first in range(F):
        if done[first]:
            continue
        u = path.at[first]
        at, x = q_next + u * T * v_next, T * v_next
        change = _changes(at, x, bend + u * T * law.period, T * law.period, law)
        momentum = wrenches(at, x, masses).momentum
        for f in range(F):
            if path.at[f] != u:
                continue
            done[f] = True
            kappa, brake = path.share[f], 0.0
            for c in range(6):
                brake -= ground.rows[f, c] * momentum[c]
            most = min(1.0, kappa / (1.0 - h)) if h < 1.0 else 1.0
            share = most if brake > 0.0 else kappa
            for j in range(n):
                for c in range(6):
                    g[F + f, j] += ground.rows[f, c] * (
                        change[j, 0, c]
                        + (kappa**2 * change[j, 1, c] - share * change[j, 2, c]) / T**2
                    )
    for f in range(F):
        b[f] = level[f] - way.values[f]
        b[F + f] = level[f] - path.values[f]
    for row in range(2 * F):
        for j in range(n):
            b[row] += g[row, j] * a[law.controlled[j]]
    return excess, g, b


@compiled(loops=True)
def _changes(
    q: np.ndarray, x: np.ndarray, of_q: float, of_x: float, law: BalanceLaw
) -> np.ndarray:
    """How `wrenches` change with the accelerations of the controlled joints, each of
    which changes its q by `of_q` and its x by `of_x`: (n, 3, 6), by differences.

    Wrenches are quadratic in x: of a small part of these.
    """
    masses, n = law.masses, len(law.controlled)
    here = wrenches(q, x, masses)
    changes = np.empty((n, 3, 6))
    for j in range(n):
        moved, faster = q.copy(), x.copy()
        moved[law.controlled[j]] += _PART * of_q
        faster[law.controlled[j]] += _PART * of_x
        there = wrenches(moved, faster, masses)
        for c in range(6):
            changes[j, 0, c] = (there.weight[c] - here.weight[c]) / _PART
            changes[j, 1, c] = (there.turning[c] - here.turning[c]) / _PART
            changes[j, 2, c] = (there.momentum[c] - here.momentum[c]) / _PART
    return changes
