"""A robot that stands, live: targets are dragged, it is pushed, its log is whole."""

import time

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from standing_robots import HEIGHT, standing_robot

from crar_drake.law.parameters import LookaheadParameters
from crar_drake.play.live_scene import LiveScene
from crar_drake.play.live_simulation import LiveSimulation
from crar_drake.play.pacing import Pacer
from crar_drake.robot.task import Task
from crar_drake.simulation.scenario import Scenario, Standing
from crar_drake.targets.keyframes import Keyframe


@pytest.fixture(scope="module")
def live(tmp_path_factory) -> LiveSimulation:
    folder = tmp_path_factory.mktemp("robot")
    standing_robot(folder)
    way = [[0.45, 0.1, HEIGHT + 0.1], [0.45, 0.15, HEIGHT + 0.15]]
    scenario = Scenario(
        robot=str(folder),
        tasks=[Task(frame="hand")],
        keyframes={"hand": [Keyframe(time=i, xyz=xyz) for i, xyz in enumerate(way)]},
        standing=Standing(),
        controller=LookaheadParameters(period=0.005),
    )
    return LiveSimulation(scenario)


def test_it_stands_whatever_a_person_does(live) -> None:
    for k in range(120):
        if k == 20:
            live.set_offset(0, np.array([-0.1, 0.0, 0.1]))
        if k == 60:
            live.push("trunk", np.array([20.0, 0.0, 0.0]))
        live.step()
    log = live.recorder.log(live.logged_scenario())
    assert len(log.time) > 100 and log.q.shape[1] == 21
    assert np.abs(log.q[:, 6] - HEIGHT).max() < 0.02
    assert np.abs(log.v[:, 3]).max() > 0.005  # it was pushed


def test_the_page_shows_the_robot_itself(live) -> None:
    scene = LiveScene(live, Meshcat())
    frame = scene.frame(Pacer(time.monotonic()), time.monotonic(), "")
    poses = np.reshape(frame["poses"], (-1, 7))
    assert len(poses) == len(scene.robot.paths)
    hand = live.setup.simulated.tasks_at(live.positions())[:3]
    np.testing.assert_allclose(frame["reached"][0], hand, atol=1e-4)
