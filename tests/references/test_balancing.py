"""Balanced motions of a small humanoid, judged by Drake's momentum."""

from dataclasses import replace

import numpy as np
import pytest
from small_biped import biped
from small_reference_robots import write_csv, write_robot
from small_walker import ANKLE_HEIGHT, HALF_WIDTH, HIP, SHANK, THIGH, walker

from crar_drake.commands import main
from crar_drake.commands.clean import balance_lines, violations
from crar_drake.errors import ModelError
from crar_drake.references import clean_file as clean_file_module
from crar_drake.references.balancing import Balancer
from crar_drake.references.certificate_files import read_certificate
from crar_drake.references.change import find_change
from crar_drake.references.clean_file import clean_file
from crar_drake.references.cleaning import Cleaner
from crar_drake.references.ground_support import (
    Ground,
    Support,
    given_share,
    worst_outside,
)
from crar_drake.references.motion_files import read_motion
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description

RATE, FRAMES = 30.0, 61
LEG = THIGH + SHANK  # [m]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walker")
    walker(folder, knee=0.06)
    return folder


@pytest.fixture(scope="module")
def made(folder):
    robot = WholeBody(load_robot_description(folder))
    ground = Ground(robot)
    return robot, ground, Balancer(Cleaner(robot.description, RATE), ground)


def standing(robot, joint: str, angle: np.ndarray) -> RobotMotion:
    """Both feet stand, legs straight; ankles turn to and fro by an angle (T,), by what
    of them: "pitch", the body leans with them, or "roll", the hips turn against them.

    The pelvis goes on a circle about the ankles.
    """
    q = np.zeros((len(angle), robot.n))
    p = np.zeros((len(angle), 3))
    turns = np.zeros((len(angle), 4))
    turns[:, 0] = 1.0
    for side in ("left", "right"):
        foot = {"pitch": "ankle", "roll": "foot"}[joint]
        q[:, robot.joint_names.index(f"{side}_{foot}_j")] = -angle
        if joint == "roll":
            q[:, robot.joint_names.index(f"{side}_hip_roll_j")] = angle
    arm = LEG + (0.0 if joint == "roll" else -HIP[2])
    height = ANKLE_HEIGHT + arm * np.cos(angle)
    if joint == "roll":
        p[:, 1], p[:, 2] = -arm * np.sin(angle), height - HIP[2]
    else:
        p[:, 0], p[:, 2] = arm * np.sin(angle), height
        turns[:, 0], turns[:, 2] = np.cos(0.5 * angle), np.sin(0.5 * angle)
    return RobotMotion(robot.joint_names, p, turns, q, RATE)


def lifting(robot) -> RobotMotion:
    """Both feet stand; from frame 30 on the left one rises by 6 cm in 0.2 s, the knee
    bent, and stays there, while all above stays midway between the feet."""
    angle = 0.4 * np.clip((np.arange(FRAMES) - 30.0) / 6.0, 0.0, 1.0)
    motion = standing(robot, "pitch", np.zeros(FRAMES))
    q = motion.joint_positions.copy()
    for joint, share in (("hip_pitch", -1.0), ("shank", 2.0), ("ankle", -1.0)):
        q[:, robot.joint_names.index(f"left_{joint}_j")] = share * angle
    return replace(motion, joint_positions=q)


def taking_over(robot) -> RobotMotion:
    """The left foot is in the air, 4 cm up, and from frame 30 on the right one, from
    one frame to the next, while all above stays midway between the feet."""
    motion = standing(robot, "pitch", np.zeros(FRAMES))
    q = motion.joint_positions.copy()
    for side, up in (("left", slice(0, 30)), ("right", slice(30, None))):
        for joint, share in (("hip_pitch", -1.0), ("shank", 2.0), ("ankle", -1.0)):
            q[up, robot.joint_names.index(f"{side}_{joint}_j")] = 0.32 * share
    return replace(motion, joint_positions=q)


def sway(size: float, frequency: float) -> np.ndarray:
    return size * np.sin(2.0 * np.pi * frequency * np.arange(FRAMES) / RATE)


