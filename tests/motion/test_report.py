"""The report finds planted defects and leaves honest motion alone."""

import dataclasses
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from crar_drake.errors import MotionError
from crar_drake.motion import report as reports
from crar_drake.motion.formats.asf_amc import (
    Bone,
    Clip,
    Skeleton,
    read_amc,
    read_asf,
)
from crar_drake.motion.performers.asf_amc import asf_amc_performer
from crar_drake.motion.picture import plot_motion
from crar_drake.motion.report import MotionReport, describe
from tests.amc_files import write_amc, write_asf

T = 120


def inspect(clip: Clip) -> MotionReport:
    return reports.inspect(asf_amc_performer(clip))


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
    assert not report.findings
    person = report.performer
    assert (person.num_frames, person.frame_rate, person.bones) == (T, 120.0, 8)
    assert person.duration == pytest.approx(119 / 120)
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
    assert (flip.of, flip.frame) == ("lhumerus", 51)
    assert np.degrees(flip.size) == pytest.approx(180.0, abs=5.0)
    lines = [line for line in describe(report) if "flips" in line]
    assert len(lines) == 1
    assert "lhumerus flips once, first in frame 51 (0.42 s)" in lines[0]


def test_full_turn_in_the_angles_is_no_flip(clip: Clip) -> None:
    angles = clip.joints["lhumerus"].copy()
    angles[50:] += [2.0 * np.pi, 0.0, -4.0 * np.pi]
    bad = dataclasses.replace(clip, joints=clip.joints | {"lhumerus": angles})
    assert not inspect(bad).findings


def test_second_set_of_angles_for_one_rotation_is_no_flip(clip: Clip) -> None:
    """(rx, ry, rz) and (rx + pi, pi - ry, rz + pi) are the same rotation."""
    angles = clip.joints["lhumerus"].copy()
    angles[50:] = angles[50:] * [1.0, -1.0, 1.0] + np.pi
    bad = dataclasses.replace(clip, joints=clip.joints | {"lhumerus": angles})
    assert not inspect(bad).findings


def test_flip_of_the_root_is_not_blamed_on_its_children(clip: Clip) -> None:
    rotation = clip.root_rotation.copy()
    rotation[30:, 1] += np.radians(100.0)
    report = inspect(dataclasses.replace(clip, root_rotation=rotation))
    assert [(flip.of, flip.frame) for flip in report.flips] == [("root", 31)]


@pytest.mark.parametrize("index", [1, 2, 70, T - 2, T - 1])
def test_jump_of_the_root_is_found_ends_included(clip: Clip, index: int) -> None:
    position = clip.root_position.copy()
    position[index:, 0] += 0.10
    report = inspect(dataclasses.replace(clip, root_position=position))
    jump = next(jump for jump in report.jumps if jump.of == "waist")
    assert {jump.frame for jump in report.jumps} == {index + 1}
    assert jump.size == pytest.approx(0.10, abs=1e-3)
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
    assert report.frozen == ((41, 61),)
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
    assert not report.findings


def test_figure_is_written(clip: Clip, tmp_path: Path) -> None:
    plot_motion(asf_amc_performer(clip), tmp_path / "stroll.png")
    assert (tmp_path / "stroll.png").read_bytes().startswith(b"\x89PNG")
    plot_motion(asf_amc_performer(clip), tmp_path / "stroll.svg")
    text = (tmp_path / "stroll.svg").read_text()
    assert "<svg" in text
    assert {path.name for path in tmp_path.iterdir()} == {"stroll.png", "stroll.svg"}


def test_figure_needs_joint_centres(clip: Clip, tmp_path: Path) -> None:
    bare = dataclasses.replace(clip, skeleton=_skeleton(arms=False), joints={})
    with pytest.raises(MotionError, match="lhumerus"):
        plot_motion(asf_amc_performer(bare), tmp_path / "none.png")


# --- implausible as a whole -------------------------------------------------------


def _throwing(frame_rate: float, reach: float = 1.0) -> Clip:
    """Arms that swing by +-1 rad at 1.5 Hz of true time, taken at 60 Hz: the wrists
    0.4 `reach` m from the shoulder move at up to 0.4 reach 2 pi 1.5 m/s."""
    time = np.arange(180) / 60.0
    zero = np.zeros(180)
    swing = np.stack([zero, zero, np.sin(2.0 * np.pi * 1.5 * time)], axis=1)
    skeleton = _skeleton()
    for name, bone in skeleton.bones.items():
        if name[1:] in ("humerus", "radius"):
            skeleton.bones[name] = dataclasses.replace(bone, length=0.2 * reach)
    return Clip(
        name="throws",
        skeleton=skeleton,
        frame_rate=frame_rate,
        root_position=np.stack([zero, 0.9 + zero, zero], axis=1),
        root_rotation=np.zeros((180, 3)),
        joints={"lhumerus": swing, "rhumerus": swing},
    )


