"""Targets, files and judge of the comparison of controllers of a robot that stands."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from scipy.spatial.transform import Rotation

from benchmarks.peers import standing
from benchmarks.peers.driver import NoAnswer, Problem
from benchmarks.peers.floating import (
    Floating,
    after,
    from_pinocchio,
    matrix,
    to_pinocchio,
)
from crar_drake.control.parameters import BalanceParameters
from tests.standing_robots import CORNERS, standing_robot

MARGIN = 0.02


@pytest.fixture(scope="module")
def judge(tmp_path_factory) -> standing.Judge:
    robot = standing_robot(tmp_path_factory.mktemp("robot"))
    return standing.Judge(robot, BalanceParameters(MARGIN), ["hand"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory, judge) -> Path:
    path = tmp_path_factory.mktemp("problem")
    standing.write_robot(path, judge)
    return path


class Told(Floating):
    """Answers with accelerations that are told, step by step."""

    def set_up(self, settings: dict) -> None:
        self.told = iter(settings["told"])

    def solve(self, q, v, targets):
        a = next(self.told)
        if a is None:
            raise NoAnswer
        return a


def state(rng: np.random.Generator, n: int = 3) -> tuple[np.ndarray, np.ndarray]:
    q, v = rng.normal(size=7 + n), rng.normal(size=6 + n)
    q[:4] /= np.linalg.norm(q[:4])
    return q, v


def recorded(judge, folder, told) -> dict[str, np.ndarray]:
    """What a driver writes that is told these accelerations."""
    steps = len(told)
    time = standing.PERIOD * np.arange(steps + 1)
    p = np.tile(judge.home, (steps + 1, 1, 1))
    path = folder / "told.npz"
    np.savez(path, time=time, p=p, v=0.0 * p, a=0.0 * p)
    driver = Told(Problem(folder), standing.PERIOD, {"told": told})
    return driver.record(path, standing.PERIOD, None)


def test_the_roots_turn_is_that_of_another_program():
    rng = np.random.default_rng(1)
    q, v = state(rng)
    assert np.allclose(matrix(q[:4]), Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix())
    a = np.zeros(9)
    turn = Rotation.from_rotvec(0.3 * v[:3])
    expected = turn.as_matrix() @ matrix(q[:4])
    assert np.allclose(matrix(after(q, v, a, 0.3)[:4]), expected)


def test_a_path_with_held_accelerations_in_pinocchios_axes():
    """Differences of the velocity in the root's axes, along the path, are Pinocchio's
    accelerations."""
    rng = np.random.default_rng(2)
    (q, v), a, h = state(rng), rng.normal(size=9), 1e-5

    def inside(t: float) -> np.ndarray:
        return to_pinocchio(after(q, v, a, t), v + t * a)[1]

    differences = (inside(h) - inside(-h)) / (2.0 * h)
    assert np.allclose(from_pinocchio(q, v, differences), a, atol=1e-7)


def test_pinocchios_positions_have_the_place_first(judge):
    q, _ = to_pinocchio(judge.rest, np.zeros(len(judge.rest) - 1))
    assert np.allclose(q[:7], [0, 0, judge.rest[6], 0, 0, 0, 1])
    assert np.allclose(q[7:], judge.rest[7:])


def test_the_written_robot_is_the_shipped_one(judge, folder):
    """Read by Drake: the same mass, and points of soles and hand where they were."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(folder / "robot_pinocchio.urdf"))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    q = np.zeros(plant.num_positions())
    names = plant.GetPositionNames(add_model_instance_prefix=False)
    for joint, angle in zip(judge.joints, judge.rest[7:], strict=True):
        (at,) = [i for i, name in enumerate(names) if name == f"{joint}_q"]
        q[at] = angle
    (root,) = [i for i, name in enumerate(names) if name.endswith("_qw")]
    q[root] = 1.0
    q[names.index(names[root].replace("_qw", "_z"))] = judge.rest[6]
    plant.SetPositions(context, q)
    assert plant.CalcTotalMass(context) == pytest.approx(
        judge.model.plant.CalcTotalMass(judge.model.plant.CreateDefaultContext())
    )
    hand = plant.GetFrameByName("hand").CalcPoseInWorld(context)
    assert np.allclose(hand.translation(), judge.home[0])
    for sole in json.loads((folder / "standing.json").read_text())["soles"]:
        X = plant.GetFrameByName(sole["frame"]).CalcPoseInWorld(context)
        assert np.allclose(X.rotation().matrix(), np.eye(3))
        assert X.translation()[2] == pytest.approx(0.0, abs=1e-9)


def test_soles_are_smaller_by_the_margin(folder):
    x, y = np.array(CORNERS).T
    for sole in json.loads((folder / "standing.json").read_text())["soles"]:
        assert sole["length"] == pytest.approx(x.max() - x.min() - 2 * MARGIN)
        assert sole["width"] == pytest.approx(y.max() - y.min() - 2 * MARGIN)


