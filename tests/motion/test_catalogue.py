"""Names of motions: which files they stand for, and what a wrong name is told."""

import os
import re
from pathlib import Path

import pytest
from short_motions import ONE_BONE

from crar_drake.errors import MotionError
from crar_drake.motion import catalogue
from crar_drake.motion.catalogue import (
    available_trials,
    builtin_names,
    load_clip,
    load_performer,
    resolve,
    trial_files,
    trial_id,
)
from crar_drake.references.motion_files import read_motion

AMC = """\
:FULLY-SPECIFIED
:DEGREES
1
root 0 18 0 0 0 0
spine 0
2
root 1 18 0 0 0 0
spine 10
3
root 2 18 0 0 0 0
spine 20
"""


@pytest.fixture
def trials(monkeypatch, tmp_path) -> Path:
    """The folder of CRAR_MOCAP_PATH, which is not there yet."""
    folder = tmp_path / "mocap"
    monkeypatch.setenv("CRAR_MOCAP_PATH", str(folder))
    return folder


@pytest.fixture
def builtin(monkeypatch, tmp_path) -> Path:
    """A folder of built-in motions that is independent of the shipped ones."""
    folder = tmp_path / "builtin"
    write(folder / "performer.asf", ONE_BONE)
    for name in ("dance", "boxing"):
        write(folder / f"{name}.amc", AMC)
    monkeypatch.setattr(catalogue, "builtin_motions_folder", lambda: folder)
    return folder


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def add_trial(folder: Path, trial: str) -> None:
    files = trial_files(folder, trial)
    write(files.asf, ONE_BONE)
    write(files.amc, AMC)


def refusal(*args) -> str:
    with pytest.raises(MotionError) as caught:
        resolve(*args)
    return str(caught.value)


# --- paths ------------------------------------------------------------------------


def test_skeleton_by_name_then_by_subject_then_the_only_one(tmp_path):
    amc = write(tmp_path / "05_02.amc", AMC)
    only = write(tmp_path / "someone.asf", ONE_BONE)
    assert resolve(str(amc)).asf == only
    subject = write(tmp_path / "05.asf", ONE_BONE)
    assert resolve(str(amc)).asf == subject
    own = write(tmp_path / "05_02.asf", ONE_BONE)
    files = resolve(str(amc))
    assert files == (amc, own)


def test_given_skeleton_comes_before_the_one_beside(tmp_path):
    amc = write(tmp_path / "05_02.amc", AMC)
    write(tmp_path / "05.asf", ONE_BONE)
    other = write(tmp_path / "elsewhere" / "x.ASF", ONE_BONE)
    assert resolve(amc, other).asf == other
    assert resolve(str(amc), str(other)).asf == other


def test_relative_path_and_bare_file_name(tmp_path, monkeypatch):
    write(tmp_path / "walk.amc", AMC)
    write(tmp_path / "walk.asf", ONE_BONE)
    monkeypatch.chdir(tmp_path)
    for name in ("walk.amc", "./walk.amc", Path("walk.amc")):
        assert resolve(name).asf == Path("walk.asf")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert resolve("~/walk.amc").amc == tmp_path / "walk.amc"


def test_ambiguous_skeleton_lists_the_candidates(tmp_path):
    amc = write(tmp_path / "walk.amc", AMC)
    write(tmp_path / "a.asf", ONE_BONE)
    write(tmp_path / "b.asf", ONE_BONE)
    assert "a.asf, b.asf; name the right one" in refusal(str(amc))


def test_another_subjects_skeleton_is_not_taken_silently(tmp_path):
    amc = write(tmp_path / "05_02.amc", AMC)
    other = write(tmp_path / "07.asf", ONE_BONE)
    assert re.search(r"07\.asf, is another subject's; put 05\.asf", refusal(str(amc)))
    assert resolve(amc, other).asf == other


