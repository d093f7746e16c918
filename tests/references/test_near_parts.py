"""How fast near parts approach: balls hold their triangles, and no bound is passed."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from test_mesh_clearance import robot_of

from crar_drake.references.mesh_clearance import ClearanceOfMeshes
from crar_drake.references.near_parts import (
    are_near,
    divided,
    near_approach,
    near_box,
    place_balls,
    swept_by,
)


def test_balls_hold_what_they_are_about():
    """Points of slivers and of small faces are each within a ball, and its group's."""
    rng = np.random.default_rng(0)
    slivers = rng.normal(size=(40, 3, 3)) * [0.2, 1e-3, 1e-3]
    triangles = np.concatenate([slivers, 0.01 * rng.normal(size=(200, 3, 3))])
    parts = divided(triangles)
    share = rng.dirichlet([0.5] * 3, size=(240, 20))
    points = (share @ triangles).reshape(-1, 3)
    for balls in (parts.parts, parts.groups):
        off = np.linalg.norm(points[:, None] - balls[:, :3], axis=2) - balls[:, 3]
        assert off.min(axis=1).max() <= 0.0
    assert parts.parts[:, 3].max() < 0.02
    for group, (a, b) in enumerate(zip(parts.first[:-1], parts.first[1:], strict=True)):
        centre, radius = parts.groups[group, :3], parts.groups[group, 3]
        arms = np.linalg.norm(parts.parts[a:b, :3] - centre, axis=1)
        assert a < b and np.all(arms < radius)
    assert parts.first[-1] == len(parts.parts)


def test_a_pin_with_a_wide_rim(tmp_path):
    """A hand that turns about a pin: its far rim moves 20 times as fast as what is near
    the pin, and the bound of that holds of distances in closed form."""
    post = trimesh.creation.cylinder(radius=0.01, height=0.1, sections=64)
    ring = trimesh.creation.annulus(r_min=0.011, r_max=0.2, height=0.004, sections=64)
    ring.apply_translation([0.0, 0.0, 0.01])
    ring = ring.subdivide_to_size(0.004)
    post = post.subdivide_to_size(0.004)
    body = robot_of(tmp_path, post, ring)
    meshes = ClearanceOfMeshes(body)
    angles = np.cumsum([0.0, 0.01, 0.03, 0.1, 0.02])
    slide = np.array([0.0, 1e-4, 0.0, -2e-4, 0.0])
    q = body.configurations(np.column_stack([angles, slide]))
    R, p = meshes.meshes.poses(q)
    advance = meshes.advance(q, R, p)
    every = np.ones(len(q) - 1, dtype=bool)
    near = meshes.advance_of_near(0, q, R, p, advance[0], every)
    # The ring's inner radius, cells' diagonals, and what comes near on the way.
    steps, slides = np.diff(angles), np.abs(np.diff(slide))
    assert np.all(near <= steps * (0.041 + 0.5 * advance[0]) + slides + 1e-9)
    assert np.all(advance[0] > 3.5 * near)
    # The ring is off the pin's middle by x, and nearer by that, but for the facets.
    facets = 4.0 * 0.011 * (1.0 - np.cos(np.pi / 64.0))
    nearer = np.abs(np.diff(np.abs(slide)))
    assert np.all(nearer <= near + facets) and nearer.max() > 2.0 * facets


@pytest.mark.parametrize("seed", range(4))
def test_no_point_that_is_near_is_left_out(seed):
    """Corners are asked pair by pair, as balls without a radius, and so are all parts:
    what boxes and groups leave is between these."""
    rng, h = np.random.default_rng(seed), 0.03
    triangles = 0.05 * rng.normal(size=(2, 20, 1, 3))
    triangles = triangles + 0.01 * rng.normal(size=(2, 20, 3, 3))
    a, b = map(divided, triangles)
    R = np.empty((2, 2, 3, 3))
    R[0] = Rotation.random(2, random_state=seed).as_matrix()
    R[1] = R[0] @ Rotation.from_rotvec(0.2 * rng.normal(size=(2, 3))).as_matrix()
    p = np.zeros((2, 2, 3))
    p[:, 1] = [0.15, 0.0, 0.0]
    p[1] += 0.01 * rng.normal(size=(2, 3))
    joints, slides, steps = np.array([0]), np.zeros(1), np.array([[0.1]])
    origins, axes = rng.normal(size=(2, 2, 1, 3))
    axes /= np.linalg.norm(axes, axis=2, keepdims=True)
    nearer = np.array([0.01 * rng.random()])

    def swept(*balls: np.ndarray) -> np.ndarray:
        """(2,) by the near ones of these, all pairs of which are asked."""
        placed = [
            place_balls(x, np.ones(len(x), dtype=bool), R[:, k], p[:, k])
            for k, x in enumerate(balls)
        ]
        one, other = balls
        near = np.zeros((len(one), len(other)), dtype=bool)
        for i, j in np.ndindex(*near.shape):
            radius = one[i, 3] + other[j, 3] + h
            near[i, j] = are_near(placed[0], i, radius, placed[1], j, nearer[0])
        sides = near.any(axis=1), near.any(axis=0)
        return np.array(
            [
                swept_by(x, who, at, joints, origins, axes, slides, steps[0])
                for x, who, at in zip(balls, sides, placed, strict=True)
            ]
        )

    corners = (np.pad(x.reshape(-1, 3), ((0, 0), (0, 1))) for x in triangles)
    least, most = swept(*corners), swept(a.parts, b.parts)
    (found,) = near_approach(
        *(R, p, np.array([0, 1]), a, b, joints, joints),
        *(origins, axes, slides, steps, nearer, np.ones(1, dtype=bool), h),
    )
    assert np.all(least > 0.0)
    assert np.all(least <= found + 1e-12) and np.all(found <= most + 1e-12)


@pytest.mark.parametrize(("h", "nearer", "found"), [
    (0.09, 0.0, []), (0.13, 0.0, [0]), (0.09, 0.1, [0]), (0.13, 0.3, [0, 1]),
])  # fmt: skip
def test_balls_that_are_near_a_box_are_found(h, nearer, found):
    """Balls 0.2 and 0.3 m before a row of others, in a frame that is turned."""
    balls = np.array([[-0.2, 0.1, 0.0, 0.02], [-0.3, 0.2, 0.0, 0.02]])
    R = np.array(2 * [Rotation.from_rotvec([0.0, 0.0, 0.5 * np.pi]).as_matrix()])
    others = np.array([[0.0, 0.0, 0.0, 0.06], [0.4, 0.0, 0.0, 0.01]])  # along y
    placed = np.array(2 * [balls[:, :3]])
    some = near_box(balls, placed, others, R, np.zeros((2, 3)), nearer, h)
    assert some.tolist() == found
