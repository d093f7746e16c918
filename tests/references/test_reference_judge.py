"""Motions of a small robot whose penetrations, limits and heights are known."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_biped import (
    DEPTH_FIRST,
    FOOT,
    HIP,
    LIMIT,
    SHIN,
    SPEED,
    THIGH,
    biped,
    whole_biped,
)

from crar_drake.commands import main
from crar_drake.references.motion_files import write_motions
from crar_drake.references.reference_judge import ReferenceJudge, Tolerances
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.verdict_report import verdict_lines
from crar_drake.robot.description import load_robot_description

LEG = THIGH + SHIN
STANDING = LEG + FOOT  # height of the root [m]


def crossing(frames: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """(T, 5) joints that bring the feet into each other, and their distance [m]."""
    s = 0.12 * np.sin(np.linspace(0.0, np.pi, frames))
    joints = np.zeros((frames, 5))
    joints[:, 0], joints[:, 2] = -s, s
    return joints, 2.0 * (HIP - LEG * np.sin(s)) - 2.0 * FOOT


def motion(joints: np.ndarray, height: float = STANDING, rate: float = 30.0):
    root = np.tile([0.0, 0.0, height], (len(joints), 1))
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(joints), 1))
    return RobotMotion(DEPTH_FIRST, root, upright, joints, rate)


@pytest.fixture(scope="module")
def judge(tmp_path_factory) -> ReferenceJudge:
    folder = biped(tmp_path_factory.mktemp("biped"))
    return ReferenceJudge(load_robot_description(folder))


def test_capsules_that_penetrate(judge: ReferenceJudge):
    joints, distance = crossing()
    verdict = judge.judge(motion(joints))
    (pair,) = verdict.capsules
    assert pair.pair == ("left_shin", "right_shin")
    bad = np.flatnonzero(distance < 0.0)
    assert 3 < len(bad) < 20 and pair.frames == list(bad)
    np.testing.assert_allclose(pair.depths, -distance[bad], atol=1e-9)
    assert pair.frame == distance.argmin()
    near = distance < 0.05
    np.testing.assert_allclose(
        verdict.capsule_distances[near], distance[near], atol=1e-9
    )
    assert np.isnan(verdict.capsule_distances[~near]).all()
    assert verdict.violations == ("capsules penetrate",)
    assert verdict.meshes is None


def test_the_root_does_not_matter_to_collisions(judge: ReferenceJudge):
    joints, _ = crossing()
    still = judge.judge(motion(joints))
    moved = motion(joints)
    turned = np.tile([0.6, 0.0, 0.8, 0.0], (len(joints), 1))
    far = moved.root_positions + [5.0, 3.0, 1.0]
    there = judge.judge(replace(moved, root_quaternions=turned, root_positions=far))
    assert there.capsules == still.capsules


def test_limits_and_speeds(judge: ReferenceJudge):
    joints = np.zeros((40, 5))
    joints[:, 4] = (LIMIT + 0.1) * np.sin(np.linspace(0.0, np.pi, 40)) ** 2
    verdict = judge.judge(motion(joints))
    (limit,) = verdict.limits
    assert limit.joint == "waist"
    assert limit.frames == tuple(np.flatnonzero(joints[:, 4] > LIMIT + 1e-6))
    assert limit.excess == pytest.approx(joints[:, 4].max() - LIMIT)
    assert verdict.violations == ("joint limits",)
    # The same, so fast that it is as fast as the limit allows in its fastest step only.
    joints[:, 4] *= 0.9
    step = np.abs(np.diff(joints[:, 4])).max()
    assert not judge.judge(motion(joints, rate=0.999 * SPEED / step)).speeds
    (speed,) = judge.judge(motion(joints, rate=1.001 * SPEED / step)).speeds
    assert speed.joint == "waist" and speed.excess == pytest.approx(0.001 * SPEED)


def test_ground(judge: ReferenceJudge):
    joints = np.zeros((20, 5))
    verdict = judge.judge(motion(joints, STANDING - 0.02))
    np.testing.assert_allclose(verdict.ground.lowest, -0.02, atol=1e-9)
    assert verdict.ground.floor == pytest.approx(-0.02)
    assert verdict.ground.lowest_links[verdict.ground.lowest.argmin()] in (
        "left_shin",
        "right_shin",
    )
    assert verdict.violations == ("below the ground",)
    lenient = Tolerances(below_ground=0.03)
    assert (
        judge.judge(motion(joints, STANDING - 0.02), tolerances=lenient).violations
        == ()
    )


@pytest.mark.parametrize("height", [4.0, 84.0])
def test_a_motion_that_is_nowhere_near_the_ground(judge: ReferenceJudge, height):
    verdict = judge.judge(motion(np.zeros((20, 5)), STANDING + height))
    assert verdict.violations == ("never on the ground",)
    # A jump is none, nor is one that lands.
    flight = motion(np.zeros((20, 5)), STANDING + 0.4)
    assert judge.judge(flight).violations == ()


def test_feet_stand_although_the_motion_floats(judge: ReferenceJudge):
    joints = np.zeros((20, 5))
    sliding = motion(joints, STANDING + 0.04)
    way = np.linspace(0.0, 0.05, 20)  # 0.08 m/s
    sliding.root_positions[:, 1] = way
    verdict = judge.judge(sliding, tolerances=Tolerances(slip=0.04))
    assert [foot.foot for foot in verdict.ground.feet] == ["left_foot", "right_foot"]
    for foot in verdict.ground.feet:
        assert foot.planted.all() and foot.num_contacts == 1
        assert foot.total == pytest.approx(0.05) and foot.worst == foot.total
        assert foot.top_speed == pytest.approx(0.05 / 19 * 30)
    assert verdict.violations == ("feet slip",)


def test_a_jump(judge: ReferenceJudge):
    joints = np.zeros((20, 5))
    joints[9:, 1] = 0.1
    root = motion(joints, rate=200.0)
    root.root_positions[14:, 0] = 0.03
    verdict = judge.judge(root)
    told = [(jump.what, jump.frame, round(jump.size, 9)) for jump in verdict.jumps]
    assert told == [("left_knee", 9, 0.1), ("root position", 14, 0.03)]
    assert {"jumps", "speed limits"} <= set(verdict.violations)
    # Steady motion, however fast, does not jump.
    joints[:, 1] = np.linspace(-1.9, 1.9, 20)
    assert judge.judge(motion(joints, rate=200.0)).jumps == ()


def test_jerk_of_a_cubic(judge: ReferenceJudge):
    joints = np.zeros((20, 5))
    t = np.arange(20) / 50.0
    joints[:, 3] = 7.0 * t**3
    verdict = judge.judge(motion(joints, rate=50.0))
    assert verdict.peak_jerk == pytest.approx(42.0) and verdict.peak_jerk_joint == (
        "right_knee"
    )
    assert verdict.rms_jerk == pytest.approx(42.0 / np.sqrt(5.0))


def test_how_the_root_accelerates(judge: ReferenceJudge):
    """Of a throw: as things fall; of a stop at one frame: by all its speed."""
    t = np.arange(21) / 50.0
    thrown = motion(np.zeros((21, 5)), rate=50.0)
    thrown.root_positions[:, 0] += 2.0 * t
    thrown.root_positions[:, 2] += 3.0 * t - 0.5 * 9.81 * t**2
    assert judge.judge(thrown).root_acceleration == pytest.approx((9.81, 9.81))
    stopped = motion(np.zeros((21, 5)), rate=50.0)
    stopped.root_positions[:, 1] += 2.0 * np.minimum(t, t[10])
    rms, peak = judge.judge(stopped).root_acceleration
    assert peak == pytest.approx(100.0) and rms == pytest.approx(100.0 / np.sqrt(19.0))


# --- meshes -----------------------------------------------------------------------

CUBE = "".join(
    f"v {x} {y} {z}\n" for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)
) + "".join(
    f"f {a} {b} {c}\nf {a} {c} {d}\n"
    for a, b, c, d in (
        *((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2)),
        *((3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)),
    )
)
INERTIA = (
    '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
    'iyz="0"/></inertial>'
)


def test_meshes_that_penetrate(tmp_path: Path):
    """A cube of 0.2 on a slide and a lift, 0.3 beside another."""
    (tmp_path / "cube.obj").write_text(CUBE)
    cube = '<visual><geometry><mesh filename="cube.obj"/></geometry></visual>'
    links = "".join(
        f'<link name="{name}">{INERTIA}{shape}</link>'
        for name, shape in (("stand", cube), ("carriage", ""), ("block", cube))
    )
    joints = "".join(
        f'<joint name="{name}" type="prismatic"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="{xyz}"/><axis xyz="{axis}"/>'
        '<limit lower="-1" upper="1" effort="9" velocity="9"/></joint>'
        for name, parent, child, xyz, axis in (
            ("slide", "stand", "carriage", "0 0.3 0", "0 1 0"),
            ("lift", "carriage", "block", "0 0 0", "0 0 1"),
        )
    )
    (tmp_path / "slides.urdf").write_text(f'<robot name="s">{links}{joints}</robot>')
    (tmp_path / "robot.yaml").write_text(
        "name: slides\nmodel: slides.urdf\nbase: stand\n"
    )
    judge = ReferenceJudge(load_robot_description(tmp_path))
    q = np.zeros((9, 2))
    q[:, 0] = [0.0, -0.05, -0.09, -0.12, -0.15, -0.12, -0.09, -0.05, 0.0]
    n = len(q)
    upright = np.tile([1.0, 0, 0, 0], (n, 1))
    given = RobotMotion(("slide", "lift"), np.ones((n, 3)), upright, q, 30.0)
    verdict = judge.judge(given)
    (pair,) = verdict.mesh_pairs
    assert pair.pair == ("stand", "block") and pair.frames == [3, 4, 5]
    np.testing.assert_allclose(pair.depths, [0.02, 0.05, 0.02], atol=2e-5)
    np.testing.assert_allclose(verdict.mesh_depths()[[2, 4]], [0.0, 0.05], atol=2e-5)
    assert verdict.capsules is None and verdict.violations == ("meshes penetrate",)
    sparse = judge.judge(given, every=4 / 30.0)
    assert sparse.meshes.frames.tolist() == [0, 4, 8]
    assert sparse.penetrating_frames == (4,)


# --- the command ------------------------------------------------------------------


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A folder with a clean motion, one that penetrates, and one that is cut off."""
    folder = tmp_path / "motions"
    folder.mkdir()
    robot = whole_biped(tmp_path / "biped")
    still = motion(np.zeros((12, 5)))
    write_motions(folder / "clean.csv", [still], "wxyz-csv")
    write_motions(folder / "bad.pkl", [motion(crossing()[0])], "gmr-pkl", robot)
    (folder / "cut.npz").write_bytes(b"PK\x03\x04")
    return folder


