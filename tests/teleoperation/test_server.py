"""The server over a real socket: floods, losses, stalls, drivers, what is refused."""

import gc
import json
import re
import socket
import threading
import time
import weakref
from pathlib import Path

import numpy as np
import pytest

from crar_drake.addresses import listen
from crar_drake.errors import CrarError, ScenarioError
from crar_drake.law.parameters import PaperParameters
from crar_drake.teleoperation import server as module
from crar_drake.teleoperation.gate import Gate
from crar_drake.teleoperation.heard_obstacles import HeardObstacles
from crar_drake.teleoperation.inbox import BYTES, LINES, Inbox
from crar_drake.teleoperation.messages import LONGEST
from crar_drake.teleoperation.server import TeleoperationServer
from crar_drake.teleoperation.serving import make_server
from crar_drake.teleoperation.task_motion import TaskMotion

WAIT = 120.0  # [s] for an answer, which may have to be compiled on a busy computer


@pytest.fixture(scope="module")
def made():
    server = make_server(rate=100.0)
    yield server
    server.close()


@pytest.fixture
def server(made):
    """A new one with the same robot, at rest."""
    motion = made.motion
    motion.q, motion.v = motion.model.rest_positions(), np.zeros_like(motion.v)
    motion.law.reset()
    new = TeleoperationServer(motion, Gate())
    yield new
    new.close()


@pytest.fixture
def client(server):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.connect(server.address)
        client.settimeout(WAIT)
        yield client


def targets(time: float, **positions) -> bytes:
    named = {name: {"position": list(p)} for name, p in positions.items()}
    return json.dumps({"time": time, "targets": named}).encode()


def test_targets_are_followed_and_lost_ones_brake(server, client, monkeypatch):
    now = 100.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    layout, start = server.motion.model.layout, server.motion.where()
    there = layout.unpack(start).p[0] + [0.05, 0.0, 0.05]
    assert server.tick(now).status == "braking"
    statuses = []
    for k in range(200):
        now = 100.0 + k * server.period
        if k < 150:
            client.send(targets(k * 0.01, left_wrist=there))
            server._receive()
        statuses.append(server.tick(now).status)
        answer = json.loads(client.recv(65536))
        assert answer["status"] == statuses[-1]
        assert answer["of"] == pytest.approx(min(k, 149) * 0.01)
        if k == 149:
            p = layout.unpack(server.motion.where()).p
            np.testing.assert_allclose(p[0], there, atol=2e-3)
            # The other wrist has no target, and stays where it was.
            np.testing.assert_allclose(p[1], layout.unpack(start).p[1], atol=5e-3)
    assert statuses[0] == "blending" and statuses[149] == "tracking"
    lost = 150 + round(server.stream.gate.timeout / server.period)
    assert set(statuses[lost + 1 :]) == {"braking"}
    assert np.abs(server.motion.v).max() < 1e-3
    np.testing.assert_array_equal(answer["positions"], server.motion.q.round(9))
    assert len(server.statistics.latency) == 150


