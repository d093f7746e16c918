"""The step of a start pose, against the printed inverse and differences."""

import math

import numpy as np
import pytest

from crar_drake.equations.joint_limits import limit_potential
from crar_drake.equations.paper import PaperGains, start_step

NAN = math.nan
GAINS = PaperGains(
    damping=0.05,
    Gv=NAN,
    GvN=NAN,
    rho=1e-3,
    alpha=50.0,
    beta=2.0,
    limit_share=0.5,
    period=NAN,
    velocity_level=False,
)
LOWER, UPPER = np.full(4, -1.0), np.full(4, 1.0)
Q = np.array([0.1, -0.3, 0.2, 0.0])
NO_PAIRS = np.zeros(0), np.zeros((0, 4))


@pytest.fixture
def task():
    rng = np.random.default_rng(7)
    return rng.normal(size=(3, 4)), 0.1 * rng.normal(size=3)


def limit_weights(q):
    """Eqs. (17), (18): 1 + |dH/dq| of H = (b-a)^2 / (4 (b-q) (q-a)), by differences."""

    def H(q):
        return (UPPER - LOWER) ** 2 / (4.0 * (UPPER - q) * (q - LOWER))

    step = 1e-6
    return 1.0 + np.abs(H(q + step) - H(q - step)) / (2.0 * step)


def test_the_step_is_the_error_times_the_printed_inverse(task):
    J, error = task
    # Eq. (27) without pairs: a share of the limits' weight, and the rest is 1.
    a = GAINS.limit_share
    W = a * limit_weights(Q) + (1.0 - a)
    found = start_step(
        Q, J, error, *NO_PAIRS, (LOWER, UPPER), limit_potential(LOWER, UPPER), GAINS
    )
    damped = (J / W) @ J.T + GAINS.damping**2 * np.eye(len(J))
    expected = (J / W).T @ np.linalg.solve(damped, error)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("end", [0, 1], ids=["lower", "upper"])
def test_a_joint_at_its_end_stays_and_the_others_do_its_part(task, end):
    J, error = task
    limits = limit_potential(LOWER, UPPER)
    free = start_step(Q, J, error, *NO_PAIRS, (LOWER, UPPER), limits, GAINS)
    outward = free < 0.0 if end == 0 else free > 0.0
    joint = int(np.argmax(outward))
    assert outward[joint]
    room = [LOWER.copy(), UPPER.copy()]
    room[end][joint] = Q[joint]
    found = start_step(Q, J, error, *NO_PAIRS, tuple(room), limits, GAINS)
    assert abs(found[joint]) < 1e-7 < abs(free[joint])
    # Three joints do what three rows ask for, but for the damping.
    assert np.linalg.norm(error - J @ found) < 0.2 * np.linalg.norm(error)
    room[end][joint] += 0.1 if end == 0 else -0.1  # it is beyond already
    beyond = start_step(Q, J, error, *NO_PAIRS, tuple(room), limits, GAINS)
    np.testing.assert_array_equal(beyond, found)
    other = [LOWER.copy(), UPPER.copy()]
    other[1 - end][joint] = Q[joint]
    inward = start_step(Q, J, error, *NO_PAIRS, tuple(other), limits, GAINS)
    np.testing.assert_array_equal(inward, free)


def test_a_near_pair_slows_the_joints_that_bring_it_nearer(task):
    J, error = task
    limits = limit_potential(LOWER, UPPER)
    dd_dq = np.zeros((1, 4))
    dd_dq[0, 2] = 1.0
    steps = [
        start_step(Q, J, error, np.array([d]), dd_dq, (LOWER, UPPER), limits, GAINS)
        for d in (1.0, 0.02)
    ]
    assert abs(steps[1][2]) < 0.5 * abs(steps[0][2])
