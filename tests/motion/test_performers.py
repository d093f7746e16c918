"""One motion through every naming, and every convention of axes, unit and rest pose."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from bvh_maker import AXES, NAMES, TREE, Convention, along_x, arms_hang, bvh_text
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.catalogue import load_clip, load_performer
from crar_drake.motion.formats.asf_amc import Clip
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import Performer
from crar_drake.motion.performers.asf_amc import asf_amc_performer
from crar_drake.motion.retarget import HANGS_ON, retarget

LENGTHS = {"waist": 0.7} | {end: 0.2 for end in HANGS_ON}


@pytest.fixture(scope="module")
def clip() -> Clip:
    """A part of the built-in dance: it turns, bends and steps."""
    whole = load_clip("dance")
    part = slice(200, 300)
    return dataclasses.replace(
        whole,
        root_position=whole.root_position[part],
        root_rotation=whole.root_rotation[part],
        joints={name: values[part] for name, values in whole.joints.items()},
    )


def performed(folder: Path, text: str, **options) -> Performer:
    (folder / "a.bvh").write_text(text, newline="")
    return load_performer(str(folder / "a.bvh"), MotionOptions(**options))


@pytest.fixture(scope="module")
def plain(clip, tmp_path_factory) -> Performer:
    return performed(tmp_path_factory.mktemp("plain"), bvh_text(clip, Convention()))


CONVENTIONS = {
    **{f"names of {names}": Convention(names=names) for names in NAMES},
    **{axes: Convention(axes=axes) for axes in AXES},
    "metres": Convention(unit=1.0),
    "millimetres": Convention(unit=1e-3),
    "inches": Convention(unit=0.0254),
    "unit of CMU": Convention(unit=0.0254 / 0.45, names="cmu"),
    "XYZ": Convention(order="XYZ"),
    "YXZ, z up in mm": Convention(
        order="YXZ", axes="z up, -y forward", unit=1e-3, names="biped"
    ),
    "a position on every joint": Convention(all_positions=True, order="ZXY"),
    "arms hang at rest": Convention(zero=arms_hang, names="xsens"),
    "all along x at zero": Convention(zero=along_x, names="lafan1", order="ZYX"),
    "nameless, z up, along x": Convention(
        zero=along_x, names="nothing", axes="z up, -x forward"
    ),
    "nameless, x forward": Convention(names="nothing", axes="y up, x forward"),
}


@pytest.mark.parametrize("case", CONVENTIONS)
def test_every_convention_gives_the_same_targets(case, clip, plain, tmp_path) -> None:
    convention = CONVENTIONS[case]
    performer = performed(tmp_path, bvh_text(clip, convention))
    expected = retarget(plain, LENGTHS)
    targets = retarget(performer, LENGTHS)
    for name, p_WC in expected.positions.items():
        np.testing.assert_allclose(targets.positions[name], p_WC, atol=1e-6)
    np.testing.assert_allclose(targets.heading, expected.heading, atol=1e-6)
    assert performer.height == pytest.approx(plain.height, abs=1e-6)
    assert set(performer.positions) == set(plain.positions)
    assert bool(performer.doubts) == (case == "names of swapped")


def test_joint_centres_are_those_of_the_amc(clip, plain) -> None:
    truth = asf_amc_performer(clip)
    for joint in set(plain.positions) - {"left_toe", "right_toe"}:
        np.testing.assert_allclose(
            plain.positions[joint], truth.positions[joint], atol=1e-8
        )
        np.testing.assert_allclose(
            plain.orientations[joint], truth.orientations[joint], atol=1e-7
        )
    np.testing.assert_allclose(plain.heading, truth.heading, atol=1e-8)
    for hand, R_WH in truth.hands.items():
        np.testing.assert_allclose(plain.hands[hand], R_WH, atol=1e-7)


def test_what_was_inferred_is_said(plain) -> None:
    facts = {fact.what: (fact.value, fact.source) for fact in plain.facts}
    assert facts["unit"] == ("cm", "inferred")
    assert facts["up"] == ("+y", "inferred")
    assert facts["facing"] == ("+z", "inferred")
    assert facts["rest pose"] == ("T-pose", "file")
    matches = list(plain.matches())
    assert "left_shoulder: LeftArm" in matches
    assert "left_toe: end of LeftFoot" in matches


def test_limbs_by_the_tree_are_said(clip, plain, tmp_path) -> None:
    assert not any("tree" in fact.value for fact in plain.facts)
    text = bvh_text(clip, Convention())
    for i, name in enumerate(("Arm", "ForeArm", "Hand")):
        for side in ("Left", "Right"):
            text = re.sub(rf"\b{side}{name}\b", f"Bone{side[0] == 'L':d}{i}", text)
    performer = performed(tmp_path, text)
    assert "left_elbow: Bone11" in list(performer.matches())
    said = [str(fact) for fact in performer.facts]
    assert (
        "arms by the shape of the tree (inferred: names do not tell them; "
        "--joints says otherwise)" in said
    )


def test_overrides_count(clip, tmp_path) -> None:
    text = bvh_text(clip, Convention())
    upright = performed(tmp_path, text)
    turned = performed(tmp_path, text, facing="x", up="y", unit="0.02")
    p, q = upright.positions["neck"], turned.positions["neck"]
    # The file's x, to the left, is now forward: forward goes to the right.
    np.testing.assert_allclose(q, 2.0 * np.stack([p[:, 1], -p[:, 0], p[:, 2]], 1))
    assert "standing height 3.3" in turned.doubts[0]
    with pytest.raises(MotionError, match="facing.*up.*one axis"):
        MotionOptions(facing="-y", up="y")
    with pytest.raises(MotionError, match="unit: 'ell' is none; known: m, cm"):
        MotionOptions(unit="ell")


def test_a_file_of_joints_overrides_the_match(clip, plain, tmp_path) -> None:
    joints = tmp_path / "joints.yaml"
    joints.write_text("left_wrist: LeftForeArm\nleft_elbow: LeftArm\n")
    text = bvh_text(clip, Convention())
    with pytest.raises(MotionError, match="do not hang on each other; name all"):
        performed(tmp_path, text, joints=str(joints))
    joints.write_text(
        "left_wrist: LeftForeArm\nleft_elbow: LeftArm\nleft_shoulder: LeftShoulder\n"
    )
    performer = performed(tmp_path, text, joints=str(joints))
    np.testing.assert_allclose(
        performer.positions["left_wrist"], plain.positions["left_elbow"]
    )
    joints.write_text("left_wrist: LeftHnd\n")
    with pytest.raises(MotionError, match="no 'LeftHnd'; did you mean 'LeftHand'"):
        performed(tmp_path, text, joints=str(joints))
    joints.write_text("left_paw: LeftHand\n")
    with pytest.raises(MotionError, match="left_paw"):
        performed(tmp_path, text, joints=str(joints))


# --- nasty performers --------------------------------------------------------------


def test_a_start_in_lying_does_not_turn_the_world(clip, tmp_path) -> None:
    """Lying on the back for a third of the time, as the file begins."""
    pitch = clip.root_rotation.copy()
    pitch[:35] = [-np.pi / 2.0, 0.0, 0.0]
    lying = dataclasses.replace(clip, root_rotation=pitch)
    for zero in (Convention().zero, along_x):
        text = bvh_text(lying, Convention(zero=zero, axes="z up, -y forward"))
        performer = performed(tmp_path, text)
        assert performer.up == "+z"
        truth = asf_amc_performer(lying)
        np.testing.assert_allclose(
            performer.positions["left_knee"] - performer.positions["pelvis"],
            truth.positions["left_knee"] - truth.positions["pelvis"],
            atol=1e-8,
        )


def test_a_skeleton_that_lies_in_a_world_in_which_it_moves_upright(
    clip, plain, tmp_path
) -> None:
    """Its zero pose stands along y, its motion along z: that pose is no standing one,
    and the pelvis is known by hips and trunk."""
    head, motion = bvh_text(clip, Convention(order="ZYX")).split("MOTION\n")
    lines, turn = motion.strip().split("\n"), Rotation.from_euler("x", 90, degrees=True)
    for i, line in enumerate(lines[2:], start=2):
        row = np.array(line.split(), float)
        row[:3] = turn.apply(row[:3])
        turned = turn * Rotation.from_euler("ZYX", row[3:6], degrees=True)
        row[3:6] = turned.as_euler("ZYX", degrees=True)
        lines[i] = " ".join(f"{number:.9f}" for number in row)
    performer = performed(tmp_path, head + "MOTION\n" + "\n".join(lines))
    assert performer.up == "+z"
    assert any("the rest pose stands along +y" in doubt for doubt in performer.doubts)
    up = performer.orientations["pelvis"][:, :, 2]
    upright = plain.orientations["pelvis"][:, :, 2]
    off = np.arccos(np.clip(up[:, 2], -1, 1)) - np.arccos(np.clip(upright[:, 2], -1, 1))
    assert np.abs(np.degrees(off)).max() < 20.0


def test_a_neck_that_no_name_tells_is_between_the_shoulders(clip, tmp_path) -> None:
    performer = performed(
        tmp_path, bvh_text(clip, Convention()).replace("Neck", "Bone")
    )
    assert "neck: between the shoulders (a guess)" in list(performer.matches())
    shoulders = [performer.positions[f"{side}_shoulder"] for side in ("left", "right")]
    np.testing.assert_allclose(performer.positions["neck"], np.mean(shoulders, axis=0))
    assert "neck" not in performer.orientations


def test_one_frame_apart_is_left_out(clip, tmp_path) -> None:
    joints = {name: values.copy() for name, values in clip.joints.items()}
    for values in joints.values():
        values[0] = 0.0
    joints["lhumerus"][1:] += [0.0, 0.0, 0.6]
    position, rotation = clip.root_position.copy(), clip.root_rotation.copy()
    position[0], rotation[0] = [3.0, 1.0, -2.0], 0.0
    text = bvh_text(
        dataclasses.replace(
            clip, joints=joints, root_position=position, root_rotation=rotation
        ),
        Convention(),
    )
    performer = performed(tmp_path, text)
    assert performer.num_frames == clip.num_frames - 1
    assert "frame 1 is a pose apart" in performer.notes[0]


def with_frame_time(clip: Clip, written: str) -> str:
    return re.sub(r"(?<=Frame Time: ).*", written, bvh_text(clip, Convention()))


@pytest.mark.parametrize(
    "written, rate",
    [
        ("30", 30.0),
        ("120", 120.0),
        ("33.3333", 30.0),
        ("8.3333", 120.0),
        ("16667", 60.0),
        ("0.0333333", 30.0),
        ("0.04", 25.0),
    ],
)
def test_a_frame_time_that_is_a_rate_or_milliseconds(clip, tmp_path, written, rate):
    text = with_frame_time(clip, written)
    performer = performed(tmp_path, text)
    assert performer.frame_rate == rate
    odd = float(written) >= 1.0
    assert odd == any("--frame-rate HZ" in note for note in performer.notes)
    assert performed(tmp_path, text, frame_rate=77.0).frame_rate == 77.0


@pytest.mark.parametrize("written", ["20", "7.7", "1e8"])
def test_a_frame_time_that_nothing_explains_is_refused(clip, tmp_path, written):
    text = with_frame_time(clip, written)
    with pytest.raises(MotionError, match="frame time of .* is none .*--frame-rate HZ"):
        performed(tmp_path, text)


def test_a_slow_rate_is_doubted(clip, tmp_path) -> None:
    text = with_frame_time(clip, "0.5")
    assert "a rate of 2 Hz is no camera's" in performed(tmp_path, text).doubts[-1]


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("held, frames", [(6, 6), (1, 1), (80, 80), (200, 0)])
def test_frames_of_the_zero_pose_are_left_out(
    clip, tmp_path, held, frames, last
) -> None:
    """As converters for DAZ write them first, and those of PFNN's recordings last; two
    seconds of it are a part of the motion."""
    head, rows = with_frame_time(clip, "0.0083333").split("Frame Time: 0.0083333\n")
    rows = rows.splitlines()
    place = rows[-1 if last else 0].split()[:3]
    pose = [" ".join(place + ["0"] * (len(rows[0].split()) - 3))] * held
    rows = rows + pose if last else pose + rows
    head = head.replace(f"Frames: {clip.num_frames}", f"Frames: {len(rows)}")
    text = head + "Frame Time: 0.0083333\n" + "\n".join(rows) + "\n"
    performer = performed(tmp_path, text)
    assert performer.num_frames == len(rows) - frames
    told = [note for note in performer.notes if "a pose apart" in note]
    assert len(told) == bool(frames)
    if frames > 1:
        first = len(rows) - frames + 1 if last else 1
        which = f"frames {first} to {first + frames - 1} are a pose apart"
        assert told[0].startswith(which)


@pytest.mark.parametrize("held, left", [(30, 40), (60, 100)])
def test_what_is_apart_is_the_shorter_part(clip, tmp_path, held, left) -> None:
    head, rows = with_frame_time(clip, "0.0083333").split("Frame Time: 0.0083333\n")
    rows = rows.splitlines()[:40]
    pose = " ".join(rows[0].split()[:3] + ["0"] * (len(rows[0].split()) - 3))
    rows = [pose] * held + rows
    head = head.replace(f"Frames: {clip.num_frames}", f"Frames: {len(rows)}")
    text = head + "Frame Time: 0.0083333\n" + "\n".join(rows) + "\n"
    assert performed(tmp_path, text).num_frames == left


def test_poses_apart_at_both_ends_are_left_out(clip, tmp_path) -> None:
    head, rows = bvh_text(clip, Convention()).split("Frame Time: ")
    time, *rows = rows.splitlines()
    pose = " ".join(["0"] * len(rows[0].split()))
    head = head.replace(f"Frames: {clip.num_frames}", f"Frames: {len(rows) + 3}")
    text = "\n".join([f"{head}Frame Time: {time}", pose, *rows, pose, pose]) + "\n"
    performer = performed(tmp_path, text)
    assert performer.num_frames == clip.num_frames
    assert len([n for n in performer.notes if "a pose apart" in n]) == 2


def test_positions_of_nothing_on_every_joint_are_told(clip, plain, tmp_path) -> None:
    """Each joint has position channels, all 0 beside its OFFSET, but for the root."""
    lines = bvh_text(clip, Convention()).split("\n")
    joints = [line for line in lines if "CHANNELS" in line]
    lines = [
        line.replace("CHANNELS 3 ", "CHANNELS 6 Xposition Yposition Zposition ")
        for line in lines
    ]
    start = next(i for i, line in enumerate(lines) if "Frame Time" in line) + 1
    for i in range(start, len(lines)):
        if words := lines[i].split():
            columns = words[:6]
            for j in range(1, len(joints)):
                columns += ["0", "0", "0", *words[3 + 3 * j : 6 + 3 * j]]
            lines[i] = " ".join(columns)
    performer = performed(tmp_path, "\n".join(lines))
    assert "more joints are about 0 beside their OFFSET" in performer.notes[0]
    for joint, positions in plain.positions.items():
        np.testing.assert_allclose(performer.positions[joint], positions, atol=1e-8)


def test_giants_need_a_unit(clip, tmp_path) -> None:
    text = bvh_text(clip, Convention(unit=1e-5))
    with pytest.raises(MotionError, match="in no unit .*--unit"):
        performed(tmp_path, text)
    assert performed(tmp_path, text, unit="1e-5").height == pytest.approx(
        1.69, abs=0.01
    )


def test_a_body_without_arms_or_legs_says_what_was_found(clip, tmp_path) -> None:
    for part, names in (("arm", "nothing"), ("leg", "lafan1")):
        text = bvh_text(clip, Convention(names=names))
        without = _without(text, names, part)
        with pytest.raises(MotionError, match=f"no two {part}s") as caught:
            performed(tmp_path, without)
        message = str(caught.value)
        assert "--joints FILE" in message and "two like branches" in message


def _without(text: str, names: str, part: str) -> str:
    """A BVH whose limbs of a kind are cut off, with their columns."""
    roots = {
        "arm": ("left_collar", "right_collar"),
        "leg": ("left_thigh", "right_thigh"),
    }
    lines, columns, cut, column, depth = [], [], None, 0, 0
    roots = [NAMES[names][root] for root in roots[part]]
    head, motion = text.split("MOTION\n")
    for line in head.splitlines():
        word, *rest = line.split()
        if word == "JOINT" and " ".join(rest) in roots:
            cut = depth
        if word == "CHANNELS":
            width = int(rest[0])
            columns += [column + i for i in range(width) if cut is None]
            column += width
        if cut is None:
            lines.append(line)
        depth += {"{": 1, "}": -1}.get(word, 0)
        if cut == depth and word == "}":
            cut = None
    rows = motion.splitlines()
    kept = [" ".join(row.split()[i] for i in columns) for row in rows[2:]]
    return "\n".join([*lines, "MOTION", *rows[:2], *kept]) + "\n"


def test_the_tree_is_whole() -> None:
    """The maker itself: each parent comes before its children."""
    seen = [""]
    for joint, (_, parent) in TREE.items():
        assert parent in seen
        seen.append(joint)
