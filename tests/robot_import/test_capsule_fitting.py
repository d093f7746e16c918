"""Fits are close: judged by trimesh's own capsules, volumes and distances."""

import numpy as np
import pytest
import trimesh
from pydrake.math import RigidTransform, RollPitchYaw

from crar_drake.robot_import.capsule_fitting import (
    EXCESS,
    TOLERANCE,
    Fit,
    FittedCapsule,
    Hulls,
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
        (trimesh.creation.box(extents=(0.08, 0.06, 0.3)), 8),
    ],
)
def test_simple_shapes(mesh, most):
    mesh = mesh.copy()
    fit = fit_link([part(mesh)], most)
    assert fit.good(EXCESS) and len(fit.capsules) <= most
    coverage, ratio = judge(fit, mesh)
    assert coverage == 1.0 and fit.coverage == 1.0
    assert ratio == pytest.approx(fit.volume_ratio, rel=0.06)


def test_a_bent_link_gets_two():
    upper = trimesh.creation.capsule(radius=0.03, height=0.3)
    upper.apply_translation([0.0, 0.0, 0.15 - upper.centroid[2]])
    lower = upper.copy()
    lower.apply_transform(trimesh.transformations.rotation_matrix(1.8, [1, 0, 0]))
    mesh = trimesh.util.concatenate([upper, lower])
    fit = fit_link([part(mesh)], 2)
    assert fit.good(EXCESS) and len(fit.capsules) == 2
    # A single one that encloses both is worse by far.
    assert fit_link([part(upper), part(lower)], 1).volume_ratio > fit.volume_ratio


def far_points(fit: Fit, count: int = 400) -> np.ndarray:
    """Points on the capsules' surfaces, in the directions of a sphere's."""
    directions = np.random.default_rng(0).normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.concatenate(
        [
            end + capsule.radius * directions
            for capsule in fit.capsules
            for end in np.linspace(capsule.p_L0, capsule.p_L1, 5)
        ]
    )


def sticking_out(fit: Fit, mesh: trimesh.Trimesh) -> float:
    """How far they are outside of the hull, by the triangles' own distances [m]."""
    points = far_points(fit)
    hull = mesh.convex_hull
    from_faces = points[:, np.newaxis] - hull.triangles_center
    outside = points[np.einsum("pfx,fx->pf", from_faces, hull.face_normals).max(1) > 0]
    if not len(outside):
        return 0.0
    _, distance, _ = trimesh.proximity.closest_point_naive(hull, outside)
    return float(distance.max())


def bracket() -> trimesh.Trimesh:
    """Like a torso of plates: an L with a foot, in which most of its hull is empty."""
    boxes = [
        trimesh.creation.box(extents=(0.24, 0.04, 0.4)),
        trimesh.creation.box(extents=(0.24, 0.25, 0.05)),
    ]
    boxes[1].apply_translation([0.0, 0.12, -0.18])
    return trimesh.util.concatenate(boxes)


@pytest.mark.parametrize(
    "make, excess",
    [
        (lambda: trimesh.creation.box(extents=(0.25, 0.2, 0.4)), 0.03),  # a torso
        (lambda: trimesh.creation.box(extents=(0.25, 0.2, 0.4)), 0.02),
        (lambda: trimesh.creation.box(extents=(0.3, 0.3, 0.02)), 0.01),  # a plate
        (lambda: trimesh.creation.cylinder(radius=0.08, height=0.12), 0.01),
        (bracket, 0.02),
        (bracket, 0.01),
    ],
)
def test_capsules_stick_out_by_no_more_than_is_asked_for(make, excess):
    """A single one about the torso sticks out by 71 mm."""
    mesh = make()
    fit = fit_link([part(mesh)], 32, excess)
    assert fit.good(excess) and fit.farthest <= TOLERANCE
    measured = sticking_out(fit, mesh)
    assert measured <= fit.excess + 1e-6 <= excess + 2e-6
    assert measured > fit.excess - 3e-3  # it is no mere bound


def test_how_far_a_ball_sticks_out():
    """Of a unit cube, in closed form: centres inside, off a face and off a corner."""
    hulls = Hulls([np.array(np.meshgrid(*[[0, 1.0]] * 3)).reshape(3, -1).T])
    corner = np.array([1.3, 1.4, 2.0])
    for centre, expected in (
        (np.array([0.5, 0.5, 0.8]), 0.5 - 0.2),
        (np.array([0.5, 0.5, 1.25]), 0.5 + 0.25),
        (corner, 0.5 + np.linalg.norm(corner - 1.0)),
    ):
        ball = FittedCapsule(centre, centre, 0.5)
        assert hulls.excess(ball) == pytest.approx(expected, abs=1e-12)
    within = FittedCapsule(np.full(3, 0.5), np.full(3, 0.5), 0.1)
    assert hulls.excess(within) == 0.0


def test_what_cannot_be_met_is_told():
    """Two capsules do not hold a wide plate closely; the best there is is taken."""
    plate = trimesh.creation.box(extents=(0.3, 0.3, 0.002))
    fit = fit_link([part(plate)], 2)
    assert not fit.good(EXCESS) and fit.coverage == 1.0
    assert len(fit.capsules) <= 2


def test_an_image_is_held_as_well():
    """Two shapes that are nearly the same: one set of capsules holds both, and sticks
    out of neither's hull by more than is allowed."""
    meshes = [trimesh.creation.box(extents=(0.1, w, 0.25)) for w in (0.06, 0.062)]
    parts = [part(mesh) for mesh in meshes]
    fit = fit_link(parts[:1], 16, 0.012, parts[1:])
    for mesh in meshes:
        assert inside(fit, np.asarray(mesh.vertices), TOLERANCE).all()
        assert sticking_out(fit, mesh) <= 0.012 + 1e-6


def test_a_flat_mesh_has_no_fit():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    assert fit_link([Part(square, np.array([[0, 1, 2], [0, 2, 3]]), (1,) * 4)]) is None


def test_the_same_mesh_has_the_same_fit():
    mesh = part(trimesh.creation.box(extents=(0.05, 0.07, 0.2)))
    first, second = fit_link([mesh], 2), fit_link([mesh], 2)
    for a, b in zip(first.capsules, second.capsules, strict=True):
        np.testing.assert_array_equal(a.p_L0, b.p_L0)
        assert a.radius == b.radius
