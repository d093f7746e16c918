"""The parts in a user's own Drake diagram, as the guide of diagrams promises.

What they say is compared with a judge that reads the robot's own file.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import product
import pytest
from attacks import judge_of
from pydrake.geometry import Capsule, ProximityProperties
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Adder, ConstantVectorSource, MatrixGain
from tracking import Robot

STEP, PERIOD = 1e-3, 5e-3  # of plants and of controllers, unless told otherwise [s]
LEFT, RIGHT = product.points_of("wrists")
NECK = product.points_of("seven")[-1]
WRISTS = [("position", LEFT), ("position", RIGHT)]
ALL_KINDS = [
    ("pose", LEFT),
    ("orientation", RIGHT),
    ("position", NECK),
    ("joint", product.JOINT),
]
ROUNDING = 1e-9


class Given(LeafSystem):
    """A function of time as a source."""

    def __init__(self, size: int, function: Callable[[float], np.ndarray]) -> None:
        super().__init__()
        self._function = function
        self.DeclareVectorOutputPort("y", size, self._calc, {self.time_ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.ravel(self._function(context.get_time())))


@dataclass
class Seen:
    """What was to be seen once a control period, before the plant's step."""

    time: list[float] = field(default_factory=list)
    state: list[np.ndarray] = field(default_factory=list)
    told: list[dict[str, np.ndarray]] = field(default_factory=list)
    ports: list[dict[str, np.ndarray]] = field(default_factory=list)

    def q(self, wired: product.Wired) -> np.ndarray:
        return np.array(self.state)[:, : wired.plant.num_positions()]

    def of(self, name: str) -> np.ndarray:
        """What is told by this name, a row a period."""
        return np.array([each[name] for each in self.told])


class Running:
    """A diagram with a controller whose targets are a function of time."""

    def __init__(
        self,
        wired: product.Wired,
        targets: Callable[[float], np.ndarray],
        **more: Callable[[float], np.ndarray] | np.ndarray,
    ) -> None:
        """
        Args:
            targets: as the port takes them.
            more: input port to what it is given.
        """
        self.wired, builder = wired, wired.builder
        given = {"targets": targets, **more}
        if self.input("prescribed") is not None:
            _, still = wired.ports()[product.INPUTS["prescribed"]]
            given.setdefault("prescribed", lambda t: still)
        for name, value in given.items():
            port = self.input(name)
            source = Given(port.size(), value)
            builder.Connect(builder.AddSystem(source).get_output_port(), port)
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)

    def input(self, name: str) -> Any:
        return input_of(self.wired, name)

    @property
    def root(self) -> Context:
        return self.simulator.get_mutable_context()

    def state(self, root: Context | None = None) -> np.ndarray:
        """[q; v] of the plant."""
        plant = self.wired.plant
        return plant.GetPositionsAndVelocities(
            plant.GetMyContextFromRoot(root or self.root)
        )

    def port(self, name: str) -> np.ndarray:
        """What an output of the controller has now, or once it has been updated."""
        controller = self.wired.controller
        context = controller.GetMyContextFromRoot(self.root)
        if name in product.HELD:
            return controller.diagnostics(context)[product.HELD[name]].copy()
        return controller.GetOutputPort(product.OUTPUTS[name]).Eval(context).copy()

    def watch(self, until: float, period: float = PERIOD) -> Seen:
        """Simulates, and looks once a period, once the controller has answered."""
        seen = Seen()
        for k in range(round(self.root.get_time() / period), round(until / period)):
            self.simulator.AdvanceTo(k * period)
            if not k:
                self.simulator.Initialize()
            seen.time.append(k * period)
            seen.state.append(self.state())
            seen.told.append(product.told(self.wired, self.root))
            seen.ports.append({name: self.port(name) for name in product.OUTPUTS})
        return seen


def input_of(wired: product.Wired, name: str) -> Any:
    """An input port of the controller, or None."""
    controller, port = wired.controller, product.INPUTS[name]
    return controller.GetInputPort(port) if controller.HasInputPort(port) else None


def ready(robot: str = product.BUILT_IN, tasks=None, **given) -> product.Wired:
    """A robot in a plant with its controller."""
    wired = product.put_in_plant(robot, given.pop("time_step", STEP))
    wired.plant.Finalize()
    product.add_controller(wired, tasks or WRISTS, **{"period": PERIOD} | given)
    return wired


