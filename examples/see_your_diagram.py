"""A diagram of one's own, with a post in the robot's way, seen in a browser.

    python examples/see_your_diagram.py [robot] [seconds] [page.html]

The robot is `upper_body`, or another with wrists: an imported one, say. The address of
the live view is printed; afterwards the page has all of it, and needs no network.
"""

import sys
from pathlib import Path

import numpy as np
from pydrake.geometry import Capsule, ProximityProperties, StartMeshcat
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from pydrake.visualization import AddDefaultVisualization

from crar_drake import (
    AddCrarController,
    AddRobot,
    ControlModel,
    LookaheadParameters,
    load_robot_description,
    position_tasks,
)

arguments = dict(enumerate(sys.argv))
name = arguments.get(1, "upper_body")
seconds = float(arguments.get(2, 3.0))
page = Path(arguments.get(3, "see_your_diagram.html"))

tasks = position_tasks(["left_wrist", "right_wrist"])

# Where the wrists are at rest: the post stands 15 cm before the left one, and that is
# told to go to the other side of it.
description = load_robot_description(name)
alone = ControlModel.FromDescription(description, tasks)
rest = alone.layout.unpack(alone.tasks_at(alone.rest_positions())).p
beyond = rest + [[0.30, 0.0, 0.0], [0.0, 0.0, 0.0]]
x, y, z = rest[0] + [0.15, 0.0, 0.0]

builder = DiagramBuilder()
plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
robot = AddRobot(plant, name)

# The obstacle: a link, welded to the world, with a shape to be seen and one to collide.
of_post = plant.AddModelInstance("post")
inertia = SpatialInertia.SolidSphereWithMass(mass=1.0, radius=0.04)
post = plant.AddRigidBody("post", of_post, inertia)
shape, upright = Capsule(radius=0.04, length=0.4), RigidTransform()
plant.RegisterVisualGeometry(post, upright, shape, "post", [0.96, 0.62, 0.16, 1.0])
plant.RegisterCollisionGeometry(post, upright, shape, "post", ProximityProperties())
plant.WeldFrames(plant.world_frame(), post.body_frame(), RigidTransform([x, y, z]))
plant.Finalize()

# Every link that may touch the post keeps off it.
parameters = LookaheadParameters(period=0.005)
controller = AddCrarController(
    *(builder, plant, scene_graph, tasks, parameters),
    model_instance=robot,
    prescribed=list(description.prescribed_joints),
)
path = PiecewisePolynomial.CubicShapePreserving(
    [0.0, 0.5, 2.0],
    np.column_stack([rest.ravel(), rest.ravel(), beyond.ravel()]),
    zero_end_point_derivatives=True,
)
targets = builder.AddSystem(TrajectorySource(path, output_derivative_order=2))
builder.Connect(targets.get_output_port(), controller.get_input_port_desired_tasks())
if controller.model.prescribed_names:
    at_rest = controller.model.prescribed_at(controller.model.rest_positions())
    still = builder.AddSystem(ConstantVectorSource(at_rest))
    builder.Connect(
        still.get_output_port(), controller.get_input_port_desired_prescribed()
    )

# Three lines for Meshcat; StartMeshcat prints the address.
meshcat = StartMeshcat()
AddDefaultVisualization(builder, meshcat)
meshcat.StartRecording()

simulator = Simulator(builder.Build())
simulator.AdvanceTo(seconds)

# One for a page that plays it again.
meshcat.PublishRecording()
page.write_text(meshcat.StaticHtml())

context = controller.GetMyContextFromRoot(simulator.get_context())
distances = controller.diagnostics(context)["signed_distances"]
of_post = ["post" in pair for pair in controller.model.pairs.names]
print(f"{sum(of_post)} links watch the post")
print(f"smallest distance from it {1e3 * distances[of_post].min():.1f} mm")
print(page)
