"""The governor for targets: bounds, no lag within them, arrival, consistency."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crar_drake.equations.governor import TargetBounds, govern_tasks, start_governor
from crar_drake.equations.tasks import TaskLayout

H = 5e-3  # control period [s]
V, A = 1.5, 20.0  # [m/s], [m/s^2]
W, B = 6.0, 80.0  # [rad/s], [rad/s^2]
BOUNDS = TargetBounds(V, A, W, B)
POSITION = TaskLayout(("tip",), ("position",))
ORIENTATION = TaskLayout(("tip",), ("orientation",))
ZERO = np.zeros(3)


def target(x, v=ZERO, a=ZERO) -> np.ndarray:
    return np.concatenate([x, v, a])


def start(layout: TaskLayout, x, v=None, bounds=BOUNDS, h: float = H) -> np.ndarray:
    pose = np.r_[x, np.zeros(2 * layout.m)]
    v = np.zeros(layout.m) if v is None else np.asarray(v, dtype=float)
    return start_governor(pose, v, layout.rows, bounds, h)


def follow(
    layout: TaskLayout,
    desired: Callable[[float], np.ndarray],
    before: np.ndarray,
    duration: float,
    bounds: TargetBounds = BOUNDS,
    h: float = H,
) -> tuple[np.ndarray, np.ndarray]:
    """The governed targets and those given, (N, size) each."""
    given = np.array([desired(k * h) for k in range(round(duration / h))])
    governed = []
    for now in given:
        before = govern_tasks(now, before, layout.rows, bounds, h)
        governed.append(before)
    return np.array(governed), given


def passed(governed: np.ndarray, given: np.ndarray) -> np.ndarray:
    return (governed == given).all(axis=1)


def lengths(x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(x, axis=1)


def rotations(governed: np.ndarray) -> Rotation:
    return Rotation.from_quat(governed[:, :4], scalar_first=True)


def check_position(governed: np.ndarray, given: np.ndarray, V=V, A=A, h=H) -> None:
    """What is said is within the bounds, and so is what is done."""
    slack = 1.0 + 2e-6
    p, v, a = governed[:, :3], governed[:, 3:6], governed[:, 6:]
    assert lengths(v).max() <= slack * V
    assert lengths(a).max() <= slack * A
    assert lengths(np.diff(p, axis=0)).max() <= slack * V * h
    assert lengths(np.diff(v, axis=0)).max() <= slack * A * h
    assert lengths(np.diff(p, 2, axis=0)).max() <= slack * A * h**2
    # And it is the integral of what was said, where the target is not passed. (One
    # that was may have said an acceleration that leads beyond V.)
    chases = ~passed(governed, given)[1:]
    chases &= lengths(v[:-1] + h * a[:-1]) <= V * (1.0 + 1e-12)
    assert chases.sum() > 5
    np.testing.assert_allclose(
        p[1:][chases],
        (p[:-1] + h * v[:-1] + h**2 / 2 * a[:-1])[chases],
        rtol=0.0,
        atol=1e-12,
    )
    np.testing.assert_allclose(
        v[1:][chases], (v[:-1] + h * a[:-1])[chases], rtol=0.0, atol=1e-10
    )


def check_orientation(governed: np.ndarray, given: np.ndarray, h: float = H) -> None:
    slack = 1.0 + 2e-6
    R, v, a = rotations(governed), governed[:, 4:7], governed[:, 7:]
    assert lengths(v).max() <= slack * W
    assert lengths(a).max() <= slack * B
    assert (R[1:] * R[:-1].inv()).magnitude().max() <= slack * W * h
    assert lengths(np.diff(v, axis=0)).max() <= slack * B * h
    chases = ~passed(governed, given)[1:]
    np.testing.assert_allclose(
        v[1:][chases], (v[:-1] + h * a[:-1])[chases], rtol=0.0, atol=1e-10
    )
    # The integral in twenty small turns, each about its mean velocity.
    end = R[:-1]
    for i in range(20):
        mean = v[:-1] + (i + 0.5) / 20 * h * a[:-1]
        end = Rotation.from_rotvec(h / 20 * mean) * end
    wrong = (R[1:] * end.inv()).magnitude()[chases]
    assert wrong.max(initial=0.0) < 2e-6


def sine(amplitude: float, rate: float, phase: float = 0.0, axis=(0.6, 0.0, 0.8)):
    axis = np.array(axis)

    def at(t: float) -> np.ndarray:
        s, c = np.sin(rate * t + phase), np.cos(rate * t + phase)
        return target(
            np.array([0.3, 0.2, 1.0]) + amplitude * s * axis,
            amplitude * rate * c * axis,
            -amplitude * rate**2 * s * axis,
        )

    return at


def bang_bang(t: float) -> np.ndarray:
    """To and fro at the bounds: accelerations jump, between control steps too."""
    ramp = V / A
    s, x = t % (4.0 * ramp), 0.5 * V * ramp
    if s < ramp:
        d, v, a = 0.5 * A * s**2, A * s, A
    elif s < 3.0 * ramp:
        u = s - ramp
        d, v, a = x + V * u - 0.5 * A * u**2, V - A * u, -A
    else:
        u = s - 3.0 * ramp
        d, v, a = x - V * u + 0.5 * A * u**2, -V + A * u, A
    axis = np.array([0.6, 0.0, -0.8])
    return target(np.array([2.0, 0.1, 1.0]) + d * axis, v * axis, a * axis)


def circle(t: float) -> np.ndarray:
    """As fast as the bounds allow: V^2 / r = A."""
    r = V**2 / A
    rate = V / r
    c, s = np.cos(rate * t), np.sin(rate * t)
    return target([r * c, r * s, 0], [-V * s, V * c, 0], [-A * c, -A * s, 0])


@pytest.mark.parametrize("h", [1e-3, 1e-2, 0.03])
@pytest.mark.parametrize(
    "desired", [sine(0.19, 7.5), sine(0.05, 19.9), bang_bang, circle]
)
def test_a_motion_within_the_bounds_is_passed_bit_for_bit(desired, h):
    first = desired(0.0)
    before = start(POSITION, first[:3], first[3:6], h=h)
    governed, given = follow(POSITION, desired, before, 0.7, h=h)
    np.testing.assert_array_equal(governed, given)
    assert lengths(given[:, 6:]).max() > 0.5 * A


@pytest.mark.parametrize("share", [1.05, 2.0])
@pytest.mark.parametrize("h", [1e-3, 1e-2])
def test_a_motion_beyond_the_bounds_is_not_passed(share, h):
    """Either bound: at the largest speed, and at the largest acceleration."""
    for amplitude, rate in [(V / 4.0, 4.0), (A / 400.0, 20.0)]:
        desired = sine(share * amplitude, rate)
        first = desired(0.0)
        before = start(POSITION, first[:3], first[3:6], h=h)
        governed, given = follow(POSITION, desired, before, 0.8, h=h)
        assert not passed(governed, given).all()
        check_position(governed, given, h=h)


@pytest.mark.parametrize("h", [1e-3, 1e-2, 0.03])
def test_a_teleport_becomes_a_fast_straight_move(h):
    """In hardly more than the least time there is, V/A + d/V, and with no overshoot."""
    x = np.array([0.6, -0.48, 0.64])
    d = np.linalg.norm(x)
    rest = target(x)
    governed, given = follow(
        POSITION, lambda t: rest, start(POSITION, ZERO, h=h), 1.2, h=h
    )
    check_position(governed, given, h=h)
    arrived = passed(governed, given)
    first = int(arrived.argmax())
    assert arrived[first:].all() and not arrived[:first].any()
    least = V / A + d / V
    assert least - h < first * h < 1.03 * least + 3.0 * h
    along = governed[:, :3] @ x / d
    np.testing.assert_allclose(governed[:, :3], along[:, None] * x / d, atol=1e-12)
    assert (np.diff(along) >= 0.0).all() and along.max() <= d * (1.0 + 1e-15)
    # The brakes are put on once, not again and again.
    braking = governed[:first, 6:] @ x < -1e-9
    assert np.abs(np.diff(braking.astype(int))).sum() <= 1 + (h > 0.01)


def test_it_comes_to_a_resting_target_from_any_velocity():
    rng = np.random.default_rng(1)
    for _ in range(20):
        x, v = rng.normal(size=(2, 3))
        v *= V * rng.uniform() / np.linalg.norm(v)
        rest = target(x)
        governed, given = follow(
            POSITION, lambda t, rest=rest: rest, start(POSITION, ZERO, v), 3.0
        )
        check_position(governed, given)
        arrived = passed(governed, given)
        assert arrived[-1] and arrived[int(arrived.argmax()) :].all()
        # Once it could have stopped, it comes nearer all the time.
        gap = lengths(governed[:, :3] - x)
        assert np.diff(gap[round(2.0 * V / A / H) :]).max() <= 1e-12


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_it_catches_up_with_a_moving_target(share):
    """And then it is the target, bit for bit."""
    for phase in (0.0, 2.0, 4.0):
        desired = sine(share * A / 400.0, 20.0, phase)
        governed, given = follow(POSITION, desired, start(POSITION, ZERO), 2.5)
        check_position(governed, given)
        arrived = passed(governed, given)
        first = int(arrived.argmax())
        assert arrived[first:].all() and 0.2 < first * H < 2.4


def jumps(t: float) -> np.ndarray:
    """Steps of the position every 70 ms."""
    return target(np.random.default_rng(int(t / 0.07)).normal(size=3))


def beyond(t: float) -> np.ndarray:
    return sine(0.7, 25.0)(t)


def wrong_rates(t: float) -> np.ndarray:
    """Positions that move, with velocities that have nothing to do with them."""
    rng = np.random.default_rng(int(1e6 * t))
    return np.r_[beyond(t)[:3], 100.0 * rng.normal(size=3), 1e6 * rng.normal(size=3)]


def walk() -> Callable[[float], np.ndarray]:
    steps = np.random.default_rng(3).normal(scale=0.01, size=(500, 3)).cumsum(axis=0)
    return lambda t: target(steps[round(t / H)])


@pytest.mark.parametrize("desired", [jumps, beyond, wrong_rates, walk()])
def test_bounds_are_respected_whatever_is_asked(desired):
    governed, given = follow(
        POSITION, desired, start(POSITION, ZERO, [5.0, 0.0, 0.0]), 1.0
    )
    assert lengths(np.diff(given[:, :3], 2, axis=0)).max() > 2.0 * A * H**2
    check_position(governed, given)
    # It does follow.
    assert lengths(governed[:, :3]).max() > 0.1


@pytest.mark.parametrize("desired", [jumps, beyond])
@pytest.mark.parametrize(
    "bounds", [(V, np.inf), (np.inf, A), (0.5 * V, 3.0 * A)], ids=str
)
def test_bounds_may_be_given_each_for_itself(desired, bounds):
    speed, acceleration = bounds
    limits = TargetBounds(speed, acceleration, np.inf, np.inf)
    before = start(POSITION, ZERO, bounds=limits)
    governed, given = follow(POSITION, desired, before, 1.0, limits)
    check_position(governed, given, V=speed, A=acceleration)
    assert not passed(governed, given).all()


def test_without_an_acceleration_bound_it_moves_at_the_speed():
    limits = TargetBounds(V, np.inf, np.inf, np.inf)
    rest = target([1.0, 0.0, 0.0])
    governed, given = follow(
        POSITION, lambda t: rest, start(POSITION, ZERO, bounds=limits), 0.8, limits
    )
    first = int(passed(governed, given).argmax())
    assert first * H == pytest.approx(1.0 / V, abs=2.0 * H)
    assert passed(governed, given)[first:].all()
    assert governed[:, 0].max() == 1.0


def test_it_starts_where_it_is_told():
    x, v = np.array([0.3, -0.2, 1.0]), np.array([0.4, 0.0, -0.3])
    before = start(POSITION, x, v)
    governed = govern_tasks(target(x + 1.0), before, POSITION.rows, BOUNDS, H)
    np.testing.assert_allclose(governed[:6], np.r_[x, v], atol=1e-15)
    turned = Rotation.random(random_state=2).as_quat(scalar_first=True)
    before = start(ORIENTATION, turned, v)
    far = target([1.0, 0.0, 0.0, 0.0])
    governed = govern_tasks(far, before, ORIENTATION.rows, BOUNDS, H)
    np.testing.assert_allclose(governed[:7], np.r_[turned, v], atol=1e-15)


# --- orientations -----------------------------------------------------------------


def spin(rate: float, swing: float) -> Callable[[float], np.ndarray]:
    """exp(rate t z) exp(swing sin(6 t) x): about two axes, with exact derivatives."""

    def at(t: float) -> np.ndarray:
        z = np.array([0.0, 0.0, rate])
        outer = Rotation.from_rotvec(z * t)
        s, c = np.sin(6.0 * t), np.cos(6.0 * t)
        inner = Rotation.from_rotvec([swing * s, 0.0, 0.0])
        x = outer.apply([1.0, 0.0, 0.0])
        return target(
            (outer * inner).as_quat(scalar_first=True),
            z + 6.0 * swing * c * x,
            -36.0 * swing * s * x + 6.0 * swing * c * np.cross(z, x),
        )

    return at


@pytest.mark.parametrize("h", [1e-3, 1e-2])
def test_a_turn_within_the_bounds_is_passed_bit_for_bit(h):
    """The quaternions' signs and lengths as well; the signs change on the way."""

    def desired(t: float) -> np.ndarray:
        value = spin(4.0, 0.7)(t)
        value[:4] *= 2.0 - t
        return value

    first = desired(0.0)
    before = start(ORIENTATION, first[:4], first[4:7], h=h)
    governed, given = follow(ORIENTATION, desired, before, 1.0, h=h)
    np.testing.assert_array_equal(governed, given)