def balanced(made, motion: RobotMotion) -> RobotMotion:
    return made[2].balance(motion, np.zeros((motion.num_frames, 0)))


def feet(robot, motion: RobotMotion) -> np.ndarray:
    p, _ = robot.poses_in_root(motion.joint_positions, ("left_foot", "right_foot"))
    R = motion.root_rotations.as_matrix()
    return motion.root_positions[:, None] + np.einsum("tij,tlj->tli", R, p)


def test_the_motions_of_these_tests_stand(made):
    robot, ground, _ = made
    for motion in (
        standing(robot, "roll", sway(0.15, 1.0)),
        standing(robot, "pitch", sway(0.1, 0.5)),
    ):
        assert np.ptp(feet(robot, motion), axis=0).max() < 1e-9
        support = ground.support(motion)
        np.testing.assert_array_equal(np.flatnonzero(~support.stands), [0, FRAMES - 1])
        np.testing.assert_allclose(support.floor, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    "joint, angle",
    [
        ("roll", sway(0.15, 1.2)),  # 10 cm to and fro, too fast
        ("pitch", sway(0.1, 1.0)),
        ("pitch", np.full(FRAMES, 0.23)),  # at rest, beyond the toes
    ],
)
def test_what_leaves_the_soles_comes_back_inside(made, joint, angle):
    robot, ground, _ = made
    motion = standing(robot, joint, angle)
    was = ground.outside(motion)
    assert given_share(was) < 0.7 and worst_outside(was) > 0.02
    found = balanced(made, motion)
    now = ground.outside(found)
    assert given_share(now) == 1.0 and worst_outside(now) < 0.0
    change = find_change(motion, found, robot)
    assert change.feet_worst < 2e-3
    assert 0.0 < change.root_worst < 0.15


def test_what_the_ground_could_give_comes_back_to_the_last_bit(made):
    robot, ground, _ = made
    motion = standing(robot, "roll", sway(0.05, 0.4))
    assert worst_outside(ground.outside(motion)) < -0.02
    found = balanced(made, motion)
    for name in ("root_positions", "root_quaternions", "joint_positions"):
        np.testing.assert_array_equal(getattr(found, name), getattr(motion, name))


def test_a_second_away_from_it_a_motion_stays_to_the_last_bit(made):
    robot, ground, _ = made
    still = np.zeros(60)
    bump = 0.15 * np.sin(np.linspace(0.0, np.pi, 12)) ** 2
    motion = standing(robot, "pitch", np.concatenate([still, bump, still]))
    found = balanced(made, motion)
    same = (found.joint_positions == motion.joint_positions).all(axis=1)
    assert same[:30].all() and same[-30:].all() and not same[60:72].any()
    assert given_share(ground.outside(found)) > given_share(ground.outside(motion))


def test_a_foot_is_lifted_once_the_other_balances(made):
    robot, ground, _ = made
    motion = lifting(robot)
    _, (before,) = ground.judged(motion)
    assert before.foot == "left_foot" and 30 <= before.frame <= 36
    # Midway is 9 cm from the right foot's middle, and it is 6 cm wide.
    assert before.outside == pytest.approx(HIP[1] - HALF_WIDTH, abs=0.02)
    found = balanced(made, motion)
    outside, (lift,) = ground.judged(found)
    assert lift.foot == "left_foot" and abs(lift.frame - before.frame) <= 1
    assert lift.outside < 0.0 and np.nanmax(outside) < 0.0
    # And stays to the last bit, if it is balanced again.
    again = balanced(made, found)
    np.testing.assert_array_equal(again.joint_positions, found.joint_positions)


def test_one_frame_comes_back(made):
    robot, _, balancer = made
    motion = standing(robot, "pitch", np.zeros(FRAMES))
    arrays = ("root_positions", "root_quaternions", "joint_positions")
    one = replace(motion, **{name: getattr(motion, name)[:1] for name in arrays})
    assert balancer.balance(one, np.zeros((1, 0))) is one


