"""Whether a robot in somebody's plant stands where its control model does."""

from __future__ import annotations

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    Joint,
    ModelInstanceIndex,
    PrismaticJoint,
    RevoluteJoint,
)
from pydrake.systems.framework import Context

from crar_drake.errors import ModelError
from crar_drake.robot.model import ControlModel

# Calibrations err by less; bases that are welded elsewhere by more [m, rad].
_FAR = 0.05


def check_place(
    plant: MultibodyPlant, model: ControlModel, *part: ModelInstanceIndex
) -> None:
    """Looks at what carries the robot, and where the axes of all joints are in the
    world, at rest; files may place frames as they like along them.

    Args:
        plant: finalized, with positions of the same names as the model's.
        model: of the same robot.
        part: the robot's instance, if there are other things in the plant.

    Raises:
        ModelError: something that moves carries the robot; or an axis is 5 cm or 0.05
            rad from where the model has it, so that gravity and targets would mean
            something else.
    """
    for instance in part:
        _refuse_carried(plant, model, instance)
    q = model.rest_positions()
    theirs, ours = plant.CreateDefaultContext(), model.plant.CreateDefaultContext()
    plant.SetPositions(theirs, *part, q)
    model.plant.SetPositions(ours, q)
    for joint in map(model.plant.get_joint, model.plant.GetJointIndices()):
        if not isinstance(joint, RevoluteJoint | PrismaticJoint):
            continue
        there = plant.GetJointByName(joint.name(), *part)
        if type(there) is not type(joint):
            continue  # the numbers of positions agree all the same
        (a, p), (b, o) = _axis(there, theirs), _axis(joint, ours)
        turn = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
        apart = np.linalg.norm(np.cross(b, p - o))
        if isinstance(joint, PrismaticJoint):
            apart = 0.0  # whatever moves along is the same anywhere
        if turn > _FAR or apart > _FAR:
            raise ModelError(
                f"joint {joint.name()} of the plant is {apart:.2f} m and {turn:.2f} "
                "rad from where the control model has it: weld the robot where the "
                "model's base is, or let the model be where the robot is: "
                "dataclasses.replace(description, root_pose=RootPose(xyz, rpy))"
            )


def _refuse_carried(
    plant: MultibodyPlant, model: ControlModel, part: ModelInstanceIndex
) -> None:
    """Raises ModelError where a joint that is none of a part's moves a body of it."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    carriers = {joint.child_body().index(): joint for joint in joints}
    own = {index for index in plant.GetJointIndices(part)}
    for index in plant.GetBodyIndices(part):
        body = plant.get_body(index)
        while (joint := carriers.get(body.index())) is not None:
            if joint.num_velocities() and joint.index() not in own:
                raise ModelError(
                    f"robot {model.description.name}: its link "
                    f"{plant.get_body(index).name()!r} is carried by joint "
                    f"{joint.name()!r} of "
                    f"{plant.GetModelInstanceName(joint.model_instance())!r}, which "
                    "the law does not know: weld the base to the world, or make both "
                    "one model (its joints as prescribed_joints)"
                )
            body = joint.parent_body()


def _axis(joint: Joint, context: Context) -> tuple[np.ndarray, np.ndarray]:
    """(3,) direction of a joint's axis, and (3,) a point on it, in the world [m]."""
    X_WF = joint.frame_on_parent().CalcPoseInWorld(context)
    if isinstance(joint, RevoluteJoint):
        axis = joint.revolute_axis()
    else:
        axis = joint.translation_axis()
    return X_WF.rotation() @ axis, X_WF.translation()
