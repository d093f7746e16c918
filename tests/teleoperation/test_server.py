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

from crar_drake.errors import CrarError, ScenarioError
from crar_drake.law.parameters import PaperParameters
from crar_drake.teleoperation import server as module
from crar_drake.teleoperation.heard_obstacles import HeardObstacles
from crar_drake.teleoperation.messages import MessageError
from crar_drake.teleoperation.newest_messages import EACH, SENDERS, NewestMessages
from crar_drake.teleoperation.safe_motion import SafeMotion
from crar_drake.teleoperation.server import TeleoperationServer
from crar_drake.teleoperation.serving import make_server
from crar_drake.teleoperation.target_stream import Gate

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
    assert server.statistics.latency.count == 150


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


def test_a_robot_that_keeps_off_none_says_why(server, client, monkeypatch):
    server.obstacles = HeardObstacles("its root floats")
    client.send(b'{"obstacles": {"Ann": null}}')
    server._receive()
    assert server.statistics.last_error == "its root floats"


def test_a_robot_that_does_not_follow_is_braked_for(made, monkeypatch):
    """Wrists swing; from the second 1 to 2 the robot stays where it was, from 3 on it
    says nothing."""
    now, motion = 0.0, made.motion
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    motion.begin({})
    server = TeleoperationServer(motion, Gate(), latency=0.02, tracking_error=0.05)
    joints = list(motion.model.joint_names)
    at = motion.model.controlled_positions[: motion.model.n]
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
                measured = dict(zip(joints, robot[at].tolist(), strict=True))
                if k < 300:
                    client.send(json.dumps({"measured": measured}).encode())
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
    assert server.statistics.not_followed == statuses.count("braking") + 1
    assert server.statistics.largest_error == max(said[1:])


def test_it_begins_where_the_robot_says_it_is(made, monkeypatch):
    motion = made.motion
    motion.begin({})
    server = TeleoperationServer(motion, Gate(), start_measured=True)
    name = motion.model.joint_names[-1]
    at = list(motion.model.position_names).index(name)
    there = float(motion.q[at]) - 0.1
    heard = []
    monkeypatch.setattr(server, "_send", lambda command, now: heard.append(command))
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.connect(server.address)
            client.send(json.dumps({"measured": {name: there}}).encode())
            while len(heard) < 2:
                time.sleep(0.01)
    finally:
        server.stop()
        thread.join()
        server.close()
    assert heard[0].positions[at] == pytest.approx(there, abs=1e-9)
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
    server.robot.hear({motion.model.joint_names[-1]: 50.0}, 0.0)
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
        assert len(server._newest) == 0
    messages = server.statistics.messages
    assert messages["taken"] == 60 and messages["flooding"] > 5000
    assert sum(messages.values()) == 60 * 200 + 60
    for other in others:
        other.close()


def test_what_is_kept_of_a_flood_is_bounded():
    newest, lost = NewestMessages(), 0
    for k in range(1000):
        lost += newest.add(b"%d" % k, k % 50, driver=7)
        assert len(newest) <= EACH * SENDERS
    assert lost == 1000 - len(newest)
    kept = list(newest.take(driver=7))
    assert len(newest) == 0 and kept[0][0] == 7
    assert list(kept[0][1]) == [b"807", b"857", b"907", b"957"]
    assert {sender for sender, _ in kept} == {7, *range(43, 50)}


def test_several_lines_in_a_datagram_are_as_many_messages(server, client):
    lines = [targets(0.01 * k, left_wrist=[0.2, 0.2, 0.9]) for k in range(5)]
    client.send(b"\n".join([*lines, b"", b"{", lines[0] + b"\n"]))
    server._receive()
    assert server.statistics.messages == {"taken": 6, "malformed": 1}
    assert server.statistics.targets["late"] == 1
    server.tick(0.0)
    # However short they are, a period has its budget.
    client.send(b"{\n" * 4000)
    server._receive()
    messages = server.statistics.messages
    assert messages["malformed"] == 1 + 64 and messages["flooding"] == 4000 - 64


