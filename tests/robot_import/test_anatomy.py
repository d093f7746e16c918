"""The first guess finds the arms of robots that exist, whatever they are called."""

from dataclasses import replace

import numpy as np
import pytest
from small_urdfs import humanoid, joint, link, robot, write

from crar_drake.robot_import.anatomy import (
    elbow_index,
    find_anatomy,
)
from crar_drake.robot_import.body_frames import guess_frames, guess_tool
from crar_drake.robot_import.joint_groups import guess_locked
from crar_drake.robot_import.meshes import with_looks
from crar_drake.robot_import.rest_posture import guess_rest
from crar_drake.robot_import.robot_files import find_urdf
from crar_drake.robot_import.source_urdf import read_urdf


def test_the_small_humanoid(tmp_path):
    robot = read_urdf(write(tmp_path, humanoid()))
    anatomy = find_anatomy(robot)
    assert anatomy.left.hand == "left_arm_hand"
    assert [j.name for j in anatomy.right.joints] == [
        f"right_arm_{i}" for i in range(1, 7)
    ]
    frames, X = guess_frames(robot, anatomy), robot.poses()

    def p(point: str) -> np.ndarray:
        return X[frames[point].link].multiply(np.array(frames[point].point))

    np.testing.assert_allclose(p("waist"), [0, 0, 0])
    np.testing.assert_allclose(p("neck"), [0, 0, 0.4], atol=1e-5)
    np.testing.assert_allclose(p("left_shoulder"), [0, 0.2, 0.4], atol=1e-5)
    np.testing.assert_allclose(p("right_elbow"), [0, -0.2, 0.15], atol=1e-5)
    np.testing.assert_allclose(p("left_wrist"), [0, 0.2, -0.1], atol=1e-5)
    assert set(guess_locked(robot, anatomy)) == {
        "neck_joint",
        *(f"{s}_hip" for s in ("left", "right")),
        *(f"{s}_arm_finger_{i}" for s in ("left", "right") for i in (1, 2)),
    }


@pytest.mark.parametrize(
    "name, joints, hands",
    [
        ("g1_29dof_rev_1_0", 7, ("left_rubber_hand", "right_rubber_hand")),
        (
            "g1_29dof_with_hand_rev_1_0",
            7,
            ("left_hand_palm_link", "right_hand_palm_link"),
        ),
        ("talos_full_v2", 7, ("gripper_left_base_link", "gripper_right_base_link")),
        ("romeo", 7, None),
        ("alex_nub_hands", 7, None),
        ("icub", 7, None),
    ],
)
def test_real_humanoids(robot_data, name, joints, hands):
    robot = read_urdf(find_urdf(name)[0])
    anatomy = find_anatomy(robot)
    assert len(anatomy.left.joints) == len(anatomy.right.joints) == joints
    if hands:
        assert (anatomy.left.hand, anatomy.right.hand) == hands
    frames, X = guess_frames(robot, anatomy), robot.poses()
    left, right = (
        X[frames[f"{side}_shoulder"].link].multiply(
            np.array(frames[f"{side}_shoulder"].point)
        )
        for side in ("left", "right")
    )
    assert left[1] > 0.05 and np.abs(left - right * [1, -1, 1]).max() < 0.01


def test_an_arm_alone_is_no_humanoid(robot_data):
    robot = read_urdf(find_urdf("panda")[0])
    assert find_anatomy(robot) is None
    assert set(guess_locked(robot, None)) == {
        "panda_finger_joint1",
        "panda_finger_joint2",
    }


def arms(segments: list[tuple[str, str, str]], hand: str = "0 0 -0.1") -> str:
    """A trunk with two arms; each joint is (name, axis, way from the one before)."""
    parts = [link("trunk", '<box size="0.2 0.2 0.4"/>', "0 0 0.2")]
    for side, y in (("left", 1), ("right", -1)):
        below = "trunk"
        for index, (name, axis, xyz) in enumerate(segments):
            x, away, z = xyz.split()
            xyz = f"{x} {y * float(away)} {z}"
            parts += [
                link(f"{side}_{index}"),
                joint(f"{side}_{name}", below, f"{side}_{index}", axis, xyz),
            ]
            below = f"{side}_{index}"
        x, away, z = hand.split()
        parts += [
            link(f"{side}_hand", '<sphere radius="0.03"/>'),
            joint(
                f"{side}_weld",
                below,
                f"{side}_hand",
                xyz=f"{x} {y * float(away)} {z}",
                kind="fixed",
            ),
        ]
    return robot(parts)


