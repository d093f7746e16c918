"""A robot tells whose joints a motion has, and in which order."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_biped import (
    BREADTH_FIRST,
    DEPTH_FIRST,
    biped,
    moving_samples,
    whole_biped,
)

from crar_drake.errors import MotionError
from crar_drake.references.motion_files import read_motion, write_motions
from crar_drake.references.robot_match import matched
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description

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
    write_motions(tmp_path / "a.npz", [named(DEPTH_FIRST)], "beyondmimic-npz", robot)
    held = np.load(tmp_path / "a.npz")
    unnamed = [key for key in held.files if not key.endswith("names")]
    np.savez(tmp_path / "a.npz", **{key: held[key] for key in unnamed})
    read = read_motion(tmp_path / "a.npz", layout="mjlab-npz", robot=robot)
    assert read.layout == "beyondmimic-npz" and read.joint_names == DEPTH_FIRST
    np.testing.assert_allclose(read.joint_positions, JOINTS, atol=1e-6)
    assert "breadth first, since then links are where the file says" in read.guesses[-1]


def test_without_names_or_links_the_number_counts(robot):
    found = matched(replace(named(DEPTH_FIRST), joint_names=()), robot)
    assert found.joint_names == DEPTH_FIRST
    assert found.guesses == ("joints have no names: 5 as biped, depth first",)


def test_a_motion_without_the_wrists_has_them_still(tmp_path: Path):
    """The wrist is depth first the second of five joints, of which there are four."""
    folder = biped(tmp_path / "biped")
    urdf = folder / "biped.urdf"
    urdf.write_text(urdf.read_text().replace('"left_knee"', '"left_wrist_pitch"'))
    robot = WholeBody(load_robot_description(folder))
    assert robot.joint_names[1] == "left_wrist_pitch"
    others = tuple(name for name in robot.joint_names if "wrist" not in name)
    q = JOINTS[:, :4]
    axes = np.array([[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    turns = np.concatenate([np.zeros((len(q), 1, 3)), axes * q[:, :, None]], axis=1)
    clip = dict(root_trans_offset=P, dof=q, root_rot=np.roll(Q, -1, 1), fps=30)
    for names, aa in (((), turns), (others[::-1], turns), ((), None)):
        held = clip | (dict(pose_aa=aa) if aa is not None else {})
        held |= dict(joint_names=list(names)) if names else {}
        (tmp_path / "a.pkl").write_bytes(pickle.dumps(held))
        found = read_motion(tmp_path / "a.pkl", robot=robot)
        assert found.joint_names == robot.joint_names and not found.is_as_read
        assert np.array_equal(found.joint_positions[:, 1], np.zeros(len(q)))
        rest = found.joint_positions[:, [0, 2, 3, 4]]
        assert np.array_equal(rest, q[:, ::-1] if names else q)
        assert "biped's without its 1 of the wrists" in found.guesses[0]
        write_motions(tmp_path / "b.pkl", [found], "motion-lib-pkl", robot)
        again = pickle.loads((tmp_path / "b.pkl").read_bytes())
        assert again["dof"].shape == (len(q), 5) and again["pose_aa"].shape[1] == 6
    # Turns about other axes are those of other joints.
    (tmp_path / "a.pkl").write_bytes(
        pickle.dumps(clip | dict(pose_aa=turns[..., ::-1]))
    )
    with pytest.raises(MotionError, match="4 joints; robot biped has 5 joints"):
        read_motion(tmp_path / "a.pkl", robot=robot)
