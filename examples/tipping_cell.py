"""A cell on a light frame: with `balance` it stays on its feet, without it tips over.

A run welds the frame to the floor. Here its motion is done again where only gravity,
friction and contact hold the frame; stiff motors do what was commanded.

    python examples/tipping_cell.py [seconds]
"""

import sys
from dataclasses import replace

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from crar_drake import AddRobot, add_contact_ground, load_scenario
from crar_drake.run import run_scenario

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 12.0
for balance in (None, load_scenario("tipping_cell").controller.balance):
    scenario = load_scenario("tipping_cell")
    scenario.duration, scenario.controller.balance = seconds, balance
    result = run_scenario(scenario)
    log, welded = result.log, result.setup.model.plant

    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
    robot = replace(result.setup.model.description, root="prescribed")
    upper_body = AddRobot(plant, robot)
    add_contact_ground(plant, scene_graph, robot, friction=0.8, height=0.0)
    for index in plant.GetJointActuatorIndices():
        gains = PdControllerGains(p=1e4, d=100.0)
        plant.get_joint_actuator(index).set_controller_gains(gains)
    plant.Finalize()
    of_motors = welded.MakeActuationMatrix().T  # (nu, nv)
    wanted = [log.time, of_motors @ log.q.T, of_motors @ log.v.T]
    states = TrajectorySource(PiecewisePolynomial.CubicHermite(*wanted), 1)
    torques = PiecewisePolynomial.FirstOrderHold(log.time, log.actuation.T)
    for source, port in (
        (states, plant.get_desired_state_input_port(upper_body)),
        (TrajectorySource(torques), plant.get_actuation_input_port(upper_body)),
    ):
        builder.Connect(builder.AddSystem(source).get_output_port(), port)
    simulator = Simulator(builder.Build())
    context = plant.GetMyContextFromRoot(simulator.get_context())
    frame, tilt = plant.GetBodyByName(robot.base), 0.0
    while tilt < 0.5 and context.get_time() < seconds:
        simulator.AdvanceTo(context.get_time() + 0.01)
        up = plant.EvalBodyPoseInWorld(context, frame).rotation().matrix()[2, 2]
        tilt = max(tilt, np.arccos(min(up, 1.0)))
    error = 1e3 * np.sqrt((log.task_error**2).sum(axis=1).mean() / 2)  # of a wrist
    print(
        f"{'with' if balance else 'without'} balance: wrists {error:.0f} mm off (rms), "
        f"frame {np.degrees(tilt):.1f} degrees aslant after {context.get_time():.1f} s"
    )
