"""What is said of a YAML file that is wrong: file, key, value, line, remedy."""

from pathlib import Path

import pytest
from pydrake.common.yaml import yaml_load_typed

from crar_drake.errors import ModelError, ScenarioError
from crar_drake.law.parameters import BalanceParameters, LookaheadParameters
from crar_drake.robot.description import load_robot_description
from crar_drake.robot_import.choices import ImportChoices, load_choices
from crar_drake.simulation.scenario import Scenario, load_scenario, parse_scenario
from crar_drake.yaml_files import read_text

VALID = "motion: dance\nexperiment: wrists\n"


def refusal(text: str) -> str:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text, "f.yaml")
    message = str(caught.value)
    assert message.startswith("f.yaml: ") and "\n" not in message
    assert len(message) < 500
    return message


@pytest.mark.parametrize(
    "data, words",
    [
        (b"motion: dance\ndescription: caf\xe9\n", ["line 2", "byte 31", "0xe9"]),
        ("motion: dance\n".encode("utf-16"), ["line 1", "UTF-16", "save it as UTF-8"]),
    ],
)
def test_a_file_that_is_not_utf_8_is_named_with_line_and_byte(tmp_path, data, words):
    for name, load, error in (
        ("s.yaml", load_scenario, ScenarioError),
        ("robot.yaml", load_robot_description, ModelError),
        ("import.yaml", load_choices, ModelError),
    ):
        file = tmp_path / name
        file.write_bytes(data)
        with pytest.raises(error) as caught:
            load(file)
        for word in [f"{file}: ", *words]:
            assert word in str(caught.value)


