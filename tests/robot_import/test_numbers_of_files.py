"""Wrong numbers and texts of robots' files, or ones that are hardly meant: said."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from small_urdfs import humanoid, joint, link, robot, write

from crar_drake.commands import main
from crar_drake.errors import ModelError
from crar_drake.robot_import import import_robot
from crar_drake.robot_import.alarms import number_alarms
from crar_drake.robot_import.source_file import read_robot

RANGE = 'lower="-1.5" upper="1.5" effort="20" velocity="5"'


def arm_with(limits: str) -> str:
    """The small humanoid, whose left arm's first joint has these limits."""
    old = re.search(r'<joint name="left_arm_1".*?</joint>', humanoid())[0]
    return humanoid().replace(old, old.replace(RANGE, limits))


@pytest.mark.parametrize(
    "limits, words",
    [
        ('lower="1.5" upper="-1.5"', ["1.5 to -1.5 rad", "lower is above upper"]),
        ('lower="0.5"', ["0.5 to 0 rad", "lower is above upper"]),
        ('lower="nan" upper="nan"', ["lower", "'nan'", "finite"]),
        ('lower="-1" upper="inf"', ["-1 to inf rad", "both limits or none"]),
        ('lower="-1" upper="1" velocity="-5"', ["velocity is -5", "positive"]),
        ('lower="-1" upper="1" effort="-2"', ["effort is -2", "positive"]),
        ('lower="-1" upper="1" effort="nan"', ["effort", "'nan'"]),
        ('lower="-1" upper="1 2"', ["upper", "'1 2' is not a number"]),
    ],
)
def test_limits_that_are_none(tmp_path, capsys, limits, words):
    path = write(tmp_path, arm_with(limits))
    assert main(["import-robot", str(path), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    for word in [str(path), "'left_arm_1'", *words]:
        assert word in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "limits, expected",
    [
        ('upper="1.5"', (0.0, 1.5)),
        ('lower="-1.5"', (-1.5, 0.0)),
        ('effort="20"', (-np.inf, np.inf)),
        ('lower="-inf" upper="inf" effort="inf" velocity="inf"', (-np.inf, np.inf)),
    ],
)
def test_limits_that_are_left_out(tmp_path, limits, expected):
    read = read_robot(write(tmp_path, arm_with(limits)))
    found = read.joints["left_arm_1"]
    assert (found.lower, found.upper) == expected
    assert found.velocity is None
    said = " ".join(read.warnings)
    assert ("left_arm_1" in said) == np.isfinite(expected[0])


def test_the_side_that_is_given_holds_in_the_robot_that_is_made(tmp_path):
    report = import_robot(
        write(tmp_path, arm_with('upper="1.5" effort="20" velocity="5"')),
        tmp_path / "out",
    )
    assert any("no lower limit" in warning for warning in report.warnings)
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(tmp_path / "out" / "robot.urdf"))
    plant.Finalize()
    made = plant.GetJointByName("left_arm_1")
    assert made.position_lower_limits() == [0.0]
    assert made.position_upper_limits() == [1.5]


@pytest.mark.parametrize(
    "place, wrong",
    [
        ('<box size="0.16 0.24 0.16"/>', '<box size="0.16 nan 0.16"/>'),
        ('xyz="0 0 0.28"', 'xyz="0 0 inf"'),
        ('<mass value="5.0"/>', '<mass value="nan"/>'),
        ('ixx="0.01"', 'ixx="inf"'),
        ('<mimic joint="left_arm_finger_1" multiplier="-1"/>',
         '<mimic joint="left_arm_finger_1" multiplier="nan"/>'),
    ],
)  # fmt: skip
def test_numbers_that_are_not_finite(tmp_path, place, wrong):
    assert place in humanoid()
    with pytest.raises(ModelError, match="(link|joint) '.*' is not made of finite"):
        read_robot(write(tmp_path, humanoid().replace(place, wrong, 1)))


QUATERNION = 'quat_xyzw="0.70710678 0 0 0.70710678"'
FORE = '<link name="left_arm_fore"><inertial><origin xyz="0 0 -0.12"'