def test_obstacles_are_kept_off_until_they_are_taken_away(server, client, monkeypatch):
    """Somebody who comes to a hand that swings: it is slow, by Drake's velocities."""
    now = 0.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    motion, layout = server.motion, server.motion.layout
    plant = motion.model.plant
    context = plant.CreateDefaultContext()
    hand = plant.GetBodyByName("left_hand")
    start = layout.unpack(motion.where()).p[0]

    def swing(count, person=None):
        nonlocal now
        speeds = []
        for k in range(count):
            aim = start + 0.15 * np.sin(5.0 * now) * np.array([0.0, 0.5, 1.0])
            client.send(targets(now, left_wrist=aim))
            if person is not None:
                told = json.dumps({"obstacles": {"Ann": person(k)}})
                client.send(told.encode())
            server._receive()
            command = server.tick(now)
            plant.SetPositions(context, command.positions)
            plant.SetVelocities(context, command.velocities)
            v = hand.EvalSpatialVelocityInWorld(context).translational()
            speeds.append(np.linalg.norm(v))
            now += server.period
        return np.array(speeds), command

    begin, command = swing(100)
    assert begin.max() > 0.2 and command.why is None
    place = hand.EvalPoseInWorld(context).translation()

    def comes(k):
        position = (place + [max(1.5 - 0.015 * k, 0.2), 0.0, 0.0]).tolist()
        return {"position": position, "radius": 0.1, "speed": 1.6}

    near, command = swing(130, comes)
    assert near[-20:].max() <= 0.05
    assert command.why.startswith("obstacle: Ann - ")
    assert command.admitted == "scaled"
    assert server.statistics.messages["obstacles"] == 130
    silent, command = swing(60)
    assert silent.max() <= 0.05 and command.why.startswith("obstacle: Ann - ")
    gone, command = swing(150, lambda k: None)
    assert gone[50:].max() > 0.2 and command.why is None
    assert server.motion.model.n_p  # the waist is prescribed, and stands


def hear(server) -> None:
    """Takes what has arrived, and reads it."""
    server._receive()
    server._read()


def ann(x: float) -> dict:
    return {"position": [x, 0.0, 1.0], "radius": 0.3, "speed": 0.0}


def obstacles(**told) -> bytes:
    return json.dumps({"obstacles": told}).encode()


def test_an_obstacle_too_many_brakes_until_there_is_room(server, client, monkeypatch):
    """A hundred stale ones, and a person: who is ignored is told of in the replies."""
    now = 0.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    there = server.motion.where()[:3] + [0.0, 0.0, 0.05]

    def command(*messages: bytes) -> dict:
        nonlocal now
        for message in (targets(now, left_wrist=there), *messages):
            client.send(message)
        server._receive()
        server.tick(now)
        now += server.period
        return json.loads(client.recv(65536))

    for k in range(10):
        stale = {f"stale {10 * k + i}": ann(50.0) for i in range(10)}
        said = command(obstacles(**stale))
    assert said["status"] == "blending" and said["rejected"] is None
    said = command(obstacles(person=ann(0.6)))
    assert said["status"] == "braking" and said["why"] == "obstacle refused: person"
    assert "more than 100 obstacles" in said["rejected"]
    said = command()
    assert said["status"] == "braking" and said["rejected"] is None
    # One who is known is heard of all the same; with room all are taken.
    command(obstacles(**{"stale 7": None}))
    said = command(obstacles(person=ann(0.6)))
    assert said["status"] == "blending" and said["why"] != "obstacle refused: person"
    said = command(obstacles(other=ann(0.6)))
    assert said["why"] == "obstacle refused: other"
    assert command(b'{"obstacles": null}')["status"] == "blending"
    assert len(server.obstacles) == 0
    assert server.statistics.messages["refused"] == 2


def test_a_robot_that_keeps_off_none_stops_for_all(server, client):
    server.obstacles = HeardObstacles("its root floats")
    client.send(obstacles(Ann=ann(1.0)))
    server._receive()
    assert server.tick(0.0).why == "obstacle refused: Ann"
    assert json.loads(client.recv(65536))["rejected"] == "its root floats"
    client.send(obstacles(Ann=None))
    server._receive()
    assert server.tick(0.01).why is None


