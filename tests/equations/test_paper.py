"""The paper's law in its order: from the printed formulas, for every variant."""

import math

import numpy as np
import pytest

from crar_drake.equations.joint_limits import limit_potential
from crar_drake.equations.paper import (
    PaperGains,
    constraint_weights,
    weighted_acceleration,
)
from crar_drake.equations.references import References

GAINS = PaperGains(
    damping=0.1,
    Gv=20.0,
    GvN=math.nan,
    rho=0.7,
    alpha=40.0,
    beta=1.5,
    limit_share=0.3,
    period=2e-3,
    velocity_level=False,
)
LOWER, UPPER = np.array([-1.0, -0.5, -np.inf]), np.array([1.2, 2.0, np.inf])
LIMITS = limit_potential(LOWER, UPPER)


def weights_of(q, d, dd_dq, before):
    return constraint_weights(q, d, dd_dq, before[0], before[1], LIMITS, GAINS)


def some_state() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    q, d = np.array([1.0, -0.3, 7.0]), np.array([0.08, 0.03])
    return q, d, rng.normal(size=(2, 3))


def printed(q, d, dd_dq, limits_count, pairs_count) -> np.ndarray:
    """Eqs. (17)-(27) with the stated joints and pairs approaching; term by term."""
    W = np.zeros(3)
    for i in range(3):
        W_JL = 1.0
        if limits_count[i] and np.isfinite(LOWER[i]):
            rise, fall = q[i] - LOWER[i], UPPER[i] - q[i]
            W_JL += abs((rise + fall) ** 2 * (rise - fall) / (2 * rise * fall) ** 2)
        W_COL = 0.0
        for j in range(2):
            f = 0.7 * math.exp(-40.0 * d[j]) / d[j] ** 1.5
            slope = f * (1.5 / d[j] + 40.0)
            W_COL += (1.0 + pairs_count[j, i] * abs(slope * dd_dq[j, i])) / 2
        W[i] = 0.3 * W_JL + 0.7 * W_COL
    return W


def test_constraint_weights_are_the_printed_ones_for_what_approaches():
    state = some_state()
    all_limits, all_pairs = np.ones(3), np.ones((2, 3))
    first = weights_of(*state, (np.zeros(3), np.zeros((2, 3))))
    np.testing.assert_allclose(first.W, printed(*state, all_limits, all_pairs))
    # The second joint leaves its limit, and one pair some joints' ways.
    leaving = np.array([0, 1, 0]), np.array([[1, 0, 0], [0, 0, 1]])
    before = (
        first.limit_proximity * (1.0 + 1e-6 * leaving[0]),
        first.pair_proximity * (1.0 + 1e-6 * leaving[1]),
    )
    second = weights_of(*state, before)
    np.testing.assert_allclose(
        second.W, printed(*state, 1 - leaving[0], 1 - leaving[1])
    )
    assert (first.W - second.W > 1e-3).all()


@pytest.mark.parametrize("inertia", [False, True])
@pytest.mark.parametrize("GvN", [math.nan, 5.0])
def test_weighted_acceleration_is_the_printed_one(inertia, GvN):
    """Eqs. (34), (15), (33), (35), (30), with the inertia and the gains asked for."""
    rng = np.random.default_rng(6)
    m, n = 3, 5
    J, root = rng.normal(size=(m, n)), rng.normal(size=(n, n))
    v_r, a_r = rng.normal(size=(2, m))
    qdot, posture = rng.normal(size=(2, n))
    W = 1.0 + 5.0 * rng.uniform(size=n)
    H = root @ root.T + np.eye(n)
    none = np.zeros(0)
    qddot, qdot_c, diagonal = weighted_acceleration(
        References(J, v_r, a_r, posture, none, np.zeros(m)),
        qdot,
        W,
        H if inertia else np.zeros((0, 0)),
        none,
        GAINS._replace(GvN=GvN),
    )

    weight = np.diag(W)
    if inertia:
        weight = H / np.linalg.det(H) ** (1 / n) + np.diag(W) - np.eye(n)
    inverse = np.linalg.inv(weight)
    J_star = inverse @ J.T @ np.linalg.inv(J @ inverse @ J.T + 0.01 * np.eye(m))
    Gv_null = 5.0 if GvN == 5.0 else 20.0
    expected_c = J_star @ v_r
    zeta = Gv_null * (expected_c - qdot) + posture
    expected = (
        J_star @ a_r + (np.eye(n) - J_star @ J) @ zeta + 20.0 * (expected_c - qdot)
    )
    np.testing.assert_allclose(qdot_c, expected_c, rtol=1e-9)
    np.testing.assert_allclose(qddot, expected, rtol=1e-9)
    np.testing.assert_allclose(diagonal, np.diag(weight), rtol=1e-9)
