"""The nominal of a plan: accelerations that have seen what comes next, (L10)-(L14).

Feedback on the present error alone begins to evade an obstacle when it is there, and
then needs high gains to make up for it. Here the accelerations of the next moment,
some 0.2 s, are chosen as a whole: those that follow the targets, as they are expected
to go on, the closest with the least acceleration, and past the obstacles. Only the
first of them is the nominal one, and all are chosen anew at the next step: a
receding-horizon plan. `docs/theory/theorem.md` has the derivation.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.approach import SHARE_OF_RANGE, Approach
from crar_drake.law.capsule_distances import (
    distance_gradient_about_origin,
    nearest_points,
)
from crar_drake.law.compilation import Held, compiled, hold
from crar_drake.law.constraints import RobotConstraints
from crar_drake.law.kinematics import find_state, joint_motion
from crar_drake.law.one_sided import one_sided_nearest_in
from crar_drake.law.parameters import Resolved
from crar_drake.law.path_balls import Shapes, near_on_way, place_postures
from crar_drake.law.references import (
    Nominal,
    References,
    Targets,
    TaskGains,
    find_references,
)
from crar_drake.law.vectors import (
    add_to_diagonal,
    cholesky,
    cholesky_solve,
    cholesky_solve_matrix,
    gram,
    product,
    put,
    times,
    transposed_times,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.workspace import Workspace

_NO_PLAN = np.zeros(0)
# The instants are at these shares of the preview: close together at first, for only
# the first acceleration is used, and what is farther ahead is known less well.
_INSTANTS = np.array([1.0, 3.0, 6.0, 10.0, 16.0]) / 16.0
# What a row weighs beside an error of 1 m: a contact gives way to no target.
_ROW_WEIGHT = 300.0
# Pairs farther apart than this at an instant have no row there [m]; the same of joints
# and their limits [rad].
_NEAR = 0.1
_NEAR_LIMIT = 0.3
# Joints that are slower than this share of the fastest at an instant have no row [1].
_NEAR_SPEED = 0.7
# Motors of which less than this share of their limit is asked have no row [1].
_NEAR_EFFORT = 0.6
# What a whole limit counts [m], and the share that plans use [1].
_EFFORT = 0.03
_SPARE_EFFORT = 0.97
# The shares of a joint's way from the rest posture to a limit from which on the null
# space is drawn back, and from which on all the way [1].
_DRAWN, _DRAWN_WHOLLY = 0.5, 0.6


class Preview(NamedTuple):
    """What the preview is made with, by `make_preview`; N instants."""

    times: np.ndarray  # (N,) tau, the instants, from now on [s]
    lengths: np.ndarray  # (N,) of the parts of constant acceleration that end there [s]
    weights: np.ndarray  # (N,) of the errors at the instants [s]
    # (N, N) C, how far an acceleration of 1 in part j has led at instant i [s^2]
    moved: np.ndarray
    # h, how long after an instant rows ask where the robot is: a control period [s]
    coasting: float
    # (N, N) as C, that long after the instant and without acceleration since [s^2]
    coasted: np.ndarray
    errors: np.ndarray  # (N, N) C^T diag(weights) C
    tasks: np.ndarray  # (N, 3) C^T diag(weights) [1, tau, tau^2/2]
    efforts: np.ndarray  # (N,) rho^2 of each part
    pull: np.ndarray  # (N, N) H, the null space's share of (L12) [1]
    damping: float  # of the null space [1/s]
    stiffness: float  # and its pull to the nominal posture [1/s^2]
    farthest: float  # of (L13) [rad or m]
    task_damping: float  # lambda of N in (L12) [m]


def make_preview(ahead: Resolved, period: float) -> Preview:
    """The preview's numbers, which stay the same, with a control period [s]."""
    least = period * (1.0 + np.arange(len(_INSTANTS)))
    at = np.maximum(ahead.preview * _INSTANTS, least)
    lengths = np.diff(at, prepend=0.0)
    # A trapezoidal rule over the preview.
    weights = 0.5 * (lengths + np.append(lengths, 0.0)[1:])
    begun = np.tri(len(at))
    moved = begun * lengths * (at[:, np.newaxis] - at + 0.5 * lengths)
    weighed = moved.T * weights
    pull = ahead.damping * begun * lengths + ahead.stiffness * moved
    return Preview(
        at,
        lengths,
        weights,
        moved,
        float(period),
        moved + period * begun * lengths,
        np.ascontiguousarray(weighed @ moved),
        weighed @ np.column_stack([np.ones(len(at)), at, 0.5 * at**2]),
        ahead.smoothness**2 * lengths,
        pull,
        *(ahead.damping, ahead.stiffness),
        *(ahead.farthest_pull, ahead.null_space_damping),
    )


