"""Eqs. (4), (7), (8), (11) against SciPy's rotations and the printed formula."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crar_drake.law.references import find_error
from crar_drake.law.tasks import (
    DesiredTasks,
    TaskLayout,
    orientation_error,
    quaternion_from_rotation,
    rotation_from_quaternion,
)

KINDS = ("pose", "position", "orientation", "position", "pose")
NAMES = ("hand", "elbow", "head", "neck", "foot")


@pytest.fixture
def layout() -> TaskLayout:
    return TaskLayout(names=NAMES, kinds=KINDS)


def random_rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    return Rotation.random(count, random_state=rng).as_matrix()


def scipy_matrix(wxyz: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(np.roll(wxyz, -1, axis=-1)).as_matrix()


def half_turns(rng: np.random.Generator) -> np.ndarray:
    """Rotations by exactly or nearly 180 degrees: all axes that may be special."""
    axes = [np.eye(3), -np.eye(3), [[1, 1, 0], [0, 1, 1], [1, 0, -1], [1, 1, 1]]]
    axes = np.concatenate([*axes, rng.normal(size=(20, 3))]).astype(float)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    gaps = np.array([0.0, 1e-12, 1e-9, 1e-6, 1e-3])
    vectors = (np.pi - gaps)[:, None, None] * axes
    return Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix()


def test_orientation_error_is_the_printed_sum_of_cross_products():
    rng = np.random.default_rng(1)
    R, R_d = random_rotations(rng, 50), random_rotations(rng, 50)
    expected = np.zeros((50, 3))
    for i in range(50):
        for column in range(3):  # n, s, c
            expected[i] += 0.5 * np.cross(R[i][:, column], R_d[i][:, column])
    np.testing.assert_allclose(orientation_error(R, R_d), expected, atol=1e-15)


@pytest.mark.parametrize("degrees", [0.0, 1e-6, 1.0, 45.0, 90.0, 135.0, 179.0, 180.0])
def test_orientation_error_is_sine_times_axis(degrees):
    """From R to R_d about `axis` in W; it is zero again at 180 degrees."""
    rng = np.random.default_rng(2)
    for R in random_rotations(rng, 10):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        theta = np.radians(degrees)
        R_d = Rotation.from_rotvec(theta * axis).as_matrix() @ R
        np.testing.assert_allclose(
            orientation_error(R[None], R_d[None])[0], np.sin(theta) * axis, atol=1e-14
        )


def test_orientation_error_shape_without_tasks():
    assert orientation_error(np.empty((0, 3, 3)), np.empty((0, 3, 3))).shape == (0, 3)


def test_layout_rows_follow_the_tasks_angular_above_linear(layout):
    assert layout.m == 6 + 3 + 3 + 3 + 6
    assert layout.size_x == 7 + 3 + 4 + 3 + 7
    assert layout.size == 24 + 2 * 21
    assert layout.angular_tasks.tolist() == [0, 2, 4]
    assert layout.linear_tasks.tolist() == [0, 1, 3, 4]
    assert layout.angular_rows.tolist() == [[0, 1, 2], [9, 10, 11], [15, 16, 17]]
    assert layout.linear_rows.tolist() == [
        [3, 4, 5],
        [6, 7, 8],
        [12, 13, 14],
        [18, 19, 20],
    ]
    assert layout.quaternion_entries[:, 0].tolist() == [0, 10, 17]
    assert layout.position_entries[:, 0].tolist() == [4, 7, 14, 21]
    slices = [layout.rows_of(i) for i in range(5)]
    assert [(s.start, s.stop) for s in slices] == [
        (0, 6),
        (6, 9),
        (9, 12),
        (12, 15),
        (15, 21),
    ]


def test_unpack_undoes_pack(layout):
    rng = np.random.default_rng(3)
    R, p = random_rotations(rng, 3), rng.normal(size=(4, 3))
    v, a = rng.normal(size=layout.m), rng.normal(size=layout.m)
    desired = layout.pack(R, p, v, a)
    assert desired.shape == (layout.size,)
    target = layout.unpack(desired)
    np.testing.assert_allclose(target.R, R, atol=1e-14)
    np.testing.assert_array_equal(target.p, p)
    np.testing.assert_array_equal(target.v, v)
    np.testing.assert_array_equal(target.a, a)


def test_layout_refuses_an_unknown_kind_by_name():
    with pytest.raises(ValueError, match=r"task elbow: 'velocity'"):
        TaskLayout(("hand", "elbow"), ("pose", "velocity"))


def test_task_error_stacks_orientation_above_position(layout):
    rng = np.random.default_rng(5)
    R, R_d = random_rotations(rng, 3), random_rotations(rng, 3)
    p, p_d = rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    desired = DesiredTasks(R_d, p_d, np.zeros(layout.m), np.zeros(layout.m))
    e = find_error(np.zeros(0), R, p, desired, layout.rows)
    angular = [0.5 * np.cross(R[i], R_d[i], axis=0).sum(axis=1) for i in range(3)]
    linear = p_d - p
    expected = np.r_[
        angular[0], linear[0], linear[1], angular[1], linear[2], angular[2], linear[3]
    ]
    np.testing.assert_allclose(e, expected, atol=1e-15)


def test_rotation_from_quaternion_is_scipys():
    rng = np.random.default_rng(6)
    quaternions = rng.normal(size=(200, 4))  # of any length
    np.testing.assert_allclose(
        rotation_from_quaternion(quaternions), scipy_matrix(quaternions), atol=1e-14
    )


def test_quaternion_from_rotation_is_scipys_with_positive_w():
    rng = np.random.default_rng(7)
    R = random_rotations(rng, 200)
    quaternions = quaternion_from_rotation(R)
    expected = np.roll(Rotation.from_matrix(R).as_quat(), 1, axis=-1)
    expected *= np.where(expected[:, :1] < 0.0, -1.0, 1.0)
    np.testing.assert_allclose(quaternions, expected, atol=1e-13)
    assert (quaternions[:, 0] >= 0.0).all()


def test_quaternions_of_half_turns_give_the_rotation_back():
    """w is about 0: the sign is free, and the trace formula would fail."""
    R = half_turns(np.random.default_rng(8))
    quaternions = quaternion_from_rotation(R)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, atol=1e-14)
    assert (quaternions[:, 0] >= 0.0).all()
    np.testing.assert_allclose(scipy_matrix(quaternions), R, atol=1e-14)
    np.testing.assert_allclose(rotation_from_quaternion(quaternions), R, atol=1e-14)


def test_quaternions_of_the_identity_and_of_single_matrices():
    np.testing.assert_allclose(
        quaternion_from_rotation(np.eye(3)), [1, 0, 0, 0], atol=1e-15
    )
    np.testing.assert_allclose(
        rotation_from_quaternion(np.array([[-2.0, 0, 0, 0]])), np.eye(3)[None]
    )
    assert quaternion_from_rotation(np.empty((0, 3, 3))).shape == (0, 4)
    assert rotation_from_quaternion(np.empty((0, 4))).shape == (0, 3, 3)


def test_a_zero_quaternion_gives_nan_quietly():
    assert np.isnan(rotation_from_quaternion(np.zeros((1, 4)))).all()