def swings(wired: product.Wired) -> Callable[[float], np.ndarray]:
    """Positions of both wrists that swing about where they are at rest."""
    home = Robot(product.BUILT_IN, [LEFT, RIGHT]).law.home
    size, omega = np.array([0.1, 0.05, 0.12]), 6.0

    def at(t: float) -> np.ndarray:
        # From a standstill: 1 - cos.
        x = size * (1.0 - np.cos(omega * t))
        v, a = size * omega * np.sin(omega * t), size * omega**2 * np.cos(omega * t)
        return np.concatenate([(home + x).ravel(), *[np.tile(d, 2) for d in (v, a)]])

    return at


def stay(points: np.ndarray) -> np.ndarray:
    """Targets of positions (2, 3) at rest."""
    return np.r_[points.ravel(), np.zeros(12)]


# --- the robot, the ports -------------------------------------------------------------


def test_a_robot_stands_in_a_plant_at_rest():
    """The base is welded; what is said of it names what is in the plant, where other
    things may be, too."""
    wired = product.put_in_plant(product.BUILT_IN)
    plant, judge = wired.plant, judge_of(product.BUILT_IN)
    box = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    plant.AddRigidBody("box", plant.AddModelInstance("box"), box)
    plant.Finalize()
    assert plant.num_positions() == len(judge.joints) + 7
    said, context = product.says(wired), plant.CreateDefaultContext()
    for name in judge.joints:
        joint = plant.GetJointByName(name)
        at = plant.GetPositions(context)[joint.position_start()]
        assert at == pytest.approx(said["rest"].get(name, 0.0))
    for frame in said["points"].values():
        assert plant.HasFrameNamed(frame)
    assert product.JOINT in judge.joints and set(said["prescribed"]) < set(judge.joints)
    assert len(said["pairs"]) == len(judge.pairs) == 30
    for pair in said["pairs"]:
        assert all(plant.HasBodyNamed(link) for link in pair)


@pytest.mark.parametrize(
    "robot, tasks, size",
    [
        (product.BUILT_IN, WRISTS, 18),
        (product.BUILT_IN, ALL_KINDS, 19 + 10 + 9 + 3),
        (product.ARM, [("pose", "tool")], 19),
    ],
    ids=["wrists", "all kinds", "arm"],
)
def test_ports_have_the_sizes_of_the_guide(robot, tasks, size):
    wired = ready(robot, tasks)
    judge = judge_of(robot)
    n, n_p = len(judge.joints), len(product.facts(robot).prescribed)
    sizes = {"state": 2 * n, "targets": size, "posture": n - n_p}
    if n_p:
        sizes["prescribed"] = 3 * n_p
    for name in product.INPUTS:
        port = input_of(wired, name)
        assert (port and port.size()) == sizes.get(name), name
    m = {"pose": 6, "orientation": 3, "position": 3, "joint": 1}
    parts = {
        "errors": sum(m[kind] for kind, _ in tasks),
        "distances": len(judge.pairs),
        "status": 1,
        "admission": 4,
        "torque limit": 2,
        "weights": n - n_p,
    }
    outputs = {"torques": len(np.flatnonzero(judge.efforts)), "accelerations": n}
    outputs["command"] = 2 * n
    for name, many in outputs.items():
        port = wired.controller.GetOutputPort(product.OUTPUTS[name])
        assert port.size() == many, name
    running = Running(wired, lambda t: wired.ports()[product.TARGETS][1])
    running.simulator.Initialize()
    every, told = running.port("told"), product.told(wired, running.root)
    for name, many in parts.items():
        assert told[name].shape == (many,)
        part = every[product.place_told(wired, name)]
        np.testing.assert_array_equal(part, told[name])


