"""Two arms that face each other, under one controller: it keeps them apart.

    python examples/two_arms.py [seconds]

Both tools go to one place. Under a controller each, they would not see each other.
"""

import sys
from dataclasses import replace

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from crar_drake import (
    AddCrarController,
    AddRobot,
    LookaheadParameters,
    load_robot_description,
    position_tasks,
)

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 3.0
builder = DiagramBuilder()
plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
turned = RigidTransform(RollPitchYaw(0.0, 0.0, np.pi), [1.1, 0.0, 0.0])
places = {"left": RigidTransform(), "right": turned}
described = load_robot_description("shelf_arm")
of_arm = [pair for pair in described.pairs if "shelf" not in pair]
described = replace(described, environment={}, pairs=of_arm)  # without its shelf
arms = [
    AddRobot(plant, described, prefix=name, X_WB=X_WB) for name, X_WB in places.items()
]
plant.Finalize()
tools = [f"{plant.GetModelInstanceName(arm)}::tool" for arm in arms]

controller = AddCrarController(
    *(builder, plant, scene_graph, position_tasks(tools)),
    LookaheadParameters(period=0.005),
    model_instance=arms,
)
desired = np.zeros(controller.model.layout.size)
desired[:6] = 2 * [0.55, 0.0, 0.5]
targets = builder.AddSystem(ConstantVectorSource(desired))
builder.Connect(targets.get_output_port(), controller.get_input_port_desired_tasks())

simulator = Simulator(builder.Build())
simulator.AdvanceTo(seconds)
told = controller.diagnostics(controller.GetMyContextFromRoot(simulator.get_context()))
names = controller.model.pairs.names
between = [a.split("::")[0] != b.split("::")[0] for a, b in names]
print(f"{sum(between)} of {len(names)} pairs are of both arms")
print(f"nearest of these: {1e3 * told['signed_distances'][between].min():.1f} mm")
print(told["promise"])
