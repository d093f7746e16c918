"""The torque limit takes the largest share that it may, judged by brute force."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from crar_drake.equations.torque_limit import (
    clip_torque,
    limit_torque,
    nearest_accelerations,
    next_braking_torque,
    share_of_nominal,
    torque_scale,
)

vectors = arrays(float, 4, elements=st.floats(-50.0, 50.0))
THETA = np.linspace(0.0, 1.0, 2001)


def scale(tau, tau_brake, tau_still, limits, dt_T=0.0):
    return torque_scale(
        np.asarray(tau, float),
        np.asarray(tau_brake, float),
        np.asarray(tau_still, float),
        np.asarray(limits, float),
        float(dt_T),
    )


def torques(tau, tau_brake):
    return tau_brake + THETA[:, None] * (tau - tau_brake)


@settings(max_examples=200, deadline=None)
@given(vectors, vectors, arrays(float, 4, elements=st.floats(1.0, 40.0)))
def test_the_largest_share_within_the_limits(tau, tau_brake, limits):
    # At rest braking is standing still: nothing is to be reserved.
    found = scale(tau, tau_brake, tau_brake, limits)
    allowed = (np.abs(torques(tau, tau_brake)) <= limits).all(axis=1)
    commanded = tau_brake + found.theta * (tau - tau_brake)
    if found.excess == 0.0:
        assert (np.abs(commanded) <= limits * (1 + 1e-6)).all()
    if allowed.any():
        assert found.excess == pytest.approx(0.0, abs=1e-6)
    else:
        worst = np.max(np.abs(torques(tau, tau_brake)) / limits, axis=1).min() - 1.0
        assert found.excess <= worst + 1e-9
        assert found.excess == pytest.approx(worst, abs=0.06)


def test_within_the_limits_all_is_allowed():
    assert scale([3, -4], [0, 0], [0, 0], [5, 5]).theta == 1.0


def test_half_of_it():
    assert scale([10, 0], [0, 0], [0, 0], [5, 5]).theta == pytest.approx(0.5)


def test_unlimited_actuators_do_not_count():
    assert scale([1e6, 1], [0, 0], [0, 0], [np.inf, 5]).theta == 1.0
    assert scale([1e6], [0], [0], [np.inf]).theta == 1.0


def test_an_idle_actuator_with_a_limit_of_zero_does_not_count():
    found = scale([0.0, 3.0], [0.0, -1.0], [0.0, 0.0], [0.0, 5.0], 0.5)
    assert found.theta == 1.0 and found.excess == 0.0


def test_not_even_braking_is_within_the_limits():
    found = scale([20.0], [8.0], [8.0], [5.0])
    assert found.theta == 0.0 and found.excess == pytest.approx(0.6)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(
    "tau, tau_brake, theta, excess",
    [
        # |20 - 12 theta| of 5 falls all the way: all of the wish is best.
        ([-8.0], [-20.0], 1.0, 0.6),
        # 1.5 + 0.4 theta and 1.7 - 0.4 theta cross at a quarter; of unlike signs...
        ([1.9, -1.3], [1.5, -1.7], 0.25, 0.6),
        # ... and of the same.
        ([1.9, 1.3], [1.5, 1.7], 0.25, 0.6),
        # The third line is above where the first two cross: 1.8 - 0.4 theta.
        ([1.9, -1.3, 1.4], [1.5, -1.7, 1.8], 0.375, 0.65),
    ],
)
def test_least_excess_by_hand(tau, tau_brake, theta, excess, sign):
    tau, tau_brake = sign * np.array(tau), sign * np.array(tau_brake)
    limits = np.full(len(tau), 5.0 if len(tau) == 1 else 1.0)
    found = scale(tau, tau_brake, tau_brake, limits)
    assert found.theta == pytest.approx(theta, abs=1e-12)
    assert found.excess == pytest.approx(excess, abs=1e-12)


def test_a_rounding_error_beyond_the_limit_is_none():
    """The first actuator is at its limit whatever is done, but for the last bit."""
    at_limit = np.nextafter(5.0, 6.0)
    found = scale([at_limit, 3.0], [at_limit, -1.0], [0.0, 0.0], [5.0, 5.0], 0.5)
    assert found.theta == 1.0 and found.excess == 0.0
    # A thousandth more is a violation, and no share is better than braking.
    found = scale([5.005, 3.0], [5.005, -1.0], [0.0, 0.0], [5.0, 5.0], 0.5)
    assert found.theta == 0.0 and found.excess == pytest.approx(1e-3)


def test_speed_is_kept_low_enough_to_brake():
    """A mass pushed by a far target under the limit never outruns its brakes."""
    mass, limit, T, dt = 2.0, 10.0, 0.05, 1e-3
    v, fastest = 0.0, 0.0
    for _ in range(3000):
        tau_brake, wish = -mass * v / T, mass * (5.0 - v) / T  # s = 5 m/s
        found = scale([wish], [tau_brake], [0.0], [limit], dt / T)
        tau = tau_brake + found.theta * (wish - tau_brake)
        assert found.excess == 0.0 and abs(tau) <= limit * (1 + 1e-9)
        v += dt * tau / mass
        fastest = max(fastest, v)
    assert mass * fastest / T <= limit  # braking at q_ddot = -q_dot / T is possible
    assert fastest > 0.7 * limit * T / mass  # and it is not needlessly slow


@pytest.mark.parametrize(
    "tau, tau_brake, tau_still, theta",
    [
        # L = 10, dt / T = 1/2. Next braking torque: -3 - 7.5 theta, of at most 8.
        (9.0, -6.0, 0.0, 2.0 / 3.0),
        # 1 beyond the reserve of 8. Braking alone leaves 4.5: 8 >= 4.5 + 6 theta.
        (3.0, -9.0, 0.0, 7.0 / 12.0),
        # It leaves 8.2, and that is what it is to come back to.
        (3.0, -9.0, -7.4, 0.0),
        # The mirror images.
        (-9.0, 6.0, 0.0, 2.0 / 3.0),
        (-3.0, 9.0, 0.0, 7.0 / 12.0),
        # Torques up to 20: theta <= 0.5. Next: 12 - 10 theta <= 8 asks for 0.4 or more.
        (20.0, 0.0, 24.0, 0.5),
        # 15 - 10 theta <= 8 asks for 0.7, which is not allowed: the least allowed.
        (20.0, 0.0, 30.0, 0.0),
        # Only 0.25 and more is allowed, and no share leaves a next braking torque of
        # 10 or less, 11 + 4 theta: the least allowed, again.
        (-4.0, -12.0, -10.0, 0.25),
        # 10 - 2.5 theta <= 8 asks for 0.8 or more, which is allowed.
        (5.0, 0.0, 20.0, 1.0),
    ],
)
def test_share_that_leaves_room_to_brake_by_hand(tau, tau_brake, tau_still, theta):
    found = scale([tau], [tau_brake], [tau_still], [10.0], 0.5)
    assert found.theta == pytest.approx(theta, abs=1e-9)
    assert found.excess == 0.0


@settings(max_examples=300, deadline=None)
@given(
    vectors,
    vectors,
    vectors,
    arrays(float, 4, elements=st.floats(20.0, 60.0)),
    st.sampled_from([0.02, 0.2, 0.5, 1.0]),
)
def test_the_largest_share_that_leaves_room_to_brake(
    tau, tau_brake, tau_still, limits, c
):
    """By trying shares: of those within the limits the largest after which braking
    needs 80 % of them or, where it needs more, no more than now and no more than after
    braking; or else the smallest within the limits."""
    braked = tau_brake - c * (tau_brake - tau_still)
    least = np.minimum(np.abs(tau_brake), np.abs(braked))
    room = np.maximum(0.8 * limits, least)

    def allowed(theta: np.ndarray, slack: float) -> np.ndarray:
        now = tau_brake + theta[:, None] * (tau - tau_brake)
        return (np.abs(now) <= limits * (1.0 + slack)).all(axis=1)

    def kept(theta: np.ndarray, slack: float) -> np.ndarray:
        now = tau_brake + theta[:, None] * (tau - tau_brake)
        after = tau_brake - c * (now - tau_still)
        return (np.abs(after) <= room * (1.0 + slack)).all(axis=1)

    # Shares that are right, or that may be, whatever rounding does.
    right = allowed(THETA, -1e-9)
    assume(right.any())
    found = scale(tau, tau_brake, tau_still, limits, c)
    at = np.array([found.theta])
    assert found.excess == 0.0
    assert 0.0 <= found.theta <= 1.0 and allowed(at, 1e-9)[0]
    if (right & kept(THETA, -1e-9)).any():
        assert kept(at, 1e-9)[0]
        assert found.theta >= THETA[right & kept(THETA, -1e-9)].max() - 1e-9
    elif not kept(at, 1e-9)[0]:
        assert found.theta <= THETA[right].min() + 1e-9


class Arm(NamedTuple):
    """A robot of three joints with affine torque; the last joint is prescribed."""

    H: np.ndarray
    bias: np.ndarray
    v: np.ndarray
    wish: np.ndarray
    horizon: float = 0.05
    period: float = 1e-3

    def torque(self, vdot: np.ndarray) -> np.ndarray:
        return self.H @ vdot + self.bias

    def limited(self, limits) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return limit_torque(
            self.wish,
            self.torque(self.wish),
            self.H,
            self.v,
            np.array([0, 1]),
            np.asarray(limits, float),
            self.horizon,
            self.period,
        )

    def nearest(self, limits, lowest=-np.inf, highest=np.inf) -> np.ndarray:
        return nearest_accelerations(
            self.wish,
            self.torque(self.wish),
            self.H,
            self.v,
            np.array([0, 1]),
            np.asarray(limits, float),
            np.broadcast_to(lowest, 2) + np.zeros(2),
            np.broadcast_to(highest, 2) + np.zeros(2),
            self.horizon,
            self.period,
        )

    def slowed(self, theta: float) -> np.ndarray:
        """Accelerations (theta s - v) / T of the controlled joints, s = v + T vdot."""
        s = self.v + self.horizon * self.wish
        vdot = (theta * s - self.v) / self.horizon
        vdot[2] = self.wish[2]
        return vdot


@pytest.fixture
def arm() -> Arm:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(3, 3))
    return Arm(
        H=root @ root.T + np.eye(3),
        bias=rng.normal(size=3),
        v=0.05 * rng.normal(size=3),
        wish=np.array([30.0, -20.0, 5.0]),
    )


def test_torque_within_the_limits_is_left_alone(arm):
    vdot, tau, (theta, excess) = arm.limited([1e4, np.inf, 1e4])
    assert theta == 1.0 and excess == 0.0
    np.testing.assert_array_equal(vdot, arm.wish)
    np.testing.assert_array_equal(tau, arm.torque(arm.wish))


def test_torque_within_the_limits_is_left_alone_to_the_last_bit(arm):
    """Also where braking is so hard that adding and subtracting it would round."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        wish, v = rng.normal(size=(2, 3))
        hasty = arm._replace(wish=wish, v=v)
        vdot, tau, _ = hasty.limited([1e6, np.inf, 1e6])
        np.testing.assert_array_equal(vdot, wish)
        np.testing.assert_array_equal(tau, hasty.torque(wish))


