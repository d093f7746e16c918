"""Pictures of the robot: it is in the picture, and tinted where asked."""

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, Sphere

from benchmarks.section_iv.snapshots import TINT, SnapshotRenderer, inflated
from crar_drake.robot.description import load_robot_description


@pytest.fixture(scope="module")
def renderer() -> SnapshotRenderer:
    return SnapshotRenderer(load_robot_description("upper_body"), size=(120, 140))


def pose(**joints: float) -> np.ndarray:
    """Positions of the upper body, the waist at hip height."""
    names = ["waist_x", "waist_y", "waist_z", "torso_yaw", "torso_pitch", "torso_roll"]
    for side in ("left", "right"):
        names += [f"{side}_shoulder_{axis}" for axis in ("pitch", "roll", "yaw")]
        names.append(f"{side}_elbow")
    joints = {"waist_z": 0.69} | joints
    return np.array([joints.get(name, 0.0) for name in names])


def yellow(picture: np.ndarray) -> np.ndarray:
    """Pixels whose colour has the tint's hue, in whatever light."""
    red, green, blue = np.moveaxis(picture, 2, 0)
    return (red > 0.35) & (blue < 0.35 * red) & (np.abs(green / red - TINT.g()) < 0.15)


def test_the_robot_is_in_the_middle_of_a_white_picture(renderer):
    picture = renderer.render(pose())
    assert picture.shape == (140, 120, 3)
    np.testing.assert_array_equal(picture[0], 1.0)
    robot = (picture < 0.95).any(axis=2)
    assert 0.05 < robot.mean() < 0.5
    rows, columns = np.nonzero(robot[:100])  # above its stand
    assert abs(columns.mean() - 60) < 10
    assert 30 < rows.mean() < 80
    assert not yellow(picture).any()


def test_it_is_followed_wherever_the_waist_goes(renderer):
    here = renderer.render(pose())
    there = renderer.render(pose(waist_x=2.0, waist_y=-1.0, waist_z=0.8))
    # Only the height of the stand differs, and rounding.
    assert np.abs(here[:90] - there[:90]).mean() < 0.02


def test_tinted_segments_are_yellow_where_they_are_and_nothing_else(renderer):
    q = pose(left_shoulder_roll=1.5, left_elbow=0.0)
    plain = renderer.render(q)
    left = renderer.render(q, ["left_hand", "left_forearm"])
    # The robot faces the camera: its left is on the right.
    tinted = yellow(left)
    assert tinted.sum() > 40
    assert np.nonzero(tinted)[1].min() > 60
    np.testing.assert_allclose(left[:, :50], plain[:, :50], atol=1e-6)
    right = yellow(renderer.render(q, ["right_hand"]))
    assert right.any() and np.nonzero(right)[1].max() < 60


def test_a_tint_goes_when_it_is_not_asked_for_any_more(renderer):
    q = pose()
    plain = renderer.render(q)
    assert yellow(renderer.render(q, ["torso"])).any()
    np.testing.assert_array_equal(renderer.render(q), plain)


def test_another_robot():
    picture = SnapshotRenderer(load_robot_description("obstacle_arm")).render(
        np.zeros(7), ["arm::hand"]
    )
    assert (picture < 0.9).any() and yellow(picture).any()


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
