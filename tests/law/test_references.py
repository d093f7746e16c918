"""Eqs. (9) and (14): put together row by row; the posture is approached."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from crar_drake.law.blending import blend_tasks
from crar_drake.law.kinematics import State
from crar_drake.law.references import (
    Targets,
    TaskGains,
    find_references,
    posture_acceleration,
)
from crar_drake.law.tasks import TaskLayout


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
    nominal = rng.normal(size=n)
    start = layout.pack(R_start[None], p_start)[: layout.size_x]
    start = np.concatenate([start, q_p_start])
    s, s_dot, s_ddot = step = (0.4, 1.2, 3.0) if blending else (1.0, 0.0, 0.0)
    K, Kp, Kv, stiffness = 11.0, 130.0, 17.0, 4.0
    found = find_references(
        state,
        Targets(
            layout.pack(R_d[None], p_d, v_d, a_d),
            np.concatenate([q_p, v_p, a_p]),
            nominal if posture else np.zeros(0),
            start if blending else np.nan * start,
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
        target = blend_tasks(layout.rows, start, target, step)
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
