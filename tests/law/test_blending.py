"""Blending onto the targets: every derivative by finite differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crar_drake.law.blending import (
    blend_rotations,
    blend_tasks,
    blend_vectors,
    rotation_from_vector,
    rotation_vector,
    smooth_step,
)
from crar_drake.law.tasks import DesiredTasks, TaskLayout

DURATION = 0.8
H = 1e-5  # step of the finite differences [s]


def axis_of(rng: np.random.Generator) -> np.ndarray:
    axis = rng.normal(size=3)
    return axis / np.linalg.norm(axis)


class MovingFrame:
    """R_0 exp(t a) exp(t^2 b / 2) R_1: its derivatives are known in closed form."""

    def __init__(self, R_0: np.ndarray, a: np.ndarray, b: np.ndarray) -> None:
        self.R_0, self.a, self.b = R_0, a, b

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        A = Rotation.from_rotvec(t * self.a).as_matrix()
        B = Rotation.from_rotvec(0.5 * t**2 * self.b).as_matrix()
        # Angular velocity in W: a (constant, about itself) and t b behind A.
        omega = self.a + A @ (t * self.b)
        omega_dot = np.cross(self.a, A @ (t * self.b)) + A @ self.b
        return A @ B @ self.R_0, omega, omega_dot


def angular_velocity(before: np.ndarray, after: np.ndarray, dt: float) -> np.ndarray:
    return Rotation.from_matrix(after @ before.T).as_rotvec() / dt


def test_smooth_step_starts_and_ends_at_rest():
    assert smooth_step(0.0, DURATION) == (0.0, 0.0, 0.0)
    assert smooth_step(-1.0, DURATION) == (0.0, 0.0, 0.0)
    assert smooth_step(DURATION, DURATION) == (1.0, 0.0, 0.0)
    assert smooth_step(9.0, DURATION) == (1.0, 0.0, 0.0)
    np.testing.assert_allclose(
        smooth_step(DURATION - 1e-9, DURATION), (1.0, 0.0, 0.0), atol=1e-6
    )
    assert smooth_step(0.5 * DURATION, DURATION)[0] == pytest.approx(0.5)


def test_smooth_step_of_no_duration_is_over_at_once():
    assert smooth_step(0.0, 0.0) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("t", [0.01, 0.2, 0.4, 0.61, 0.79])
def test_smooth_step_derivatives(t):
    before, now, after = (smooth_step(t + k * H, DURATION) for k in (-1, 0, 1))
    assert now[1] == pytest.approx((after[0] - before[0]) / (2 * H), rel=1e-6)
    assert now[2] == pytest.approx((after[1] - before[1]) / (2 * H), abs=1e-6)


def test_smooth_step_never_overshoots():
    values = [smooth_step(t, DURATION) for t in np.linspace(0.0, DURATION, 200)]
    assert all(0.0 <= s <= 1.0 and s_dot >= 0.0 for s, s_dot, _ in values)


@pytest.mark.parametrize("t", [0.05, 0.3, 0.5, 0.75])
def test_vector_derivatives_with_a_moving_target(t):
    start = np.array([[0.3, -0.2, 0.9], [1.0, 2.0, 3.0]])
    amplitude, rate = np.array([[0.4], [0.2]]), np.array([3.0, 5.0, 7.0])

    def blended(time: float):
        x = amplitude * np.sin(rate * time)
        v = amplitude * rate * np.cos(rate * time)
        a = -amplitude * rate**2 * np.sin(rate * time)
        return blend_vectors(start, x, v, a, smooth_step(time, DURATION))

    before, now, after = (blended(t + k * H) for k in (-1, 0, 1))
    np.testing.assert_allclose(now[1], (after[0] - before[0]) / (2 * H), atol=1e-6)
    np.testing.assert_allclose(now[2], (after[1] - before[1]) / (2 * H), atol=1e-6)


def test_vector_ends():
    start, x, v, a = np.arange(12.0).reshape(4, 3)
    p, p_dot, p_ddot = blend_vectors(start, x, v, a, smooth_step(0.0, DURATION))
    np.testing.assert_array_equal(p, start)
    assert not p_dot.any() and not p_ddot.any()
    for actual, expected in zip(
        blend_vectors(start, x, v, a, smooth_step(DURATION, DURATION)),
        (x, v, a),
        strict=True,
    ):
        np.testing.assert_allclose(actual, expected)


@pytest.mark.parametrize(
    "degrees", [0.0, 1e-7, 1e-3, 0.5, 0.6, 5.0, 90.0, 150.0, 170.0]
)
@pytest.mark.parametrize("t", [0.05, 0.3, 0.75])
def test_rotation_derivatives_with_a_moving_target(degrees, t):
    """The target is `degrees` from the start at time t and moves through there.

    About half a degree is where the series gives way to the closed form.
    """
    for seed in range(4):
        rng = np.random.default_rng(seed)
        R_start = Rotation.random(random_state=rng).as_matrix()
        offset = Rotation.from_rotvec(np.radians(degrees) * axis_of(rng)).as_matrix()
        a, b = 1.5 * rng.normal(size=3), 2.0 * rng.normal(size=3)
        frame = MovingFrame(np.eye(3), a, b)
        frame.R_0 = frame.at(t)[0].T @ R_start @ offset

        def blended(time: float, R_start=R_start, frame=frame):
            return blend_rotations(
                R_start, *frame.at(time), smooth_step(time, DURATION)
            )

        before, now, after = (blended(t + k * H) for k in (-1, 0, 1))
        np.testing.assert_allclose(
            now[1], angular_velocity(before[0], after[0], 2 * H), atol=2e-6
        )
        np.testing.assert_allclose(now[2], (after[1] - before[1]) / (2 * H), atol=2e-5)


@pytest.mark.parametrize("degrees", [0.0, 1e-6, 30.0, 170.0, 179.9])
def test_rotation_ends(degrees):
    rng = np.random.default_rng(4)
    R_start = Rotation.random(random_state=rng).as_matrix()
    R_d = R_start @ Rotation.from_rotvec(np.radians(degrees) * axis_of(rng)).as_matrix()
    omega, omega_dot = rng.normal(size=(2, 3))
    R, w, w_dot = blend_rotations(
        R_start, R_d, omega, omega_dot, smooth_step(0.0, DURATION)
    )
    np.testing.assert_allclose(R, R_start, atol=1e-14)
    assert not w.any() and not w_dot.any()
    R, w, w_dot = blend_rotations(
        R_start, R_d, omega, omega_dot, smooth_step(DURATION, DURATION)
    )
    np.testing.assert_allclose(R, R_d, atol=1e-12)
    np.testing.assert_allclose(w, omega, atol=1e-11)
    np.testing.assert_allclose(w_dot, omega_dot, atol=1e-9)


def test_half_way_to_a_fixed_target_is_half_the_angle():
    R_d = Rotation.from_rotvec([0.0, 0.0, 2.0]).as_matrix()
    R, w, w_dot = blend_rotations(
        np.eye(3), R_d, np.zeros(3), np.zeros(3), smooth_step(0.5 * DURATION, DURATION)
    )
    np.testing.assert_allclose(
        R, Rotation.from_rotvec([0.0, 0.0, 1.0]).as_matrix(), atol=1e-14
    )
    np.testing.assert_allclose(w, [0.0, 0.0, 2.0 * 30 / 16 / DURATION])
    np.testing.assert_allclose(w_dot, 0.0, atol=1e-12)


def test_rotation_vector_is_scipys():
    rng = np.random.default_rng(5)
    angles = np.r_[0.0, np.geomspace(1e-12, 3.1, 60), np.pi - np.geomspace(1e-3, 1, 9)]
    for angle in angles:
        phi = angle * axis_of(rng)
        R = Rotation.from_rotvec(phi).as_matrix()
        np.testing.assert_allclose(rotation_vector(R), phi, atol=1e-12)
        np.testing.assert_allclose(rotation_from_vector(phi), R, atol=1e-14)


@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-9, 1e-7, 1e-6, 1e-5])
def test_rotation_vector_near_180_degrees_gives_the_rotation_back(gap):
    rng = np.random.default_rng(6)
    axes = [*np.eye(3), *-np.eye(3), *(axis_of(rng) for _ in range(20))]
    for axis in axes:
        R = Rotation.from_rotvec((np.pi - gap) * axis).as_matrix()
        phi = rotation_vector(R)
        assert np.linalg.norm(phi) == pytest.approx(np.pi - gap, abs=1e-9)
        np.testing.assert_allclose(Rotation.from_rotvec(phi).as_matrix(), R, atol=1e-9)


def test_tasks_are_blended_row_by_row():
    """A mixed layout gives what its parts give on their own."""
    rng = np.random.default_rng(7)
    layout = TaskLayout(("a", "b", "c"), ("position", "pose", "orientation"))
    R_start = Rotation.random(2, random_state=rng).as_matrix()
    R_d = Rotation.random(2, random_state=rng).as_matrix()
    p_start, p_d = rng.normal(size=(2, 2, 3))
    v, a = rng.normal(size=(2, layout.m))
    step = smooth_step(0.3, DURATION)
    blended = blend_tasks(
        layout.rows,
        layout.pack(R_start, p_start),
        DesiredTasks(R=R_d, p=p_d, v=v, a=a),
        step,
    )
    # Rows: a.p 0-2, b.omega 3-5, b.p 6-8, c.omega 9-11.
    for i, rows in enumerate([slice(0, 3), slice(6, 9)]):
        p, p_dot, p_ddot = blend_vectors(p_start[i], p_d[i], v[rows], a[rows], step)
        np.testing.assert_allclose(blended.p[i], p)
        np.testing.assert_allclose(blended.v[rows], p_dot)
        np.testing.assert_allclose(blended.a[rows], p_ddot)
    for i, rows in enumerate([slice(3, 6), slice(9, 12)]):
        R, w, w_dot = blend_rotations(R_start[i], R_d[i], v[rows], a[rows], step)
        np.testing.assert_allclose(blended.R[i], R)
        np.testing.assert_allclose(blended.v[rows], w)
        np.testing.assert_allclose(blended.a[rows], w_dot)


def test_tasks_without_orientations():
    layout = TaskLayout(("a",), ("position",))
    none = np.empty((0, 3, 3))
    target = DesiredTasks(R=none, p=np.ones((1, 3)), v=np.ones(3), a=np.ones(3))
    blended = blend_tasks(layout.rows, np.zeros(3), target, (1.0, 0.0, 0.0))
    assert blended.R.shape == (0, 3, 3)
    np.testing.assert_array_equal(blended.p, np.ones((1, 3)))
