"""What robots that exist have and a body has not: found all the same, or told apart."""

import re
from dataclasses import replace

import numpy as np
import pytest
from small_urdfs import humanoid_with_legs, joint, link, robot, write

from crar_drake.errors import ModelError
from crar_drake.robot_import.alarms import coupling_alarms, limb_alarms
from crar_drake.robot_import.anatomy import find_anatomy, find_leg_chains
from crar_drake.robot_import.body_frames import (
    guess_frames,
    guess_leg_and_head_frames,
    guess_tool,
    has_feet,
)
from crar_drake.robot_import.facing import guess_facing, guess_up, turned
from crar_drake.robot_import.joint_groups import guess_locked, joint_groups
from crar_drake.robot_import.meshes import with_looks
from crar_drake.robot_import.rest_posture import guess_rest
from crar_drake.robot_import.source_urdf import read_urdf

SIDES = (("left", 1.0), ("right", -1.0))


def added(text: str, parts: list[str]) -> str:
    return text.replace("</robot>", "".join(parts) + "</robot>")


def chain(names, start: str, ways, axes) -> list[str]:
    """Links and joints one after the other; a joint is called like its link."""
    parts, below = [], start
    for name, xyz, axis in zip(names, ways, axes, strict=True):
        parts += [
            link(name, '<sphere radius="0.02"/>'),
            joint(f"{name}_j", below, name, axis, xyz),
        ]
        below = name
    return parts


def arm_pair(steps) -> list[str]:
    """Two arms on a link `torso`; a step is (way with y to the left, axis)."""
    parts = [link("torso", '<box size="0.2 0.2 0.4"/>')]
    for side, y in SIDES:
        ways = [f"{x} {y * aside} {z}" for (x, aside, z), _ in steps]
        names = [f"{side}_{i}" for i in range(len(steps))]
        parts += chain(names, "torso", ways, [axis for _, axis in steps])
    return parts


def points(read) -> dict[str, np.ndarray]:
    """The motion's points in the robot's frame."""
    X = read.poses()
    frames = guess_frames(read, find_anatomy(read))
    return {n: X[f.link].multiply(np.array(f.point)) for n, f in frames.items()}


def test_what_is_welded_to_feet_and_hands_hides_no_limb(tmp_path):
    """Corners of soles, in an order of their own, and a camera on one hand."""
    parts = []
    for side, _ in SIDES:
        for corner, (dx, dy) in enumerate([(0.1, 0.05), (0.1, -0.05), (-0.1, 0.05)]):
            name = f"{side}_corner_{corner}"
            parts += [
                link(name, '<sphere radius="0.01"/>', mass=0.0),
                joint(
                    f"{name}_weld",
                    f"{side}_ankle_roll",
                    name,
                    xyz=f"{dx} {dy} 0",  # not mirrored
                    kind="fixed",
                ),
            ]
    parts += [
        link("camera", '<box size="0.02 0.02 0.02"/>', mass=0.0),
        joint("eye", "left_arm_hand", "camera", xyz="0.05 0.1 0", kind="fixed"),
    ]
    read = read_urdf(write(tmp_path, added(humanoid_with_legs(), parts)))
    anatomy = find_anatomy(read)
    legs = find_leg_chains(read, anatomy)
    assert [len(leg.joints) for leg in legs] == [6, 6]
    assert len(anatomy.left.joints) == 6


LEG = [("0 0 -0.1", "0 0 1"), ("0 0 0", "1 0 0"), ("0 0 0", "0 1 0")]
LEG += [("0 0 -0.4", "0 1 0"), ("0 0 -0.4", "0 1 0"), ("0 0 0", "1 0 0")]


@pytest.mark.parametrize(
    "names", [("hip_z", "hip_x", "hip_y", "knee", "ankle_y", "ankle_x"), range(6)]
)
def test_legs_alone_are_no_arms(tmp_path, names):
    """By their names, or if these say nothing since they hang down from the root."""
    parts = [link("pelvis", '<box size="0.2 0.2 0.2"/>')]
    for side, y in SIDES:
        ways = [LEG[0][0].replace("0 0 ", f"0 {0.1 * y} "), *(w for w, _ in LEG[1:])]
        named = [f"{side}_{name}" for name in names]
        parts += chain(named, "pelvis", ways, [axis for _, axis in LEG])
    assert find_anatomy(read_urdf(write(tmp_path, robot(parts)))) is None


def test_four_legs_are_not_two(tmp_path):
    text = humanoid_with_legs()
    assert find_leg_chains(*_with_anatomy(tmp_path, text)) is not None
    parts = []
    for side, y in SIDES:
        ways = [f"-0.5 {0.1 * y} -0.15", "0 0 0", "0 0 -0.3", "0 0 -0.3"]
        axes = ["1 0 0", "0 1 0", "0 1 0", "0 1 0"]
        parts += chain([f"{side}_hind_{i}" for i in range(4)], "pelvis", ways, axes)
    assert find_leg_chains(*_with_anatomy(tmp_path, added(text, parts))) is None


