"""MVNX files, against SciPy's rotations of a body that the test makes."""

from pathlib import Path

import numpy as np
import pytest
from performed import performed
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.performer import JOINTS

T, RATE = 30, 60.0
# Segment: the one it hangs on, and where it begins in that, in a T-pose [m].
BODY = {"Pelvis": ("", (0.0, 0.0, 0.95)), "L5": ("Pelvis", (0.0, 0.0, 0.1)),
        "L3": ("L5", (0.0, 0.0, 0.1)), "T12": ("L3", (0.0, 0.0, 0.1)),
        "T8": ("T12", (0.0, 0.0, 0.1)), "Neck": ("T8", (0.0, 0.0, 0.12)),
        "Head": ("Neck", (0.0, 0.0, 0.1))}  # fmt: skip
for side, y in (("Right", -1.0), ("Left", 1.0)):
    BODY[f"{side}Shoulder"] = ("T8", (0.0, 0.03 * y, 0.07))
    BODY[f"{side}UpperArm"] = (f"{side}Shoulder", (0.0, 0.14 * y, 0.0))
    BODY[f"{side}ForeArm"] = (f"{side}UpperArm", (0.0, 0.27 * y, 0.0))
    BODY[f"{side}Hand"] = (f"{side}ForeArm", (0.0, 0.24 * y, 0.0))
    BODY[f"{side}UpperLeg"] = ("Pelvis", (0.0, 0.09 * y, 0.0))
    BODY[f"{side}LowerLeg"] = (f"{side}UpperLeg", (0.0, 0.0, -0.42))
    BODY[f"{side}Foot"] = (f"{side}LowerLeg", (0.0, 0.0, -0.42))
    BODY[f"{side}Toe"] = (f"{side}Foot", (0.16, 0.0, -0.08))


def poses() -> dict[str, list[tuple[np.ndarray, Rotation]]]:
    """(p, R) of each segment in each frame: a person who walks and turns."""
    rng = np.random.default_rng(4)
    sizes = {name: rng.uniform(0.05, 0.3, 3) for name in BODY}
    found: dict[str, list] = {name: [] for name in BODY}
    for k in range(T):
        for name, (parent, offset) in BODY.items():
            turn = Rotation.from_rotvec(sizes[name] * np.sin(0.2 * k + sizes[name]))
            if not parent:
                turn = Rotation.from_euler("z", 0.3 + 0.02 * k)
                found[name].append((np.array(offset) + [0.02 * k, 0.0, 0.0], turn))
                continue
            p, R = found[parent][k]
            found[name].append((p + R.apply(offset), R * turn))
    return found


def mvnx(frames=None, namespace=' xmlns="http://www.xsens.com/mvn/mvnx"') -> str:
    truth = poses()
    lines = [f'<?xml version="1.0"?><mvnx version="4"{namespace}>',
             f'<subject label="A" frameRate="{RATE:g}" segmentCount="{len(BODY)}">',
             "<segments>", *(f'<segment label="{name}" id="1"/>' for name in BODY),
             "</segments><frames>",
             '<frame type="tpose"><position>0</position></frame>']  # fmt: skip
    for k in range(T):
        p = " ".join(f"{x:.9f}" for name in BODY for x in truth[name][k][0])
        turns = [np.roll(truth[name][k][1].as_quat(), 1) for name in BODY]
        q = " ".join(f"{x:.9f}" for turn in turns for x in turn)
        lines.append(f'<frame type="normal" index="{k}"><orientation>{q}</orientation>')
        lines.append(f"<position>{p}</position><velocity>0 0</velocity></frame>")
    lines.append("</frames></subject></mvnx>")
    return "\n".join(lines)


