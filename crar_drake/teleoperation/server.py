"""The loop of `crar-drake serve`: targets in over UDP, safe commands out.

One thread does all of it. Between two ticks it waits for messages and judges them as
they come; at each tick it takes a control step and sends the command. No message can
hold it up: how much is judged in a period, and until when, is bounded. In a flood the
socket is emptied all the same, so that nothing grows old in it, and of what is too much
the newest of each sender are judged before the step.
"""

import gc
import json
import math
import select
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from crar_drake.addresses import cannot_listen, check_address, family_of
from crar_drake.teleoperation.filtered_motion import FilteredMotion
from crar_drake.teleoperation.followed_robot import FollowedRobot
from crar_drake.teleoperation.heard_obstacles import HeardObstacles
from crar_drake.teleoperation.latencies import Latencies
from crar_drake.teleoperation.messages import (
    LONGEST,
    Command,
    Describe,
    Drive,
    Measured,
    MessageError,
    ObstacleMessage,
    TargetMessage,
    as_targets,
    parse,
)
from crar_drake.teleoperation.newest_messages import NewestMessages
from crar_drake.teleoperation.safe_motion import SafeMotion
from crar_drake.teleoperation.target_stream import Gate, TargetStream

# Messages that are judged in one period as they come.
_MOST_PER_PERIOD = 64
# Datagrams that are taken from the socket at once: more small ones than it holds.
_MOST_AT_ONCE = 1024
# What a flood may take from a step [s]; then one message of each sender is judged.
_GRACE = 1e-3
# Clients that get commands; another one takes the place of who was silent longest.
_MOST_CLIENTS = 8
_CLIENT_TIMEOUT = 5.0  # [s] of silence
# A robot that got no command for so long is taken to have stopped [s].
_STALL = 0.1

MALFORMED, OVERSIZED, FLOODING = "malformed", "oversized", "flooding"
NOT_DRIVING = "not driving"

Address = tuple[str, int]


@dataclass
class Statistics:
    """What a server has done so far."""

    # datagrams that arrived, by what became of them: "taken", "malformed", "oversized",
    # "flooding" (more in a period than are judged, and not the newest of their sender),
    # "not driving" (targets of another client than the one that drives)
    messages: Counter = field(default_factory=Counter)
    # verdict to number of targets, see `target_stream.VERDICTS`
    targets: Counter = field(default_factory=Counter)
    steps: Counter = field(default_factory=Counter)  # status to how many
    held_back: int = 0  # steps that were corrected or scaled
    overruns: int = 0  # steps that began more than a period late
    stalls: int = 0  # steps that began so late that the robot goes on from rest
    unsent: int = 0  # commands that the network did not take
    # steps that braked since the robot was too far from what it was told, or was not
    # heard
    not_followed: int = 0
    largest_error: float = 0.0  # of joints from what they were told [rad or m]
    smallest_distance: float = np.inf  # of a watched pair [m]
    # from a target's arrival to the first command that knows it
    latency: Latencies = field(default_factory=Latencies)
    step_time: Latencies = field(default_factory=Latencies)  # of the control steps
    last_error: str = ""  # what was wrong with the last malformed message

    def lines(self) -> list[str]:
        """For people."""

        def counted(counter: Counter) -> str:
            return ", ".join(f"{n} {what}" for what, n in counter.items()) or "none"

        def times(latencies: Latencies) -> str:
            if not latencies.count:
                return "none"
            p50, p99 = latencies.percentile(50), latencies.percentile(99)
            return (
                f"p50 {1e3 * p50:.2f} ms, p99 {1e3 * p99:.2f} ms, "
                f"longest {1e3 * latencies.longest:.2f} ms"
            )

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
        if self.largest_error or self.not_followed:
            lines.append(
                f"the robot was off by {self.largest_error:.3g} rad or m at most; "
                f"{self.not_followed} steps braked for that, or since it was not heard"
            )
        if self.unsent:
            lines.append(f"{self.unsent} commands could not be sent")
        if self.last_error:
            lines.append(f"last malformed message: {self.last_error}")
        return lines