def test_limited_torque_is_that_of_the_slower_resting_point(arm):
    """The prescribed joint keeps its acceleration; the largest share is taken."""
    limits = np.abs(arm.torque(arm.slowed(0.6))) * [1.0, 1.5, 1.5]
    assert np.abs(arm.torque(arm.slowed(0.61)))[0] > limits[0]
    # Braking in the next step must need less than 80 % of these limits.
    after = arm.torque(arm.slowed(0.0)) - arm.period / arm.horizon * (
        arm.torque(arm.slowed(0.6)) - arm.torque(np.array([0.0, 0.0, arm.wish[2]]))
    )
    assert (np.abs(after) < 0.8 * limits).all()
    vdot, tau, (theta, excess) = arm.limited(limits)
    assert theta == pytest.approx(0.6, abs=1e-9) and excess == 0.0
    np.testing.assert_allclose(vdot, arm.slowed(theta), rtol=1e-9)
    np.testing.assert_allclose(tau, arm.torque(vdot), rtol=1e-9)


def test_limited_torque_leaves_room_to_brake(arm):
    """By trying shares; what no acceleration costs is that of the controlled joints,
    while the prescribed joint goes on."""
    arm = arm._replace(period=0.03)
    c = arm.period / arm.horizon
    brake = arm.torque(arm.slowed(0.0))
    limits = np.maximum(np.abs(brake), np.abs(arm.torque(arm.wish))) * 1.01

    def largest(still: np.ndarray) -> float:
        now = np.array([arm.torque(arm.slowed(theta)) for theta in THETA])
        after = brake - c * (now - arm.torque(still))
        braked = brake - c * (brake - arm.torque(still))
        room = np.maximum(0.8 * limits, np.minimum(np.abs(brake), np.abs(braked)))
        kept = (np.abs(now) <= limits) & (np.abs(after) <= room)
        return THETA[kept.all(axis=1)].max()

    expected = largest(np.array([0.0, 0.0, arm.wish[2]]))
    assert 0.05 < expected < 0.95
    assert abs(largest(np.zeros(3)) - expected) > 0.01
    vdot, tau, (theta, excess) = arm.limited(limits)
    assert theta == pytest.approx(expected, abs=THETA[1]) and excess == 0.0
    np.testing.assert_allclose(vdot, arm.slowed(theta), rtol=1e-9)
    np.testing.assert_allclose(tau, arm.torque(vdot), rtol=1e-9)


