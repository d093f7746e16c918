"""Reading, writing and moving ASF/AMC files, against independent kinematics."""

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.formats.asf_amc import (
    Clip,
    Skeleton,
    bone_end,
    clip_tree,
    read_amc,
    read_asf,
    rest_tree,
)
from tests.amc_files import write_amc, write_asf

ASF = """\
# a comment
:version 1.10
:name toy
:units
  mass 1.0
  length 0.9
  angle deg
:documentation
   begin nothing of this matters: end
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name hip
     direction 0 -1 0
     length 2
     axis 0 0 0  XYZ
  end
  begin
     id 2
     name thigh
     direction 0 -2 0
     length 4
     axis 10 20 30  XYZ
    dof rx rz
    limits (-160.0 20.0)
           (-70.0 70.0)
  end
  begin
     id 3
     name shin
     direction 0 -1 0
     length 3.5
     axis 0 0 0  XYZ
    dof ry
    limits (-inf inf)
  end
:hierarchy
  begin
    root hip
    hip thigh
    thigh shin
  end
"""

AMC = """\
#!OML:ASF C:\\gone\\toy.ASF
# a comment
:FULLY-SPECIFIED
:DEGREES
1
root 9 18 27 10 20 30
shin -3.67752e-015
thigh 30 40
2
root 9 18 27 370 20 30
shin 45
thigh -30 400
"""

LENGTH = 0.0254 / 0.9  # metres in a file unit of the toy


@pytest.fixture
def toy(tmp_path: Path) -> Skeleton:
    return read_asf(_write(tmp_path / "toy.asf", ASF))