@pytest.mark.parametrize(
    "name, before",
    [
        ("left_arm_4", '<child link="left_arm_fore"/><origin xyz="0 0 -0.25"'),
        ("left_arm_fore", FORE),
        ("head", '</inertial><visual><origin xyz="0 0 0"'),
    ],
)
def test_a_quaternion_of_an_origin_is_refused_by_name(tmp_path, capsys, name, before):
    """URDF 1.1 has it; dropped, what it is of would be turned elsewhere."""
    old = humanoid()
    place = old.index(before, max(0, old.index(f'name="{name}"') - 10)) + len(before)
    path = write(tmp_path, f"{old[:place]} {QUATERNION}{old[place:]}")
    assert main(["import-robot", str(path), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    for word in [str(path), f"'{name}'", "quat_xyzw", "as rpy"]:
        assert word in error
    assert not (tmp_path / "out").exists()


def test_numbers_that_are_hardly_meant(tmp_path):
    def said(text: str, locked=()) -> str:
        read = read_robot(write(tmp_path, text))
        read = replace(read, locked=dict.fromkeys(locked, 0.0))
        return " ".join(number_alarms(read))

    assert said(humanoid()) == ""
    degrees = arm_with('lower="-90" upper="90"')
    assert "left_arm_1 (-90 to 90) rad" in said(degrees)
    assert said(degrees, locked=["left_arm_1"]) == ""
    assert said(arm_with('lower="-12.6" upper="12.6"')) == ""  # two turns each way
    slide = [link("a"), link("b"), joint("j", "a", "b", kind="prismatic")]
    assert said(robot(slide).replace('upper="1.5"', 'upper="90"')) == ""
    zero = 'lower="0" upper="0" effort="0" velocity="0"'
    assert "lower = upper of left_arm_1: they cannot move" in said(arm_with(zero))
    still = re.sub(
        r'lower="[-\d.]*" upper="[-\d.]*"', 'lower="0" upper="0"', humanoid()
    )
    assert "lower = upper of all joints" in said(still)
    heavy = humanoid().replace('<mass value="5.0"/>', '<mass value="-5.0"/>')
    assert "negative of pelvis (-5 kg)" in said(heavy)


def declared(encoding: str, text: str) -> str:
    return f'<?xml version="1.0" encoding="{encoding}"?>\n<!-- Prüfung -->{text}'


@pytest.mark.parametrize(
    "name, encode",
    [
        ("utf-8", partial(str.encode, encoding="utf-8-sig")),
        ("iso-8859-1", partial(str.encode, encoding="latin-1")),
        ("gbk", lambda text: text.replace("Prüfung", "检查").encode("gbk")),
        ("utf-16", partial(str.encode, encoding="utf-16")),
        ("utf-16", partial(str.encode, encoding="utf-16-le")),
        ("UTF-16", partial(str.encode, encoding="utf-16-be")),
        ("utf-32", partial(str.encode, encoding="utf-32")),
    ],
)
def test_encodings(tmp_path, name, encode):
    """As declared, or as the first bytes say: a link's name tells."""
    word = "检查" if name == "gbk" else "Prüfung"
    text = humanoid().replace('"left_arm_hand"', '"left_Prüfung_hand"')
    path = tmp_path / "small.urdf"
    path.write_bytes(encode(declared(name, text)))
    links = read_robot(path).links
    assert f"left_{word}_hand" in links and len(links) == 21


def test_an_encoding_that_is_none(tmp_path):
    path = tmp_path / "small.urdf"
    path.write_bytes(declared("klingon", humanoid()).encode())
    with pytest.raises(ModelError, match="small.urdf: .*encoding, 'klingon'"):
        read_robot(path)
    path.write_bytes(declared("utf-8", humanoid()).encode("latin-1"))
    with pytest.raises(ModelError, match="small.urdf: not a URDF: .*can't decode"):
        read_robot(path)


def test_an_sdf_in_another_encoding(tmp_path):
    text = """<sdf version="1.9"><model name="m"><link name="Prüfung"/><link name="b"/>
    <joint name="j" type="revolute"><parent>Prüfung</parent><child>b</child>
    <axis><xyz>0 0 1</xyz></axis></joint></model></sdf>"""
    path = tmp_path / "m.sdf"
    path.write_bytes(declared("utf-16", text).encode("utf-16"))
    assert list(read_robot(path).links) == ["Prüfung", "b"]


# --- joints that follow others, and arms that are locked in part ------------------


@pytest.mark.parametrize("index", [1, 3, 4, 6])
def test_a_joint_of_an_arm_that_follows_another(tmp_path, index):
    """Two arms stay two arms; both joints stand in the middle of what both allow."""
    leads = index - 1 or 2
    text = re.sub(
        rf'(<joint name="(left|right)_arm_{index}".*?)</joint>',
        rf'\1<mimic joint="\2_arm_{leads}" multiplier="0.5" offset="-0.1"/></joint>',
        humanoid(),
    )
    report = import_robot(write(tmp_path, text), tmp_path / "out")
    locked = report.choices.locked
    for side in ("left", "right"):
        follower, leader = f"{side}_arm_{index}", f"{side}_arm_{leads}"
        own = {f"{side}_arm_{i}" for i in range(1, 7)}
        assert own & set(locked) == {follower, leader}
        range_ = (-2.2, 0.0) if leads == 4 else (-1.5, 1.5)
        if index == 4:  # 0.5 q - 0.1 is to be below zero
            range_ = (-1.5, 0.2)
        assert locked[leader] == pytest.approx(np.mean(range_))
        assert f"{side}_wrist" in report.choices.frames
        assert any(f"{follower} follows {leader}" in w for w in report.warnings)


@pytest.mark.parametrize("index", [1, 4, 6])
def test_an_arm_with_one_joint_locked_by_hand(tmp_path, index):
    path = write(tmp_path, humanoid())
    others = [f"{side}_{j}" for side in ("left", "right")
              for j in ("hip", "arm_finger_1", "arm_finger_2")]  # fmt: skip
    at = dict.fromkeys([*others, "neck_joint", f"left_arm_{index}"], 0.0)
    at[f"left_arm_{index}"] = -0.3
    report = import_robot(path, tmp_path / "out", locked=at)
    assert {"left_wrist", "right_wrist"} <= set(report.choices.frames)
    assert f"left_arm_{index}" not in report.choices.rest_posture