def listen(host: str = "127.0.0.1", port: int = 0) -> socket.socket:
    """A socket for datagrams, bound.

    Args:
        host: that of another interface than the loopback lets everybody there move the
            robot.
        port: 0 takes one that is free.

    Raises:
        CrarError: nothing can listen there.
    """
    check_address(host, port)
    opened = socket.socket(family_of(host), socket.SOCK_DGRAM)
    opened.setblocking(False)
    try:
        opened.bind((host, port))
    except OSError as error:
        opened.close()
        raise cannot_listen("UDP", host, port, error) from error
    return opened


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
        motion: SafeMotion | FilteredMotion,
        gate: Gate | None = None,
        host: str = "127.0.0.1",
        port: int = 0,
        opened: socket.socket | None = None,
        latency: float = 0.0,
        tracking_error: float = math.inf,
        start_measured: bool = False,
    ) -> None:
        """
        Args:
            gate: what a target may be.
            host, port: see `listen`.
            opened: of `listen`, instead of a new one; it is closed here then.
            latency: of measured positions [s].
            tracking_error: where a joint is farther than this from what it was told,
                or the robot is not heard for the gate's timeout, the motion brakes
                [rad or m]; infinite: never.
            start_measured: whether `run` waits until the robot is heard, and begins
                where it is.

        Raises:
            CrarError: nothing can listen there.
        """
        self.motion = motion
        model = motion.model
        self.stream = TargetStream(motion.layout, gate or Gate(), motion.period)
        self.statistics = Statistics(targets=self.stream.counts)
        self.period = motion.period
        self.robot = FollowedRobot(model.position_names, latency, tracking_error)
        self.obstacles = HeardObstacles(motion.no_obstacles)
        self._start_measured = start_measured
        self._socket = opened or listen(host, port)
        self.address: Address = self._socket.getsockname()[:2]
        self._clients: dict[Address, float] = {}
        self._driver: Address | None = None  # whose targets are followed
        self._driven = -math.inf  # when that one's last targets came [s]
        self._arrived: list[float] = []  # of targets that no command knows yet
        self._of: float | None = None
        self._here = motion.where()
        self._budget = _MOST_PER_PERIOD
        self._newest = NewestMessages()  # of what is beyond the budget
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
        tell: Callable[[Statistics], None] | None = None,
        every: float = 5.0,
        asked: Callable[[], bool] = lambda: False,
    ) -> Statistics:
        """Serves until asked to end or stopped, or for a time; then it brakes first.

        Args:
            duration: [s]; None for no end.
            tell: is called now and then with what was done so far.
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
        while self._start_measured and not self.robot.positions:
            if self._stopped or asked() or (duration and tick - self._start > duration):
                return self.statistics
            self._wait(tick)
            self._take_newest()
            self._budget = _MOST_PER_PERIOD
            tick += self.period
        if self._start_measured:
            self.motion.begin(self.robot.positions)
            self._here = self.motion.where()
            self._start_measured = False
        while True:
            over = duration is not None and tick - self._start >= duration
            self._ends = self._stopped or over or asked()
            if self._ends and self.motion.at_rest:
                return self.statistics
            self._wait(tick)
            late = time.monotonic() - tick
            if late > self.period:
                self.statistics.overruns += 1
                tick += late  # what was missed is not made up for
            if late > _STALL:
                self.statistics.stalls += 1
                self.motion.stop_here()
            self.tick(tick)
            tick += self.period
            if tell is not None and tick - reported >= every:
                reported = tick
                tell(self.statistics)

    def tick(self, now: float) -> Command:
        """One control step on what has arrived, and its command to all clients.

        Args:
            now: on our monotonic clock [s].
        """
        statistics = self.statistics
        self._take_newest()
        began = time.monotonic()
        desired = self.stream.desired_at(now, self._here)
        follows = self.robot.follows(now, self.stream.gate.timeout)
        if self._ends or not follows:
            desired[:] = np.nan  # to brake
        moved = self.motion.move(desired, self.obstacles.at(now))
        self.robot.tell(now + self.period, self.motion.q)
        statistics.step_time.add(time.monotonic() - began)
        command = Command(
            time=now - self._start,
            of=self._of,
            status=moved.status,
            positions=self.motion.q,
            velocities=self.motion.v,
            torques=moved.torques,
            distance=moved.distance,
            admitted=moved.admitted,
            why=moved.why,
            driver=self._named(now),
            tracking_error=self.robot.error,
            tracking_joint=self.robot.joint,
        )
        self._send(command, now)
        sent = time.monotonic()
        for arrived in self._arrived:
            statistics.latency.add(sent - arrived)
        self._arrived.clear()
        statistics.steps[moved.status] += 1
        statistics.held_back += moved.admitted != "nominal"
        statistics.not_followed += not follows
        statistics.smallest_distance = np.fmin(
            statistics.smallest_distance, command.distance
        )
        self._here = self.motion.where()
        self._budget = _MOST_PER_PERIOD
        return command

    def _wait(self, until: float) -> None:
        """Takes messages as they come, until it is time for the next step."""
        while (left := until - time.monotonic()) > 0.0:
            if select.select([self._socket], [], [], left)[0]:
                self._receive(until)
        # Also those that came while nothing waited.
        self._receive(until)

    def _receive(self, until: float = math.inf) -> None:
        """Reads what is there. What is beyond the period's budget, or read later than
        `until` [s], is kept, the newest of it."""
        for _ in range(_MOST_AT_ONCE):
            try:
                data, sender = self._socket.recvfrom(LONGEST + 1)
            except BlockingIOError:
                return
            except OSError:  # an answer to nobody: the network says so here
                continue
            now = time.monotonic()
            if self._budget > 0 and now <= until:
                self._budget -= 1
                self._take(data, sender, now)
            else:
                self._flooded(self._newest.add(data, sender, self._driver))

    def _take_newest(self) -> None:
        """Judges what `_receive` has kept: who drives comes first."""
        late = time.monotonic() + _GRACE
        for sender, kept in self._newest.take(self._driver):
            while kept:
                if time.monotonic() > late:
                    while len(kept) > 1:
                        kept.popleft()
                        self._flooded(1)
                self._budget = 0  # of several lines the last one
                self._take(kept.popleft(), sender, time.monotonic())

    def _flooded(self, count: int) -> None:
        if count > 0:
            self.statistics.messages[FLOODING] += count

    def _take(self, data: bytes, sender: Address, now: float) -> None:
        if len(data) > LONGEST:
            self.statistics.messages[OVERSIZED] += 1
            return
        lines = [line for line in data.split(b"\n") if line.strip()] or [data]
        room = 1 + self._budget  # the datagram is counted already
        self._flooded(len(lines) - room)
        for line in lines[-room:]:
            self._take_line(line, sender, now)
        self._budget -= min(len(lines), room) - 1

    def _take_line(self, line: bytes, sender: Address, now: float) -> None:
        try:
            message = parse(line, self.stream.layout, self.robot.names)
            learned = self._learn(message, now)
        except MessageError as error:
            self._note(error)
            return
        if isinstance(message, Describe):
            self._reply(self._description(), sender)
            return
        self._clients.pop(sender, None)
        while len(self._clients) >= _MOST_CLIENTS:
            others = (each for each in self._clients if each != self._driver)
            del self._clients[next(others)]
        self._clients[sender] = now
        if isinstance(message, Drive):
            self._driver, self._driven = sender, now
        elif not learned:
            self._use(message, now, sender)

    def _learn(self, message: object, now: float) -> bool:
        """Takes what is told of the robot or of obstacles; whether it was that."""
        statistics = self.statistics
        if isinstance(message, Measured):
            self.robot.hear(message.positions, now)
            statistics.messages["measured"] += 1
            if self.robot.error > statistics.largest_error:
                statistics.largest_error = self.robot.error
        elif isinstance(message, ObstacleMessage):
            self.obstacles.hear(message, now)
            statistics.messages["obstacles"] += 1
        else:
            return False
        return True

    def _named(self, now: float) -> str | None:
        """Who drives; None if nobody has for a while."""
        if now - self._driven > self.stream.gate.timeout:
            return None
        host, port = self._driver[:2]
        return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

    def _note(self, error: MessageError) -> None:
        self.statistics.messages[MALFORMED] += 1
        self.statistics.last_error = str(error)[:200]

    def _use(self, message: TargetMessage, now: float, sender: Address) -> None:
        if sender != self._driver and self._named(now) is not None:
            self.statistics.messages[NOT_DRIVING] += 1
            return
        self._driver, self._driven = sender, now
        self.statistics.messages["taken"] += 1
        if self.stream.take(message, now, self._here, sender):
            self._arrived.append(now)
            self._of = message.time

    def _send(self, command: Command, now: float) -> None:
        silent = [c for c, at in self._clients.items() if now - at > _CLIENT_TIMEOUT]
        for client in silent:
            del self._clients[client]
        if self._clients:
            line = command.to_line()
            # Who drives comes first, lest others fill the network's buffer.
            for client in sorted(self._clients, key=lambda each: each != self._driver):
                self._reply(line, client)

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
            "torques": self._actuators(),
        }
        return json.dumps(said).encode() + b"\n"

    def _actuators(self) -> list[str]:
        plant = self.motion.model.plant
        return list(plant.GetActuatorNames(add_model_instance_prefix=False))