def test_messages_that_take_long_to_read_do_not_hold_up_the_step(
    server, client, monkeypatch
):
    """A period of 10 ms; each takes 4 ms by a clock that goes on while it is read."""
    now = 0.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)

    def slowly(*_):
        nonlocal now
        now += 4e-3
        raise MessageError("no JSON")

    monkeypatch.setattr(module, "parse", slowly)
    for _ in range(30):
        client.send(b"[{}]")
    server._receive(until=0.01)
    assert now == pytest.approx(0.012)
    assert server.statistics.messages == {"malformed": 3, "flooding": 27 - EACH}
    # Of what is kept the newest is read, and what there is time for.
    server.tick(now)
    assert now == pytest.approx(0.020)
    assert server.statistics.messages == {"malformed": 5, "flooding": 25}
    for _ in range(3):
        client.send(b"[{}]")
    server._receive(until=now - 1.0)
    assert now == pytest.approx(0.020)
    server.tick(now)
    assert server.statistics.messages == {"malformed": 7, "flooding": 26}


def test_a_client_that_is_silent_gets_no_more(server, client):
    client.send(b'{"describe": true}')
    server._receive()
    assert json.loads(client.recv(65536))["tasks"] and not server._clients
    client.send(b'{"drive": true}')
    (now,) = (server._receive(), server._clients[client.getsockname()])[1:]
    server.tick(now)
    server.tick(now + 6.0)
    assert not server._clients
    for _ in range(12):  # more clients than are answered
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.connect(server.address)
            other.send(b'{"drive": true}')
            server._receive()
    assert len(server._clients) == 8


def test_after_a_stall_it_goes_on_from_rest(server, client, monkeypatch):
    now = 0.0
    there = server.motion.model.layout.unpack(server.motion.where()).p[0] + [0.3, 0, 0]

    def later(tick):  # the clock of a process that is not run between two steps
        nonlocal now
        now = tick if len(speeds) != 20 else tick + 0.5

    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    monkeypatch.setattr(server, "_wait", lambda tick: (later(tick), server._receive()))
    speeds, step = [], server.motion.advance

    def advance(desired, *rest):
        speeds.append(np.abs(server.motion.v).max())
        client.send(targets(0.01 * len(speeds), left_wrist=there))
        return step(desired, *rest)

    monkeypatch.setattr(server.motion, "advance", advance)
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
    server._receive()
    for _ in range(30):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.connect(server.address)
            other.send(targets(0.0, left_wrist=[0.0, 0.0, 0.0]))
        server._receive()
    assert client.getsockname() in server._clients and len(server._clients) == 8
    sent = []
    server._reply = lambda line, to: sent.append(to)
    server.tick(0.0)
    assert sent[0] == client.getsockname() and len(sent) == 8


def test_it_listens_at_an_address_of_ip_version_6(made):
    try:
        server = TeleoperationServer(made.motion, host="::1")
    except CrarError as error:
        if "not available" in str(error) or "not supported" in str(error):
            pytest.skip("this computer has no IPv6")
        raise
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as client:
        client.connect(server.address)
        client.settimeout(WAIT)
        client.send(targets(0.0, left_wrist=[0.3, 0.2, 1.0]))
        while not server._clients:
            server._receive()
        server.tick(0.0)
        driver = json.loads(client.recv(65536))["driver"]
        assert driver == f"[::1]:{client.getsockname()[1]}"
    server.close()


def test_it_starts_where_it_is_told(made):
    model, parameters = made.motion.model, made.motion.law.parameters
    motion = SafeMotion(model, parameters, {"left_elbow": -1.5, "torso_yaw": 0.2})
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
            SafeMotion(model, parameters, start)


def test_what_cannot_be_served(made):
    model = made.motion.model
    with pytest.raises(CrarError, match="choose another --port"):
        TeleoperationServer(made.motion, host="127.0.0.1", port=made.address[1])
    with pytest.raises(CrarError, match="from 0 to 65535"):
        TeleoperationServer(made.motion, port=70000)
    with pytest.raises(ScenarioError, match="needs lookahead"):
        SafeMotion(model, PaperParameters(constraints="none"))
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
