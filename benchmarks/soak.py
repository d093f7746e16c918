"""Does `serve --joints` hold for minutes, with a robot that lags and people about?

    python -m benchmarks.soak [--minutes 10] [--loss 0.1] [--page PAGE]

Three processes: the server; `examples/lagging_robot.py`, which follows its commands
late and says where it is, a tenth of it lost; and this one, which sends positions of
joints that swing and jump, and where two people are, who come at the robot and leave, a
tenth of it lost, too. What the server's commands do to these people is judged
afterwards by `judging.obstacle_judge`, at two instants of each period, and the
commanded postures by the referee.
"""

import json
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.kept import seed_number
from benchmarks.page import ROOT, Benchmark, Table, run
from crar_drake.errors import CrarError
from crar_drake.judging.obstacle_judge import ObstacleJudge
from crar_drake.judging.referee import Referee
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel

ROBOT = "upper_body"
CONTACT_SPEED = 0.05  # [m/s], the filter's
FASTEST, RADIUS = 1.2, 0.15  # of the people [m/s], [m]
# How old at most a message may be when the server takes it [s]: spheres are told to be
# larger by what people move meanwhile.
AGE = 0.05
TARGETS_EVERY, PEOPLE_EVERY = 0.01, 0.03  # [s]
JUDGED = (0.5, 1.0)  # shares of a period
POSTURES_EVERY = 20  # commands
WARM = 30.0  # [s] until memory counts


@dataclass
class Person:
    """Somebody who comes at the robot, stands, and leaves.

    Attributes:
        name: of its own.
        where: (3,) now [m].
        goal: (3,) where to [m].
        until: when it thinks again [s].
        way: times and places since it was made.
    """

    name: str
    where: np.ndarray
    goal: np.ndarray = field(default_factory=lambda: np.zeros(3))
    until: float = -np.inf
    way: list[tuple[float, np.ndarray]] = field(default_factory=list)

    def walk(self, now: float, rng: np.random.Generator) -> None:
        """Goes on until now [s], no faster than it may."""
        before = self.way[-1][0] if self.way else now
        if now >= self.until:
            self.until = now + rng.uniform(1.0, 4.0)
            near = rng.random() < 0.4
            self.goal = rng.uniform([0.0, -0.4, 0.7], [0.4, 0.4, 1.2])
            if not near:
                self.goal = self.goal * [1.0, 3.0, 1.0] + [1.5, 0.0, 0.0]
        way = self.goal - self.where
        far, most = np.linalg.norm(way), (1.0 - 1e-9) * FASTEST * (now - before)
        self.where = self.where + way * (min(1.0, most / far) if far > 0.0 else 0.0)
        self.way.append((now, self.where))

    def told(self) -> dict:
        """As the server is told of it."""
        radius = RADIUS + AGE * FASTEST
        return {"position": self.where.tolist(), "radius": radius, "speed": FASTEST}

    def at(self, times: np.ndarray) -> np.ndarray:
        """(T, 3) where it was [m]."""
        known = np.array([time for time, _ in self.way])
        places = np.array([place for _, place in self.way])
        return np.column_stack([np.interp(times, known, x) for x in places.T])


class Wishes:
    """Positions of joints that swing about rest, and jump at times."""

    def __init__(self, rest: dict[str, float], rng: np.random.Generator) -> None:
        self._rest, self._rng = rest, rng
        self._size = rng.uniform(0.1, 0.5, len(rest))
        self._rate = rng.uniform(0.5, 2.5, len(rest))
        self._off, self._until = np.zeros(len(rest)), 0.0

    def at(self, now: float) -> dict[str, dict]:
        if now >= self._until:
            self._until = now + self._rng.uniform(1.0, 5.0)
            self._off = self._rng.uniform(-0.6, 0.6, len(self._rest))
        swing = self._off + self._size * np.sin(self._rate * now)
        return {
            name: {"position": float(q + x)}
            for (name, q), x in zip(self._rest.items(), swing, strict=True)
        }


@dataclass
class Seen:
    """What came back, and what it cost.

    Attributes:
        commands: in their order, as they were read.
        arrived: when each did [s].
        latencies: from a target's sending to the first command that knows it [s].
        memory: times since the start [s] and the server's resident memory then [B].
    """

    commands: list[dict] = field(default_factory=list)
    arrived: list[float] = field(default_factory=list)
    latencies: list[float] = field(default_factory=list)
    memory: list[tuple[float, int]] = field(default_factory=list)


