"""Turns of quaternions against SciPy's rotations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from crar_drake.equations.quaternions import turn_between, turned, turned_on


def wxyz(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat()[[3, 0, 1, 2]]


def rotation(quaternion: np.ndarray) -> Rotation:
    return Rotation.from_quat(quaternion[[1, 2, 3, 0]])


ANGLES = [0.0, 1e-12, 1e-7, 1e-3, 1.0, 3.0, np.pi - 1e-9, 4.0, 7.0, 25.0]


@pytest.mark.parametrize("angle", ANGLES)
def test_a_turn_is_scipys(angle: float) -> None:
    rng = np.random.default_rng(1)
    axis = rng.normal(size=3)
    phi = angle * axis / np.linalg.norm(axis)
    start = 3.0 * wxyz(Rotation.random(random_state=2))
    end = turned(start, phi)
    expected = Rotation.from_rotvec(phi) * rotation(start)
    assert (rotation(end) * expected.inv()).magnitude() < 2e-15 * (1.0 + angle)
    assert np.linalg.norm(end) == pytest.approx(1.0, abs=1e-15)
    # The way back, by the shorter way, whatever sign the quaternion has.
    shorter = (expected * rotation(start).inv()).as_rotvec()
    for sign in (1.0, -2.0):
        back = turn_between(start, sign * end)
        np.testing.assert_allclose(back, shorter, atol=3e-15 * (1.0 + angle))
    # Small ones keep their digits, which a matrix would lose.
    if 0.0 < angle < 1e-3:
        np.testing.assert_allclose(turn_between(start, end), phi, rtol=1e-3, atol=1e-15)


def test_half_a_turn_is_found_and_so_is_none_of_any_length() -> None:
    """Exactly: there the cosine, and here the sine, of half the angle is 0."""
    none, about_x = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0, 0.0])
    for start, end in ((none, about_x), (about_x, none), (3.0 * none, -2.0 * about_x)):
        half = turn_between(start, end)
        np.testing.assert_allclose(np.abs(half), [np.pi, 0.0, 0.0], atol=1e-15)
    for length in (1e-3, 1.0, 1e3):
        np.testing.assert_array_equal(turn_between(length * none, none), np.zeros(3))


def test_a_continuous_turn_is_integrated_to_the_fifth_order() -> None:
    rng = np.random.default_rng(5)
    start = wxyz(Rotation.random(random_state=6))
    omega, alpha = 10.0 * rng.normal(size=3), 400.0 * rng.normal(size=3)

    def rate(t, R):
        turning = omega + t * alpha
        return np.cross(turning, R.reshape(3, 3), axisb=0, axisc=0).ravel()

    errors = []
    for period in (0.02, 0.01):
        R = solve_ivp(
            rate,
            (0.0, period),
            rotation(start).as_matrix().ravel(),
            rtol=1e-12,
            atol=1e-13,
        ).y[:, -1]
        found = rotation(turned_on(start, omega, alpha, period))
        expected = Rotation.from_matrix(R.reshape(3, 3))
        errors.append((found * expected.inv()).magnitude())
    assert errors[0] < 1e-3 and errors[1] < errors[0] / 20.0