def test_replies_say_what_was_not_taken(server, client, monkeypatch):
    monkeypatch.setattr(module.time, "monotonic", lambda: 0.0)
    x, y, z = server.motion.where()[:3]

    def rejected(message: bytes) -> str | None:
        client.send(message)
        server._receive()
        server.tick(0.0)
        return json.loads(client.recv(65536))["rejected"]

    assert "no JSON" in rejected(b"{")
    assert f"longer than {LONGEST}" in rejected(b"x" * (LONGEST + 1))
    assert "is not from" in rejected(
        b'{"measured": {"left_elbow": 1%s}}' % (b"0" * 400)
    )
    assert rejected(targets(1.0, left_wrist=[x, y, z])) is None
    assert rejected(targets(1.0, left_wrist=[x, y, z])) == "left_wrist: late"
    assert rejected(targets(2.0, left_wrist=[x + 9, y, z])) == "left_wrist: rejected"
    assert rejected(b'{"drive": true}') is None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.connect(server.address)
        other.settimeout(WAIT)
        other.send(targets(1.0, left_wrist=[x, y, z]))
        hear(server)
        server.tick(0.0)
        said = json.loads(other.recv(65536))
    assert said["rejected"] == f"{said['driver']} drives"


def test_a_robot_that_does_not_follow_is_braked_for(made, monkeypatch):
    """Wrists swing; from the second 1 to 2 the robot stays where it was, from 3 on it
    says nothing."""
    now, motion = 0.0, made.motion
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    motion.begin({})
    server = TeleoperationServer(motion, Gate(), latency=0.02, tracking_error=0.05)
    joints = list(motion.model.position_names)
    layout, home = motion.model.layout, motion.where()
    p = layout.unpack(home).p[0]
    states, said, statuses, stayed = [motion.q] * 3, [], [], None
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.connect(server.address)
            assert server.tick(now).status == "braking", "it was not heard yet"
            for k in range(400):
                now = 0.01 * k
                aim = p + [0.1 * np.sin(3.0 * now), 0.0, 0.05]
                client.send(targets(now, left_wrist=aim))
                if k == 100:
                    stayed = states[0]
                robot = stayed if 100 <= k < 200 else states[0]
                measured = list(zip(joints, robot.tolist(), strict=True))
                # Its arms speak for themselves, the wrong one first.
                for some in (measured[::2], measured[1::2]) if k < 300 else ():
                    client.send(json.dumps({"measured": dict(some)}).encode())
                server._receive()
                command = server.tick(now)
                # What is measured now is what was commanded for 20 ms ago.
                states = [*states[1:], motion.q]
                said.append(command.tracking_error)
                statuses.append(command.status)
    finally:
        server.close()
    assert set(statuses[80:100]) == {"tracking"} and max(said[10:100]) < 1e-9
    # It moves on until it is 0.05 rad off, then brakes, and stays off.
    first = statuses.index("braking", 100)
    assert said[first] > 0.05 and max(said[100:first]) <= 0.05 + 1e-9
    assert set(statuses[first:200]) == {"braking"}
    assert statuses[280] == "tracking", "the robot was back"
    silent = 300 + round(server.stream.gate.timeout / server.period)
    assert statuses[silent - 2] == "tracking" and statuses[silent + 2] == "braking"
    assert server.statistics.stopped == statuses.count("braking") + 1
    assert server.statistics.largest_error == max(said[1:])


def test_it_begins_where_the_robot_says_it_is(made, monkeypatch):
    """Once all joints are heard, in messages of their own, and lately."""
    now, motion = 0.0, made.motion
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    motion.begin({})
    server = TeleoperationServer(motion, Gate(), start_measured=True)
    names = list(motion.model.position_names)
    there = dict(zip(names, (motion.q - 0.01).tolist(), strict=True))
    periods, heard, told = 0, [], []

    def wait(tick: float) -> None:
        """One joint a period, the first of them again after a while."""
        nonlocal now, periods
        now, periods = tick, periods + 1
        if periods > 40:  # till then it is silent
            name = names[periods % len(names)]
            client.send(json.dumps({"measured": {name: there[name]}}).encode())
        server._receive()

    monkeypatch.setattr(server, "_wait", wait)
    monkeypatch.setattr(server, "_send", lambda command, now: heard.append(command))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.connect(server.address)
        client.send(json.dumps({"measured": {names[0]: there[names[0]]}}).encode())
        server.run(1.0, told.append, 0.1)
    server.close()
    assert told[0].startswith("waits for the robot to say where it is; not heard: ")
    assert names[1] in told[0] and names[0] in told[2]
    assert len(heard) == periods - 40 - len(names) + 1
    np.testing.assert_allclose(heard[0].positions, motion.q * 0 + list(there.values()))
    motion.begin({})