def test_what_is_on_one_side_alone_is_no_head(tmp_path):
    """As caps of shoulders, which reach above them."""
    text = humanoid_with_legs().replace("head", "bare").replace("0.09", "0.001")
    parts = []
    for side, y in SIDES:
        parts += [
            link(f"{side}_cap", '<sphere radius="0.1"/>'),
            joint(
                f"{side}_cap_j",
                "torso",
                f"{side}_cap",
                xyz=f"0 {0.2 * y} 0.4",
                kind="fixed",
            ),
        ]
    read, anatomy = _with_anatomy(tmp_path, added(text, parts))
    read = with_looks(read)
    frames, lacking = guess_leg_and_head_frames(read, anatomy)
    assert frames["head"].link == "bare"
    read = replace(read, looks=read.looks | {"bare": []})
    frames, lacking = guess_leg_and_head_frames(read, anatomy)
    assert "head" not in frames and lacking == ["head"]


def test_legs_without_a_shape_at_their_end_have_no_feet(tmp_path):
    """As of a model whose feet are masses alone: nothing says where its soles are."""
    read, anatomy = _with_anatomy(tmp_path, humanoid_with_legs())
    read = with_looks(read)
    assert has_feet(read, anatomy)
    read = replace(read, looks=read.looks | {"left_leg": []})
    assert not has_feet(read, anatomy)


def _with_anatomy(folder, text):
    read = read_urdf(write(folder, text))
    return read, find_anatomy(read)


# Shoulder of three joints, elbow, wrist of two; the way to each, and its axis.
USUAL = [
    ((0, 0.2, 0.4), "0 1 0"),
    ((0, 0, 0), "1 0 0"),
    ((0, 0, 0), "0 0 1"),
    ((0, 0, -0.25), "0 1 0"),
    ((0, 0, -0.25), "0 0 1"),
    ((0, 0, 0), "1 0 0"),
]
STRAIGHT = {"left_3_j": 0.0, "right_3_j": 0.0}


def test_arms_that_cross_at_zero_keep_their_sides(tmp_path):
    """As YuMi's."""
    crossing = [
        *USUAL[:3],
        ((0.2, -0.2, 0), "0 1 0"),
        ((0.1, -0.15, 0), "0 0 1"),
        USUAL[5],
    ]
    read = read_urdf(write(tmp_path, robot(arm_pair(crossing))))
    assert read.poses()["left_5"].translation()[1] < -0.1
    found = guess_facing(read)
    assert (found.facing, found.doubt) == ("+x", "")
    assert find_anatomy(read).left.hand == "left_5"
    assert limb_alarms(read, guess_frames(read, find_anatomy(read))) == []


def test_a_shoulder_of_parallel_axes(tmp_path):
    """As industrial arms have it: the second joint and the elbow bend alike."""
    steps = [
        ((0, 0.2, 0.4), "0 0 1"),
        ((0, 0, 0), "0 1 0"),
        ((0, 0, -0.3), "0 1 0"),
        ((0, 0, -0.15), "0 0 1"),
        ((0, 0, -0.15), "0 1 0"),
        ((0, 0, 0), "0 0 1"),
    ]
    p = points(read_urdf(write(tmp_path, robot(arm_pair(steps)))))
    np.testing.assert_allclose(p["left_shoulder"], [0, 0.2, 0.4], atol=1e-5)
    np.testing.assert_allclose(p["left_elbow"], [0, 0.2, 0.1], atol=1e-5)


def test_an_origin_anywhere_along_its_axis(tmp_path):
    """As of Vega and Qinglong, whose left arm is the right one turned, not mirrored."""
    parts = arm_pair(USUAL)
    for old, new in (
        ('<child link="left_3"/><origin xyz="0 0.0 -0.25"/>', "0 0.06 -0.25"),
        ('<child link="left_4"/><origin xyz="0 0.0 -0.25"/>', "0 -0.06 -0.25"),
        ('<child link="right_3"/><origin xyz="0 -0.0 -0.25"/>', "0 0.06 -0.25"),
        ('<child link="right_4"/><origin xyz="0 -0.0 -0.25"/>', "0 -0.06 -0.25"),
    ):
        assert sum(old in part for part in parts) == 1
        way = old.partition('xyz="')[0] + f'xyz="{new}"/>'
        parts = [part.replace(old, way) for part in parts]
    p = points(read_urdf(write(tmp_path, robot(parts))))
    np.testing.assert_allclose(p["left_elbow"], [0, 0.2, 0.15], atol=1e-5)
    np.testing.assert_allclose(p["right_elbow"], [0, -0.2, 0.15], atol=1e-5)


