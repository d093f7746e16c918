"""Peers as filters of references: the problem, the loop, the choice, the judging."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from small_reference_robots import reaching, write_csv, write_robot

from benchmarks.peers import filters
from benchmarks.peers.driver import (
    Filter,
    NoAnswer,
    Problem,
    is_recorded,
    made_of,
)
from crar_drake.errors import CrarError
from crar_drake.references.reference_judge import ReferenceJudge
from crar_drake.robot.description import load_robot_description

RATE = 30.0


class Robot:
    """The chain of three, its joints turned in their links, and one motion of it."""

    def __init__(self, folder: Path) -> None:
        robot = write_robot(folder)
        urdf = robot / "chain.urdf"
        text = urdf.read_text().replace(
            'xyz="0.3 0 0"/>', 'xyz="0.3 0 0" rpy="0.3 -0.2 0.7"/>'
        )
        # As an import writes it.
        text = text.replace("<capsule ", "<drake:capsule ")
        self.turned = text.replace("<collision>", '<collision name="ball">')
        urdf.write_text(self.turned)
        self.description = load_robot_description(robot)
        self.judge = ReferenceJudge(self.description, meshes=False)
        path = write_csv(folder / "swing.csv", reaching(20, RATE, 0.3))
        self.motions = filters.read_references(path, self.judge.robot)
        self.folder = folder / "problem"
        self.start = self.motions["swing"].joint_positions[0] + 0.1
        self.periods = filters.write_references(
            self.folder, self.description, self.motions, {"swing": self.start}
        )


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Robot:
    return Robot(tmp_path_factory.mktemp("filters"))


def poses(path: Path, q: np.ndarray, links: list[str]) -> list[np.ndarray]:
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
    Parser(plant).AddModels(str(path))
    base = plant.GetBodyByName("base")
    if base not in plant.GetBodiesWeldedTo(plant.world_body()):
        plant.WeldFrames(plant.world_frame(), base.body_frame())
    plant.Finalize()
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    return [
        plant.GetBodyByName(link).EvalPoseInWorld(context).GetAsMatrix34()
        for link in links
    ]


@pytest.mark.parametrize("name", ["robot_pinocchio.urdf", "robot_mujoco.xml"])
def test_turned_joints_stand_in_every_dialect(robot, name) -> None:
    assert "rpy" in robot.turned
    links = sorted({link for pair in robot.description.pairs for link in pair})
    q = np.array([0.4, -0.7, 1.1])
    wanted = poses(Path(robot.description.folder) / "chain.urdf", q, links)
    np.testing.assert_allclose(poses(robot.folder / name, q, links), wanted, atol=1e-9)


def test_the_problem_is_of_this_robot(robot) -> None:
    problem = json.loads((robot.folder / "problem.json").read_text())
    assert problem["pairs"] == robot.description.pairs
    assert problem["velocity_limits"] == [6.0] * 3
    assert robot.periods == {"swing": 1.0 / RATE}
    case = np.load(robot.folder / "swing.npz")
    assert case["q"].shape == (20, 3) and case["time"][-1] == pytest.approx(19 / RATE)
    empty = robot.folder / "none"
    empty.mkdir()
    with pytest.raises(CrarError, match="no robot motions"):
        filters.read_references(empty, robot.judge.robot)


class Straight(Filter):
    """Goes where it is to go, but in one step."""

    def set_up(self, settings: dict) -> None:
        self.asked, self.silent = [], settings["silent"]

    def solve(self, q, v, targets):
        self.asked.append(targets)
        if len(self.asked) == self.silent:
            raise NoAnswer
        return (targets - q) / self.period


def test_the_loop_goes_where_the_filter_says(robot) -> None:
    problem = Problem(robot.folder)
    follower = Straight(problem, 1.0 / RATE, {"steps": 2, "silent": 6})
    result = follower.record(robot.folder / "swing.npz", 1.0 / RATE, None)
    q = robot.motions["swing"].joint_positions
    np.testing.assert_array_equal(result["q"][0], robot.start)
    # The sixth step is the second one of the third frame: it stays where it was.
    assert np.flatnonzero(result["no_answer"]).tolist() == [2]
    np.testing.assert_allclose(result["q"][3], 0.5 * (q[2] + q[3]), atol=1e-12)
    others = [1, 2, *range(4, 20)]
    np.testing.assert_allclose(result["q"][others], q[others], atol=1e-12)
    np.testing.assert_allclose(follower.asked[0], 0.5 * (q[0] + q[1]), atol=1e-12)


def test_a_run_is_kept_until_anything_changes(robot, tmp_path) -> None:
    out = tmp_path / "one.npz"
    job = {"case": "swing", "period": 0.1, "settings": {"steps": 1}, "out": str(out)}
    job["keep"] = True
    assert not is_recorded(job, robot.folder)
    np.savez(out, made_of=made_of(job, robot.folder))
    assert is_recorded(job, robot.folder)
    assert not is_recorded(job | {"keep": False}, robot.folder)
    assert not is_recorded(job | {"settings": {"steps": 2}}, robot.folder)
    assert not is_recorded(job | {"period": 0.2}, robot.folder)
    other = tmp_path / "problem"
    shutil.copytree(robot.folder, other)
    assert is_recorded(job, other)
    case = dict(np.load(other / "swing.npz"))
    np.savez(other / "swing.npz", **(case | {"q_start": case["q_start"] + 1e-9}))
    assert not is_recorded(job, other)


def test_rows_tell_what_the_judge_finds(robot) -> None:
    clear = robot.motions["swing"]
    deep = replace(clear, joint_positions=reaching(20, RATE, 1.0))
    row = filters.row(clear, deep, robot.judge, "one", {"steps": 1}, 3, seconds=2.0)
    assert row.capsule_frames == len(robot.judge.judge(deep).capsule_frames) > 0
    off = deep.joint_positions - clear.joint_positions
    assert row.change.joints_rms == pytest.approx(np.sqrt(np.mean(off**2)))
    assert row.change.feet_worst > 0.01 and np.isnan(row.change.hands_rms)
    assert row.times_real_time == pytest.approx(19 / RATE / 2.0)
    calm = filters.row(clear, clear, robot.judge, "two", {"steps": 4})
    assert (calm.capsule_frames, calm.change.joints_rms) == (0, 0.0)
    # Fewer frames in penetration come first, and the less change.
    tried = [
        filters.Tried({"n": n}, clear, frames, change, 0, 1.0)
        for n, (frames, change) in enumerate([(2, 0.0), (0, 0.2), (0, 0.1), (5, 0.0)])
    ]
    assert filters.best(tried) is tried[2]
    tables, said = filters.tables_and_versions({"swing": [calm, row]}, {"numpy": "2.0"})
    assert f"| one | {row.capsule_frames} | " in tables[0].markdown()
    assert '| swing | one | `{"steps": 1}` |' in tables[1].markdown()
    assert "numpy 2.0" in said