def test_targets_are_a_smooth_path_from_rest(tmp_path):
    home = np.array([[0.1, 0.2, 0.3]])
    rng = np.random.default_rng(3)
    targets = standing.swings(home.ravel(), rng, (0.1, 0.2), (1.0, 2.0))
    standing.write_case(tmp_path / "case.npz", home, targets, 2.0)
    case = np.load(tmp_path / "case.npz")
    p, v, a, h = case["p"], case["v"], case["a"], standing.SAMPLE
    assert np.allclose(p[0], home) and np.allclose([v[0], a[0]], 0.0)
    assert np.allclose((p[2:] - p[:-2]) / (2 * h), v[1:-1], atol=0.02)
    assert np.allclose((v[2:] - v[:-2]) / (2 * h), a[1:-1], atol=0.4)
    assert np.allclose(p[-1], targets(2.0)[:3])


def test_a_robot_at_rest_is_judged_at_rest(judge, folder):
    found = recorded(judge, folder, [np.zeros(len(judge.rest) - 1)] * 4)
    figures = judge.figures(found, found_p(judge, 4))
    assert figures.wrong == 0.0 and figures.outside == 0.0
    assert figures.error == pytest.approx(0.0, abs=1e-9)
    # At rest the centre of pressure is below the centre of mass.
    plant = judge.model.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, judge.model.rest_positions())
    com = plant.CalcCenterOfMassPositionInWorld(context)[:2]
    expected = (judge.ground.hull[:, :2] @ com + judge.ground.hull[:, 2]).max()
    assert figures.farthest == pytest.approx(expected, abs=1e-9)


def test_a_push_sideways_is_seen_as_friction_and_outside(judge, folder):
    """The whole robot, accelerated as one: slope and centre by Newton."""
    a = np.zeros(len(judge.rest) - 1)
    a[3] = 6.0  # along x
    figures = judge.figures(recorded(judge, folder, [a, a]), found_p(judge, 2))
    assert figures.slips == 1.0 and figures.outside == 1.0  # 6 / 9.81 > 0.5
    a[3] = 1.0
    plant = judge.model.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, judge.model.rest_positions())
    com = plant.CalcCenterOfMassPositionInWorld(context)
    at = com[:2] - [com[2] * 1.0 / 9.81, 0.0]
    expected = (judge.ground.hull[:, :2] @ at + judge.ground.hull[:, 2]).max()
    outside, slope = judge.demand(judge.rest[None], np.zeros((1, len(a))), a[None])
    assert slope[0] == pytest.approx(1.0 / 9.81, rel=1e-3)
    assert outside[0] == pytest.approx(expected, abs=1e-4)


def test_a_motor_that_is_too_weak_is_seen(judge):
    """The elbow's is 60 Nm; the forearm is a kilogram 15 cm away from it."""
    a = np.zeros((2, len(judge.rest) - 1))
    a[0, -1], a[1, -1] = 1e3, 3e3  # 60 / (1 * 0.15^2 + 0.01) = 1.8e3
    weak = judge.too_weak(np.tile(judge.rest, (2, 1)), 0.0 * a, a)
    assert judge.joints[-1] == "elbow"
    assert weak.tolist() == [False, True]


def found_p(judge, steps: int) -> np.ndarray:
    return np.tile(judge.home, (steps, 1, 1))


def test_a_step_without_an_answer_stops_the_robot(judge, folder):
    a = np.zeros(len(judge.rest) - 1)
    a[-1] = 10.0
    found = recorded(judge, folder, [a, None, np.full_like(a, np.nan), a])
    assert found["no_answer"].tolist() == [False, True, True, False]
    assert np.allclose(found["v"][1:3], 0.0)
    figures = judge.figures(found, found_p(judge, 4))
    assert figures.failed == 0.5
    assert figures.acceleration == pytest.approx(10.0)


def test_the_best_settings_have_nothing_wrong():
    good = standing.Figures(0, 0, -0.01, 0, 0, 0, 0, 0, 0.05, 10, 0, 0, 0)
    near = replace(good, error=0.01, outside=0.2)
    better = replace(good, error=0.04, pairs=0.1)
    assert standing.best([good, near, better]) == 2
    assert standing.best([near, replace(near, outside=0.1, error=1.0)]) == 1
    slid = replace(good, error=0.001, soles=0.01)
    assert standing.best([slid, good]) == 1


def test_figures_of_several_runs_are_merged():
    one = standing.Figures(0.1, 0.2, 0.3, 0, 0, 0, 0, 0, 0.03, 10, 0.1, 0, 0)
    two = standing.Figures(0.0, 0.0, -0.1, 0, 0, 0, 0, 0, 0.04, 30, 0.0, 0, 0)
    both = standing.merged([one, two])
    assert both.outside == pytest.approx(0.1) and both.farthest == 0.3
    assert both.error == pytest.approx(np.sqrt(0.5 * (0.03**2 + 0.04**2)))
    assert both.acceleration == 30


def test_drivers_of_peers_need_nothing_of_the_project():
    """Their environments lack it."""
    code = (
        "import sys; import benchmarks.peers.floating; "
        "assert not any(m.startswith(('crar_drake', 'pydrake')) for m in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=standing_root())
    assert done.returncode == 0


def standing_root() -> Path:
    return Path(standing.__file__).resolve().parents[2]
