"""A position-controlled arm that lags: motors of finite stiffness, commands 20 ms late.

python examples/filter_a_lagging_robot.py [seconds]
"""

import sys

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    DiscreteTimeDelay as Delay,
    LogVectorOutput,
    TrajectorySource,
)
from pydrake.trajectories import PiecewisePolynomial

from crar_drake import (
    AddRobot,
    SafetyFilter,
    SafetyFilterSystem,
    load_robot_description,
)
from crar_drake.judging.referee import Referee

PERIOD, LATENCY = 0.01, 2  # [s], periods
seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 4.0
builder = DiagramBuilder()
plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
arm = AddRobot(plant, "obstacle_arm")
for index in plant.GetJointActuatorIndices():
    gains = PdControllerGains(p=3000.0, d=150.0)
    plant.get_mutable_joint_actuator(index).set_controller_gains(gains)
plant.Finalize()
rest = plant.GetPositions(plant.CreateDefaultContext())
# What is wanted: through where the post stands, and back, every two seconds.
through = rest + np.array([1.5, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
times = np.arange(0.0, seconds + 2.0)
ends = np.array([through if k % 2 else rest for k in range(len(times))]).T
way = TrajectorySource(PiecewisePolynomial.CubicShapePreserving(times, ends, True))
policy = builder.AddSystem(way).get_output_port()
safe = builder.AddSystem(SafetyFilterSystem(SafetyFilter("obstacle_arm", PERIOD)))
late = builder.AddSystem(Delay(PERIOD, LATENCY, 2 * len(rest)))
state = plant.get_state_output_port(arm)
builder.Connect(policy, safe.get_input_port_desired_position())
builder.Connect(state, safe.get_input_port_measured_state())
builder.Connect(safe.get_output_port_command(), late.get_input_port())
builder.Connect(late.get_output_port(), plant.get_desired_state_input_port(arm))
log = LogVectorOutput(state, builder, PERIOD)
told = LogVectorOutput(safe.get_output_port_diagnostics(), builder, PERIOD)
simulator = Simulator(builder.Build())
context = simulator.get_mutable_context()
begin = np.tile(np.r_[rest, 0.0 * rest], LATENCY + 1)
late.GetMyMutableContextFromRoot(context).SetDiscreteState(begin)
simulator.AdvanceTo(seconds)
q = log.FindLog(context).data().T[:, : len(rest)]
error = np.nanmax(told.FindLog(context).data()[4])
pairs = load_robot_description("obstacle_arm").pairs
found = Referee(plant, scene_graph, pairs).violations(q)
print(f"the arm is off its command by up to {np.degrees(error):.1f} degrees")
print(f"nearest {1e3 * found.smallest_distance:.1f} mm, {found.num_violated} violated")