def test_missing_and_wrong_files_name_the_remedy(tmp_path):
    amc = write(tmp_path / "05_02.amc", AMC)
    asf = write(tmp_path / "sub" / "05.asf", ONE_BONE)
    assert "put 05.asf into its folder" in refusal(str(amc))
    assert "a motion is an .amc file" in refusal(str(asf))
    assert "a motion is an .amc file" in refusal(tmp_path)
    assert "a skeleton is an .asf file" in refusal(amc, amc)
    assert "no such skeleton file" in refusal(amc, tmp_path / "05.asf")
    assert "no such motion file" in refusal("nowhere/walk.amc")
    assert "or write cmu:05_03" in refusal(str(tmp_path / "05_03.amc"))
    (tmp_path / "folder.amc").mkdir()
    assert "no such motion file" in refusal(str(tmp_path / "folder.amc"))


@pytest.mark.parametrize("suffix", ["bvh", "npz", "csv", "pkl", "amc"])
def test_a_pointer_of_git_lfs_is_told(suffix: str, tmp_path) -> None:
    """What a clone without Git LFS has in a file's place, as the format's pages say."""
    path = tmp_path / f"walk.{suffix}"
    path.write_text(
        "version https://git-lfs.github.com/spec/v1\n"
        f"oid sha256:{'0' * 64}\nsize 164520\n"
    )
    with pytest.raises(MotionError, match="walk.*pointer of Git LFS.*git lfs pull"):
        load_performer(path)
    if suffix not in ("bvh", "amc"):  # of a person alone
        with pytest.raises(MotionError, match="walk.*pointer of Git LFS.*git lfs pull"):
            read_motion(path)


def test_load_clip_is_called_what_the_user_called_it(tmp_path, trials):
    amc = write(tmp_path / "walk.amc", AMC)
    asf = write(tmp_path / "elsewhere" / "walk.asf", ONE_BONE)
    clip = load_clip(amc, asf)
    assert clip.name == str(amc)
    assert clip.num_frames == 3
    # 18 units / 0.45 are 40 inches
    assert clip.root_position[0, 1] == pytest.approx(40 * 0.0254)
    add_trial(trials, "05_02")
    assert load_clip("cmu:05_02").name == "cmu:05_02"


# --- trials -----------------------------------------------------------------------


def test_trial_from_search_path_in_order(tmp_path, monkeypatch):
    first, second = tmp_path / "first", tmp_path / "second"
    monkeypatch.setenv(
        "CRAR_MOCAP_PATH", os.pathsep.join(["", str(first), str(second)])
    )
    add_trial(second, "05_02")
    assert resolve("cmu:05_02").amc.is_relative_to(second)
    add_trial(first, "05_02")
    files = resolve("cmu:05_02")
    assert files.amc == first / "subjects" / "05" / "05_02.amc"
    assert files.asf == first / "subjects" / "05" / "05.asf"
    # Without its skeleton it does not hide a complete one.
    files.asf.unlink()
    assert resolve("cmu:05_02").amc.is_relative_to(second)


def test_absent_trial_tells_which_files_are_to_be_where(monkeypatch, trials):
    message = refusal("cmu:127_23")
    assert f"not in CRAR_MOCAP_PATH ({trials})" in message
    amc, asf = "subjects/127/127_23.amc", "subjects/127/127.asf"
    assert f"get {amc} and {asf} from http://mocap.cs.cmu.edu" in message
    monkeypatch.delenv("CRAR_MOCAP_PATH")
    assert "CRAR_MOCAP_PATH (not set)" in refusal("cmu:127_23")


def test_trial_without_skeleton_tells_which(trials):
    add_trial(trials, "05_02")
    asf = trial_files(trials, "05_02").asf
    asf.unlink()
    message = refusal("cmu:05_02")
    assert f"its skeleton {asf} is missing; get it from http" in message


@pytest.mark.parametrize("text", ["05_02", "cmu:05_02", "127_23", "cmu:144_10"])
def test_trial_id(text):
    assert trial_id(text) == text.removeprefix("cmu:")


@pytest.mark.parametrize("text", ["cmu:5_2", "005_02", "5_02", "05_2", "cmu:05_02.amc"])
def test_trial_written_unusually_is_told_the_usual_way(text):
    with pytest.raises(MotionError, match="is written '05_02'"):
        trial_id(text)


@pytest.mark.parametrize(
    "text", ["", "cmu:", "05", "05-02", "../05_02", "05_02/..", "05_02\n", "٠٥_٠٢"]
)
def test_malformed_trial(text):
    with pytest.raises(MotionError, match="such as 05_02"):
        trial_id(text)