@pytest.mark.parametrize("limits", ['lower="-1.4" upper="1.4" velocity="5"', ""])
@pytest.mark.parametrize("forearm", [(0, 0, -0.25), (0.2, 0, 0)])
def test_an_elbow_that_turns_as_far_both_ways_bends_as_a_persons(
    tmp_path, limits, forearm
):
    """As Digit's, whose left axis is the mirror image of the right one: both forearms
    go ahead or, if they are there already, up."""
    steps = [*USUAL[:4], (forearm, "0 0 1"), USUAL[5]]
    parts = []
    for part in arm_pair(steps):
        if 'name="right_3_j"' in part or 'name="left_3_j"' in part:
            part = re.sub("<limit .*?/>", f"<limit {limits}/>" if limits else "", part)
            part = part if limits else part.replace("revolute", "continuous")
        if 'name="right_3_j"' in part:
            part = part.replace('axis xyz="0 1 0"', 'axis xyz="0 -1 0"')
        parts.append(part)
    read, anatomy = _with_anatomy(tmp_path, robot(parts))
    rest = guess_rest(read, anatomy, frames=guess_frames(read, anatomy))
    X, straight = (read.poses(q) for q in (rest, rest | STRAIGHT))
    further = 0 if forearm[2] else 2  # ahead or up
    for side, _ in SIDES:
        wrist = f"{side}_4"
        way = X[wrist].translation() - straight[wrist].translation()
        assert way[further] > 0.1


def test_the_waist_is_where_a_body_has_it(tmp_path):
    """A root on the floor below legs, and a mount between two arms."""
    text = humanoid_with_legs()
    weld = joint("stands", "floor", "pelvis", xyz="0 0 0.9", kind="fixed")
    p = points(read_urdf(write(tmp_path, added(text, [link("floor"), weld]))))
    np.testing.assert_allclose(p["waist"], [0, 0, 0.85], atol=1e-5)  # between the hips
    mounted = [((0, 0.2, 0.0), "0 1 0"), *USUAL[1:]]
    p = points(read_urdf(write(tmp_path, robot(arm_pair(mounted)))))
    np.testing.assert_allclose(p["waist"], [0, 0, -0.9 * 0.5], atol=1e-5)


def test_a_gripper_is_no_joint_of_the_arm(tmp_path):
    """By what follows it, or by its name at the end of a chain."""
    steps = [(f"0 {0.2 * i} 0.2", "0 1 0") for i in range(5)]
    ways, axes = zip(*steps, strict=True)
    for name, extra, gripper in (
        ("jaw", [], True),
        ("gripper_yaw", [], False),
        (
            "drive",
            [
                link("other"),
                joint("other_j", "l4", "other", extra='<mimic joint="drive_j"/>'),
            ],
            True,
        ),
    ):
        parts = [link("base"), *chain([f"l{i}" for i in range(5)], "base", ways, axes)]
        parts += chain([name], "l4", ["0 0 0.1"], ["1 0 0"])
        read = read_urdf(write(tmp_path, robot([*parts, *extra])))
        assert guess_tool(read)["tool"].link == ("l4" if gripper else name)
        assert (f"{name}_j" in guess_locked(read, None)) == gripper


def test_a_gear_in_the_midst_of_an_arm_does_not_end_it(tmp_path):
    """As of a motor whose own gear is a link, which the upper arm's follows."""
    parts = arm_pair(USUAL)
    for side, _ in SIDES:
        (index,) = [k for k, p in enumerate(parts) if f'"{side}_2_j"' in p]
        follows = f'<mimic joint="{side}_gear_j"/></joint>'
        parts[index] = parts[index].replace("</joint>", follows)
        parts += [
            link(f"{side}_gear"),
            joint(f"{side}_gear_j", f"{side}_1", f"{side}_gear"),
        ]
    read, anatomy = _with_anatomy(tmp_path, robot(parts))
    assert anatomy.left.hand == "left_5" and len(anatomy.right.joints) == 6
    locked = guess_locked(read, anatomy)
    assert {"left_gear_j", "left_2_j"} <= locked.keys()
    assert any("left_gear_j" in x for x in coupling_alarms(read, anatomy, locked))


