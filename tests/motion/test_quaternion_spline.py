"""Orientations along a spline, against finite differences and SciPy's rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crar_drake.motion.quaternion_spline import QuaternionSpline, sign_continuous

TIMES = np.linspace(0.0, 3.0, 31)


@pytest.fixture(scope="module")
def rotations() -> Rotation:
    """More than a turn about an axis that itself moves."""
    angles = np.stack([3.0 * TIMES, np.sin(TIMES), 0.5 * TIMES**2], axis=1)
    return Rotation.from_euler("ZYX", angles)


@pytest.fixture(scope="module")
def way(rotations) -> QuaternionSpline:
    signs = np.where(np.arange(len(TIMES)) % 3, 1.0, -1.0)  # any sign will do
    return QuaternionSpline(TIMES, rotations.as_quat() * signs[:, None])


def test_signs_become_continuous(rotations):
    quaternions = sign_continuous(rotations.as_quat())
    assert (np.sum(quaternions[1:] * quaternions[:-1], axis=1) > 0.0).all()
    same = Rotation.from_quat(quaternions) * rotations.inv()
    np.testing.assert_allclose(same.magnitude(), 0.0, atol=1e-9)


def test_it_passes_through_the_samples(way, rotations):
    for time, R in zip(TIMES, rotations.as_matrix(), strict=True):
        np.testing.assert_allclose(way(time)[0], R, atol=1e-12)


@pytest.mark.parametrize("t", [0.03, 0.5, 1.0, 1.234, 2.97])
def test_derivatives(way, t):
    h = 1e-5
    before, now, after = (way(t + k * h) for k in (-1, 0, 1))
    omega = Rotation.from_matrix(after[0] @ before[0].T).as_rotvec() / (2 * h)
    np.testing.assert_allclose(now[1], omega, atol=1e-7)
    np.testing.assert_allclose(now[2], (after[1] - before[1]) / (2 * h), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(omega), np.linalg.norm(now[1]))


def test_it_stands_still_outside(way):
    for t, end in ((-0.1, 0.0), (3.1, 3.0)):
        R, omega, alpha = way(t)
        np.testing.assert_array_equal(R, way(end)[0])
        assert not omega.any() and not alpha.any()
