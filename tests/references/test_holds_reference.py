"""CSV and NPZ files hold robot motions, or the points of a person: told by contents."""

import numpy as np
import pytest

from crar_drake.motion.robots_own import holds_reference


@pytest.mark.parametrize(
    "name, text, is_one",
    [
        ("a.csv", "0.1,0.2,0.8,1,0,0,0,0.5\n", True),
        ("a.csv", "time,head_x,head_y,head_z\n0,1,2,3\n", False),
        ("a.csv", "", False),
        ("a.npz", "no archive", False),
        ("a.pkl", "read with care, whatever is in it", True),
        ("a.amc", ":FULLY-SPECIFIED", False),
    ],
)
def test_texts(tmp_path, name, text, is_one):
    (tmp_path / name).write_text(text)
    assert holds_reference(tmp_path / name) is is_one
    assert not holds_reference(tmp_path / "not_there.csv")


def test_archives(tmp_path):
    path = tmp_path / "motion.npz"
    np.savez(path, positions=np.zeros((3, 17, 3)))
    assert not holds_reference(path)
    np.savez(path, joint_pos=np.zeros((3, 29)), fps=50)
    assert holds_reference(path)
