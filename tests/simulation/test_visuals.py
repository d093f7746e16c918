"""Robots without visual geometry: what is drawn of them, and what is left alone."""

import pytest
from pydrake.geometry import Role
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from small_robots import chain_urdf

from crar_drake.commands import main
from crar_drake.simulation.visuals import draw_collision_shapes, models_without_visuals

SEEN = chain_urdf("zz").replace("chain", "seen").replace(
    '<link name="base"/>',
    '<link name="base"><visual><geometry><sphere radius="0.1"/></geometry></visual>'
    "</link>",
)  # fmt: skip
GROUND = """<sdf version="1.7"><model name="ground"><link name="floor">
<collision name="plane"><geometry><plane><normal>0 0 1</normal></plane></geometry>
</collision></link></model></sdf>"""
EMPTY = '<robot name="empty"><link name="nothing"/></robot>'


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """The folder of a robot without visual geometry, and a scenario for it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(chain_urdf("zz"))
    (tmp_path / "robot.yaml").write_text(
        "model: arm.urdf\nbase: base\npairs: [[l1, post]]\n"
    )
    (tmp_path / "s.yaml").write_text(
        "robot: robot.yaml\ntasks: [{frame: tip}]\nkeyframes: "
        "{tip: [{time: 0, xyz: [0.5, 0, 0]}, {time: 0.05, xyz: [0.5, 0, 0]}]}\n"
    )
    return tmp_path


def test_only_models_that_nothing_is_seen_of_are_drawn_by_their_shapes():
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    for text in (chain_urdf("zz"), SEEN, EMPTY):
        Parser(plant).AddModelsFromString(text, "urdf")
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    before = inspector.NumGeometriesWithRole(Role.kIllustration)
    assert models_without_visuals(plant, inspector) == ["chain"]
    draw_collision_shapes(plant, scene_graph)
    shapes = [
        geometry
        for body in ("l0", "l1", "post")
        for geometry in plant.GetCollisionGeometriesForBody(
            plant.GetBodyByName(body, plant.GetModelInstanceByName("chain"))
        )
    ]
    assert len(shapes) == 3
    for geometry in shapes:
        assert inspector.GetIllustrationProperties(geometry) is not None
        assert inspector.GetPerceptionProperties(geometry) is not None
        assert inspector.GetProximityProperties(geometry) is not None
    assert inspector.NumGeometriesWithRole(Role.kIllustration) == before + 3
    # Now there is something to be seen.
    assert models_without_visuals(plant, inspector) == []
    builder.Build().CreateDefaultContext()


def test_a_plane_without_end_is_not_drawn():
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    Parser(plant).AddModelsFromString(GROUND, "sdf")
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    assert inspector.NumGeometriesWithRole(Role.kProximity) == 1
    draw_collision_shapes(plant, scene_graph)
    assert inspector.NumGeometriesWithRole(Role.kIllustration) == 0


def test_the_recording_draws_them_and_the_command_says_so(robot, capsys):
    assert main(["run", "s.yaml", "--out", "it"]) == 0
    told = "warning: model chain has no visual geometry: the recording draws its"
    assert told in capsys.readouterr().out
    assert main(["run", "s.yaml", "--out", "else", "--no-page"]) == 0
    assert "visual geometry" not in capsys.readouterr().out
    assert main(["show", "it/log.npz"]) == 0
    assert "no visual geometry: its collision shapes are drawn" in (
        capsys.readouterr().out
    )