@pytest.mark.parametrize("namespace", [' xmlns="http://www.xsens.com/mvn/mvnx"', ""])
def test_it_is_read(namespace: str, tmp_path: Path) -> None:
    (tmp_path / "a.mvnx").write_text(mvnx(namespace=namespace))
    performer = performed(tmp_path / "a.mvnx")
    assert performer.format == "MVNX" and performer.frame_rate == RATE
    assert performer.up == "+z" and performer.facing == "+x"
    assert set(performer.positions) == set(JOINTS)
    truth = poses()
    for joint, segment in (("pelvis", "Pelvis"), ("left_elbow", "LeftForeArm"),
                           ("right_wrist", "RightHand"), ("left_toe", "LeftToe"),
                           ("head", "Head")):  # fmt: skip
        for k in (0, T - 1):
            p, R = truth[segment][k]
            np.testing.assert_allclose(performer.positions[joint][k], p, atol=1e-6)
            turned = performer.orientations[joint][k]
            np.testing.assert_allclose(turned, R.as_matrix(), atol=1e-6)
    np.testing.assert_allclose(performer.heading, 0.3 + 0.02 * np.arange(T), atol=1e-6)
    # x to the fingertips, z to the thumb, which points ahead at rest.
    R = truth["RightHand"][5][1].as_matrix()
    hand = performer.hands["right_hand"][5]
    np.testing.assert_allclose(hand[:, 0], -R[:, 1], atol=1e-6)
    np.testing.assert_allclose(hand[:, 2], R[:, 0], atol=1e-6)
    assert performer.carriers["left_wrist"] >= {"LeftForeArm", "T8", "Pelvis"}
    bend = truth["LeftUpperArm"][3][1].inv() * truth["LeftForeArm"][3][1]
    next_bend = truth["LeftUpperArm"][4][1].inv() * truth["LeftForeArm"][4][1]
    expected = (bend.inv() * next_bend).magnitude()
    assert performer.turns["LeftForeArm"][3] == pytest.approx(expected, abs=1e-6)


def test_a_second_subject_is_named(tmp_path: Path) -> None:
    text = mvnx().replace("</subject>", '</subject><subject label="B"></subject>')
    (tmp_path / "a.mvnx").write_text(text)
    performer = performed(tmp_path / "a.mvnx")
    assert performer.num_frames == T
    assert performer.notes == ("other subjects in the file: B",)


WHOLE = mvnx()


@pytest.mark.parametrize(
    "text, options, said",
    [
        ("no XML", {}, "a.mvnx:1: no MVNX file"),
        (WHOLE[: len(WHOLE) // 2], {}, "cut off"),
        ("<bvh/>", {}, "its first element is bvh"),
        ("<mvnx><subject/></mvnx>", {}, "it has no segments"),
        (WHOLE.replace('"normal"', '"other"'), {}, "no frames with poses"),
        (WHOLE.replace("position>", "place>"), {}, "frame 1: it has no position"),
        (WHOLE.replace("<position>0.0", "<position>1 0.0", 2), {},
         "frame 1: position has 70 numbers"),
        (WHOLE.replace("<position>0.0", "<position>x0.0"), {}, "the file is damaged"),
        (WHOLE.replace("<orientation>0.9", "<orientation>7.9", 1), {},
         "the orientation of Pelvis has length"),
        (WHOLE.replace('label="LeftHand"', 'label="Claw"'), {}, "no left_wrist in it"),
        (WHOLE.replace('frameRate="60"', ""), {}, "--frame-rate HZ"),
        (WHOLE.replace('frameRate="60"', 'frameRate="0"'), {}, "one positive number"),
        (WHOLE, {"unit": "cm"}, "leave unit cm away"),
    ],
)  # fmt: skip
def test_wrong_files_are_told(text: str, options, said: str, tmp_path: Path) -> None:
    (tmp_path / "a.mvnx").write_text(text)
    with pytest.raises(MotionError, match=said):
        performed(tmp_path / "a.mvnx", **options)


def test_texts_that_grow_are_refused(tmp_path: Path) -> None:
    """Each entity is ten of the one before: a small file would fill the memory."""
    entities = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12))
    text = f'<!DOCTYPE mvnx [<!ENTITY e0 "0.0 ">{entities}]><mvnx>&e11;</mvnx>'
    (tmp_path / "a.mvnx").write_text(text)
    with pytest.raises(MotionError, match="no MVNX file"):
        performed(tmp_path / "a.mvnx")
