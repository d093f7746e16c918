"""Motions with known courses at other rates, and the commands that use it."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_biped import DEPTH_FIRST, biped, moving_samples, whole_biped

from crar_drake.commands import main
from crar_drake.errors import MotionError
from crar_drake.references.motion_files import read_motion, write_motions
from crar_drake.references.resampling import resampled, retimed
from crar_drake.references.robot_motion import RobotMotion


def course(rate: float, duration: float = 2.0, **changes) -> RobotMotion:
    """The same motion sampled at any rate; its root turns evenly about one axis."""
    t = np.arange(int(duration * rate + 1e-9) + 1) / rate
    turn = Rotation.from_rotvec(t[:, None] * [0.3, -0.4, 1.2])
    return RobotMotion(
        ("a", "b"),
        np.column_stack([np.sin(t), np.cos(2 * t), 0.8 + 0.1 * t]),
        turn.as_quat()[:, [3, 0, 1, 2]],
        np.column_stack([np.sin(3 * t), t**3]),
        rate,
        **changes,
    )


@pytest.mark.parametrize("rate", [50.0, 120.0, 20.0])
def test_samples_are_those_of_the_course(rate: float):
    made, left_out = resampled(course(30.0), rate)
    true = course(rate)
    assert made.rate == rate and made.num_frames == true.num_frames and not left_out
    np.testing.assert_allclose(made.root_positions, true.root_positions, atol=1e-5)
    np.testing.assert_allclose(made.joint_positions, true.joint_positions, atol=1e-5)
    np.testing.assert_allclose(made.joint_positions[:, 1], made.times**3, atol=1e-12)
    apart = (made.root_rotations * true.root_rotations.inv()).magnitude()
    assert apart.max() < 1e-5
    np.testing.assert_allclose(np.linalg.norm(made.root_quaternions, axis=1), 1.0)


def test_no_rate_to_change_and_none_that_is_other():
    given = course(30.0)
    assert resampled(given, 30.0)[0] is given
    with pytest.raises(MotionError, match="one frame"):
        resampled(course(30.0, 0.0), 50.0)


def test_signs_of_quaternions_do_not_matter():
    given = course(30.0)
    given.root_quaternions[7:20] *= -1.0
    made, _ = resampled(given, 60.0)
    apart = (made.root_rotations * course(60.0).root_rotations.inv()).magnitude()
    assert apart.max() < 1e-5


def test_rows_of_frames_are_left_out():
    given = course(30.0, extras={"mask": np.zeros(61), "names": ["x"]})
    made, left_out = resampled(given, 60.0)
    assert left_out == ("mask",) and list(made.extras) == ["names"]


def test_a_motion_slows_down_where_a_joint_is_too_fast_and_nowhere_else():
    """A joint swings at 1 rad/s but for a burst of 4 rad/s in the middle."""
    t = np.arange(241) / 30.0
    speed = 1.0 + 3.0 * np.exp(-(((t - 4.0) / 0.15) ** 2))
    q = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) / 30.0])
    given = RobotMotion(
        ("a", "b"),
        np.column_stack([q, 0.0 * q, 0.8 + 0.0 * q]),
        np.tile([1.0, 0.0, 0.0, 0.0], (241, 1)),
        np.column_stack([q, 0.5 * np.sin(q)]),
        30.0,
        extras={"contact": t < 4.0, "object": q[:, None], "names": ["x"]},
    )

    def speeds(motion):
        steps = np.diff(motion.joint_positions, axis=0)
        return np.abs(steps).max(axis=1) * 30.0 / 2.0

    made = retimed(given, speeds)
    new = made.joint_positions[:, 0]
    rates = np.diff(new) * 30.0
    assert rates.max() <= 2.0 and rates.max() > 1.8 and rates.min() > 0.0
    # The same configurations, in the same order, from the first to the last.
    np.testing.assert_allclose(made.joint_positions[:, 1], 0.5 * np.sin(new), atol=1e-3)
    np.testing.assert_allclose(made.root_positions[:, 0], new, atol=1e-9)
    np.testing.assert_allclose(new[[0, -1]], q[[0, -1]], atol=1e-9)
    # A second away from the burst it keeps its tempo.
    calm = new < q[90]
    np.testing.assert_allclose(rates[: calm.sum() - 1], 1.0, atol=0.02)
    # Slower by what the burst has beyond 2 rad/s at least, and by not much more.
    least = np.sum(np.maximum(speed / 2.0 - 1.0, 0.0)) / 30.0
    assert least < made.duration - given.duration < 5.0 * least
    # What has a row for each frame is that of the nearest.
    assert made.extras["names"] == ["x"]
    assert np.abs(made.extras["object"][:, 0] - new).max() < 0.5 * 4.0 / 30.0
    turns = np.flatnonzero(np.diff(made.extras["contact"].astype(int)))
    assert len(turns) == 1 and abs(new[turns[0]] - q[119]) < 2.5 / 30.0
    assert retimed(made, speeds) is made


# --- the commands -----------------------------------------------------------------


def test_convert(tmp_path: Path, capsys):
    p, Q, q = moving_samples(31)
    source, out = tmp_path / "a.csv", tmp_path / "b.npz"
    write_motions(source, [RobotMotion(DEPTH_FIRST, p, Q, q, 30.0)], "wxyz-csv")
    robot = str(biped(tmp_path / "biped"))
    given = ["convert", str(source), str(out), "--robot", robot]
    assert main([*given, "--to", "beyondmimic-npz", "--rate", "50"]) == 0
    told = capsys.readouterr().out
    assert "guessed: quaternions are wxyz" in told
    assert "51 frames at 50 Hz, 5 joints, from wxyz-csv to beyondmimic-npz" in told
    read = read_motion(out, robot=whole_biped(tmp_path / "biped"))
    assert read.rate == 50.0 and read.layout == "beyondmimic-npz"
    np.testing.assert_allclose(read.joint_positions[::5], q[::3], atol=1e-6)
    back = tmp_path / "c.csv"
    assert main(["convert", str(out), str(back), "--to", "xyzw-csv"]) == 2
    assert "--robot" in capsys.readouterr().err and not back.exists()
    assert main(["convert", str(source), str(out)]) == 2
    assert "say its layout with --to: beyondmimic-npz" in capsys.readouterr().err
    assert main(["convert", str(source), str(out), "--to", "gmr-pkl"]) == 2
    assert "gmr-pkl is a .pkl file" in capsys.readouterr().err
    given[given.index("--robot") :] = ["--to", "mjlab-npz", "--rate", "1e12"]
    assert main([*given, "--robot", robot]) == 2
    assert "the rate is 1e+12 Hz" in capsys.readouterr().err


def test_motion_tells_what_was_guessed(tmp_path: Path, capsys):
    p, Q, q = moving_samples(31)
    source, plot = tmp_path / "a.csv", tmp_path / "a.png"
    write_motions(source, [RobotMotion(DEPTH_FIRST, p, Q, q, 30.0)], "xyzw-csv")
    assert main(["show", str(source), "--out", str(plot)]) == 0
    told = capsys.readouterr().out
    for text in (
        "31 frames at 30 Hz, 1.00 s, 5 joints",
        "layout xyzw-csv",
        "guessed: quaternions are xyzw",
        "guessed: 30 Hz",
        "joints have no names",
        "nothing jumps",
    ):
        assert text in told
    assert plot.stat().st_size > 10_000
    assert main(["show", "dance", "--layout", "xyzw-csv"]) == 2
