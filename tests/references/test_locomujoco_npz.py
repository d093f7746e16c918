"""Trajectories of LocoMuJoCo, written by NumPy alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_biped import BREADTH_FIRST, DEPTH_FIRST, moving_samples, whole_biped

from crar_drake.errors import MotionError
from crar_drake.motion.robots_own import holds_reference
from crar_drake.references.motion_files import (
    read_motion,
    read_motions,
    write_motions,
)
from crar_drake.references.robot_motion import RobotMotion

P, Q, JOINTS = moving_samples()
T = len(P)


def loco(**changes) -> dict:
    held = dict(
        qpos=np.vstack([np.hstack([P, Q, JOINTS]), np.hstack([P, Q, 2 * JOINTS])]),
        qvel=np.zeros((2 * T, 11)),
        split_points=np.array([0, T, 2 * T]),
        joint_names=np.array(["floating", *DEPTH_FIRST]),
        njnt=np.array(6),
        jnt_type=np.array([0, 3, 3, 3, 3, 3]),
        frequency=np.array(100.0),
        body_pos=np.ones((7, 3)),
        metadata=np.array(None, dtype=object),
        xpos=np.zeros((2 * T, 7, 3)),
    )
    return {key: value for key, value in (held | changes).items() if value is not None}


def test_trajectories_are_read_and_written(tmp_path: Path) -> None:
    robot = whole_biped(tmp_path / "biped")
    path = tmp_path / "a.npz"
    np.savez(path, **loco())
    assert holds_reference(path)
    one, two = read_motions(path, robot=robot)
    assert (one.clip, two.clip, one.rate) == ("0", "1", 100.0)
    assert one.joint_names == DEPTH_FIRST and not one.guesses
    assert np.array_equal(one.root_quaternions, Q)
    assert np.array_equal(two.joint_positions, 2 * JOINTS)
    write_motions(tmp_path / "b.npz", (one, two), "locomujoco-npz", robot)
    file, given = np.load(tmp_path / "b.npz"), loco()
    for key in file.files:
        assert np.array_equal(file[key], given[key]), key
    assert set(given) - set(file.files) == {"metadata", "xpos"}
    # A changed one gets velocities of its own.
    changed = replace(one, joint_positions=3 * JOINTS)
    write_motions(tmp_path / "b.npz", [changed], "locomujoco-npz", robot)
    file = np.load(tmp_path / "b.npz")
    assert np.array_equal(file["split_points"], [0, T])
    qdot = 3 * np.gradient(JOINTS, 0.01, axis=0)
    np.testing.assert_allclose(file["qvel"][:, 6:], qdot, atol=1e-9)
    np.testing.assert_allclose(file["qvel"][:, :3], np.gradient(P, 0.01, axis=0))
    # MuJoCo turns a free body by its own angular velocity, from the right.
    R = Rotation.from_quat(np.roll(Q, -1, axis=1))
    w = file["qvel"][4, 3:6]
    turned = R[3] * Rotation.from_rotvec(w * 0.02)
    assert (turned.inv() * R[5]).magnitude() < 1e-4


def test_one_trajectory_of_other_makers(tmp_path: Path) -> None:
    motion = RobotMotion(BREADTH_FIRST, P, Q, JOINTS, 50.0)
    write_motions(tmp_path / "a.npz", [motion], "locomujoco-npz")
    read = read_motion(tmp_path / "a.npz")
    assert read.joint_names == BREADTH_FIRST and read.clip == "" and read.rate == 50.0
    with pytest.raises(MotionError, match="same joints and rate"):
        write_motions(
            tmp_path / "a.npz", (motion, replace(motion, rate=1.0)), "locomujoco-npz"
        )
    with pytest.raises(MotionError, match="--robot"):
        write_motions(
            tmp_path / "a.npz", [replace(motion, joint_names=())], "locomujoco-npz"
        )


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"frequency": None}, "no frequency"),
        ({"jnt_type": np.array([3, 3, 3, 3, 3, 3])}, "has to be free"),
        ({"jnt_type": np.array([0, 1, 3, 3, 3, 3])}, "one degree of freedom"),
        ({"joint_names": np.array(["root"])}, "1 joint names, 6 types"),
        ({"split_points": np.array([0, 5])}, "do not go from 0"),
        ({"split_points": np.array([0, 9, 5, 2 * T])}, "do not go from 0"),
        ({"frequency": np.array([1.0, 2.0])}, "not one number"),
        ({"frequency": np.array(0.0)}, "the rate is 0"),
        ({"qpos": np.full((2 * T, 12), "a")}, "array qpos"),
        ({"qpos": np.array([None])}, "no qpos"),
    ],
)
def test_wrong_files_are_told(changes, said: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **loco(**changes))
    with pytest.raises(MotionError, match=said):
        read_motions(tmp_path / "a.npz")


def test_a_layout_that_is_said_has_to_be_there(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **loco())
    with pytest.raises(MotionError, match="not those of mjlab-npz"):
        read_motions(tmp_path / "a.npz", layout="mjlab-npz")
    np.savez(tmp_path / "a.npz", joint_pos=JOINTS)
    with pytest.raises(MotionError, match="no frequency, .* as locomujoco"):
        read_motions(tmp_path / "a.npz", layout="locomujoco-npz")
