"""The loop of `crar-drake serve`: targets in over UDP, safe commands out.

One thread does all of it. Between two ticks it takes messages from the socket, so that
nothing grows old in it; at each tick it reads them, takes a control step and sends the
command. No message can hold it up: how much is read in a period is bounded, and of what
is too much the newest of each sender are read.
"""

import gc
import json
import math
import select
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from crar_drake.addresses import in_words, listen
from crar_drake.strict_json import MessageError
from crar_drake.teleoperation.followed_robot import FollowedRobot
from crar_drake.teleoperation.gate import Gate
from crar_drake.teleoperation.heard_obstacles import HeardObstacles
from crar_drake.teleoperation.inbox import Inbox
from crar_drake.teleoperation.messages import (
    LONGEST,
    Command,
    Describe,
    Drive,
    Measured,
    Message,
    ObstacleMessage,
    TargetMessage,
    as_targets,
    parse,
)
from crar_drake.teleoperation.safe_motion import SafeMotion
from crar_drake.teleoperation.target_stream import (
    CLAMPED,
    LATE,
    PASSED,
    REJECTED,
    TargetStream,
)

# Datagrams that are taken from the socket at once: more small ones than it holds.
_MOST_AT_ONCE = 1024
# Clients that get commands; another one takes the place of who was silent longest.
_MOST_CLIENTS = 8
_CLIENT_TIMEOUT = 5.0  # [s] of silence
_MOST_TIMES = 200_000  # that statistics are made of, the last ones
_MOST_REASONS = 4  # why messages of a client were not taken, in a command
# A robot that got no command for so long is taken to have stopped [s].
_STALL = 0.1

MALFORMED, OVERSIZED, FLOODING = "malformed", "oversized", "flooding"
REFUSED, NOT_DRIVING = "refused", "not driving"

Address = tuple[str, int]


@dataclass
class _Client:
    """Who gets commands."""

    heard: float  # when it said something last [s]
    # why messages were not taken since the last command, each once, in order
    rejected: dict[str, None] = field(default_factory=dict)


@dataclass
class Statistics:
    """What a server has done so far."""

    # messages, by what became of them: "taken" of targets, "measured", "obstacles",
    # "malformed", "refused" (obstacles), "oversized", "flooding" (more in a period than
    # are read, and not the newest of their sender), "not driving" (targets of another
    # client than the one that drives)
    messages: Counter = field(default_factory=Counter)
    # verdict to number of targets, see `target_stream`
    targets: Counter = field(default_factory=Counter)
    steps: Counter = field(default_factory=Counter)  # status to how many
    held_back: int = 0  # steps that were corrected or scaled
    overruns: int = 0  # steps that began more than a period late
    stalls: int = 0  # steps that began so late that the robot goes on from rest
    unsent: int = 0  # commands that the network did not take
    # steps that braked since the robot was too far from what it was told, or was not
    # heard, or an obstacle was refused
    stopped: int = 0
    largest_error: float = 0.0  # of joints from what they were told [rad or m]
    smallest_distance: float = np.inf  # of a watched pair [m]
    # from a target's arrival to the first command that knows it [s]
    latency: deque[float] = field(default_factory=lambda: deque(maxlen=_MOST_TIMES))
    # of the control steps [s]
    step_time: deque[float] = field(default_factory=lambda: deque(maxlen=_MOST_TIMES))
    last_error: str = ""  # why the last message that was not taken was not

    def lines(self) -> list[str]:
        """For people."""

        def counted(counter: Counter) -> str:
            return ", ".join(f"{n} {what}" for what, n in counter.items()) or "none"

        def times(last: deque[float]) -> str:
            if not last:
                return "none"
            p50, p99, longest = 1e3 * np.percentile(last, (50, 99, 100))
            return f"p50 {p50:.2f} ms, p99 {p99:.2f} ms, longest {longest:.2f} ms"

        lines = [
            f"messages: {counted(self.messages)}",
            f"targets: {counted(self.targets)}",
            f"steps: {counted(self.steps)}; {self.held_back} corrected or scaled, "
            f"{self.overruns} late by more than a period"
            + (
                f", {self.stalls} so late that it went on from rest" * bool(self.stalls)
            ),
            f"from target to command: {times(self.latency)}",
            f"control step: {times(self.step_time)}",
        ]
        if np.isfinite(self.smallest_distance):
            lines.append(f"smallest distance: {1e3 * self.smallest_distance:.1f} mm")
        if self.largest_error:
            lines.append(
                f"the robot was off by {self.largest_error:.3g} rad or m at most"
            )
        if self.stopped:
            lines.append(
                f"{self.stopped} steps braked: the robot did not follow, or was not "
                "heard, or an obstacle was refused"
            )
        if self.unsent:
            lines.append(f"{self.unsent} commands could not be sent")
        if self.last_error:
            lines.append(f"last message that was not taken: {self.last_error}")
        return lines