def test_utf_8_is_read_whatever_the_locale_and_with_a_byte_order_mark(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("LC_ALL", "C")
    file = tmp_path / "s.yaml"
    text = VALID + "description: Café à l’épaule\n"
    file.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert load_scenario(file).description == "Café à l’épaule"


def test_a_file_that_cannot_be_read(tmp_path):
    with pytest.raises(ScenarioError, match="cannot be read: Is a directory"):
        read_text(tmp_path, ScenarioError)


TEXT, LIST, KEYS = "the text 'x'", "the list [1, 2]", "the keys 'a'"


@pytest.mark.parametrize(
    "key, path, expected",
    [
        ("duration: VALUE", "duration", "a number"),
        ("controller: {margin: VALUE}", "controller.margin", "a number"),
        ("controller:\n  nominal:\n    rho: VALUE", "controller.nominal.rho", "a num"),
        ("disturbances: {delay_periods: VALUE}", "disturbances.delay_periods", "a w"),
        ("plant_config: {time_step: VALUE}", "plant_config.time_step", "a number"),
        ("simulator_config: {accuracy: VALUE}", "simulator_config.accuracy", "a numb"),
        ("visualization: {publish_period: VALUE}", "visualization.publish_period", "a"),
        (
            "visualization: {default_proximity_color: {rgba: [1, VALUE, 0]}}",
            "visualization.default_proximity_color.rgba[1]",
            "a number",
        ),
        (
            "disturbances: {pushes: [{frame: a}, {force: [0, VALUE, 0]}]}",
            "disturbances.pushes[1].force[1]",
            "a number",
        ),
    ],
)
@pytest.mark.parametrize(
    "value, found",
    [
        ("x", TEXT),
        ("[1, 2]", LIST),
        ("{a: 1}", KEYS),
        ("yes", "true"),
        ("2001-01-01", "date"),
    ],
)
def test_a_number_is_wanted(key, path, expected, value, found):
    text = VALID + key.replace("VALUE", value) + "\n"
    message = refusal(text)
    assert message.startswith(f"f.yaml: {path} (line {3 + key.count(chr(10))}): ")
    assert f"expected {expected}" in message and found in message


@pytest.mark.parametrize(
    "text, words",
    [
        ("controller: {margin: }", ["controller.margin (line 3)", "nothing (null)"]),
        ("controller:", ["controller (line 3): expected keys such as period", "null"]),
        ("controller: lookahead", ["controller (line 3)", "the text 'lookahead'"]),
        ("controller: [Kp, 3]", ["controller (line 3)", "found the list"]),
        ("robot: 3", ["robot (line 3): expected text, found the number 3"]),
        ("robot: no", ["robot (line 3): expected text, found false", "quote it"]),
        ("robot: [a]", ["robot (line 3): expected text, found the list ['a']"]),
        ("simulated_robot: {contact: 1}", ["simulated_robot.contact", "true or false"]),
        ("keyframes: [1]", ["keyframes (line 3): expected names", "the list"]),
        ("keyframes: {1: []}", ["keyframes.1 (line 3): expected a name"]),
        ("keyframes: {a: {time: 0}}", ["keyframes.a", "a list", "the keys 'time'"]),
        ("disturbances: {delay_periods: 2.5}", ["a whole number, found the number 2."]),
        ("disturbances: {noise_seed: .nan}", ["disturbances.noise_seed", "whole"]),
        ("plant_config: {contact_model: 3}", ["plant_config.contact_model", "text"]),
        ("cutoff: 1e400000", ["cutoff"]),
        ("duration: 1" + "0" * 400, ["duration", "a number"]),
    ],
)
def test_other_types_are_refused_with_their_key(text, words):
    message = refusal(VALID + text)
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    "text, path, hint",
    [
        ("controller: {balance: {xyz: 1}}", "controller.balance.xyz", "friction"),
        ("controller:\n  margn: 1", "controller.margn", "'margin'"),
        ("controller: {balance: {level: 1}}", "controller.balance.level", ""),
        ("Kp: 3", "Kp", ""),
        ("time_step: 3", "time_step", ""),
        ("simulator_config: {acuracy: 1}", "simulator_config.acuracy", "'accuracy'"),
        ("visualization: {publish_perod: 1}", "visualization.", "'publish_period'"),
        ("tasks: [{frame: a}, {fram: b}]", "tasks[1].fram", "'frame'"),
    ],
)
def test_an_unknown_key_is_told_with_its_level_and_the_keys_there(text, path, hint):
    message = refusal(VALID + text)
    assert f"f.yaml: {path}" in message and "unknown key" in message
    assert f"(line {3 + text.count(chr(10))})" in message
    assert hint in message
    # Only keys of that level are proposed.
    level = Scenario(controller=LookaheadParameters(balance=BalanceParameters()))
    for name in path.split(".")[:-1]:
        level = getattr(level, name) if "[" not in name else Scenario()
    if "[" not in path:
        after = message.partition("unknown key")[2].split("; ", 1)[1]
        proposed = after.removeprefix("known are ").removeprefix("did you mean ")
        for key in proposed.rstrip("?").split(", "):
            assert hasattr(level, key.strip("'"))


@pytest.mark.parametrize(
    "text, words",
    [
        (VALID + "cutoff: 3\ncutoff: 4", ["cutoff: the key is there twice", "3 and 4"]),
        (
            VALID + "controller:\n  Kp: 1\n  Gv: 2\n  'Kp': 3",
            ["controller.Kp: the key is there twice, in lines 4 and 6"],
        ),
        (
            VALID + "tasks:\n- frame: a\n- {frame: b, frame: c}",
            ["tasks[1].frame: the key is there twice"],
        ),
        ("", ["the file is empty", "diagrams/README.md"]),
        ("# only a comment\n", ["the file is empty"]),
        ("---\n", ["the file is empty"]),
        ("- a\n- b", ["found the list", "diagrams/README.md"]),
        ("3", ["found the number 3"]),
        (VALID + "controller: {Kp: 3\nduration: 4\n", ["line 4", "not YAML"]),
        (VALID + "a: b: c", ["line 3, column 5", "not YAML"]),
        (VALID + "\tduration: 3", ["line 3", "\\t"]),
        (VALID + 'description: "abc', ["line 3", "quoted"]),
        (VALID + "description: a\x00b", ["line 3", "'\\x00'", "remove it"]),
        (VALID + "---\nmotion: b", ["line 3", "another document"]),
        (VALID + "robot: *nowhere", ["line 3", "undefined alias"]),
        (VALID + "? [a, b]\n: 3", ["line 3", "unhashable"]),
        (VALID + "description: 2001-99-99", ["month must be in 1..12"]),
        (VALID + "a: " + 5000 * "[", ["nested too deep"]),
        (VALID + "tasks: &t [*t]", ["tasks[0]"]),
        (VALID + "controller: !Foo {margin: 0.01}", ["controller", "Foo"]),
        ("999: dance\n" + VALID, ["line 1", "the key 999 is no name"]),
        (VALID + "true: dance\n", ["the key true is no name"]),
    ],
)
def test_what_is_no_yaml_or_no_mapping(text, words):
    message = refusal(text)
    for word in words:
        assert word in message


