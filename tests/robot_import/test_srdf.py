"""An SRDF's posture is the rest posture, and what it disables is not watched."""

import pytest
from small_urdfs import humanoid, joint, link, robot, write

from crar_drake.errors import ModelError
from crar_drake.robot.description import load_robot_description
from crar_drake.robot_import import import_robot, load_choices
from crar_drake.robot_import.robot_files import find_urdf
from crar_drake.robot_import.source_urdf import read_urdf
from crar_drake.robot_import.srdf import read_srdf

SITTING = """
<group_state name="half_sitting" group="legs">
  <joint name="root_joint" value="0 0 1 0 0 0 1"/>
  <joint name="left_hip" value="-0.4"/><joint name="right_hip" value="-0.4"/>
</group_state>
<group_state name="half_sitting" group="arms">
  <joint name="left_arm_2" value="0.5"/><joint name="right_arm_2" value="-0.5"/>
  <joint name="left_arm_4" value="-0.7"/><joint name="right_arm_4" value="-9"/>
</group_state>
<group_state name="reaching" group="arms"><joint name="left_arm_1" value="-1"/>
</group_state>"""
ALLOWED = '<disable_collisions link1="head" link2="{}" reason="User"/>'


def srdf(*parts: str) -> str:
    return f'<robot name="small_humanoid">{"".join(parts)}</robot>'


@pytest.fixture(scope="module")
def sitting(tmp_path_factory):
    """A report and its folder, beside a URDF and an SRDF."""
    folder = tmp_path_factory.mktemp("srdf")
    urdf = write(folder, humanoid())
    # Of the hand's segment the finger may not touch the head; a thigh may.
    text = srdf(SITTING, *map(ALLOWED.format, ("right_arm_hand", "left_arm_fore")))
    path = write(folder, text, "small.srdf")
    return import_robot(str(urdf), folder / "out", srdf=str(path))


def test_the_posture_is_that_of_all_groups(sitting):
    choices = load_choices(sitting.folder / "import.yaml")
    rest = dict(choices.rest_posture)
    # Lower legs that swing 0.4 rad ahead lift the soles' front or rear edge.
    assert 0.7 < rest.pop("waist_z") < 0.8
    # The elbow's limit is 2.2 rad.
    assert rest == {
        "left_arm_2": 0.5,
        "right_arm_2": -0.5,
        "left_arm_4": -0.7,
        "right_arm_4": -2.2,
    }
    assert choices.locked["left_hip"] == choices.locked["right_hip"] == -0.4
    assert choices.locked["neck_joint"] == 0.0
    assert any("half_sitting" in note for note in sitting.notes)


def test_what_may_touch_is_not_watched_and_said(sitting):
    pairs = load_robot_description(sitting.folder).pairs
    watched = {frozenset(pair) for pair in pairs}
    assert frozenset(("head", "left_arm_hand")) in watched
    assert frozenset(("head", "right_arm_fore")) in watched
    assert frozenset(("head", "left_arm_fore")) not in watched
    # The fingers are one segment with the hand, and nothing disables theirs.
    assert frozenset(("head", "right_arm_hand")) in watched
    (warning,) = [w for w in sitting.warnings if "lets them touch" in w]
    assert "head - left_arm_fore:" in warning


def test_it_is_kept_and_imported_again(sitting):
    file = sitting.folder / "import.yaml"
    before = file.read_text()
    again = import_robot("", sitting.folder)
    assert not again.guessed and file.read_text() == before
    with pytest.raises(ModelError, match="posture: reaching into it"):
        import_robot("", sitting.folder, posture="reaching")


def test_the_same_file_by_another_path_is_the_same(sitting, monkeypatch):
    """The import file has the whole path, whatever the option had."""
    monkeypatch.chdir(sitting.folder.parent)
    again = import_robot("", sitting.folder, srdf="small.srdf")
    assert not again.guessed
    with pytest.raises(ModelError, match="is there already: write srdf: .*other.srdf"):
        import_robot("", sitting.folder, srdf="other.srdf")


