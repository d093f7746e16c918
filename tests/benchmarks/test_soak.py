"""The soak's own people and its judge; the soak itself takes minutes."""

import numpy as np
import pytest

from benchmarks.soak import AGE, FASTEST, RADIUS, Person, Seen, judge, rows_of
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel

PERIOD = 0.005


def test_people_keep_to_their_speed_and_are_told_larger():
    rng = np.random.default_rng(1)
    ann = Person("Ann", np.array([2.0, 0.0, 1.0]))
    times = np.cumsum(rng.uniform(0.01, 0.2, 300))
    for now in times:
        ann.walk(now, rng)
    known, places = zip(*ann.way, strict=True)
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(known)
    assert 0.9 * FASTEST < speeds.max() <= FASTEST
    assert ann.told()["radius"] == RADIUS + AGE * FASTEST
    middle = ann.at(np.array([0.5 * (known[7] + known[8])]))[0]
    np.testing.assert_allclose(middle, 0.5 * (places[7] + places[8]), atol=1e-12)


@pytest.fixture(scope="module")
def model() -> ControlModel:
    return ControlModel.FromDescription(load_robot_description("upper_body"), [])


@pytest.mark.parametrize("speed, violated", [(0.0, False), (1.0, True)])
def test_the_judge_sees_who_is_touched_by_what_is_fast(model, speed, violated):
    """Commands that turn an elbow, or leave it, while Bob stands in the hand."""
    context = model.plant.CreateDefaultContext()
    rest, elbow = model.rest_positions(), model.position_names.index("left_elbow")
    model.plant.SetPositions(context, rest)
    hand = model.plant.GetBodyByName("left_hand").EvalPoseInWorld(context)
    bob, seen = Person("Bob", hand.translation()), Seen()
    bob.way = [(-np.inf, bob.where), (np.inf, bob.where)]
    for k in range(60):
        v = np.zeros(len(rest))
        v[elbow] = speed
        q = rest + (k + 1) * PERIOD * v
        said = {"time": k * PERIOD, "positions": q.tolist(), "velocities": v.tolist()}
        seen.commands.append(said)
        seen.arrived.append(100.0 + k * PERIOD + 0.001)
        seen.latencies.append(0.004)
    seen.memory = [(0.0, 2**20), (40.0, 2**21)]
    found = judge(seen, [bob], model)
    assert found.contacts == found.instants == 120
    assert (found.violations > 0) == violated == (found.fastest > 0.05)
    rows = dict(rows_of(seen, found, "steps: 3 tracking\n"))
    assert rows["violations: contacts at more than 50 mm/s"] == str(found.violations)
    assert rows["server: steps"] == "3 tracking"
