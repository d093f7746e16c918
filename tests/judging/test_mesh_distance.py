"""Distances of meshes against closed forms, and against points sampled on them."""

import numpy as np
import pytest
import trimesh
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.spatial import ConvexHull, KDTree

from crar_drake.judging.mesh_distance import (
    TriangleMesh,
    mesh_distance,
    meshes_meet,
    penetration_depth,
)


def mesh(solid: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(solid.vertices, solid.faces)


def box(*edges: float, at=(0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    return trimesh.creation.box(edges, trimesh.transformations.translation_matrix(at))


def l_shape() -> TriangleMesh:
    """Of boxes from 0 to 0.3 along x and along z, 0.1 thick, as one closed surface."""
    profile = [(0.0, 0.0), (0.3, 0.0), (0.3, 0.1), (0.1, 0.1), (0.1, 0.3), (0.0, 0.3)]
    points = np.array([(x, y, z) for y in (0.0, 0.1) for x, z in profile])
    n = len(profile)
    sides = [(i, (i + 1) % n) for i in range(n)]
    faces = [f for i, j in sides for f in ((i, i + n, j + n), (i, j + n, j))]
    front = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    back = [(a + n, c + n, b + n) for a, b, c in front]
    return TriangleMesh(points, np.array([*faces, *front, *back]))


# Half a turn about y.
TURNED = RollPitchYaw(0.0, np.pi, 0.0)


def test_interlocked_ls_are_apart_though_their_hulls_overlap():
    """Each one's foot reaches past the other's, 0.02 from the upright."""
    shape = l_shape()
    assert shape.is_closed
    # The turned one fills x from 0.12 to 0.42 at z from 0.25 to 0.35, and x from 0.32
    # to 0.42 at z from 0.05 to 0.35.
    X = RigidTransform(TURNED, [0.42, 0.0, 0.35])
    turned = shape.vertices @ X.rotation().matrix().T + X.translation()
    # Between the hulls' slanted faces: x + z <= 0.4 here, and >= 0.77 - 0.4 there.
    assert (turned[:, [0, 2]].sum(axis=1) > 0.369).all()
    assert (turned[:, [0, 2]].sum(axis=1) < 0.4).any()
    assert mesh_distance(shape, shape, X) == pytest.approx(0.02, abs=1e-9)
    # 0.03 farther left they are 0.01 within each other.
    X = RigidTransform(TURNED, [0.39, 0.0, 0.35])
    assert mesh_distance(shape, shape, X) == pytest.approx(-0.01, abs=2e-5)


def test_a_foot_in_the_corner_of_an_l():
    """A box in the notch is inside the hull of the L, and 0.01 from its two walls."""
    cube = mesh(box(0.06, 0.06, 0.06))
    at = np.array([0.1 + 0.01 + 0.03, 0.05, 0.1 + 0.02 + 0.03])
    hull = ConvexHull(l_shape().vertices).equations
    corners = cube.vertices + at
    assert (hull[:, :3] @ corners.T + hull[:, 3:] < 0.0).all(), "all within the hull"
    assert mesh_distance(l_shape(), cube, RigidTransform(at)) == pytest.approx(0.01)
    assert mesh_distance(cube, l_shape(), RigidTransform(-at)) == pytest.approx(0.01)


@pytest.mark.parametrize("depth", [0.0005, 0.02, 0.099])
@pytest.mark.parametrize("side", [(0.0, 0.0), (0.013, -0.027)])
def test_two_cubes_that_overlap(depth, side):
    a, b = mesh(box(0.1, 0.1, 0.1)), mesh(box(0.2, 0.2, 0.2))
    X = RigidTransform([0.15 - depth, *side])
    turn = RigidTransform(RollPitchYaw(0.3, -0.8, 1.1), [0.5, 0.2, -0.4])
    assert meshes_meet(a, b, X)
    assert mesh_distance(a, b, X) == pytest.approx(-depth, abs=2e-5)
    # The same in another frame.
    a_turned = TriangleMesh(
        a.vertices @ turn.rotation().matrix().T + turn.translation(), a.faces
    )
    assert mesh_distance(a_turned, b, turn @ X) == pytest.approx(-depth, abs=2e-5)


def test_a_cube_inside_another_is_in_penetration():
    """No triangles meet; out of a cube of 1 m, one of 0.2 m has to go by 0.6 m."""
    small, large = mesh(box(0.2, 0.2, 0.2)), mesh(box(1.0, 1.0, 1.0))
    for a, b in ((small, large), (large, small)):
        assert meshes_meet(a, b, RigidTransform())
        assert mesh_distance(a, b, RigidTransform()) == pytest.approx(-0.6, abs=2e-5)
        off = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.1, -0.2, 0.05])
        assert mesh_distance(a, b, off) < -0.4
    assert mesh_distance(small, large, RigidTransform([0.7, 0, 0])) == pytest.approx(
        0.1
    )


def test_a_ball_in_a_hollow_one_is_apart():
    outer, inner = (trimesh.creation.icosphere(3, radius=r) for r in (0.5, 0.4))
    inner.invert()  # its triangles face the cavity
    shell = mesh(trimesh.util.concatenate([outer, inner]))
    ball = mesh(trimesh.creation.icosphere(3, radius=0.1))
    assert shell.is_closed and len(shell.one_vertex_each) == 2
    assert 0.29 < mesh_distance(shell, ball, RigidTransform()) < 0.3
    assert mesh_distance(shell, ball, RigidTransform([0.32, 0, 0])) < 0.0


def test_a_second_piece_inside_counts():
    """The nearest triangles are of the piece outside; the other one is swallowed."""
    large = mesh(box(1.0, 1.0, 1.0))
    two = mesh(
        trimesh.util.concatenate(
            [box(0.1, 0.1, 0.1, at=(0.56, 0, 0)), box(0.1, 0.1, 0.1)]
        )
    )
    assert len(two.one_vertex_each) == 2
    assert meshes_meet(large, two, RigidTransform())
    assert mesh_distance(large, two, RigidTransform()) < -0.5


def test_inside_of_a_surface_with_a_hole():
    """It winds more than half around what is deep inside, less around what is not."""
    solid = trimesh.creation.icosphere(3, radius=0.5)
    solid.update_faces(solid.triangles_center[:, 2] < 0.45)
    open_ball, ball = mesh(solid), mesh(trimesh.creation.icosphere(2, radius=0.05))
    assert not open_ball.is_closed
    assert mesh_distance(open_ball, ball, RigidTransform()) < 0.0
    assert mesh_distance(open_ball, ball, RigidTransform([0, 0, 0.6])) > 0.0


def test_winding_numbers_of_a_closed_surface():
    solid = mesh(trimesh.creation.icosphere(2, radius=1.0))
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (50, 3))
    r = np.linalg.norm(points, axis=1)
    points, r = points[abs(r - 1.0) > 0.1], r[abs(r - 1.0) > 0.1]
    assert solid.winding_numbers(points) == pytest.approx((r < 1.0) * 1.0, abs=1e-9)