def test_a_telescope_is_a_part_of_its_arm(tmp_path):
    """Stretch's: its pieces follow each other, are locked, and carry a wrist."""
    parts = [link("base"), *chain(["lift"], "base", ["0 0 0.3"], ["0 0 1"])]
    below = "lift"
    for i in range(4):
        mimic = '<mimic joint="piece0_j"/>' if i else ""
        parts += [
            link(f"piece{i}", '<sphere radius="0.02"/>'),
            joint(f"piece{i}_j", below, f"piece{i}", "1 0 0", extra=mimic),
        ]
        below = f"piece{i}"
    wrist = ["yaw", "pitch", "roll"]
    parts += chain(wrist, below, ["0.1 0 0"] * 3, ["0 0 1", "0 1 0", "1 0 0"])
    parts += chain(["finger"], "roll", ["0.1 0 0"], ["0 0 1"])
    read = read_urdf(write(tmp_path, robot(parts)))
    assert guess_tool(read)["tool"].link == "roll"
    pieces = {f"piece{i}_j" for i in range(4)}
    assert set(guess_locked(read, None)) == {*pieces, "finger_j"}


def test_a_hand_of_long_fingers_ends_the_arm(tmp_path):
    """Four joints a finger, as many as an arm has; but shorter than the way to it."""
    parts = arm_pair(USUAL)
    for side, _ in SIDES:
        for digit in range(3):
            names = [f"{side}_digit{digit}_{i}" for i in range(4)]
            ways = [f"{0.02 * (digit - 1)} 0 -0.05", *["0 0 -0.03"] * 3]
            parts += chain(names, f"{side}_5", ways, ["0 1 0"] * 4)
    read = read_urdf(write(tmp_path, robot(parts)))
    assert find_anatomy(read).left.hand == "left_5"
    groups = joint_groups(read, find_anatomy(read))
    assert groups["left_digit2_3_j"] == "hands" and groups["left_5_j"] == "arms"


def test_what_is_beside_a_single_arm_is_locked(tmp_path):
    parts = [link("base"), *chain(["lift"], "base", ["0 0 0.3"], ["0 0 1"])]
    names = [f"l{i}" for i in range(4)]
    parts += chain(names, "lift", ["0.1 0 0.1"] * 4, ["0 1 0"] * 4)
    parts += chain(["pan", "tilt"], "lift", ["0 0 0.5", "0 0 0"], ["0 0 1", "0 1 0"])
    parts += chain(["wheel"], "base", ["0 0.2 0"], ["0 1 0"])
    read = read_urdf(write(tmp_path, robot(parts)))
    assert set(guess_locked(read, None)) == {"pan_j", "tilt_j", "wheel_j"}


@pytest.mark.parametrize("up, rpy", [("+y", "-1.5707963 0 0"), ("+x", "0 1.5707963 0")])
def test_another_axis_points_up(tmp_path, up, rpy):
    """The robot hangs on a root link of other axes; its limbs say which."""
    weld = (
        '<joint name="turned" type="fixed"><parent link="stand"/>'
        f'<child link="pelvis"/><origin rpy="{rpy}"/></joint>'
    )
    parts = [link("stand", mass=0.0), weld]
    read = read_urdf(write(tmp_path, added(humanoid_with_legs(), parts)))
    assert guess_up(read) == up
    facing = guess_facing(read, up)
    assert not facing.doubt
    p = points(turned(read, facing.facing, up))
    np.testing.assert_allclose(p["left_shoulder"], [0, 0.2, 0.4], atol=1e-5)
    usual = read_urdf(write(tmp_path, humanoid_with_legs(), "usual.urdf"))
    assert guess_up(usual) == "+z"


def test_a_world_that_carries_two_arms_gets_a_name(tmp_path):
    parts = [link("world", mass=0.0)]
    for side, y in SIDES:
        ways = [f"{x} {y * aside} {z}" for (x, aside, z), _ in USUAL]
        base = f"{side}_base"
        parts += [link(base), joint(f"{side}_weld", "world", base, kind="fixed")]
        parts += chain(
            [f"{side}_{i}" for i in range(6)], base, ways, [a for _, a in USUAL]
        )
    bare = read_urdf(write(tmp_path, robot(parts))).without_world()
    assert bare.root == "mount" and "world" not in bare.links
    assert bare.links["mount"].name == "mount"
    assert [j.child for j in bare.children("mount")] == ["left_base", "right_base"]
    assert find_anatomy(bare) is not None


def test_a_weld_follows_nothing(tmp_path):
    parts = [link("base"), link("a"), link("b"), joint("j", "base", "a")]
    parts.append(joint("k", "a", "b", kind="fixed", extra='<mimic joint="j"/>'))
    assert not read_urdf(write(tmp_path, robot(parts))).joints["k"].mimic


def test_macros_are_refused(tmp_path):
    text = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="r">'
    text += '<xacro:include filename="arm.xacro"/><link name="world"/></robot>'
    with pytest.raises(ModelError, match="macros that are not expanded"):
        read_urdf(write(tmp_path, text))
