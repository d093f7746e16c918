"""Fits are close: judged by trimesh's own capsules, volumes and distances."""

import numpy as np
import pytest
import trimesh
from pydrake.math import RigidTransform, RollPitchYaw

from crar_drake.robot_import.capsule_fitting import (
    LARGEST_RATIO,
    REQUIRED_COVERAGE,
    Fit,
    FittedCapsule,
    fit_link,
)
from crar_drake.robot_import.meshes import Part

X = RigidTransform(RollPitchYaw(0.4, -0.7, 1.1), [0.3, -0.2, 0.5]).GetAsMatrix4()


def part(mesh: trimesh.Trimesh) -> Part:
    mesh.apply_transform(X)
    return Part(np.asarray(mesh.vertices), np.asarray(mesh.faces), (1, 1, 1, 1))


def inside(fit: Fit, points: np.ndarray, tolerance: float) -> np.ndarray:
    """Whether points are in the union, by sampling each axis densely."""
    d = []
    for capsule in fit.capsules:
        s = np.linspace(0.0, 1.0, 400)[:, None]
        axis = capsule.p_L0 + s * (capsule.p_L1 - capsule.p_L0)
        gaps = np.linalg.norm(points[:, None] - axis[None], axis=2).min(axis=1)
        d.append(gaps - capsule.radius)
    return np.min(d, axis=0) <= tolerance


def judge(fit: Fit, mesh: trimesh.Trimesh) -> tuple[float, float]:
    """Coverage and volume ratio, found independently (Monte Carlo)."""
    low = np.min([np.minimum(c.p_L0, c.p_L1) - c.radius for c in fit.capsules], axis=0)
    high = np.max([np.maximum(c.p_L0, c.p_L1) + c.radius for c in fit.capsules], axis=0)
    points = np.random.default_rng(1).uniform(low, high, size=(6000, 3))
    volume = inside(fit, points, 0.0).mean() * np.prod(high - low)
    covered = inside(fit, np.asarray(mesh.vertices), 5.1e-3).mean()
    return covered, volume / mesh.convex_hull.volume


@pytest.mark.parametrize(
    "mesh, most",
    [
        (trimesh.creation.cylinder(radius=0.05, height=0.3), 1),
        (trimesh.creation.capsule(radius=0.04, height=0.2), 1),
        (trimesh.creation.icosphere(3, radius=0.1), 1),
        (trimesh.creation.box(extents=(0.08, 0.06, 0.3)), 4),
    ],
)
def test_simple_shapes(mesh, most):
    mesh = mesh.copy()
    fit = fit_link([part(mesh)], most)
    assert fit.good and len(fit.capsules) <= most
    coverage, ratio = judge(fit, mesh)
    assert coverage >= REQUIRED_COVERAGE
    assert coverage == pytest.approx(fit.coverage, abs=0.01)
    assert ratio == pytest.approx(fit.volume_ratio, rel=0.06)
    assert ratio <= LARGEST_RATIO * 1.06


def test_a_bent_link_gets_two():
    upper = trimesh.creation.capsule(radius=0.03, height=0.3)
    upper.apply_translation([0.0, 0.0, 0.15 - upper.centroid[2]])
    lower = upper.copy()
    lower.apply_transform(trimesh.transformations.rotation_matrix(1.8, [1, 0, 0]))
    mesh = trimesh.util.concatenate([upper, lower])
    fit = fit_link([part(mesh)], 2)
    assert fit.good and len(fit.capsules) == 2
    # A single one that encloses both is worse by far.
    assert fit_link([part(upper), part(lower)], 1).volume_ratio > fit.volume_ratio


def test_what_cannot_be_met_is_told():
    """A thin plate has hardly any volume, so that capsules have too much."""
    plate = trimesh.creation.box(extents=(0.3, 0.3, 0.002))
    fit = fit_link([part(plate)], 2)
    assert not fit.good and fit.coverage >= REQUIRED_COVERAGE


def test_a_flat_mesh_has_no_fit():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    assert fit_link([Part(square, np.array([[0, 1, 2], [0, 2, 3]]), (1,) * 4)]) is None


def test_the_same_mesh_has_the_same_fit():
    mesh = part(trimesh.creation.box(extents=(0.05, 0.07, 0.2)))
    first, second = fit_link([mesh], 2), fit_link([mesh], 2)
    for a, b in zip(first.capsules, second.capsules, strict=True):
        np.testing.assert_array_equal(a.p_L0, b.p_L0)
        assert a.radius == b.radius


def test_distance_to_a_sphere_and_a_capsule():
    sphere = FittedCapsule(np.zeros(3), np.zeros(3), 0.5)
    np.testing.assert_allclose(sphere.distance(np.array([[2.0, 0, 0]])), [1.5])
    capsule = FittedCapsule(np.zeros(3), np.array([0, 0, 1.0]), 0.5)
    points = np.array([[1.0, 0, 0.5], [0, 0, 3.0], [0, 0, 0.5]])
    np.testing.assert_allclose(capsule.distance(points), [0.5, 1.5, -0.5])
