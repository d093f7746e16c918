"""Joint commands through the server, judged by code of its own."""

import json
import socket

import numpy as np
import pytest

from crar_drake.errors import ScenarioError
from crar_drake.law.obstacles import Obstacles
from crar_drake.strict_json import MessageError
from crar_drake.teleoperation import server as module
from crar_drake.teleoperation.gate import Gate
from crar_drake.teleoperation.heard_obstacles import MOST, HeardObstacles
from crar_drake.teleoperation.messages import Heard, ObstacleMessage
from crar_drake.teleoperation.server import TeleoperationServer
from crar_drake.teleoperation.serving import make_server


class Loop:
    """A server whose clock is at `now`, and a client of it."""

    def __init__(self, server, client):
        self.server, self.client, self.now = server, client, 0.0
        self.motion = server.motion
        self.names = server.motion.filter.joint_names

    def tick(self, joints, measured=None):
        """Says where joints are to be and where they are, and takes a step."""
        named = {name: {"position": float(x)} for name, x in joints.items()}
        if named:
            self.client.send(json.dumps({"targets": named}).encode())
        q = self.motion.q if measured is None else measured
        said = {"measured": dict(zip(self.names, q.tolist(), strict=True))}
        self.client.send(json.dumps(said).encode())
        self.server._receive()
        command = self.server.tick(self.now)
        self.now += self.server.period
        return command

    def tell(self, **obstacles):
        """Says where obstacles are."""
        self.client.send(json.dumps({"obstacles": obstacles}).encode())


@pytest.fixture(scope="module")
def made():
    server = make_server(joints=True, rate=100.0)
    yield server.motion
    server.close()


@pytest.fixture
def loop(made, monkeypatch):
    made.begin({})
    server = TeleoperationServer(made, Gate(), tracking_error=0.2)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.connect(server.address)
        client.settimeout(60.0)
        loop = Loop(server, client)
        monkeypatch.setattr(module.time, "monotonic", lambda: loop.now)
        yield loop
    server.close()


def test_what_is_safe_is_commanded_as_it_is(loop):
    """An elbow that swings slowly, heard 100 times a second; the others stay."""
    home, elbow = loop.motion.q.copy(), loop.names.index("left_elbow")
    for _ in range(50):  # until it is blended in
        loop.tick({"left_elbow": home[elbow]})
        loop.client.recv(65536)
    targets = home[elbow] - 0.2 * np.sin(np.arange(200) * 0.01) ** 2
    for k, x in enumerate(targets):
        command = loop.tick({"left_elbow": x})
        others = np.delete(command.positions - home, elbow)
        np.testing.assert_array_equal(others, 0.0)
        # At the tick the target has moved on, by its speed, to the period's end.
        wanted = x + (x - targets[k - 1] if k else 0.0)
        assert command.positions[elbow] == pytest.approx(wanted, abs=1e-12)
        assert command.admitted == "nominal" and command.why is None
        answer = json.loads(loop.client.recv(65536))
        assert answer["why"] is None and answer["status"] == "tracking"


def test_targets_are_blended_in_after_a_gap(loop):
    """Half a second at first, and again, however fast a joint could go."""
    home, elbow = loop.motion.q[loop.names.index("left_elbow")], "left_elbow"
    at = loop.names.index(elbow)
    for start, goal in ((home, home - 0.3), (home - 0.3, home)):
        commands = [loop.tick({elbow: goal}) for _ in range(60)]
        way = np.array([c.positions[at] for c in commands]) - start
        statuses = [c.status for c in commands]
        assert set(statuses[:49]) == {"blending"} and set(statuses[50:]) == {"tracking"}
        # The quintic that begins and ends at rest, a period on.
        t = np.minimum(np.arange(1, 61) * loop.server.period / 0.5, 1.0)
        smooth = t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
        np.testing.assert_allclose(way, smooth * (goal - start), atol=1e-3)
        for _ in range(40):
            command = loop.tick({})
        assert command.status == "braking"


def test_without_targets_nothing_is_held_back(loop):
    command = loop.tick({})
    assert command.status == "braking" and command.why is None


def test_it_brakes_where_the_robot_does_not_follow(loop):
    home, elbow = loop.motion.q.copy(), loop.names.index("left_elbow")
    statuses = [
        loop.tick({"left_elbow": home[elbow] - 0.8}, measured=home).status
        for _ in range(100)
    ]
    assert statuses[0] == "blending" and statuses[-1] == "braking"
    moved = abs(loop.motion.q[elbow] - home[elbow])
    # Off by as much as is allowed, and what it takes to brake from 3 rad/s.
    assert 0.2 < moved < 0.2 + 3.0 * 0.1 and loop.motion.at_rest