@pytest.mark.parametrize("angle", [0.3, 2.0, np.pi - 1e-9, np.pi])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_orientation_that_jumps_is_turned_to_the_short_way(angle, sign):
    axis = np.array([0.48, -0.6, 0.64])
    begin = Rotation.from_rotvec([0.4, 1.0, -0.2])
    end = Rotation.from_rotvec(angle * axis) * begin
    rest = target(sign * end.as_quat(scalar_first=True))
    governed, given = follow(
        ORIENTATION,
        lambda t: rest,
        start(ORIENTATION, begin.as_quat(scalar_first=True)),
        1.0,
    )
    check_orientation(governed, given)
    arrived = passed(governed, given)
    first = int(arrived.argmax())
    assert arrived[first:].all()
    # One way round, about the axis, in hardly more than the least time.
    left = (end * rotations(governed).inv()).magnitude()
    assert np.diff(left).max() <= 1e-9
    along = np.cross(governed[:, 4:7], axis)
    np.testing.assert_allclose(along, 0.0, atol=1e-6)
    fast = angle > W**2 / B
    least = W / B + angle / W if fast else 2.0 * np.sqrt(angle / B)
    assert least - H < first * H < 1.03 * least + 3.0 * H


def test_it_comes_to_an_orientation_from_any_velocity_and_catches_up():
    rng = np.random.default_rng(5)
    for desired in (spin(0.0, 0.0), spin(2.0, 0.5), spin(-4.0, 0.2)):
        for _ in range(2):
            begin = Rotation.random(random_state=rng).as_quat(scalar_first=True)
            before = start(ORIENTATION, begin, rng.normal(size=3))
            governed, given = follow(ORIENTATION, desired, before, 2.5)
            check_orientation(governed, given)
            arrived = passed(governed, given)
            first = int(arrived.argmax())
            assert first > 10 and arrived[first:].all()


