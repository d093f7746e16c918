"""Targets and commands over LCM, within one process."""

import numpy as np
import pytest
from drake import lcmt_drake_signal
from pydrake.lcm import DrakeLcm

from crar_drake.equations.tasks import TaskLayout
from crar_drake.teleoperation.lcm_link import (
    COMMAND,
    MEASURED,
    OBSTACLES,
    TARGETS,
    LcmLink,
    decode,
)
from crar_drake.teleoperation.messages import Command, Heard, MessageError

LAYOUT = TaskLayout(("wrist", "hand"), ("position", "pose"))
NUMBERS = {
    "wrist.x": 0.1, "wrist.y": 0.2, "wrist.z": 0.3,
    "hand.x": 1.0, "hand.y": 2.0, "hand.z": 3.0,
    "hand.qw": 0.0, "hand.qx": 0.0, "hand.qy": 1.0, "hand.qz": 0.0,
}  # fmt: skip


def signal(numbers: dict[str, float], timestamp: int = 1500) -> bytes:
    message = lcmt_drake_signal()
    message.coord, message.val = list(numbers), list(numbers.values())
    message.dim, message.timestamp = len(numbers), timestamp
    return message.encode()


def test_targets():
    message = decode(TARGETS, signal(NUMBERS), LAYOUT)
    assert message.time == 1.5
    assert decode(TARGETS, signal(NUMBERS, 0), LAYOUT).time is None
    np.testing.assert_array_equal(message.targets[0], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(message.targets[1], [0, 0, 1, 0, 1, 2, 3])


@pytest.mark.parametrize(
    "data, why",
    [
        (b"", "no lcmt_drake_signal"),
        (signal(NUMBERS)[:-9], "no lcmt_drake_signal"),
        (signal(NUMBERS)[:8] + b"\x7f\xff\xff\xff", "no lcmt_drake_signal"),
        (signal(NUMBERS)[:8] + b"\xff" * 60, "no lcmt_drake_signal"),
        (signal({}), "no target"),
        (signal({"wrist.x": 0.0}), "no task has 'wrist.x'"),
        (signal(NUMBERS | {"head.x": 0.0}), "no task has 'head.x'"),
        (signal(NUMBERS | {"wrist.x": np.nan}), "beyond all sense"),
        (signal(NUMBERS).replace(b"wrist.x", b"wrist.y"), "twice"),
    ],
)
def test_what_is_refused(data, why):
    with pytest.raises(MessageError, match=why):
        decode(TARGETS, data, LAYOUT)


def test_where_the_robot_is():
    data = signal({"a": 0.25, "b": -1.5})
    assert decode(MEASURED, data, LAYOUT, ("a", "b")).positions == {
        "a": 0.25,
        "b": -1.5,
    }
    with pytest.raises(MessageError, match="no joint 'b'"):
        decode(MEASURED, data, LAYOUT, ("a",))
    with pytest.raises(MessageError, match="measured"):
        decode(MEASURED, signal({}), LAYOUT, ("a",))


def test_obstacles_by_name():
    numbers = {"Ann.x": 1.0, "Ann.y": -2.0, "Ann.z": 0.5, "cart.gone": 1.0}
    numbers |= {"Ann.radius": 0.3, "Ann.speed": 1.6}
    told = decode(OBSTACLES, signal(numbers), LAYOUT).obstacles
    assert told == {"Ann": Heard((1.0, -2.0, 0.5), 0.3, 1.6), "cart": None}
    for wrong in ({"Ann.x": 1.0}, {"radius": 1.0}, numbers | {"Ann.mass": 1.0}, {}):
        with pytest.raises(MessageError):
            decode(OBSTACLES, signal(wrong), LAYOUT)


def test_both_ways():
    """The URL memq:// is of one process, where each LCM hears itself alone."""
    heard = []
    link = LcmLink("memq://", LAYOUT, ["q.a", "v.a", "tau.a", "braking"])
    lcm: DrakeLcm = link._lcm
    lcm.Subscribe(COMMAND, lambda data: heard.append(lcmt_drake_signal.decode(data)))
    lcm.Publish(TARGETS, signal(NUMBERS))
    lcm.Publish(TARGETS, b"nonsense")
    one = np.ones(1)
    link.publish(Command(2.5, None, "braking", one, 2 * one, 3 * one, 0.1, "nominal"))
    assert link.poll(1) == [(TARGETS, signal(NUMBERS))]
    assert link.poll(5) == [(TARGETS, b"nonsense")]
    assert heard[0].timestamp == 2500 and heard[0].val == (1.0, 2.0, 3.0, 1.0)
    assert heard[0].coord == ["q.a", "v.a", "tau.a", "braking"]