def test_in_a_thread_it_destroys_nothing_of_others(made):
    """Drake aborts where a Meshcat is destroyed by another thread than the main one."""
    made.motion.begin({})
    server = TeleoperationServer(made.motion, Gate())
    thread = threading.Thread(target=server.run, args=(2.0 * server.period,))
    gc.disable()
    try:
        left_over = type("LeftOver", (), {})()
        left_over.itself = left_over
        here = weakref.ref(left_over)
        del left_over
        thread.start()
        thread.join()
        assert here() is not None
    finally:
        gc.enable()
        server.close()
    made.motion.begin({})


def test_a_robot_that_is_beyond_its_limits_cannot_begin_there(made):
    motion = made.motion
    server = TeleoperationServer(motion, Gate(), start_measured=True)
    rest = dict.fromkeys(server.robot.names, 0.0)
    now = module.time.monotonic()
    server.robot.hear(rest | {motion.model.joint_names[-1]: 50.0}, now + 60.0)
    try:
        with pytest.raises(ScenarioError, match="beyond its limits"):
            server.run(1.0)
    finally:
        server.close()
        motion.begin({})


def test_nobodys_flood_drowns_another_client(server, client, monkeypatch):
    """Garbage by thousands, also from many addresses, before and after each target."""
    now = 100.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    others = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(20)]
    for k in range(60):
        now = 100.0 + k * server.period
        for batch in range(10):
            for other in others[: 1 if k < 30 else None]:
                for _ in range(20 if k < 30 else 1):
                    other.sendto(b"[1, 2", server.address)
            if batch == 4:
                client.send(targets(0.01 * k, left_wrist=[0.25, 0.2, 0.95]))
            server._receive()
        command = server.tick(now)
        assert command.of == pytest.approx(0.01 * k)
        assert len(server._inbox) == 0
    messages = server.statistics.messages
    assert messages["taken"] == 60 and messages["flooding"] > 5000
    assert sum(messages.values()) == 60 * 200 + 60
    for other in others:
        other.close()


def test_what_is_kept_of_a_flood_is_bounded():
    inbox, lost = Inbox(), 0
    for k in range(10_000):
        lost += inbox.put(b"%d" % k, k % 100, 0.0, driver=7)
        assert len(inbox) <= LINES * LINES
    taken, more = inbox.take(lambda sender: sender != 7)
    assert len(inbox) == 0 and len(taken) == LINES
    assert lost + more == 10_000 - LINES
    # The newest of each of those who spoke last, and of who drives, in their order.
    assert [line.sender for line in taken] == [7, *range(37, 100)]
    assert [int(line.text) for line in taken] == [9907, *range(9937, 10_000)]
    # One alone has all of it, and long ones are fewer.
    for k in range(100):
        inbox.put(b"%d" % k, "one", 0.0, driver=None)
    taken, _ = inbox.take(lambda sender: 0)
    assert [int(line.text) for line in taken] == list(range(36, 100))
    for k in range(20):
        inbox.put(b"%4096d" % k, "one", 0.0, driver=None)
    taken, lost = inbox.take(lambda sender: 0)
    assert len(taken) == BYTES // 4096 and lost == 20 - len(taken)


@pytest.mark.parametrize("together", [False, True])
def test_a_burst_is_read_however_late_it_is(server, client, together, monkeypatch):
    """64 lines a period, in as many datagrams or in some: none is lost."""
    now = 0.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    x, y, z = server.motion.where()[:3]
    for k in range(20):
        lines = [
            targets(0.01 * k + 1e-4 * i, left_wrist=[x, y, z]) for i in range(LINES)
        ]
        size = 16 if together else 1
        for i in range(0, LINES, size):
            client.send(b"\n".join(lines[i : i + size]))
        now = 0.01 * k + 0.5 * (k % 2)  # the step is late
        server._wait(0.01 * k)
        server.tick(now)
    assert server.statistics.messages == {"taken": 20 * LINES}
    assert server.statistics.targets["late"] == 0