def test_what_drake_reads_is_not_refused():
    """The comparison with the schema is as lenient as the loader itself."""
    text = VALID + (
        "_template: &mine {margin: 1e-2, latency: 0}\n"
        "duration: null\ncutoff: 7\nlog_period: 1e-2\n"
        "controller: {<<: *mine, latency: '0.5', effort_limits: 'true'}\n"
        "disturbances: {noise_seed: 3.0}\n"
        "visualization: {default_proximity_color: {rgba: [1, 0, 0, 0.5]}}\n"
    )
    scenario = parse_scenario(text)
    by_drake = yaml_load_typed(schema=Scenario, data=text, defaults=Scenario())
    assert scenario.to_yaml() == by_drake.to_yaml()
    assert (scenario.controller.margin, scenario.controller.latency) == (0.01, 0.5)
    assert scenario.controller.effort_limits is True
    assert (scenario.duration, scenario.log_period) == (None, 0.01)


@pytest.mark.parametrize(
    "name, text, words",
    [
        ("robot", "model: a\npairs: 3", ["pairs (line 2): expected a list"]),
        ("robot", "pairs:\n- [a, b]\n- [c, 4]", ["pairs[1][1] (line 3)", "text"]),
        ("robot", "rest_posture: {j: up}", ["rest_posture.j", "a number", "'up'"]),
        ("robot", "rest_posture: {j: 1, j: 2}", ["rest_posture.j: the key is there"]),
        ("robot", "task_frame: {}", ["task_frame (line 1)", "'task_frames'"]),
        ("robot", "", ["empty", "models/README.md"]),
        ("robot", "name: [", ["line 1"]),
        ("import", "source: a\nlocked: [j]", ["locked (line 2): expected names"]),
        ("import", "frames: {neck: {lnk: a}}", ["frames.neck.lnk", "'link'"]),
        ("import", "most_capsules: many", ["most_capsules (line 1)", "a whole number"]),
        ("import", "sauce: a", ["sauce (line 1): unknown key", "'source'"]),
        ("import", "base: yes", ["base (line 1): expected text, found true"]),
        ("import", "", ["empty", "docs/guides/your-robot.md"]),
    ],
)
def test_robots_and_imports_are_read_alike(tmp_path: Path, name, text, words):
    file = tmp_path / f"{name}.yaml"
    file.write_text(text)
    with pytest.raises(ModelError) as caught:
        load_robot_description(file) if name == "robot" else load_choices(file)
    for word in [f"{file}: ", *words]:
        assert word in str(caught.value)


def test_a_complete_import_file_is_read(tmp_path):
    file = tmp_path / "import.yaml"
    file.write_text(
        "source: a.urdf\nbase: fixed\nlocked: {j: 1}\nsegments: {a: [b]}\n"
        "frames: {neck: {link: l, point: [0, 0, 1]}}\npairs: [[a, b]]\n"
    )
    choices = load_choices(file)
    assert isinstance(choices, ImportChoices)
    assert choices.frames["neck"].point == [0.0, 0.0, 1.0]
    assert choices.locked == {"j": 1.0} and choices.rest_posture is None
