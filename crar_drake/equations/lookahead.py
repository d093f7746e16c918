"""The lookahead: constraints act where the robot would come to rest.

The paper's W looks at the present configuration, per joint, and lets a joint go
free as soon as its share of a gradient shrinks; it asks for a more rigorous W, an
adaptive Gv and less damping. Here the constraints are imposed where the robot would
come to rest, and only along their gradients. `docs/lookahead.md` has the derivation.

Let T be a braking horizon. Under q_ddot = -q_dot/T the robot comes to rest at

    q_s = q + T q_dot,       and     s = q_dot + T q_ddot

is the velocity of q_s: choosing an acceleration is choosing s, a first-order
problem in q_s. Each watched pair gives two rows (h, g): a distance that must stay
positive, and its gradient, so that h changes by g s per second. Prescribed joints
move it by a known drift as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv, dpotrs

from crar_drake.equations.joint_limits import LimitPotential

# A margin of a row smaller than this [m] weighs as this: weights stay finite.
SMALLEST_MARGIN = 1e-4


@dataclass(slots=True)
class Constraints:
    """Margins h that should stay positive and change by g s + drift per second.

    Rows of pairs and of joint limits alike: of a limit, g is a signed unit vector.

    Attributes:
        h: (C,) margins where the robot will come to rest: distances of pairs [m],
            or from a joint to its nearer limit [rad], negative beyond it.
        g: (C, n) their gradients by the controlled joints [m/rad or 1].
        drift: (C,) their change other than by s: by the prescribed joints, and by
            what of the slip goes towards the constraint [m/s or rad/s].
        weight: (C,) omega of a pair, `row_weights`, or rho_JL |grad h_i| of a limit.
        retreat: (C,) r, the speed at which a violated one must recede [m/s or
            rad/s].
    """

    h: np.ndarray
    g: np.ndarray
    drift: np.ndarray
    weight: np.ndarray
    retreat: np.ndarray

    def with_(self, other: Constraints) -> Constraints:
        """These and others, as one set."""
        return Constraints(
            np.concatenate([self.h, other.h]),
            np.concatenate([self.g, other.g]),
            np.concatenate([self.drift, other.drift]),
            np.concatenate([self.weight, other.weight]),
            np.concatenate([self.retreat, other.retreat]),
        )


@dataclass(slots=True)
class LookaheadSolution:
    """The lookahead's choice.

    Attributes:
        qddot: (n,) resolved acceleration (s - q_dot) / T [rad/s^2].
        s: (n,) velocity of q_s [rad/s].
        qdot_c: (n,) Eq. (15) with the full-matrix weight [rad/s].
        W: (n, n) the weight matrix of the last pass.
        passes: how often the two loops solved, together.
    """

    qddot: np.ndarray
    s: np.ndarray
    qdot_c: np.ndarray
    W: np.ndarray
    passes: int


def resting_configuration(q: np.ndarray, qdot: np.ndarray, T: float) -> np.ndarray:
    """q_s = q + T q_dot: where q_ddot = -q_dot/T leads. All (n,); T in s."""
    return q + T * qdot


def slip_velocity(
    previous: np.ndarray,
    qdot: np.ndarray,
    qdot_before: np.ndarray,
    qddot_before: np.ndarray,
    *,
    T: float,
    period: float,
    time_constant: float,
) -> np.ndarray:
    """How fast q_s moves besides s: T times what the plant did other than told.

    A torque that is held is not an acceleration that is held, models are wrong, and
    somebody may push. What the last control period showed of it is taken, through a
    first-order low-pass, as what the next will bring.

    Args:
        previous: (n,) this function's value one period ago [rad/s].
        qdot, qdot_before: (n,) velocities now and one period ago [rad/s].
        qddot_before: (n,) commanded one period ago [rad/s^2].
        T: braking horizon [s].
        period: of the controller [s].
        time_constant: of the low-pass [s].

    Returns:
        (n,) [rad/s].
    """
    seen = T * ((qdot - qdot_before) / period - qddot_before)
    return previous + min(1.0, period / time_constant) * (seen - previous)


def row_weights(
    h: np.ndarray, d_min: float, rho: float, alpha: float, beta: float
) -> np.ndarray:
    """omega: the magnitude of Eq. (23) at the margin eta = h - d_min.

    Args:
        h: (R,) distances at rest [m].
        d_min: distance to keep [m].
        rho, alpha, beta: amplitude, decay [1/m] and exponent of Eq. (22).

    Returns:
        (R,) finite: eta counts as at least SMALLEST_MARGIN.
    """
    eta = np.maximum(h - d_min, SMALLEST_MARGIN)
    return rho * np.exp(-alpha * eta) * eta**-beta * (beta / eta + alpha)


def make_rows(
    h: np.ndarray,
    g: np.ndarray,
    drift: np.ndarray,
    *,
    d_min: float,
    influence: float,
    gamma: float,
    fastest: float,
    rho: float,
    alpha: float,
    beta: float,
    slip: np.ndarray | None = None,
) -> Constraints:
    """The rows within the influence distance, with weights and retreat speeds.

    Args:
        h, g, drift: (R,), (R, n), (R,) of all rows.
        d_min: distance to keep [m].
        influence: rows with h beyond it do not count [m].
        gamma: a row inside d_min must recede at gamma (d_min - h) [1/s],
        fastest: but at no more than this [m/s].
        rho, alpha, beta: of the weight.
        slip: (n,) velocity of q_s that is not commanded, see `slip_velocity`; only
            what approaches counts [rad/s].
    """
    near = np.flatnonzero(h < influence)
    h, g, drift = h.take(near), g.take(near, axis=0), drift.take(near)
    if slip is not None:
        drift = drift + np.minimum(g @ slip, 0.0)
    return Constraints(
        h=h,
        g=g,
        drift=drift,
        weight=row_weights(h, d_min, rho, alpha, beta),
        retreat=np.minimum(gamma * np.maximum(d_min - h, 0.0), fastest),
    )


class JointLimits:
    """The joint limits as constraints on the resting configuration."""

    def __init__(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        *,
        margin: float,
        gamma: float,
        fastest: float,
        rho: float,
    ) -> None:
        """
        Args:
            lower, upper: (n,) limits [rad], infinite where there is none.
            margin: to keep from them [rad].
            gamma: a joint nearer than that must come back at gamma (margin -
                distance) [1/s],
            fastest: but at no more than this [rad/s].
            rho: rho_JL, the weight's amplitude.
        """
        self._limited = np.flatnonzero(np.isfinite(lower) & np.isfinite(upper))
        self._lower, self._upper = lower[self._limited], upper[self._limited]
        self._potential = LimitPotential(self._lower, self._upper)
        self._units = np.eye(len(lower))[self._limited]
        self._margin, self._gamma, self._fastest = margin, gamma, fastest
        self._rho = rho

    def __call__(self, q_s: np.ndarray, slip: np.ndarray | None = None) -> Constraints:
        """One row per limited joint, of its nearer limit, with weight Eq. (17) at q_s.

        Args:
            q_s: (n,) resting configuration [rad].
            slip: (n,) velocity of q_s that is not commanded, see `slip_velocity`;
                only what goes towards the limit counts [rad/s].
        """
        q_s = q_s.take(self._limited)
        to_upper, to_lower = self._upper - q_s, q_s - self._lower
        h = np.minimum(to_upper, to_lower)
        inward = np.copysign(1.0, to_upper - to_lower)  # -1 near the upper limit
        if slip is None:
            drift = np.zeros(len(h))
        else:
            drift = np.minimum(inward * slip.take(self._limited), 0.0)
        short = np.maximum(self._margin - h, 0.0)
        return Constraints(
            h=h,
            g=inward[:, None] * self._units,
            drift=drift,
            weight=self._rho * np.abs(self._potential.gradient(q_s)),
            retreat=np.minimum(self._gamma * short, self._fastest),
        )


def solve_lookahead(
    J: np.ndarray,
    v_r: np.ndarray,
    a_r: np.ndarray,
    qdot: np.ndarray,
    constraints: Constraints,
    *,
    T: float,
    Gv: float,
    damping: float,
    posture: np.ndarray | None = None,
) -> LookaheadSolution:
    """Resolved acceleration under constraints; it always exists.

    Two stages, each a loop over a growing active set A that starts empty and takes
    up whatever the solution moves towards, until nothing is added. First the
    paper's law with W(A) = I + sum omega_j g_j g_j^T (of a limit: w_i e_i e_i^T) in
    place of its diagonal W, Eqs. (15), (30), (34), (35) by the push-through
    identity:

        M = J^T J + lambda^2 W
        q_dot_c = M^-1 (J^T v_r - lambda^2 sum omega_j drift_j g_j)
        z = Gv (q_dot_c - q_dot)
        alpha = M^-1 [J^T a_r + lambda^2 z  if m < n],   s_0 = q_dot + T (alpha + z)

    then the guard, which brings s_0 to the speeds that the constraints allow:

        s = argmin |s - s_0|^2 + sum omega_j (g_j s + drift_j - r_j)^2

    over the constraints that s exceeds.

    Args:
        J: (m, n) task Jacobian.
        v_r: (m,) v_d + K e less the prescribed joints' share.
        a_r: (m,) Eq. (14) less bias and the prescribed joints' share.
        qdot: (n,) present velocity [rad/s].
        constraints: rows and limits.
        T: braking horizon [s].
        Gv: joint velocity gain [1/s].
        damping: lambda [m], positive.
        posture: (n,) a null-space acceleration, added where m < n [rad/s^2].
    """
    m, n = J.shape
    damping2 = damping**2
    g, drift, retreat = constraints.g, constraints.drift, constraints.retreat
    # With lambda in the roots, both stages have lambda^2 on their diagonals.
    root = damping * np.sqrt(constraints.weight)
    rows = root[:, None] * g

    normal = J.T @ J
    normal.flat[:: n + 1] += damping2
    sides = np.array([v_r, a_r]) @ J  # (2, n)
    M, right, penalty = normal, sides, np.zeros((n, n))
    on = np.zeros(len(drift), dtype=bool)
    passes = 0
    while True:
        passes += 1
        factor, answers = _solve_spd(M, right.T)
        qdot_c, alpha = answers.T
        z = Gv * (qdot_c - qdot)
        if m < n:
            pull = z if posture is None else z + posture
            alpha = alpha + dpotrs(factor, damping2 * pull)[0]
        s_0 = qdot + T * (alpha + z)
        rate = g @ s_0 + drift
        added = (rate < 0.0) > on
        if not added.any():
            break
        on |= added
        active = rows[on]
        penalty = active.T @ active  # symmetric to the last bit
        M = normal + penalty
        right = sides.copy()
        right[0] -= (root * drift)[on] @ active
    W = penalty / damping2
    W.flat[:: n + 1] += 1.0

    wish = root * (retreat - drift)
    on = np.zeros(len(drift), dtype=bool)
    s = s_0
    while True:
        added = (rate < retreat) > on
        if not added.any():
            break
        passes += 1
        on |= added
        active = rows[on]
        M = active.T @ active
        M.flat[:: n + 1] += damping2
        _, s = _solve_spd(M, damping2 * s_0 + wish[on] @ active)
        rate = g @ s + drift
    return LookaheadSolution((s - qdot) / T, s, qdot_c, W, passes)


def _solve_spd(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The Cholesky factor of A (n, n), and X of A X = B (n,) or (n, k)."""
    factor, X, info = dposv(A, B)
    if info:
        raise FloatingPointError(
            "a matrix that is positive definite by construction is not: a NaN or an "
            "overflow reached the solver"
        )
    return factor, X
