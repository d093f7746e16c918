"""The first guess finds the arms of robots that exist, whatever they are called."""

import numpy as np
import pytest
from small_urdfs import humanoid, write

from crar_drake.robot_import.anatomy import find_anatomy, guess_frames, guess_locked
from crar_drake.robot_import.source_urdf import find_urdf, read_urdf


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
