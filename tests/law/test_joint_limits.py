"""Eqs. (17), (18) at limits, beyond them and in narrow ranges; what is approached.

Elsewhere they are compared in `tests/acceptance/test_paper_law.py`.
"""

import numpy as np
import pytest

from crar_drake.law.paper import (
    LIMIT_CLAMP,
    approach_weights,
    limit_gradient,
    limit_potential,
    limit_proximity,
)

LOWER, UPPER = np.array([-0.7]), np.array([1.9])


def joint_limit_gradient(q, lower, upper) -> np.ndarray:
    return limit_gradient(q, limit_potential(lower, upper))


def joint_limit_proximity(q, lower, upper) -> np.ndarray:
    limits = limit_potential(lower, upper)
    return limit_proximity(q, limit_gradient(q, limits), limits)


def gradient_at(q) -> np.ndarray:
    q = np.atleast_1d(np.asarray(q, dtype=float))
    return joint_limit_gradient(q, np.full(q.shape, LOWER), np.full(q.shape, UPPER))


def proximity_at(q) -> np.ndarray:
    q = np.atleast_1d(np.asarray(q, dtype=float))
    return joint_limit_proximity(q, np.full(q.shape, LOWER), np.full(q.shape, UPPER))


def weight_of_move(q_before: float, q_now: float) -> float:
    """W_JL of one joint that went from q_before to q_now in one step."""
    W = approach_weights(
        gradient_at(q_now), proximity_at(q_now), proximity_at(q_before)
    )
    return W[0]


@pytest.mark.parametrize(
    "lower, upper",
    [(-np.inf, np.inf), (-np.inf, 1.0), (-1.0, np.inf)],
)
@pytest.mark.parametrize("q", [0.0, 1.0, -1.0, 100.0, -1e6])
def test_unlimited_joints_weigh_nothing(lower, upper, q):
    """A limit on one side only has no range for Eq. (17): it counts as unlimited."""
    q, lower, upper = np.array([q]), np.array([lower]), np.array([upper])
    assert joint_limit_gradient(q, lower, upper) == 0.0
    assert joint_limit_proximity(q, lower, upper) == 0.0
    W = approach_weights(np.zeros(1), np.zeros(1), np.zeros(1))
    assert W == 1.0


def test_gradient_is_finite_and_monotone_through_both_limits():
    inside = np.geomspace(1e-12, 0.5, 200)
    q = np.sort(
        np.r_[LOWER - inside, LOWER, LOWER + inside, UPPER - inside, UPPER,
              UPPER + inside, LOWER - 100, UPPER + 100]
    )  # fmt: skip
    gradient = gradient_at(q)
    assert np.isfinite(gradient).all()
    assert (np.diff(gradient) >= 0.0).all()
    assert gradient[0] < -1e6 and gradient[-1] > 1e6


@pytest.mark.parametrize("past", [0.0, 1e-9, 1e-5, 0.1, 3.0])
def test_beyond_a_limit_it_is_the_value_just_inside(past):
    np.testing.assert_allclose(
        gradient_at(UPPER + past), gradient_at(UPPER - LIMIT_CLAMP), rtol=1e-9
    )
    np.testing.assert_allclose(
        gradient_at(LOWER - past), gradient_at(LOWER + LIMIT_CLAMP), rtol=1e-9
    )


@pytest.mark.parametrize("span", [0.0, 1e-300, 1e-12, 1e-7, 1e-4, 3e-4, 1e-3])
def test_narrow_ranges_and_equal_limits_stay_finite(span):
    lower = np.full(601, 0.3)
    q = 0.3 + 0.5 * span + np.linspace(-1e-3, 1e-3, 601)
    gradient = joint_limit_gradient(q, lower, lower + span)
    proximity = joint_limit_proximity(q, lower, lower + span)
    assert np.isfinite(gradient).all() and np.isfinite(proximity).all()
    assert (np.diff(gradient) >= 0.0).all()
    assert gradient[0] < -1e3 and gradient[-1] > 1e3