def test_targets_of_every_kind_have_the_order_of_the_guide():
    """Where the robot is, they are its own points; errors are rotation vectors nearly,
    then metres, towards the target."""
    wired = ready(tasks=ALL_KINDS)
    robot = Robot(product.BUILT_IN, [LEFT, RIGHT, NECK])
    places = robot.points(robot.rest[None])[0]
    poses = robot.judge.poses(robot.rest[None])
    links = product.point_links(product.BUILT_IN)
    hands = [
        robot.judge.plant.GetBodyByName(links[point]) for _, point in ALL_KINDS[:2]
    ]
    R = [poses[int(hand.index())][0][0] for hand in hands]
    elbow = robot.rest[robot.judge.at([product.JOINT])]
    mine = product.packed(wired, R, places[[0, 2]], q=elbow)
    _, here = wired.ports()[product.TARGETS]
    np.testing.assert_allclose(mine, here, atol=1e-12)
    quaternion = RotationMatrix(R[0]).ToQuaternion().wxyz()
    assert abs(here[:4] @ quaternion) == pytest.approx(1.0)
    np.testing.assert_allclose(here[4:7], places[0], atol=1e-12)
    np.testing.assert_allclose(here[11:15], [*places[2], *elbow], atol=1e-12)
    assert not here[15:].any()

    turn = RotationMatrix.MakeZRotation(0.1).matrix()
    there = product.packed(
        wired,
        [turn @ R[0], R[1]],
        places[[0, 2]] + [[0.02, 0, 0], [0, 0, 0.03]],
        q=elbow + 0.04,
    )
    running = Running(wired, lambda t: there)
    running.simulator.Initialize()
    errors = product.told(wired, running.root)["errors"]
    wanted = [0, 0, np.sin(0.1), 0.02, 0, 0, 0, 0, 0, 0, 0, 0.03, 0.04]
    np.testing.assert_allclose(errors, wanted, atol=1e-9)


# --- what it does and tells -----------------------------------------------------------


def test_what_it_tells_is_true():
    """Of two wrists that swing: errors, distances, the braking path, torques, the state
    that a command leads to."""
    wired = ready()
    targets, robot = swings(wired), Robot(product.BUILT_IN, [LEFT, RIGHT])
    seen = Running(wired, targets).watch(1.2)
    judge, q = judge_of(product.BUILT_IN, time_step=STEP), seen.q(wired)
    x = np.array([targets(t)[:6] for t in seen.time]).reshape(-1, 2, 3)
    errors = seen.of("errors").reshape(-1, 2, 3)
    np.testing.assert_allclose(errors, x - robot.points(q), atol=ROUNDING)
    assert np.abs(errors[-1]).max() < 0.01 < np.ptp(robot.points(q), axis=0).max()
    distances = judge.distances(q)
    # SceneGraph searches, and stops a little early.
    beyond = seen.of("distances") - distances
    assert beyond.min() >= -ROUNDING and beyond.max() <= product.MEASURED_WITHIN
    # The step is proved for what comes next.
    bound = seen.of("bound of distances")[:-1]
    assert (bound <= distances[1:].min(axis=1) + ROUNDING).all()
    assert (bound >= product.SAFETY_DISTANCE - ROUNDING).all()
    assert (seen.of("path is clear") == 1.0).all()
    blends = np.array(seen.time) < product.BLEND - 1e-9
    np.testing.assert_array_equal(
        seen.of("status")[:, 0], np.where(blends, product.BLENDS, product.TRACKS)
    )
    command = np.array([each["command"] for each in seen.ports])
    np.testing.assert_allclose(np.array(seen.state)[1:], command[:-1], atol=1e-7)
    a = np.array([each["accelerations"] for each in seen.ports])
    tau = np.array([each["torques"] for each in seen.ports])
    v = np.array(seen.state)[:, len(robot.rest) :]
    np.testing.assert_allclose(tau, judge.torques(q, v, a), atol=1e-6)


def test_accelerations_are_held_for_a_period_and_torques_follow():
    wired = ready()
    running = Running(wired, swings(wired))
    held = []
    for k in range(100):
        running.simulator.AdvanceTo(k * STEP)
        held.append((running.port("accelerations"), running.port("torques")))
    changed = [
        [bool(np.any(now[i] != before[i])) for i in (0, 1)]
        for before, now in zip(held, held[1:], strict=False)
    ]
    a, tau = np.array(changed).T
    assert set(np.flatnonzero(a) + 1) == set(range(5, 100, 5))
    assert tau[5:].all()  # it stands still at first