def test_several_lines_in_a_datagram_are_as_many_messages(server, client):
    lines = [targets(0.01 * k, left_wrist=[0.2, 0.2, 0.9]) for k in range(5)]
    client.send(b"\n".join([*lines, b"", b"{", lines[0] + b"\n"]))
    hear(server)
    assert server.statistics.messages == {"taken": 6, "malformed": 1}
    assert server.statistics.targets["late"] == 1
    # However short they are, a period has its budget.
    client.send(b"{\n" * 4000)
    hear(server)
    messages = server.statistics.messages
    assert messages["malformed"] == 1 + LINES and messages["flooding"] == 4000 - LINES


def test_a_client_that_is_silent_gets_no_more(server, client):
    client.send(b'{"describe": true}')
    hear(server)
    assert json.loads(client.recv(65536))["tasks"] and not server._clients
    client.send(b'{"drive": true}')
    hear(server)
    now = server._clients[client.getsockname()].heard
    server.tick(now)
    server.tick(now + 6.0)
    assert not server._clients
    for _ in range(12):  # more clients than are answered
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.connect(server.address)
            other.send(b'{"drive": true}')
            hear(server)
    assert len(server._clients) == 8


def test_after_a_stall_it_goes_on_from_rest(server, client, monkeypatch):
    now = 0.0
    there = server.motion.model.layout.unpack(server.motion.where()).p[0] + [0.3, 0, 0]

    def later(tick):  # the clock of a process that is not run between two steps
        nonlocal now
        now = tick if len(speeds) != 20 else tick + 0.5

    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    monkeypatch.setattr(server, "_wait", lambda tick: (later(tick), server._receive()))
    speeds, step = [], server.motion.move

    def move(desired, *rest):
        speeds.append(np.abs(server.motion.v).max())
        client.send(targets(0.01 * len(speeds), left_wrist=there))
        return step(desired, *rest)

    monkeypatch.setattr(server.motion, "move", move)
    server.run(0.9)
    assert speeds[19] > 0.3 and speeds[20] == 0.0 and max(speeds[21:]) > 0.3
    assert server.statistics.stalls == 1
    assert any("went on from rest" in line for line in server.statistics.lines())


def test_one_client_drives_until_another_asks(server, client, monkeypatch):
    x, y, z = server.motion.where()[:3]
    now = 0.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)

    def driver_after(by, towards) -> str | None:
        nonlocal now
        now += server.period
        by.send(targets(now, left_wrist=[x, y, z + towards]))
        server._receive()
        return server.tick(now).driver

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.connect(server.address)
        here, there = (":".join(map(str, s.getsockname())) for s in (client, other))
        assert driver_after(client, 0.1) == here
        assert driver_after(other, -0.1) == here
        assert server.statistics.messages["not driving"] == 1
        other.send(b'{"drive": true}')
        assert driver_after(other, -0.1) == there
        assert driver_after(client, 0.1) == there
        assert server.statistics.messages["not driving"] == 2
        # Nobody drives once who did is silent; then whoever speaks does.
        now += 2 * server.stream.gate.timeout
        assert server.tick(now).driver is None
        assert driver_after(client, 0.1) == here


def test_whoever_drives_gets_every_command(server, client):
    """However many others ask for them."""
    client.send(targets(0.0, left_wrist=server.motion.where()[:3]))
    hear(server)
    for _ in range(30):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.connect(server.address)
            other.send(targets(0.0, left_wrist=[0.0, 0.0, 0.0]))
        hear(server)
    assert client.getsockname() in server._clients and len(server._clients) == 8
    sent = []
    server._reply = lambda line, to: sent.append(to)
    server.tick(0.0)
    assert sent[0] == client.getsockname() and len(sent) == 8


