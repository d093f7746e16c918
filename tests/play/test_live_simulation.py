"""A simulation that is changed while it goes on: no jump, no violation, no lost sample.

The tests share one simulation, in the order in which they stand here.
"""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.multibody.tree import JacobianWrtVariable

from crar_drake.control.modes.fading import FadingMode
from crar_drake.errors import CrarError, ModelError, ScenarioError
from crar_drake.judging.obstacle_judge import ObstacleJudge
from crar_drake.judging.referee import Referee
from crar_drake.play.live_simulation import LiveSimulation
from crar_drake.play.recorder import OVER_TIME
from crar_drake.results.certificate import judge_certificate
from crar_drake.results.obstacles import judge_obstacles
from crar_drake.simulation.scenario import Scenario, load_scenario

PERIOD = 5e-3
CLOSE, CALM = 8e-5, 2.3e-4  # [m s^2]


def scenario(constraints: str = "lookahead") -> Scenario:
    loaded = load_scenario("dance_wrists")
    loaded.controller.period = PERIOD
    loaded.controller.constraints = constraints
    return loaded


@pytest.fixture(scope="module")
def live() -> LiveSimulation:
    return LiveSimulation(scenario())


@pytest.fixture(scope="module")
def referee(live) -> Referee:
    model = live.model
    return Referee(model.plant, model.scene_graph, model.description.pairs)


def steps(live: LiveSimulation, count: int) -> np.ndarray:
    """(count, n) accelerations of the controlled joints in these steps."""
    told = []
    for _ in range(count):
        live.step()
        told.append(commanded(live))
    return np.array(told)


def commanded(live: LiveSimulation) -> np.ndarray:
    return live.diagnostics()["desired_acceleration"][live.model.controlled]


def test_a_step_is_a_control_period(live):
    steps(live, 100)
    assert live.time == pytest.approx(0.5)
    assert live.simulator.get_context().get_time() == pytest.approx(0.5025)
    np.testing.assert_allclose(live.log().time, PERIOD * np.arange(101), atol=1e-12)


def test_the_motion_passes_the_governor_as_it_is(live):
    """So do the derivatives that the clock scales: differences are the judge."""
    steps(live, 140)
    log, layout = live.log(), live.model.layout
    x = log.desired_tasks[:, :6]
    v, a = log.desired_tasks[:, 6:12], log.desired_tasks[:, 12:]
    np.testing.assert_allclose((x[2:] - x[:-2]) / (2 * PERIOD), v[1:-1], atol=2e-3)
    np.testing.assert_allclose((v[2:] - v[:-2]) / (2 * PERIOD), a[1:-1], atol=0.2)
    assert np.abs(v).max() > 0.1 and layout.m == 6
    held = live.controller._GetHeld(live._controller_context)
    np.testing.assert_array_equal(held.governed, log.desired_tasks[-1])


@pytest.mark.parametrize("constraints", ["none", "paper", "lookahead"])
def test_another_mode_takes_over_without_a_jump(live, constraints):
    before = steps(live, 60)
    usual = np.abs(np.diff(before, axis=0)).max()
    live.set_mode(constraints)
    assert live.mode == constraints
    after = steps(live, 60)
    jumps = np.abs(np.diff(np.vstack([before[-1:], after]), axis=0)).max(axis=1)
    # The first step repeats what was commanded before, to the last digits.
    assert jumps[0] < 1e-9
    assert jumps.max() < 3.0 * usual + 3.0


def test_hands_do_not_jump_where_the_mode_changes_in_motion(live, referee):
    """From one period to the next, and from one's way to the next one's; no link
    touches another."""
    workspace, entries = live.model.MakeWorkspace(), live.model.layout.position_entries

    def hands() -> np.ndarray:
        return live.model.tasks_at(live.positions(), workspace)[entries]

    assert live.moves
    fastest = 0.0
    for constraints in ("paper", "lookahead", "none", "lookahead"):
        steps(live, 30)
        there = [hands()]
        for k in range(40):
            if k == 10:
                live.set_mode(constraints)
            live.step()
            there.append(hands())
            assert referee.distances(live.positions()).min() > 0.0
        moved = np.linalg.norm(np.diff(there, axis=0), axis=2).max()
        jump = np.linalg.norm(np.diff(there, 2, axis=0), axis=2).max()
        assert jump < 3e-3
        fastest = max(fastest, moved)
    assert fastest > 1e-3  # 0.2 m/s