@compiled
def shifted_plan(plan: np.ndarray, preview: Preview, n: int) -> np.ndarray:
    """The last plan, from now on, (N, n) [rad/s^2]: 0 beyond its end.

    Args:
        plan: (N n,) of one period ago; (0,) at a start.
    """
    N = len(preview.times)
    shifted = np.zeros((N, n))
    if not len(plan):
        return shifted
    for i in range(N):
        middle = preview.times[i] - 0.5 * preview.lengths[i] + preview.coasting
        for j in range(N):
            if middle <= preview.times[j]:
                shifted[i] = plan[j * n : (j + 1) * n]
                break
    return shifted


@compiled
def expected_motion(
    v: np.ndarray, qddot_p: np.ndarray, plan: np.ndarray, preview: Preview
) -> np.ndarray:
    """(L10): x (N, nv), how far joints have moved, a period h after each instant [rad
    or m], if they coast from then on:

        x_i = (tau_i + h) q_dot + sum_j (C_ij + h length_j) q_ddot_j,    j <= i,

    of the prescribed joints with the one acceleration that they have now.
    `docs/theory/theorem.md` says what h is for.

    Args:
        v: (nv,) velocities.
        qddot_p: (n_p,) of the prescribed joints.
        plan: (N, n) accelerations of the others.
    """
    N, n = plan.shape
    x = np.zeros((N, len(v)))
    for i in range(N):
        tau, h = preview.times[i], preview.coasting
        for k in range(len(v)):
            x[i, k] = (tau + h) * v[k]
            if k >= n:
                x[i, k] += (0.5 * tau + h) * tau * qddot_p[k - n]
                continue
            for j in range(i + 1):
                x[i, k] += preview.coasted[i, j] * plan[j, k]
    return x


@compiled
def possible_motion(
    x: np.ndarray,
    q: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    fastest: float,
    preview: Preview,
) -> np.ndarray:
    """A motion (N, nv) that is no faster, and no farther than to the joint limits.

    What is linear about the last plan says nothing far from where robots can be, and a
    plan that has been led there would lead the next one on.

    Args:
        x: (N, nv) `expected_motion` [rad or m].
        q: (nv,) positions.
        lower, upper: (n,) limits of the controlled joints.
        fastest: [rad/s or m/s].
    """
    possible = x.copy()
    for c in range(len(lower)):
        before = 0.0
        for i in range(len(x)):
            since = preview.lengths[i] + (preview.coasting if i == 0 else 0.0)
            most = fastest * since
            at = min(max(x[i, c], before - most), before + most)
            # Where a joint is beyond its limit already, that is where it may be.
            at = max(at, min(lower[c] - q[c], 0.0))
            at = min(at, max(upper[c] - q[c], 0.0))
            possible[i, c] = before = at
    return possible


@compiled
def pair_rows_ahead(
    q: np.ndarray,
    v: np.ndarray,
    x: np.ndarray,
    approach: Approach,
    shapes: Shapes,
    preview: Preview,
) -> tuple[np.ndarray, np.ndarray]:
    """(L11): what a plan has to keep of pairs.

    Where x leads with instant i, a pair has the distance d and the gradient g; another
    plan, to x_i', changes it by g (x_i' - x_i). What is in violation now is to leave at
    its retreat speed, however deep it is, and not at once.

    Args:
        q, v: (nv,), (nv,) state.
        x: (N, nv) `possible_motion` of the last plan.

    Returns:
        (C, N n) rows and (C,) the least of each that is asked for.
    """
    r, balls = shapes.robot.value, shapes.balls.value
    pairs = r.pairs.value
    N, n = len(x), r.n
    postures = np.concatenate((q + x, q.reshape(1, -1)))
    points, centres = place_postures(postures, r, balls)
    S, still = joint_motion(points[:, : 3 * len(q)]), np.zeros(len(balls.radius))
    all_rows, all_least = np.zeros((0, N * n)), np.zeros(0)
    for i in range(N):
        until = preview.times[i] + preview.coasting
        at = centres[i : i + 1], points[i : i + 1]
        some, _ = near_on_way(*at, still, _NEAR, pairs, balls)
        if not len(some):
            continue
        d, normal, p, _ = nearest_points(points[i], pairs, some)
        now, _, _, _ = nearest_points(points[N], pairs, some)
        near = np.flatnonzero(d < _NEAR)
        g = distance_gradient_about_origin(
            normal[near], p[near], S[i], pairs.moves[some[near]]
        )
        rows, least = np.zeros((len(near), N * n)), np.empty(len(near))
        for found in range(len(near)):
            k = near[found]
            gradient = g[found, :n]
            for j in range(i + 1):
                put(rows[found], j * n, preview.coasted[i, j] * gradient)
            change = (gradient * (x[i, :n] - until * v[:n])).sum()
            left = now[k] + approach.retreat_speed * until
            least[found] = min(approach.distance_margin, left) - d[k] + change
        all_rows = np.concatenate((all_rows, rows))
        all_least = np.concatenate((all_least, least))
    return all_rows, all_least


