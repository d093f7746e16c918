"""Hips, knees, feet and head: where they are found, and what is said where not."""

import numpy as np
import pytest
from small_urdfs import humanoid, humanoid_with_legs, write

from crar_drake.robot_import.anatomy import find_anatomy
from crar_drake.robot_import.leg_and_head_frames import guess_leg_and_head_frames
from crar_drake.robot_import.meshes import link_parts
from crar_drake.robot_import.source_urdf import find_urdf, read_urdf
from crar_drake.robot_import.upper_body_frames import guess_frames

POINTS = {f"{s}_{n}" for s in ("left", "right") for n in ("hip", "knee", "foot")}


def found_in(robot):
    """The frames with their places in the root's frame, and what is lacking."""
    parts = {name: link_parts(link) for name, link in robot.links.items()}
    anatomy, X = find_anatomy(robot), robot.poses()
    frames, lacking = guess_leg_and_head_frames(robot, anatomy, parts)
    frames = guess_frames(robot, anatomy, parts) | frames
    p = {k: X[f.link].multiply(np.array(f.point)) for k, f in frames.items()}
    return p, lacking


def test_a_leg_of_six_joints(tmp_path):
    p, lacking = found_in(read_urdf(write(tmp_path, humanoid_with_legs())))
    assert not lacking
    np.testing.assert_allclose(p["left_hip"], [0, 0.1, -0.15], atol=1e-5)
    np.testing.assert_allclose(p["left_knee"], [0, 0.1, -0.45], atol=1e-5)
    np.testing.assert_allclose(p["right_foot"], [0, -0.1, -0.75], atol=1e-5)
    np.testing.assert_allclose(p["head"], [0, 0, 0.56], atol=0.02)


def test_what_is_not_found_is_said(tmp_path):
    """Legs of one joint have no knees."""
    p, lacking = found_in(read_urdf(write(tmp_path, humanoid())))
    assert set(lacking) == POINTS and "head" in p


@pytest.mark.parametrize("name", ["g1_29dof_rev_1_0", "talos_full_v2", "romeo"])
def test_real_humanoids(robot_data, name):
    p, lacking = found_in(read_urdf(find_urdf(name)[0]))
    assert not lacking
    for point in ("hip", "knee", "foot"):
        left, right = p[f"left_{point}"], p[f"right_{point}"]
        assert left[1] > 0.03 and np.abs(left - right * [1, -1, 1]).max() < 0.01
    thigh = np.linalg.norm(p["left_hip"] - p["left_knee"])
    shank = np.linalg.norm(p["left_knee"] - p["left_foot"])
    assert 0.7 < thigh / shank < 1.4
    assert p["head"][2] > p["neck"][2] > p["left_hip"][2] > p["left_knee"][2]
    assert abs(p["head"][1]) < 0.02