def test_without_fading_there_is_a_jump(live, monkeypatch):
    """Else the test above could not fail."""
    monkeypatch.setattr("crar_drake.control.modes.fading.FADE_TIME", 0.0)
    live.set_mode("paper")
    before = commanded(live)
    after = steps(live, 2)
    assert np.abs(after[0] - before).max() > 0.5
    live.set_mode("lookahead")
    steps(live, 40)


def test_gains_change_what_is_done_and_keep_the_braking_time(live):
    horizon = live.parameters.braking_horizon
    before = commanded(live)
    assert set(live.gains) == {"smoothness"}
    live.set_gains({"K": 20.0, "smoothness": 2e-4})
    assert live.controller.law.parameters.K == 20.0
    assert live.gains == {"smoothness": 2e-4}
    assert live.parameters.braking_horizon == horizon
    assert isinstance(live.controller.law.mode, FadingMode)
    after = steps(live, 1)
    assert np.abs(after[0] - before).max() < 1e-9
    with pytest.raises(ScenarioError, match="diverges"):
        live.set_gains({"Kp": 9000.0, "K": 3000.0})
    assert live.parameters.K == 20.0 == live.controller.law.parameters.K
    live.set_gains({"K": 30.0, "smoothness": CALM})


def test_targets_that_are_dragged_into_the_body_are_not_followed_there(live, referee):
    """Both hands into the chest, through each other, behind the back, and home."""
    steps(live, 60)
    layout = live.model.layout
    lowest, left = np.inf, 0.0
    for where in ((0.0, 0.0, 0.75), (0.2, 0.0, 0.95), (0.05, 0.0, 1.0), None):
        for task in range(2):
            here = live.targets()[layout.position_entries[task]] - live.offsets[task]
            live.set_offset(task, np.zeros(3) if where is None else where - here)
        for k in range(100):
            if k % 50 == 40:  # other gains where it is near, there and back
                live.set_gains({"smoothness": CLOSE + CALM - live.gains["smoothness"]})
            live.step()
            if k % 4 == 0:
                lowest = min(lowest, referee.distances(live.positions()).min())
        left = max(left, np.abs(live.diagnostics()["task_error"]).max())
    assert 4e-3 <= lowest < 20e-3  # it was near,
    assert left > 0.03  # and held back


def test_a_push_gives_its_impulse_and_nothing_else_is_touched(live):
    """Against the same simulation without it, by the generalized momentum."""
    live.set_motion(False)
    steps(live, 300)
    plant, context = live.plant, live._plant_context
    frame = plant.GetFrameByName(live.model.description.task_frames["left_wrist"])
    J = plant.CalcJacobianTranslationalVelocity(
        context,
        JacobianWrtVariable.kV,
        frame,
        np.zeros(3),
        plant.world_frame(),
        plant.world_frame(),
    )
    M = plant.CalcMassMatrix(context)
    before = plant.GetVelocities(context)
    live.step()
    usual = plant.GetVelocities(context) - before
    live.push("left_wrist", np.array([0.0, 0.0, 30.0]))
    assert not live.pushed
    before = plant.GetVelocities(context)
    live.step()
    assert live.pushed
    gained = M @ (plant.GetVelocities(context) - before - usual)
    # For the control period, which is the plant's step.
    share = gained @ (J.T @ [0, 0, 30.0]) / np.sum((J.T @ [0, 0, 30.0]) ** 2)
    assert share == pytest.approx(5e-3, rel=0.2)
    for _ in range(30):
        live.step()
    assert not live.pushed
    assert live.logged_scenario().disturbances.pushes[0].frame == "left_wrist"
    with pytest.raises(ModelError, match="no_such"):
        live.push("no_such", np.zeros(3))


def test_pushes_are_bounded_in_sum(live):
    """Of those that act at a time: a crowd's, or a program's."""
    for _ in range(2):
        live.push("left_wrist", np.array([0.0, 0.0, 400.0]))
    with pytest.raises(CrarError, match="pushes of 1300 N together; at most 1000 N"):
        live.push("right_wrist", np.array([300.0, 400.0, 0.0]))
    live.push("right_wrist", np.array([0.0, 200.0, 0.0]))
    for _ in range(25):  # longer than each lasts
        live.step()
    live.push("right_wrist", np.array([300.0, 400.0, 0.0]))