def test_an_implausible_speed_names_the_rate_that_explains_it() -> None:
    true_speed = 0.4 * 1.5 * 2.0 * np.pi * 1.5  # at 60 Hz [m/s]
    report = inspect(_throwing(120.0, 1.5))
    (doubt,) = report.doubts
    found = re.fullmatch(
        r"(left|right) wrist reaches ([\d.]+) m/s; at 60 Hz it would be ([\d.]+) m/s: "
        r"is the rate 60 Hz\? --frame-rate 60",
        doubt,
    )
    assert found
    # The low-pass takes little of 1.5 Hz, and more of what seems to be 3 Hz and more.
    assert float(found[3]) == pytest.approx(true_speed, rel=0.02)
    assert float(found[2]) == pytest.approx(2.0 * true_speed, rel=0.1)
    assert report.findings[0] == doubt
    assert doubt in list(describe(report))
    assert not inspect(_throwing(60.0, 1.5)).findings


def test_a_speed_that_no_rate_explains_is_told_as_such() -> None:
    (doubt,) = inspect(_throwing(120.0, 1.9)).doubts
    assert "--frame-rate 60" in doubt
    fast = dataclasses.replace(
        _throwing(120.0),
        root_position=np.stack([40.0 * np.arange(180) / 30.0, *np.ones((2, 180))], 1),
    )
    (doubt,) = inspect(fast).doubts
    assert "which no usual frame rate explains" in doubt


@pytest.mark.parametrize("there_and_back", [False, True])
def test_a_flip_does_not_count_as_speed(clip: Clip, there_and_back: bool) -> None:
    """Filtered, this leap of the wrist by 0.8 m is at 10 m/s and more."""
    short = {name: values[:60].copy() for name, values in clip.joints.items()}
    short["lhumerus"][30 : 33 if there_and_back else None, 1] += np.pi
    bad = dataclasses.replace(
        clip,
        root_position=clip.root_position[:60],
        root_rotation=0.0 * clip.root_rotation[:60],
        joints=short,
    )
    report = inspect(bad)
    assert {flip.of for flip in report.flips} == {"lhumerus"}
    assert report.peak_speeds["left_wrist"] > 50.0
    assert report.doubts == ()


@pytest.mark.parametrize(
    "wrong, height, explained",
    [
        # Lengths of a 1.3 m stick figure were written for `length right`.
        (0.2, 1.3 * 0.45 / 0.2, "with length 0.45 it would be 1.30 m"),
        (2.54, 1.3 * 0.45 / 2.54, "with length 0.45 it would be 1.30 m"),
    ],
)
def test_a_wrong_length_is_pointed_out(
    clip: Clip, tmp_path: Path, wrong: float, height: float, explained: str
) -> None:
    write_asf(tmp_path / "a.asf", clip.skeleton)
    text = (tmp_path / "a.asf").read_text()
    assert "  length 0.45\n" in text
    (tmp_path / "a.asf").write_text(text.replace("length 0.45", f"length {wrong}", 1))
    skeleton = read_asf(tmp_path / "a.asf")
    report = inspect(dataclasses.replace(clip, skeleton=skeleton))
    (doubt,) = report.doubts
    assert f"standing height {height:.3g} m is implausible" in doubt
    assert f"with length {wrong:g} in the skeleton's :units" in doubt
    assert explained in doubt
    assert report.performer.height == pytest.approx(height)
    # Speeds of a giant say nothing of the rate.
    assert "m/s" not in doubt


def test_a_height_that_no_length_explains_proposes_none(clip: Clip) -> None:
    bones = {
        name: dataclasses.replace(bone, length=300.0 * bone.length)
        for name, bone in clip.skeleton.bones.items()
    }
    (doubt,) = inspect(
        dataclasses.replace(clip, skeleton=Skeleton("a tower", bones))
    ).doubts
    assert "390 m is implausible" in doubt and "would be" not in doubt


def _files(clip: Clip, folder: Path) -> tuple[Path, Path]:
    """The clip as files in degrees, with the axes and limits of a real skeleton."""
    bones = {
        name: dataclasses.replace(
            bone,
            axis=np.radians([0.0, 20.0, -90.0]),
            limits=tuple((-np.pi, np.pi) for _ in bone.dof),
        )
        for name, bone in clip.skeleton.bones.items()
    }
    skeleton = Skeleton("real", bones)
    write_asf(folder / "a.asf", skeleton)
    write_amc(folder / "a.amc", dataclasses.replace(clip, skeleton=skeleton))
    return folder / "a.asf", folder / "a.amc"


def _in_radians(file: Path, words: tuple[str, ...]) -> str:
    """The file's text with the numbers after those words turned into radians."""
    lines = []
    for line in file.read_text().splitlines():
        word, *rest = line.replace("(", " ").replace(")", " ").split() or [""]
        if word in words:
            skip = 3 if word == "root" else 0  # its position
            rest = [
                value
                if i < skip or value == "XYZ"
                else f"{np.radians(float(value)):.9f}"
                for i, value in enumerate(rest)
            ]
            if word == "limits" or word == "":
                rest = [f"({' '.join(rest)})"]
            line = " ".join([word, *rest])
        lines.append(line)
    return "\n".join(lines) + "\n"


