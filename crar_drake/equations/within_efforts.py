"""Accelerations that the effort limits have changed, admitted again; and over how long
a robot brakes whose motors are weak.

`equations.torque_limit` finds accelerations within the limits, and the guard and the
admission leave of them what is clear. Where motors have not the torque to brake within
the horizon T, they may have it for a longer one, whose braking path is then looked at.
"""

import numpy as np

from crar_drake.equations.admission import (
    AS_NOMINAL,
    SCALED,
    AdmissionGains,
    check_step,
    examine_present,
    scale_step,
)
from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.kinematics import (
    Measured,
    find_state,
    join_joints,
    row_distances,
)
from crar_drake.equations.lookahead_guard import (
    LookaheadNumbers,
    admit,
    guard,
    share_within,
    step_bounds,
)
from crar_drake.equations.lookahead_rows import (
    LookaheadGains,
    find_constraints,
    limit_margins,
    pair_margins,
    resting_velocity,
    with_resting,
)
from crar_drake.equations.prediction import state_ahead
from crar_drake.equations.torque_limit import (
    clip_torque,
    limit_torque,
    nearest_accelerations,
    next_braking_torque,
    share_of_nominal,
)
from crar_drake.equations.vectors import identity, largest, put, times

# What `nearest_accelerations` and rounding leave beyond a limit is no excess [1].
NO_EXCESS = 1e-4
# The next braking torque is aimed to need 80 % of a limit at most, and to be possible
# is judged by the accelerations alone: so much counts as possible [1].
_SURE = 0.9
# So much left of the nominal accelerations is as good as all: no other is tried; and
# none that promises no more than this beyond what is left already [1].
_ENOUGH, _NO_MORE = 0.99, 0.05
# So many horizons' accelerations are looked at, if any of them will do: each takes as
# long as a guard and an admission.
_LOOKS = 2
# Nothing was admitted, for nothing was changed: in the place of how it was.
NOT_ASKED = -1.0


@compiled
def acceleration_bounds(
    measured: Measured, robot: Held, mode: Held
) -> tuple[np.ndarray, np.ndarray]:
    """`step_bounds` as accelerations, (n,), (n,) [rad/s^2]; arguments as below."""
    r, numbers = robot.value, mode.value
    q, v = measured.q[0][r.positions], measured.v[r.order]
    lowest, highest = step_bounds(q, v, r.n, numbers.limits.value, numbers.admission)
    qdot, T = v[: r.n], numbers.admission.T
    return (lowest - qdot) / T, (highest - qdot) / T


