"""The controller in a diagram of one's own, beside a plant that it does not own.

The plant here is 10 % heavier than the model that the controller computes with, as
a real robot might be. Both wrists are asked to stay where they are in the room while
the robot is lifted by 10 cm.

    python examples/controller_in_your_diagram.py [seconds]
"""

import sys

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from crar_drake import (
    AddCrarController,
    AddRobot,
    ControlModel,
    CrarParameters,
    position_tasks,
)

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 2.0

# Somebody's diagram with somebody's plant.
builder = DiagramBuilder()
plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
description = AddRobot(plant, "upper_body")
plant.Finalize()

# The controller, in three lines: state and actuation are connected by the call.
# Without control_model it would compute with a clone of the plant.
tasks = position_tasks(["left_wrist", "right_wrist"])
model = ControlModel.FromDescription(description, tasks)
controller = AddCrarController(
    builder,
    plant,
    scene_graph,
    description,
    tasks,
    CrarParameters(constraints="lookahead"),
    control_model=model,
)

# What it is to do: wrists fixed in the room, waist 10 cm up.
q0 = model.rest_positions()
targets = builder.AddSystem(ConstantVectorSource(model.tasks_at(q0)))
waist = q0[model.prescribed]
lift = PiecewisePolynomial.CubicShapePreserving(
    [0.0, 0.5, 1.5], np.column_stack([waist, waist, waist + [0.0, 0.0, 0.1]]), True
)
prescribed = builder.AddSystem(TrajectorySource(lift, 2))
builder.Connect(targets.get_output_port(), controller.get_input_port_desired_tasks())
builder.Connect(
    prescribed.get_output_port(), controller.get_input_port_desired_prescribed()
)

diagram = builder.Build()
simulator = Simulator(diagram)
plant_context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
for index in plant.GetBodyIndices(plant.GetModelInstanceByName("upper_body")):
    body = plant.get_body(index)
    M_B = body.CalcSpatialInertiaInBodyFrame(plant_context)
    if M_B.get_mass() > 0.0:
        heavier = SpatialInertia(
            1.1 * M_B.get_mass(), M_B.get_com(), M_B.get_unit_inertia()
        )
        body.SetSpatialInertiaInBodyFrame(plant_context, heavier)

simulator.AdvanceTo(seconds)
controller_context = controller.GetMyContextFromRoot(simulator.get_context())
reported = controller.diagnostics(controller_context)
error = reported["task_error"]
distances = reported["signed_distances"]
print(f"wrists off by at most {1e3 * np.abs(error).max():.1f} mm")
print(f"smallest distance {1e3 * distances.min():.1f} mm")
