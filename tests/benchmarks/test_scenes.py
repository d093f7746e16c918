"""The scenes of benchmarks/peers with spheres that move, without the peers."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from benchmarks.peers.driver import Guard, NoAnswer, Problem, Spheres
from benchmarks.peers.problem import BASE, describe, write_problem
from crar_drake import load_robot_description
from crar_drake.law.obstacles import Obstacles
from crar_drake.law.safety_filter import SafetyFilter

PERIOD = 0.01


@pytest.fixture(scope="module")
def on_a_base(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("base")
    write_problem(folder, "obstacle_arm", on_a_base=True)
    return folder


def test_a_base_moves_all_links_of_the_robot(on_a_base):
    """By Drake: x, y and yaw of the base move the tool as they move the plane."""
    problem = Problem(on_a_base)
    assert problem.joints[:3] == ["base_x", "base_y", "base_yaw"]
    assert np.allclose(problem.upper[:3], [BASE["reach"], BASE["reach"], np.pi])
    assert np.allclose(problem.velocity_limits[:3], BASE["fastest"])
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(on_a_base / "robot.urdf"))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(problem.base))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    tool = plant.GetBodyByName(problem.links[0])

    def tool_at(base: np.ndarray) -> np.ndarray:
        plant.SetPositions(context, np.concatenate([base, problem.rest[3:]]))
        return tool.EvalPoseInWorld(context).translation()

    before, turn = tool_at(np.zeros(3)), 0.7
    cos, sin = np.cos(turn), np.sin(turn)
    wanted = [0.3, -0.2, 0.0] + np.array(
        [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]
    ) @ before
    assert np.allclose(tool_at(np.array([0.3, -0.2, turn])), wanted)


class Passes(Guard):
    """Lets everything through, but has no answer in its third step."""

    def __init__(self, problem=None, period=PERIOD, settings=None) -> None:
        self.seen: list[Spheres] = []

    def guard(self, q, v, spheres):
        self.seen.append(spheres)
        if len(self.seen) == 3:
            raise NoAnswer
        return v


def test_all_filters_are_given_the_same_wish_and_what_a_sphere_did(tmp_path):
    time = PERIOD * np.arange(6)
    centres = np.zeros((6, 1, 3))
    centres[:, 0, 1] = 0.4 * time
    case = tmp_path / "case.npz"
    np.savez(
        case,
        time=time,
        q_start=np.zeros(2),
        q=np.tile([0.1, 9.0], (6, 1)),
        fastest=np.array([2.0, 2.0]),
        centres=centres,
        radii=np.array([0.05]),
        speeds=np.array([0.4]),
    )
    guard = Passes()
    made = guard.record(case, PERIOD, None)
    # By hand: 3/s times what is missing, at most 2 rad/s; none in the third step.
    assert np.allclose(made["v"][1], [0.3, 2.0])
    assert np.allclose(made["v"][2], [3.0 * (0.1 - 0.003), 2.0])
    assert np.allclose(made["v"][3], 0.0)
    assert made["no_answer"].tolist() == [False, False, True, False, False]
    assert np.allclose(made["q"][3], made["q"][2])
    assert np.allclose(guard.seen[0].velocities, 0.0)
    assert np.allclose(guard.seen[2].velocities, [[0.0, 0.4, 0.0]])


def test_the_filter_in_the_driver_is_the_filter(on_a_base, tmp_path):
    """The commands of the driver are those of a filter that is called by hand."""
    from benchmarks.peers.guard_crar import CrarGuard

    problem = Problem(on_a_base)
    n = len(problem.joints)
    wanted = problem.rest + np.linspace(0.0, 0.5, n)
    case = tmp_path / "case.npz"
    sphere = np.array([[0.4, 0.3, 0.6]])
    np.savez(
        case,
        time=PERIOD * np.arange(21),
        q_start=problem.rest,
        q=np.tile(wanted, (21, 1)),
        fastest=np.full(n, 2.0),
        centres=np.tile(sphere, (21, 1, 1)),
        radii=np.array([0.05]),
        speeds=np.array([0.25]),
    )
    made = CrarGuard(problem, PERIOD, {}).record(case, PERIOD, None)
    filter = SafetyFilter(
        describe(on_a_base, load_robot_description("obstacle_arm")), PERIOD
    )
    filter.reset(problem.rest)
    q = problem.rest
    for k in range(20):
        v = np.clip(3.0 * (wanted - q), -2.0, 2.0)
        around = Obstacles(sphere, 0.05, 0.25, ("sphere 0",))
        q = filter(v=v, obstacles=around).q
        assert np.allclose(made["q"][k + 1], q, atol=1e-12)
