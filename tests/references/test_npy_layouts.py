"""NPY files of PHUMA and of the G1's AMASS, written by NumPy alone."""

from pathlib import Path

import numpy as np
import pytest
from small_biped import moving_samples

from crar_drake.errors import MotionError
from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.robots_own import holds_reference
from crar_drake.references.motion_files import read_motion, write_motions
from crar_drake.references.robot_motion import RobotMotion

P, Q, JOINTS = moving_samples()
XYZW = np.roll(Q, -1, axis=1)


def phuma(**changes) -> dict:
    held = dict(root_trans=P, root_ori=XYZW, dof_pos=JOINTS, fps=30)
    return {k: v for k, v in (held | changes).items() if v is not None}


def test_phuma_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, phuma())
    assert holds_reference(path)
    read = read_motion(path)
    assert read.layout == "phuma-npy" and read.rate == 30.0 and not read.guesses
    assert np.array_equal(read.root_positions, P)
    assert np.array_equal(read.root_quaternions, Q)
    assert np.array_equal(read.joint_positions, JOINTS)
    write_motions(tmp_path / "b.npy", [read], "phuma-npy")
    held = np.load(tmp_path / "b.npy", allow_pickle=True).item()
    for key, value in phuma().items():
        assert np.array_equal(held[key], value)


def test_the_g1s_table_is_read(tmp_path: Path) -> None:
    table = np.hstack([P - [0, 0, 0.793], XYZW, np.zeros((len(P), 29))])
    np.save(tmp_path / "walk_poses_100_jpos.npy", table)
    read = read_motion(tmp_path / "walk_poses_100_jpos.npy")
    assert read.layout == "amass-npy" and read.rate == 100.0
    np.testing.assert_allclose(read.root_positions, P, atol=1e-12)
    assert np.array_equal(read.root_quaternions, Q)
    assert "0.793 m" in read.guesses[0]
    changed = RobotMotion((), P, Q, np.zeros((len(P), 29)), 30.0)
    for motion, tolerance in ((read, 0.0), (changed, 1e-12)):
        write_motions(tmp_path / "b.npy", [motion], "amass-npy")
        np.testing.assert_allclose(np.load(tmp_path / "b.npy"), table, atol=tolerance)
    # Of another robot nothing is added, and without a rate in the name one is guessed.
    np.save(tmp_path / "c.npy", np.hstack([P, XYZW, JOINTS]).astype(np.float32))
    read = read_motion(tmp_path / "c.npy")
    assert read.rate == 120.0 and "its name has none" in read.guesses[0]
    assert read.precision == "float32"
    np.testing.assert_allclose(read.root_positions, P, atol=1e-6)
    assert read_motion(tmp_path / "c.npy", rate=50.0).guesses == ()


def test_points_of_a_person_are_none(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((5, 22, 3)))
    assert not holds_reference(tmp_path / "a.npy")
    np.save(tmp_path / "a.npy", phuma())
    with pytest.raises(MotionError, match="of a robot's own joints, not of a person"):
        load_performer(str(tmp_path / "a.npy"))


@pytest.mark.parametrize(
    "held, said",
    [
        (phuma(dof_pos=None), "it has no dof_pos, as phuma-npy has"),
        (phuma(root_ori=np.zeros((12, 4))), "frame 1: root_ori has length zero"),
        (phuma(dof_pos=JOINTS[:3]), "numbers of frames differ"),
        (phuma(dof_pos=JOINTS.T[0]), "dof_pos is an array"),
        (phuma(fps="fast"), "fps is fast, not one number"),
        (phuma(more=Path), "names .*which is no plain data and could run code"),
        (np.array([{}, {}], dtype=object), "an array of objects"),
        (np.array(None, dtype=object), "it holds no dict"),
        (np.zeros((4, 7)), "at least one joint"),
        (np.full((4, 9), np.nan), "no finite number"),
    ],
)
def test_wrong_files_are_told(held, said: str, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", held, allow_pickle=True)
    with pytest.raises(MotionError, match=said) as caught:
        read_motion(tmp_path / "a.npy")
    assert str(tmp_path / "a.npy") in str(caught.value)


def test_what_is_cut_off_or_said_wrongly_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, phuma())
    data = path.read_bytes()
    with pytest.raises(MotionError, match="those of phuma-npy, not those of amass-npy"):
        read_motion(path, layout="amass-npy")
    for length in (5, 60, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:length])
        with pytest.raises(MotionError, match=r"a\.npy: "):
            read_motion(path)