def test_malformed_trial_as_motion_name(trials):
    assert "such as 05_02" in refusal("cmu:dance")


def test_lists_of_trials(tmp_path, monkeypatch, trials):
    assert available_trials() == {}
    mine = tmp_path / "mine"
    monkeypatch.setenv("CRAR_MOCAP_PATH", os.pathsep.join([str(mine), str(trials)]))
    for folder, trial in [(mine, "14_07"), (trials, "127_23"), (trials, "05_02")]:
        add_trial(folder, trial)
    add_trial(mine, "05_02")
    write(mine / "subjects" / "14" / "notes.amc", AMC)  # not a trial
    write(mine / "subjects" / "77" / "77_01.amc", AMC)  # without a skeleton
    write(trials / "subjects" / "05" / "05_03.amc.part", AMC[:20])
    assert list(available_trials()) == ["cmu:05_02", "cmu:14_07", "cmu:127_23"]
    assert available_trials()["cmu:05_02"].is_relative_to(mine)
    for name, amc in available_trials().items():
        assert resolve(name).amc == amc


def test_real_trials_by_name(cmu):
    assert "cmu:05_02" in available_trials()
    clip = load_clip("cmu:09_06")
    assert (clip.name, clip.num_frames) == ("cmu:09_06", 141)


# --- built-in motions -------------------------------------------------------------


def test_builtin_motions_share_a_skeleton(builtin):
    assert builtin_names() == ["boxing", "dance"]
    for name in builtin_names():
        files = resolve(name)
        assert files.amc == builtin / f"{name}.amc"
        assert files.asf == builtin / "performer.asf"
        assert load_clip(name).name == name


@pytest.mark.parametrize(
    ("name", "nearest"), [("danse", "dance"), ("Boxing", "boxing")]
)
def test_unknown_builtin_is_told_the_nearest(builtin, name, nearest):
    message = refusal(name)
    assert f"did you mean {nearest!r}?" in message
    assert "Built in: boxing, dance." in message


def test_unknown_name_without_a_near_one(builtin):
    for name in ("xyzzy", ""):
        message = refusal(name)
        assert "did you mean" not in message
        assert "Built in: boxing, dance." in message
    assert "did you mean 'cmu:05_02'?" in refusal("05_02")


def test_skeleton_is_refused_where_it_is_known(builtin, tmp_path):
    for name in ("dance", "cmu:05_02"):
        assert "has its own skeleton" in refusal(name, tmp_path / "x.asf")


# --- frame rates ------------------------------------------------------------------


def test_where_a_frame_rate_comes_from(trials, tmp_path) -> None:
    def rate(name, **options) -> tuple[float, str]:
        clip = load_clip(name, **options)
        return clip.frame_rate, clip.rate_source

    (tmp_path / "walk.asf").write_text(ONE_BONE)
    walk = tmp_path / "walk.amc"
    walk.write_text(AMC)
    assert rate(walk) == (120.0, "assumed")
    assert rate(walk, frame_rate=50.0) == (50.0, "given")
    walk.write_text(AMC.replace(":DEGREES", ":DEGREES\n:SAMPLES-PER-SECOND 30"))
    assert rate(walk) == (30.0, "file")
    assert rate(walk, frame_rate=50.0) == (50.0, "given")
    # As the trial of the database that it is called, its rate is known;
    # as a file of somebody's with such a name it is assumed.
    for trial, expected in (("61_01", 60.0), ("05_02", 120.0)):
        files = trial_files(trials, trial)
        files.amc.parent.mkdir(parents=True)
        files.amc.write_text(AMC)
        files.asf.write_text(ONE_BONE)
        assert rate(f"cmu:{trial}") == (expected, "database")
        assert rate(files.amc) == (expected, "assumed")
    assert rate("dance") == (60.0, "file")


@pytest.mark.parametrize("frame_rate", [0.0, -1.0, float("nan"), float("inf")])
def test_a_frame_rate_must_be_positive(frame_rate) -> None:
    with pytest.raises(MotionError, match="frame rate must be positive"):
        load_clip("dance", frame_rate=frame_rate)
