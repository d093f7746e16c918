"""The lookahead on real loops: its certificate is true."""

from dataclasses import fields, replace

import numpy as np
import pytest

from crar_drake.judging.referee import Referee
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.results.certificate import judge_certificate
from crar_drake.results.log import SimulationLog
from crar_drake.run import RunResult, run_scenario
from crar_drake.simulation.scenario import Scenario, load_scenario, parse_scenario

# Motion, experiment, control period and duration [s]. At 3.5 s of the boxing a hand
# passes the head.
CASES = {
    "wrists, 1 ms": ("wrists", 1e-3, 1.5),
    "wrists, 5 ms": ("wrists", 5e-3, 4.0),
    "upper body, 5 ms": ("upper-body", 5e-3, 3.7),
}


def boxing(experiment: str, period: float, duration: float) -> Scenario:
    return Scenario(
        motion="boxing",
        experiment=experiment,
        controller=LookaheadParameters(period=period),
        duration=duration,
        log_period=1e-3,
    )


def arm() -> Scenario:
    shipped = load_scenario("obstacle_arm")
    controller = LookaheadParameters(period=5e-3)
    # In this time the straight way leads into the post.
    return replace(shipped, controller=controller, duration=3.2, log_period=1e-3)


@pytest.fixture(scope="module", params=[*CASES, "arm and post, 5 ms"])
def run(request) -> RunResult:
    scenario = boxing(*CASES[request.param]) if request.param in CASES else arm()
    return run_scenario(scenario, record=False)


def referee_of(run: RunResult) -> Referee:
    model = run.setup.model
    return Referee(model.plant, model.scene_graph, model.description.pairs)


def test_what_the_log_claims_of_braking_paths_is_true(run):
    """By the referee, which knows nothing of how the controller bounds distances."""
    log, parameters = run.log, parse_scenario(run.log.scenario).controller
    step = run.setup.model.plant.time_step()
    verdict = judge_certificate(log, referee_of(run), parameters, step, every=40)
    assert verdict.true and not verdict.violated
    assert verdict.reported == run.summary.admitted_steps == verdict.steps.of
    assert verdict.reported_unclear == run.summary.unclear_steps == 0
    assert verdict.steps.judged >= 100 and verdict.steps.below_floor == 0
    assert verdict.clearance == run.summary.path_clearance >= verdict.floor


LONG = 0.6  # [s]


def test_a_longer_braking_time_in_mid_motion_has_its_path_asked_anew(run):
    """Where the path over it leads below the floor, it is reported as not clear; the
    path over the own time, or over a shorter one, is clear."""
    log, model, referee = run.log, run.setup.model, referee_of(run)
    gains = parse_scenario(log.scenario).controller
    T, floor = gains.T, gains.safety_distance
    laws = [
        ControlLaw(model, replace(gains, braking_time=time))
        for time in (0.5 * T, T, LONG)
    ]
    ticks = np.arange(0, len(log.time), round(gains.period / log.time[1]))
    unclear = 0
    for k in ticks[:: max(1, len(ticks) // 40)]:
        q, v = log.q[k], log.v[k]
        clear = []
        for law in laws:
            law.reset()
            solution = law.step(q, v, model.tasks_at(q), model.prescribed_at(q))
            clear.append(solution.admission[3])
        path = q + LONG * np.linspace(0.0, 1.0, 9)[:, None] * v
        nearest = referee.violations(path).smallest_distance
        assert clear[:2] == [1.0, 1.0]
        if nearest < floor - 1e-6:
            assert clear[2] == 0.0
            unclear += 1
    assert unclear > 3


@pytest.mark.parametrize("kind", ["upper body", "arm"])
def test_same_run_same_bits(kind):
    scenario = boxing("upper-body", 1e-3, 0.4) if kind == "upper body" else arm()
    scenario = replace(scenario, duration=0.4)
    first, second = (run_scenario(scenario, record=False).log for _ in range(2))
    for field in fields(SimulationLog):
        a, b = getattr(first, field.name), getattr(second, field.name)
        if isinstance(a, np.ndarray) and a.dtype.kind == "f":
            assert a.tobytes() == b.tobytes(), field.name
        else:
            np.testing.assert_array_equal(a, b)
