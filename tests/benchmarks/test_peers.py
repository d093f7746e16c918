"""The problem and the judging of benchmarks/peers, without the peers."""

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from pydrake.geometry import Sphere
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from crar_drake import ControlModel, load_robot_description, position_tasks
from crar_drake.judging.referee import Referee

FILES = ("robot.urdf", "robot_mujoco.xml", "robot_pinocchio.urdf")


@pytest.fixture(scope="module")
def example() -> dict[str, ModuleType]:
    """The modules of benchmarks.peers, by their names."""
    names = (
        "motions",
        "robot_files",
        "problem",
        "driver",
        "judge",
        "tuning",
        "report",
        "peers",
        "run_crar",
    )
    return {name: importlib.import_module(f"benchmarks.peers.{name}") for name in names}


@pytest.fixture(scope="module")
def folder(example, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("peers")
    example["problem"].write_problem(path)
    return path


@pytest.fixture(scope="module")
def judge(example, folder):
    data = json.loads((folder / "problem.json").read_text())
    return example["judge"].Judge(data["robot"], data["joints"], data["tasks"])


def load(path: Path) -> tuple[MultibodyPlant, dict[str, list]]:
    """A plant of a robot's file, and each link's shapes: (shape, X_BG)."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    Parser(plant).AddModels(str(path))
    if plant.GetBodyByName("base") not in plant.GetBodiesWeldedTo(plant.world_body()):
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    shapes = {
        plant.get_body(index).name(): [
            (inspector.GetShape(g), inspector.GetPoseInFrame(g))
            for g in plant.GetCollisionGeometriesForBody(plant.get_body(index))
        ]
        for index in plant.GetBodyIndices(plant.GetModelInstanceByName("upper_body"))
    }
    return plant, shapes


def axis_ends(shape, X_BG) -> np.ndarray:
    """The ends of a capsule's axis in its link, in a fixed order, and its radius."""
    half = shape.length() / 2.0 if not isinstance(shape, Sphere) else 0.0
    ends = [X_BG.multiply(np.array([0.0, 0.0, z])) for z in (-half, half)]
    ends = sorted(np.round(ends, 9).tolist())
    return np.array([*ends[0], *ends[1], shape.radius()])


@pytest.mark.parametrize("name", FILES)
def test_every_dialect_is_the_shipped_robot(name: str, folder: Path) -> None:
    """Poses of all links, masses, limits and shapes against the shipped URDF."""
    shipped = load_robot_description("upper_body")
    reference = ControlModel.FromDescription(shipped, position_tasks(["left_wrist"]))
    data = json.loads((folder / "problem.json").read_text())
    plant, shapes = load(folder / name)
    rng = np.random.default_rng(3)
    context, wanted_context = plant.CreateDefaultContext(), None
    wanted_context = reference.plant.CreateDefaultContext()
    for _ in range(5):
        q = rng.uniform(-1.0, 1.0, len(data["joints"]))
        q_wanted = reference.rest_positions()
        for joint, angle in zip(data["joints"], q, strict=True):
            plant.GetJointByName(joint).set_angle(context, angle)
            q_wanted[reference.position_names.index(joint)] = angle
        reference.plant.SetPositions(wanted_context, q_wanted)
        for link in {link for pair in data["pairs"] for link in pair} | set(
            data["task_links"]
        ):
            X_WB = plant.GetBodyByName(link).EvalPoseInWorld(context)
            X_WB_wanted = reference.plant.GetBodyByName(link).EvalPoseInWorld(
                wanted_context
            )
            assert X_WB.IsNearlyEqualTo(X_WB_wanted, 1e-8), link
    assert plant.CalcTotalMass(context) == pytest.approx(
        reference.plant.CalcTotalMass(wanted_context), rel=1e-9
    )
    for joint, lower, upper in zip(
        data["joints"], data["lower"], data["upper"], strict=True
    ):
        found = plant.GetJointByName(joint)
        if lower is None:
            assert found.position_lower_limits()[0] <= -100.0
        else:
            assert found.position_lower_limits()[0] == pytest.approx(lower)
            assert found.position_upper_limits()[0] == pytest.approx(upper)
    _, wanted_shapes = load(folder / "robot.urdf")
    for link, own in shapes.items():
        wanted = sorted(axis_ends(*one).tolist() for one in wanted_shapes[link])
        found = sorted(axis_ends(*one).tolist() for one in own)
        np.testing.assert_allclose(found, wanted, atol=1e-8, err_msg=link)


def test_the_motion_is_as_the_page_says(folder: Path, judge) -> None:
    """Followed, it penetrates by about 10 cm, and starts where the cases say."""
    shipped = load_robot_description("upper_body")
    model = judge.model
    referee = Referee(model.plant, model.scene_graph, shipped.pairs)
    crossing = np.load(folder / "crossing.npz")
    found = referee.violations(judge.whole(crossing["q_reference"][::10]))
    assert -0.105 < found.smallest_distance < -0.095
    assert np.degrees(found.largest_limit_excess) == pytest.approx(2.9, abs=0.1)
    assert referee.distances(judge.whole(crossing["q_start"][None])[0]).min() > 0.05
    inside = np.load(folder / "start_inside.npz")
    start = referee.distances(judge.whole(inside["q_start"][None])[0])
    assert start.min() == pytest.approx(-0.015, abs=1e-6)
    held = np.load(folder / "target_inside.npz")
    end = referee.distances(judge.whole(held["q_reference"][-1:])[0])
    assert end.min() < -0.05
    for case in (crossing, inside, held):
        assert not case["v"][0].any() and not case["a"][0].any()


@pytest.mark.slow
def test_the_lookahead_end_to_end(example, folder: Path, judge, tmp_path) -> None:
    """The driver of this project, on a short stretch."""
    problem = example["driver"].Problem(folder)
    controller = example["run_crar"].Crar(problem, 0.005, {})
    result = controller.record(folder / "crossing.npz", 0.005, 1.8)
    found = judge.figures(result)
    assert found.holds and found.smallest_distance > 0.0
    assert result["q"].shape == (361, 11)


def test_settings_and_pins_are_complete(example) -> None:
    """Every peer has tuned settings of its own grid, and pinned packages."""
    peers = example["peers"]
    settings = example["tuning"].load_settings()
    for peer in peers.PEERS:
        assert importlib.util.find_spec(f"benchmarks.peers.{peer.driver}")
        assert peer.environment in peers.ENVIRONMENTS
        for case, chosen in settings[peer.name].items():
            assert case in example["problem"].CASES
            assert chosen["settings"] in peer.grid, (peer.name, case)
            assert chosen["tried"] == len(peer.grid)
    for requirements in peers.ENVIRONMENTS.values():
        assert all("==" in requirement for requirement in requirements)