@pytest.mark.parametrize(
    "span, effective", [(0.0, 1e-4), (5e-5, 1e-4), (1e-4, 1e-4), (2e-4, 2e-4)]
)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_narrow_range_is_clamped_at_a_quarter_of_it(span, effective, sign):
    """Eq. (17) at a quarter of the range r from a limit is 32 / (9 r); a range narrower
    than a clamp counts as one as wide, about the same middle."""
    assert LIMIT_CLAMP == 1e-4
    middle = 0.3
    lower, upper = np.array([middle - 0.5 * span]), np.array([middle + 0.5 * span])

    def gradient(offset: float) -> float:
        q = np.array([middle + sign * offset])
        return sign * joint_limit_gradient(q, lower, upper)[0]

    at_clamp = 32.0 / (9.0 * effective)
    for offset in (0.25, 0.3, 0.5, 1.0, 1e5):
        assert gradient(offset * effective) == pytest.approx(at_clamp, rel=1e-9)
    # Further inside it is Eq. (17) as printed: r^2 2x / (4 (r^2/4 - x^2)^2).
    for share in (0.2, 0.1, 0.0):
        x, r = share * effective, effective
        printed = r**2 * 2.0 * x / (4.0 * (0.25 * r**2 - x**2) ** 2)
        assert gradient(x) == pytest.approx(printed, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("span", [3.9e-4, 4e-4, 4.1e-4, 1e-3])
def test_the_clamp_is_a_quarter_of_the_range_or_its_own_width(span):
    """Whichever is less: on both sides of four clamps, from the printed formula."""
    lower, upper = np.array([0.0]), np.array([span])
    clamp = 0.25 * span if span < 4e-4 else 1e-4
    rest = span - clamp
    printed = span**2 * (rest - clamp) / (4 * clamp**2 * rest**2)
    beyond = joint_limit_gradient(upper + 1.0, lower, upper)
    np.testing.assert_allclose(beyond, printed, rtol=1e-9)
    np.testing.assert_allclose(
        joint_limit_gradient(lower - 1.0, lower, upper), -printed
    )
    # Beyond the clamp, the proximity grows by one gradient per LIMIT_CLAMP.
    past = upper - clamp + 3.0 * LIMIT_CLAMP
    np.testing.assert_allclose(
        joint_limit_proximity(past, lower, upper), 4.0 * printed, rtol=1e-9
    )


def test_proximity_grows_strictly_outwards_without_a_jump():
    out = np.r_[np.linspace(-0.5, -2e-4, 200), np.linspace(-2e-4, 2e-4, 400)[1:],
                np.linspace(2e-4, 2.0, 200)[1:]]  # fmt: skip
    for proximity in (proximity_at(UPPER + out), proximity_at(LOWER - out)):
        assert np.isfinite(proximity).all()
        assert (np.diff(proximity) > 0.0).all()
    step = 1e-12
    for edge in (UPPER - LIMIT_CLAMP, LOWER + LIMIT_CLAMP):
        ratio = proximity_at(edge + step) / proximity_at(edge - step)
        assert ratio == pytest.approx(1.0, abs=1e-6)


def test_weight_branches_per_joint():
    """Approaching, unchanged (counts as approaching), leaving."""
    gradient = np.array([2.0, -3.0, 4.0])
    W = approach_weights(gradient, np.abs(gradient), np.array([1.9, 3.0, 4.1]))
    assert W.tolist() == [3.0, 4.0, 1.0]


@pytest.mark.parametrize(
    "q_before, q_now, approaching",
    [
        (1.5, 1.6, True),
        (1.6, 1.5, False),
        (-0.3, -0.4, True),
        (-0.4, -0.3, False),
        (1.6, 1.6, True),
        (1.89, 1.95, True),  # over the limit in one step
        (1.95, 2.0, True),  # further out
        (2.0, 1.95, False),  # coming back, still outside
        (1.95, 1.89, False),  # back inside in one step
        (1.89999, 1.89995, False),  # within the clamp
        (1.89995, 1.89999, True),
        (-0.75, -0.8, True),
        (-0.8, -0.75, False),
    ],
)
def test_weight_of_a_move(q_before, q_now, approaching):
    expected = 1.0 + abs(gradient_at(q_now)[0]) if approaching else 1.0
    assert weight_of_move(q_before, q_now) == pytest.approx(expected)
    assert expected > 1.0 or not approaching
