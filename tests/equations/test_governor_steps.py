"""Single steps of the governor, by the words and equations of its module."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crar_drake.equations.governor import (
    TargetBounds,
    _is_step,
    govern_orientation,
    govern_position,
    govern_tasks,
    start_governor,
)
from crar_drake.equations.tasks import TaskLayout

H = 5e-3  # control period [s]
V, A = 1.5, 20.0  # [m/s], [m/s^2]
W, B = 6.0, 80.0  # [rad/s], [rad/s^2]
FREE = np.inf


def at_most(x: np.ndarray, bound: float) -> np.ndarray:
    return x * min(1.0, bound / max(np.linalg.norm(x), 1e-300))


def chased(G, v, v_next, a_target, V, A) -> np.ndarray:
    """The acceleration of rule 2, by roots of its polynomials."""
    A = min(A, 4.0 * V / H)
    c = max(0.9 * (A - a_target), 0.1 * A)
    n, distance = G / np.linalg.norm(G), np.linalg.norm(G)
    r = np.roots([1.0, c * H, -2.0 * c * distance]).real.max()
    if np.isfinite(V):
        fastest = np.roots([1.0, 2.0 * v_next @ n, v_next @ v_next - V * V])
        # Where the target itself is as fast, rounding may leave no root.
        r = min(r, max(fastest.real.max(), 0.0))
    return at_most((at_most(v_next + r * n, V) - v) / H, A)


def random_vectors(rng: np.random.Generator, sizes) -> list[np.ndarray]:
    """Of lengths up to these, often the whole of them."""
    found = []
    for size in sizes:
        x = rng.normal(size=3)
        found.append(rng.choice([0.0, rng.uniform(), 1.0]) * size * at_most(x, 1.0))
    return found


@pytest.mark.parametrize("bounds", [(V, A), (V, FREE), (FREE, A)], ids=str)
@pytest.mark.parametrize("far", [1e-3, 0.03, 1.0])
def test_a_position_is_chased_as_the_module_says(bounds, far) -> None:
    """From random states, after targets that move within the bounds and beyond."""
    rng = np.random.default_rng(3)
    top, most = min(bounds[0], 3.0), min(bounds[1], 500.0)
    chases = 0
    for _ in range(200):
        x_d, p0, v_d, v0, a_d, a0 = random_vectors(
            rng, (far, far, 1.5 * top, top, 1.5 * most, most)
        )
        p, v, a = govern_position(x_d, v_d, a_d, p0, v0, a0, *bounds, H)
        if (p == x_d).all():
            continue
        v_new = at_most(v0 + H * a0, bounds[0])
        a_then = (v_new - v0) / H
        np.testing.assert_allclose(v, v_new, atol=1e-12)
        np.testing.assert_allclose(p, p0 + H * v0 + 0.5 * H * H * a_then, atol=1e-12)
        v_t, a_t = at_most(v_d, bounds[0]), at_most(a_d, bounds[1])
        x_next = x_d + H * v_t + 0.5 * H * H * a_t
        v_next = at_most(v_t + H * a_t, bounds[0])
        mean = (v_next - v) / H
        if (np.abs(a - mean) < 1e-9).all():  # the step onto the target
            continue
        G = x_next - p - 0.5 * H * (v + v_next)
        expected = chased(G, v, v_next, np.linalg.norm(a_t), *bounds)
        np.testing.assert_allclose(a, expected, rtol=1e-6, atol=1e-6 * most)
        chases += 1
    assert chases > 3


@pytest.mark.parametrize("bounds", [(W, B), (W, FREE), (FREE, B)], ids=str)
@pytest.mark.parametrize("far", [1e-2, 0.3, 2.0])
def test_an_orientation_is_chased_as_the_module_says(bounds, far) -> None:
    """Likewise; what was said is integrated in fifty small turns."""
    rng = np.random.default_rng(4)
    top, most = min(bounds[0], 12.0), min(bounds[1], 1000.0)

    def ahead(R: Rotation, omega, alpha) -> Rotation:
        for k in range(50):
            small = H / 50.0 * (omega + (k + 0.5) / 50.0 * H * alpha)
            R = Rotation.from_rotvec(small) * R
        return R

    chases = 0
    for _ in range(60):
        turn, v_d, v0, a_d, a0 = random_vectors(
            rng, (far, 1.5 * top, top, 1.5 * most, most)
        )
        begin = Rotation.random(random_state=rng)
        end = Rotation.from_rotvec(turn) * begin
        p0, x_d = (R.as_quat(scalar_first=True) for R in (begin, end))
        p, v, a = govern_orientation(3.0 * x_d, v_d, a_d, p0, v0, a0, *bounds, H)
        if (p == 3.0 * x_d).all():
            continue
        v_new = at_most(v0 + H * a0, bounds[0])
        then = ahead(begin, v0, (v_new - v0) / H)
        here = Rotation.from_quat(p, scalar_first=True)
        np.testing.assert_allclose(v, v_new, atol=1e-12)
        assert (here * then.inv()).magnitude() < 1e-7
        v_t, a_t = at_most(v_d, bounds[0]), at_most(a_d, bounds[1])
        v_next = at_most(v_t + H * a_t, bounds[0])
        if (np.abs(a - (v_next - v) / H) < 1e-9).all():
            continue
        on = Rotation.from_rotvec(0.5 * H * (v + v_next)) * here
        G = (ahead(end, v_t, a_t) * on.inv()).as_rotvec()
        expected = chased(G, v, v_next, np.linalg.norm(a_t), *bounds)
        np.testing.assert_allclose(a, expected, rtol=1e-4, atol=1e-4 * most)
        chases += 1
    assert chases > 3


@pytest.mark.parametrize("beyond", [0.99, 1.01])
@pytest.mark.parametrize("side", [0, 1])
def test_the_step_onto_a_position_is_admissible_or_chased(beyond, side) -> None:
    """It ends as far from where either velocity leads as A allows, or farther: with the
    mean acceleration, or with another."""
    rng, end = np.random.default_rng(6), 0.5 * A * H * H
    for _ in range(20):
        p0, v0, a0, change, aside = rng.normal(size=(5, 3))
        v0, a0 = 0.3 * V * at_most(v0, 1.0), 0.5 * A * at_most(a0, 1.0)
        p, v = p0 + H * v0 + 0.5 * H * H * a0, v0 + H * a0
        # With so small a change of velocity both tell about the same, and one more.
        v_next = v + 0.02 * A * H * at_most(change, 1.0)
        off = beyond * end * aside / np.linalg.norm(aside)
        gap = H * (v, v_next)[side] + off
        if np.linalg.norm(gap - H * (v_next, v)[side]) > beyond * end:
            gap -= 2.0 * off
        # One that asks for more than A is never passed as it is.
        a_d = rng.normal(size=3)
        a_d *= 1.5 * A / np.linalg.norm(a_d)
        v_d = v_next - H * at_most(a_d, A)
        x_d = p + gap - H * v_d - 0.5 * H * H * at_most(a_d, A)
        found = govern_position(x_d, v_d, a_d, p0, v0, a0, V, A, H)
        np.testing.assert_allclose(found[0], p, atol=1e-12)
        is_mean = np.allclose(found[2], (v_next - v) / H, atol=1e-6)
        assert is_mean == (beyond < 1.0)


def test_a_step_is_told_by_each_of_its_four_bounds() -> None:
    """At a ten-thousandth more than each, and less."""
    rng = np.random.default_rng(7)
    for turn in (0.0, 0.2):
        most = [V * H, *2 * [(1.0 + turn) * 0.5 * A * H * H], A * H]
        for which in range(4):
            for scale in (1.0 - 1e-4, 1.0 + 1e-4):
                x = rng.normal(size=(4, 3))
                x /= np.linalg.norm(x, axis=1)[:, None]
                x *= 0.5 * np.array(most)[:, None]
                x[which] *= 2.0 * scale
                assert _is_step(*x, 0.0, turn, V, A, H) == (scale < 1.0)


def test_far_from_the_origin_rounding_counts_and_no_more() -> None:
    """A circle at the bounds, a thousand kilometres away, is passed bit for bit; a
    micrometre more is not."""
    r, far, h = V**2 / A, np.array([1e6, -2e5, 3e5]), 1e-3
    rate, u = V / r, np.eye(3)[:2]

    def at(t: float):
        (x, y), (c, s) = u, (np.cos(rate * t), np.sin(rate * t))
        out = c * x + s * y
        return far + r * out, V * (c * y - s * x), -A * out

    before = at(0.0)
    for k in range(1, 200):
        now = at(k * h)
        found = govern_position(*now, *before, V, A, h)
        for one, other in zip(found, now, strict=True):
            np.testing.assert_array_equal(one, other)
        off = (now[0] + 1e-6 * u[0], *now[1:])
        assert (govern_position(*off, *before, V, A, h)[0] != off[0]).any()
        before = now


@pytest.mark.parametrize("step", [0, 1])
@pytest.mark.parametrize("speed", [1.0, 5.0])
def test_a_turning_frame_leaves_an_orientation_more_of_a_bend(step, speed) -> None:
    """Passed as it is, and in the step onto it: 1 + 2 h speed times as much."""
    for beyond in (-1e-3, 1e-3):
        v = np.array([0.0, 0.6, 0.8]) * speed
        most = 0.5 * B * H * H * (1.0 + 2.0 * H * speed) * (1.0 + beyond)
        begin = Rotation.random(random_state=1)
        p0, still = begin.as_quat(scalar_first=True), np.zeros(3)
        # Along the axis, so that from either velocity it is as far.
        end = Rotation.from_rotvec((1 + step) * H * v + most * v / speed) * begin
        x_d = end.as_quat(scalar_first=True)
        if step:  # one period more, of what is never passed as it is
            a_d = np.array([1.5 * B, 0.0, 0.0])
            v_d = v - H * a_d / 1.5
            back = -H * v_d - 0.5 * H * H * a_d / 1.5
            x_d = (Rotation.from_rotvec(back) * end).as_quat(scalar_first=True)
            # The turn of a period to a few parts in a million; most is of 1e-3.
            found = govern_orientation(x_d, v_d, a_d, p0, v, still, W, B, H)
            is_on = np.abs(found[2]).max() < 1e-9
        else:
            found = govern_orientation(x_d, v, still, p0, v, still, W, B, H)
            is_on = (found[0] == x_d).all()
        assert is_on == (beyond < 0.0)


def test_without_a_bound_on_acceleration_it_turns_round_in_a_period() -> None:
    x, still = np.array([1.0, 0.0, 0.0]), np.zeros(3)
    found = govern_position(-x, still, still, x, V * x, still, V, FREE, H)
    np.testing.assert_allclose(found[1] + H * found[2], -V * x, rtol=1e-12)


def test_without_a_gap_the_velocity_alone_is_chased() -> None:
    """The target comes to where this would be, but far too fast for it."""
    h, still = 2.0**-8, np.zeros(3)
    v_d = np.array([1.0, 0.0, 0.0])
    found = govern_position(-0.5 * h * v_d, v_d, still, still, still, still, V, A, h)
    np.testing.assert_array_equal(found[0], still)
    np.testing.assert_allclose(found[2], [A, 0.0, 0.0])


def test_many_poses_are_governed_each_as_if_alone() -> None:
    rng, bounds = np.random.default_rng(9), TargetBounds(V, A, W, B)
    alone = TaskLayout(("a",), ("pose",))
    layout = TaskLayout(("a", "b", "c"), 3 * ("pose",))
    poses = [
        (Rotation.random(1, random_state=rng).as_matrix(), rng.normal(size=(1, 3)))
        for _ in range(6)
    ]
    rates = rng.normal(size=(3, 6))
    R, p = (np.concatenate([pose[k] for pose in poses]) for k in (0, 1))
    still, each = np.zeros(18), np.zeros(6)
    begin = layout.pack(R[:3], p[:3], still, still)
    desired = layout.pack(R[3:], p[3:], still, still)
    before = start_governor(begin, rates.ravel(), layout.rows, bounds, H)
    governed = govern_tasks(desired, before, layout.rows, bounds, H)
    for k in range(3):
        own = start_governor(
            alone.pack(*poses[k], each, each), rates[k], alone.rows, bounds, H
        )
        to = alone.pack(*poses[3 + k], each, each)
        expected = govern_tasks(to, own, alone.rows, bounds, H)
        for whole, part in ((before, own), (governed, expected)):
            x, v, a = np.split(whole, [21, 39])
            found = np.concatenate(
                [x[7 * k : 7 * k + 7], v[6 * k : 6 * k + 6], a[6 * k : 6 * k + 6]]
            )
            np.testing.assert_array_equal(found, part)


@pytest.mark.parametrize("bounds", [(W, FREE), (FREE, B)], ids=str)
def test_bounds_of_orientations_may_be_given_each_for_itself(bounds) -> None:
    layout = TaskLayout(("a",), ("orientation",))
    far = Rotation.from_rotvec([0.0, 2.0, 0.0]).as_quat(scalar_first=True)
    begin = np.concatenate(([1.0, 0.0, 0.0, 0.0], np.zeros(6)))
    both = TargetBounds(FREE, FREE, *bounds)
    before = start_governor(begin, np.zeros(3), layout.rows, both, H)
    governed = govern_tasks(
        np.concatenate((far, np.zeros(6))), before, layout.rows, both, H
    )
    np.testing.assert_allclose(governed[:4], begin[:4], atol=1e-12)
    assert np.abs(governed[7:]).max() > 1.0


def test_the_tasks_after_a_quaternion_of_no_length_are_governed() -> None:
    layout = TaskLayout(("a", "b"), ("orientation", "orientation"))
    bounds = TargetBounds(V, A, W, B)
    begin = np.concatenate((*2 * [[1.0, 0.0, 0.0, 0.0]], np.zeros(12)))
    before = start_governor(begin, np.zeros(6), layout.rows, bounds, H)
    desired = begin.copy()
    desired[:8] = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]
    governed = govern_tasks(desired, before, layout.rows, bounds, H)
    np.testing.assert_array_equal(governed[:4], 0.0)
    np.testing.assert_allclose(governed[4:8], begin[4:8], atol=1e-12)
