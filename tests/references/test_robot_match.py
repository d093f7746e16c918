"""A robot tells whose joints a motion has, and in which order."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_biped import BREADTH_FIRST, DEPTH_FIRST, moving_samples, whole_biped

from crar_drake.errors import MotionError
from crar_drake.references.motion_files import read_motion, write_motion
from crar_drake.references.robot_match import matched
from crar_drake.references.robot_motion import RobotMotion

P, Q, JOINTS = moving_samples()


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return whole_biped(tmp_path_factory.mktemp("biped"))


def named(names: tuple[str, ...]) -> RobotMotion:
    return RobotMotion(names, P, Q, JOINTS[:, : len(names)], 30.0, source="a.csv")


def test_names_decide(robot):
    given = named(BREADTH_FIRST)
    found = matched(given, robot)
    assert found.joint_names == DEPTH_FIRST
    for column, name in enumerate(DEPTH_FIRST):
        there = BREADTH_FIRST.index(name)
        assert np.array_equal(found.joint_positions[:, column], JOINTS[:, there])


def test_other_names_are_refused(robot):
    with pytest.raises(MotionError, match="it lacks waist; it has tail"):
        matched(named((*DEPTH_FIRST[:4], "tail")), robot)
    with pytest.raises(MotionError, match="it lacks right_knee, waist"):
        matched(named(DEPTH_FIRST[:3]), robot)
    more = replace(
        named(DEPTH_FIRST),
        joint_names=(*DEPTH_FIRST, "neck"),
        joint_positions=np.hstack([JOINTS, JOINTS[:, :1]]),
    )
    with pytest.raises(MotionError, match="locked, import the whole robot"):
        matched(more, robot)


def test_links_decide_against_a_wrong_layout(tmp_path: Path, robot):
    write_motion(tmp_path / "a.npz", named(DEPTH_FIRST), "beyondmimic-npz", robot)
    read = read_motion(tmp_path / "a.npz", layout="mjlab-npz", robot=robot)
    assert read.layout == "beyondmimic-npz" and read.joint_names == DEPTH_FIRST
    np.testing.assert_allclose(read.joint_positions, JOINTS, atol=1e-6)
    assert "breadth first, since then links are where the file says" in read.guesses[-1]


def test_without_names_or_links_the_number_counts(robot):
    found = matched(replace(named(DEPTH_FIRST), joint_names=()), robot)
    assert found.joint_names == DEPTH_FIRST
    assert found.guesses == ("joints have no names: 5 as biped, depth first",)