def tumbling(t: float) -> np.ndarray:
    return spin(15.0, 1.0)(t)


def turned_at_random(t: float) -> np.ndarray:
    turn = Rotation.random(random_state=int(t / 0.06))
    return target(turn.as_quat(scalar_first=True))


@pytest.mark.parametrize("desired", [tumbling, turned_at_random])
def test_bounds_of_orientations_are_respected_whatever_is_asked(desired):
    before = start(ORIENTATION, [1.0, 0.0, 0.0, 0.0], [20.0, 0.0, 0.0])
    governed, given = follow(ORIENTATION, desired, before, 1.0)
    check_orientation(governed, given)
    assert not passed(governed, given).any()


# --- several tasks ----------------------------------------------------------------

LAYOUT = TaskLayout(("a", "b", "c"), ("position", "pose", "orientation"))


def random_targets(rng: np.random.Generator) -> np.ndarray:
    R = Rotation.random(2, random_state=rng).as_matrix()
    return LAYOUT.pack(R, rng.normal(size=(2, 3)), *rng.normal(size=(2, LAYOUT.m)))


def test_tasks_are_governed_row_by_row():
    """Each as if it were alone; what is given is never changed."""
    rng = np.random.default_rng(7)
    desired, pose = random_targets(rng), random_targets(rng)
    pose[LAYOUT.size_x :] = 0.0
    velocity = rng.normal(size=LAYOUT.m)
    before = start_governor(pose, velocity, LAYOUT.rows, BOUNDS, H)
    copies = desired.copy(), before.copy()
    governed = govern_tasks(desired, before, LAYOUT.rows, BOUNDS, H)
    np.testing.assert_array_equal(desired, copies[0])
    np.testing.assert_array_equal(before, copies[1])
    assert not np.shares_memory(governed, desired)
    end = LAYOUT.size_x + LAYOUT.m
    for layout, entries, rows in (
        (POSITION, slice(0, 3), slice(0, 3)),
        (ORIENTATION, slice(3, 7), slice(3, 6)),
        (POSITION, slice(7, 10), slice(6, 9)),
        (ORIENTATION, slice(10, 14), slice(9, 12)),
    ):

        def own(x, entries=entries, rows=rows):
            v, a = x[LAYOUT.size_x : end], x[end:]
            return np.r_[x[entries], v[rows], a[rows]]

        alone = start(layout, pose[entries], velocity[rows])
        np.testing.assert_array_equal(own(before), alone)
        np.testing.assert_array_equal(
            own(governed), govern_tasks(own(desired), alone, layout.rows, BOUNDS, H)
        )


def test_what_has_no_bounds_is_left_as_it_is():
    rng = np.random.default_rng(8)
    desired, pose = random_targets(rng), random_targets(rng)
    pose[LAYOUT.size_x :] = 0.0
    for bounds, entries in (
        (TargetBounds(V, A, np.inf, np.inf), LAYOUT.quaternion_entries),
        (TargetBounds(np.inf, np.inf, W, B), LAYOUT.position_entries),
    ):
        before = start_governor(pose, np.zeros(LAYOUT.m), LAYOUT.rows, bounds, H)
        governed = govern_tasks(desired, before, LAYOUT.rows, bounds, H)
        np.testing.assert_array_equal(governed[entries], desired[entries])
        assert not np.array_equal(governed, desired)


def test_a_quaternion_of_zero_length_is_left_for_the_law_to_refuse():
    desired = target(np.zeros(4))
    before = start(ORIENTATION, [1.0, 0.0, 0.0, 0.0])
    governed = govern_tasks(desired, before, ORIENTATION.rows, BOUNDS, H)
    np.testing.assert_array_equal(governed, desired)
