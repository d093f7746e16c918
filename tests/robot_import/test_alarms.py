"""What leaves a robot unprotected, or looks wrong, is said aloud."""

from dataclasses import replace

import pytest
from small_urdfs import humanoid, humanoid_with_legs, joint, link, robot, write

from crar_drake.robot_import import import_robot
from crar_drake.robot_import.alarms import (
    floor_alarms,
    limb_alarms,
    mirrored_range_alarms,
    pair_alarms,
)
from crar_drake.robot_import.anatomy import find_anatomy
from crar_drake.robot_import.body_frames import guess_frames
from crar_drake.robot_import.choices import FrameChoice
from crar_drake.robot_import.meshes import with_looks
from crar_drake.robot_import.source_urdf import read_urdf


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """The small humanoid and its arms."""
    read = read_urdf(write(tmp_path_factory.mktemp("small"), humanoid()))
    return with_looks(read), find_anatomy(read)


def test_nothing_to_say_about_the_small_humanoid(small, imported):
    read, anatomy = small
    assert limb_alarms(read, guess_frames(read, anatomy)) == []
    assert floor_alarms(read, {}, 0.8, anatomy) == []
    assert imported.warnings == []


@pytest.mark.parametrize(
    "axis, limits, wrong",
    [
        ("0 1 0", (-0.1, 1.3), False),
        ("0 -1 0", (-1.3, 0.1), False),
        ("0 1 0", (-1.3, 0.1), True),
        ("0 -1 0", (-0.1, 1.3), True),
        ("0 1 0", (-0.5, 1.3), False),  # not the same, but to the same side
    ],
)
def test_a_knee_that_bends_to_the_other_side_than_its_twin(
    tmp_path, axis, limits, wrong
):
    text = humanoid_with_legs()
    for side, way, (lower, upper) in (
        ("left", axis, limits),
        ("right", "0 1 0", (-0.1, 1.3)),
    ):
        name = f"{side}_knee"
        old = joint(f"{name}_joint", f"{side}_pitch", name, "0 1 0", "0 0 -0.3")
        assert old in text
        both = f'lower="{lower}" upper="{upper}" effort="20" velocity="5"'
        new = joint(
            f"{name}_joint", f"{side}_pitch", name, way, "0 0 -0.3", limits=both
        )
        text = text.replace(old, new)
    read = read_urdf(write(tmp_path, text))
    found = mirrored_range_alarms(read, find_anatomy(read))
    assert len(found) == wrong
    assert all("left_knee_joint" in x and "right_knee_joint" in x for x in found)
    locked = replace(read, locked={"left_knee_joint": 0.0})
    assert mirrored_range_alarms(locked, find_anatomy(read)) == []


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"left_elbow": ("left_arm_upper", -0.05)}, ["left_shoulder to left_elbow"]),
        ({"right_wrist": ("right_arm_fore", 0.0)}, ["right_elbow to right_wrist"]),
        ({"neck": ("torso", 0.05)}, ["waist to neck is 0.050 m"]),
        ({"left_wrist": ("left_arm_fore", -0.4)}, ["each other's mirror"]),
    ],
)
def test_limbs_that_no_body_has(small, changes, words):
    read, anatomy = small
    frames = dict(guess_frames(read, anatomy))
    for point, (name, z) in changes.items():
        frames[point] = FrameChoice(name, [0.0, 0.0, z])
    said = " ".join(limb_alarms(read, frames))
    for word in words:
        assert word in said


def test_hands_that_are_crossed(small):
    read, anatomy = small
    frames = guess_frames(read, anatomy)
    crossed = {
        name.replace("left", "x").replace("right", "left").replace("x", "right"): frame
        for name, frame in frames.items()
    }
    assert any("on the right" in said for said in limb_alarms(read, crossed))


def test_what_is_below_the_floor(small):
    read, anatomy = small
    (said,) = floor_alarms(read, {}, 0.7, anatomy)
    assert "leg is 100 mm below the floor" in said


def test_a_robot_without_legs_stands_on_its_hands(small):
    read, anatomy = small
    upper = {name: of for name, of in read.looks.items() if "leg" not in name}
    lowest = min(
        read.poses()[name].multiply(part.vertices.T)[2].min()
        for name, of in upper.items()
        for part in of
    )
    (said,) = floor_alarms(replace(read, looks=upper), {}, -lowest, anatomy)
    assert "stands on its hands" in said and "waist_z" in said


def chain(sizes: list[float]) -> tuple:
    """Boxes of 0.1 m along x, 0.2 m apart, each on a joint of the one before."""
    parts = []
    for index, size in enumerate(sizes):
        parts.append(link(f"l{index}", f'<box size="{size} 0.1 0.1"/>'))
        if index:
            below = f"l{index - 1}"
            parts.append(joint(f"j{index}", below, f"l{index}", xyz="0.2 0 0"))
    return parts


@pytest.mark.parametrize(
    "sizes, pair, locked, words",
    [
        # Shoulders are in each other: two joints apart, and really so.
        ([0.1, 0.1, 0.72], ("l0", "l2"), {}, None),
        ([0.1, 0.1, 0.1], ("l0", "l1"), {}, None),
        ([0.1, 0.1, 0.1], ("l0", "l2"), {"j1": 0.0}, None),
        ([0.1, 0.1, 0.1], ("l0", "l2"), {}, ["2 joints", "do not: change"]),
        ([0.1, 0.1, 0.1, 1.12], ("l0", "l3"), {}, ["3 joints", "touch, too"]),
        ([0.1, 0.1, 0.1, 1.12], ("l0", "l3"), {"j1": 0.0}, None),
        ([0.1, 0.1, 0.1, 0.1], ("l0", "l3"), {}, ["NOT watched", "3 joints", "do not"]),
    ],
)
def test_pairs_that_nobody_watches(tmp_path, sizes, pair, locked, words):
    read = with_looks(read_urdf(write(tmp_path, robot(chain(sizes)))))
    read = replace(read, locked=locked)
    found = pair_alarms(read, read.looks, {}, [["l0", "l1"]], [pair])
    if words is None:
        assert found == []
    else:
        assert all(word in found[0] for word in [*words, " - ".join(pair)])


def test_the_rest_posture_counts_not_position_zero(tmp_path):
    parts = chain([0.1, 0.1, 0.1])
    parts[-1] = joint("j2", "l1", "l2", "1 0 0", "0.3 0 0", kind="prismatic")
    read = with_looks(read_urdf(write(tmp_path, robot(parts))))
    pair, watched = [("l0", "l2")], [["l0", "l1"]]
    assert pair_alarms(read, read.looks, {}, watched, pair)
    assert not pair_alarms(read, read.looks, {"j2": -0.45}, watched, pair)


def test_an_import_says_so(tmp_path):
    urdf = write(tmp_path, robot(chain([0.1, 0.1])))
    report = import_robot(urdf, tmp_path, most_capsules=1)
    assert any("no pair of links is watched" in said for said in report.warnings)
    text = (tmp_path / "report.txt").read_text()
    assert "WARNING: pairs: no pair of links is watched" in text


def test_joints_that_slide_are_said_to(tmp_path):
    parts = [link("a", '<box size="0.1 0.1 0.1"/>'), link("b"), link("c")]
    parts += [joint("turn", "a", "b"), joint("slide", "b", "c", kind="prismatic")]
    report = import_robot(write(tmp_path, robot(parts)), tmp_path, most_capsules=1)
    (note,) = [n for n in report.notes if "slide" in n and " m" in n]
    assert "slide (-1.5 to 1.5 m)" in note and "turn" not in note and "m/s" in note