@pytest.mark.parametrize("time_step", [0.0, STEP, PERIOD])
def test_the_simulated_robot_arrives(time_step):
    """By any plant's step, without a violation on the way."""
    wired = ready(time_step=time_step)
    robot = Robot(product.BUILT_IN, [LEFT, RIGHT])
    there = robot.law.home + [[0.2, 0.05, 0.3], [0.15, 0.1, 0.15]]
    running = Running(wired, lambda t: stay(there))
    seen = running.watch(2.0)
    q, judge = seen.q(wired), robot.judge
    assert np.linalg.norm(robot.points(q[-1:])[0] - there, axis=1).max() < 1e-3
    assert judge.distances(q).min() >= product.SAFETY_DISTANCE
    moved = robot.law.controlled
    assert (q >= judge.lower)[:, moved].all() and (q <= judge.upper)[:, moved].all()
    assert np.abs(seen.of("torque beyond limits")).max() < ROUNDING


def test_a_robot_whose_targets_are_lost_brakes_and_goes_on():
    wired = ready()
    targets, lost = swings(wired), (0.7, 1.1)

    def at(t: float) -> np.ndarray:
        found = targets(t)
        if lost[0] - 1e-9 < t < lost[1] - 1e-9:
            found[7] = np.nan  # one entry is enough
        return found

    seen = Running(wired, at).watch(2.4)
    time, status = np.array(seen.time), seen.of("status")[:, 0]
    v = np.abs(np.array(seen.state)[:, wired.plant.num_positions() :]).max(axis=1)
    gone = (time > lost[0] - 1e-9) & (time < lost[1] - 1e-9)
    back = (time > lost[1] - 1e-9) & (time < lost[1] + product.BLEND - 1e-9)
    assert (status[gone] == product.BRAKES).all()
    assert (status[back] == product.BLENDS).all()
    assert (status[time > lost[1] + product.BLEND] == product.TRACKS).all()
    assert v[time < lost[0]].max() > 0.5 and v[gone][-1] < 1e-2
    assert np.isfinite(seen.state).all()
    # Blended in: without more of a jump than there was at the beginning.
    a = np.array([each["accelerations"] for each in seen.ports])
    jumps = np.abs(np.diff(a, axis=0)).max(axis=1)
    assert jumps[back[1:]][0] < 5.0 + jumps[: round(product.BLEND / PERIOD)].max()
    assert np.abs(seen.of("errors")[-1]).max() < 0.01


def test_a_posture_draws_what_the_tasks_leave_free():
    """One hand of two arms: the other one, and the elbow, come nearer to it."""
    ends = {}
    for given in (False, True):
        wired = ready(tasks=WRISTS[:1])
        robot = Robot(product.BUILT_IN, [LEFT])
        moved = robot.law.controlled
        posture = robot.rest[moved].copy()
        posture[-1] -= 0.5
        more = {"posture": lambda t, q=posture: q} if given else {}
        _, here = wired.ports()[product.TARGETS]
        running = Running(wired, lambda t, x=here: x, **more)
        running.simulator.AdvanceTo(1.5)
        q = running.state()[: len(robot.rest)]
        assert np.abs(robot.points(q[None])[0] - robot.law.home).max() < 1e-3
        ends[given] = abs(q[moved[-1]] - posture[-1])
    assert ends[True] < 0.05 < 0.4 < ends[False]


def test_what_stands_beside_it_is_kept_off():
    """A post that is a link of the plant, in the hand's way; by Drake's distances."""
    wired = product.put_in_plant(product.BUILT_IN)
    plant = wired.plant
    robot = Robot(product.BUILT_IN, [LEFT, RIGHT])
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.04)
    post = plant.AddRigidBody("post", plant.AddModelInstance("post"), inertia)
    shape = plant.RegisterCollisionGeometry(
        post, RigidTransform(), Capsule(0.04, 0.4), "post", ProximityProperties()
    )
    place = robot.law.home[0] + [0.15, 0.0, 0.0]
    plant.WeldFrames(plant.world_frame(), post.body_frame(), RigidTransform(place))
    plant.Finalize()
    links = {link for pair in robot.judge.pairs for link in pair}
    product.watch(wired, [(link, "post") for link in sorted(links)])
    product.add_controller(wired, WRISTS, period=PERIOD)
    there = robot.law.home + [[0.3, 0.0, 0.0], [0.0, 0.0, 0.0]]
    running = Running(wired, lambda t: stay(there))
    hand = plant.GetCollisionGeometriesForBody(plant.GetBodyByName(product.LINK))[0]
    query, nearest = wired.scene_graph.get_query_output_port(), np.inf
    for k in range(1, 150):
        running.simulator.AdvanceTo(0.01 * k)
        asked = query.Eval(wired.scene_graph.GetMyContextFromRoot(running.root))
        far = asked.ComputeSignedDistancePairClosestPoints(hand, shape).distance
        nearest = min(nearest, far)
    assert product.SAFETY_DISTANCE - ROUNDING < nearest < 0.02


