"""Hips, knees, feet and head: where they are found, and what is said where not."""

import re
from dataclasses import replace

import numpy as np
import pytest
from small_urdfs import humanoid, humanoid_with_legs, write

from crar_drake.robot_import.anatomy import find_anatomy
from crar_drake.robot_import.body_frames import (
    guess_frames,
    guess_leg_and_head_frames,
)
from crar_drake.robot_import.meshes import with_looks
from crar_drake.robot_import.rest_posture import bent_knees
from crar_drake.robot_import.robot_files import find_urdf
from crar_drake.robot_import.source_urdf import read_urdf

POINTS = {f"{s}_{n}" for s in ("left", "right") for n in ("hip", "knee", "foot")}


def found_in(robot):
    """The frames with their places in the root's frame, and what is lacking."""
    robot = with_looks(robot)
    anatomy, X = find_anatomy(robot), robot.poses()
    frames, lacking = guess_leg_and_head_frames(robot, anatomy)
    frames = guess_frames(robot, anatomy) | frames
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


@pytest.mark.parametrize("reverse", [False, True])
def test_knees_bend_ahead_and_soles_stay_level(tmp_path, reverse):
    """By the poses of the links, whatever the sign of the axes."""
    text = humanoid_with_legs()
    if reverse:
        for name in ("left_knee", "left_pitch", "right_roll"):
            old = text[text.index(f'<joint name="{name}_joint"') :]
            old = old[: old.index("</joint>")]
            text = text.replace(
                old, re.sub(r'axis xyz="(.*?)1', r'axis xyz="\g<1>-1', old)
            )
    robot = read_urdf(write(tmp_path, text))
    anatomy, straight = find_anatomy(robot), robot.poses()
    for spread in (0.0, 0.1):
        X = robot.poses(bent_knees(robot, anatomy, spread))
        for side, outwards in (("left", 1.0), ("right", -1.0)):
            hip, knee, sole = (f"{side}_{n}" for n in ("pitch", "knee", "leg"))
            p_hip, p_knee, p_sole = (X[n].translation() for n in (hip, knee, sole))
            way = p_sole - p_hip
            assert way[0] == pytest.approx(0.0, abs=2e-3)
            assert way[1] == pytest.approx(outwards * 0.6 * np.sin(spread), abs=0.01)
            assert 0.55 < -way[2] < 0.595, "the leg is shorter than straight"
            assert p_knee[0] > p_hip[0] + 0.04
            tilt = X[sole].rotation().matrix() @ straight[sole].rotation().matrix().T
            assert tilt[2, 2] > np.cos(0.01) and tilt[0, 0] > np.cos(0.03)


def test_legs_that_are_locked_or_have_no_knees_stay(tmp_path):
    robot = read_urdf(write(tmp_path, humanoid_with_legs()))
    locked = {"left_knee_joint": 0.0, "right_knee_joint": 0.0}
    robot = replace(robot, locked=locked)
    assert not bent_knees(robot, find_anatomy(robot))
    robot = read_urdf(write(tmp_path, humanoid()))
    assert not bent_knees(robot, find_anatomy(robot))


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
