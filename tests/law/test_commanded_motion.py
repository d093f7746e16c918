"""The law on its own command: what it reads at each tick is the theorem's (1)."""

import numpy as np
import pytest
from exact_loop import follow
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from small_robots import add_plant, chain_urdf

from crar_drake.law.commanded_motion import CommandedMotion
from crar_drake.law.controller import CrarController
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

PERIOD = 0.005  # [s]


@pytest.fixture(scope="module")
def loop():
    """A controller on its own command, and what it is to follow."""
    plant, scene_graph = add_plant(DiagramBuilder(), chain_urdf("zyz"), time_step=0.0)
    description = RobotDescription(pairs=[["l2", "post"]], rest_posture={"j1": 0.4})
    model = ControlModel.FromPlant(plant, scene_graph, description, [Task(frame="tip")])
    parameters = LookaheadParameters(period=PERIOD)
    builder = DiagramBuilder()
    controller = CrarController(model, parameters, plant_is_discrete=False)
    builder.AddSystem(controller)
    motion = builder.AddSystem(CommandedMotion(model.rest_positions(), PERIOD))
    target = model.tasks_at(model.rest_positions())
    target[:3] += [-0.2, 0.25, 0.1]
    source = builder.AddSystem(ConstantVectorSource(target))
    acceleration = controller.get_output_port_desired_acceleration()
    for output, port in (
        (source.get_output_port(), controller.get_input_port_desired_tasks()),
        (acceleration, motion.get_input_port_acceleration()),
        (motion.get_output_port_state(), controller.get_input_port_estimated_state()),
    ):
        builder.Connect(output, port)
    return builder.Build(), model, parameters, target


def test_the_command_is_the_exact_models_motion(loop) -> None:
    """Against the law called by hand, each time on the state that it predicted."""
    diagram, model, parameters, target = loop
    expected, _ = follow(model, parameters, np.tile(target, (60, 1)))
    assert np.abs(expected[-1][3:]).max() > 0.1  # it is under way
    simulator = Simulator(diagram)
    state = diagram.GetSubsystemByName("commanded_motion").get_output_port_state()
    context = diagram.GetSubsystemByName("commanded_motion").GetMyContextFromRoot(
        simulator.get_context()
    )
    for k, at_tick in enumerate(expected, start=1):
        simulator.AdvanceTo(k * PERIOD)
        np.testing.assert_allclose(state.Eval(context), at_tick, atol=1e-11)


def test_between_ticks_it_is_the_closed_form(loop) -> None:
    """q + (t - e) q_dot + e s, e = t^2 / (2 T), s = q_dot + T q_dd, of (1), delta 0."""
    diagram, model, parameters, _ = loop
    T = parameters.T
    motion = diagram.GetSubsystemByName("commanded_motion")
    controller = diagram.GetSubsystemByName("crar_controller")
    simulator = Simulator(diagram)
    root = simulator.get_context()
    context = motion.GetMyContextFromRoot(root)
    for k in range(0, 40, 7):
        # The events of an instant are handled by the step that begins there.
        simulator.AdvanceTo(k * PERIOD)
        q, v = np.split(motion.get_output_port_state().Eval(context).copy(), 2)
        for share in (0.2, 0.7):
            t = share * PERIOD
            simulator.AdvanceTo(k * PERIOD + t)
            a = controller.get_output_port_desired_acceleration().Eval(
                controller.GetMyContextFromRoot(root)
            )
            s, e = v + T * a, t * t / (2.0 * T)
            expected = [*(q + (t - e) * v + e * s), *(v + t * (s - v) / T)]
            np.testing.assert_allclose(
                motion.get_output_port_state().Eval(context), expected, atol=1e-13
            )


def test_it_can_start_elsewhere() -> None:
    motion = CommandedMotion(np.zeros(2), PERIOD)
    context = motion.CreateDefaultContext()
    motion.SetStart(context, [0.3, -0.4])
    context.SetTime(0.004)
    state = motion.get_output_port_state().Eval(context)
    np.testing.assert_array_equal(state, [0.3, -0.4, 0.0, 0.0])
