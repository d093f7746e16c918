"""A slide with two joints: an L on it and one that stands, whose distances are known.

The standing L fills x from 0 to 0.3 at z from 0 to 0.1, and z up to 0.3 at x up to 0.1.
The other one is turned upside down; at q = (0, 0) both reach past each other, 0.02
apart, while their hulls overlap by 0.03 / sqrt(2).
"""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from small_logs import small_log
from small_urdfs import joint, link, robot, write

from crar_drake.commands import main
from crar_drake.errors import ModelError
from crar_drake.judging.mesh_judge import MeshJudge
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.joints import names_by_joint
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import position_tasks
from crar_drake.robot_import.link_meshes import read_link_meshes

LIMITS = 'lower="-1" upper="1" effort="9" velocity="9"'
YAML = """
name: hooks
model: hooks.urdf
task_frames: {tool: hook}
pairs: [[stand, hook]]
"""
SCENARIO = """
robot: ROBOT
tasks: [{frame: tool}]
keyframes: {tool: [{time: 0, xyz: [0, 0, 0]}, {time: 1, xyz: [0, 0, 0]}]}
controller: {constraints: none, period: 0.01}
"""


def hook() -> trimesh.Trimesh:
    """An L of two boxes, 0.1 thick, as one file may have it: two closed pieces."""
    foot = trimesh.creation.box(bounds=[(0, 0, 0), (0.3, 0.1, 0.1)])
    upright = trimesh.creation.box(bounds=[(0, 0, 0), (0.1, 0.1, 0.3)])
    return trimesh.util.concatenate([foot, upright])


