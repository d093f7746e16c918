"""A simulation that is moved by hand while it goes on: no violation, no lost sample.

The tests share one simulation, in the order in which they stand here.
"""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.multibody.tree import JacobianWrtVariable

from crar_drake.errors import CrarError, ModelError
from crar_drake.judging.obstacle_judge import ObstacleJudge
from crar_drake.judging.referee import Referee
from crar_drake.law.parameters import with_constraints
from crar_drake.play.live_scene import LiveScene
from crar_drake.play.live_simulation import LiveSimulation
from crar_drake.play.pacing import Pacer
from crar_drake.play.recorder import OVER_TIME
from crar_drake.results.certificate import judge_certificate
from crar_drake.results.log import SimulationLog
from crar_drake.results.obstacles import judge_obstacles
from crar_drake.simulation.scenario import Scenario, load_scenario

PERIOD = 5e-3


def scenario(constraints: str = "lookahead") -> Scenario:
    loaded = load_scenario("dance_wrists")
    loaded.controller.period = PERIOD
    loaded.controller = with_constraints(loaded.controller, constraints)
    return loaded


@pytest.fixture(scope="module")
def live() -> LiveSimulation:
    return LiveSimulation(scenario())


@pytest.fixture(scope="module")
def referee(live) -> Referee:
    model = live.model
    return Referee(model.plant, model.scene_graph, model.description.pairs)


def log_of(live: LiveSimulation) -> SimulationLog:
    return live.recorder.log(live.logged_scenario())


def steps(live: LiveSimulation, count: int) -> None:
    for _ in range(count):
        live.step()


def test_a_step_is_a_control_period(live):
    steps(live, 100)
    assert live.time == pytest.approx(0.5)
    assert live.simulator.get_context().get_time() == pytest.approx(0.5025)
    np.testing.assert_allclose(log_of(live).time, PERIOD * np.arange(101), atol=1e-12)


def test_what_the_motion_asks_for_is_smooth(live):
    """So do the derivatives that the clock scales: differences are the judge."""
    steps(live, 140)
    log, layout = log_of(live), live.model.layout
    x = log.desired_tasks[:, :6]
    v, a = log.desired_tasks[:, 6:12], log.desired_tasks[:, 12:]
    np.testing.assert_allclose((x[2:] - x[:-2]) / (2 * PERIOD), v[1:-1], atol=2e-3)
    np.testing.assert_allclose((v[2:] - v[:-2]) / (2 * PERIOD), a[1:-1], atol=0.2)
    assert np.abs(v).max() > 0.1 and layout.m == 6


def test_a_target_that_is_dragged_moves_at_a_bounded_speed(live):
    """Straight to where it is wanted, and home."""
    live.set_offset(0, np.array([0.03, 0.0, 0.04]))
    live.set_offset(1, np.array([0.0, 0.001, 0.0]))
    way = []
    for _ in range(8):
        live.step()
        way.append(live.moved)
        motion = live.targets()[live.model.layout.position_entries] - live.moved
        np.testing.assert_allclose(live.wanted(), motion + live.offsets, atol=1e-12)
    way = np.array(way)
    np.testing.assert_allclose(
        way[:6, 0], np.outer(1.5 * PERIOD * np.arange(1, 7), [0.6, 0.0, 0.8]), atol=1e-9
    )
    np.testing.assert_allclose(way[7], [[0.03, 0.0, 0.04], [0.0, 0.001, 0.0]])
    assert way[0, 1, 1] == pytest.approx(0.001)
    live.take_offsets_away()
    steps(live, 8)
    assert not live.offsets.any() and not live.moved.any()


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
    """No sample is lost, and each claim is true."""
    log = log_of(live)
    count = round(live.time / PERIOD) + 1
    np.testing.assert_allclose(log.time, PERIOD * np.arange(count), atol=1e-9)
    scenario = live.logged_scenario()
    pushed = scenario.disturbances.pushes[0].start
    nearest = np.where(log.time < pushed, log.signed_distances.min(axis=1), np.inf)
    near = slice(nearest.argmin() - 8, nearest.argmin() + 8)
    part = replace(log, **{name: getattr(log, name)[near] for name in OVER_TIME})
    verdict = judge_certificate(part, referee, scenario.controller, PERIOD)
    assert verdict.true and not verdict.violated and verdict.steps.judged >= 10
    assert "left_wrist pushed by 0, 0, 30 N" in scenario.description


def test_the_ball_is_dragged_no_faster_than_it_may_and_kept_off():
    """Into the chest and away again; links stay off it or slow."""
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
        *(log_of(live), logged, model.plant, model.scene_graph),
        model.description.pairs,
    )
    assert figures["your ball"].contact_samples >= touched
    assert figures["your ball"].fast_contacts == 0


def test_what_is_beyond_a_limit_is_never_called_clear_and_is_left():
    """A push that leads an elbow 2 rad beyond, where the hand is caught behind the
    upper arm, if joints do not stop at their limits."""
    live = LiveSimulation(scenario())
    steps(live, 60)
    live.set_motion(False)
    steps(live, 25)
    scene, model = LiveScene(live, Meshcat()), live.model
    live.push("left_forearm", np.array([-310.7125, 79.962, 106.8492]))
    farthest = 0.0
    for k in range(300):
        live.step()
        q = live.positions()[model.controlled_positions]
        beyond = np.maximum(model.lower - q, q - model.upper).max()
        farthest = max(farthest, beyond)
        if beyond > 1e-6 or k % 10 == 0:
            kind, words = scene.frame(Pacer(0.0), 0.0, "")["promise"]
            assert kind == "broken" or beyond <= 1e-6
    assert beyond < 0.0 and farthest < 0.1
    assert (kind, words) == ("holds", "lookahead: the way to brake is clear")
    # Put there by hand: it is said, whatever pairs let it do.
    elbow, q = model.joint_names.index("left_elbow"), live.positions()
    q[model.controlled_positions[elbow]] = model.upper[elbow] + 0.5
    live.plant.SetPositions(live._plant_context, q)
    assert scene.frame(Pacer(0.0), 0.0, "")["promise"][0] == "broken"


def test_the_oldest_pieces_are_dropped(live, monkeypatch):
    monkeypatch.setattr("crar_drake.play.recorder._PIECE", 0.1)
    monkeypatch.setattr(live.recorder, "kept", 0.3)
    steps(live, 200)
    log = log_of(live)
    assert 0.3 <= log.time[-1] - log.time[0] < 1.0
    np.testing.assert_allclose(np.diff(log.time), PERIOD, atol=1e-9)
    assert log.time[-1] == pytest.approx(live.time)


def test_what_cannot_be_done(live):
    with pytest.raises(CrarError, match="there is no target 7"):
        live.set_offset(7, np.zeros(3))


@pytest.mark.parametrize("constraints", ["none", "paper"])
def test_what_keeps_off_no_obstacle_has_no_ball(constraints):
    live = LiveSimulation(scenario(constraints))
    steps(live, 20)
    assert live.mode == constraints == live.logged_scenario().controller.constraints
    assert live.ball is None
    with pytest.raises(CrarError, match="there is no ball"):
        live.set_ball(np.zeros(3))
