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

from typing import NamedTuple

import numpy as np

from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.handover import take_over
from crar_drake.equations.kinematics import Measured, find_state, join_joints
from crar_drake.equations.lookahead_guard import (
    admit,
    damped_gram,
    guard,
    guard_norm,
    nominal_velocity,
)
from crar_drake.equations.lookahead_rows import (
    find_constraints,
    limit_margins,
    pair_margins,
    resting_velocity,
    slip_velocity,
    some_of,
    weighed_margins,
    with_resting,
)
from crar_drake.equations.preview import preview_plan, previewed_velocity
from crar_drake.equations.references import Targets, find_references
from crar_drake.equations.vectors import smallest
from crar_drake.equations.within_efforts import limited_acceleration, scale_acceleration


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
    references = find_references(state, targets, r.rows.value, numbers.tasks)
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
        s_0, qdot_c, W = nominal_velocity(
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
    s_1 = guard(s_0, constraints, norm)
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
    law: Held,
) -> np.ndarray:
    """`lookahead_step`, from arrays to one; or `scale_acceleration` or
    `limited_acceleration`, which are next to nothing to compile beside it and would
    else be half as much again.

    Args:
        q, v, asked: of the state, in the plant's order, see `handover.hand_over`; what
            was asked in both configurations.
        tasks, prescribed, posture, R, p, q_p, q_t, s, s_dot, s_ddot: the targets, of
            `handover.hand_over`; any where there are accelerations.
        v_before, vdot_before: (nv,), (nv,) velocities one period ago, and what was
            commanded then, in the plant's order.
        kept: (n + 2 Nr + nl + N n,) slip, margins and plan of `LookaheadMemory`.
        efforts: (nu, nv + 2) of `preview.effort_rows`, (0, nv + 2) without limits.
        accelerations: (nv,) that are to be scaled, or where there are efforts limited;
            (0,) for a step.
        law: holds `LookaheadLaw`.

    Returns:
        What the one of the three returns, one after the other.
    """
    robot, mode = law.value.robot, law.value.mode
    r, n = robot.value, robot.value.n
    measured = Measured(with_resting(q, v, r, mode.value.gains.T), v, asked)
    if len(accelerations) and len(efforts):
        found = limited_acceleration(
            measured, accelerations, efforts, robot, mode.value
        )
        return np.concatenate(found)
    if len(accelerations):
        found = scale_acceleration(measured, accelerations, robot, mode.value)
        return np.concatenate(found)
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