SHOULDER = [("pitch", "0 1 0", "0 0.15 0.4"), ("roll", "1 0 0", "0 0.05 0")]
TWIST = ("twist", "0 0 1", "0 0 0")


@pytest.mark.parametrize(
    "joints, hand, elbow",
    [
        # As Booster's T1: the name is at the shoulder, its axis along the arm.
        (
            [
                *SHOULDER,
                ("elbow_pitch", "0 1 0", "0 0.06 0"),
                ("elbow_yaw", "0 0 1", "0 0.15 0"),
            ],
            "0 0.2 0",
            3,
        ),
        # A shoulder of four joints, as ARMAR-4's, and no name.
        (
            [
                *SHOULDER,
                ("third", "0 1 0", "0 0 0"),
                TWIST,
                ("bend", "0 1 0", "0 0 -0.3"),
                ("last", "0 0 1", "0 0 -0.25"),
                ("end", "1 0 0", "0 0 0"),
            ],
            "0 0 -0.1",
            4,
        ),
        # Two joints named elbow at one place: the one that bends, as Romeo's.
        (
            [
                *SHOULDER,
                ("elbow_roll", "0 0 1", "0 0 -0.3"),
                ("elbow_yaw", "0 1 0", "0 0 0"),
                ("wrist_roll", "0 0 1", "0 0 -0.25"),
                ("wrist_yaw", "1 0 0", "0 0 0"),
            ],
            "0 0 -0.1",
            3,
        ),
        # The name is right although it is the fifth.
        (
            [
                *SHOULDER,
                TWIST,
                ("middle", "0 1 0", "0 0 -0.15"),
                ("elbow", "0 1 0", "0 0 -0.12"),
                ("last", "0 0 1", "0 0 -0.25"),
                ("end", "1 0 0", "0 0 0"),
            ],
            "0 0 -0.1",
            4,
        ),
    ],
)
def test_the_elbow_is_where_the_arm_bends(tmp_path, joints, hand, elbow):
    read = read_urdf(write(tmp_path, arms(joints, hand)))
    anatomy, X = find_anatomy(read), read.poses()
    assert elbow_index(X, anatomy.left) == elbow_index(X, anatomy.right) == elbow
    assert guess_frames(read, anatomy)["left_elbow"].link == f"left_{elbow}"


def test_the_wrist_bends_and_is_not_where_the_forearm_twists(tmp_path):
    joints = [
        *SHOULDER,
        TWIST,
        ("elbow", "0 1 0", "0 0 -0.3"),
        ("forearm", "0 0 1", "0 0 -0.1"),
        ("wrist", "0 1 0", "0 0 -0.15"),
    ]
    read = read_urdf(write(tmp_path, arms(joints)))
    frames, X = guess_frames(read, find_anatomy(read)), read.poses()
    wrist = frames["left_wrist"]
    p = X[wrist.link].multiply(np.array(wrist.point))
    np.testing.assert_allclose(p, X["left_5"].translation(), atol=1e-9)


def test_a_forearm_without_a_hand_has_its_wrist_near_the_tip(tmp_path):
    """As H1's: the elbow's link is the last one."""
    joints = [*SHOULDER, TWIST, ("elbow", "0 1 0", "0 0 -0.3")]
    text = arms(joints, "0 0 0").replace(
        '<sphere radius="0.03"/>', '<box size="0.3 0.06 0.06"/>'
    )
    text = text.replace(
        '<origin xyz="0 0 0"/><geometry><box size="0.3',
        '<origin xyz="0.15 0 0"/><geometry><box size="0.3',
    )
    read = with_looks(read_urdf(write(tmp_path, text)))
    frames = guess_frames(read, find_anatomy(read))
    for side in ("left", "right"):
        wrist = frames[f"{side}_wrist"]
        assert wrist.link == f"{side}_hand"
        np.testing.assert_allclose(wrist.point, [0.24, 0, 0], atol=0.005)
        assert frames[f"{side}_hand"] == wrist


def rolling(root: str, trunk_turns_at: float | None = None) -> str:
    """The small humanoid's upper half on a wheeled base."""
    text = arms([*SHOULDER, TWIST, ("elbow", "0 1 0", "0 0 -0.3")], "0 0 -0.25")
    kind = "prismatic" if trunk_turns_at is None else "revolute"
    z = 0.5 if trunk_turns_at is None else trunk_turns_at
    base = link(root, '<box size="0.4 0.4 0.1"/>', "0 0 0.05")
    lift = joint("lift", root, "trunk", "0 0 1", f"0 0 {z}", kind)
    return text.replace("</robot>", base + lift + "</robot>")