def _write(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def _line_of(text: str, needle: str) -> int:
    """The 1-based number of the first line that holds the needle."""
    return next(i for i, t in enumerate(text.splitlines(), 1) if needle in t)


def _refusal(read, *args, **kwargs) -> str:
    with pytest.raises(MotionError) as caught:
        read(*args, **kwargs)
    return str(caught.value)


# --- what is read -----------------------------------------------------------------


def test_skeleton_in_metres_and_radians(toy: Skeleton) -> None:
    assert toy.name == "toy"
    assert list(toy.bones) == ["hip", "thigh", "shin"]
    thigh = toy.bones["thigh"]
    assert thigh.parent == "hip"
    assert thigh.length == pytest.approx(4 * LENGTH, rel=1e-12)
    np.testing.assert_allclose(thigh.direction, [0, -1, 0])
    np.testing.assert_allclose(thigh.axis, np.radians([10, 20, 30]))
    assert thigh.dof == ("rx", "rz")
    np.testing.assert_allclose(thigh.limits, np.radians([[-160, 20], [-70, 70]]))
    assert toy.bones["hip"].dof == ()


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_motion_of_either_line_end(toy: Skeleton, tmp_path: Path, newline: str) -> None:
    path = _write(tmp_path / "m.amc", AMC.replace("\n", newline))
    clip = read_amc(path, toy)
    assert (clip.name, clip.num_frames, clip.frame_rate) == ("m", 2, 120.0)
    assert clip.duration == pytest.approx(1 / 120)
    np.testing.assert_allclose(clip.root_position[0], np.array([9, 18, 27]) * LENGTH)
    # Never wrapped and never clamped to the limits.
    np.testing.assert_allclose(np.degrees(clip.root_rotation[1]), [370, 20, 30])
    np.testing.assert_allclose(np.degrees(clip.joints["thigh"][1]), [-30, 400])
    np.testing.assert_allclose(np.degrees(clip.joints["shin"][0]), [-3.67752e-15])
    assert "hip" not in clip.joints


def test_headers_may_lack_and_trailing_newline_too(
    toy: Skeleton, tmp_path: Path
) -> None:
    body = AMC[AMC.index("\n1\n") + 1 :].rstrip()
    clip = read_amc(_write(tmp_path / "m.amc", "\ufeff" + body), toy)
    np.testing.assert_allclose(np.degrees(clip.root_rotation[0]), [10, 20, 30])


def test_radians_in_either_file(toy: Skeleton, tmp_path: Path) -> None:
    clip = read_amc(_write(tmp_path / "m.amc", AMC.replace(":DEG", ":deg")), toy)
    text = AMC.replace(":DEGREES", ":RADIANS")
    in_radians = read_amc(_write(tmp_path / "r.amc", text), toy)
    np.testing.assert_allclose(in_radians.joints["thigh"][0], [30, 40])
    np.testing.assert_allclose(in_radians.root_position, clip.root_position)
    skeleton = read_asf(_write(tmp_path / "r.asf", ASF.replace("deg", "rad")))
    np.testing.assert_allclose(skeleton.bones["thigh"].axis, [10, 20, 30])


@pytest.mark.parametrize(
    ("name", "header", "override", "rate"),
    [
        ("05_02", "", None, 120.0),
        ("60_01", "", None, 60.0),
        ("61_15", "", None, 60.0),
        ("60", "", None, 120.0),
        ("160_01", "", None, 120.0),
        ("60_01", ":SAMPLES-PER-SECOND 100\n", None, 100.0),
        ("dance", ":samples-per-second 59.94\n", None, 59.94),
        ("60_01", ":SAMPLES-PER-SECOND 100\n", 30.0, 30.0),
    ],
)
def test_frame_rate(toy, tmp_path, name, header, override, rate) -> None:
    path = _write(tmp_path / f"{name}.amc", header + AMC)
    assert read_amc(path, toy, frame_rate=override).frame_rate == rate


# --- kinematics -------------------------------------------------------------------


def test_rotations_against_scipy(toy: Skeleton, tmp_path: Path) -> None:
    clip = read_amc(_write(tmp_path / "m.amc", AMC), toy)
    tree = clip_tree(clip)
    # Lower-case letters are SciPy's fixed axes: Rz Ry Rx.
    root = Rotation.from_euler("xyz", [[10, 20, 30], [370, 20, 30]], degrees=True)
    C = Rotation.from_euler("xyz", [10, 20, 30], degrees=True)
    dof = Rotation.from_euler("xyz", [[30, 0, 40], [-30, 0, 400]], degrees=True)
    thigh = root * C * dof * C.inv()
    shin = thigh * Rotation.from_euler("y", [[0], [45]], degrees=True)
    for name, expected in {"root": root, "thigh": thigh, "shin": shin}.items():
        np.testing.assert_allclose(
            tree.rotations[tree.names.index(name)], expected.as_matrix(), atol=1e-12
        )
    knee = (
        np.array([9, 18, 27]) * LENGTH
        + root.apply([0, -2 * LENGTH, 0])
        + thigh.apply([0, -4 * LENGTH, 0])
    )
    np.testing.assert_allclose(bone_end(toy, tree, "thigh"), knee, atol=1e-12)


def test_rest_pose_lays_bones_end_to_end(toy: Skeleton) -> None:
    rest = rest_tree(toy)
    np.testing.assert_allclose(
        bone_end(toy, rest, "shin"), [[0, -9.5 * LENGTH, 0]], atol=1e-15
    )
    np.testing.assert_allclose(rest.rotations[-1], [np.eye(3)], atol=1e-15)


# --- round trip -------------------------------------------------------------------


def test_round_trip(toy: Skeleton, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    clip = Clip(
        name="random",
        skeleton=toy,
        frame_rate=59.94,
        root_position=rng.normal(size=(20, 3)),
        root_rotation=rng.normal(scale=10.0, size=(20, 3)),
        joints={
            "thigh": rng.normal(scale=20.0, size=(20, 2)),
            "shin": rng.normal(scale=1e-15, size=(20, 1)),
        },
    )
    write_asf(tmp_path / "out.asf", toy)
    write_amc(tmp_path / "out.amc", clip)
    skeleton = read_asf(tmp_path / "out.asf")
    again = read_amc(tmp_path / "out.amc", skeleton)
    assert again.frame_rate == 59.94
    np.testing.assert_allclose(again.root_position, clip.root_position, atol=1e-9)
    np.testing.assert_allclose(again.root_rotation, clip.root_rotation, atol=1e-9)
    for bone in ("thigh", "shin"):
        np.testing.assert_allclose(again.joints[bone], clip.joints[bone], atol=1e-9)
        assert skeleton.bones[bone].dof == toy.bones[bone].dof
        np.testing.assert_allclose(skeleton.bones[bone].limits, toy.bones[bone].limits)
    before = bone_end(toy, clip_tree(clip), "shin")
    after = bone_end(skeleton, clip_tree(again), "shin")
    np.testing.assert_allclose(after, before, atol=1e-9)


def test_round_degrees_stay_short(toy: Skeleton, tmp_path: Path) -> None:
    write_amc(tmp_path / "out.amc", read_amc(_write(tmp_path / "m.amc", AMC), toy))
    assert "thigh -30 400\n" in (tmp_path / "out.amc").read_text()


# --- refusals ---------------------------------------------------------------------

BAD_MOTIONS = [
    # (what, text, needle on the line that is named, words of the message)
    ("empty", "", None, ["no frames"]),
    ("headers only", ":FULLY-SPECIFIED\n:DEGREES\n", None, ["no frames"]),
    ("one frame", AMC[: AMC.index("2\nroot")], None, ["single frame", "at least 2"]),
    ("nan", AMC.replace("-30 400", "-30 nan"), "-30 nan", ["nan", "finite"]),
    ("inf", AMC.replace("shin 45", "shin -inf"), "-inf", ["-inf", "finite"]),
    ("word", AMC.replace("shin 45", "shin 4x5"), "4x5", ["number", "4x5"]),
    ("few values", AMC.replace("-30 400", "-30"), "thigh -30", ["2 values", "found 1"]),
    ("many values", AMC.replace("shin 45", "shin 45 1"), "shin 45", ["found 2"]),
    ("no values", AMC.replace("shin 45", "shin"), None, ["1 values", "found 0"]),
    ("unknown bone", AMC.replace("shin 45", "tail 45"), "tail", ["tail", "'toy'"]),
    ("no dof", AMC.replace("shin 45", "hip 45"), "hip 45", ["hip", "no degrees"]),
    ("missing bone", AMC.replace("thigh 30 40\n", ""), "2", ["frame 1", "thigh"]),
    ("missing root", AMC.replace("root 9 18 27 10 20 30\n", ""), None, ["root"]),
    ("cut off", AMC[: AMC.rindex("thigh")], None, ["frame 2", "thigh", "cut off"]),
    ("twice", AMC.replace("shin 45", "shin 45\nshin 45"), None, ["shin", "twice"]),
    ("same frame", AMC.replace("\n2\n", "\n1\n"), None, ["frame 1", "frame 2 was"]),
    ("jump", AMC.replace("\n2\n", "\n3\n"), None, ["frame 3", "frame 2 was"]),
    ("from 0", AMC.replace("\n1\n", "\n0\n"), None, ["frame 0", "frame 1 was"]),
    ("binary", bytes(range(256)) * 40, None, ["not an AMC"]),
    ("skeleton", ASF.replace(":", ""), None, ["not an AMC"]),
    ("rate", ":SAMPLES-PER-SECOND 0\n" + AMC, ":SAMP", ["positive"]),
]


@pytest.mark.parametrize(
    ("text", "needle", "words"),
    [case[1:] for case in BAD_MOTIONS],
    ids=[case[0] for case in BAD_MOTIONS],
)
def test_bad_motion_names_file_line_and_matter(toy, tmp_path, text, needle, words):
    path = _write(tmp_path / "bad.amc", text)
    message = _refusal(read_amc, path, toy)
    assert ":0:" not in message
    place = str(path) + ":"
    if needle and needle != "2":
        place += f"{_line_of(text, needle)}:"
    assert message.startswith(place)
    for word in words:
        assert word in message
    assert message.isprintable()


def test_missing_bone_is_reported_where_the_frame_ends(toy, tmp_path) -> None:
    text = AMC.replace("thigh 30 40\n", "")
    path = _write(tmp_path / "bad.amc", text)
    line = text.splitlines().index("2") + 1
    assert _refusal(read_amc, path, toy).startswith(f"{path}:{line}:")


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan")])
def test_bad_override_of_the_frame_rate(toy, tmp_path, rate) -> None:
    path = _write(tmp_path / "m.amc", AMC)
    assert "positive" in _refusal(read_amc, path, toy, frame_rate=rate)


BAD_SKELETONS = [
    ("empty", "", None, ["no :root"]),
    ("no root", ASF.replace(":root", ":boot"), None, ["no :root"]),
    ("no bonedata", ASF[: ASF.index(":bonedata")], None, ["no :bonedata"]),
    ("no hierarchy", ASF[: ASF.index(":hierarchy")], None, ["no :hierarchy"]),
    ("no length", ASF.replace("  length 0.9\n", ""), None, ["length", "0.45"]),
    ("zero length", ASF.replace("h 0.9", "h 0"), "  length 0", ["positive"]),
    ("parent", ASF.replace("  hip thigh", "  hop thigh"), "hop", ["parent 'hop'"]),
    ("child", ASF.replace("thigh shin", "thigh fin"), "fin", ["bone 'fin'"]),
    ("orphan", ASF.replace("    thigh shin\n", ""), None, ["shin", "root"]),
    (
        "orphan with a key of its own",
        ASF.replace("    thigh shin\n", "").replace("    id 3\n", "    line 99\n"),
        None,
        [":33: bone shin"],
    ),
    ("cycle", ASF.replace("root hip", "shin hip"), None, ["hip", "root"]),
    ("two parents", ASF.replace("root hip", "root hip shin"), None, ["two parents"]),
    ("twice", ASF.replace("name shin", "name thigh"), None, ["thigh", "twice"]),
    ("nan", ASF.replace("length 3.5", "length nan"), "nan", ["finite"]),
    ("direction", ASF.replace("0 -2 0", "0 0 0"), None, ["thigh", "direction"]),
    ("few", ASF.replace("0 -2 0", "0 -2"), "0 -2", ["direction", "3 values"]),
    ("dof", ASF.replace("dof ry", "dof tx"), "dof tx", ["tx", "rx ry rz"]),
    (
        "limits of no bone",
        ASF.replace("  end\n:hier", "  end\n  begin\n  (1 2)\n  end\n:hier"),
        "  (1 2)",
        ["without the word limits"],
    ),
    ("axis", ASF.replace("30  XYZ", "30  ZYX"), "ZYX", ["ZYX", "XYZ"]),
    ("order", ASF.replace("RX RY RZ", "RZ RY RX"), "order", ["root order"]),
    ("offset", ASF.replace("orientation 0", "orientation 9"), "orient", ["0 0 0"]),
    ("angle", ASF.replace("angle deg", "angle gon"), "gon", ["gon", "deg or rad"]),
    ("nameless", ASF.replace("     name shin\n", ""), None, ["no name"]),
    ("cut off", ASF[: ASF.index("dof ry")], None, ["cut off"]),
    ("no end", ASF.replace("  end\n:hier", ":hier"), ":hier", ["no end"]),
    ("binary", bytes(range(256)) * 40, None, ["not an ASF"]),
    ("motion", AMC[AMC.index("\n1\n") :], None, ["not an ASF"]),
]


@pytest.mark.parametrize(
    ("text", "needle", "words"),
    [case[1:] for case in BAD_SKELETONS],
    ids=[case[0] for case in BAD_SKELETONS],
)
def test_bad_skeleton_names_file_line_and_matter(tmp_path, text, needle, words):
    path = _write(tmp_path / "bad.asf", text)
    message = _refusal(read_asf, path)
    place = str(path) + ":"
    if needle:
        place += f"{_line_of(text, needle)}:"
    assert message.startswith(place)
    for word in words:
        assert word in message
    assert message.isprintable()


def test_missing_files_and_folders(toy: Skeleton, tmp_path: Path) -> None:
    for path in (tmp_path / "absent", tmp_path):
        told = _refusal(read_asf, path)
        assert str(path) in told and "motion" not in told.replace(str(path), "")
        assert str(path) in _refusal(read_amc, path, toy)


# --- real files -------------------------------------------------------------------


@pytest.mark.parametrize("trial", ["02_01", "05_02", "09_06", "11_01", "127_23"])
def test_real_clips_load_whole(cmu: Path, trial: str) -> None:
    with open(cmu / "INDEX.csv", newline="") as file:
        row = next(row for row in csv.DictReader(file) if row["trial"] == trial)
    folder = cmu / "subjects" / trial.split("_")[0]
    skeleton = read_asf(folder / f"{folder.name}.asf")
    clip = read_amc(folder / f"{trial}.amc", skeleton)
    assert clip.num_frames == int(row["frames"])
    assert clip.frame_rate == float(row["fps"])
    values = sum(array.shape[1] for array in clip.joints.values())
    assert (len(skeleton.bones), values) == (30, 56)
    # A person's: the scale is right.
    assert 0.8 < np.median(clip.root_position[:, 1]) < 1.1
