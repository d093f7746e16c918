"""The standing law: Newton and Euler, cones, limits; what the ground cannot give."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from exact_loop import follow
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import MultibodyForces
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from standing_robots import BELOW, CORNERS, HEIGHT, standing_robot

from crar_drake.errors import ModelError
from crar_drake.law.controller import CrarController
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.law.standing_controller import StandingController
from crar_drake.law.standing_law import SOLE_MARGIN, StandingLaw, StandingStep
from crar_drake.robot.description import add_robot
from crar_drake.robot.model import ControlModel
from crar_drake.robot.standing import standing_description
from crar_drake.robot.task import Task

FRICTION = 0.7
PERIOD = 0.005  # [s]
SEEDS = range(4)


def make_law(folder, **options) -> StandingLaw:
    description = standing_robot(folder, **options).without_ground()
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    add_robot(plant, description)
    plant.Finalize()
    return StandingLaw(plant, description, FRICTION)


@pytest.fixture(scope="module")
def law(tmp_path_factory) -> StandingLaw:
    return make_law(tmp_path_factory.mktemp("robot"))


def step(law: StandingLaw, seed: int, size: float = 1.0):
    """What the law answers near where it stands, and the state."""
    random = np.random.default_rng(seed)
    n, nv = len(law.joint_names), law.plant.num_velocities()
    q, v = law.rest.copy(), size * 0.05 * random.normal(size=nv)
    q[7:] += size * 0.03 * random.normal(size=n)
    q[4:7] += size * 0.01 * random.normal(size=3)
    accelerations = np.zeros(n)
    accelerations[-2:] = size * 5.0 * random.normal(size=2)
    command = law.rest[7:], np.zeros(n), accelerations
    contexts = [law.plant.CreateDefaultContext() for _ in range(2)]
    state = np.concatenate((q, v))
    return law.step(*contexts, state, command), state, contexts[0]


def inverse_dynamics(law: StandingLaw, context, answer: StandingStep) -> np.ndarray:
    """(nv,) Drake's, with the answer's forces applied to the feet."""
    plant = law.plant
    forces, of_corners = MultibodyForces(plant), iter(answer.forces)
    plant.CalcForceElementsContribution(context, forces)
    for foot in ("left_foot", "right_foot"):
        body = plant.GetBodyByName(foot)
        for corner in np.array(CORNERS):
            # The soles are rectangles: drawn in, each side comes nearer by as much.
            middle = np.mean(CORNERS, axis=0)
            used = corner - SOLE_MARGIN * np.sign(corner - middle)
            R_WB = plant.EvalBodyPoseInWorld(context, body).rotation()
            body.AddInForce(
                context,
                R_WB @ np.array([*used, -BELOW]),  # in W
                SpatialForce(np.zeros(3), next(of_corners)),
                plant.world_frame(),
                forces,
            )
    return plant.CalcInverseDynamics(context, answer.acceleration, forces)


@pytest.mark.parametrize("seed", SEEDS)
def test_forces_and_efforts_make_the_acceleration(law, seed) -> None:
    """The root needs nothing else, and the joints just their efforts."""
    answer, _, context = step(law, seed)
    tau = inverse_dynamics(law, context, answer)
    np.testing.assert_allclose(tau[:6], 0.0, atol=1e-7)
    np.testing.assert_allclose(tau[6:], answer.efforts, atol=1e-7)
    assert answer.clipped == 0.0


@pytest.mark.parametrize("seed", SEEDS)
def test_forces_are_within_the_friction_cone(law, seed) -> None:
    answer, _, _ = step(law, seed, 2.0)
    up, along = answer.forces[:, 2], np.linalg.norm(answer.forces[:, :2], axis=1)
    assert (up >= 0.0).all() and up.sum() > 0.0
    assert (along <= FRICTION * up + 1e-9).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_the_soles_stay(law, seed) -> None:
    """Where they stand and rest, their planned acceleration is 0."""
    answer, state, context = step(law, seed)
    n, nv = len(law.joint_names), law.plant.num_velocities()
    at_rest = np.concatenate((law.rest, np.zeros(nv)))
    command = law.rest[7:], np.zeros(n), np.eye(n)[-1] * 4.0
    answer = law.step(context, law.plant.CreateDefaultContext(), at_rest, command)
    of_bodies = law.plant.CalcSpatialAccelerationsFromVdot(context, answer.acceleration)
    for foot in ("left_foot", "right_foot"):
        of_foot = of_bodies[int(law.plant.GetBodyByName(foot).index())]
        np.testing.assert_allclose(of_foot.get_coeffs(), 0.0, atol=1e-8)
    assert abs(answer.acceleration[-1] - 4.0) < 1e-9


def test_at_rest_the_ground_carries_the_weight(law) -> None:
    answer, _, context = step(law, 0, 0.0)
    weight = 9.81 * law.plant.CalcTotalMass(context)
    np.testing.assert_allclose(
        answer.forces.sum(axis=0), [0.0, 0.0, weight], atol=1e-3 * weight
    )
    assert np.abs(answer.acceleration).max() < 0.02


def test_what_is_pushed_is_brought_back(law) -> None:
    """A root that moves ahead and leans is accelerated backwards and upright."""
    _, state, context = step(law, 0, 0.0)
    n, nq = len(law.joint_names), law.plant.num_positions()
    state[nq + 3] = 0.05  # [m/s]
    state[nq + 1] = 0.05  # [rad/s] about y
    command = law.rest[7:], np.zeros(n), np.zeros(n)
    answer = law.step(context, law.plant.CreateDefaultContext(), state, command)
    assert answer.forces.sum(axis=0)[0] < -1.0  # [N]
    assert answer.acceleration[1] < 0.0


def test_weak_motors_get_no_more_than_they_give(tmp_path) -> None:
    """With 4 Nm the knees cannot carry the robot as it stands, bent."""
    law = make_law(tmp_path, effort=4.0)
    answer, _, _ = step(law, 0, 0.0)
    legs = answer.efforts[:12]
    assert np.abs(legs).max() <= 4.0
    # The ground gives less than the weight: the robot sinks, as planned.
    assert answer.acceleration[5] < -0.1


def test_legs_that_cannot_hold_the_root_get_finite_torques(law) -> None:
    """Between postures whose legs hold it from either side there is one in which none
    does: accelerations of the root follow from no forces."""
    contexts = [law.plant.CreateDefaultContext() for _ in range(2)]
    n, nv = len(law.joint_names), law.plant.num_velocities()
    ends = [0.8 * np.random.default_rng(seed).normal(size=12) for seed in (0, 3)]
    command, limp = (law.rest[7:], np.zeros(n), np.zeros(n)), 0
    for share in np.linspace(0.835, 0.838, 400):
        q = law.rest.copy()
        q[7:19] += (1.0 - share) * ends[0] + share * ends[1]
        answer = law.step(*contexts, np.concatenate((q, np.zeros(nv))), command)
        assert np.isfinite(answer.efforts).all()
        limp += answer.fell
    assert limp < 40


def test_a_robot_that_lies_is_braked(law) -> None:
    contexts = [law.plant.CreateDefaultContext() for _ in range(2)]
    n, nv = len(law.joint_names), law.plant.num_velocities()
    for change in ({6: 0.3 * HEIGHT}, {0: np.cos(0.5), 2: np.sin(0.5)}):
        q = law.rest.copy()
        for place, value in change.items():
            q[place] = value
        v = np.arange(nv) / nv - 0.61
        zero = np.zeros(n)
        state = np.concatenate((q, v))
        answer = law.step(*contexts, state, (law.rest[7:], zero, zero))
        assert answer.fell and not answer.forces.any()
        assert (answer.efforts * v[6:] < 0.0).all()


@dataclass
class Commanded:
    """What a standing controller asks of the model of its command."""

    velocity_names: list[str]
    rest: np.ndarray

    def rest_positions(self) -> np.ndarray:
        return self.rest


def test_the_system_finds_joints_by_name(law) -> None:
    """A command in another order is the same command."""
    random = np.random.default_rng(0)
    n, nv = len(law.joint_names), law.plant.num_velocities()
    a = random.normal(size=n)
    state = np.concatenate((law.rest, 0.01 * random.normal(size=nv)))
    efforts = []
    for order in (np.arange(n), random.permutation(n)):
        names = [law.joint_names[i] for i in order]
        system = StandingController(law, Commanded(names, law.rest[7:][order]), PERIOD)
        context = system.CreateDefaultContext()
        system.get_input_port_estimated_state().FixValue(context, state)
        system.get_input_port_commanded_acceleration().FixValue(context, a[order])
        efforts.append(system.get_output_port_actuation().Eval(context.Clone()))
    np.testing.assert_allclose(efforts[0], efforts[1], atol=1e-9)
    names = [x for x in law.joint_names if x != "elbow"]
    with pytest.raises(ModelError, match="lacks elbow"):
        StandingController(law, Commanded(names, law.rest[7:-1]), PERIOD)


def test_the_command_does_exactly_as_told(law, tmp_path) -> None:
    """The controller on its own command: at a tick that is the state that the law
    itself predicted, and in between q + (t - e) q_dot + e s, e = t^2 / (2 T), s = q_dot
    + T q_ddot, of (1) with delta 0."""
    still = standing_description(standing_robot(tmp_path))
    tasks = [Task(frame="hand")]
    model = ControlModel.FromDescription(still, tasks, time_step=0.0)
    parameters = LookaheadParameters(period=PERIOD)
    rest, T = model.rest_positions(), parameters.T
    target = model.tasks_at(rest)
    target[:3] += [0.05, 0.02, 0.05]
    expected, _ = follow(model, parameters, np.tile(target, (30, 1)))
    builder = DiagramBuilder()
    controller = CrarController(model, parameters)
    system = StandingController(law, model, PERIOD)
    for each in (controller, system):
        builder.AddSystem(each)
    acceleration = controller.get_output_port_desired_acceleration()
    command = system.get_output_port_commanded_state()
    for value, port in (
        (target, controller.get_input_port_desired_tasks()),
        (model.prescribed_at(rest), controller.get_input_port_desired_prescribed()),
    ):
        source = builder.AddSystem(ConstantVectorSource(value))
        builder.Connect(source.get_output_port(), port)
    builder.Connect(command, controller.get_input_port_estimated_state())
    told = system.get_input_port_commanded_acceleration()
    builder.Connect(acceleration, told)
    at_rest = np.concatenate((law.rest, np.zeros(law.plant.num_velocities())))
    source = builder.AddSystem(ConstantVectorSource(at_rest))
    measured = system.get_input_port_estimated_state()
    builder.Connect(source.get_output_port(), measured)
    simulator = Simulator(builder.Build())
    root = simulator.get_context()
    of_command = system.GetMyContextFromRoot(root)
    of_law = controller.GetMyContextFromRoot(root)
    for k, at_tick in enumerate(expected):
        q, v = np.split(command.Eval(of_command).copy(), 2)
        t = 0.3 * PERIOD
        simulator.AdvanceTo(k * PERIOD + t)
        s, e = v + T * acceleration.Eval(of_law), t * t / (2.0 * T)
        between = [*(q + (t - e) * v + e * s), *(v + t * (s - v) / T)]
        np.testing.assert_allclose(command.Eval(of_command), between, atol=1e-13)
        simulator.AdvanceTo((k + 1) * PERIOD)
        np.testing.assert_allclose(command.Eval(of_command), at_tick, atol=1e-11)
    assert np.abs(expected[-1][len(q) :]).max() > 0.1  # it is under way


def test_a_root_that_is_welded_is_told(tmp_path) -> None:
    description = standing_description(standing_robot(tmp_path))
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    add_robot(plant, description)
    plant.Finalize()
    with pytest.raises(ModelError, match="has a root that floats"):
        StandingLaw(plant, replace(description), FRICTION)
