"""What is drawn while a diagram runs: the overlay and its warning shells."""

import numpy as np
import pytest
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    Sphere,
)
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from spy_meshcat import SpyMeshcat

from crar_drake.errors import CrarError
from crar_drake.robot.description import add_robot, load_robot_description
from crar_drake.simulation.scenario import Scenario
from crar_drake.simulation.visualization import (
    AddPlaybackOverlay,
    AddVisualization,
    inflated,
)

LEFT, RIGHT = (
    f"/drake/illustration/upper_body/{side}_hand/near" for side in ("left", "right")
)


@pytest.fixture(scope="module")
def meshcat() -> SpyMeshcat:
    return SpyMeshcat()


def test_shells_follow_the_distance(meshcat):
    """And survive the visualiser's start, twice."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1.0 / 128)
    add_robot(plant, load_robot_description("upper_body"))
    plant.Finalize()
    overlay = AddVisualization(
        builder,
        Scenario().visualization,
        meshcat,
        plant,
        scene_graph,
        [("left_hand", "right_hand"), ("left_hand", "torso")],
        ["left_wrist"],
    )
    # The hands come nearer than 20 mm after 0.1 s; the torso stays far.
    distance = PiecewisePolynomial.FirstOrderHold([0, 0.2], [[0.04, 0.0], [0.5, 0.5]])
    for trajectory, port in (
        (distance, overlay.get_input_port_signed_distances()),
        (PiecewisePolynomial(np.ones(3)), overlay.get_input_port_target_positions()),
    ):
        source = builder.AddSystem(TrajectorySource(trajectory))
        builder.Connect(source.get_output_port(), port)
    simulator = Simulator(builder.Build())
    for _ in range(2):
        meshcat.forget()
        simulator.get_mutable_context().SetTime(0.0)
        simulator.Initialize()
        assert meshcat.HasPath(LEFT) and meshcat.HasPath(RIGHT)
        simulator.AdvanceTo(0.25)
        # 0.1 s is between frames 3 and 4.
        assert [e for e in meshcat.visibility if e[1]] == [
            (LEFT, True, 4 / 32), (RIGHT, True, 4 / 32)
        ]  # fmt: skip
        assert sum(not value for _, value, _ in meshcat.visibility) == 3


def test_overlay_needs_the_visualiser_first(meshcat):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    plant.Finalize()
    with pytest.raises(CrarError, match="before AddPlaybackOverlay"):
        AddPlaybackOverlay(builder, meshcat, plant, scene_graph, [], [], 1.0 / 32.0)


def test_shells_are_larger_on_every_side():
    assert inflated(Sphere(0.1), 0.01).radius() == pytest.approx(0.11)
    capsule = inflated(Capsule(0.1, 0.3), 0.01)
    assert (capsule.radius(), capsule.length()) == pytest.approx((0.11, 0.3))
    cylinder = inflated(Cylinder(0.1, 0.3), 0.01)
    assert (cylinder.radius(), cylinder.length()) == pytest.approx((0.11, 0.32))
    np.testing.assert_allclose(inflated(Box(1, 2, 3), 0.01).size(), [1.02, 2.02, 3.02])
    ellipsoid = inflated(Ellipsoid(0.1, 0.2, 0.3), 0.01)
    assert (ellipsoid.a(), ellipsoid.b(), ellipsoid.c()) == pytest.approx(
        (0.11, 0.21, 0.31)
    )
    assert inflated(Convex(np.eye(3, 4), "tetrahedron"), 0.01) is None