def test_torque_that_no_share_limits_is_clipped(arm):
    limits = 0.2 * np.abs(arm.torque(arm.slowed(0.0)))
    _, tau, (theta, excess) = arm.limited(limits)
    assert excess > 0.0
    free = arm.torque(arm.slowed(theta))
    assert (np.abs(free) / limits).max() == pytest.approx(1.0 + excess)
    np.testing.assert_allclose(tau, np.clip(free, -limits, limits), rtol=1e-9)


def nearest_in(A: np.ndarray, b: np.ndarray, wish: np.ndarray) -> np.ndarray:
    """The point of the plane nearest to the wish with A x <= b, by trying: it is the
    wish, on one line, or where two of them meet."""
    tried = [wish]
    for i, a in enumerate(A):
        tried.append(wish - (a @ wish - b[i]) / (a @ a) * a)
        for j in range(i):
            pair = A[[i, j]]
            if abs(np.linalg.det(pair)) > 1e-9:
                tried.append(np.linalg.solve(pair, b[[i, j]]))
    allowed = [x for x in tried if (A @ x <= b + 1e-9 * (1.0 + abs(b))).all()]
    return min(allowed, key=lambda x: np.linalg.norm(x - wish))


@pytest.mark.parametrize("seed", range(20))
def test_the_nearest_accelerations_are_those_of_a_quadratic_program(seed):
    """With intervals and bounds as they are meant."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3))
    arm = Arm(
        H=root @ root.T + np.eye(3),
        bias=rng.normal(size=3),
        v=0.3 * rng.normal(size=3),
        wish=30.0 * rng.normal(size=3),
        period=10.0 ** rng.uniform(-3.0, -2.0),
    )
    c, M = arm.period / arm.horizon, arm.H[:, :2]
    brake, still = arm.wish.copy(), arm.wish.copy()
    brake[:2], still[:2] = -arm.v[:2] / arm.horizon, 0.0
    tau_brake, tau_still = arm.torque(brake), arm.torque(still)
    limits = rng.uniform(1.3, 3.0, 3) * np.maximum(abs(tau_brake), abs(tau_still))
    lowest = np.minimum(brake[:2], 0.0) - rng.uniform(0.5, 40.0, 2)
    highest = np.maximum(brake[:2], 0.0) + rng.uniform(0.5, 40.0, 2)

    known = arm.bias + arm.H[:, 2] * arm.wish[2]
    # tau_b - c (tau - tau_still), of which tau - tau_still = M x.
    sides = [
        (M, limits - known),
        (-M, limits + known),
        (-c * M, 0.8 * limits - tau_brake),
        (c * M, 0.8 * limits + tau_brake),
        (np.eye(2), highest),
        (-np.eye(2), -lowest),
    ]
    A, b = (np.concatenate(part) for part in zip(*sides, strict=True))
    found = arm.nearest(limits, lowest, highest)
    np.testing.assert_allclose(found[:2], nearest_in(A, b, arm.wish[:2]), atol=2e-3)
    assert found[2] == arm.wish[2]
    # Next to nothing is outside: the rest of the way is clipped or slowed down.
    assert (np.abs(arm.torque(found)) <= limits).all()
    assert (lowest <= found[:2]).all() and (found[:2] <= highest).all()


def test_the_wish_itself_is_the_nearest_where_it_is_allowed(arm):
    np.testing.assert_array_equal(arm.nearest([1e4, np.inf, 1e4]), arm.wish)


def test_a_weak_motor_leaves_the_other_joints_alone():
    arm = Arm(
        H=np.diag([2.0, 3.0, 1.0]),
        bias=np.zeros(3),
        v=np.zeros(3),
        wish=np.array([30.0, -20.0, 5.0]),
    )
    np.testing.assert_allclose(
        arm.nearest([10.0, 1e3, 1e3]), [5.0, -20.0, 5.0], rtol=1e-5
    )


def test_the_share_of_the_wish_is_theta_where_it_was_slowed_down(arm):
    def share(vdot: np.ndarray, wish: np.ndarray = arm.wish) -> float:
        return share_of_nominal(vdot, wish, arm.v[:2], arm.horizon)

    for theta in (0.0, 0.3, 0.9):
        assert share(arm.slowed(theta)) == pytest.approx(theta, abs=1e-12)
    assert share(arm.wish - 3.0 * (arm.wish - arm.slowed(0.0))) == 0.0
    # All of it is left of itself alone, not where another joint gives way.
    assert share(arm.wish) == 1.0
    assert 1.0 - 1e-9 < share(arm.wish + [0.0, 0.0, 1.0]) < 1.0
    assert 1.0 - 1e-9 < share(np.nextafter(arm.wish, 100.0)) < 1.0
    # A wish to brake, and what the limits leave of it: no way, and no division.
    braking = -arm.v / arm.horizon
    with np.errstate(all="raise"):
        assert share(arm.wish, braking) == 0.0


def test_a_clipped_torque_and_its_excess():
    limits = np.array([10.0, 4.0, np.inf])
    torque, excess = clip_torque(np.array([-11.0, 3.0, 1e4]), limits)
    np.testing.assert_array_equal(torque, [-10.0, 3.0, 1e4])
    assert excess == pytest.approx(0.1)
    torque, excess = clip_torque(np.array([2.0, 9.0, 0.0]), limits)
    np.testing.assert_array_equal(torque, [2.0, 4.0, 0.0])
    assert excess == pytest.approx(1.25)
    for within in ([9.0, -4.0, 1e9], [10.0 * (1 + 1e-15), 0.0, 0.0]):
        torque, excess = clip_torque(np.array(within), limits)
        np.testing.assert_allclose(torque, within, rtol=1e-14)
        assert excess == 0.0


def test_braking_one_period_on():
    """The torque of the accelerations that brake at the velocity which they lead to."""
    rng = np.random.default_rng(4)
    M, bias = rng.normal(size=(3, 4)), rng.normal(size=3)
    v, vdot, T, period = rng.normal(size=4), rng.normal(size=4), 0.05, 0.01
    braking = vdot.copy()  # the others keep their acceleration
    for i in (0, 3):
        braking[i] = -(v[i] + period * vdot[i]) / T
    found = next_braking_torque(
        vdot, M @ vdot + bias, M, v, np.array([0, 3]), T, period
    )
    np.testing.assert_allclose(found, M @ braking + bias)