def test_no_spline_is_asked_where_one_foot_takes_over_from_the_other(made):
    """Centres of pressure leap from sole to sole there."""
    robot, ground, balancer = made
    motion = taking_over(robot)
    support = ground.support(motion)
    y = np.zeros((FRAMES, 6 + robot.n))
    nothing = np.zeros((FRAMES, 0))
    wide = balancer.problem(motion, support, nothing, y).wide
    frames, row = wide.rows(np.arange(FRAMES), y).places
    of_spline = row >= wide.num_rows // 2
    np.testing.assert_array_equal(np.unique(frames[~of_spline]), np.arange(1, 60))
    expected = np.setdiff1d(np.arange(2, 59), [29, 30])
    np.testing.assert_array_equal(np.unique(frames[of_spline]), expected)


def test_what_goes_on_beside_flights_and_where_feet_take_over():
    left = np.array([1, 1, 0, 0, 1, 1, 0, 0, 1, 1], dtype=bool)
    right = np.array([0, 1, 1, 1, 0, 0, 0, 1, 1, 0], dtype=bool)
    support = Support(
        np.zeros(10),
        {foot: np.zeros((10, 1, 3)) for foot in ("left_foot", "right_foot")},
        {"left_foot": left, "right_foot": right},
    )
    expected = np.array([1, 1, 1, 0, 0, 1, 1, 1, 1, 1], dtype=bool)
    np.testing.assert_array_equal(support.goes_on, expected)


def test_what_carries_where_a_foot_is_lifted():
    """The right foot alone in the last frame of the left one; both, where it was set
    down in that frame only, and where none goes on."""
    left = np.array([1, 1, 1, 0, 0, 1, 0, 1, 0], dtype=bool)
    right = np.array([0, 1, 1, 1, 1, 0, 1, 1, 0], dtype=bool)
    support = Support(
        np.zeros(9),
        {foot: np.zeros((9, 1, 3)) for foot in ("left_foot", "right_foot")},
        {"left_foot": left, "right_foot": right},
    )
    stays = support.stays
    expected = np.array([1, 1, 0, 0, 0, 1, 0, 1, 0], dtype=bool)
    np.testing.assert_array_equal(stays["left_foot"], expected)
    np.testing.assert_array_equal(stays["right_foot"], right)


def test_flights_are_left_as_they_are(made):
    robot, ground, _ = made
    motion = standing(robot, "pitch", sway(0.3, 2.0))
    away = np.linspace(0.0, 4.0, FRAMES)[:, None] * [1.0, 0.0, 0.0]  # 2 m/s
    motion = replace(motion, root_positions=motion.root_positions + away)
    outside = ground.outside(motion)
    assert np.isnan(outside).all() and np.isnan(given_share(outside))
    found = balanced(made, motion)
    np.testing.assert_array_equal(found.joint_positions, motion.joint_positions)


def test_who_needs_no_ground_or_has_no_soles_is_told(tmp_path):
    robot = WholeBody(load_robot_description(write_robot(tmp_path)))
    with pytest.raises(ModelError, match="base is fixed"):
        Ground(robot)
    place = biped(tmp_path / "biped")
    text = (place / "robot.yaml").read_text()
    frames = "task_frames: {left_foot: left_shin, right_foot: right_shin}\n"
    assert frames in text
    text = text.replace(frames, "root: prescribed\n")
    (place / "robot.yaml").write_text(text)
    with pytest.raises(ModelError, match="no foot has a shape"):
        Ground(WholeBody(load_robot_description(place)))