def test_one_file_and_its_exit_code(files: Path, tmp_path: Path, capsys):
    robot = ["--robot", str(tmp_path / "biped")]
    assert main(["judge", str(files / "clean.csv"), *robot]) == 0
    told = capsys.readouterr().out
    assert (
        "guessed: quaternions are wxyz" in told
        and "\n  clean\nOK; guessed: quaternions are wxyz, 30 Hz" in told
    )
    assert main(["judge", str(files / "bad.pkl"), *robot]) == 1
    told = capsys.readouterr().out
    assert "left_shin - right_shin" in told and "VIOLATED: capsules penetrate" in told
    assert main(["judge", str(files / "clean.csv")]) == 2
    assert "--robot" in capsys.readouterr().err
    assert main(["judge", str(files / "missing.csv"), *robot]) == 2
    assert "no such file" in capsys.readouterr().err


def test_a_folder_with_a_bad_file(
    files: Path, tmp_path: Path, capsys, no_new_processes
):
    out = tmp_path / "out"
    given = ["judge", str(files), "--robot", str(tmp_path / "biped"), "--jobs", "1"]
    assert main([*given, "--out", str(out)]) == 1
    told = capsys.readouterr().out
    assert "2 motions: 1 with a violation, 1 clean; 1 files cannot be used" in told
    data = json.loads((out / "judge.json").read_text())
    assert [Path(m["file"]).name for m in data["motions"]] == ["bad.pkl", "clean.csv"]
    bad = data["motions"][0]
    _, distance = crossing()
    assert (
        bad["capsules"]["penetrating_frames"] == np.flatnonzero(distance < 0).tolist()
    )
    assert [Path(u["file"]).name for u in data["unusable"]] == ["cut.npz"]
    assert (out / "bad.pkl.png").stat().st_size > 10_000
    # Nothing is violated, but a file cannot be used.
    (files / "bad.pkl").unlink()
    assert main(given) == 2


def test_a_frame_is_one_and_no_height_is_minus_zero(judge: ReferenceJudge):
    joints = np.zeros((10, 5))
    joints[4, 0] = LIMIT + 0.1
    told = "\n".join(verdict_lines(judge.judge(motion(joints, STANDING - 1e-5))))
    assert "joint limits: 1 frame beyond" in told and ": 1 frame (5), by up to" in told
    assert "ground: lowest 0.0 mm" in told and "feet stand at 0.0 mm" in told