def test_targets_may_come_from_the_command():
    """Ports that hold are fed by no input; after an update they are what is told."""
    wired = ready(robot=product.ARM, tasks=[("joint", "joint1")])
    controller, n = wired.controller, len(wired.posture)
    pick = np.zeros((3, 2 * n))
    pick[0, 0] = pick[1, n] = 1.0  # go on as it was told to be
    gain, ahead = MatrixGain(pick), Given(3, lambda t: np.array([0.002, 0.0, 0.0]))
    adder = Adder(2, 3)
    for system in (gain, ahead, adder):
        wired.builder.AddSystem(system)
    connect, port = wired.builder.Connect, controller.GetOutputPort
    connect(port(product.OUTPUTS["command"]), gain.get_input_port())
    connect(gain.get_output_port(), adder.get_input_port(0))
    connect(ahead.get_output_port(), adder.get_input_port(1))
    connect(adder.get_output_port(), input_of(wired, "targets"))
    simulator = Simulator(wired.builder.Build())
    context = controller.GetMyContextFromRoot(simulator.get_context())
    for name in product.HELD:
        held = controller.GetOutputPort(product.OUTPUTS[name])
        assert not any(
            controller.HasDirectFeedthrough(i, held.get_index())
            for i in range(controller.num_input_ports())
        )
    simulator.AdvanceTo(1.0 + 0.5 * STEP)
    for name, told in product.HELD.items():
        held = controller.GetOutputPort(product.OUTPUTS[name]).Eval(context)
        np.testing.assert_array_equal(held, controller.diagnostics(context)[told])
    held = controller.GetOutputPort(product.OUTPUTS["command"]).Eval(context)
    assert held[0] > wired.posture[0] + 0.01


# --- contexts, other ways to the same law ---------------------------------------------


def test_contexts_have_all_of_the_state():
    """A clone goes on as the original does, which is left alone; so does a second
    simulator of the same diagram."""
    wired = ready()
    running = Running(wired, swings(wired))
    running.simulator.AdvanceTo(0.3037)
    before = running.state()
    clone = Simulator(running.diagram, running.root.Clone())
    clone.AdvanceTo(0.8)
    np.testing.assert_array_equal(running.state(), before)
    second = Simulator(running.diagram)
    second.AdvanceTo(0.2)
    running.simulator.AdvanceTo(0.8)
    second.AdvanceTo(0.8)
    there = running.state()
    assert np.abs(there - before).max() > 0.01
    np.testing.assert_array_equal(running.state(clone.get_context()), there)
    np.testing.assert_array_equal(running.state(second.get_context()), there)


def test_a_robot_by_its_own_file_is_driven_alike():
    """Beside a box that falls."""
    there = []
    for own in (False, True):
        if own:
            wired = product.robot_by_its_own_file(finalized=False)
            box = wired.plant.AddModelInstance("box")
            inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
            wired.plant.AddRigidBody("box", box, inertia)
            wired.plant.Finalize()
            product.rest_in_plant(wired)
            product.add_controller(wired, WRISTS, period=PERIOD, own_file=True)
        else:
            wired = ready()
        running = Running(wired, swings(wired))
        running.simulator.AdvanceTo(0.5)
        q = running.state()[: wired.plant.num_positions()]
        there.append(wired.plant.GetPositionsFromArray(wired.robot, q) if own else q)
    np.testing.assert_allclose(*there, atol=1e-8)


