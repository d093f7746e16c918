"""The server over a real socket: whatever is sent, its commands are safe."""

import json
import socket
import threading
from dataclasses import replace

import numpy as np
import pytest
from drake import lcmt_drake_signal

from crar_drake.errors import CrarError, ScenarioError
from crar_drake.results.referee import Referee
from crar_drake.teleoperation import server as module
from crar_drake.teleoperation.lcm_link import TARGETS
from crar_drake.teleoperation.messages import LONGEST, MessageError
from crar_drake.teleoperation.safe_motion import SafeMotion
from crar_drake.teleoperation.server import TeleoperationServer
from crar_drake.teleoperation.serving import make_server
from crar_drake.teleoperation.target_stream import Gate


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
        client.settimeout(5.0)
        yield client


def ticks(server, start: float, count: int) -> list:
    commands = []
    for k in range(count):
        server._receive()
        commands.append(server.tick(start + k * server.period))
    return commands


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


def test_whatever_is_sent_nothing_is_violated(server, client, monkeypatch):
    """Nonsense, and targets inside of the chest, behind the back and out of reach."""
    now = 0.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    rng = np.random.default_rng(1)
    model, q, v = server.motion.model, [], []
    nonsense = (b"", b"{", b"\xff" * 50, b"[" * 5000, b"7" * (LONGEST + 9))
    for k in range(600):
        now = k * server.period
        if k % 10 == 0:
            aim = {
                n: rng.uniform(-0.5, 0.5, 3) + [0, 0, 0.9] for n in model.layout.names
            }
        client.send(targets(k * 0.01, **aim))
        client.send(nonsense[k % len(nonsense)])
        server._receive()
        server.tick(now)
        q.append(server.motion.q)
        v.append(server.motion.v)
    judged = Referee(
        model.plant,
        model.scene_graph,
        model.description.pairs,
        velocity_limits=model.velocity_limits,
    )
    found = judged.violations(np.array(q), np.array(v))
    assert found.num_violated == 0 and found.num_beyond_speed == 0
    assert found.smallest_distance < 0.05, "it came near"
    messages, verdicts = server.statistics.messages, server.statistics.targets
    assert messages == {"taken": 600, "malformed": 480, "oversized": 120}
    assert verdicts["clamped"] > 50 and verdicts["passed"] > 200
    assert server.statistics.last_error


def test_a_flood_is_read_in_part_and_thrown_away(server, client):
    for k in range(200):
        client.send(targets(float(k), left_wrist=[0.2, 0.2, 0.9]))
    server._receive()
    messages = server.statistics.messages
    assert messages["taken"] == 64 and messages["flooding"] == 64
    server.tick(0.0)  # a new period, a new budget
    server._receive()
    assert sum(messages.values()) == 200


def test_messages_that_take_long_to_read_do_not_hold_up_the_step(
    server, client, monkeypatch
):
    """A period of 10 ms; each takes 4 ms by a clock that goes on while it is read."""
    now = 0.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)

    def slowly(line, layout):
        nonlocal now
        now += 4e-3
        raise MessageError("no JSON")

    monkeypatch.setattr(module, "parse", slowly)
    for _ in range(30):
        client.send(b"[{}]")
    server._receive(until=0.01)
    assert now == pytest.approx(0.012)
    assert server.statistics.messages == {"malformed": 3, "flooding": 27}
    # Even where there is no time at all, one message is read.
    server.tick(now)
    client.send(b"[{}]")
    client.send(b"[{}]")
    server._receive(until=now - 1.0)
    assert server.statistics.messages == {"malformed": 4, "flooding": 28}


def test_a_flood_over_lcm_is_read_in_part(made):
    """A sender that never stops: it sends again whenever a message is handed on."""
    server = TeleoperationServer(made.motion, lcm_url="memq://")
    lcm, coming = server._lcm._lcm, lcmt_drake_signal().encode()
    lcm.Subscribe(TARGETS, lambda data: lcm.Publish(TARGETS, data))
    lcm.Publish(TARGETS, coming)
    server._receive_lcm(until=np.inf)
    assert server.statistics.messages == {"malformed": 64}
    server.tick(0.0)
    server.close()


def test_it_runs_in_real_time_and_describes_itself(server, client):
    thread = threading.Thread(target=server.run, args=(1.0,))
    thread.start()
    client.send(b'{"describe": true}')
    said = json.loads(client.recv(65536))
    commands = [json.loads(client.recv(65536)) for _ in range(3)]
    thread.join()
    model = server.motion.model
    assert said["tasks"] == {"left_wrist": "position", "right_wrist": "position"}
    assert said["positions"] == list(model.position_names)
    assert len(said["torques"]) == len(commands[0]["torques"])
    assert [c["status"] for c in commands] == ["braking"] * 3
    assert sum(server.statistics.steps.values()) <= 101
    assert any("control step" in line for line in server.statistics.lines())


def test_a_client_that_is_silent_gets_no_more(server, client):
    client.send(b'{"describe": true}')
    (now,) = (server._receive(), server._clients[client.getsockname()])[1:]
    server.tick(now)
    server.tick(now + 6.0)
    assert not server._clients
    for _ in range(12):  # more clients than are answered
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.connect(server.address)
            other.send(b'{"describe": true}')
            server._receive()
    assert len(server._clients) == 8


def test_what_cannot_be_served(made):
    model, parameters = made.motion.model, made.motion.law.parameters
    with pytest.raises(CrarError, match="choose another --port"):
        TeleoperationServer(made.motion, host="127.0.0.1", port=made.address[1])
    with pytest.raises(CrarError, match="from 0 to 65535"):
        TeleoperationServer(made.motion, port=70000)
    with pytest.raises(CrarError, match="--lcm nowhere://: LCM carries no"):
        TeleoperationServer(made.motion, lcm_url="nowhere://")
    with pytest.raises(ScenarioError, match="needs lookahead"):
        SafeMotion(model, replace(parameters, constraints="none"))
    lost = replace(parameters.lookahead, lost_target="error")
    with pytest.raises(ScenarioError, match="lost_target"):
        SafeMotion(model, replace(parameters, lookahead=lost))
    with pytest.raises(CrarError, match="--host is empty"):
        make_server(host="")
    with pytest.raises(ScenarioError, match="--rate 5"):
        make_server(rate=5.0)
