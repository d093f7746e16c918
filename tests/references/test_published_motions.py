"""Motions that others published, in the folder that CRAR_ROBOT_MOTIONS names."""

import os
from pathlib import Path

import numpy as np
import pytest

from crar_drake.references.motion_files import read_motion, write_motions


@pytest.fixture(scope="module")
def folder() -> Path:
    name = os.environ.get("CRAR_ROBOT_MOTIONS", "")
    if not name:
        pytest.skip("set CRAR_ROBOT_MOTIONS to the folder of the robots' motions")
    return Path(name)


@pytest.mark.parametrize("name", ["dance.csv", "jumpjack.csv", "walk.csv"])
def test_csv(folder: Path, tmp_path: Path, name: str):
    read = read_motion(folder / name)
    assert read.layout == "wxyz-csv" and read.num_joints == 29 and read.rate == 30.0
    assert "wxyz: sure" in read.guesses[0]
    write_motions(tmp_path / name, [read], "wxyz-csv")
    before, after = (np.loadtxt(f / name, delimiter=",") for f in (folder, tmp_path))
    assert np.array_equal(before, after)


def test_npz(folder: Path, tmp_path: Path):
    name = "sub3_largebox_003_mj.npz"
    read = read_motion(folder / name)
    assert read.layout == "holosoma-npz" and read.rate == 50.0 and not read.guesses
    assert read.joint_names[3] == "left_knee_joint" and read.num_joints == 29
    write_motions(tmp_path / name, [read], "holosoma-npz")
    before, after = (np.load(f / name) for f in (folder, tmp_path))
    assert set(before.files) == set(after.files)
    for key in before.files:
        assert before[key].dtype == after[key].dtype
        assert np.array_equal(before[key], after[key])
