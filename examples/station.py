"""A station: an arm with a gripper beside a post, a table with a box on it.

    python examples/station.py [targets] [page.html]

The tool goes to twenty targets, one after the other, on one diagram. The page shows it.
"""

import sys
from pathlib import Path

import numpy as np
from pydrake.geometry import Box, StartMeshcat
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import (
    PdControllerGains,
    PrismaticJoint,
    SpatialInertia,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput
from pydrake.visualization import AddDefaultVisualization

from crar_drake import AddCrarController, AddRobot, LookaheadParameters, position_tasks

count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
page = Path(sys.argv[2]) if len(sys.argv) > 2 else Path("station.html")

builder = DiagramBuilder()
plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
arm = AddRobot(plant, "obstacle_arm")  # it has the post in its scene


def add_box(name, size, mass, instance):
    """A link with a box to be seen and one to collide."""
    inertia = SpatialInertia.SolidBoxWithMass(mass, *size)
    body = plant.AddRigidBody(name, instance, inertia)
    of = body, RigidTransform(), Box(*size), name
    plant.RegisterCollisionGeometry(*of, CoulombFriction(0.8, 0.8))
    plant.RegisterVisualGeometry(*of, [0.96, 0.62, 0.16, 1.0])
    return body


table = add_box("table", (0.5, 0.5, 0.04), 10.0, plant.AddModelInstance("table"))
X_WT = RigidTransform([0.45, -0.35, 0.1])
plant.WeldFrames(plant.world_frame(), table.body_frame(), X_WT)
box = add_box("box", (0.06, 0.06, 0.06), 0.3, plant.AddModelInstance("box"))
X_WB = RigidTransform([0.6, -0.5, 0.15])
plant.SetDefaultFloatingBaseBodyPose(box, X_WB)
of_gripper = plant.AddModelInstance("gripper")
palm = add_box("gripper_palm", (0.08, 0.03, 0.03), 0.2, of_gripper)
plant.WeldFrames(
    plant.GetFrameByName("tool", arm), palm.body_frame(), RigidTransform([0, 0, 0.02])
)
for side in (-1.0, 1.0):
    finger = add_box(f"finger_{side:+.0f}", (0.01, 0.02, 0.05), 0.05, of_gripper)
    slide = PrismaticJoint(
        f"slide_{side:+.0f}", palm.body_frame(), finger.body_frame(), [side, 0, 0]
    )
    slide = plant.AddJoint(slide)
    slide.set_default_translation(0.035)
    motor = plant.AddJointActuator(slide.name(), slide)
    motor.set_controller_gains(PdControllerGains(p=5000.0, d=50.0))
plant.Finalize()

controller = AddCrarController(
    *(builder, plant, scene_graph, position_tasks(["tool"])),
    LookaheadParameters(period=0.005),
    model_instance=arm,
)
# It counts as locked where it is by default, so it is held there.
grip = builder.AddSystem(ConstantVectorSource(np.array([0.035, 0.035, 0.0, 0.0])))
builder.Connect(grip.get_output_port(), plant.get_desired_state_input_port(of_gripper))
log = LogVectorOutput(controller.get_output_port_diagnostics(), builder, 0.005)
meshcat = StartMeshcat()
AddDefaultVisualization(builder, meshcat)

simulator = Simulator(builder.Build())
context = controller.GetMyMutableContextFromRoot(simulator.get_mutable_context())
model, rng = controller.model, np.random.default_rng(1)
meshcat.StartRecording()
for number in range(count):
    target = np.zeros(model.layout.size)
    target[:3] = rng.uniform([0.25, -0.5, 0.25], [0.6, 0.5, 0.7])
    controller.get_input_port_desired_tasks().FixValue(context, target)
    simulator.AdvanceTo(1.5 * (number + 1))
    told = controller.diagnostics(context)
    error = 1e3 * np.linalg.norm(told["task_error"])
    print(f"{number}: {error:.1f} mm from its target, {told['promise']}")
meshcat.PublishRecording()
page.write_text(meshcat.StaticHtml())
place = controller.diagnostics_slices["signed_distances"]
distances = log.FindLog(simulator.get_context()).data()[place]
print(f"nearest of {len(distances)} pairs: {1e3 * distances.min():.1f} mm")
