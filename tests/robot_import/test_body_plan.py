"""Bodies that a person's motion does not fit: told what they are, or refused."""

import numpy as np
import pytest
from small_urdfs import humanoid, humanoid_with_legs, joint, link, robot, write

from crar_drake.errors import ModelError
from crar_drake.robot_import import import_robot
from crar_drake.robot_import.anatomy import find_anatomy
from crar_drake.robot_import.body_frames import guess_frames
from crar_drake.robot_import.body_plan import (
    frame_alarms,
    refuse_hand,
    turned_hands,
)
from crar_drake.robot_import.choices import FrameChoice
from crar_drake.robot_import.joint_groups import guess_locked, joint_groups
from crar_drake.robot_import.source_urdf import read_urdf

BALL = '<sphere radius="0.02"/>'


def limb(name: str, start: str, first: str, steps, limits: str = "") -> list[str]:
    """A chain: where its first joint is, and (axis, way to the next joint) of each."""
    parts, below, xyz = [], start, first
    for number, (axis, way) in enumerate(steps, 1):
        here = f"{name}_l{number}"
        more = {"limits": limits} if limits and number == len(steps) else {}
        parts.append(link(here, BALL, mass=0.2))
        parts.append(joint(f"{name}_j{number}", below, here, axis, xyz, **more))
        below, xyz = here, way
    return parts


def read(tmp_path, parts):
    return read_urdf(write(tmp_path, robot([link("body", BALL), *parts])))


def said(source) -> str:
    anatomy = find_anatomy(source)
    frames = {} if anatomy is None else guess_frames(source, anatomy)
    return " ".join(frame_alarms(source, anatomy, frames, False))


LEG = [("1 0 0", "0 0 0"), ("0 1 0", "0 0 -0.2"), ("0 1 0", "0 0 -0.2")]
FOUR = [(f"{end}{side}", f"{x} {y} 0") for end, x in (("f", 0.2), ("h", -0.2))
        for side, y in (("l", 0.1), ("r", -0.1))]  # fmt: skip


def test_a_quadruped_is_called_one(tmp_path):
    legs = [part for name, at in FOUR for part in limb(name, "body", at, LEG)]
    assert "a quadruped: keyframes can be run" in said(read(tmp_path, legs))


FINGER = [("0 0 1", "0.02 0 0"), ("0 1 0", "0.04 0 0"), ("0 1 0", "0.03 0 0")]


def test_a_hand_alone_is_refused(tmp_path):
    """With or without a wrist; on an arm it is none."""
    wrist = limb("wrist", "body", "0 0 0", [("0 1 0", "0 0 0"), ("0 0 1", "0 0 0")])
    for start, first in (("body", []), ("wrist_l2", wrist)):
        fingers = [
            part
            for k in range(4)
            for part in limb(f"f{k}", start, f"0.09 {0.02 * k} 0", FINGER)
        ]
        with pytest.raises(ModelError, match="a hand with 4 fingers, and neither"):
            refuse_hand(read(tmp_path, [*first, *fingers]))
    with pytest.raises(ModelError, match="small.urdf: a hand with 4 fingers"):
        import_robot(tmp_path / "small.urdf", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    for text in (humanoid(), humanoid_with_legs()):
        refuse_hand(read_urdf(write(tmp_path, text)))
    # A child's size: limbs as short as fingers, but for the legs.
    arms = [("0 1 0", "0 0 0.02"), ("1 0 0", "0 0 -0.09"), ("0 1 0", "0 0 -0.1")]
    small = [
        *(p for s, y in (("l", 0.06), ("r", -0.06))
          for p in limb(f"{s}a", "body", f"0 {y} 0.1", arms)),
        *(p for s, y in (("l", 0.04), ("r", -0.04))
          for p in limb(f"{s}l", "body", f"0 {y} 0", LEG)),
    ]  # fmt: skip
    refuse_hand(read(tmp_path, small))


def test_arms_of_three_joints_are_told(tmp_path):
    arm = [("0 1 0", "0 0 0"), ("1 0 0", "0 0 -0.2"), ("0 1 0", "0 0 -0.04")]
    parts = [
        part
        for side, y in (("left", 0.15), ("right", -0.15))
        for part in limb(side, "body", f"0 {y} 0.3", arm)
    ]
    text = said(read(tmp_path, parts))
    assert "left_l3 and right_l3 mirror each other with 3 joints" in text
    assert "left_elbow" in text and "list them as frames in import.yaml" in text


def test_two_arms_side_by_side_are_told(tmp_path):
    """As two arms of one kind on a table: moved, not mirrored."""
    axes = ("0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1", "0 1 0")
    arm = [(axis, "0.01 0.05 0.2") for axis in axes]
    parts = [
        part
        for name, y in (("a", 0.4), ("b", -0.4))
        for part in limb(name, "body", f"0 {y} 0", arm)
    ]
    text = said(read(tmp_path, parts))
    assert "a_l6 and b_l6 are alike, side by side" in text


@pytest.mark.parametrize("limits, opens", [("-1.57 0", True), ("-1.57 1.57", False)])
def test_a_jaw_is_no_joint_of_an_arm(tmp_path, limits, opens):
    lower, upper = limits.split()
    axes = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0", "0 1 0")
    parts = limb(
        "arm", "body", "0 0 0.1", [(axis, "0.15 0 0") for axis in axes],
        f'lower="{lower}" upper="{upper}" effort="20" velocity="5"',
    )  # fmt: skip
    source = read(tmp_path, parts)
    assert joint_groups(source, None)["arm_j7"] == ("hands" if opens else "arms")
    assert ("arm_j7" in guess_locked(source, None)) == opens
    assert said(source) == ""  # an arm needs no frames of a person


def test_what_a_whole_body_lacks_is_told(tmp_path):
    source = read_urdf(write(tmp_path, humanoid()))
    anatomy = find_anatomy(source)
    frames = dict(guess_frames(source, anatomy))
    assert not any("knee" in x for x in frame_alarms(source, anatomy, frames, False))
    (alarm,) = (x for x in frame_alarms(source, anatomy, frames, True) if "knee" in x)
    assert "left_knee" in alarm and "right_foot" in alarm
    del frames["left_wrist"]
    (alarm,) = frame_alarms(source, anatomy, frames, False)
    assert "Without left_wrist no motion of a person" in alarm


def test_a_hand_that_is_turned_is_told(tmp_path):
    source = read_urdf(write(tmp_path, humanoid()))  # its arms hang: x is ahead
    anatomy = find_anatomy(source)
    frames = dict(guess_frames(source, anatomy))
    (alarm,) = turned_hands(source, frames)
    assert "left_hand (90°), right_hand (90°)" in alarm and "rpy" in alarm
    for side in ("left", "right"):  # x down
        hand = frames[f"{side}_hand"]
        frames[f"{side}_hand"] = FrameChoice(hand.link, hand.point, [0, np.pi / 2, 0])
    assert turned_hands(source, frames) == []
