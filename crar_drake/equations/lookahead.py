"""The lookahead: constraints act where the robot would come to rest.

The paper's W looks at the present configuration, per joint, and lets a joint go
free as soon as its share of a gradient shrinks; it asks for a more rigorous W, an
adaptive Gv and less damping. Here the constraints are imposed where the robot would
come to rest, and only along their gradients. `docs/theory/theorem.md` has the
derivation.

Let T be a braking horizon. Under q_ddot = -q_dot/T the robot comes to rest at

    q_s = q + T q_dot,       and     s = q_dot + T q_ddot

is the velocity of q_s: choosing an acceleration is choosing s, a first-order
problem in q_s. Each watched pair gives two rows (h, g): a distance that must stay
positive, and its gradient, so that h changes by g s per second. Prescribed joints
move it by a known drift as well.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from crar_drake.equations.admission import (
    AS_NOMINAL,
    SCALED,
    check_step,
    examine_present,
    scale_step,
)
from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.handover import take_over
from crar_drake.equations.kinematics import (
    Measured,
    State,
    find_state,
    join_joints,
    row_distances,
)
from crar_drake.equations.lookahead_guard import (
    admit,
    damped_gram,
    guard,
    guard_norm,
    nominal_velocity,
    share_within,
    step_bounds,
)
from crar_drake.equations.lookahead_rows import (
    Constraints,
    Limits,
    LookaheadGains,
    join_constraints,
    limit_constraints,
    limit_margins,
    margin_curvature,
    pair_constraints,
    pair_margins,
    resting_velocity,
    slip_velocity,
    some_of,
    that_weigh,
    weighed_margins,
    with_resting,
)
from crar_drake.equations.preview import preview_plan, previewed_velocity
from crar_drake.equations.references import Targets, find_references
from crar_drake.equations.vectors import identity, smallest, times


class LookaheadMemory(NamedTuple):
    """What one step of the mode leaves to the next."""

    qdot: np.ndarray  # (n,) measured [rad/s]
    qddot: np.ndarray  # (n,) commanded [rad/s^2]
    slip: np.ndarray  # (n,) `slip_velocity` [rad/s]
    weighed: np.ndarray  # (2 Nr + nl,) `weighed_margins` [m, rad]; (0,) of other rows
    plan: np.ndarray  # (N n,) `plan_accelerations` [rad/s^2]; (0,) at a start


@compiled
def lookahead_step(
    measured: Measured,
    targets: Targets,
    robot: Held,
    mode: Held,
    before: LookaheadMemory,
    efforts: np.ndarray,
) -> tuple[np.ndarray, ...]:
    """(L3)-(L13) in their order: one control step of the mode.

    Args:
        measured: the state, and q_s.
        targets: what to do.
        robot: holds a `Robot` with a row for each pair of shapes.
        mode: holds `LookaheadNumbers`.
        before: of the step before; at the first, with q_dot itself and zeros, so that
            nothing slipped, and infinite margins.
        efforts: (k, nv + 2) of `preview.effort_rows`.

    Returns:
        (nv,) accelerations in the plant's order; (m,) Eq. (11) against the targets as
        given; (n,) diagonal of W; (n,) q_dot_c; (n,) slip; (2 Nr + nl,)
        `weighed_margins`; (N n,) the plan, where there is a preview; (2,) the smallest
        distance [m] and the smallest margin to a limit [rad] at q_s; (4,) of `admit`;
        (Nc,) signed distances [m].
    """
    r, numbers = robot.value, mode.value
    limits, gains = numbers.limits.value, numbers.gains
    n, T = r.n, gains.T
    state = find_state(measured, r)
    references = find_references(state, targets, r.rows.value, r.turn, numbers.tasks)
    v, qdot = state.v, state.v[:n]
    slip = slip_velocity(
        before.slip, qdot, before.qdot, before.qddot, T, gains.period, gains.slip_share
    )
    h = pair_margins(state.d, state.dd_dv, v, T)
    s_p = resting_velocity(v[n:], references.qddot_p, T)
    by_pairs = weighed_margins(
        h,
        before.weighed[: len(h)],
        gains.distance_margin,
        gains.retreat_speed * gains.period,
    )
    to_limits = limit_margins(state.q[:n] + T * qdot, limits)
    by_limits = weighed_margins(
        to_limits,
        before.weighed[len(h) :],
        0.0,
        gains.joint_retreat_speed * gains.period,
    )
    constraints = find_constraints(
        state, h, by_pairs, to_limits, by_limits, s_p, slip, limits, gains
    )
    normal = damped_gram(references.J, gains)
    preview, plan = numbers.preview.value, before.plan
    if len(preview.times):
        plan = preview_plan(
            state, references, targets.posture, before.plan, efforts, r, numbers
        )
        s_0, qdot_c, W = previewed_velocity(plan, qdot, gains, preview)
    else:
        weighed_rows = constraints
        if gains.approach_rate > 0.0:
            weighed_rows = some_of(constraints, np.arange(0))
        s_0, qdot_c, W, _ = nominal_velocity(
            references.J,
            normal,
            references.v_r,
            references.a_r,
            qdot,
            references.posture,
            weighed_rows,
            gains,
            references.qdot_0,
            references.qddot_0,
        )
    norm = guard_norm(normal, gains)
    s_1, _ = guard(s_0, constraints, norm)
    s, s_p, admission = admit(
        s_0, s_p, s_1, state.q, v, state.d, constraints, norm, r, numbers
    )
    margins = np.full(2, np.inf)
    if len(h):
        margins[0] = state.d[1].min()
    if len(to_limits):
        margins[1] = to_limits.min()
    d = state.d[0]
    if len(numbers.members) < len(d):
        d = d[smallest(d, numbers.members)]
    qddot_p = references.qddot_p
    if admission[1] < 1.0:
        qddot_p = (s_p - v[n:]) / T
    vdot = join_joints((s - qdot) / T, qddot_p, r.order)
    weighed = np.concatenate((by_pairs, by_limits))
    error = references.error
    return vdot, error, W, qdot_c, slip, weighed, plan, margins, admission, d


@compiled
def find_constraints(
    state: State,
    h: np.ndarray,
    by_pairs: np.ndarray,
    to_limits: np.ndarray,
    by_limits: np.ndarray,
    s_p: np.ndarray,
    slip: np.ndarray,
    limits: Limits,
    gains: LookaheadGains,
) -> Constraints:
    """The rows of pairs and of limits that weigh.

    Args:
        state: of the robot.
        h, by_pairs: (2 Nr,) margins of the pairs, and those by which they weigh [m].
        to_limits, by_limits: (nl,) the same of limits [rad].
        s_p: (n_p,) velocity of q_s of the prescribed joints.
        slip: (n,) that is expected to go on [rad/s].
        limits, gains: of the mode.
    """
    n, v = len(slip), state.v
    by_joint = state.dd_dv.reshape(len(h), len(v))
    pairs = pair_constraints(
        h,
        by_pairs,
        np.ascontiguousarray(by_joint[:, :n]),
        times(by_joint[:, n:], s_p) + margin_curvature(state.dd_dv, v),
        slip,
        gains,
    )
    at_limits = limit_constraints(to_limits, by_limits, slip, limits, gains)
    return join_constraints(pairs, that_weigh(at_limits))


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
    measured: Measured, vdot: np.ndarray, robot: Held, mode: Held
) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations whose step is clear, between the given ones and braking.

    For what the effort limits have changed after `admit`.

    Args:
        measured: the state, and q_s.
        vdot: (nv,) accelerations in the plant's order.
        robot, mode: as in `lookahead_step`.

    Returns:
        (nv,) accelerations; (4,) of `admit`.
    """
    r, numbers = robot.value, mode.value
    admission, reaches = numbers.admission, numbers.reaches
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
    measured: Measured, vdot: np.ndarray, robot: Held, mode: Held
) -> tuple[np.ndarray, np.ndarray]:
    """What guard and `admit` leave of accelerations that were chosen elsewhere.

    For those of another horizon: the guard changes what this one's rows ask for, and
    no joint besides, where `scale_acceleration` slows all of them down.

    Args, returns: as of `scale_acceleration`.
    """
    r, numbers = robot.value, mode.value
    limits, gains = numbers.limits.value, numbers.gains
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
    s_1, _ = guard(s_0, constraints, norm)
    s_c, s_p, admission = admit(
        s_0, s[n:], s_1, state.q, v, state.d, constraints, norm, r, numbers
    )
    if not (s_c == s_0).all() or admission[1] < 1.0:
        vdot = join_joints((s_c - qdot) / T, (s_p - v[n:]) / T, r.order)
    return vdot, admission


