"""Covered: every point of every triangle is in some capsule."""

import numpy as np
import pytest

pytest.importorskip("trimesh")

from crar_drake.robot_import.capsule_fitting import Fit, FittedCapsule
from crar_drake.robot_import.covering import covered
from crar_drake.robot_import.meshes import Part


def box(x: float, y: float, z: float) -> Part:
    import trimesh

    mesh = trimesh.creation.box((x, y, z))
    return Part(np.asarray(mesh.vertices), np.asarray(mesh.faces), (1, 1, 1, 1))


def points_on(part: Part, count: int) -> np.ndarray:
    """Uniform in barycentric coordinates, corners and edges among them."""
    rng = np.random.default_rng(0)
    weights = rng.dirichlet([0.4] * 3, size=(len(part.faces), count))
    return np.einsum("fkc,fcx->fkx", weights, part.vertices[part.faces]).reshape(-1, 3)


def test_every_point_of_the_triangles_is_inside_afterwards():
    parts = [box(0.1, 0.06, 0.04), box(0.02, 0.02, 0.15)]
    ends = [np.array([0.04, 0.0, 0.0]), np.array([0.0, 0.0, 0.06])]
    capsules = tuple(FittedCapsule(-end, end, 0.012) for end in ends)
    points = np.concatenate([points_on(part, 500) for part in parts])
    before = np.min([c.distance(points) for c in capsules], axis=0)
    assert before.max() > 5e-3
    fit, most = covered(Fit(capsules, 0.5, 1.0, 0.02, 0.0), parts)
    after = np.min([c.distance(points) for c in fit.capsules], axis=0)
    assert after.max() <= 0.0
    # A vertex was as far outside as the most that was grown, or nearly.
    corners = np.concatenate([part.vertices for part in parts])
    outside = np.min([c.distance(corners) for c in capsules], axis=0)
    assert outside.max() <= most + 1e-6
    assert fit.coverage == 1.0 and fit.volume_ratio > 1.0


def test_capsules_that_hold_everything_do_not_grow():
    ball = FittedCapsule(np.zeros(3), np.zeros(3), 0.1)
    fit, most = covered(Fit((ball,), 1.0, 1.0, 0.0, 0.0), [box(0.1, 0.1, 0.1)])
    (capsule,) = fit.capsules
    for name, value in vars(ball).items():
        np.testing.assert_array_equal(getattr(capsule, name), value)
    assert most == 0.0
