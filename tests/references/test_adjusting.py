"""Motions trimmed, set on the ground, and held to how far they may change."""

from dataclasses import replace

import numpy as np
import pytest
from small_biped import FOOT, link_poses, moving_samples, whole_biped
from small_reference_robots import YAML, reaching, write_csv, write_robot
from small_walker import HEIGHT, walker

from crar_drake.commands import main
from crar_drake.errors import ModelError, MotionError
from crar_drake.references.certificate_files import certificate_path, read_certificate
from crar_drake.references.change import AtMost
from crar_drake.references.clean_file import clean_file, set_on_ground
from crar_drake.references.ground_contact import Outline
from crar_drake.references.motion_certificate import check_certificate
from crar_drake.references.motion_files import write_motions
from crar_drake.references.robot_motion import RobotMotion, trimmed
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description


@pytest.fixture(scope="module")
def reach(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reach")
    write_robot(folder)
    return folder, write_csv(folder / "reach.csv", reaching(24, 30.0, 1.0))


def table(path):
    return np.loadtxt(path, delimiter=",")


def test_only_these_frames_are_written_and_certified(reach, tmp_path):
    robot, reference = reach
    out = tmp_path / "part.csv"
    (row,) = clean_file(reference, out, str(robot), frames=(5, 20))
    assert row.frames == 16 and not row.violated
    np.testing.assert_array_equal(table(out)[:, :7], table(reference)[4:20, :7])
    certificate = read_certificate(certificate_path(out))
    assert certificate["options"]["frames"] == [5, 20]
    assert len(certificate["clips"][0]["frames"]["distance"]) == 16
    assert check_certificate(out, certificate, load_robot_description(robot)).holds
    (row,) = clean_file(reference, tmp_path / "end.csv", str(robot), frames=(23, 99))
    assert row.frames == 2
    np.testing.assert_array_equal(table(tmp_path / "end.csv"), table(reference)[22:])
    with pytest.raises(MotionError, match="has 24 frames, .* from 25 on"):
        clean_file(reference, tmp_path / "no.csv", str(robot), frames=(25, None))
    assert not (tmp_path / "no.csv").exists()


def test_a_motion_that_is_too_fast_is_slowed_down(tmp_path, capsys):
    """Through 0.2 s a joint would need 9.4 rad/s, of 6 that it has."""
    write_robot(tmp_path)
    joints = np.tile([0.0, -0.3, 0.1], (61, 1))
    joints[:, 0] = -0.9 + 0.6 * np.clip((np.arange(61) - 27.0) / 6.0, 0.0, 1.0)
    joints[28:33, 0] = -0.9 + 0.3 * (1 - np.cos(np.pi * np.arange(1, 6) / 6.0))
    joints[:, 0] *= 2.0
    fast = write_csv(tmp_path / "fast.csv", joints)
    (lags,) = clean_file(fast, tmp_path / "lags.csv", str(tmp_path))
    assert lags.too_fast_before > 0 and lags.joints_worst > 0.05 and not lags.slowed
    out = tmp_path / "slowed.csv"
    command = ["clean", str(fast), "--robot", str(tmp_path), "--out", str(out)]
    assert main([*command, "--retime"]) == 0
    assert "slowed down: it takes" in capsys.readouterr().out
    slowed = table(out)[:, 7:]
    assert len(slowed) > 61
    assert np.abs(np.diff(slowed, axis=0)).max() * 30.0 <= 6.0
    np.testing.assert_allclose(slowed[:, 1:], np.tile([-0.3, 0.1], (len(slowed), 1)))
    np.testing.assert_allclose(slowed[[0, -1]], joints[[0, -1]], atol=1e-9)
    certificate = read_certificate(certificate_path(out))
    assert certificate["options"]["retime"]
    assert check_certificate(out, certificate, load_robot_description(tmp_path)).holds


def motion_with_object(frames=12):
    p, Q, q = moving_samples(frames)
    return RobotMotion(
        joint_names=("left_hip", "left_knee", "right_hip", "right_knee", "waist"),
        root_positions=p,
        root_quaternions=Q,
        joint_positions=q,
        rate=30.0,
        layout="holosoma-npz",
        precision="float64",
        extras={
            "object_pos_w": np.arange(3.0 * frames).reshape(frames, 3),
            "contact": np.arange(frames) % 2 == 0,
            "body_names": np.array(["pelvis"] * frames),  # no row a frame
            "gravity": np.array([0.0, 0.0, -9.81]),
        },
    ).as_read()


def test_what_has_a_row_a_frame_is_trimmed_with_them():
    motion = motion_with_object()
    part = trimmed(motion, (3, 7))
    for key in ("object_pos_w", "contact"):
        np.testing.assert_array_equal(part.extras[key], motion.extras[key][2:7])
    assert len(part.extras["body_names"]) == 12 and len(part.extras["gravity"]) == 3
    np.testing.assert_array_equal(part.joint_positions, motion.joint_positions[2:7])
    assert not part.is_as_read and trimmed(motion, (1, 12)) is motion


def test_the_feet_stand_on_the_ground_and_objects_rise_with_the_robot(tmp_path):
    """The floor is where the feet are in the lowest tenth of the frames, by hand."""
    outline = Outline(whole_biped(tmp_path / "biped"))
    motion = motion_with_object(200)

    def feet(of):
        heights = []
        for p, R, q in zip(
            of.root_positions,
            of.root_rotations.as_matrix(),
            of.joint_positions,
            strict=True,
        ):
            poses = link_poses(q)
            ends = (poses[f"{side}_shin"] for side in ("left", "right"))
            balls = [p + R @ (at + turn.apply([0, 0, -0.4])) for at, turn in ends]
            heights.append(min(ball[2] for ball in balls) - FOOT)
        return np.quantile(heights, 0.1)

    stands, rise = set_on_ground(motion, outline)
    assert abs(feet(motion)) > 0.05
    assert rise == pytest.approx(-feet(motion), abs=1e-9)
    assert feet(stands) == pytest.approx(0.0, abs=1e-9)
    moved = stands.extras["object_pos_w"] - motion.extras["object_pos_w"]
    np.testing.assert_allclose(moved, np.tile([0, 0, rise], (200, 1)), atol=1e-12)
    assert stands.extras["contact"] is motion.extras["contact"]
    assert set_on_ground(stands, outline) == (stands, 0.0)


def test_a_motion_on_the_ground_stays_as_it_is(tmp_path):
    """The walker stands straight, its pelvis HEIGHT above its soles, and too high."""
    robot = walker(tmp_path)
    names = WholeBody(robot).joint_names
    p = np.tile([0.3, 0.2, HEIGHT + 0.12], (12, 1))
    p[:, 0] += np.linspace(0.0, 0.5, 12)
    motion = RobotMotion(
        joint_names=names,
        root_positions=p,
        root_quaternions=np.tile([1.0, 0.0, 0.0, 0.0], (12, 1)),
        joint_positions=np.zeros((12, len(names))),
        rate=30.0,
    )
    first, again = tmp_path / "a" / "calm.csv", tmp_path / "b" / "calm.csv"
    write_motions(tmp_path / "calm.csv", [motion], "wxyz-csv")
    (row,) = clean_file(tmp_path / "calm.csv", first, str(tmp_path), ground=True)
    assert row.raised == pytest.approx(-0.12, abs=1e-9) and row.changed == 0
    p[:, 2] = HEIGHT
    np.testing.assert_allclose(table(first)[:, :3], p, atol=1e-9)
    (row,) = clean_file(first, again, str(tmp_path), ground=True)
    assert row.raised == 0.0 and again.read_bytes() == first.read_bytes()


def test_what_a_robot_lacks_is_told_before_anything_is_read(reach, tmp_path):
    robot, _ = reach
    none = tmp_path / "none.csv"
    with pytest.raises(ModelError, match="no task_frames left_hand and right_hand"):
        clean_file(none, tmp_path / "o.csv", str(robot), at_most=AtMost(hands=0.1))
    footless = write_robot(tmp_path)
    text = YAML.replace("task_frames: {left_foot: tip}\n", "")
    (footless / "robot.yaml").write_text(text)
    with pytest.raises(ModelError, match="no foot has a shape"):
        clean_file(none, tmp_path / "o.csv", str(footless), ground=True)


def test_a_motion_that_changed_by_more_violates_that_and_is_written(
    reach, tmp_path, capsys
):
    robot, reference = reach
    out = tmp_path / "out.csv"
    (free,) = clean_file(reference, out, str(robot))
    change = np.abs(table(out) - table(reference))[:, 7:].max()
    for share, exceeded in ((1.01, False), (0.99, True)):
        limits = f"joints={np.degrees(share * change)}deg,feet=10m"
        arguments = ["clean", str(reference), "--robot", str(robot), "--no-page"]
        arguments += ["--out", str(out), "--at-most", limits]
        assert main(arguments) == exceeded
        said = capsys.readouterr().out
        assert ("VIOLATED: changed: joints by" in said) is exceeded
        assert (f"joints by {np.degrees(change):.1f} deg" in said) is exceeded
    assert out.is_file() and not free.exceeded
    most = AtMost(joints=0.9 * change, feet=0.5 * free.feet_worst)
    assert most.exceeded(free).count("allowed") == 2
    assert not most.exceeded(replace(free, joints_worst=0.0, feet_worst=np.nan))


@pytest.mark.parametrize(
    "option, text, told",
    [
        ("--at-most", "joints=15", "in deg or rad"),
        ("--at-most", "feet=3deg", "in mm or cm or m"),
        ("--at-most", "feet=-3mm", "'-3' is not a positive number"),
        ("--at-most", "knees=3deg", "how far joints, feet and hands"),
        ("--at-most", "feet=3mm,feet=2mm", "once each"),
        ("--frames", "7", "are no frames"),
        ("--frames", "0:5", "counted from 1"),
        ("--frames", "5:4", "are no frames"),
    ],
)
def test_bad_options_are_told(option, text, told, capsys):
    assert main(["clean", "a.csv", "--robot", "b", f"{option}={text}"]) == 2
    assert told in capsys.readouterr().err
