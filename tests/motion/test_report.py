"""The report finds planted defects and leaves honest motion alone."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from crar_drake.errors import MotionError
from crar_drake.motion import (
    Bone,
    Clip,
    MotionReport,
    Skeleton,
    describe,
    inspect,
    plot_motion,
    read_amc,
    read_asf,
)

T = 120


def _skeleton(*, arms: bool = True) -> Skeleton:
    bones = {
        "leg": Bone("leg", "root", np.array([0.0, -1.0, 0.0]), 0.9, np.zeros(3)),
        "lowerneck": Bone(
            "lowerneck", "root", np.array([0.0, 1.0, 0.0]), 0.4, np.zeros(3)
        ),
    }
    if arms:
        for side, x in (("l", 1.0), ("r", -1.0)):
            parent = "lowerneck"
            for bone in ("humerus", "radius", "wrist"):
                name, direction = side + bone, np.array([x, 0.0, 0.0])
                dof = ("rx", "ry", "rz") if bone == "humerus" else ()
                bones[name] = Bone(name, parent, direction, 0.2, np.zeros(3), dof)
                parent = name
    return Skeleton("stick", bones)


@pytest.fixture
def clip() -> Clip:
    """A stroll with swinging arms; nothing in it is bad."""
    time = np.arange(T) / 120.0
    zero = np.zeros(T)
    swing = np.stack([np.sin(4.0 * time), np.cos(3.0 * time), zero], axis=1)
    return Clip(
        name="stroll",
        skeleton=_skeleton(),
        frame_rate=120.0,
        root_position=np.stack([zero, 0.9 + zero, 1.5 * time], axis=1),
        root_rotation=np.stack([zero, 3.0 * time, zero], axis=1),
        joints={"lhumerus": swing, "rhumerus": -swing},
    )


def test_honest_motion(clip: Clip) -> None:
    report = inspect(clip)
    assert report.looks_clean
    assert (report.frames, report.frame_rate, report.bones) == (T, 120.0, 8)
    assert report.duration == pytest.approx(119 / 120)
    assert report.peak_speeds["waist"] == pytest.approx(1.5)
    text = "\n".join(describe(report))
    assert "120 frames at 120 Hz" in text and "nothing looks bad" in text


def test_flip_is_found_once_and_named(clip: Clip) -> None:
    angles = clip.joints["lhumerus"].copy()
    angles[50:, 0] += np.pi
    bad = dataclasses.replace(clip, joints=clip.joints | {"lhumerus": angles})
    report = inspect(bad)
    (flip,) = report.flips
    # The file numbers frames from 1, so index 50 is frame 51.
    assert (flip.bone, flip.frame) == ("lhumerus", 51)
    assert np.degrees(flip.angle) == pytest.approx(180.0, abs=5.0)
    lines = [line for line in describe(report) if "flips" in line]
    assert len(lines) == 1
    assert "lhumerus flips once, first in frame 51 (0.42 s)" in lines[0]


def test_full_turn_in_the_angles_is_no_flip(clip: Clip) -> None:
    angles = clip.joints["lhumerus"].copy()
    angles[50:] += [2.0 * np.pi, 0.0, -4.0 * np.pi]
    bad = dataclasses.replace(clip, joints=clip.joints | {"lhumerus": angles})
    assert inspect(bad).looks_clean


def test_second_set_of_angles_for_one_rotation_is_no_flip(clip: Clip) -> None:
    """(rx, ry, rz) and (rx + pi, pi - ry, rz + pi) are the same rotation."""
    angles = clip.joints["lhumerus"].copy()
    angles[50:] = angles[50:] * [1.0, -1.0, 1.0] + np.pi
    bad = dataclasses.replace(clip, joints=clip.joints | {"lhumerus": angles})
    assert inspect(bad).looks_clean


def test_flip_of_the_root_is_not_blamed_on_its_children(clip: Clip) -> None:
    rotation = clip.root_rotation.copy()
    rotation[30:, 1] += np.radians(100.0)
    report = inspect(dataclasses.replace(clip, root_rotation=rotation))
    assert [(flip.bone, flip.frame) for flip in report.flips] == [("root", 31)]


@pytest.mark.parametrize("index", [1, 2, 70, T - 2, T - 1])
def test_jump_of_the_root_is_found_ends_included(clip: Clip, index: int) -> None:
    position = clip.root_position.copy()
    position[index:, 0] += 0.10
    report = inspect(dataclasses.replace(clip, root_position=position))
    jump = next(jump for jump in report.jumps if jump.point == "waist")
    assert {jump.frame for jump in report.jumps} == {index + 1}
    assert jump.distance == pytest.approx(0.10, abs=1e-3)
    assert any("waist jumps once" in line for line in describe(report))


def test_held_gap_is_found(clip: Clip) -> None:
    def hold(values: np.ndarray) -> np.ndarray:
        values = values.copy()
        values[40:61] = values[40]
        return values

    report = inspect(
        dataclasses.replace(
            clip,
            root_position=hold(clip.root_position),
            root_rotation=hold(clip.root_rotation),
            joints={name: hold(values) for name, values in clip.joints.items()},
        )
    )
    assert [(gap.first, gap.last) for gap in report.frozen] == [(41, 61)]
    assert any("nothing moves from frame 41" in line for line in describe(report))


def test_skeleton_without_arms_is_reported_not_refused(clip: Clip) -> None:
    position = clip.root_position.copy()
    position[70:, 0] += 0.10
    report = inspect(
        dataclasses.replace(
            clip, skeleton=_skeleton(arms=False), joints={}, root_position=position
        )
    )
    assert "lhumerus" in report.obstacle
    assert report.peak_speeds == {}
    assert [jump.frame for jump in report.jumps] == [71]
    assert any("no robot can follow" in line for line in describe(report))


def test_two_frames_are_enough_to_report(clip: Clip) -> None:
    report = inspect(
        dataclasses.replace(
            clip,
            root_position=clip.root_position[:2],
            root_rotation=clip.root_rotation[:2],
            joints={name: values[:2] for name, values in clip.joints.items()},
        )
    )
    assert report.looks_clean


def test_figure_is_written(clip: Clip, tmp_path: Path) -> None:
    plot_motion(clip, tmp_path / "stroll.png")
    assert (tmp_path / "stroll.png").read_bytes().startswith(b"\x89PNG")
    plot_motion(clip, tmp_path / "stroll.svg")
    text = (tmp_path / "stroll.svg").read_text()
    assert "<svg" in text
    assert {path.name for path in tmp_path.iterdir()} == {"stroll.png", "stroll.svg"}


def test_figure_needs_joint_centres(clip: Clip, tmp_path: Path) -> None:
    bare = dataclasses.replace(clip, skeleton=_skeleton(arms=False), joints={})
    with pytest.raises(MotionError, match="lhumerus"):
        plot_motion(bare, tmp_path / "none.png")


# --- real files -------------------------------------------------------------------


def _report(cmu: Path, trial: str) -> MotionReport:
    folder = cmu / "subjects" / trial.split("_")[0]
    skeleton = read_asf(folder / f"{folder.name}.asf")
    return inspect(read_amc(folder / f"{trial}.amc", skeleton))


@pytest.mark.parametrize("trial", ["05_02", "05_07", "127_23", "09_06"])
def test_no_flip_in_pirouettes_a_roll_and_a_run(cmu: Path, trial: str) -> None:
    report = _report(cmu, trial)
    assert report.flips == () and report.frozen == ()


def test_flipping_thumbs_and_a_leaping_elbow_are_found(cmu: Path) -> None:
    assert {flip.bone for flip in _report(cmu, "131_01").flips} == {"rthumb"}
    report = _report(cmu, "13_17")
    assert {(jump.point, jump.frame) for jump in report.jumps} == {
        ("right_elbow", 716),
        ("right_wrist", 716),
    }