class TeleoperationServer:
    """A safe motion that whoever sends targets moves.

    Attributes:
        motion: the robot.
        stream: the targets.
        statistics: of all since it was made.
        robot: what it says of itself.
        obstacles: what is said of those that move by themselves.
        address: (host, port) that it listens at.
    """

    def __init__(
        self,
        motion: SafeMotion,
        gate: Gate | None = None,
        opened: socket.socket | None = None,
        latency: float = 0.0,
        tracking_error: float = math.inf,
        start_measured: bool = False,
    ) -> None:
        """
        Args:
            gate: what a target may be.
            opened: of `addresses.listen`, by default a new one; it is closed here.
            latency: of measured positions [s].
            tracking_error: where a joint is farther than this from what it was told,
                or the robot is not heard for the gate's timeout, the motion brakes
                [rad or m]; infinite: never.
            start_measured: whether `run` waits until the robot is heard, and begins
                where it is.
        """
        self.motion = motion
        model = motion.model
        self.stream = TargetStream(motion.layout, gate or Gate(), motion.period)
        self.statistics = Statistics(targets=self.stream.counts)
        self.period = motion.period
        self.robot = FollowedRobot(model.position_names, latency, tracking_error)
        self.obstacles = HeardObstacles(motion.no_obstacles)
        self._start_measured = start_measured
        self._socket = opened or listen("UDP")
        self._socket.setblocking(False)
        self.address: Address = self._socket.getsockname()[:2]
        self._clients: dict[Address, _Client] = {}
        self._driver: Address | None = None  # whose targets are followed
        self._driven = -math.inf  # when that one's last targets came [s]
        self._arrived: list[float] = []  # of targets that no command knows yet
        self._of: float | None = None
        self._here = motion.where()
        self._inbox = Inbox()
        self._start = time.monotonic()
        self._stopped = self._ends = False

    def close(self) -> None:
        """Gives the port free."""
        self._socket.close()

    def stop(self) -> None:
        """Ends `run` as soon as the robot is at rest, from whatever thread."""
        self._stopped = True

    def run(
        self,
        duration: float | None = None,
        tell: Callable[[str], None] = lambda text: None,
        every: float = 5.0,
        asked: Callable[[], bool] = lambda: False,
    ) -> Statistics:
        """Serves until asked to end or stopped, or for a time; then it brakes first.

        Args:
            duration: [s]; None for no end.
            tell: is called now and then with how it goes.
            every: how often [s].
            asked: whether somebody asks it to end.

        Raises:
            ScenarioError: the robot cannot start where it says it is.
        """
        # What lives as long as the server need not be looked through again and again.
        # A Meshcat that was left over, no other thread may destroy: Drake aborts.
        if threading.current_thread() is threading.main_thread():
            gc.collect()
            gc.freeze()
        self._start = reported = time.monotonic()
        tick = self._start + self.period
        self._stopped = False
        while True:
            over = duration is not None and tick - self._start >= duration
            self._ends = self._stopped or over or asked()
            if self._ends and (self.motion.at_rest or self._start_measured):
                return self.statistics
            self._wait(tick)
            late = time.monotonic() - tick
            if late > self.period:
                self.statistics.overruns += 1
                tick += late  # what was missed is not made up for
            if late > _STALL:
                self.statistics.stalls += 1
                self.motion.stop_here()
            if self._start_measured and not self._ends:
                self._begin_where_it_is(tick)
            if not self._start_measured:
                self.tick(tick)
            if tick - reported >= every:
                reported = tick
                tell(self._how_it_goes(tick))
            tick += self.period

    def _begin_where_it_is(self, now: float) -> None:
        """Begins where the robot is, once all of its joints are heard."""
        self._read()
        if not self.robot.unheard(now, self.stream.gate.timeout):
            self.motion.begin(self.robot.positions)
            self._here = self.motion.where()
            self._start_measured = False

    def _how_it_goes(self, now: float) -> str:
        if self._start_measured:
            unheard = self.robot.unheard(now, self.stream.gate.timeout)
            return f"waits for the robot to say where it is; not heard: {unheard}"
        return self.statistics.lines()[3]

    def tick(self, now: float) -> Command:
        """One control step on what has arrived, and its command to all clients.

        Args:
            now: on our monotonic clock [s].
        """
        statistics = self.statistics
        self._read()
        began = time.monotonic()
        desired = self.stream.desired_at(now, self._here)
        held = self.obstacles.reason_to_brake or self.robot.reason_to_brake(
            now, self.stream.gate.timeout
        )
        if self._ends or held:
            desired[:] = np.nan  # to brake
        moved = self.motion.move(desired, self.obstacles.at(now))
        self.robot.tell(now + self.period, self.motion.q)
        statistics.step_time.append(time.monotonic() - began)
        command = Command(
            **vars(moved) | {"why": held or moved.why},
            time=now - self._start,
            of=self._of,
            positions=self.motion.q,
            velocities=self.motion.v,
            driver=self._named(now),
            tracking_error=self.robot.error,
            tracking_joint=self.robot.joint,
        )
        self._send(command, now)
        sent = time.monotonic()
        statistics.latency += (sent - arrived for arrived in self._arrived)
        self._arrived.clear()
        statistics.steps[moved.status] += 1
        statistics.held_back += moved.admitted != "nominal"
        statistics.stopped += held is not None
        statistics.smallest_distance = np.fmin(
            statistics.smallest_distance, command.distance
        )
        self._here = self.motion.where()
        return command

    def _wait(self, until: float) -> None:
        """Takes messages from the socket, until it is time for the next step."""
        while (left := until - time.monotonic()) > 0.0:
            select.select([self._socket], [], [], left)
            self._receive()
        # Also those that came while nothing waited.
        self._receive()

    def _receive(self) -> None:
        """Takes what is there."""
        for _ in range(_MOST_AT_ONCE):
            try:
                data, sender = self._socket.recvfrom(LONGEST + 1)
            except BlockingIOError:
                return
            except OSError:  # an answer to nobody: the network says so here
                continue
            if len(data) > LONGEST:
                self._reject(OVERSIZED, f"longer than {LONGEST} bytes", sender)
                continue
            self._lose(self._inbox.put(data, sender, time.monotonic(), self._driver))

    def _read(self) -> None:
        """Reads the newest of what was taken; who drives comes first, then clients."""
        lines, lost = self._inbox.take(
            lambda sender: (sender != self._driver, sender not in self._clients)
        )
        self._lose(lost)
        for line in lines:
            try:
                message = parse(line.text, self.stream.layout, self.robot.names)
            except MessageError as error:
                self._reject(MALFORMED, str(error), line.sender)
                continue
            if isinstance(message, Describe):
                self._reply(self._description(), line.sender)
                continue
            self._meet(line.sender, line.arrived)
            self._use(message, line.arrived, line.sender)

    def _lose(self, count: int) -> None:
        if count:
            self.statistics.messages[FLOODING] += count

    def _meet(self, sender: Address, now: float) -> None:
        """Takes the sender for a client, who gets commands from now on."""
        known = self._clients.pop(sender, None)
        while len(self._clients) >= _MOST_CLIENTS:
            others = (each for each in self._clients if each != self._driver)
            del self._clients[next(others)]
        self._clients[sender] = known or _Client(now)
        self._clients[sender].heard = now

    def _reject(self, what: str, why: str, sender: Address) -> None:
        """Counts a message that is not taken, and tells its sender, if there is room
        for one who has said nothing else."""
        self.statistics.messages[what] += 1
        self.statistics.last_error = why[:200]
        if sender not in self._clients and len(self._clients) < _MOST_CLIENTS:
            self._meet(sender, time.monotonic())
        self._explain(why, sender)

    def _explain(self, why: str, sender: Address) -> None:
        client = self._clients.get(sender)
        if client is not None and len(client.rejected) < _MOST_REASONS:
            client.rejected[why[:200]] = None

    def _use(self, message: Message, now: float, sender: Address) -> None:
        statistics = self.statistics
        if isinstance(message, Drive):
            self._driver, self._driven = sender, now
        elif isinstance(message, Measured):
            self.robot.hear(message.positions, now)
            statistics.messages["measured"] += 1
            statistics.largest_error = np.fmax(
                statistics.largest_error, self.robot.error
            )
        elif isinstance(message, ObstacleMessage):
            try:
                self.obstacles.hear(message, now)
                statistics.messages["obstacles"] += 1
            except MessageError as error:
                self._reject(REFUSED, str(error), sender)
        elif sender != self._driver and self._named(now) is not None:
            self._reject(NOT_DRIVING, f"{self._named(now)} drives", sender)
        else:
            self._follow(message, now, sender)

    def _follow(self, message: TargetMessage, now: float, sender: Address) -> None:
        self._driver, self._driven = sender, now
        self.statistics.messages["taken"] += 1
        verdicts = self.stream.take(message, now, self._here, sender)
        for task, verdict in verdicts.items():
            if verdict in (REJECTED, LATE):
                self._explain(f"{self.stream.layout.names[task]}: {verdict}", sender)
        if {PASSED, CLAMPED} & set(verdicts.values()):
            self._arrived.append(now)
            self._of = message.time

    def _named(self, now: float) -> str | None:
        """Who drives; None if nobody has for a while."""
        if now - self._driven > self.stream.gate.timeout:
            return None
        return in_words(*self._driver[:2])

    def _send(self, command: Command, now: float) -> None:
        self._clients = {
            address: client
            for address, client in self._clients.items()
            if now - client.heard <= _CLIENT_TIMEOUT
        }
        line = command.to_line() if self._clients else b""
        # Who drives comes first, lest others fill the network's buffer.
        for address in sorted(self._clients, key=lambda each: each != self._driver):
            rejected = self._clients[address].rejected
            told = command.to_line("; ".join(rejected)) if rejected else line
            self._reply(told, address)
            rejected.clear()

    def _reply(self, line: bytes, client: Address) -> None:
        try:
            self._socket.sendto(line, client)
        except OSError:  # a full buffer, or nobody there any more
            self.statistics.unsent += 1

    def _description(self) -> bytes:
        """Names and order, and where the robot's points are, as JSON."""
        model, layout = self.motion.model, self.motion.layout
        said = {
            "robot": model.description.name,
            "period": self.period,
            "tasks": dict(zip(layout.names, layout.kinds, strict=True)),
            "targets": as_targets(self._here, layout),
            "positions": list(model.position_names),
            "velocities": list(model.velocity_names),
            "torques": list(model.plant.GetActuatorNames(False)),
        }
        return json.dumps(said).encode() + b"\n"