def test_a_lift_that_is_not_balanced_is_a_violation_by_name(
    made, folder, tmp_path, capsys, monkeypatch
):
    """As of a motion that nothing could balance."""
    robot, ground, _ = made
    motion, out = lifting(robot), tmp_path / "out.csv"
    path = written(tmp_path / "lifting.csv", motion)
    monkeypatch.setattr(Balancer, "balance", lambda self, motion, *_: motion)
    given = ["clean", str(path), "--robot", str(folder), "--layout", "wxyz-csv"]
    assert main([*given, "--out", str(out), "--no-page", "--balance"]) == 1
    (lift,) = ground.judged(motion)[1]
    which = f"left_foot in frame {lift.frame + 1} ({1e3 * lift.outside:.1f} mm)"
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == f"VIOLATED: 1 lift of a foot not balanced on what stays: {which}"
    (clip,) = clean_file(path, out, str(folder), layout="wxyz-csv", balance=True)
    assert clip.violated and clip.lifts_outside == 1
    # Of several motions it says how many.
    assert violations([clip, replace(clip, lifts_outside=0)]) == [
        "1 lift of a foot not balanced on what stays"
    ]


def written(path, motion: RobotMotion):
    write_csv(path, motion.joint_positions)
    rows = np.loadtxt(path, delimiter=",")
    rows[:, :3], rows[:, 3:7] = motion.root_positions, motion.root_quaternions
    np.savetxt(path, rows, delimiter=",", fmt="%.10g")
    return path


def test_the_command_says_of_which_lifts_and_frames(made, folder, tmp_path, capsys):
    robot, ground, _ = made
    motion, out = lifting(robot), tmp_path / "out.csv"
    path = written(tmp_path / "lifting.csv", motion)
    given = ["clean", str(path), "--robot", str(folder), "--layout", "wxyz-csv"]
    assert main([*given, "--out", str(out), "--no-page", "--balance"]) == 0
    said = capsys.readouterr().out
    assert "balance: 1 lift of a foot, all balanced on the other" in said
    assert "outside in frames" not in said
    note = read_certificate(tmp_path / "out.certificate.json")["notes"][""]
    assert note.endswith("; 1 lift of a foot")
    # What it says of the motion as it was: that it stands on one foot to the end.
    (clip,) = clean_file(path, out, str(folder), layout="wxyz-csv", balance=True)
    clip = replace(clip, **clean_file_module._ground_shares(ground, motion, motion))
    outside, (lift,) = ground.judged(motion)
    worst = 1e3 * outside[lift.frame + 1 : -1].max()
    frames = f"outside in frames {lift.frame + 2}-{FRAMES - 1} ({worst:.1f} mm)"
    which = f"left_foot in frame {lift.frame + 1} ({1e3 * lift.outside:.1f} mm)"
    assert balance_lines(clip)[1:] == [
        f"balance: {frames}",
        f"balance: 1 lift of a foot, of which 1 not balanced on the other: {which}",
    ]
    note = clean_file_module._note_of_balance(clip)
    words = f"; {frames}; 1 lift of a foot, not balanced on what stays planted: {which}"
    assert note.endswith(words)


def test_the_command_says_what_became_of_it(made, folder, tmp_path, capsys):
    robot, ground, _ = made
    motion = standing(robot, "pitch", sway(0.1, 1.0))
    path = written(tmp_path / "sway.csv", motion)
    out = tmp_path / "out.csv"
    given = ["clean", str(path), "--robot", str(folder), "--layout", "wxyz-csv"]
    given += ["--out", str(out), "--no-page"]
    assert main([*given, "--balance"]) == 0
    said = capsys.readouterr().out
    kept = read_motion(out, "wxyz-csv", None, robot=robot)
    shares = [given_share(ground.outside(m)) for m in (motion, kept)]
    assert shares[0] < 0.7 and shares[1] == 1.0
    assert f"{100 * shares[0]:.0f} % and 100 % of the frames that stand" in said
    certificate = read_certificate(tmp_path / "out.certificate.json")
    assert certificate["options"]["balance"] is True
    note = certificate["notes"][""]
    assert "in 1.0000 of the 59 frames" in note and "by the change of momentum" in note
    judged = ["judge", str(out), "--robot", str(folder), "--layout", "wxyz-csv"]
    assert main([*judged, "--certificate"]) == 0
    capsys.readouterr()
    assert main(given) == 0
    assert "balance" not in capsys.readouterr().out
