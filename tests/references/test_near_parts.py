"""How fast near parts approach: balls hold their triangles, and no bound is passed."""

import numpy as np
import trimesh
from test_mesh_clearance import robot_of

from crar_drake.references.mesh_clearance import ClearanceOfMeshes
from crar_drake.references.near_parts import divided


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
    near = meshes.advance_of_near(0, q, R, p, advance[0])
    # The ring's inner radius, cells' diagonals, and what comes near on the way.
    steps, slides = np.diff(angles), np.abs(np.diff(slide))
    assert np.all(near <= steps * (0.041 + 0.5 * advance[0]) + slides + 1e-9)
    assert np.all(advance[0] > 3.5 * near)
    # The ring is off the pin's middle by x, and nearer by that, but for the facets.
    facets = 4.0 * 0.011 * (1.0 - np.cos(np.pi / 64.0))
    nearer = np.abs(np.diff(np.abs(slide)))
    assert np.all(nearer <= near + facets) and nearer.max() > 2.0 * facets
