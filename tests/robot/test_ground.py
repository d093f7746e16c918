"""The ground as a half space: distances, gradients, what stands on it, who judges."""

from dataclasses import replace

import numpy as np
import pytest
from grounded_robots import SPHERE, add_ground, grounded
from pydrake.geometry import Box, Capsule, HalfSpace
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder
from small_robots import CAPSULE, add_plant, chain_urdf, random_state

from crar_drake.drake_warnings import collected_warnings
from crar_drake.errors import ModelError
from crar_drake.judging.referee import Referee
from crar_drake.robot.collision_pairs import WatchedPairs
from crar_drake.robot.description import (
    add_robot,
    load_robot_description,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

BOX = '<box size="0.05 0.07 0.2"/>'
SLOPE = RigidTransform(RollPitchYaw(0.4, -0.7, 0.2), [0.1, 0.2, -0.3])
PAIRS = [["l1", "ground"], ["ground", "l2"], ["l3", "l0"]]


def height_of_cloud(model: ControlModel, link: str, q: np.ndarray) -> float:
    """How high a link is above the slope, by many points of its shapes."""
    plant = model.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    inspector = model.scene_graph.model_inspector()
    body = plant.GetBodyByName(link)
    X_GB = SLOPE.inverse() @ plant.EvalBodyPoseInWorld(context, body)
    lowest = np.inf
    for geometry in plant.GetCollisionGeometriesForBody(body):
        shape, X = inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry)
        if isinstance(shape, Box):
            half, radius = 0.5 * shape.size(), 0.0
        else:
            length = shape.length() if isinstance(shape, Capsule) else 0.0
            half, radius = np.array([0.0, 0.0, 0.5 * length]), shape.radius()
        grid = np.linspace(-1.0, 1.0, 9)
        points = np.array(np.meshgrid(grid, grid, grid)).reshape(3, -1)
        on = (X_GB @ X).multiply(half[:, np.newaxis] * points)
        lowest = min(lowest, on[2].min() - radius)
    return lowest


@pytest.mark.parametrize("shapes", [(CAPSULE,), (SPHERE, CAPSULE), (BOX, SPHERE)])
def test_the_height_is_that_of_the_lowest_point(shapes) -> None:
    """Against a cloud of points, and the gradient against central differences."""
    model = grounded(chain_urdf("zyzy", shapes=shapes), SLOPE, pairs=PAIRS)
    assert model.pairs.names == tuple(map(tuple, PAIRS))
    workspace, step = model.MakeWorkspace(), 1e-6
    for seed in range(5):
        q, v = random_state(model, seed)
        state = model.evaluate(workspace, q, v)
        for pair, link in ((0, "l1"), (1, "l2")):
            assert state.d[pair] == pytest.approx(
                height_of_cloud(model, link, q), abs=1e-12
            )
        for j in range(model.n):
            sides = [
                model.signed_distances(q + k * step * np.eye(model.n)[j])
                for k in (-1.0, 1.0)
            ]
            slope = (sides[1] - sides[0]) / (2.0 * step)
            np.testing.assert_allclose(state.dd_dq[:2, j], slope[:2], atol=1e-7)


def test_scene_graph_has_no_other_opinion_of_a_spheres_height() -> None:
    model = grounded(chain_urdf("zyzy", shapes=(SPHERE,)), SLOPE, pairs=PAIRS[:2])
    context = model.diagram.CreateDefaultContext()
    q, v = random_state(model, 5)
    model.plant.SetPositions(model.plant.GetMyMutableContextFromRoot(context), q)
    query = model.scene_graph.get_query_output_port().Eval(
        model.scene_graph.GetMyContextFromRoot(context)
    )
    bodies = (model.plant.GetBodyByName("l1"), model.plant.world_body())
    ids = [model.plant.GetCollisionGeometriesForBody(body)[0] for body in bodies]
    d = query.ComputeSignedDistancePairClosestPoints(*ids).distance
    found = model.evaluate(model.MakeWorkspace(), q, v).d[0]
    assert found == pytest.approx(d, abs=1e-12)


def test_the_referee_knows_the_ground() -> None:
    """All three ways of asking it, against the cloud."""
    urdf = chain_urdf("zyzy", shapes=(CAPSULE, SPHERE))
    model = grounded(urdf, SLOPE, pairs=PAIRS)
    referee = Referee(model.plant, model.scene_graph, PAIRS)
    for seed in range(5):
        q, _ = random_state(model, seed)
        heights = [height_of_cloud(model, link, q) for link in ("l1", "l2")]
        d = referee.distances(q)
        np.testing.assert_allclose(d[:2], heights, atol=1e-12)
        nearest, pair = referee.nearest(q)
        assert nearest == d.min() and list(pair) == PAIRS[int(d.argmin())]
        below = referee.distances_below(q, d.min() + 1e-6)
        assert below[int(d.argmin())] == d.min()


def test_a_description_brings_the_ground() -> None:
    """As one of the world's own shapes."""
    shipped = load_robot_description("upper_body")
    described = replace(shipped, ground=-0.1, pairs=[["left_hand", "ground"]])
    described.validate()
    model = ControlModel.FromDescription(described, [Task(frame="left_wrist")])
    q = model.rest_positions()
    d = model.evaluate(model.MakeWorkspace(), q, np.zeros(len(q))).d
    without = ControlModel.FromDescription(shipped, [Task(frame="left_wrist")])
    p = without.layout.unpack(without.tasks_at(q)).p
    assert 0.0 < d[0] - 0.1 < p[0, 2]

    # Two robots have one each; a link of that name would be another thing.
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    add_robot(plant, described)
    add_robot(plant, replace(load_robot_description("obstacle_arm"), ground=-0.2))
    assert len(plant.GetCollisionGeometriesForBody(plant.world_body())) == 2
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    plant.AddRigidBody("ground", plant.AddModelInstance("park"))
    with pytest.raises(ModelError, match="there is a link 'ground' already; leave"):
        add_robot(plant, described)


def test_a_cylinder_stands_on_a_slope_by_the_hull_about_it() -> None:
    urdf = chain_urdf("zy", shapes=('<cylinder radius="0.05" length="0.2"/>',))
    model = grounded(urdf, SLOPE, pairs=[["l1", "ground"]])
    capsule = chain_urdf("zy", shapes=('<cylinder radius="0.049" length="0.196"/>',))
    smaller = grounded(capsule, SLOPE, pairs=[["l1", "ground"]])
    q = model.rest_positions()
    d, more = (each.signed_distances(q)[0] for each in (model, smaller))
    assert d < more < d + 0.005


def test_a_half_space_on_a_link_is_refused() -> None:
    """Welded or not: for Drake's collision engine it is one of the moving shapes."""
    for link in ("l0", "post"):
        plant, scene_graph = add_plant(
            DiagramBuilder(), chain_urdf("zy"), finalize=False
        )
        plant.RegisterCollisionGeometry(
            plant.GetBodyByName(link),
            RigidTransform(),
            HalfSpace(),
            "flat",
            CoulombFriction(1.0, 1.0),
        )
        plant.Finalize()
        pairs = [(plant.GetBodyByName("l1"), plant.GetBodyByName(link))]
        with pytest.raises(
            ModelError, match=f"{link!r} carries a half space: register"
        ):
            WatchedPairs(plant, scene_graph.model_inspector(), pairs)


def test_drake_says_nothing_of_a_ground(capsys) -> None:
    """It warns of soft bodies, which no robot here has."""
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    with collected_warnings():
        add_ground(plant, RigidTransform())
        plant.Finalize()
    assert not capsys.readouterr().err
