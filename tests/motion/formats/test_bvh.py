"""BVH files that are odd but right are read; wrong ones are told with their line."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.formats.bvh import bvh_tree, read_bvh

TEXT = """\
HIERARCHY
ROOT Hips
{
  OFFSET 0.0 0.0 0.0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Left Arm:x
  {
    OFFSET 1.0 2.0 3.0
    CHANNELS 3 Yrotation Xrotation Zrotation
    End Site
    {
      OFFSET 0.0 1.0 0.0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0083333
1 2 3 10 20 30 40 50 60
1 2 3 1e1 2.0E+1 -3e-015 0 0 0
"""


def read(folder: Path, text: str | bytes):
    data = text if isinstance(text, bytes) else text.encode()
    (folder / "a.bvh").write_bytes(data)
    return read_bvh(folder / "a.bvh")


def refusal(folder: Path, text: str) -> str:
    with pytest.raises(MotionError) as caught:
        read(folder, text)
    return str(caught.value).removeprefix(str(folder / "a.bvh"))


def test_kinematics_are_scipys(tmp_path) -> None:
    bvh = read(tmp_path, TEXT)
    tree = bvh_tree(bvh)
    R_hips = Rotation.from_euler("ZXY", [10, 20, 30], degrees=True)
    R_arm = R_hips * Rotation.from_euler("YXZ", [40, 50, 60], degrees=True)
    p_arm = [1, 2, 3] + R_hips.apply([1, 2, 3])
    np.testing.assert_allclose(tree.positions[1][0], p_arm, atol=1e-12)
    np.testing.assert_allclose(
        tree.positions[2][0], p_arm + R_arm.apply([0, 1, 0]), atol=1e-12
    )
    np.testing.assert_allclose(tree.rotations[1][0], R_arm.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(tree.rotations[0][0], R_hips.as_matrix(), atol=1e-12)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: "\ufeff" + text,
        lambda text: text.replace("  ", "\t").replace(" ", "\t \t"),
        lambda text: text.lower(),
        lambda text: text.replace("\n{", " {").replace("\n    {", " {"),
        lambda text: text.rstrip() + "\n\n \t\n",
        lambda text: text.replace("MOTION\n", "MOTION\n\n").replace(": ", ":"),
        lambda text: text.replace(
            "Frames: 2\nFrame Time: 0.0083333", "Frame Time: 0.0083333\nFrames:\t2"
        ),
        lambda text: text.rstrip(),
        lambda text: text.encode("utf-16"),
        lambda text: text.encode("utf-16-le"),
        lambda text: text.encode("utf-32"),
    ],
)
def test_odd_spellings_are_read_the_same(tmp_path, change) -> None:
    plain, odd = read(tmp_path, TEXT), read(tmp_path, change(TEXT))
    np.testing.assert_array_equal(odd.values, plain.values)
    assert odd.frame_time == plain.frame_time
    for a, b in zip(odd.joints, plain.joints, strict=True):
        assert a.name.lower().split() == b.name.lower().split()
        assert (a.parent, a.channels) == (b.parent, b.channels)
        np.testing.assert_array_equal(a.offset, b.offset)


def test_a_missing_end_site_and_two_roots_are_read(tmp_path) -> None:
    end = "    End Site\n    {\n      OFFSET 0.0 1.0 0.0\n    }\n"
    assert len(read(tmp_path, TEXT.replace(end, "")).joints) == 2
    two = TEXT.replace("MOTION", "ROOT Prop\n{\nOFFSET 0 0 0\n}\nMOTION")
    assert [joint.parent for joint in read(tmp_path, two).joints] == [-1, 0, 1, -1]


def test_a_position_on_a_joint_replaces_its_offset(tmp_path) -> None:
    text = (
        TEXT.replace(
            "CHANNELS 3 Yrotation Xrotation Zrotation", "CHANNELS 2 Xposition Zrotation"
        )
        .replace("40 50 60", "7 90")
        .replace("0 0 0\n", "7 0\n")
    )
    tree = bvh_tree(read(tmp_path, text))
    R = Rotation.from_euler("ZXY", [10, 20, 30], degrees=True)
    np.testing.assert_allclose(tree.positions[1][0], [1, 2, 3] + R.apply([7, 2, 3]))


def test_positions_of_nothing_beside_an_offset_are_added_to_it(tmp_path) -> None:
    text = (
        TEXT.replace(
            "CHANNELS 3 Yrotation Xrotation Zrotation",
            "CHANNELS 4 Xposition Yposition Zposition Zrotation",
        )
        .replace("40 50 60", "0 0 0.1 90")
        .replace("0 0 0\n", "0 0 0 0\n")
    )
    tree = bvh_tree(read(tmp_path, text))
    for frame, (y, offset) in enumerate(((30, [1, 2, 3.1]), (0, [1, 2, 3]))):
        R = Rotation.from_euler("ZXY", [10, 20, y], degrees=True)
        np.testing.assert_allclose(
            tree.positions[1][frame], [1, 2, 3] + R.apply(offset), atol=1e-12
        )


def test_names_in_latin_letters_are_read(tmp_path) -> None:
    bvh = read(tmp_path, TEXT.replace("Hips", "H\u00fcfte").encode("latin-1"))
    assert bvh.joints[0].name == "H\u00fcfte"


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("10 20 30", "10 1e300 30", ":19: '1e300' is no measurement"),
        ("10 20 30", "10 2,5 30", ":19: expected a number, found '2,5'; write a point"),
        ("10 20 30", "10 20-30", ":19: 8 values in frame 1"),
        ("1.0 2.0 3.0", "1.0 2.0 inf", ":8: inf is not a finite number"),
        ("Frames: 2", "Frames: 1e308", ":17: '1e308' is no measurement"),
        ("HIERARCHY", "HIERACHY", ":1: not a BVH motion: expected HIERARCHY"),
        (" 40 50 60", " 40 50", ":19: 8 values in frame 1, but the channels are 9"),
        ("60\n", "60 70\n", ":19: 10 values in frame 1"),
        ("10 20 30", "10 nan 30", ":19: nan is not a finite number"),
        ("10 20 30", "10 2O 30", ":19: expected a number, found '2O'"),
        ("0.0083333", "0", ":18: a frame time of 0 s"),
        ("0.0083333", "-0.01", ":18: a frame time of -0.01 s"),
        ("0.0083333", "fast", ":18: expected a number, found 'fast'"),
        ("Frames: 2", "Frames: 0", ": the motion has no frames"),
        ("Frames: 2", "Frames: 3", ": 2 of 3 frames are there"),
        ("Frames: 2", "Frames: 1", ":20: a line too many"),
        ("Frames: 2\n", "", ":18: expected Frames:"),
        ("    }\n  }\n}\n", "    }\n  }\n", ": MOTION inside joint 'Hips'"),
        ("}\nMOTION", "}\n}\nMOTION", ": a } too many"),
        ("    OFFSET 1.0 2.0 3.0\n", "", "has no OFFSET"),
        ("OFFSET 1.0 2.0 3.0", "OFFSET 1.0 2.0", ":8: expected 3 numbers, found 2"),
        ("CHANNELS 3 Y", "CHANNELS 4 Y", ":9: CHANNELS says 4, found 3"),
        ("3 Yrotation X", "3 Xrotation X", ":9: a channel is listed twice"),
        ("Yrotation Xrotation Zrotation", "Yrot X Z", ":9: channel 'yrot' is not"),
        ("JOINT", "BONE", ":6: expected OFFSET, CHANNELS, JOINT"),
    ],
)
def test_mistakes_name_their_line(tmp_path, old, new, message) -> None:
    assert old in TEXT
    assert message in refusal(tmp_path, TEXT.replace(old, new, 1))


def test_files_that_are_cut_off_or_none(tmp_path) -> None:
    assert "the file is empty" in refusal(tmp_path, "")
    for end in range(20, TEXT.index("1 2 3 1e1"), 23):
        assert refusal(tmp_path, TEXT[:end]).startswith(":")
    (tmp_path / "b.bvh").write_bytes(bytes(range(256)) * 4)
    with pytest.raises(MotionError, match="not a BVH"):
        read_bvh(tmp_path / "b.bvh")
    with pytest.raises(MotionError, match="cannot read"):
        read_bvh(tmp_path / "none.bvh")