def test_a_motion_that_is_off_stands(live):
    assert not live.moves
    phase = live.phase
    x = live.targets().copy()
    steps(live, 20)
    assert live.phase == phase
    np.testing.assert_array_equal(live.targets(), x)
    live.set_motion(True)
    steps(live, 100)
    assert live.phase != phase


def test_what_is_recorded_is_judged(live, referee):
    """No sample is lost, and of those of the lookahead each claim is true."""
    log = live.log()
    count = round(live.time / PERIOD) + 1
    np.testing.assert_allclose(log.time, PERIOD * np.arange(count), atol=1e-9)
    scenario = live.logged_scenario()
    assert scenario.controller.constraints == "none"  # what promises the least
    told = np.isfinite(log.admission[:, 3])
    assert 0.5 < told.mean() < 1.0
    pushed = scenario.disturbances.pushes[0].start
    nearest = np.where(log.time < pushed, log.signed_distances.min(axis=1), np.inf)
    nearest[~told] = np.inf
    near = slice(nearest.argmin() - 8, nearest.argmin() + 8)
    part = replace(log, **{name: getattr(log, name)[near] for name in OVER_TIME})
    verdict = judge_certificate(part, referee, scenario.controller, PERIOD)
    assert verdict.true and not verdict.violated and verdict.steps.judged >= 10
    assert "constraints none" in scenario.description
    assert "left_wrist pushed by 0, 0, 30 N" in scenario.description


def test_the_ball_is_dragged_no_faster_than_it_may_and_kept_off():
    """Into the chest and away again, while gains change; links stay off it or slow."""
    live = LiveSimulation(scenario())
    steps(live, 60)
    live.set_ball(np.array([0.1, 0.1, 0.95]))
    model, held = live.model, set()
    links = [link for pair in model.description.pairs for link in pair]
    judge = ObstacleJudge(model.plant, model.scene_graph, links)
    fast, touched, before = 0, 0, live.ball
    for k in range(600):
        if k == 420:
            live.set_ball(None)
        if k % 100 == 50:
            live.set_gains({"smoothness": CLOSE + CALM - live.gains["smoothness"]})
        live.step()
        assert np.linalg.norm(live.ball - before) <= 0.8 * PERIOD
        np.testing.assert_allclose(live.obstacles()[-1], [*live.ball, 0.08])
        before = live.ball
        held.add(live.holding_back())
        state = live.plant.GetPositionsAndVelocities(live._plant_context)
        q, v = np.split(state, 2)
        d, speed = judge.look(q, v, live.ball[None], np.array([0.08]))
        touched += int((d <= 0.0).any())
        fast += int(((d <= 0.0) & (speed > 0.05 * (1 + 1e-9))).any())
    assert {name for name, _ in held - {None}} == {"your ball"}
    assert touched > 10 and fast == 0
    logged = live.logged_scenario()
    assert logged.obstacles[-1].name == "your ball"
    assert "your ball to" in logged.description
    figures = judge_obstacles(
        *(live.log(), logged, model.plant, model.scene_graph),
        model.description.pairs,
    )
    assert figures["your ball"].contact_samples >= touched
    assert figures["your ball"].fast_contacts == 0


def test_the_oldest_pieces_are_dropped(live, monkeypatch):
    monkeypatch.setattr("crar_drake.play.recorder._PIECE", 0.1)
    monkeypatch.setattr(live.recorder, "kept", 0.3)
    steps(live, 200)
    log = live.log()
    assert 0.3 <= log.time[-1] - log.time[0] < 1.0
    np.testing.assert_allclose(np.diff(log.time), PERIOD, atol=1e-9)
    assert log.time[-1] == pytest.approx(live.time)


def test_what_cannot_be_done(live):
    with pytest.raises(CrarError, match="there is no target 7"):
        live.set_offset(7, np.zeros(3))
    with pytest.raises(ScenarioError, match="cannot change in a simulation"):
        live.controller.TakeOver(
            live._controller_context, replace(live.parameters, period=0.01)
        )


def test_a_governor_lets_the_motion_pass(live):
    governor = live.parameters.governor
    times = np.linspace(0.0, live.duration, 150)
    v = np.array([live.setup.motion.tasks_at(t)[6:12] for t in times]).reshape(-1, 3)
    assert governor.speed > np.linalg.norm(v, axis=1).max()
    assert governor.speed >= 1.5 and governor.angular_speed is None
