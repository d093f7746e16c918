"""The same targets and commands over LCM: messages of Drake's type lcmt_drake_signal.

Such a message has a time stamp [ms], names and numbers. Channel CRAR_TARGETS carries
targets: a task's numbers are named `TASK.x`, `.y`, `.z` [m] and `.qw`, `.qx`, `.qy`,
`.qz`, that of a task that is a joint `TASK` [rad or m]. Channel CRAR_MEASURED carries
where the robot is, `JOINT` [rad or m], CRAR_OBSTACLES obstacles that move, `NAME.x`,
`.y`, `.z`, `.radius` [m] and `.speed` [m/s], or `NAME.gone`. Channel CRAR_COMMAND
carries what goes back: `q.JOINT` [rad or m], `v.JOINT`, `tau.ACTUATOR` [Nm or N], and
`braking`, 1 or 0. A time stamp of 0 is none.
"""

import struct
from collections.abc import Collection
from functools import partial

from drake import lcmt_drake_signal
from pydrake.lcm import DrakeLcm

from crar_drake.equations.tasks import TaskLayout
from crar_drake.errors import CrarError
from crar_drake.teleoperation.messages import (
    LONGEST,
    PARTS,
    Command,
    Measured,
    MessageError,
    ObstacleMessage,
    TargetMessage,
    make_measured,
    make_obstacles,
    make_targets,
)

TARGETS, COMMAND, MEASURED = "CRAR_TARGETS", "CRAR_COMMAND", "CRAR_MEASURED"
OBSTACLES = "CRAR_OBSTACLES"
_PROBE = "CRAR_PROBE"
_PATIENCE = 500  # [ms]
_ENDINGS = {"orientation": ("qw", "qx", "qy", "qz"), "position": ("x", "y", "z")}


class _EnoughError(Exception):
    """Ends LCM's loop over what has arrived."""


class LcmLink:
    """Subscribes to targets and publishes commands."""

    def __init__(self, url: str, layout: TaskLayout, names: list[str]) -> None:
        """
        Args:
            url: of LCM, as "udpm://239.255.76.67:7667?ttl=0".
            names: of the numbers of a command, in their order.

        Raises:
            CrarError: there is no LCM at the URL.
        """
        self._lcm = DrakeLcm(url)
        self._check(url)
        self._layout, self._names = layout, names
        self._most, self._arrived = 0, []
        for channel in (TARGETS, MEASURED, OBSTACLES):
            self._lcm.Subscribe(channel, partial(self._receive, channel))

    def poll(self, most: int) -> list[tuple[str, bytes]]:
        """What has arrived, its channel and the bytes; it does not wait.

        Args:
            most: messages; LCM hands on what comes while it does, without end where a
                sender is fast enough. What is left waits.
        """
        self._most, self._arrived = most, []
        try:
            self._lcm.HandleSubscriptions(0)
        except _EnoughError:
            pass
        return self._arrived

    def publish(self, command: Command) -> None:
        """Sends a command."""
        message = lcmt_drake_signal()
        message.val = [
            *command.positions,
            *command.velocities,
            *command.torques,
            float(command.status == "braking"),
        ]
        message.coord, message.dim = self._names, len(self._names)
        message.timestamp = int(1e3 * command.time)
        self._lcm.Publish(COMMAND, message.encode())

    def _check(self, url: str) -> None:
        """Hears another LCM at the same URL.

        Where a URL is wrong, LCM says so on stderr alone, and Drake then carries
        messages within each DrakeLcm.
        """
        if url.startswith("memq:"):  # which does just that
            return
        heard: list[bytes] = []
        self._lcm.Subscribe(_PROBE, heard.append)
        DrakeLcm(url).Publish(_PROBE, b"")
        self._lcm.HandleSubscriptions(_PATIENCE)
        if not heard:
            raise CrarError(
                f"--lcm {url}: LCM carries no messages there; LCM itself says why above"
            )

    def _receive(self, channel: str, data: bytes) -> None:
        self._arrived.append((channel, data))
        if len(self._arrived) >= self._most:
            raise _EnoughError


def decode(
    channel: str, data: bytes, layout: TaskLayout, joints: Collection[str] = ()
) -> TargetMessage | Measured | ObstacleMessage:
    """What the bytes of an lcmt_drake_signal say on a channel.

    Raises:
        MessageError: it is none, or as `messages.parse`.
    """
    if len(data) > LONGEST:
        raise MessageError(f"longer than {LONGEST} bytes")
    try:
        message = lcmt_drake_signal.decode(data)
    except (ValueError, struct.error, UnicodeDecodeError, IndexError) as error:
        raise MessageError(f"no lcmt_drake_signal: {error}") from error
    numbers = dict(zip(message.coord, message.val, strict=True))
    if len(numbers) < message.dim:
        raise MessageError("a name twice")
    if channel == MEASURED:
        return make_measured(numbers, joints)
    if channel == OBSTACLES:
        return make_obstacles(_by_name(numbers))
    targets: dict[str, dict] = {}
    for name, kind in zip(layout.names, layout.kinds, strict=True):
        if kind == "joint":
            if name in numbers:
                targets[name] = {"position": numbers.pop(name)}
            continue
        for part, _ in PARTS[kind]:
            keys = [f"{name}.{ending}" for ending in _ENDINGS[part]]
            if all(key in numbers for key in keys):
                values = [numbers.pop(key) for key in keys]
                targets.setdefault(name, {})[part] = values
    if numbers:
        raise MessageError(f"no task has {next(iter(numbers))[:40]!r}")
    time = message.timestamp * 1e-3 if message.timestamp else None
    return make_targets(time, targets, layout)


def _by_name(numbers: dict[str, float]) -> dict[str, dict | None]:
    """Obstacles as `messages.make_obstacles` takes them, of `NAME.PART`."""
    told: dict[str, dict | None] = {}
    for key, value in numbers.items():
        name, _, part = key.rpartition(".")
        told.setdefault(name, {})[part] = value
    for name, parts in told.items():
        if set(parts) == {"gone"}:
            told[name] = None
        elif set(_ENDINGS["position"]) <= set(parts):
            parts["position"] = [parts.pop(key) for key in _ENDINGS["position"]]
    return told
