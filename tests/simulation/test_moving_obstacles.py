"""Obstacles of a scenario: what a file may say, and what a run makes of them."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.geometry import Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import RevoluteJoint, SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from crar_drake import ScenarioError
from crar_drake.judging.obstacle_judge import ObstacleJudge
from crar_drake.law.parameters import with_constraints
from crar_drake.results.log import SimulationLog
from crar_drake.results.playback import record_logs
from crar_drake.run import run_scenario
from crar_drake.simulation.moving_obstacles import MovingObstacle, ObstacleSource, Place
from crar_drake.simulation.scenario import Scenario, load_scenario, parse_scenario
from tests.recorded_pages import read_data

PERSON = """
obstacles:
  - name: Ann
    radius: 0.2
    {speed}
    keyframes:
      - {{time: 0.0, xyz: [1.0, 0.0, 1.0]}}
      - {{time: 0.5, xyz: [0.4, 0.0, 1.8]}}
      - {{time: 2.5, xyz: [0.4, 2.0, 1.8]}}
"""
SCENARIO = "motion: dance\nexperiment: wrists\n"


def test_between_keyframes_it_moves_straight_and_its_speed_is_known():
    """0.6 and 0.8 m in half a second are 2 m/s; then it takes 1 m/s."""
    (ann,) = parse_scenario(SCENARIO + PERSON.format(speed="")).obstacles
    assert ann.fastest == pytest.approx(2.0)
    np.testing.assert_allclose(ann.at(0.25), [0.7, 0.0, 1.4])
    np.testing.assert_allclose(ann.at(1.5), [0.4, 1.0, 1.8])
    np.testing.assert_allclose(ann.at(-1.0), [1.0, 0.0, 1.0])
    np.testing.assert_allclose(ann.at(99.0), [0.4, 2.0, 1.8])
    (ann,) = parse_scenario(SCENARIO + PERSON.format(speed="speed: 2.5")).obstacles
    assert ann.fastest == 2.5
    ball = MovingObstacle("ball", 0.1, None, [], [1.0, 2.0, 3.0], [0.0, -3.0, 4.0])
    ball.validate()
    assert ball.fastest == pytest.approx(5.0)
    np.testing.assert_allclose(ball.at(0.5), [1.0, 0.5, 5.0])


def test_the_source_has_all_of_them_and_shifts_them_by_hand():
    place = MovingObstacle("post", 0.3, None, [Place(0.0, [1.0, 1.0, 1.0])])
    ball = MovingObstacle("ball", 0.1, None, [], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    source = ObstacleSource([place, ball])
    context = source.CreateDefaultContext()
    context.SetTime(2.0)
    out = source.get_output_port()
    np.testing.assert_allclose(out.Eval(context), [1, 1, 1, 0.3, 2, 0, 1, 0.1])
    source.shift(context, np.array([[0.0, 0.0, 0.0], [0.5, 0.0, -0.5]]))
    np.testing.assert_allclose(out.Eval(context), [1, 1, 1, 0.3, 2.5, 0, 0.5, 0.1])


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"speed": 1.9}, ["Ann", "speed", "1.9", "from 0 to 0.5 s", "2 m/s"]),
        ({"speed": -1.0}, ["Ann", "speed", "-1"]),
        ({"radius": 0.0}, ["Ann", "radius"]),
        ({"name": ""}, ["name"]),
        ({"keyframes": []}, ["Ann", "either keyframes or a start"]),
        ({"start": [0.0, 0.0, 0.0]}, ["Ann", "both"]),
        ({"velocity": [0.0, 0.0, 0.0]}, ["Ann", "velocity"]),
        ({"keyframes": [Place(0.0, [0.0, 1.0])]}, ["Ann", "0 s", "three"]),
        (
            {"keyframes": [Place(1.0, [0.0] * 3), Place(1.0, [1.0] * 3)]},
            ["Ann", "increase"],
        ),
        ({"keyframes": [], "start": [0.0, 0.0, np.nan]}, ["Ann", "start"]),
        ({"keyframes": [], "start": [0.0] * 3}, ["Ann", "velocity"]),
    ],
)
def test_what_is_wrong_is_said_with_the_obstacles_name(changes, words):
    (ann,) = parse_scenario(SCENARIO + PERSON.format(speed="")).obstacles
    with pytest.raises(ScenarioError) as caught:
        Scenario(
            motion="dance", experiment="wrists", obstacles=[replace(ann, **changes)]
        ).validate()
    for word in words:
        assert word in str(caught.value)


def test_two_of_one_name_and_other_time_steps_are_refused():
    (ann,) = parse_scenario(SCENARIO + PERSON.format(speed="")).obstacles
    scenario = Scenario(motion="dance", experiment="wrists", obstacles=[ann, ann])
    with pytest.raises(ScenarioError, match="two are called Ann"):
        scenario.validate()
    scenario.obstacles = [ann]
    scenario.controller.period = 0.005
    with pytest.raises(ScenarioError, match="time step, 0.001 s, must be the control"):
        run_scenario(scenario)


def test_the_judge_knows_distance_and_speed_of_a_ball_on_a_string():
    """A ball of 0.1 m turns at 2 rad/s, 1 m from the axis: its far side has 2.2 m/s."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    arm = plant.AddRigidBody("arm", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
    plant.AddJoint(
        RevoluteJoint("turn", plant.world_frame(), arm.body_frame(), [0.0, 0.0, 1.0])
    )
    far = RigidTransform([1.0, 0.0, 0.0])
    plant.RegisterCollisionGeometry(arm, far, Sphere(0.1), "ball", CoulombFriction())
    plant.Finalize()
    builder.Build()
    judge = ObstacleJudge(plant, scene_graph, ["arm"])
    # At 90 degrees the ball is at (0, 1, 0).
    q, v = np.array([np.pi / 2]), np.array([2.0])
    centres = np.array([[0.0, 2.0, 0.0], [0.0, 1.15, 0.0], [0.0, 0.85, 0.0]])
    d, speed = judge.look(q, v, centres, np.full(3, 0.1))
    np.testing.assert_allclose(d[0], [0.8, -0.05, -0.05], atol=1e-12)
    np.testing.assert_allclose(speed[0], [2.2, 2.2, 1.8], atol=1e-12)
    spheres = np.array([[[0.0, y, 0.0, 0.1]] for y in (1.3, 1.15, 2.0)])
    times, states = np.arange(3.0), (np.tile(q, (3, 1)), np.array([v, v, v]))
    for harmless, violations in ((2.3, 0), (2.1, 1)):
        (found,) = judge.judge(times, *states, spheres, harmless)
        assert (found.contact_samples, found.fast_contacts) == (1, violations)
        assert (found.link, found.time) == ("arm", 1.0)
        assert found.fastest_contact == pytest.approx(2.2)
        assert found.smallest_distance == pytest.approx(-0.05)
    # A ball at rest may be touched.
    (found,) = judge.judge(times, states[0], 0.0 * states[1], spheres, 0.05)
    assert (found.contact_samples, found.fast_contacts) == (1, 0)
    assert found.fastest_contact == 0.0