def test_a_person_who_is_heard_of_makes_it_slow(loop):
    """One who runs at the robot; who is lost grows; who is gone lets it go on.

    Where the left hand is, and how fast, is by Drake.
    """
    model = loop.motion.model
    context = model.plant.CreateDefaultContext()
    hand = model.plant.GetBodyByName("left_hand")
    home, elbow = loop.motion.q.copy(), loop.names.index("left_elbow")

    def fast(command):
        model.plant.SetPositions(context, command.positions)
        model.plant.SetVelocities(context, command.velocities)
        return np.linalg.norm(hand.EvalSpatialVelocityInWorld(context).translational())

    def swing(count, told=None):
        speeds = []
        for k in range(count):
            if told is not None:
                loop.tell(person=told(k))
            aim = home[elbow] - 0.4 * np.sin(loop.now * 5.0)
            command = loop.tick({"left_elbow": aim})
            speeds.append(fast(command))
        return np.array(speeds), command

    begin, _ = swing(100)
    assert begin.max() > 0.3
    place = hand.EvalPoseInWorld(context).translation()

    def person(k):
        far = max(1.5 - 0.01 * 1.5 * k, 0.2)
        position = (place + [far, 0.0, 0.0]).tolist()
        return {"position": position, "radius": 0.1, "speed": 1.6}

    near, command = swing(140, person)
    # As near as that, and with a bound of 0.05 m/s on all of the surface.
    assert near[-20:].max() <= 0.05
    assert command.why.startswith("obstacle: person - ")
    assert loop.server.statistics.messages["obstacles"] == 140
    lost, command = swing(100)  # nobody says where the person is
    assert lost.max() <= 0.05 and command.why.startswith("obstacle: person - ")
    loop.tell(person=None)
    gone, command = swing(150)
    assert gone[50:].max() > 0.3 and command.why is None


def test_obstacles_grow_until_they_are_taken_away():
    told = Heard((1.0, 2.0, 3.0), 0.3, 1.6)
    heard = HeardObstacles()
    assert len(heard.at(5.0)) == 0
    heard.hear(ObstacleMessage({"person": told}), 10.0)
    heard.hear(ObstacleMessage({"cart": told, "nobody": None}), 11.0)
    found = heard.at(12.0)
    assert found.names == ("person", "cart")
    np.testing.assert_allclose(found.radii, [0.3 + 2 * 1.6, 0.3 + 1.6])
    np.testing.assert_array_equal(found.centres, [[1.0, 2.0, 3.0]] * 2)
    many = {str(k): told for k in range(MOST)}
    with pytest.raises(MessageError, match="more than"):
        heard.hear(ObstacleMessage(many), 12.0)
    assert len(heard) == MOST and "98, 99" in heard.reason_to_brake
    heard.hear(ObstacleMessage({"person": None, "cart": None}), 12.0)
    assert heard.reason_to_brake is not None, "it is not known where they are"
    heard.hear(ObstacleMessage(many), 12.0)
    assert len(heard.at(12.0)) == MOST and heard.reason_to_brake is None


def test_what_cannot_be_begun(made):
    with pytest.raises(ScenarioError, match="apart there, and the floor is"):
        made.begin(
            {"left_shoulder_pitch": 0.0, "left_elbow": -2.0, "left_shoulder_yaw": -1.2}
        )
    with pytest.raises(ScenarioError, match="beyond its limits"):
        made.begin({"left_elbow": 3.0})
    with pytest.raises(ScenarioError, match="joints are all targets"):
        make_server(joints=True, experiment="wrists")


def test_a_scenario_says_whether_obstacles_are_evaded(tmp_path):
    """Somebody who comes moves a robot that nobody has told to move."""
    path = tmp_path / "scenario.yaml"
    moved = {}
    for evade in ("false", "true"):
        path.write_text(
            "robot: upper_body\nmotion: dance\nexperiment: wrists\n"
            f"controller: {{evade: {evade}}}\n"
        )
        server = make_server(str(path), joints=True, rate=100.0)
        motion = server.motion
        start = motion.q.copy()
        for k in range(60):
            at = [[1.0 - 0.01 * k, 0.2, 1.1]]
            motion.move(motion.where(), Obstacles(at, 0.1, 1.0, ["Ann"]))
        moved[evade] = np.abs(motion.q - start).max()
        server.close()
    assert moved["false"] == 0.0 and moved["true"] > 0.01