@compiled
def limit_rows_ahead(
    q: np.ndarray,
    v: np.ndarray,
    x: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    approach: Approach,
    preview: Preview,
) -> tuple[np.ndarray, np.ndarray]:
    """(L11) of joint limits (n,), (n,); as `pair_rows_ahead`."""
    N, n = len(x), len(lower)
    rows, least, found = np.zeros((2 * N * n, N * n)), np.empty(2 * N * n), 0
    for i in range(N):
        until = preview.times[i] + preview.coasting
        for c in range(n):
            margin = min(approach.limit_margin, SHARE_OF_RANGE * (upper[c] - lower[c]))
            for inward in (1.0, -1.0):
                limit = lower[c] if inward > 0.0 else upper[c]
                if not inward * (q[c] + x[i, c] - limit) < _NEAR_LIMIT:
                    continue
                for j in range(i + 1):
                    rows[found, j * n + c] = inward * preview.coasted[i, j]
                left = inward * (q[c] - limit) + approach.joint_retreat_speed * until
                unmoved = inward * (q[c] + until * v[c] - limit)
                least[found] = min(margin, left) - unmoved
                found += 1
    return rows[:found], least[:found]


@compiled
def speed_rows(
    qdot: np.ndarray, plan: np.ndarray, fastest: float, preview: Preview
) -> tuple[np.ndarray, np.ndarray]:
    """(L12): rows of joints that the last plan makes near too fast.

        |q_dot + sum_{j <= i} length_j q_ddot_j| <= fastest

    times the whole preview, so that all rows are of distances. The others need not be
    slower for them, as they would be if all were scaled.

    Args:
        qdot: (n,) velocities.
        plan: (N, n) the last one.
        fastest: [rad/s or m/s].
    """
    N, n = plan.shape
    rows, least, found = np.zeros((N * n, N * n)), np.empty(N * n), 0
    led = qdot.copy()
    for i in range(N):
        for k in range(n):
            led[k] += preview.lengths[i] * plan[i, k]
            if abs(led[k]) > _NEAR_SPEED * fastest:
                slower = -np.sign(led[k]) * preview.times[-1]
                for j in range(i + 1):
                    rows[found, j * n + k] = slower * preview.lengths[j]
                least[found] = -fastest * preview.times[-1] - slower * qdot[k]
                found += 1
    return rows[:found], least[:found]