class LookaheadLaw(NamedTuple):
    """All that stays from step to step."""

    robot: Held  # of a `Robot` with a row for each pair of shapes
    mode: Held  # of `LookaheadNumbers`


@compiled
def lookahead_or_scaled(
    q: np.ndarray,
    v: np.ndarray,
    asked: np.ndarray,
    tasks: np.ndarray,
    prescribed: np.ndarray,
    posture: np.ndarray,
    R: np.ndarray,
    p: np.ndarray,
    q_p: np.ndarray,
    q_t: np.ndarray,
    s: float,
    s_dot: float,
    s_ddot: float,
    v_before: np.ndarray,
    vdot_before: np.ndarray,
    kept: np.ndarray,
    efforts: np.ndarray,
    accelerations: np.ndarray,
    guarded: bool,
    law: Held,
) -> np.ndarray:
    """`lookahead_step`, from arrays to one; or `scale_acceleration` or
    `guard_acceleration`, which are next to nothing to compile beside it and would else
    be half as much again.

    Args:
        q, v, asked: of the state, in the plant's order, see `handover.hand_over`; what
            was asked in both configurations.
        tasks, prescribed, posture, R, p, q_p, q_t, s, s_dot, s_ddot: the targets, of
            `handover.hand_over`; any where there are accelerations.
        v_before, vdot_before: (nv,), (nv,) velocities one period ago, and what was
            commanded then, in the plant's order.
        kept: (n + 2 Nr + nl + N n,) slip, margins and plan of `LookaheadMemory`.
        efforts: (k, nv + 2) of `preview.effort_rows`; any where there are
            accelerations.
        accelerations: (nv,) that are to be scaled or guarded; (0,) for a step.
        guarded: which of the two.
        law: holds `LookaheadLaw`.

    Returns:
        What `lookahead_step` returns, one after the other; else (nv,) accelerations and
        (4,) of `admit`.
    """
    robot, mode = law.value.robot, law.value.mode
    r, n = robot.value, robot.value.n
    measured = Measured(with_resting(q, v, r, mode.value.gains.T), v, asked)
    if len(accelerations) and guarded:
        return np.concatenate(guard_acceleration(measured, accelerations, robot, mode))
    if len(accelerations):
        return np.concatenate(scale_acceleration(measured, accelerations, robot, mode))
    controlled, planned = r.order[:n], n * len(mode.value.preview.value.times)
    return np.concatenate(
        lookahead_step(
            measured,
            take_over(tasks, prescribed, posture, R, p, q_p, q_t, s, s_dot, s_ddot),
            robot,
            mode,
            LookaheadMemory(
                v_before[controlled],
                vdot_before[controlled],
                kept[:n],
                kept[n : len(kept) - planned],
                kept[len(kept) - planned :],
            ),
            efforts,
        )
    )
