"""What a reproduction is going to run."""

import pytest
from pydrake.common.yaml import yaml_load_typed

from benchmarks.section_iv.plan import (
    LABELS,
    MOTION_SETS,
    SERIES,
    VARIANTS,
    make_plan,
)
from crar_drake.errors import CrarError
from crar_drake.simulation.scenario import Scenario, load_scenario, parse_scenario


def scenario_of(plan, motion: str, experiment: str, series: str) -> Scenario:
    (found,) = [
        s
        for s in plan.simulations
        if (s.motion, s.experiment, s.series) == (motion, experiment, series)
    ]
    return parse_scenario(found.scenario)


@pytest.fixture(scope="module")
def plan():
    return make_plan()


def test_every_motion_has_both_experiments_at_both_levels_and_lookahead(plan):
    assert plan.motions == MOTION_SETS["builtin"]
    for motion in plan.motions:
        for experiment in ("wrists", "upper-body"):
            # The shipped scenarios are the paper's experiments.
            paper = load_scenario(f"paper_{motion}_{experiment}").controller
            assert (
                scenario_of(plan, motion, experiment, "acceleration").controller
                == paper
            )
            velocity = scenario_of(plan, motion, experiment, "velocity").controller
            assert (velocity.level, velocity.constraints) == ("velocity", "paper")
            ours = scenario_of(plan, motion, experiment, "lookahead").controller
            assert ours.constraints == "lookahead"
    assert scenario_of(plan, "dance", "wrists", "raw").controller.constraints == "none"


def test_the_gains_are_those_that_the_paper_prints(plan):
    gains = scenario_of(plan, "boxing", "wrists", "acceleration").controller
    assert (gains.K, gains.Kp, gains.velocity_gain) == (30.0, 300.0, 2.0 * 300.0**0.5)
    assert (gains.Gv, gains.null_space_gain) == (30.0, 30.0)
    assert (gains.rho, gains.beta, gains.alpha, gains.damping) == (1.0, 2.0, 50.0, 0.1)
    assert gains.limit_share is None  # 1 / (Nc + 1)


def test_a_variant_changes_one_thing_of_the_acceleration_level(plan):
    base = yaml_fields(scenario_of(plan, "dance", "wrists", "acceleration"))
    expected = {
        "inertia": {"metric"},
        "less-damping": {"damping"},
    }
    assert set(expected) == set(VARIANTS)
    for series, changed in expected.items():
        variant = yaml_fields(scenario_of(plan, "dance", "wrists", series))
        assert {name for name in base if base[name] != variant[name]} == changed


def yaml_fields(scenario: Scenario) -> dict:
    loaded = yaml_load_typed(schema=Scenario, data=scenario.to_yaml())
    return vars(loaded.controller)


def test_the_sweep_shares_what_is_simulated_anyway(plan):
    assert plan.damping["acceleration", "paper", 0.1] == "dance_wrists_acceleration"
    assert plan.damping["velocity", "paper", 0.1] == "dance_wrists_velocity"
    assert plan.damping["acceleration", "none", 0.1] == "dance_wrists_raw"
    assert plan.damping["acceleration", "paper", 0.05] == "dance_wrists_less-damping"
    by_name = {s.name: s for s in plan.simulations}
    assert len(by_name) == len(plan.simulations)
    assert len({s.scenario for s in plan.simulations}) == len(plan.simulations)
    for (level, constraints, value), name in plan.damping.items():
        gains = parse_scenario(by_name[name].scenario).controller
        assert (gains.level, gains.constraints) == (level, constraints)
        assert gains.damping == value


def test_every_series_has_a_label(plan):
    assert {"raw", *SERIES, *VARIANTS} == set(LABELS)
    # A label that names a value names the one that is simulated.
    assert LABELS["less-damping"] == f"λ = {VARIANTS['less-damping'].damping:g} m"


def test_a_duration_cuts_every_motion():
    plan = make_plan(["dance"], duration=2.0)
    assert {s.duration for s in plan.simulations} == {2.0}
    assert {parse_scenario(s.scenario).duration for s in plan.simulations} == {2.0}


def test_what_cannot_be_planned_is_refused(tmp_path):
    with pytest.raises(CrarError, match="at least one motion"):
        make_plan([])
    with pytest.raises(CrarError, match="two of the motions are called dance"):
        make_plan(["dance", "dance"])
    with pytest.raises(CrarError, match="nowhere"):
        make_plan(["nowhere.amc"])
