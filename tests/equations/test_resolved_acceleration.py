"""Eqs. (10), (12), (13), (15), (30)-(33), (35): branches, limits and Eq. (32)."""

import math

import numpy as np
import pytest

from crar_drake.equations.paper import PaperGains, weighted_acceleration
from crar_drake.equations.references import References, reference_acceleration
from crar_drake.equations.resolved_acceleration import (
    acceleration_level_acceleration,
    constrained_resolved_acceleration,
    constrained_velocity,
    null_space_motion,
    velocity_level_acceleration,
)
from crar_drake.equations.weighted_inverse import damped_inverse


def random_case(m: int, n: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng([m, n])
    vectors = {name: rng.normal(size=n) for name in ("zeta", "qdot", "qdot_c")}
    tasks = {name: rng.normal(size=m) for name in ("a_r", "Jdot_qdot", "v_r")}
    return {"J": rng.normal(size=(m, n)), **vectors, **tasks}


def test_constrained_velocity_reproduces_the_reference_when_it_can():
    case = random_case(3, 7)
    J_star = damped_inverse(case["J"], np.arange(1.0, 8.0), 0.0)
    qdot_c = constrained_velocity(J_star, case["v_r"])
    np.testing.assert_allclose(case["J"] @ qdot_c, case["v_r"], atol=1e-12)


def test_constrained_velocity_is_least_squares_when_it_cannot():
    case = random_case(9, 4)
    J_star = damped_inverse(case["J"], np.ones(4), 1e-6)
    expected = np.linalg.lstsq(case["J"], case["v_r"], rcond=None)[0]
    np.testing.assert_allclose(
        constrained_velocity(J_star, case["v_r"]), expected, atol=1e-9
    )


def test_velocity_level_has_no_spike_at_the_first_step():
    """Without a step before there is no difference to take: alpha is 0, and what is
    left is the velocity loop of Eq. (30). With one, alpha is its difference."""
    n, Gv, period = 4, 30.0, 1e-3
    case = random_case(6, n)
    gains = PaperGains(
        damping=0.1,
        Gv=Gv,
        GvN=math.nan,
        rho=1.0,
        alpha=50.0,
        beta=2.0,
        limit_share=0.5,
        period=period,
        velocity_level=True,
    )
    zeros, none = np.zeros(n), np.zeros(0)
    references = References(
        case["J"], case["v_r"], case["a_r"], zeros, none, np.zeros(6)
    )

    def accelerate(before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        ones, identity = np.ones(n), np.zeros((0, 0))
        return weighted_acceleration(
            references, case["qdot"], ones, identity, before, gains
        )[:2]

    qddot, qdot_c = accelerate(none)
    loop = Gv * (qdot_c - case["qdot"])
    np.testing.assert_allclose(qddot, loop, rtol=1e-12)
    qddot, _ = accelerate(case["qdot_c"])
    np.testing.assert_allclose(
        qddot, (qdot_c - case["qdot_c"]) / period + loop, rtol=1e-12
    )
    alpha = velocity_level_acceleration(qdot_c, qdot_c, period)
    np.testing.assert_array_equal(alpha, zeros)


def test_velocity_level_is_the_derivative_of_a_smooth_command():
    period, t = 1e-5, 0.4
    now = np.array([np.sin(t), t**3])
    previous = np.array([np.sin(t - period), (t - period) ** 3])
    np.testing.assert_allclose(
        velocity_level_acceleration(now, previous, period),
        [np.cos(t), 3 * t**2],
        rtol=1e-4,
    )


def test_null_space_motion_drives_towards_the_constrained_velocity():
    zeta = null_space_motion(np.array([1.0, 2.0]), np.array([0.5, 3.0]), 30.0)
    np.testing.assert_allclose(zeta, [15.0, -30.0])
    gains = np.array([10.0, 1.0])
    zeta = null_space_motion(np.array([1.0, 2.0]), np.array([0.5, 3.0]), gains)
    np.testing.assert_allclose(zeta, [5.0, -1.0])


@pytest.mark.parametrize("m, n", [(3, 7), (10, 11), (6, 6), (21, 11), (2, 1)])
def test_the_null_space_term_is_there_only_if_m_is_less_than_n(m, n):
    case = random_case(m, n)
    J, wish = case["J"], case["a_r"] - case["Jdot_qdot"]
    factors = damped_inverse(J, np.arange(1.0, n + 1), 0.1)
    alpha = acceleration_level_acceleration(factors, J, wish, case["zeta"])
    # Eq. (34) as printed.
    inverse = np.diag(1.0 / np.arange(1.0, n + 1))
    J_star = inverse @ J.T @ np.linalg.inv(J @ inverse @ J.T + 0.01 * np.eye(m))
    expected = J_star @ wish
    if m < n:
        expected = expected + case["zeta"] - J_star @ (J @ case["zeta"])
    np.testing.assert_allclose(alpha, expected, atol=1e-11)
    # The branch is seen: with damping, N zeta is not 0 even for m >= n.
    without = acceleration_level_acceleration(factors, J, wish, 0 * case["zeta"])
    assert np.allclose(alpha, without) == (m >= n)


def test_constrained_acceleration_adds_the_velocity_loop():
    alpha_c = constrained_resolved_acceleration(
        np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([2.5, 5.0]), 30.0
    )
    np.testing.assert_allclose(alpha_c, [16.0, -28.0])
    alpha_c = constrained_resolved_acceleration(
        np.array([1.0, 2.0]), np.ones(2), np.zeros(2), np.array([3.0, 4.0])
    )
    np.testing.assert_allclose(alpha_c, [4.0, 6.0])


def test_both_levels_torques_agree_with_eq_12_when_K_qv_is_H_Gv():
    """tau = H alpha + bias + K_qv (q_dot_c - q_dot) = H alpha_c + bias."""
    rng = np.random.default_rng(7)
    root = rng.normal(size=(4, 4))
    H, bias = root @ root.T + np.eye(4), rng.normal(size=4)
    alpha, qdot_c, qdot = rng.normal(size=(3, 4))
    Gv = 30.0
    printed = H @ alpha + bias + (Gv * H) @ (qdot_c - qdot)
    alpha_c = constrained_resolved_acceleration(alpha, qdot_c, qdot, Gv)
    np.testing.assert_allclose(H @ alpha_c + bias, printed)


def test_undamped_and_redundant_the_tasks_get_their_acceleration():
    """J alpha_c + Jdot q_dot = a_r when the velocity loop has nothing to do."""
    case = random_case(6, 11)
    J_star = damped_inverse(case["J"], np.ones(11), 0.0)
    alpha = acceleration_level_acceleration(
        J_star, case["J"], case["a_r"] - case["Jdot_qdot"], case["zeta"]
    )
    alpha_c = constrained_resolved_acceleration(alpha, case["qdot"], case["qdot"], 30.0)
    np.testing.assert_allclose(
        case["J"] @ alpha_c + case["Jdot_qdot"], case["a_r"], atol=1e-11
    )


def realised_error(J: np.ndarray, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """Residual of Eq. (32) when a robot realises alpha_c, and e_dd itself."""
    m, n = J.shape
    rng = np.random.default_rng(8)
    a_d, v_d, e, Jdot_qdot = rng.normal(size=(4, m))
    qdot, qdot_c = rng.normal(size=(2, n))
    Kp, Kv, Gv = 300.0, 2 * np.sqrt(300.0), 30.0
    a_r = reference_acceleration(a_d, v_d, J @ qdot, e, Kp, Kv)
    J_star = damped_inverse(J, np.ones(n), damping)
    zeta = null_space_motion(qdot_c, qdot, Gv)
    alpha = acceleration_level_acceleration(J_star, J, a_r - Jdot_qdot, zeta)
    alpha_c = constrained_resolved_acceleration(alpha, qdot_c, qdot, Gv)
    e_dot = v_d - J @ qdot
    e_ddot = a_d - (J @ alpha_c + Jdot_qdot)
    residual = e_ddot + Kv * e_dot + Kp * e + J @ (Gv * (qdot_c - qdot))
    return residual, e_ddot


def test_error_dynamics_hold_exactly_without_damping():
    J = random_case(6, 11)["J"]
    residual, e_ddot = realised_error(J, damping=0.0)
    assert np.abs(e_ddot).max() > 1.0
    np.testing.assert_allclose(residual, 0.0, atol=1e-10)


def test_error_dynamics_do_not_hold_with_damping():
    """The residual can tell: the paper's lambda = 0.1 leaves something."""
    residual, _ = realised_error(random_case(6, 11)["J"], damping=0.1)
    assert np.abs(residual).max() > 1e-3
