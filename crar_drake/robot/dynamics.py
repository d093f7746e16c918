"""The masses of a plant, as the equations take them."""

from collections.abc import Iterable

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    ForceElementIndex,
    PrismaticSpring,
    RevoluteSpring,
    UniformGravityFieldElement,
)

from crar_drake.errors import ModelError
from crar_drake.law.compilation import Held, hold
from crar_drake.law.dynamics import Dynamics, Masses
from crar_drake.robot.kinematics import JointTree


def find_masses(
    plant: MultibodyPlant, joints: JointTree, bodies: Iterable[int]
) -> Masses:
    """The masses of some bodies, by the indices of these.

    Args:
        plant: of a robot whose base is fixed.
        joints: its tree.
        bodies: which count.
    """
    tree = joints.tree
    N = len(tree.parent)
    inertia = np.zeros((N, 4, 4))
    context = plant.CreateDefaultContext()
    for i in sorted(bodies):
        body = plant.get_body(BodyIndex(i))
        frame, X = joints.place(body)
        M = body.CalcSpatialInertiaInBodyFrame(context)
        m, own = M.get_mass(), np.empty((4, 4))
        if not m > 0.0:
            continue
        turned = M.CalcRotationalInertia().CopyToFullMatrix3()
        own[:3, :3] = 0.5 * np.trace(turned) * np.eye(3) - turned
        own[:3, 3] = own[3, :3] = m * M.get_com()
        own[3, 3] = m
        E = X.GetAsMatrix4()
        inertia[frame] += E @ own @ E.T
    velocity = np.zeros(N, dtype=int)
    velocity[joints.frame_of_velocity] = np.arange(len(joints.frame_of_velocity))
    turn, slide = np.zeros((N, 3)), np.zeros((N, 3))
    turn[joints.frame_of_velocity] = joints.turns
    slide[joints.frame_of_velocity] = joints.slides
    return Masses(
        hold(tree),
        velocity,
        turn,
        slide,
        inertia,
        float(-plant.gravity_field().gravity_vector()[2]),
    )


def find_dynamics(
    plant: MultibodyPlant, joints: JointTree, implicit_damping: np.ndarray
) -> Held:
    """Holds the `Dynamics` of a robot whose base is fixed.

    Args:
        plant: finalized.
        joints: its tree.
        implicit_damping: (nv,) what accelerations take to make up for damping that the
            plant takes at the end of its step [kg m^2 or kg].

    Raises:
        ModelError: the plant has other forces than gravity and springs of joints.
    """
    nv, bodies = plant.num_velocities(), range(1, plant.num_bodies())
    masses = find_masses(plant, joints, bodies)
    pulled = [
        i
        for i in bodies
        if plant.is_gravity_enabled(plant.get_body(BodyIndex(i)).model_instance())
    ]
    heavy = find_masses(plant, joints, pulled)
    stiffness, slack = np.zeros((2, nv))
    for i in range(plant.num_force_elements()):
        element = plant.get_force_element(ForceElementIndex(i))
        if isinstance(element, RevoluteSpring):
            at = element.joint().velocity_start()
            stiffness[at] += element.default_stiffness()
            slack[at] += element.default_stiffness() * element.default_nominal_angle()
        elif isinstance(element, PrismaticSpring):
            at = element.joint().velocity_start()
            stiffness[at] += element.stiffness()
            slack[at] += element.stiffness() * element.nominal_position()
        elif not isinstance(element, UniformGravityFieldElement):
            raise ModelError(
                f"effort limits: the plant has a {type(element).__name__}, whose force "
                "the control law does not know; leave it or the effort limits out"
            )
    rotors, damping = implicit_damping.copy(), np.zeros(nv)
    context = plant.CreateDefaultContext()
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        start = actuator.joint().velocity_start()
        if actuator.num_inputs() == 1:
            rotors[start] += actuator.calc_reflected_inertia(context)
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        start = joint.velocity_start()
        damping[start : start + joint.num_velocities()] = joint.default_damping_vector()
    return hold(
        Dynamics(
            hold(masses),
            plant.gravity_field().gravity_vector(),
            np.ascontiguousarray(heavy.inertia[:, 3]),
            rotors,
            damping,
            stiffness,
            slack,
        )
    )
