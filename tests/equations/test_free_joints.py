"""Free joints' configurations against SciPy's rotations, and Drake's own steps."""

import numpy as np
import pytest
from floating_robots import wxyz
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from crar_drake.equations.blending import blend_joints, smooth_step
from crar_drake.equations.free_joints import (
    PLAIN,
    displaced,
    displacement,
    has_orientation,
    turn_between,
    turned,
    turned_by_plant,
)
from crar_drake.equations.prediction import next_state


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


# Where an orientation begins among eight velocities: first, before and after plain
# entries, last.
PLACES = [0, 2, 5]


@pytest.mark.parametrize("turn", PLACES)
def test_displacements_and_configurations_fit_each_other(turn: int) -> None:
    """Of an orientation wherever it stands, and of plain joints alone."""
    rng = np.random.default_rng(3)
    q, x = rng.normal(size=9), 0.7 * rng.normal(size=8)
    moved = displaced(q, x, turn)
    np.testing.assert_allclose(displacement(q, moved, turn), x, atol=1e-14)
    plain_q = np.delete(np.arange(9), range(turn, turn + 4))
    plain_x = np.delete(np.arange(8), range(turn, turn + 3))
    np.testing.assert_array_equal(moved[plain_q], q[plain_q] + x[plain_x])
    expected = Rotation.from_rotvec(x[turn : turn + 3]) * rotation(q[turn : turn + 4])
    found = rotation(moved[turn : turn + 4])
    assert (found * expected.inv()).magnitude() < 1e-14
    # Half the displacement twice is the whole one: a way of constant velocity.
    half = displaced(q, 0.5 * x, turn)
    np.testing.assert_allclose(displaced(half, 0.5 * x, turn), moved, 1e-12)
    plain = rng.normal(size=(2, 5))
    np.testing.assert_array_equal(displaced(*plain, PLAIN), plain[0] + plain[1])
    np.testing.assert_array_equal(displacement(*plain, PLAIN), plain[1] - plain[0])


def test_a_quaternion_of_no_length_is_found() -> None:
    q = np.array([0.3, 1.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0])
    assert has_orientation(q, 1) and has_orientation(np.zeros(3), PLAIN)
    q[1] = 0.0
    assert not has_orientation(q, 1)
    q[1] = np.nan
    assert not has_orientation(q, 1)


@pytest.mark.parametrize("steps", [1, 5])
def test_the_next_state_is_where_drakes_steps_lead(steps: int) -> None:
    """Drake's discrete plant, its quaternion's rate and all, without a simulation."""
    plant = MultibodyPlant(0.0)
    plant.AddRigidBody("box", SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.2, 0.3))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    rng = np.random.default_rng(steps)
    q, v, a = np.append(rng.normal(size=4), [1.0, 2.0, 3.0]), *rng.normal(size=(2, 6))
    v, a, period = 8.0 * v, 300.0 * a, 5e-3
    found = next_state(q, v, a, period, period / steps, 0)
    for _ in range(steps):
        v = v + period / steps * a
        plant.SetPositions(context, q)
        q = q + period / steps * plant.MapVelocityToQDot(context, v)
    q[:4] /= np.linalg.norm(q[:4])
    np.testing.assert_allclose(found[0], q, atol=1e-14)
    np.testing.assert_allclose(found[1], v, atol=1e-12)


@pytest.mark.parametrize("step", [0.01, 1e-3, 2e-3, 0.05, 1.0])
@pytest.mark.parametrize("period", [0.01, 0.02, 0.06])
def test_a_turn_in_steps_is_theirs_and_of_a_longer_one_the_periods(
    period: float, step: float
) -> None:
    """Each step adds the quaternion's rate at the velocity after it."""
    rng = np.random.default_rng(4)
    steps = round(period / min(step, period))
    start = wxyz(Rotation.random(random_state=5))
    omega, alpha = 3.0 * rng.normal(size=3), 50.0 * rng.normal(size=3)
    end, d = start, period / steps
    for k in range(steps):
        rate = np.r_[0.0, 0.5 * (omega + (k + 1) * d * alpha)]
        (w, x), (a, b) = ((q[0], q[1:]) for q in (rate, end))
        turn = np.r_[w * a - x @ b, w * b + a * x + np.cross(x, b)]
        end = end + d * turn
    found = turned_by_plant(start, omega, alpha, period, step)
    np.testing.assert_allclose(found, end / np.linalg.norm(end), atol=1e-14)


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
        found = rotation(turned_by_plant(start, omega, alpha, period, 0.0))
        expected = Rotation.from_matrix(R.reshape(3, 3))
        errors.append((found * expected.inv()).magnitude())
    assert errors[0] < 1e-3 and errors[1] < errors[0] / 20.0


@pytest.mark.parametrize("turn", [0, 1, 4])
def test_blending_an_orientation_has_its_own_derivatives(turn: int) -> None:
    """From a start onto a moving target: rates by differences; starts where it is."""
    plain = np.array([0.4, 0.1, 0.0, 2.0])
    start = np.insert(plain, [turn] * 4, wxyz(Rotation.random(random_state=7)))
    first = Rotation.random(random_state=8)
    omega, slide = np.array([1.0, -2.0, 0.7]), np.array([0.3, 0.2, -0.5])

    def target(t):
        quaternion = -wxyz(Rotation.from_rotvec(t * omega) * first)  # the other sign
        x = np.append(np.sin(t), [1.0, 2.0, 3.0] + t * slide)
        return (
            np.insert(x, [turn] * 4, quaternion),
            np.insert(np.append(np.cos(t), slide), [turn] * 3, omega),
            np.insert([-np.sin(t), 0.0, 0.0, 0.0], [turn] * 3, 0.0),
        )

    def blended(t):
        return blend_joints(start, *target(t), smooth_step(t, 1.0), turn)

    q, v, _ = blended(0.0)
    np.testing.assert_allclose(displacement(start, q, turn), 0.0, atol=1e-12)
    np.testing.assert_allclose(v, 0.0, atol=1e-12)
    q, v, a = blended(1.0 - 1e-9)
    np.testing.assert_allclose(displacement(target(1.0)[0], q, turn), 0.0, atol=1e-8)
    h = 1e-5
    for t in (0.1, 0.4, 0.8):
        q, v, a = blended(t)
        (before, v_before, _), (after, v_after, _) = blended(t - h), blended(t + h)
        rate = displacement(before, after, turn) / (2.0 * h)
        np.testing.assert_allclose(v, rate, atol=1e-7)
        np.testing.assert_allclose(a, (v_after - v_before) / (2.0 * h), atol=1e-6)