def resident(pid: int) -> int:
    """The resident memory of a process [B]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def drive(
    address: tuple[str, int],
    pid: int,
    seconds: float,
    loss: float,
    people: list[Person],
    rest: dict[str, float],
    rng: np.random.Generator,
) -> Seen:
    """Sends targets and people for a while, and hears the commands.

    Args:
        address: of the server.
        pid: its process.
        seconds: how long.
        loss: share of what is sent that is lost.
        people: who walk meanwhile.
        rest: joint to position [rad].
        rng: the dice.
    """
    seen, wishes = Seen(), Wishes(rest, rng)
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.connect(address)
    client.settimeout(0.1)
    begun = False
    while not begun:  # until the robot has said where it is
        client.send(b'{"drive": true}')
        try:
            begun = bool(client.recv(65536))
        except TimeoutError:
            pass
    client.settimeout(0.002)
    start = targets_at = people_at = memory_at = time.monotonic()
    known = None

    def send(said: dict) -> None:
        if rng.random() >= loss:
            client.send(json.dumps(said).encode())

    while (now := time.monotonic()) - start < seconds:
        if now >= targets_at:
            targets_at = now + TARGETS_EVERY
            send({"time": now, "targets": wishes.at(now)})
        if now >= people_at:
            people_at = now + PEOPLE_EVERY
            for person in people:
                person.walk(now, rng)
                send({"obstacles": {person.name: person.told()}})
        if now >= memory_at:
            memory_at = now + 5.0
            seen.memory.append((now - start, resident(pid)))
        try:
            command = json.loads(client.recv(65536))
        except OSError:
            continue
        now = time.monotonic()
        seen.commands.append(command)
        seen.arrived.append(now)
        if command["of"] is not None and command["of"] != known:
            known = command["of"]
            seen.latencies.append(now - known)
    for person in people:  # where they stay until all is judged
        person.walk(time.monotonic(), rng)
        person.way.append((np.inf, person.where))
    return seen


@dataclass(frozen=True)
class Verdict:
    """What was found of the commands.

    Attributes:
        instants: that were judged, of each person.
        contacts, violations: of a person and a link; those at more than is harmless.
        fastest: of a link in a contact [m/s].
        postures, penetrating: that were judged, that penetrate.
        nearest: of all links to each other [m].
        moving: share of the commands in which some joint is faster than 0.2 rad/s.
    """

    instants: int
    contacts: int
    violations: int
    fastest: float
    postures: int
    penetrating: int
    nearest: float
    moving: float


def judge(seen: Seen, people: list[Person], model: ControlModel) -> Verdict:
    """Judges the commands by the people's true places.

    A command is what the robot does in the period after its tick, `time` on the
    server's clock; that one's zero is the earliest that the arrivals allow.
    """
    stamps = np.array([command["time"] for command in seen.commands])
    zero = (np.array(seen.arrived) - stamps).min()
    q = np.array([command["positions"] for command in seen.commands])
    v = np.array([command["velocities"] for command in seen.commands])
    period = float(np.median(np.diff(stamps)))
    links = [link for pair in model.description.pairs for link in pair]
    judge = ObstacleJudge(model.plant, model.scene_graph, links)
    contacts = violations = 0
    fastest = 0.0
    for share in JUDGED:
        times = zero + stamps + share * period
        spheres = np.full((len(q), len(people), 4), RADIUS)
        for i, person in enumerate(people):
            spheres[:, i, :3] = person.at(times)
        # Back from the end of the period along its straight way.
        at = q - (1.0 - share) * period * v
        for found in judge.judge(at, v, spheres, CONTACT_SPEED):
            contacts += found.touching
            violations += found.violations
            fastest = max(fastest, found.fastest)
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    postures = referee.violations(q[::POSTURES_EVERY])
    return Verdict(
        len(JUDGED) * len(q) * len(people),
        contacts,
        violations,
        fastest,
        postures.num_samples,
        postures.num_penetrating,
        postures.smallest_distance,
        float((np.abs(v).max(axis=1) > 0.2).mean()),
    )


def rows_of(seen: Seen, found: Verdict, told: str) -> list[list[str]]:
    """The table's lines: ours, then those that the server prints of itself."""
    p50, p99 = 1e3 * np.percentile(seen.latencies, [50, 99])
    longest = 1e3 * max(seen.latencies)
    warm = [size for at, size in seen.memory if at >= WARM] or [seen.memory[-1][1]]
    mib = [f"{size / 2**20:.1f}" for size in (warm[0], warm[-1], max(warm))]
    return [
        ["commands heard", f"{len(seen.commands):,}"],
        ["of these with a joint at more than 0.2 rad/s", f"{found.moving:.0%}"],
        ["judged instants of a person", f"{found.instants:,}"],
        ["contacts with a person", f"{found.contacts:,}"],
        ["fastest link in a contact", f"{1e3 * found.fastest:.1f} mm/s"],
        ["violations: contacts at more than 50 mm/s", str(found.violations)],
        [
            "judged postures in penetration",
            f"{found.penetrating} of {found.postures:,}; smallest distance "
            f"{1e3 * found.nearest:.1f} mm",
        ],
        [
            f"memory of the server after {WARM:.0f} s, at the end, at most",
            f"{' MiB, '.join(mib)} MiB",
        ],
        [
            "from a target sent to the command that knows it",
            f"p50 {p50:.1f} ms, p99 {p99:.1f} ms, longest {longest:.0f} ms",
        ],
        *(
            [f"server: {what}", text]
            for what, _, text in (line.partition(": ") for line in told.splitlines())
            if text and what != "last malformed message"
        ),
    ]


