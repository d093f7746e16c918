"""Starts in violation: they are what they say, and they are left in time."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import recovery as recovery_module
from benchmarks.recovery import (
    EXCESS,
    PENETRATION,
    STARTS,
    Recovery,
    default_scenario,
    make_table,
    recover,
    violating_posture,
)
from crar_drake.judging.referee import Referee
from crar_drake.robot.model import ControlModel
from crar_drake.simulation.diagram import PrepareScenario
from crar_drake.simulation.scenario import Scenario


def scenario(period: float) -> Scenario:
    base = default_scenario("wrists")
    return replace(base, controller=replace(base.controller, period=period))


@pytest.fixture(scope="module")
def model() -> ControlModel:
    return PrepareScenario(default_scenario("wrists")).model


@pytest.fixture(scope="module")
def postures(model) -> dict[str, np.ndarray]:
    """Positions by the start's name; the search takes seconds for some."""
    return {start.name: violating_posture(model, start) for start in STARTS}


@pytest.mark.parametrize("start", STARTS, ids=[s.name for s in STARTS])
def test_start_violates_what_it_says_and_nothing_else(model, postures, start):
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    q = postures[start.name]
    for (a, b), d in zip(referee.pairs, referee.distances(q), strict=True):
        if f"{a} - {b}" in start.pairs:
            assert d == pytest.approx(-PENETRATION, abs=1e-5)
        else:
            assert d > 0.009
    beyond = dict(start.joints)
    for joint, excess, position, upper in zip(
        referee.joint_names, referee.limit_excess(q), q, referee.upper, strict=True
    ):
        if joint in beyond:
            assert excess == pytest.approx(EXCESS, abs=1e-9)
            assert (position > upper) == (beyond[joint] > 0)
        else:
            assert excess == 0.0


@pytest.mark.parametrize(
    "index, inside, period",
    [(0, True, 1e-3), (2, True, 5e-3), (2, False, 5e-3), (5, True, 5e-3)],
    ids=["one pair", "two pairs", "two pairs, target outside", "three limits"],
)
def test_violation_is_left_in_time_and_gently(
    index, inside, period, postures, monkeypatch
):
    monkeypatch.setattr(
        recovery_module, "violating_posture", lambda model, start: postures[start.name]
    )
    start = replace(STARTS[index], inside=inside)
    recovery = recover(start, scenario(period))
    if start.pairs:
        assert recovery.depth == pytest.approx(PENETRATION, abs=1e-5)
    else:
        assert recovery.excess == pytest.approx(EXCESS, abs=1e-6)
    assert 0.0 < recovery.time <= 0.5
    assert recovery.effort_share <= 1.0
    if inside:
        assert recovery.later_effort_share < 1.0
    assert recovery.smallest_distance > 0.0


def test_report_tells_pairs_from_limits():
    pair = Recovery(STARTS[0], 0.015, 0.0, 0.12, 0.5, 0.6, 0.003)
    limit = Recovery(
        replace(STARTS[4], inside=False), 0.0, EXCESS, 0.3, 0.25, 1.5, 0.02
    )
    table = make_table([("wrists", pair), ("upper-body", limit)]).markdown()
    assert (
        "| wrists | stays inside | 15.0 mm | 0.12 s | 50 % | 60 % | 3.0 mm |" in table
    )
    assert (
        "| upper-body | rest posture | 5.0° | 0.30 s | 25 % | 150 % | 20.0 mm |"
        in table
    )
