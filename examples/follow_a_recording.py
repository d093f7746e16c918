"""A recorded person moves a robot in a diagram of one's own.

    python examples/follow_a_recording.py [motion] [seconds]

The motion is a built-in one, or the path of a BVH, C3D, AMC or AMASS file.
"""

import sys

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from crar_drake import (
    EXPERIMENTS,
    AddCrarController,
    AddRobot,
    LookaheadParameters,
    MotionSource,
    load_robot_description,
    position_tasks,
    solve_start_pose,
)

motion = sys.argv[1] if len(sys.argv) > 1 else "dance"
tasks = position_tasks(EXPERIMENTS["upper-body"])
source = MotionSource(motion, "upper_body", tasks)
seconds = float(sys.argv[2]) if len(sys.argv) > 2 else source.duration

builder = DiagramBuilder()
plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
robot = AddRobot(plant, "upper_body")
plant.Finalize()
controller = AddCrarController(
    *(builder, plant, scene_graph, tasks, LookaheadParameters(period=0.005)),
    model_instance=robot,
    prescribed=list(load_robot_description("upper_body").prescribed_joints),
)
builder.AddSystem(source)
for port, goes_to in (
    (
        source.get_output_port_desired_tasks(),
        controller.get_input_port_desired_tasks(),
    ),
    (
        source.get_output_port_desired_prescribed(),
        controller.get_input_port_desired_prescribed(),
    ),
):
    builder.Connect(port, goes_to)

# It starts near the first targets.
at_first = source.CreateDefaultContext()
first = source.get_output_port_desired_tasks().Eval(at_first)
waist = source.get_output_port_desired_prescribed().Eval(at_first)
model = controller.model
plant.SetDefaultPositions(solve_start_pose(model, first, waist[: model.n_p]))

simulator = Simulator(builder.Build())
context = controller.GetMyContextFromRoot(simulator.get_context())
nearest, errors, promises = np.inf, [], []
for time in np.arange(0.05, seconds, 0.05):
    simulator.AdvanceTo(time)
    told = controller.diagnostics(context)
    nearest = min(nearest, told["signed_distances"].min())
    errors.append(np.abs(told["task_error"]).max())
    promises.append(told["promise"])
kept = promises.count("guaranteed") / len(promises)
print(f"nearest pair {1e3 * nearest:.1f} mm, points off by {1e3 * max(errors):.0f} mm")
print(f"guaranteed in {100 * kept:.0f} % of the steps")