def test_the_law_without_a_diagram_answers_the_same():
    wired = ready()
    _, here = wired.ports()[product.TARGETS]
    _, still = wired.ports()[product.INPUTS["prescribed"]]
    targets = here + np.r_[0.03 * np.arange(6.0), np.linspace(-0.1, 0.2, 12)]
    running = Running(wired, lambda t: targets)
    plant, rng = wired.plant, np.random.default_rng(3)
    for _ in range(5):
        q = wired.posture + rng.normal(0.0, 0.02, plant.num_positions())
        v = rng.normal(0.0, 0.2, plant.num_velocities())
        context = running.diagram.CreateDefaultContext()
        plant.SetPositionsAndVelocities(plant.GetMyContextFromRoot(context), [*q, *v])
        running.simulator.reset_context(context)
        running.simulator.Initialize()
        answer = product.without_diagram(wired, q, v, targets, still)
        for name, value in answer.items():
            np.testing.assert_allclose(running.port(name), value, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("inside", [False, True])
def test_a_start_is_near_the_first_targets_and_clear(inside):
    wired = ready()
    robot = Robot(product.BUILT_IN, [LEFT, RIGHT])
    there = robot.law.home + [[0.2, 0.05, 0.3], [0.15, 0.1, 0.15]]
    if inside:  # the middle of the body
        there[:] = there.mean(axis=0) * [0.0, 1.0, 1.0]
    q = product.start_near(wired, stay(there))
    assert robot.judge.distances(q[None]).min() > 2.0 * product.SAFETY_DISTANCE
    assert (q >= robot.judge.lower).all() and (q <= robot.judge.upper).all()
    off = np.linalg.norm(robot.points(q[None])[0] - there, axis=1)
    home = np.linalg.norm(robot.law.home - there, axis=1)
    assert (off < home).all() if inside else off.max() < 1e-2


def test_spheres_in_a_port_are_kept_off():
    """A port that is there if their speeds are given, in a plant of the same period;
    the hand that is sent into one stops before it."""
    robot = Robot(product.BUILT_IN, [LEFT, RIGHT])
    ball = np.r_[robot.law.home[0] + [0.2, 0.0, 0.1], 0.05]
    gone = {}
    for with_ball in (False, True):
        wired = ready(time_step=PERIOD, sphere_speeds=[0.1])
        assert input_of(wired, "spheres").size() == 4
        there = robot.law.home + [[0.2, 0.0, 0.1], [0.0, 0.0, 0.0]]
        more = {"spheres": lambda t: ball} if with_ball else {}
        running = Running(wired, lambda t, x=there: stay(x), **more)
        q = running.watch(1.5).q(wired)
        far, _ = robot.judge.to_spheres(q, np.tile(ball[:3], (len(q), 1, 1)), ball[3:])
        gone[with_ball] = far.min()
    assert gone[True] > 0.0 > gone[False]


# --- the filter, a whole scenario -----------------------------------------------------


@pytest.mark.parametrize("wanted", ["positions", "velocities", "desired state"])
def test_the_filter_in_a_diagram_is_the_filter(wanted):
    """Its ports, and bit by bit what a loop of one's own gets."""
    period, count = 0.01, 60
    system = product.filter_system(product.BUILT_IN, period)
    alone = product.JointFilter(product.BUILT_IN, period)
    rest, n = alone.rest, len(alone.joints)
    sizes = dict.fromkeys(product.FILTER_INPUTS, n)
    sizes |= {"desired state": 2 * n, "measured state": 2 * n}
    del sizes["spheres"]
    assert system.num_input_ports() == len(sizes)
    for name, size in sizes.items():
        assert system.GetInputPort(product.FILTER_INPUTS[name]).size() == size
    outputs = {"command": 2 * n, "positions": n, "accelerations": n, "told": 7}
    for name, size in outputs.items():
        assert system.GetOutputPort(product.FILTER_OUTPUTS[name]).size() == size
    assert not system.HasAnyDirectFeedthrough()

    swing, omega = np.linspace(1.5, -1.5, n), 5.0

    def at(t: float) -> dict[str, np.ndarray]:
        q, v = rest + swing * np.sin(omega * t), swing * omega * np.cos(omega * t)
        whole = {"positions": q, "velocities": v, "desired state": np.r_[q, v]}
        return {wanted: whole[wanted]}

    builder = DiagramBuilder()
    builder.AddSystem(system)
    source = builder.AddSystem(Given(len(at(0.0)[wanted]), lambda t: at(t)[wanted]))
    builder.Connect(
        source.get_output_port(), system.GetInputPort(product.FILTER_INPUTS[wanted])
    )
    simulator = Simulator(builder.Build())
    context = system.GetMyContextFromRoot(simulator.get_context())

    def port(name: str) -> np.ndarray:
        return system.GetOutputPort(product.FILTER_OUTPUTS[name]).Eval(context)

    np.testing.assert_array_equal(port("command"), np.r_[rest, 0.0 * rest])
    held_back = 0
    for k in range(count):
        given = at(k * period)[wanted]
        if wanted == "desired state":
            found = alone.step(given[:n], given[n:])
        else:
            found = alone.step(**{"q" if wanted == "positions" else "v": given})
        # Half a period on: it holds.
        simulator.AdvanceTo((k + 0.5) * period)
        np.testing.assert_array_equal(port("command"), np.r_[found.q, found.v])
        np.testing.assert_array_equal(port("positions"), found.q)
        np.testing.assert_array_equal(port("accelerations"), found.a)
        told = product.filter_told(system, context)
        assert told == (found.passed, found.why, found.clearance)
        held_back += not found.passed
    assert 0 < held_back


def test_the_filter_begins_where_the_robot_is_and_heeds_spheres():
    robot = Robot(product.ARM, ["tool"])
    system = product.filter_system(product.ARM, 0.01, [0.0])
    n = len(robot.rest)
    start = robot.rest + 0.1
    ball = np.r_[robot.points(start[None])[0, 0] - [0.0, 0.0, 0.25], 0.05]
    builder = DiagramBuilder()
    builder.AddSystem(system)
    down = np.zeros(n)
    down[1] = 0.8  # the shoulder
    for name, value in (
        ("velocities", down),
        ("measured state", np.r_[start, np.zeros(n)]),
        ("spheres", ball),
    ):
        source = builder.AddSystem(ConstantVectorSource(value))
        port = system.GetInputPort(product.FILTER_INPUTS[name])
        builder.Connect(source.get_output_port(), port)
    simulator = Simulator(builder.Build())
    context = system.GetMyContextFromRoot(simulator.get_context())
    q = []
    for k in range(150):
        simulator.AdvanceTo(0.01 * k + 0.005)
        port = system.GetOutputPort(product.FILTER_OUTPUTS["positions"])
        q.append(port.Eval(context).copy())
    assert np.abs(q[0] - start).max() < 0.01
    far, _ = robot.judge.to_spheres(
        np.array(q), np.tile(ball[:3], (len(q), 1, 1)), ball[3:]
    )
    assert 0.0 < far.min() < 0.05
    assert product.filter_told(system, context)[1] == product.SPHERE


def test_a_scenario_is_a_diagram_that_does_as_its_run(tmp_path):
    """Bit by bit; nothing is drawn or written, and nothing is left to connect."""
    path = tmp_path / "short.yaml"
    path.write_text(
        product.scenario(
            robot=product.BUILT_IN, motion=product.MOTION, tasks=product.TASKS
        )
    )
    diagram = product.diagram_of(path)
    assert diagram.num_input_ports() == 0
    for name in product.DIAGRAM_OUTPUTS.values():
        assert diagram.HasOutputPort(name)
    for name in product.OUTPUTS.values():
        assert diagram.HasOutputPort(name)
    part = {
        what: diagram.GetSubsystemByName(name)
        for what, name in product.DIAGRAM_PARTS.items()
    }
    simulator = Simulator(diagram)
    root = simulator.get_context()
    start = diagram.GetOutputPort(product.DIAGRAM_OUTPUTS["state"]).Eval(root).copy()
    simulator.AdvanceTo(0.3)
    out = tmp_path / "run"
    done = product.command("simulate", path, duration=0.3, out=out, no_page=True)
    assert done.code == product.FINE, done.err
    log = product.read_log(out / product.RUN_FILES["log"])
    states = part["log of states"].FindLog(root).data().T
    np.testing.assert_array_equal(states[0], start)
    np.testing.assert_array_equal(states, np.column_stack([log.q, log.v]))
    assert not (out / product.RUN_FILES["page"]).exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run", "short.yaml"]
    # It starts near the first targets, and clear.
    robot = Robot(product.BUILT_IN, [LEFT, RIGHT])
    errors = [np.linalg.norm(error[0]) for error in log.errors.values()]
    assert max(errors) < 0.05
    assert robot.judge.distances(log.q[:1]).min() > product.SAFETY_DISTANCE
