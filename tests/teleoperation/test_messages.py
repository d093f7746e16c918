"""What is a message and what is none."""

import json
from dataclasses import replace

import numpy as np
import pytest

from crar_drake.law.tasks import TaskLayout
from crar_drake.strict_json import MessageError
from crar_drake.teleoperation.messages import (
    LONGEST,
    Command,
    Describe,
    Heard,
    as_targets,
    parse,
)

LAYOUT = TaskLayout(("wrist", "gaze", "hand"), ("position", "orientation", "pose"))


def of(targets: object, **others: object) -> bytes:
    return json.dumps({"targets": targets, **others}).encode()


def test_targets_of_each_kind():
    targets = {
        "hand": {"position": [1, 2, 3], "orientation": [0, 0, 1.5, 0]},
        "wrist": {"position": [0.5, -1e-3, 2]},
        "gaze": {"orientation": [0.6, 0.8, 0, 0]},
    }
    message = parse(of(targets, time=12.5), LAYOUT)
    assert message.time == 12.5 and set(message.targets) == {0, 1, 2}
    np.testing.assert_array_equal(message.targets[0], [0.5, -1e-3, 2])
    np.testing.assert_array_equal(message.targets[1], [0.6, 0.8, 0, 0])
    # In the order of x_d: the quaternion, of unit length now, and then the position.
    np.testing.assert_array_equal(message.targets[2], [0, 0, 1, 0, 1, 2, 3])
    x = np.concatenate([message.targets[task] for task in range(3)])
    assert as_targets(x, LAYOUT) == {
        **targets,
        "hand": {"position": [1, 2, 3], "orientation": [0, 0, 1, 0]},
    }
    assert parse(of({"wrist": {"position": [0, 0, 0]}}), LAYOUT).time is None
    assert parse(b'{"describe": true}\n', LAYOUT) == Describe()


@pytest.mark.parametrize(
    "line, why",
    [
        (b"", "no JSON"),
        (b"\xff\xfe\x00", "no JSON"),
        (b"[" * 8000, "no JSON"),
        (b'"' + b"x" * LONGEST + b'"', "longer than"),
        (b"[]", "no JSON object"),
        (b"{}", "targets"),
        (of([]), "targets"),
        (of({}), "no target"),
        (of({"wrist": {"position": [0, 0, 0]}}, run="ls"), "targets"),
        (of({"__class__": {"position": [0, 0, 0]}}), "no task '__class__'"),
        (of({"wrist": [0, 0, 0]}), "a position has position"),
        (of({"wrist": {"position": [0, 0]}}), "3 numbers"),
        (of({"wrist": {"position": [0, 0, "0"]}}), "'0' is no number"),
        (of({"wrist": {"position": [0, 0, True]}}), "'True' is no number"),
        (of({"wrist": {"position": [0, 0, None]}}), "'None' is no number"),
        (of({"wrist": {"position": [0, 0, 1e9]}}), "is not from -1000 to 1000"),
        (of({"wrist": {"position": [0, 0, 10**400]}}), "is not from"),
        (b'{"targets": {"wrist": {"position": [0, 0, NaN]}}}', "NaN is no number"),
        (b'{"targets": {"wrist": {"position": [0, 0, 1e999]}}}', "is not from"),
        (b'{"targets": {"wrist": {"position": [0,0,0], "position": 1}}}', "twice"),
        (of({"gaze": {"orientation": [0, 0, 0, 0]}}), "length 0"),
        (of({"gaze": {"orientation": [1e3, 0, 0, 0]}}), "length 1e"),
        (of({"hand": {"position": [0, 0, 0]}}), "orientation and position"),
        (of({"wrist": {"position": [0, 0, 0]}}, time="now"), "'now' is no number"),
        (of({"wrist": {"position": [0, 0, 0]}}, time=10**400), "is not from"),
        (rb'{"obstacles": {"\ud800": null}}', "no valid Unicode"),
        (b'{"time": -Infinity, "targets": {}}', "no JSON"),
        (b'{"describe": 1, "targets": {}}', "targets"),
    ],
)
def test_what_is_refused(line, why):
    with pytest.raises(MessageError, match=why):
        parse(line, LAYOUT)


def test_obstacles_by_name():
    told = {"position": [1, -2.5, 0], "radius": 0.3, "speed": 1.6}
    line = json.dumps({"obstacles": {"person": told, "trolley": None}}).encode()
    assert parse(line, LAYOUT).obstacles == {
        "person": Heard((1.0, -2.5, 0.0), 0.3, 1.6),
        "trolley": None,
    }
    assert parse(b'{"obstacles": null}', LAYOUT).obstacles is None


@pytest.mark.parametrize(
    "told, why",
    [
        ([], "by name"),
        ({}, "by name"),
        ({"": None}, "1 to 40"),
        ({"x" * 41: None}, "1 to 40"),
        ({"a": 1}, "position, radius and speed"),
        ({"a": {"position": [0, 0, 0], "radius": 1}}, "position, radius and speed"),
        (
            {"a": {"position": [0, 0, 0], "radius": 1, "speed": 1, "mass": 1}},
            "position, radius and speed",
        ),
        ({"a": {"position": [0, 0], "radius": 1, "speed": 1}}, "3 numbers"),
        ({"a": {"position": [0, 0, 1e9], "radius": 1, "speed": 1}}, "is not from"),
        ({"a": {"position": [0, 0, 0], "radius": -1, "speed": 1}}, "from 0 to"),
        ({"a": {"position": [0, 0, 0], "radius": 1, "speed": True}}, "no number"),
    ],
)
def test_obstacles_that_are_refused(told, why):
    with pytest.raises(MessageError, match=why):
        parse(json.dumps({"obstacles": told}).encode(), LAYOUT)
    with pytest.raises(MessageError, match="targets"):
        both = {"obstacles": {"a": None}, "targets": {}}
        parse(json.dumps(both).encode(), LAYOUT)


def test_random_bytes_and_damaged_messages_only_raise_message_errors():
    rng = np.random.default_rng(0)
    good = of({"hand": {"position": [1, 2, 3], "orientation": [0, 0, 1, 0]}}, time=1)
    understood = 0
    for _ in range(3000):
        line = bytearray(good)
        for _ in range(rng.integers(1, 4)):
            line[rng.integers(len(line))] = rng.integers(32, 128)
        try:
            end = len(line) if rng.random() < 0.7 else rng.integers(len(line))
            message = parse(bytes(line[:end]), LAYOUT)
        except MessageError:
            continue
        understood += 1
        assert all(np.isfinite(x).all() for x in message.targets.values())
    assert understood > 0, "a changed digit is another number"


def test_a_command_as_a_line():
    numbers = np.array([0.1, -2.0])
    command = Command(
        1.5, None, "braking", numbers, numbers, numbers[:1], 0.02, "scaled"
    )
    line = command.to_line()
    assert line.endswith(b"}\n") and line.count(b"\n") == 1
    said = json.loads(line)
    assert said["positions"] == [0.1, -2.0] and said["torques"] == [0.1]
    stamped = replace(command, of=1 / 3).to_line("late")
    assert json.loads(stamped)["of"] == 1 / 3, "a client looks for it"
    assert (said["rejected"], json.loads(stamped)["rejected"]) == (None, "late")
    nothing_watched = replace(command, distance=float("inf")).to_line()
    assert json.loads(nothing_watched)["distance"] is None
    assert (said["of"], said["status"], said["admitted"]) == (None, "braking", "scaled")