@pytest.mark.parametrize(
    "root, turns, height",
    [
        ("base_footprint", None, 0.62 * 0.9),  # the shoulders are 0.9 m above it
        ("base_footprint", 0.55, 0.55),
        # No wheels, but far from the arms: as far below them as a person's.
        ("pelvis", None, 0.9 - 0.9 * 0.55),
        # No wheels and no farther than a waist could be, but below all of it.
        ("pelvis", 0.3, 0.62 * 0.7),
    ],
)
def test_the_waist_is_not_on_wheels(tmp_path, root, turns, height):
    """As TIAGo's, PR2's and that of robosuite's PR2."""
    read = with_looks(read_urdf(write(tmp_path, rolling(root, turns))))
    waist = guess_frames(read, find_anatomy(read))["waist"]
    assert waist.link == root
    np.testing.assert_allclose(waist.point, [0, 0, height], atol=1e-5)


@pytest.mark.parametrize(
    "welded, tool",
    [
        (["flange", "hand_tcp", "camera"], "hand_tcp"),
        (["flange", "camera"], "camera"),
        ([], "l4"),
    ],
)
def test_a_single_arm_has_a_tool_and_rests_in_the_middle(tmp_path, welded, tool):
    """As Panda's, whose fourth joint has zero beside its limit."""
    parts = [link("base", '<sphere radius="0.1"/>')]
    below = "base"
    for index in range(5):
        limits = 'lower="-3.0" upper="-0.1"' if index == 3 else 'lower="-2" upper="2"'
        parts += [
            link(f"l{index}", '<sphere radius="0.03"/>'),
            joint(f"j{index}", below, f"l{index}", xyz="0 0 0.2", limits=limits),
        ]
        below = f"l{index}"
    for name in welded:
        parts += [link(name), joint(f"{name}_weld", below, name, kind="fixed")]
        below = name
    read = read_urdf(write(tmp_path, robot(parts)))
    assert find_anatomy(read) is None
    assert guess_tool(read)["tool"].link == tool
    assert guess_rest(read, None) == {"j3": -1.55}


def test_no_chain_is_the_only_longest(tmp_path):
    parts = [link("base")]
    for leg in range(3):
        below = "base"
        for index in range(4):
            name = f"leg{leg}_{index}"
            parts += [link(name), joint(f"{name}_j", below, name, xyz="0.1 0.2 -0.1")]
            below = name
    assert guess_tool(read_urdf(write(tmp_path, robot(parts)))) == {}


@pytest.mark.parametrize(
    "name, tool", [("panda", "panda_hand_tcp"), ("ur5_robot", "tool0")]
)
def test_real_tools(robot_data, name, tool):
    read = read_urdf(find_urdf(name)[0])
    assert guess_tool(read)["tool"].link == tool
    read = replace(read, locked=guess_locked(read, None))
    rest = guess_rest(read, None)
    for joint_name, q in rest.items():
        here = read.joints[joint_name]
        assert min(q - here.lower, here.upper - q) > 0.2 * (here.upper - here.lower)


def back_to_back(ahead: float) -> str:
    """Two equal arms, the other one after a half turn of its mount about the vertical,
    whose elbows are `ahead` of or behind the shoulders [m]."""
    parts = [link("base", '<box size="0.2 0.2 0.5"/>')]
    for side, s in (("r0", 1), ("r1", -1)):
        above = "base"
        for index, (x, y, z) in enumerate(
            [(0.0, 0.2, 0.4), (0.0, 0.05, 0.0), (ahead, 0.25, 0.0), (0.0, 0.25, 0.0)]
        ):
            name = f"{side}_{index}"
            axis = "0 0 1" if index % 2 else f"{s} 0 0"
            parts += [
                link(name, '<sphere radius="0.03"/>'),
                joint(f"{name}_joint", above, name, axis, f"{x * s} {y * s} {z}"),
            ]
            above = name
    return robot(parts)


def test_arms_that_a_half_turn_takes_to_each_other(tmp_path):
    found = find_anatomy(read_urdf(write(tmp_path, back_to_back(0.1))))
    assert (found.left.hand, found.right.hand) == ("r0_3", "r1_3")
    # One ahead of the other is no pair of arms.
    assert find_anatomy(read_urdf(write(tmp_path, back_to_back(0.9)))) is None
