"""Names of many makers mean the same joints."""

import pytest

from crar_drake.motion.joint_names import Meaning, joints_by_name, meaning


@pytest.mark.parametrize(
    "name, side, part",
    [
        ("mixamorig:LeftForeArm", "left", "elbow"),
        ("Bip01 R UpperArm", "right", "upper arm"),
        ("upperarm_l", "left", "upper arm"),
        ("upper_arm.R", "right", "upper arm"),
        ("lFemur", "left", "thigh"),
        ("rtibia", "right", "knee"),
        ("RUArm", "right", "upper arm"),
        ("J_Bip_L_LowerLeg", "left", "knee"),
        ("LEFTUPLEG", "left", "thigh"),
        ("ArmRight", "right", "arm"),
        ("handl", "left", "hand"),
        ("Left Toe Base", "left", "toe"),
        ("subject 7:right-shoulder", "right", "shoulder"),
        ("lowerneck", "", "neck"),
        ("Hips", "", "pelvis"),
        ("RightFoot_End", "right", "end of the foot"),
        ("l_foot_tip", "left", "end of the foot"),
    ],
)
def test_a_name_means(name, side, part) -> None:
    assert meaning(name) == Meaning(side, part)


@pytest.mark.parametrize(
    "name",
    ["LeftHandIndex1", "LeftArmRoll", "HeadTop_End", "L5", "Spine3", "ribs", "root"]
    + ["lfingers", "upperarm_twist_01_l", "LeftFoot_IK", "RightToe_End", "leftEye"],
)
def test_others_mean_nothing(name) -> None:
    assert meaning(name) is None


@pytest.mark.parametrize(
    "names, joints",
    [
        ("LeftShoulder LeftArm LeftForeArm LeftHand", "- shoulder elbow wrist"),
        ("LeftCollar LeftShoulder LeftElbow LeftWrist", "- shoulder elbow wrist"),
        ("lclavicle lhumerus lradius lwrist lhand", "- shoulder elbow wrist -"),
        ("lShldr lForeArm lHand", "shoulder elbow wrist"),
        ("LHipJoint LeftHip LeftKnee LeftAnkle LeftToe", "- hip knee ankle toe"),
        ("LeftUpLeg LeftLeg LeftFoot LeftToeBase", "hip knee ankle toe"),
        ("left_hip left_knee left_ankle left_foot", "hip knee ankle toe"),
        ("L_Thigh L_Calf L_Foot L_Toe0", "hip knee ankle toe"),
        ("LeftUpLeg LeftLeg LeftFoot LeftFoot_End", "hip knee ankle toe"),
        ("LeftLeg LeftFoot_End LeftFoot LeftToe LeftToe_End", "hip - ankle toe -"),
    ],
)
def test_what_is_ambiguous_is_weighed(names, joints) -> None:
    found = joints_by_name(names.split())
    expected = {
        f"left_{joint}": i for i, joint in enumerate(joints.split()) if joint != "-"
    }
    assert found == expected
