"""Cleaned motions: nothing goes through anything, and little is changed."""

from pathlib import Path

import mesh_judge
import numpy as np
import product
import pytest
import record
import whole_motions
from whole_motions import STRETCHES, Made


@pytest.fixture(params=STRETCHES)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def test_nothing_goes_through_anything(made: Made, judge: mesh_judge.Robot):
    """By triangles, at all frames and midway between; before it did."""
    pairs = judge.pairs(np.zeros(len(judge.joints)))
    assert judge.penetrating(made.before.joints, pairs)
    assert not judge.penetrating(made.motion.joints, pairs)
    assert not judge.penetrating(made.motion.midway, pairs)


def test_limits_are_kept(made: Made, judge: mesh_judge.Robot, name: str):
    if name == "jumping jack":
        assert np.any(made.before.joints < judge.lower - 1e-3)
        assert np.any(made.before.joints > judge.upper + 1e-3)
    whole_motions.assert_within_limits(made.motion.joints, judge)


def test_it_is_what_it_says(made: Made):
    whole_motions.assert_written(made)


def test_layout_frames_and_root_stay(made: Made):
    assert made.motion.table.shape == made.before.table.shape
    np.testing.assert_allclose(made.motion.table[:, :7], made.before.table[:, :7])


def test_it_changes_no_more_than_it_did(made: Made, judge: mesh_judge.Robot, name: str):
    figures = whole_motions.figures_of_cleaned(made, judge)
    record.assert_no_worse("motions", name, figures, whole_motions.UNNOTICED)


def test_cleaned_twice_is_cleaned_once(made: Made, tmp_path: Path):
    again = tmp_path / made.out.name
    done = product.command(
        "clean", made.out, robot=product.HUMANOID, out=again, no_page=True
    )
    assert done.code == product.FINE
    assert again.read_bytes() == made.out.read_bytes()


FEW = "12:15"  # frames of the shipped motion: its hands are in each other


def test_what_changed_too_much_is_violated(humanoid: str, tmp_path: Path):
    done = product.command(
        "clean",
        product.ROBOT_MOTION,
        robot=humanoid,
        frames=FEW,
        at_most="joints=1deg",
        no_page=True,
        out=tmp_path / "few.csv",
    )
    assert done.code == product.VIOLATED and (tmp_path / "few.csv").is_file()
    assert done.out.splitlines()[-1].startswith(product.BROKEN)
    assert "joints" in done.out and "1 deg" in done.out


def test_before_it_is_violated_and_after_it_is_not(humanoid: str, tmp_path: Path):
    """By the product's own judge."""
    first, last = map(int, FEW.split(":"))
    lines = product.ROBOT_MOTION.read_text().splitlines(keepends=True)
    raw, out = tmp_path / "raw.csv", tmp_path / "clean.csv"
    raw.write_text("".join(lines[first - 1 : last]))
    done = product.command("judge", raw, robot=humanoid, jobs=1)
    assert done.code == product.VIOLATED
    assert done.out.splitlines()[-1].startswith(product.BROKEN)
    assert "left_rubber_hand - right_rubber_hand" in done.out
    done = product.command("clean", raw, robot=humanoid, no_page=True, out=out)
    assert done.code == product.FINE, done.out
    done = product.command("judge", out, robot=humanoid, certificate=True, jobs=1)
    assert done.code == product.FINE, done.out
    assert done.out.splitlines()[-1].startswith(product.HOLDS)


@pytest.mark.parametrize(
    "text, told",
    [
        ("1,2,3\n", ("columns",)),
        ("0,0,0.8,1,0,0,0" + 29 * ",nan" + "\n", ("nan", "1")),
        ("0,0,0.8,0,0,0,0" + 29 * ",0" + "\n", ("quaternion", "1")),
        ("0,0,0.8,1,0,0,0" + 23 * ",0" + 6 * ",400" + "\n", ("joint", "400")),
        ("", ("empty",)),
    ],
)
def test_what_is_no_motion_is_refused(
    humanoid: str, tmp_path: Path, text: str, told: tuple[str, ...]
):
    path, out = tmp_path / "bad.csv", tmp_path / "out.csv"
    path.write_text(text)
    done = product.command("clean", path, robot=humanoid, out=out, no_page=True)
    assert done.code == product.REFUSED and not out.exists()
    for word in ("bad.csv", *told):
        assert word in done.err, done.err