@pytest.fixture(scope="module")
def among() -> Scenario:
    """The shipped one, shortened: a person runs at the robot at 2 m/s and stays."""
    scenario = load_scenario("upper_body_among")
    way = [Place(0.3, [1.4, 0.1, 0.9]), Place(1.0, [0.15, 0.1, 0.9])]
    scenario.obstacles = [MovingObstacle("person", 0.2, 2.0, way)]
    scenario.duration = 1.5
    return scenario


def test_a_run_judges_them_and_shows_them(among, tmp_path):
    result = run_scenario(among, tmp_path, record=False)
    figures = result.summary.obstacles["person"]
    assert figures.contact_samples > 10  # who runs into it does touch it
    assert figures.fast_contacts == result.summary.fast_contacts == 0
    assert result.summary.unclear_steps == 0
    assert result.summary.scaled_steps > 10
    log = SimulationLog.load(tmp_path / "log.npz")
    person = log.obstacles.reshape(-1, 1, 4)
    np.testing.assert_allclose(person[0, 0], [1.4, 0.1, 0.9, 0.2])
    np.testing.assert_allclose(person[-1, 0], [0.15, 0.1, 0.9, 0.2])
    page = tmp_path / "page.html"
    record_logs([log], page)
    data = read_data(page)
    assert data["robots"][0]["spheres"] == 1
    assert data["robots"][0]["paths"][-1] == "/crar/robot0/obstacle 0"
    poses = data["runs"][0]["poses"].reshape(len(data["runs"][0]["poses"]), -1, 7)
    np.testing.assert_allclose(poses[-1, -1], [0.15, 0.1, 0.9, 0, 0, 0, 1], atol=1e-3)
    at = [0.7 * data["runs"][0]["rate"]]
    expected = np.interp(at, np.arange(len(poses)), poses[:, -1, 0])
    np.testing.assert_allclose(expected, 1.4 - 0.4 / 0.7 * 1.25, atol=0.03)


def test_without_the_lookahead_it_is_run_into(among):
    paper = with_constraints(among.controller, "paper")
    scenario = replace(among, controller=paper)
    summary = run_scenario(scenario).summary
    assert summary.fast_contacts > 10
    assert summary.obstacles["person"].fastest_contact > 0.1