def test_it_listens_at_an_address_of_ip_version_6(made):
    try:
        server = TeleoperationServer(made.motion, opened=listen("UDP", "::1"))
    except CrarError as error:
        if "not available" in str(error) or "not supported" in str(error):
            pytest.skip("this computer has no IPv6")
        raise
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as client:
        client.connect(server.address)
        client.settimeout(WAIT)
        client.send(targets(0.0, left_wrist=[0.3, 0.2, 1.0]))
        while not server._clients:
            hear(server)
        server.tick(0.0)
        driver = json.loads(client.recv(65536))["driver"]
        assert driver == f"[::1]:{client.getsockname()[1]}"
    server.close()


def test_it_starts_where_it_is_told(made):
    model, parameters = made.motion.model, made.motion.law.parameters
    motion = TaskMotion(model, parameters, {"left_elbow": -1.5, "torso_yaw": 0.2})
    where = dict(zip(model.position_names, motion.q, strict=True))
    rest = dict(zip(model.position_names, model.rest_positions(), strict=True))
    assert where == {**rest, "left_elbow": -1.5, "torso_yaw": 0.2}
    assert motion.at_rest
    wrong = {
        "no joint 'left_elbo'.*did you mean 'left_elbow'": {"left_elbo": 0.0},
        "left_elbow at 1 is beyond its limits": {"left_elbow": 1.0},
        "left_elbow at nan": {"left_elbow": np.nan},
        "apart there, and the floor is": {
            "left_shoulder_yaw": 1.5, "left_elbow": -2.0, "left_shoulder_roll": -0.3,
        },
    }  # fmt: skip
    for message, start in wrong.items():
        with pytest.raises(ScenarioError, match=message):
            TaskMotion(model, parameters, start)


def test_what_cannot_be_served(made):
    model = made.motion.model
    with pytest.raises(CrarError, match="choose another --port"):
        listen("UDP", "127.0.0.1", made.address[1])
    with pytest.raises(CrarError, match="from 0 to 65535"):
        listen("UDP", port=70000)
    with pytest.raises(ScenarioError, match="needs lookahead"):
        TaskMotion(model, PaperParameters(constraints="none"))
    with pytest.raises(CrarError, match="--host is empty"):
        make_server(host="")
    with pytest.raises(ScenarioError, match="--rate 5"):
        make_server(rate=5.0)


def test_the_client_on_the_page_moves_the_wrist_as_the_hand(server):
    """The page's program, with a hand that rises by 5 cm."""
    page = Path(__file__).parents[2] / "docs" / "guides" / "teleoperation.md"
    (program,) = re.findall(
        r"^```python\n(.*?)^```", page.read_text("utf-8"), re.M | re.S
    )
    before = server.motion.where()[:6]
    heights, there = iter(np.minimum(np.linspace(0.0, 2.0, 1600), 0.05)), 0

    def tracked_hand():
        nonlocal there
        time.sleep(0.02)  # a headset's own rate
        height = next(heights, None)
        moved = server.motion.where()[:6] - before
        there = there + 1 if np.allclose(moved, [0, 0, 0.05, 0, 0, 0], atol=1e-3) else 0
        if height is None or there == 10:  # or half a minute is over
            raise EOFError
        return [7.0, 8.0, 9.0 + height]  # in a frame of its own

    thread = threading.Thread(target=server.run)
    thread.start()
    known = {"json": json, "socket": socket, "tracked_hand": tracked_hand}
    try:
        with pytest.raises(EOFError):
            exec(program.replace("7670", str(server.address[1])), known)
        after = server.motion.where()[:6]
    finally:
        known["server"].close()
        server.stop()
        thread.join()
    np.testing.assert_allclose(after - before, [0, 0, 0.05, 0, 0, 0], atol=2e-3)
