"""Capsule distances: by optimality, by derivatives, and by the referee.

The pairs are 100,000, of every kind that closed forms trip over. The referee is a
separate, plain implementation.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crar_drake.judging.referee_distances import capsule_distance
from crar_drake.law.capsule_distances import (
    ShapePairs,
    WatchedRows,
    capsule_distances,
    nearest_of_pairs,
)
from crar_drake.law.hull_distances import no_hulls

NUM_PAIRS = 100_000


def unit_vectors(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def across(rng: np.random.Generator, u: np.ndarray) -> np.ndarray:
    """Random unit vectors perpendicular to u."""
    vectors = np.cross(u, unit_vectors(rng, len(u)))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def make_pairs(rng: np.random.Generator, kind: str, count: int) -> tuple:
    """Capsule pairs of one kind, placed anywhere within a few metres."""

    def column(low: float, high: float) -> np.ndarray:
        return rng.uniform(low, high, (count, 1))

    def lengths() -> np.ndarray:
        """From a tenth of a millimetre to ten metres."""
        return 10.0 ** column(-4.0, 1.0)

    def through(p: np.ndarray, u: np.ndarray, length: np.ndarray, at: np.ndarray):
        """Ends of an axis along u that has p at the fraction `at`."""
        return p - at * length * u, p + (1.0 - at) * length * u

    p = rng.normal(size=(count, 3))
    u = unit_vectors(rng, count)
    r_a, r_b = rng.uniform(0.0, 0.2, (2, count))
    L_a, L_b = lengths(), lengths()
    a = through(p, u, L_a, column(0.0, 1.0))
    if kind == "random":
        q = p + 10.0 ** column(-3.0, 1.0) * unit_vectors(rng, count)
        b = through(q, unit_vectors(rng, count), L_b, column(0.0, 1.0))
    elif kind in ("parallel", "antiparallel"):
        # b is a copy of a, stretched by a power of two and shifted: still parallel
        # to the last bit but for the rounding of its ends.
        sign = 1.0 if kind == "parallel" else -1.0
        shift = column(-2.0, 2.0) * L_a * u + column(0.0, 0.5) * across(rng, u)
        b_0 = a[0] + shift
        b = b_0, b_0 + sign * 2.0 ** rng.integers(-3, 4, (count, 1)) * (a[1] - a[0])
    elif kind == "collinear":
        # Apart, end to end, overlapping, one inside the other.
        start = rng.choice([-3.0, -1.0, -0.5, 0.0, 0.25, 1.0, 1.5], (count, 1))
        b_0 = a[0] + start * (a[1] - a[0])
        b = b_0, b_0 + rng.choice([0.5, 1.0, -1.0, 2.0], (count, 1)) * (a[1] - a[0])
    elif kind == "crossing":
        b = through(p, unit_vectors(rng, count), L_b, column(0.0, 1.0))
    elif kind == "touching":
        # Side by side at any angle, the gap of the axes equal to both radii.
        n = across(rng, u)
        v = column(-1.0, 1.0) * u + column(-1.0, 1.0) * np.cross(u, n)
        v /= np.linalg.norm(v, axis=1, keepdims=True)
        b = through(p + (r_a + r_b)[:, None] * n, v, L_b, column(0.0, 1.0))
    elif kind == "end to end":
        b = a[1], a[1] + L_b * unit_vectors(rng, count)
    elif kind == "same":
        b = a if rng.integers(2) else a[::-1]
    elif kind in ("nearly parallel", "nearly parallel, crossing"):
        angle = 10.0 ** column(-9.0, -3.0)
        n = across(rng, u)
        v = np.cos(angle) * u + np.sin(angle) * n
        gap = 0.0 if kind.endswith("crossing") else column(0.0, 0.3)
        b = through(p + gap * np.cross(u, n), v, L_b, column(-0.5, 1.5))
    elif kind in ("sphere and capsule", "capsule and sphere", "spheres"):
        q = p + column(0.0, 0.5) * unit_vectors(rng, count)
        b = through(q, unit_vectors(rng, count), L_b, column(0.0, 1.0))
        if kind != "capsule and sphere":
            a = p, p
        if kind != "sphere and capsule":
            b = q, q
    elif kind == "sphere on the axis":
        q = a[0] + column(0.0, 1.0) * (a[1] - a[0])
        b = q, q
    elif kind == "concentric spheres":
        a = b = p, p
    else:
        raise ValueError(kind)
    return a[0], a[1], r_a, b[0], b[1], r_b


KINDS = {
    "random": 30_000,
    "parallel": 8_000,
    "antiparallel": 8_000,
    "collinear": 8_000,
    "crossing": 8_000,
    "touching": 8_000,
    "end to end": 3_000,
    "same": 1_000,
    "nearly parallel": 9_000,
    "nearly parallel, crossing": 9_000,
    "sphere and capsule": 2_000,
    "capsule and sphere": 2_000,
    "spheres": 2_000,
    "sphere on the axis": 1_000,
    "concentric spheres": 1_000,
}


@pytest.fixture(scope="module")
def pairs() -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(1)
    parts = [make_pairs(rng, kind, count) for kind, count in KINDS.items()]
    return tuple(np.concatenate(part) for part in zip(*parts, strict=True))


@pytest.fixture(scope="module")
def results(pairs) -> tuple[np.ndarray, ...]:
    """As the equations find them."""
    return capsule_distances(*pairs)


@pytest.fixture(scope="module")
def of_referee(pairs) -> np.ndarray:
    return capsule_distance(*pairs)[0]


def kind_of(index: int) -> str:
    ends = np.cumsum(list(KINDS.values()))
    return list(KINDS)[np.searchsorted(ends, index, side="right")]


def one(p_a0, p_a1, r_a, p_b0, p_b1, r_b) -> tuple[float, np.ndarray, ...]:
    """A single pair: distance, normal, witness points."""
    d, n, p_a, p_b = capsule_distances(
        *(np.array([x], dtype=float) for x in (p_a0, p_a1, r_a, p_b0, p_b1, r_b))
    )
    return d[0], n[0], p_a[0], p_b[0]


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    "start, end, at_a, at_b",
    [
        (1.0, 2.0, 1.5, 1.5),  # within
        (-3.0, 9.0, 2.0, 2.0),  # all along
        (-3.0, 1.0, 0.5, 0.5),  # over one end
        (3.0, 9.0, 3.5, 3.5),  # over the other
        (-5.0, -1.0, 0.0, -1.0),  # before
        (6.0, 9.0, 4.0, 6.0),  # after
    ],
)
def test_where_parallel_capsules_meet_by_hand(start, end, at_a, at_b, sign):
    """a from 0 to 4, b from `start` to `end` or back, a metre beside it."""
    b = [[start, 0, 0], [end, 0, 0]][:: int(sign)]
    d, _, p_a, p_b = one([0, 1, 0], [4, 1, 0], 0.1, *b, 0.1)
    np.testing.assert_allclose(p_a, [at_a, 1, 0], atol=1e-15)
    np.testing.assert_allclose(p_b, [at_b, 0, 0], atol=1e-15)
    assert d == pytest.approx(np.hypot(1.0, at_a - at_b) - 0.2)


def test_long_axes_that_cross_at_a_tiny_angle():
    """The plain formula for the nearest points has no digits left here."""
    for angle in (5e-8, 2e-7, 1e-6):
        v = np.array([np.cos(angle), np.sin(angle), 0.0])
        d, _, p_a, p_b = one([-3, 0, 0], [7, 0, 0], 0.1, -6 * v, 4 * v, 0.1)
        assert d == pytest.approx(-0.2, abs=1e-12)
        np.testing.assert_allclose([p_a, p_b], 0.0, atol=1e-6)


def test_parallel_capsules_at_exact_touch():
    """FCL answers -1 with a zero normal here."""
    d, n, *_ = one([0, 0, 0.5], [1, 0, 0.5], 0.25, [0, 0, 0], [1, 0, 0], 0.25)
    assert d == 0.0
    np.testing.assert_allclose(n, [0, 0, 1])


def test_crossing_axes_have_a_normal_perpendicular_to_both():
    d, n, *_ = one([-1, 0, 0], [1, 0, 0], 0.1, [0, -1, 0], [0, 1, 0], 0.2)
    assert d == pytest.approx(-0.3)
    np.testing.assert_allclose(np.abs(n), [0, 0, 1])


@pytest.mark.parametrize("length", [1.0, 1e-2, 1e2])
@pytest.mark.parametrize(
    "u, v",
    [
        ([1, 0, 0], [0, 0, 1]),  # crossing
        ([0, 1, 0], [0, 0, 1]),
        ([0.6, 0.8, 0], [0, 0, 0]),  # a sphere on an axis
        ([0.48, 0.64, 0.6], [0, 0, 0]),
        ([0, 0, 0], [0.48, -0.6, 0.64]),
        ([-1, 0, 0], [0, 0, 0]),
        ([0, 0, -1], [0, 0, 0]),
        ([0.48, 0.64, 0.6], [0.48, 0.64, 0.6]),  # collinear
        ([-1, 0, 0], [1, 0, 0]),
        ([0, 0, 0], [0, 0, 0]),  # concentric spheres
    ],
)
def test_normals_where_axes_meet_are_perpendicular_to_what_has_a_direction(
    u, v, length
):
    half_a, half_b = 0.5 * length * np.array(u), 0.5 * np.array(v)
    d, n, p_a, p_b = one(-half_a, half_a, 0.1, -half_b, half_b, 0.2)
    assert d == pytest.approx(-0.3)
    np.testing.assert_allclose([p_a, p_b], 0.0, atol=1e-15)
    assert n @ n == pytest.approx(1.0)
    assert n @ u == pytest.approx(0.0, abs=1e-15)
    assert n @ v == pytest.approx(0.0, abs=1e-15)


def test_no_pairs():
    none = np.empty((0, 3))
    d, n, p_a, p_b = capsule_distances(none, none, none[:, 0], none, none, none[:, 0])
    assert d.shape == (0,) and n.shape == p_a.shape == p_b.shape == (0, 3)


def test_distances_are_the_referees(of_referee, results):
    d = results[0]
    assert len(d) == NUM_PAIRS
    worst = np.argmax(np.abs(d - of_referee))
    assert abs(d[worst] - of_referee[worst]) < 1e-9, kind_of(worst)


def test_everything_is_finite(results):
    assert all(np.isfinite(result).all() for result in results)


def test_normals_are_unit_vectors(results):
    np.testing.assert_allclose(np.linalg.norm(results[1], axis=1), 1.0, atol=1e-12)


def test_distance_is_that_of_the_witness_points(pairs, results):
    d, _, p_a, p_b = results
    gap = np.linalg.norm(p_a - p_b, axis=1)
    np.testing.assert_allclose(d, gap - pairs[2] - pairs[5], atol=1e-14)


def test_normals_point_from_b_to_a(results):
    _, n, p_a, p_b = results
    gap = np.linalg.norm(p_a - p_b, axis=1)
    apart = gap > 1e-12
    assert 0.5 < apart.mean() < 1.0
    along = np.einsum("ij,ij->i", n, p_a - p_b)
    np.testing.assert_allclose(along[apart], gap[apart], rtol=1e-9)


def test_normals_of_meeting_axes_are_perpendicular_to_both(pairs, results):
    """As far as they meet inside and have directions: where an end lies on the
    other axis any normal does; nearly parallel axes have one direction only."""
    _, n, p_a, p_b = results
    u, v = pairs[1] - pairs[0], pairs[4] - pairs[3]
    lengths = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
    sine = np.linalg.norm(np.cross(u, v), axis=1) / np.where(lengths, lengths, 1.0)
    meeting = (np.linalg.norm(p_a - p_b, axis=1) < 1e-12) & (sine > 1e-3)
    assert meeting.sum() > 5_000
    for axis in (u, v):
        axis = axis[meeting] / np.linalg.norm(axis[meeting], axis=1, keepdims=True)
        assert np.abs(np.einsum("ij,ij->i", axis, n[meeting])).max() < 1e-9


def test_witness_points_satisfy_the_conditions_of_a_minimum(pairs, results):
    """The squared distance is convex in the two fractions along the axes, so the
    first-order conditions are enough: they prove the minimum without a referee."""
    p_a0, p_a1, _, p_b0, p_b1, _ = pairs
    _, _, p_a, p_b = results
    for start, end, p, other in ((p_a0, p_a1, p_a, p_b), (p_b0, p_b1, p_b, p_a)):
        axis = end - start
        length = np.linalg.norm(axis, axis=1)
        unit = axis / np.where(length, length, 1.0)[:, None]
        at = np.einsum("ij,ij->i", unit, p - start)
        # On the axis, between its ends.
        off = np.linalg.norm(p - start - at[:, None] * unit, axis=1)
        assert off.max() < 1e-13
        assert (at >= -1e-13).all() and (at <= length + 1e-13).all()
        # No way along the axis leads nearer to the other point.
        slope = np.einsum("ij,ij->i", unit, p - other)
        assert (slope[at < length - 1e-13] > -1e-11).all()
        assert (slope[at > 1e-13] < 1e-11).all()


def test_exchanging_the_capsules_turns_the_normal_round(pairs, results):
    d, n, p_a, p_b = results
    d_swapped, n_swapped, *_ = capsule_distances(*pairs[3:], *pairs[:3])
    np.testing.assert_allclose(d_swapped, d, atol=1e-11)
    # Parallel axes have many witness points, but only one normal.
    apart = np.linalg.norm(p_a - p_b, axis=1) > 1e-3
    np.testing.assert_allclose(n_swapped[apart], -n[apart], atol=1e-7)


def test_a_rigid_motion_of_both_changes_nothing(pairs, results):
    rng = np.random.default_rng(2)
    R, shift = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
    p_a0, p_a1, r_a, p_b0, p_b1, r_b = pairs
    moved = [p @ R.T + shift for p in (p_a0, p_a1, p_b0, p_b1)]
    d, *_ = capsule_distances(moved[0], moved[1], r_a, moved[2], moved[3], r_b)
    np.testing.assert_allclose(d, results[0], atol=1e-11)


def test_the_normal_is_the_distances_derivative():
    """a moves with a random twist: d_dot = n . (v + omega x p_a), also inside."""
    rng = np.random.default_rng(3)
    count, h = 20_000, 1e-6
    u, v = 0.5 * unit_vectors(rng, count), 0.5 * unit_vectors(rng, count)
    p_a0 = 0.4 * rng.normal(size=(count, 3))
    p_b0 = 0.4 * rng.normal(size=(count, 3))
    r_a, r_b = rng.uniform(0.02, 0.2, (2, count))
    twist_v, omega = rng.normal(size=(2, count, 3))
    d, n, p_a, p_b = capsule_distances(p_a0, p_a0 + u, r_a, p_b0, p_b0 + v, r_b)

    def moved(time: float) -> np.ndarray:
        R = Rotation.from_rotvec(time * omega)
        ends = [R.apply(p) + time * twist_v for p in (p_a0, p_a0 + u)]
        return capsule_distances(*ends, r_a, p_b0, p_b0 + v, r_b)[0]

    rate = (moved(h) - moved(-h)) / (2 * h)
    expected = np.einsum("ij,ij->i", n, twist_v + np.cross(omega, p_a))
    # Where axes are parallel or meet, the witness points are not unique.
    sine = np.linalg.norm(np.cross(u, v), axis=1) / 0.25
    unique = (sine > 0.1) & (np.linalg.norm(p_a - p_b, axis=1) > 0.02)
    assert unique.sum() > 10_000
    assert (d[unique] < -0.01).sum() > 1_000
    np.testing.assert_allclose(rate[unique], expected[unique], atol=2e-5)


def test_an_answer_that_the_closed_form_refutes_is_not_taken():
    """Of each pair of shapes what is asked counts, unless it is too large; of a hull
    about a shape what is asked alone; and of the nearest pair of each watched pair."""
    rng = np.random.default_rng(4)
    count = 6
    points = rng.normal(size=(4 * count, 3))  # a's axes, b's, and their vectors
    a, b, u, v = points.reshape(4, count, 3)
    radius_a, radius_b = rng.uniform(0.0, 0.1, (2, count))
    exact = capsule_distances(a, a + u, radius_a, b, b + v, radius_b)
    asked = rng.normal(size=(count, 7))
    late = np.array([1e-3, 5e-5, -1e-3, 1e-3, 0.05, np.nan])
    asked[:, 0] = exact[0] + late
    about = np.array([False, False, False, True, False, False])
    starts, radii = np.arange(count), radius_a + radius_b
    rest = radii, radii, radii < 0.0, np.zeros((count, 1))
    pairs = ShapePairs(starts, starts + count, 2 * count, *rest, **no_hulls(count))
    members = np.array([[0, 1], [2, 3], [4, 5]])
    watched = WatchedRows(members, ~about, np.zeros((3, 1)))
    found = nearest_of_pairs(points, asked, pairs, watched)
    taken = [asked[i, 0] if i in (1, 2, 3) else exact[0][i] for i in range(count)]
    for k, some in enumerate(members):
        best = min(some, key=lambda i: taken[i])
        assert found[0][k] == pytest.approx(taken[best], abs=1e-14)
        of = asked[best, 1:4] if best in (1, 2, 3) else exact[1][best]
        np.testing.assert_allclose(found[1][k], of, atol=1e-14)