def soak(minutes: float, loss: float, seed: int) -> list[list[str]]:
    """Starts the processes, drives them, and judges what was done.

    Args:
        minutes: how long.
        loss: share of all messages that is lost.
        seed: of the dice.

    Raises:
        CrarError: the server does not start.
    """
    seconds, rng = 60.0 * minutes, np.random.default_rng(seed)
    server = subprocess.Popen(
        [sys.executable, "-m", "crar_drake", "serve", "--joints", "--robot", ROBOT]
        + ["--port", "0", "--start", "measured", "--latency", "0.01"]
        + ["--tracking-error", "0.3"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    robot = None
    try:
        match = re.search(r"UDP at (.+):(\d+)", server.stdout.readline())
        if match is None:
            raise CrarError("the server does not start")
        address = match[1], int(match[2])
        robot = subprocess.Popen(
            [sys.executable, str(ROOT / "examples" / "lagging_robot.py")]
            + ["--port", match[2], "--late", "0.01", "--loss", str(loss)],
            stdout=subprocess.DEVNULL,
        )
        model = ControlModel.FromDescription(load_robot_description(ROBOT), [])
        names, q = model.position_names, model.rest_positions().tolist()
        rest = dict(zip(names, q, strict=True))
        people = [
            Person("Ann", np.array([2.0, 1.0, 1.0])),
            Person("Bob", np.array([2.0, -1.0, 1.0])),
        ]
        seen = drive(address, server.pid, seconds, loss, people, rest, rng)
        server.terminate()  # it brakes first
        told = server.communicate(timeout=60.0)[0]
    finally:
        for process in (server, robot):
            if process is not None and process.poll() is None:
                process.terminate()
                process.wait(timeout=60.0)
    return rows_of(seen, judge(seen, people, model), told)


def main(argv: Sequence[str] | None = None) -> None:
    """Soaks, and prints or writes the table."""
    benchmark = Benchmark("benchmarks.soak", __doc__, "soak")
    parser = benchmark.parser
    parser.add_argument("--minutes", type=float, default=10.0, help="how long")
    parser.add_argument("--loss", type=float, default=0.1, help="share of messages")
    parser.add_argument("--seed", type=seed_number, default=1, help="of the dice")
    options = benchmark.parse(argv, lambda options: "soak")
    rows = soak(options.minutes, options.loss, options.seed)
    found = (
        f"{options.minutes:g} minutes, {options.loss:.0%} of all messages lost: "
        f"{rows[5][1]} contacts of a person with a link that is faster than 50 mm/s."
    )
    benchmark.report([Table(("what", "measured"), rows)], found)


if __name__ == "__main__":
    run(main)