MOVING = ("root", "lhumerus", "rhumerus")


def test_radians_are_read_as_such_and_not_doubted(clip: Clip, tmp_path: Path) -> None:
    asf, amc = _files(clip, tmp_path)
    in_degrees = read_amc(amc, read_asf(asf))
    assert (in_degrees.angle_unit, in_degrees.skeleton.angle_unit) == 2 * ("degrees",)
    assert inspect(in_degrees).doubts == ()
    amc.write_text(_in_radians(amc, MOVING).replace(":DEGREES", ":RADIANS"))
    asf.write_text(_in_radians(asf, ("axis",)).replace("angle deg", "angle rad"))
    text = asf.read_text().replace("(-180 180)", f"({-np.pi} {np.pi})")
    asf.write_text(text)
    in_radians = read_amc(amc, read_asf(asf))
    assert in_radians.angle_unit == in_radians.skeleton.angle_unit == "radians"
    for name, values in in_degrees.joints.items():
        np.testing.assert_allclose(in_radians.joints[name], values, atol=1e-7)
    np.testing.assert_allclose(
        in_radians.root_rotation, in_degrees.root_rotation, atol=1e-7
    )
    for name, bone in in_degrees.skeleton.bones.items():
        np.testing.assert_allclose(in_radians.skeleton.bones[name].axis, bone.axis)
    assert inspect(in_radians).doubts == ()


def test_angles_in_the_other_unit_are_pointed_out(clip: Clip, tmp_path: Path) -> None:
    asf, amc = _files(clip, tmp_path)
    texts = asf.read_text(), amc.read_text()

    def doubts() -> tuple[str, ...]:
        return inspect(read_amc(amc, read_asf(asf))).doubts

    amc.write_text(_in_radians(amc, MOVING))  # still :DEGREES
    (doubt,) = doubts()
    assert "the motion's angles never exceed ±2.98, which looks like radians" in doubt
    assert "the file says degrees; if so, write :RADIANS" in doubt
    amc.write_text(texts[1].replace(":DEGREES", ":RADIANS"))
    (doubt,) = doubts()
    assert "looks like degrees" in doubt and "write :DEGREES" in doubt
    amc.write_text(texts[1])

    asf.write_text(_in_radians(asf, ("axis",)).replace("(-180 180)", "(-3.14 3.14)"))
    (doubt,) = doubts()
    assert "the skeleton's angles never exceed ±3.14" in doubt
    assert "write angle rad" in doubt
    asf.write_text(texts[0].replace("angle deg", "angle rad"))
    (doubt,) = doubts()
    assert "the skeleton's angles reach ±180" in doubt and "write angle deg" in doubt


@pytest.mark.parametrize(
    "source, text", [("assumed", "at 120 Hz, assumed, "), ("file", "at 120 Hz, 0.99 s")]
)
def test_an_assumed_rate_is_said_to_be_assumed(clip, source, text) -> None:
    lines = list(describe(inspect(dataclasses.replace(clip, rate_source=source))))
    assert text in lines[0]
    assert any("--frame-rate HZ" in line for line in lines) == (source == "assumed")
    assert lines[-1] == "nothing looks bad"  # it is no finding


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
    assert {flip.of for flip in _report(cmu, "131_01").flips} == {"rthumb"}
    report = _report(cmu, "13_17")
    assert {(jump.of, jump.frame) for jump in report.jumps} == {
        ("right_elbow", 716),
        ("right_wrist", 716),
    }


def _at(clip: Clip, frame_rate: float) -> Clip:
    """The same frames, taken for those of another rate."""
    return dataclasses.replace(clip, frame_rate=frame_rate)


def _all_trials(cmu: Path) -> list[Path]:
    found = sorted(cmu.glob("subjects/*/*.amc"))
    assert len(found) >= 19
    return found


@cache
def _load(amc: Path, **options) -> Clip:
    return read_amc(amc, read_asf(amc.parent / f"{amc.parent.name}.asf"), **options)


@pytest.mark.slow
def test_no_real_trial_is_doubted_as_a_whole(cmu: Path) -> None:
    for amc in _all_trials(cmu):
        report = inspect(_load(amc))
        assert report.doubts == (), amc.stem
        assert 1.4 < report.performer.height < 1.7


@pytest.mark.slow
def test_fast_trials_are_doubted_at_a_wrong_rate(cmu: Path) -> None:
    """Runs and dances at twice, nearly everything at four times their rate."""
    for trial in ("05_07", "09_06", "127_23"):
        amc = cmu / "subjects" / trial.split("_")[0] / f"{trial}.amc"
        (doubt,) = inspect(_load(amc, frame_rate=240.0)).doubts
        assert "at 120 Hz it would be" in doubt and "--frame-rate 120" in doubt
    doubted = [
        amc.stem
        for amc in _all_trials(cmu)
        if any("m/s" in d for d in inspect(_at(_load(amc), 480.0)).doubts)
    ]
    assert len(doubted) >= 0.6 * len(_all_trials(cmu))