def test_distances_against_sampled_points():
    """Of two rings, whose hulls are far from them."""
    ring = trimesh.creation.torus(0.2, 0.04, 48, 24)
    points = trimesh.sample.sample_surface(ring, 3000, seed=1)[0]
    tree, rng, seen = KDTree(points), np.random.default_rng(2), 0
    for _ in range(20):
        X = RigidTransform(
            RollPitchYaw(*rng.uniform(-3, 3, 3)), rng.uniform(-0.3, 0.3, 3)
        )
        moved = points @ X.rotation().matrix().T + X.translation()
        sampled = tree.query(moved)[0].min()
        d = mesh_distance(mesh(ring), mesh(ring), X)
        if d > 0.0:
            seen += 1
            assert d <= sampled + 1e-9 and sampled - d < 0.012
        else:
            assert sampled < 0.012
    assert seen > 5


def test_depth_is_what_parts_them():
    """Of crossed bars no corner is inside the other; the way out is 0.06 long."""
    a, b = mesh(box(1.0, 0.1, 0.1)), mesh(box(0.1, 1.0, 0.1))
    X = RigidTransform([0.0, 0.0, 0.04])
    depth = penetration_depth(a, b, X)
    assert depth == pytest.approx(0.06, abs=2e-5)
    assert meshes_meet(a, b, RigidTransform([0.0, 0.0, 0.04 + depth - 2e-5]))
    assert not meshes_meet(a, b, RigidTransform([0.0, 0.0, 0.04 + depth + 2e-5]))


@pytest.mark.parametrize(
    "vertices, faces, message",
    [
        (np.eye(3), np.zeros((0, 3)), "without triangles"),
        (np.eye(3), [[0, 1, 3]], "no vertex"),
        (np.eye(3) * np.nan, [[0, 1, 2]], "not finite"),
        (np.ones((3, 3)), [[0, 1, 2]], "without area"),
    ],
)
def test_what_is_no_mesh(vertices, faces, message):
    with pytest.raises(ValueError, match=message):
        TriangleMesh(vertices, faces)
