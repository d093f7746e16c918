"""Eqs. (9) and (14): what the error does when the reference is realised."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from crar_drake.equations.blending import blend_tasks
from crar_drake.equations.kinematics import State
from crar_drake.equations.references import (
    BlendStart,
    Targets,
    TaskGains,
    find_references,
    posture_acceleration,
    reference_acceleration,
    reference_velocity,
)
from crar_drake.equations.tasks import TaskLayout


def target(t: float) -> tuple[float, float, float]:
    """A moving target with its derivatives."""
    return np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)


def test_velocity_reference_makes_the_error_decay_exponentially():
    """x_dot = v_d + K (x_d - x) gives e(t) = e(0) exp(-K t)."""

    def x_dot(t, x):
        x_d, v_d, _ = target(t)
        return reference_velocity(np.array([v_d]), x_d - x, 30.0)

    run = solve_ivp(x_dot, (0.0, 0.1), [0.5], rtol=1e-10, atol=1e-12)
    e = target(0.1)[0] - run.y[0, -1]
    assert e == pytest.approx(-0.5 * np.exp(-3.0), rel=1e-7)


def test_acceleration_reference_gives_a_second_order_error():
    """x_dd = a_r gives e_dd + Kv e_d + Kp e = 0, solved by a matrix exponential."""
    Kp, Kv = 300.0, 7.0

    def rate(t, y):
        x_d, v_d, a_d = target(t)
        x, v = y[:1], y[1:]
        a_r = reference_acceleration(np.array([a_d]), v_d, v, x_d - x, Kp, Kv)
        return np.r_[v, a_r]

    run = solve_ivp(rate, (0.0, 0.2), [0.5, 1.0], rtol=1e-10, atol=1e-12)
    e_0 = np.array([0.0 - 0.5, 3.0 - 1.0])
    x_d, v_d, _ = target(0.2)
    expected = expm(0.2 * np.array([[0.0, 1.0], [-Kp, -Kv]])) @ e_0
    actual = np.array([x_d, v_d]) - run.y[:, -1]
    np.testing.assert_allclose(actual, expected, rtol=1e-6)


def test_gains_may_differ_by_row():
    one = np.ones(2)
    gains = np.array([10.0, 20.0])
    np.testing.assert_array_equal(reference_velocity(one, 2 * one, gains), [21.0, 41.0])
    np.testing.assert_array_equal(
        reference_acceleration(one, 3 * one, one, 2 * one, gains, 0.1 * gains),
        [1 + 2 + 20, 1 + 4 + 40],
    )


def test_posture_is_approached_with_critical_damping():
    """e(t) = (e_0 + (e_dot_0 + w e_0) t) exp(-w t), with stiffness w^2."""
    q_0, v_0, targets, w = 0.2, -3.0, 1.0, 5.0

    def rate(t, y):
        return np.r_[
            y[1:], posture_acceleration(np.array([targets]), y[:1], y[1:], w**2)
        ]

    run = solve_ivp(rate, (0.0, 0.3), [q_0, v_0], rtol=1e-10, atol=1e-12)
    e_0 = q_0 - targets
    expected = targets + (e_0 + (v_0 + w * e_0) * 0.3) * np.exp(-w * 0.3)
    assert run.y[0, -1] == pytest.approx(expected, rel=1e-8)


VARIANTS = [*itertools.product((False, True), repeat=3)]


@pytest.mark.parametrize("blending, weighted, posture", VARIANTS)
def test_references_are_put_together_row_by_row(blending, weighted, posture):
    """A pose and a position; four controlled joints and two prescribed ones.

    Once blending is over, nothing is asked of where it began: here NaN.
    """
    rng = np.random.default_rng(11)
    layout = TaskLayout(("hand", "elbow"), ("pose", "position"))
    m, n, n_p = layout.m, 4, 2
    R, R_d, R_start = Rotation.random(3, random_state=rng).as_matrix()
    p, p_d, p_start = rng.normal(size=(3, 2, 3))
    v_d, a_d, bias, S = rng.normal(size=(4, m))
    seen = {
        "q": rng.normal(size=n + n_p),
        "v": rng.normal(size=n + n_p),
        "R": R[None],
        "p": p,
        "J": rng.normal(size=(m, n + n_p)),
        "Jdot_qdot": bias,
    }
    # The references need nothing else of a state.
    state = State(**({name: np.full((1, 1), np.nan) for name in State._fields} | seen))
    q_p, v_p, a_p, q_p_start = rng.normal(size=(4, n_p))
    nominal, start = rng.normal(size=n), (R_start[None], p_start, q_p_start)
    s, s_dot, s_ddot = step = (0.4, 1.2, 3.0) if blending else (1.0, 0.0, 0.0)
    K, Kp, Kv, stiffness = 11.0, 130.0, 17.0, 4.0
    found = find_references(
        state,
        Targets(
            layout.pack(R_d[None], p_d, v_d, a_d),
            np.concatenate([q_p, v_p, a_p]),
            nominal if posture else np.zeros(0),
            BlendStart(*(x if blending else np.nan * x for x in start)),
            step,
        ),
        layout.rows,
        TaskGains(K, Kp, Kv, stiffness, S if weighted else np.zeros(0)),
    )

    def error(target) -> np.ndarray:
        turn = sum(0.5 * np.cross(R[:, i], target.R[0][:, i]) for i in range(3))
        return np.concatenate([turn, target.p[0] - p[0], target.p[1] - p[1]])

    target = layout.unpack(layout.pack(R_d[None], p_d, v_d, a_d))
    np.testing.assert_allclose(found.error, error(target), atol=1e-12)
    if blending:
        target = blend_tasks(
            layout.rows, R_start[None], p_start, np.zeros(0), target, step
        )
        gap = q_p - q_p_start
        q_p, v_p, a_p = (
            q_p_start + s * gap,
            s_dot * gap + s * v_p,
            s_ddot * gap + 2 * s_dot * v_p + s * a_p,
        )
    e, J, J_p = error(target), state.J[:, :n], state.J[:, n:]
    qddot_p = a_p + Kv * (v_p - state.v[n:]) + Kp * (q_p - state.q[n:])
    v_r = target.v + K * e - J_p @ state.v[n:]
    a_r = target.a + Kv * (target.v - state.J @ state.v) + Kp * e
    a_r = a_r - J_p @ qddot_p - bias
    rows = S if weighted else np.ones(m)
    np.testing.assert_allclose(found.qddot_p, qddot_p, rtol=1e-10)
    np.testing.assert_allclose(found.J, np.diag(rows) @ J, rtol=1e-10)
    np.testing.assert_allclose(found.v_r, rows * v_r, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found.a_r, rows * a_r, rtol=1e-10, atol=1e-10)
    pull = stiffness * (nominal - state.q[:n]) - 4.0 * state.v[:n]
    np.testing.assert_allclose(
        found.posture, pull if posture else np.zeros(n), rtol=1e-10
    )
