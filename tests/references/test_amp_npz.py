"""NPZ files of Isaac Lab's AMP tasks, written by NumPy alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_biped import (
    BREADTH_FIRST,
    DEPTH_FIRST,
    link_poses,
    moving_samples,
    whole_biped,
)

from crar_drake.errors import MotionError
from crar_drake.motion.robots_own import holds_reference
from crar_drake.references.motion_files import read_motion, write_motions

P, Q, JOINTS = moving_samples()
LINKS = ("pelvis", "trunk", "left_shin")  # some, as in G1_walk.npz
ORDER = [DEPTH_FIRST.index(name) for name in BREADTH_FIRST]


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return whole_biped(tmp_path_factory.mktemp("biped"))


def link_positions(joints: np.ndarray) -> np.ndarray:
    R_WR = Rotation.from_quat(np.roll(Q, -1, axis=1))
    return np.array(
        [
            [p + R.apply(link_poses(q)[link][0]) for link in LINKS]
            for p, R, q in zip(P, R_WR, joints, strict=True)
        ]
    )


def amp(**changes) -> dict:
    held = dict(
        fps=np.array(60),
        dof_names=np.array(BREADTH_FIRST),
        body_names=np.array(LINKS),
        dof_positions=JOINTS[:, ORDER],
        dof_velocities=np.zeros_like(JOINTS),
        body_positions=link_positions(JOINTS),
        body_rotations=np.tile(Q[:, None], (1, 3, 1)),
        body_linear_velocities=np.zeros((len(P), 3, 3)),
        body_angular_velocities=np.zeros((len(P), 3, 3)),
    )
    return {key: value for key, value in (held | changes).items() if value is not None}


def test_it_is_read_and_written(tmp_path: Path, robot) -> None:
    path, other = tmp_path / "a.npz", tmp_path / "b.npz"
    np.savez(path, **amp())
    assert holds_reference(path)
    for given in (None, robot):
        read = read_motion(path, robot=given)
        assert read.layout == "amp-npz" and read.rate == 60.0 and not read.guesses
        np.testing.assert_allclose(read.root_positions, P, atol=1e-12)
        assert np.array_equal(read.root_quaternions, Q)
        names = DEPTH_FIRST if given else BREADTH_FIRST
        assert read.joint_names == names
        columns = [BREADTH_FIRST.index(name) for name in names]
        assert np.array_equal(read.joint_positions, JOINTS[:, ORDER][:, columns])
    changed = replace(read, joint_positions=read.joint_positions + 0.1)
    for motion, joints in ((read, JOINTS), (changed, JOINTS + 0.1)):
        write_motions(other, [motion], "amp-npz", robot)
        file = np.load(other)
        assert set(file.files) == set(amp()) and file["fps"] == 60
        assert tuple(file["dof_names"]) == DEPTH_FIRST
        assert tuple(file["body_names"]) == LINKS
        np.testing.assert_allclose(file["dof_positions"], joints)
        moved = link_positions(joints)
        np.testing.assert_allclose(file["body_positions"], moved, atol=1e-9)


def test_links_of_another_version_are_reported(tmp_path: Path, robot) -> None:
    moved = link_positions(JOINTS) + [[[0, 0, 0], [0, 0, 0], [0, 0, 0.05]]]
    np.savez(tmp_path / "a.npz", **amp(body_positions=moved))
    read = read_motion(tmp_path / "a.npz", robot=robot)
    assert "up to 50 mm from where those of biped are" in read.guesses[0]


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"body_positions": None}, "it has no body_positions"),
        ({"body_rotations": np.zeros((12, 4))}, "body_rotations is an array"),
        ({"body_positions": np.zeros((3, 3, 3))}, "numbers of frames differ"),
        ({"dof_names": None}, "no dof_names"),
        ({"dof_names": np.array(["a"])}, "1 joint names but 5 joints"),
        ({"dof_positions": np.zeros(5)}, "dof_positions is an array"),
        ({"fps": np.array("fast")}, "fps is fast"),
    ],
)
def test_wrong_files_are_told(changes, said: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **amp(**changes))
    with pytest.raises(MotionError, match=said):
        read_motion(tmp_path / "a.npz")


def test_a_layout_that_is_said_has_to_be_there(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **amp())
    with pytest.raises(MotionError, match="not those of mjlab-npz"):
        read_motion(tmp_path / "a.npz", layout="mjlab-npz")
    np.savez(tmp_path / "a.npz", joint_pos=JOINTS)
    with pytest.raises(MotionError, match="not those of amp-npz"):
        read_motion(tmp_path / "a.npz", layout="amp-npz")