@compiled
def scale_acceleration(
    measured: Measured, vdot: np.ndarray, robot: Held, numbers: LookaheadNumbers
) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations whose step is clear, between the given ones and braking.

    For what the effort limits have changed after `admit`.

    Args:
        vdot: (nv,) accelerations in the plant's order.

    Returns:
        (nv,) accelerations; (4,) of `admit`.
    """
    r, admission, reaches = robot.value, numbers.admission, numbers.reaches
    T, v = admission.T, measured.v[r.order]
    q, s = measured.q[0][r.positions], resting_velocity(v, vdot[r.order], admission.T)
    limits = numbers.limits.value
    inside = share_within(s, *step_bounds(q, v, r.n, limits, admission))
    s = inside * s
    d = row_distances(measured, r)
    present = examine_present(q, v, s, d, r, reaches, admission)
    checked = check_step(q, v, s, present, r, reaches, admission)
    how, share, clearance = AS_NOMINAL, 1.0, checked.clearance
    if not checked.clear:
        share, clearance = scale_step(q, v, s, present, r, reaches, admission)
        s = share * s
    share *= inside
    if share < 1.0:
        how = SCALED
        qddot = (s - v) / T
        vdot = join_joints(qddot[: r.n], qddot[r.n :], r.order)
    clearance = min(clearance, present.low.min()) if len(present.low) else np.inf
    return vdot, np.array([how, share, clearance, 1.0 if present.held else 0.0])


@compiled
def guard_acceleration(
    measured: Measured, vdot: np.ndarray, robot: Held, numbers: LookaheadNumbers
) -> tuple[np.ndarray, np.ndarray]:
    """What guard and `admit` leave of accelerations that were chosen elsewhere.

    For those of another horizon: the guard changes what this one's rows ask for, and
    no joint besides, where `scale_acceleration` slows all of them down.

    Args, returns: as of `scale_acceleration`.
    """
    r, limits, gains = robot.value, numbers.limits.value, numbers.gains
    n, T = r.n, gains.T
    state = find_state(measured, r)
    v, qdot = state.v, state.v[:n]
    s = resting_velocity(v, vdot[r.order], T)
    present = examine_present(
        state.q, v, s, state.d, r, numbers.reaches, numbers.admission
    )
    if not present.held:
        return vdot, np.array([SCALED, 0.0, present.low.min(), 0.0])
    h = pair_margins(state.d, state.dd_dv, v, T)
    to_limits = limit_margins(state.q[:n] + T * qdot, limits)
    constraints = find_constraints(
        state, h, h, to_limits, to_limits, s[n:], np.zeros(n), limits, gains
    )
    s_0, norm = s[:n], identity(n)
    s_1 = guard(s_0, constraints, norm)
    s_c, s_p, admission = admit(
        s_0, s[n:], s_1, state.q, v, state.d, constraints, norm, r, numbers
    )
    if not (s_c == s_0).all() or admission[1] < 1.0:
        vdot = join_joints((s_c - qdot) / T, (s_p - v[n:]) / T, r.order)
    return vdot, admission


@compiled
def with_horizon(numbers: LookaheadNumbers, T: float) -> LookaheadNumbers:
    """The same numbers with another braking horizon [s]."""
    return LookaheadNumbers(
        numbers.tasks,
        numbers.limits,
        LookaheadGains(T, *numbers.gains[1:]),
        AdmissionGains(T, *numbers.admission[1:]),
        *numbers[4:],
    )


@compiled
def effort_excess(tau: np.ndarray, limits: np.ndarray) -> float:
    """By which share of its limit the worst of the torques (nu,) is beyond it [1]."""
    return max(0.0, largest(tau / limits) - 1.0)


@compiled
def may_go_on(
    vdot: np.ndarray,
    v: np.ndarray,
    n: int,
    efforts: np.ndarray,
    T: float,
    period: float,
) -> bool:
    """Whether the next step's braking takes at most 90 % of the limits.

    Args:
        vdot, v: (nv,) accelerations and velocities, in the robot's order.
        n: number of the controlled joints, which brake; the others go on so.
        efforts: of `limited_acceleration`.
        T, period: [s].
    """
    nv = len(vdot)
    A = np.ascontiguousarray(efforts[:, :nv])
    tau = times(A, vdot) + efforts[:, nv]
    tau = next_braking_torque(vdot, tau, A, v, np.arange(n), T, period)
    return effort_excess(tau, _SURE * efforts[:, nv + 1]) <= 0.0


@compiled
def rank_of(
    vdot: np.ndarray,
    excess: float,
    nominal: np.ndarray,
    v: np.ndarray,
    n: int,
    efforts: np.ndarray,
    T: float,
    horizon: float,
    period: float,
) -> float:
    """How good accelerations are that a braking horizon leaves of the nominal ones.

    2 and the share that is left where the next step's braking is within the limits;
    else how long it takes [s], the more of it the better; else less than 0, by how much
    it is beyond.

    Args:
        vdot, nominal, v: (nv,), in the robot's order.
        excess: of vdot, beyond the limits [1].
        n, efforts, period: as in `may_go_on`.
        T, horizon: this one, and the shortest one [s].
    """
    if excess > NO_EXCESS:
        return -excess
    if may_go_on(vdot, v, n, efforts, T, period):
        return 2.0 + share_of_nominal(vdot, nominal, v[:n], horizon)
    return min(T, 1.0)


@compiled
def within_limits(
    nominal: np.ndarray,
    v: np.ndarray,
    n: int,
    efforts: np.ndarray,
    lowest: np.ndarray,
    highest: np.ndarray,
    T: float,
    period: float,
) -> tuple[np.ndarray, np.ndarray]:
    """What a braking horizon T leaves of the nominal accelerations within the limits.

    Args:
        nominal, v: (nv,) accelerations and velocities, in the robot's order.
        efforts: of `limited_acceleration`.
        lowest, highest: (n,) bounds of their accelerations [rad/s^2].
        T, period: [s].

    Returns:
        (2, nv) the nearest accelerations, of the controlled joints, or where that is
        not enough, of all; and a share of the nominal ones; (2,) their excesses. Both
        are the nominal ones if these are within the limits.
    """
    nv = len(nominal)
    A, limits = np.ascontiguousarray(efforts[:, :nv]), efforts[:, nv + 1].copy()
    tau, every = times(A, nominal) + efforts[:, nv], np.arange(nv)
    found, excess = np.empty((2, nv)), np.zeros(2)
    for giving_way in (n, nv):
        slowed, _, left = limit_torque(
            nominal, tau, A, v, every[:giving_way], limits, T, period
        )
        put(found[1], 0, slowed)
        excess[1] = left[1]
        if left[1] == 0.0:
            break
    put(found[0], 0, found[1])
    if excess[1] == 0.0 and left[0] == 1.0:
        return found, excess
    low, high = np.full(nv, -np.inf), np.full(nv, np.inf)
    put(low, 0, lowest)
    put(high, 0, highest)
    for giving_way in (n, nv):
        near = nearest_accelerations(
            nominal,
            tau,
            A,
            v,
            every[:giving_way],
            limits,
            low[:giving_way],
            high[:giving_way],
            T,
            period,
        )
        torque = times(A, near) + efforts[:, nv]
        for braking in (n, nv):
            slowed, _, left = limit_torque(
                near, torque, A, v, every[:braking], limits, T, period
            )
            if left[1] == 0.0:
                break
        put(found[0], 0, slowed)
        excess[0] = left[1]
        if excess[0] <= NO_EXCESS:
            break
    return found, excess


@compiled
def admitted_over(
    measured: Measured,
    vdot: np.ndarray,
    efforts: np.ndarray,
    T: float,
    robot: Held,
    numbers: LookaheadNumbers,
) -> tuple[np.ndarray, np.ndarray, bool]:
    """What the admission with a horizon T leaves of accelerations within the limits.

    A longer path than that of the mode is made clear by the guard of its own T, so that
    a torso does not lag for an arm; by scaling alone where what the guard makes of them
    would be beyond the limits.

    Args:
        measured, efforts, robot, numbers: of `limited_acceleration`.
        vdot: (nv,) in the plant's order.
        T: [s].

    Returns:
        (nv,) accelerations; (4,) of `admit`; whether the robot may brake so.
    """
    r, nv = robot.value, len(vdot)
    if T == numbers.gains.T:
        found, admission = scale_acceleration(measured, vdot, robot, numbers)
        return found, admission, True
    n, limits = r.n, numbers.limits.value
    ends = measured.q[0][r.positions[:n]] + T * measured.v[r.order[:n]]
    if not ((ends >= limits.lower).all() and (ends <= limits.upper).all()):
        return vdot, np.array([SCALED, 0.0, 0.0, 0.0]), False
    numbers = with_horizon(numbers, T)
    q, v = measured.q[0], measured.v
    measured = Measured(with_resting(q, v, r, T), v, measured.asked)
    found, admission = guard_acceleration(measured, vdot, robot, numbers)
    if not admission[3] == 1.0:
        return found, admission, False
    there = found[r.order]
    tau = times(np.ascontiguousarray(efforts[:, :nv]), there) + efforts[:, nv]
    if effort_excess(tau, efforts[:, nv + 1]) > NO_EXCESS or not may_go_on(
        there, v[r.order], n, efforts, T, numbers.gains.period
    ):
        found, admission = scale_acceleration(measured, vdot, robot, numbers)
    return found, admission, True


@compiled
def limited_acceleration(
    measured: Measured,
    vdot: np.ndarray,
    efforts: np.ndarray,
    robot: Held,
    numbers: LookaheadNumbers,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The nominal accelerations, or the nearest within the limits that are clear.

    Where the motors have not the torque to brake within the horizon, they may have it
    for a longer one. That counts if this braking path is clear, too, as it then is
    after the step. Of those from which braking is possible for the motors again, what
    leaves the most of the nominal ones is taken; the first that leaves nearly all.
    Horizons over which the motors cannot brake now are tried only if no other will do.

    To look whether a path is clear takes long. So the limits are asked first, of all
    horizons, and the most promising one is looked at first: the admission leaves less.

    Args:
        vdot: (nv,) the nominal accelerations, admitted for the shortest horizon, in
            the plant's order.
        efforts: (nu, nv + 2) A, in the robot's order, b and the limit of each motor, by
            which |A q_ddot + b| is to be at most the limit.

    Returns:
        (nv,) accelerations; (nu,) their torque, clipped; (2,) how much is left of the
        nominal ones, and the excess before clipping; (nq + nv,) the state that they
        lead to; (4,) of `admit`, NOT_ASKED first if nothing was changed.
    """
    r, horizons, period = robot.value, numbers.horizons, numbers.gains.period
    n, nv = r.n, len(vdot)
    v, nominal = measured.v[r.order], vdot[r.order]
    q, limits = measured.q[0][r.positions], efforts[:, nv + 1].copy()
    # Two of each horizon, and how good they promise to be.
    candidates = np.empty((2 * len(horizons), nv))
    promises = np.full(len(candidates), -np.inf)
    may_brake, clear = np.zeros(len(horizons), dtype=np.bool_), len(horizons)
    for k in range(len(horizons)):
        T = horizons[k]
        lowest, highest = step_bounds(
            q, v, n, numbers.limits.value, with_horizon(numbers, T).admission
        )
        found, excess = within_limits(
            nominal,
            v,
            n,
            efforts,
            (lowest - v[:n]) / T,
            (highest - v[:n]) / T,
            T,
            period,
        )
        braking = nominal.copy()
        put(braking, 0, -v[:n] / T)
        tau = times(np.ascontiguousarray(efforts[:, :nv]), braking) + efforts[:, nv]
        may_brake[k] = effort_excess(tau, limits) <= 0.0
        for i in range(2):
            put(candidates[2 * k + i], 0, found[i])
            if i == 0 or not (found[0] == found[1]).all():
                promises[2 * k + i] = rank_of(
                    found[i], excess[i], nominal, v, n, efforts, T, horizons[0], period
                )
        if may_brake[k] and promises[2 * k] >= 2.0 + _ENOUGH:
            break
    best, chosen, looks = -np.inf, vdot, 0
    admission = np.array([NOT_ASKED, 1.0, np.nan, np.nan])
    for now in (True, False):
        while best < 2.0 + _ENOUGH and (best < 2.0 or looks < _LOOKS):
            j, least = -1, best + _NO_MORE if best >= 2.0 else best
            for i in range(len(promises)):
                if may_brake[i // 2] == now and promises[i] > least:
                    if j < 0 or promises[i] > promises[j]:
                        j = i
            if j < 0:
                break
            k, promised = j // 2, promises[j]
            promises[j] = -np.inf
            if k >= clear:
                continue
            if k == 0 and (candidates[j] == nominal).all():
                best, chosen = promised, vdot  # admitted as it is
                continue
            there = join_joints(candidates[j][:n], candidates[j][n:], r.order)
            looks += 1
            found, reported, may = admitted_over(
                measured, there, efforts, horizons[k], robot, numbers
            )
            if not may:
                clear = k  # nor are longer ones
                continue
            there = found[r.order]
            tau = times(np.ascontiguousarray(efforts[:, :nv]), there) + efforts[:, nv]
            rank = rank_of(
                there,
                effort_excess(tau, limits),
                nominal,
                v,
                n,
                efforts,
                horizons[k],
                horizons[0],
                period,
            )
            if rank > best:
                best, chosen, admission = rank, found, reported
        if best >= 2.0:
            break
    there = chosen[r.order]
    tau = times(np.ascontiguousarray(efforts[:, :nv]), there) + efforts[:, nv]
    tau, excess = clip_torque(tau, limits)
    share = share_of_nominal(there, nominal, v[:n], horizons[0])
    after = state_ahead(
        measured.q[0],
        measured.v,
        chosen,
        period,
        numbers.admission.step,
        r.positions,
        r.order,
    )
    return (chosen, tau, np.array([share, excess]), after, admission)