def ball(name: str, z: float) -> str:
    """A collision shape that is never near another."""
    return (
        f'<collision name="{name}"><origin xyz="0 9 {z}"/>'
        '<geometry><sphere radius="0.1"/></geometry></collision></link>'
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A robot of two slides, with meshes; the carriage between them has no shape."""
    hook().export(tmp_path / "hook.obj")
    mesh = '<mesh filename="hook.obj"/>'
    stand = link("stand", mesh, mass=0.0).replace("</link>", ball("s", 0.0))
    moving = link("hook", mesh).replace("</link>", ball("h", 5.0))
    actuators = [
        f'<transmission name="{name}_drive"><type>SimpleTransmission</type>'
        f'<joint name="{name}"/><actuator name="{name}"/></transmission>'
        for name in ("slide", "lift")
    ]
    parts = [
        '<link name="world"/>',
        stand,
        joint("stands", "world", "stand", kind="fixed"),
        link("carriage"),
        joint(
            "slide",
            "stand",
            "carriage",
            "1 0 0",
            "0.42 0 0.35",
            "prismatic",
            "",
            LIMITS,
        ),
        moving,
        joint("lift", "carriage", "hook", "0 0 -1", "0 0 0", "prismatic", "", LIMITS),
        *actuators,
    ]
    text = robot(parts, "hooks").replace(
        '<child link="hook"/><origin xyz="0 0 0"/>',
        f'<child link="hook"/><origin xyz="0 0 0" rpy="0 {np.pi} 0"/>',
    )
    write(tmp_path, text, "hooks.urdf")
    (tmp_path / "robot.yaml").write_text(YAML)
    return tmp_path


def log_of(folder: Path, q: np.ndarray):
    """A log of the robot in the folder with these positions, every 10 ms."""
    description = load_robot_description(folder)
    model = ControlModel.FromDescription(description, position_tasks(["tool"]))
    size = len(q)
    return replace(
        small_log(),
        time=0.01 * np.arange(size),
        q=np.asarray(q, dtype=float),
        v=np.zeros((size, 2)),
        actuation=np.zeros((size, 2)),
        desired_acceleration=np.zeros((size, 2)),
        desired_tasks=np.zeros((size, 9)),
        task_error=np.zeros((size, 3)),
        signed_distances=np.ones((size, 1)),
        constraint_weights=np.ones((size, 2)),
        status=np.zeros((size, 1)),
        admission=np.full((size, 4), np.nan),
        balance=np.full((size, 3), np.nan),
        obstacles=np.empty((size, 0)),
        torque_limit=np.tile([1.0, 0.0], (size, 1)),
        position_names=np.array(names_by_joint(model.plant)),
        velocity_names=np.array(names_by_joint(model.plant)),
        actuator_names=np.array(["slide", "lift"]),
        controlled_names=np.array(["slide", "lift"]),
        task_names=np.array(["tool"]),
        task_kinds=np.array(["position"]),
        pair_names=np.array(["stand - hook"]),
        lower=-np.ones(2),
        upper=np.ones(2),
        velocity_limits=np.full(2, 9.0),
        effort_limits=np.full(2, np.inf),
        scenario=SCENARIO.replace("ROBOT", str(folder)),
    )


def test_meshes_at_rest(folder):
    judge = MeshJudge(load_robot_description(folder))
    assert judge.pairs == [("stand", "hook")] and judge.left_out == []
    assert judge.open_links == [], "two closed pieces that share edges are closed"
    assert judge.distances(np.zeros(2)) == pytest.approx([0.02], abs=1e-6)


def test_a_trajectory(folder):
    """0.01 nearer, then 0.02 beyond contact, then far away."""
    q = np.array([[0, 0], [-0.01, 0], [-0.04, 0], [0.5, 0], [0.9, 0]], float)
    verdict = MeshJudge(load_robot_description(folder)).judge(q)
    assert len(verdict.frames) == 5 and verdict.num_pairs == 1
    assert verdict.num_penetrating == 1
    assert verdict.nearest.pair == ("stand", "hook") and verdict.nearest.index == 2
    assert verdict.nearest.distance == pytest.approx(-0.02, abs=2e-5)
    (penetration,) = verdict.penetrations
    assert penetration.frames == [2] and penetration.frame == 2


def test_the_same_as_asking_for_every_pair(folder):
    """What is not asked for, since it cannot be nearer, is not."""
    judge = MeshJudge(load_robot_description(folder))
    t = np.linspace(0.0, 20.0, 200)
    q = np.column_stack([0.12 * np.sin(t), 0.1 * np.sin(2.3 * t)])
    verdict = judge.judge(q)
    meshes = np.array([judge.distances(each) for each in q])[:, 0]
    assert 0 < verdict.num_penetrating == (meshes < 0.0).sum()
    assert verdict.nearest.distance == meshes.min()
    assert verdict.nearest.index == meshes.argmin()


def test_the_same_as_asking_for_all_of_many_pairs(tmp_path, monkeypatch):
    """Rods side by side, each turning on the one before: the balls around them always
    meet, but pairs that moved too little to be near now are not asked."""
    parts = []
    for i in range(6):
        parts.append(link(f"l{i}", '<box size="0.8 0.02 0.02"/>'))
        if i:
            parts.append(joint(f"j{i}", f"l{i - 1}", f"l{i}", xyz="0 0.06 0"))
    write(tmp_path, robot(parts, "rods"), "rods.urdf")
    (tmp_path / "robot.yaml").write_text("name: rods\nmodel: rods.urdf\nbase: l0\n")
    judge = MeshJudge(load_robot_description(tmp_path))
    t = np.linspace(0.0, 3.0, 120)
    q = 0.15 * np.sin(np.outer(t, [1.0, 1.3, 0.9, 1.1, 0.8]))
    meshes = np.array([judge.distances(each) for each in q])
    asked, ask = [], judge._hulls_apart
    monkeypatch.setattr(judge, "_hulls_apart", lambda *at: asked.append(at) or ask(*at))
    verdict = judge.judge(q)
    assert len(judge.pairs) == 10 and len(asked) < 0.5 * meshes.size
    assert 0 < verdict.num_penetrating == (meshes < 0.0).any(axis=1).sum() < 120
    assert verdict.nearest.distance == meshes.min()
    deepest = {judge.pairs[i]: d for i, d in enumerate(meshes.min(axis=0)) if d < 0.0}
    assert {c.pair: -c.depth for c in verdict.penetrations} == deepest


def test_pairs_that_meet_as_they_are_built_are_left_out(folder):
    """In the zero and in the rest posture; in one of them they are judged."""
    urdf = folder / "hooks.urdf"
    text = urdf.read_text()
    urdf.write_text(text.replace("0.42 0 0.35", "0.35 0 0.35"))
    judge = MeshJudge(load_robot_description(folder))
    assert judge.left_out == [("stand", "hook")] and judge.pairs == []
    verdict = judge.judge(np.zeros((2, 2)))
    assert verdict.num_penetrating == 0 and verdict.nearest.pair is None
    (folder / "robot.yaml").write_text(YAML + "rest_posture: {slide: 0.5}\n")
    judge = MeshJudge(load_robot_description(folder))
    assert judge.left_out == [] and judge.pairs == [("stand", "hook")]


def test_links_one_joint_apart_are_not_judged(folder):
    urdf = folder / "hooks.urdf"
    urdf.write_text(
        urdf.read_text().replace('"lift" type="prismatic"', '"lift" type="fixed"')
    )
    assert MeshJudge(load_robot_description(folder)).pairs == []


def judged(capsys, folder: Path, q: list, *options: str, **changes) -> tuple[int, str]:
    log = replace(log_of(folder, np.array(q, float)), **changes)
    log.save(folder / "log.npz")
    code = main(["judge", str(folder / "log.npz"), *options])
    return code, capsys.readouterr().out


def test_judging_a_log(folder, capsys):
    q = [[0, 0], [-0.01, 0], [-0.02 + 0.005, 0], [0.5, 0]]
    code, told = judged(capsys, folder, q, "--every", "0.01")
    assert code == 0
    assert (
        "real meshes, triangles, 4 samples, 1 pair of links more than one joint "
        "apart: 0 in penetration, smallest distance 5.0 mm (stand - hook) at 0.020 s\n"
    ) in told
    code, told = judged(capsys, folder, q, "--no-meshes")
    assert code == 0 and "meshes" not in told


def test_judging_a_log_with_a_penetration(folder, capsys):
    code, told = judged(capsys, folder, [[0, 0], [-0.05, 0]], "--every", "0.01")
    assert "1 in penetration, smallest distance -30.0 mm (stand - hook)" in told
    assert "a shift of 30.0 mm would part them" in told
    assert code == 1 and told.endswith(
        "\nVIOLATED: 1 sample with meshes that penetrate\n"
    )


def test_robots_of_primitives_are_judged_by_these_alone(folder, capsys):
    urdf = folder / "hooks.urdf"
    text = urdf.read_text().replace(
        '<mesh filename="hook.obj"/>', '<box size="1 1 1"/>'
    )
    urdf.write_text(text)
    code, told = judged(capsys, folder, [[0, 0]])
    assert code == 0 and told.count("\n") == 2 and told.endswith("\nOK\n")
    assert "collision shapes" in told


@pytest.mark.parametrize(
    "content", [None, "v 0 0 nonsense\nf 1 2 3\n", "", "v 0 0 0\n"]
)
def test_a_mesh_that_cannot_be_read(folder, capsys, content):
    log_of(folder, np.zeros((2, 2))).save(folder / "log.npz")
    mesh = folder / "hook.obj"
    mesh.unlink()
    if content is not None:
        mesh.write_text(content)
    assert main(["judge", str(folder / "log.npz")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "hook.obj" in error


def test_all_triangles_of_an_imported_robot(imported, tmp_path):
    """Not those that are drawn; one that went missing is named."""
    folder = tmp_path / "it"
    shutil.copytree(imported.folder, folder)
    file = folder / "triangles" / "torso_0.obj"
    assert file.is_file()
    description = load_robot_description(folder)
    MeshJudge(description)
    file.unlink()
    with pytest.raises(ModelError, match="'torso'.*triangles/torso_0.obj is not there"):
        MeshJudge(description)


def test_an_ellipsoid_is_judged_by_its_own_shape():
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    text = (
        '<robot name="egg"><link name="egg"><visual><geometry>'
        '<drake:ellipsoid a="0.1" b="0.2" c="0.3"/></geometry></visual></link></robot>'
    )
    Parser(plant).AddModelsFromString(text, "urdf")
    plant.Finalize()
    (egg,) = read_link_meshes(plant, scene_graph)
    (part,) = egg.parts
    mesh = trimesh.Trimesh(part.vertices, part.faces)
    assert mesh.extents == pytest.approx([0.2, 0.4, 0.6], rel=0.01)
    assert mesh.volume == pytest.approx(np.pi * 4 / 3 * 0.006, rel=0.02)
