"""Paths of every shape are bounded, and plants that cannot be are refused."""

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import RevoluteJoint, SpatialInertia
from pydrake.systems.framework import DiagramBuilder
from small_robots import CAPSULE, chain_urdf, make_model

from crar_drake.errors import ModelError
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

BOX = '<box size="0.05 0.07 0.2"/>'
CYLINDER = '<cylinder radius="0.04" length="0.2"/>'


def first_admission(shapes, pairs) -> tuple[ControlModel, np.ndarray]:
    model = make_model(
        chain_urdf("zyz", shapes=shapes), [Task(frame="tip")], pairs=pairs
    )
    law = ControlLaw(model, LookaheadParameters())
    q = model.rest_positions()
    answer = law.step(q, np.zeros(3), model.tasks_at(q))
    return model, answer.admission


@pytest.mark.parametrize("shapes", [(CAPSULE,), (BOX, CYLINDER), (CYLINDER,)])
def test_paths_of_every_shape_are_bounded(shapes) -> None:
    _, admission = first_admission(shapes, [["l2", "post"]])
    assert admission[3] == 1.0 and 0.0 < admission[2] < 1.0


def test_a_plant_with_a_coupler_is_refused() -> None:
    """Its joints would do otherwise than told."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
    parent, joints = plant.world_body(), []
    for name in "ab":
        inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
        link = plant.AddRigidBody(name, inertia)
        joint = RevoluteJoint(
            f"{name}_joint", parent.body_frame(), link.body_frame(), [0.0, 0.0, 1.0]
        )
        joints.append(plant.AddJoint(joint))
        plant.AddJointActuator(name, joints[-1])
        parent = link
    plant.set_discrete_contact_approximation(
        type(plant.get_discrete_contact_approximation()).kSap
    )
    plant.AddCouplerConstraint(*joints, 1.0)
    plant.Finalize()
    with pytest.raises(ModelError, match="1 constraints.*mimic.*AddCoupler.*lock"):
        ControlModel.FromPlant(
            plant, scene_graph, RobotDescription(name="two"), [Task(frame="b")]
        )
