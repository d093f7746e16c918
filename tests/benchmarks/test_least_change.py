"""The least change of single frames, beside a search that knows no gradients."""

import numpy as np
import pytest
from small_reference_robots import reaching, write_robot

from benchmarks.least_change import LeastChange, least_changes
from crar_drake.references.cleaning import Cleaner
from crar_drake.robot.description import load_robot_description


@pytest.fixture(scope="module")
def cleaner(tmp_path_factory) -> Cleaner:
    folder = write_robot(tmp_path_factory.mktemp("least"))
    return Cleaner(load_robot_description(folder), 30.0)


def searched(cleaner: Cleaner, reference: np.ndarray, rng) -> float:
    """The smallest change of joints among many random clear configurations."""
    best, centre, spread = np.inf, reference, 0.5
    for _ in range(14):
        some = centre + spread * rng.uniform(-1.0, 1.0, (150, 3))
        margins = cleaner.margins(some)
        clear = (margins.distance >= cleaner.parameters.floor) & (margins.limit >= 0)
        costs = np.where(clear, ((some - reference) ** 2).sum(axis=1), np.inf)
        if costs.min() < best:
            best, centre = costs.min(), some[costs.argmin()]
        spread *= 0.7
    return best


def test_no_clear_configuration_is_nearer(cleaner):
    reference = reaching(24, 30.0, 1.0)
    inside = cleaner.margins(reference).distance < 0.0
    assert 2 < inside.sum() < 10
    frames, broken = least_changes(
        cleaner, reference, cleaner.clean(reference).q, "joints alone"
    )
    assert broken < 2e-5
    assert cleaner.margins(frames).distance.min() > cleaner.parameters.floor - 3e-5
    rng = np.random.default_rng(5)
    for k in np.flatnonzero(inside):
        cost = ((frames[k] - reference[k]) ** 2).sum()
        assert 0.0 < cost < 1.02 * searched(cleaner, reference[k], rng), k
    clear = cleaner.margins(reference).distance > cleaner.parameters.floor
    np.testing.assert_array_equal(frames[clear], reference[clear])


def test_places_are_kept_where_they_matter(cleaner):
    reference = reaching(24, 30.0, 1.0)
    k = int(cleaner.margins(reference).distance.argmin())
    joints, places = (
        LeastChange(cleaner, measure) for measure in ("joints alone", "hands and feet")
    )
    start = cleaner.clean(reference).q[k]

    def change(frame: np.ndarray) -> tuple[float, float]:
        feet = [joints.places(q)[0] for q in (reference[k], frame)]
        return np.linalg.norm(frame - reference[k]), np.linalg.norm(feet[1] - feet[0])

    of_joints = change(joints.find(reference[k], [start]).q)
    of_places = change(places.find(reference[k], [start]).q)
    assert of_places[1] < 0.5 * of_joints[1] and of_places[0] > of_joints[0]