@compiled
def effort_rows(
    efforts: np.ndarray, qddot_p: np.ndarray, plan: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(L12): rows of motors of which the last plan asks for much.

        |A q_ddot_i + b| <= limit,

    with inertia and bias as they are now, of the limit's share, times `_EFFORT`.

    Args:
        efforts: (k, nv + 2) of each motor: A, in the robot's order, b, and the limit.
        qddot_p: (n_p,) of the prescribed joints.
        plan: (N, n) the last one.
    """
    N, n = plan.shape
    rows, least = np.zeros((N * len(efforts), N * n)), np.empty(N * len(efforts))
    found = 0
    nv = n + len(qddot_p)
    for m in range(len(efforts)):
        limit = efforts[m, nv + 1]
        given = efforts[m, nv]
        for k in range(len(qddot_p)):
            given += efforts[m, n + k] * qddot_p[k]
        for i in range(N):
            effort = given
            for k in range(n):
                effort += efforts[m, k] * plan[i, k]
            if abs(effort) > _NEAR_EFFORT * limit:
                less = -np.sign(effort) * _EFFORT / limit
                for k in range(n):
                    rows[found, i * n + k] = less * efforts[m, k]
                least[found] = -_EFFORT * _SPARE_EFFORT - less * given
                found += 1
    return rows[:found], least[:found]


@compiled
def task_shares(e: np.ndarray, of_rows: np.ndarray, farthest: float) -> np.ndarray:
    """(L13): what rows count of tasks that are far off: (m,).

        min(1, farthest / |e|)^(1/2)

    Squares of errors grow linearly from `farthest` on (Huber, 1964): a target out of
    reach pulls no more than one that is so far away.

    Args:
        e: (m,) weighted task errors [rad, m].
        of_rows: (m,) the task of each row.
        farthest: [rad, m].
    """
    squares = np.zeros(len(e))
    for i in range(len(e)):
        squares[of_rows[i]] += e[i] * e[i]
    shares = np.ones(len(e))
    for i in range(len(e)):
        away = np.sqrt(squares[of_rows[i]])
        if away > farthest:
            shares[i] = np.sqrt(farthest / away)
    return shares


@compiled
def posture_near_limits(
    q: np.ndarray, rest: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """(L14): the nominal posture of (L12) where none is given, (n,) [rad or m],

        (1 - u) q + u q_rest,      u = min(1, max(0, (s - 0.5) / 0.1)),

    where s is the largest share of the way from the rest posture to a limit that a
    joint has gone. A robot that has room stays where its tasks have led it, lest it
    meet an obstacle again that it has gone around.

    Args:
        q: (n,) positions.
        rest: (n,) the rest posture.
        lower, upper: (n,) limits; a joint without one is drawn back for others alone.
    """
    share = 0.0
    for i in range(len(q)):
        limit = upper[i] if q[i] > rest[i] else lower[i]
        way = abs(limit - rest[i])
        gone = abs(q[i] - rest[i])
        if gone > 0.0:
            share = max(share, gone / way if way > gone else 1.0)
    drawn = min(1.0, max(0.0, (share - _DRAWN) / (_DRAWN_WHOLLY - _DRAWN)))
    return (1.0 - drawn) * q + drawn * rest


@compiled
def plan_accelerations(
    references: References,
    of_rows: np.ndarray,
    task_damping: float,
    posture_error: np.ndarray,
    qdot: np.ndarray,
    rows: np.ndarray,
    least: np.ndarray,
    preview: Preview,
) -> np.ndarray:
    """(L12): the accelerations of the parts, (N n,) [rad/s^2].

    The task error at an instant, to the second order in tau, is

        e_i = e + tau_i e_dot + tau_i^2 / 2 a_ff - J sum_j C_ij q_ddot_j,

    with a_ff what the present targets accelerate by, less the bias. The plan is

        argmin sum_i w_i |e_i|^2 + rho^2 sum_j length_j |q_ddot_j + N z_j|^2
               + rows,     z_j = D q_dot_j + k (q_j - q_nominal),

    where N = lambda^2 (J^T J + lambda^2 I)^-1 leaves z to what tasks do not need.

    Args:
        of_rows: (m,) the task of each row.
        task_damping: lambda [m].
        posture_error: (n,) q - q_nominal, or zeros [rad].
        qdot: (n,) velocities.
        rows, least: of `pair_rows_ahead` and the others.
    """
    N, n = len(preview.times), len(qdot)
    shares = task_shares(references.e, of_rows, preview.farthest)
    J = shares[:, np.newaxis] * references.J
    damping2 = task_damping**2
    JJ = gram(J)
    normal = JJ.copy()
    add_to_diagonal(normal, np.full(n, damping2))
    free = damping2 * cholesky_solve_matrix(cholesky(normal), np.eye(n))
    free_twice = product(free, free)
    M, right = np.zeros((N * n, N * n)), np.zeros(N * n)
    towards = (
        transposed_times(J, shares * references.e),
        transposed_times(J, shares * references.e_dot),
        transposed_times(J, shares * references.a_ff),
    )
    pulled = preview.damping * qdot + preview.stiffness * posture_error
    moving = preview.stiffness * qdot
    once = (times(free, pulled), times(free, moving))
    twice = (times(free_twice, pulled), times(free_twice, moving))
    H, efforts = preview.pull, preview.efforts
    for i in range(N):
        here = slice(i * n, (i + 1) * n)
        share = efforts[i] * once[0] + (efforts[i] * preview.times[i]) * once[1]
        for k in range(N):
            both = efforts[k] * H[k, i]
            share += both * twice[0] + (both * preview.times[k]) * twice[1]
        put(
            right,
            i * n,
            preview.tasks[i, 0] * towards[0]
            + preview.tasks[i, 1] * towards[1]
            + preview.tasks[i, 2] * towards[2]
            - share,
        )
        for j in range(N):
            both = 0.0
            for k in range(N):
                both += H[k, i] * efforts[k] * H[k, j]
            one = efforts[i] * H[i, j] + H[j, i] * efforts[j]
            M[here, j * n : (j + 1) * n] = (
                preview.errors[i, j] * JJ + one * free + both * free_twice
            )
    add_to_diagonal(M, np.repeat(efforts, n))
    root = np.sqrt(_ROW_WEIGHT)
    rows, least = root * rows, root * least
    factor = cholesky(M)
    return one_sided_nearest_in(factor, cholesky_solve(factor, right), rows, least)


class PlanNumbers(NamedTuple):
    """What a plan is made with."""

    robot: Held  # of a `Robot`, for the tasks
    shapes: Held  # of `Shapes`
    preview: Held  # of `Preview`
    tasks: TaskGains
    approach: Approach
    lower: np.ndarray  # (n,) [rad or m]
    upper: np.ndarray


@compiled
def plan_step(
    q: np.ndarray,
    v: np.ndarray,
    tasks: np.ndarray,
    prescribed: np.ndarray,
    posture: np.ndarray,
    start: np.ndarray,
    blend: tuple[float, float, float],
    before: np.ndarray,
    efforts: np.ndarray,
    held: Held,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(L10)-(L13) in their order.

    Args:
        q, v: (nv,), (nv,) state in the plant's order.
        tasks, ..., blend: the targets, taken apart; posture may be (0,).
        before: (N n,) the plan of one period ago, or (0,).
        efforts: (k, nv + 2) of `effort_rows`.
        held: holds `PlanNumbers`.

    Returns:
        (N n,) the plan; (nv,) the accelerations, controlled joints first; (m,) Eq. (11)
        against the targets as given.
    """
    numbers = held.value
    targets = Targets(tasks, prescribed, posture, start, blend)
    r, preview, n = numbers.robot.value, numbers.preview.value, len(numbers.lower)
    approach, lower, upper = numbers.approach, numbers.lower, numbers.upper
    state = find_state(q, v, numbers.robot)
    references = find_references(state, targets, r.rows.value, numbers.tasks)
    q, v = state.q, state.v
    last = shifted_plan(before, preview, n)
    x = expected_motion(v, references.qddot_p, last, preview)
    x = possible_motion(x, q, lower, upper, approach.fastest, preview)
    pairs, of_pairs = pair_rows_ahead(q, v, x, approach, numbers.shapes.value, preview)
    limits, of_limits = limit_rows_ahead(q, v, x, lower, upper, approach, preview)
    slow, of_slow = speed_rows(v[:n], last, approach.fastest, preview)
    weak, of_weak = effort_rows(efforts, references.qddot_p, last)
    posture_error = np.zeros(n)
    if len(posture):
        posture_error = q[:n] - posture
    plan = plan_accelerations(
        references,
        r.tasks.value.of_rows,
        preview.task_damping,
        posture_error,
        v[:n],
        np.concatenate((pairs, limits, slow, weak)),
        np.concatenate((of_pairs, of_limits, of_slow, of_weak)),
        preview,
    )
    return plan, np.concatenate((plan[:n], references.qddot_p)), references.error


class Plan:
    """The nominal of (L10)-(L14)."""

    def __init__(
        self,
        model: ControlModel,
        constraints: RobotConstraints,
        ahead: Resolved,
        tasks: TaskGains,
    ) -> None:
        """
        Args:
            model: of the robot, its tasks.
            constraints: of the robot.
            ahead: what the plan is made with.
            tasks: gains of the prescribed joints, and the rows' weights.
        """
        of, preview = constraints, make_preview(ahead, constraints.period)
        self._numbers = hold(
            PlanNumbers(
                *(model.robot, of.pairs.shapes, hold(preview), tasks, ahead.approach),
                *(of.limits.lower, of.limits.upper),
            )
        )
        self._model, self._motors, self._ones = model, of.motors, np.ones(model.n)
        self._first = float(preview.lengths[0])

    def __call__(
        self,
        workspace: Workspace,
        q: np.ndarray,
        v: np.ndarray,
        targets: Targets,
        before: np.ndarray | None,
    ) -> Nominal:
        """The nominal of a step; as of `PaperLaw`."""
        efforts = np.zeros((0, len(v) + 2))
        if self._motors is not None:
            given = self._motors.affine(*self._model.in_order(q, v))
            efforts = np.column_stack((*given, self._motors.aimed))
        plan, vdot, error = plan_step(
            *(q, v, *targets),
            *(_NO_PLAN if before is None else before, efforts, self._numbers),
        )
        qdot_c = v[self._model.controlled] + self._first * plan[: self._model.n]
        return Nominal(vdot, error, self._ones, qdot_c, plan)
