"""Watched pairs without dynamics: shapes, axes, the order of the pairs."""

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, QueryObject
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial import ConvexHull
from small_robots import CAPSULE, chain_urdf, make_model, random_state

from crar_drake.errors import ModelError
from crar_drake.robot.collision_pairs import shape_axis

BOX = '<box size="0.05 0.07 0.2"/>'
CYLINDER = '<cylinder radius="0.04" length="0.2"/>'


@pytest.mark.parametrize("shape", [Cylinder(0.3, 1.0), Ellipsoid(0.3, 0.2, 0.5)])
def test_what_is_round_is_within_a_hull_that_is_hardly_larger(shape):
    axis = shape_axis(shape, np.eye(4)[:3])
    assert axis.round
    faces = ConvexHull(axis.hull.corners).equations
    rng = np.random.default_rng(0)
    n = rng.normal(size=(2000, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    if isinstance(shape, Cylinder):
        angle = np.arctan2(n[:, 1], n[:, 0])
        rim = 0.3 * np.column_stack((np.cos(angle), np.sin(angle)))
        surface = np.column_stack((rim, 0.5 * np.sign(n[:, 2])))
    else:
        surface = [0.3, 0.2, 0.5] * n
    assert (surface @ faces[:, :3].T + faces[:, 3]).max() <= 1e-12
    reach = np.linalg.norm(axis.hull.corners, axis=1).max()
    assert reach < 1.15 * np.linalg.norm(surface, axis=1).max()


def test_a_box_is_the_hull_of_its_corners():
    X_BG = RigidTransform(RotationMatrix.MakeYRotation(0.3), [0.1, 0.2, 0.3])
    axis = shape_axis(Box(0.2, 0.4, 0.6), X_BG.GetAsMatrix34())
    np.testing.assert_allclose(axis.p_B0, [0.1, 0.2, 0.3])
    p_G = X_BG.inverse().multiply(axis.ends.T)
    np.testing.assert_allclose(np.abs(p_G.T), np.tile([0.1, 0.2, 0.3], (8, 1)))
    assert len({tuple(np.sign(p)) for p in p_G.T}) == 8
    assert axis.extent == pytest.approx(np.sqrt(0.14))
    # Of parallel faces and edges there is one.
    assert axis.hull.faces.shape == (3, 3) and axis.hull.edges.shape == (3, 2)


def sampled_distance(model, link_a, link_b, q, count=400) -> float:
    """Brute force over points on the axes of all capsules of two links."""
    plant = model.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    inspector = model.scene_graph.model_inspector()
    clouds = []
    for link in (link_a, link_b):
        body = plant.GetBodyByName(link)
        X_WB = plant.EvalBodyPoseInWorld(context, body)
        cloud = []
        for geometry in plant.GetCollisionGeometriesForBody(body):
            shape, X_BG = (
                inspector.GetShape(geometry),
                inspector.GetPoseInFrame(geometry),
            )
            half = 0.5 * shape.length() if isinstance(shape, Capsule) else 0.0
            z = np.linspace(-half, half, count)
            points = (X_WB @ X_BG).multiply(np.array([0 * z, 0 * z, z]))
            cloud.append((points.T, shape.radius()))
        clouds.append(cloud)
    return min(
        np.linalg.norm(a[:, None] - b[None], axis=2).min() - r_a - r_b
        for a, r_a in clouds[0]
        for b, r_b in clouds[1]
    )


def test_smallest_over_all_shape_pairs_in_the_order_given():
    """Links with one, three and five shapes mixed, against brute force."""
    urdf = chain_urdf("zyzy", shapes=(CAPSULE, '<sphere radius="0.06"/>', CAPSULE))
    pairs = [["post", "l3"], ["l3", "l0"], ["l0", "l2"], ["l2", "post"], ["l1", "l3"]]
    model = make_model(urdf, pairs=pairs)
    assert model.pairs.names == tuple(map(tuple, pairs)) and len(model.pairs) == 5
    for seed in range(4):
        q, v = random_state(model, seed)
        d = model.evaluate(model.MakeWorkspace(), q, v).d
        expected = [sampled_distance(model, a, b, q) for a, b in pairs]
        np.testing.assert_allclose(d, expected, atol=2e-4)


def test_the_order_within_a_pair_does_not_matter():
    """For closed forms and for SceneGraph, which has an order of its own."""
    for shapes in ((CAPSULE,), (BOX,), (CYLINDER,)):
        urdf = chain_urdf("zyzy", shapes=shapes)
        pairs = [["l0", "l2"], ["l3", "post"], ["l1", "l3"]]
        there = make_model(urdf, pairs=pairs)
        back = make_model(urdf, pairs=[pair[::-1] for pair in pairs])
        q, v = random_state(there, 3)
        a, b = (m.evaluate(m.MakeWorkspace(), q, v) for m in (there, back))
        np.testing.assert_allclose(a.d, b.d, atol=1e-6)
        np.testing.assert_allclose(a.dd_dq, b.dd_dq, atol=1e-4)


def test_shape_without_a_distance_is_refused(monkeypatch):
    """What SceneGraph has no distance of is said at construction."""

    def refuse(self, *arguments):
        raise RuntimeError("Signed distance queries are not supported")

    monkeypatch.setattr(
        QueryObject, "ComputeSignedDistancePairClosestPoints", refuse, raising=True
    )
    urdf = chain_urdf("zz", shapes=(CYLINDER,))
    with pytest.raises(ModelError, match="cannot compute.*not supported"):
        make_model(urdf, pairs=[["l1", "post"]])