def test_a_range_without_zero_is_rested_in(tmp_path):
    """A joint that the posture does not name is as near to 0 as it can be."""
    limits = 'lower="-2.2" upper="0.0" effort="20" velocity="5"'
    assert limits in humanoid()
    text = humanoid().replace(limits, limits.replace("0.0", "-0.3"))
    path = write(tmp_path, srdf(SITTING.replace("left_arm_4", "left_arm_3")), "a.srdf")
    report = import_robot(str(write(tmp_path, text)), tmp_path / "out", srdf=str(path))
    rest = report.choices.rest_posture
    assert (rest["left_arm_3"], rest["left_arm_4"]) == (-0.7, -0.3)


def test_another_posture_can_be_named(tmp_path):
    urdf = read_urdf(write(tmp_path, humanoid()))
    semantics = read_srdf(write(tmp_path, srdf(SITTING), "a.srdf"), urdf)
    assert semantics.posture("reaching") == ("reaching", {"left_arm_1": -1.0})
    with pytest.raises(ModelError, match="did you mean 'reaching'.*half_sitting"):
        semantics.posture("reachin")


def test_where_no_name_says_rest_nothing_is_taken(tmp_path):
    urdf = read_urdf(write(tmp_path, humanoid()))
    other = SITTING.replace("half_sitting", "boxing")
    semantics = read_srdf(write(tmp_path, srdf(other), "a.srdf"), urdf)
    assert semantics.posture("") == ("", {})
    alone = other[: other.index('<group_state name="reaching"')]
    semantics = read_srdf(write(tmp_path, srdf(alone), "a.srdf"), urdf)
    assert semantics.posture("")[0] == "boxing"


def test_an_arm_rests_there_too(tmp_path):
    parts = [link("base", '<box size="0.1 0.1 0.1"/>')]
    for i in range(4):
        below = f"l{i - 1}" if i else "base"
        shape = '<box size="0.05 0.05 0.2"/>'
        parts += [
            link(f"l{i}", shape, "0 0 0.15"),
            joint(f"j{i}", below, f"l{i}", "0 1 0", "0 0 0.3"),
        ]
    urdf = write(tmp_path, robot(parts))
    ready = '<group_state name="Ready"><joint name="j1" value="0.3"/></group_state>'
    path = write(tmp_path, srdf(ready), "a.srdf")
    report = import_robot(str(urdf), tmp_path / "out", srdf=str(path))
    assert report.choices.rest_posture == {"j1": 0.3}


@pytest.mark.parametrize(
    "text, message",
    [
        ("<robot", "not an SRDF"),
        ("<sdf/>", "root element is <sdf>"),
        ('<robot name="r"><link name="a"/></robot>', "but a URDF"),
        ('<robot name="r"/>', "another robot's"),
        (
            srdf('<group_state name="s"><joint name="left_hip" value="a"/>').replace(
                "</robot>", "</group_state></robot>"
            ),
            "group_state 's': joint 'left_hip': 'a' is not made of numbers",
        ),
    ],
)
def test_what_is_wrong_is_said(tmp_path, text, message):
    urdf = read_urdf(write(tmp_path, humanoid()))
    with pytest.raises(ModelError, match=message) as error:
        read_srdf(write(tmp_path, text, "a.srdf"), urdf)
    assert "a.srdf" in str(error.value)


def test_a_posture_needs_an_srdf(tmp_path):
    urdf = write(tmp_path, humanoid())
    with pytest.raises(ModelError, match="posture: there is no srdf"):
        import_robot(str(urdf), tmp_path / "out", posture="home")


def test_talos_own_file(robot_data):
    """Half sitting, as its makers have it."""
    urdf = read_urdf(find_urdf("talos_full_v2")[0])
    semantics = read_srdf(robot_data / "robots/talos_data/srdf/talos.srdf", urdf)
    name, posture = semantics.posture("")
    assert name == "half_sitting"
    assert posture["arm_left_4_joint"] == -0.525366
    assert frozenset(("arm_left_1_link", "arm_left_4_link")) in semantics.allowed
