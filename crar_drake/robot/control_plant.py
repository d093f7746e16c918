"""The plant that a law computes with, made from a user's own: nothing can differ."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from pydrake.geometry import ProximityProperties, SceneGraph
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    FixedOffsetFrame,
    ForceElement,
    ForceElementIndex,
    Frame,
    FrameIndex,
    Joint,
    JointIndex,
    ModelInstanceIndex,
    PlanarJoint,
    PrismaticJoint,
    PrismaticSpring,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RevoluteSpring,
    RigidBody,
    ScrewJoint,
    UniformGravityFieldElement,
    UniversalJoint,
    WeldJoint,
)
from pydrake.systems.framework import Diagram, DiagramBuilder

from crar_drake.errors import ModelError
from crar_drake.robot.kinematics import screw_axis


class Part:
    """What of a plant a law knows: a robot, what it carries, what stands in the world.

    Attributes:
        instances: of the robot.
        carried: indices of the robot's bodies, and of all that hangs on those that
            move.
        bodies: these, and what is welded to the world.
        moved: indices of the robot's joints.
        locked: places in q of joints that are not its own and move what it carries.
        moved_by: of each body, the joints of these that move it.
    """

    def __init__(
        self, plant: MultibodyPlant, instances: Iterable[ModelInstanceIndex]
    ) -> None:
        """
        Raises:
            ModelError: something else that moves carries the robot.
        """
        self.instances = set(instances)
        joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
        ours = [j for j in joints if j.model_instance() in self.instances]
        self.moved = {joint.index() for joint in ours}
        carriers = {joint.child_body().index(): joint for joint in joints}
        fixed = {body.index() for body in plant.GetBodiesWeldedTo(plant.world_body())}
        self.carried, self.moved_by = set(), {}
        for i in map(BodyIndex, range(1, plant.num_bodies())):
            above = list(_above(plant.get_body(i), carriers))
            if plant.get_body(i).model_instance() in self.instances:
                self.carried.add(i)
                for joint in above:
                    if joint.num_velocities() and joint.index() not in self.moved:
                        _refuse_carried(plant, plant.get_body(i), joint)
            bodies = [joint.child_body() for joint in above]
            if any(
                body.model_instance() in self.instances and body.index() not in fixed
                for body in bodies
            ):
                self.carried.add(i)
            self.moved_by[i] = frozenset(
                joint.index()
                for joint in above
                if joint.num_velocities() and joint.index() in self.moved
            )
        self.bodies = sorted(self.carried | fixed)
        self.locked = [
            joint.position_start() + k
            for joint in joints
            if joint.child_body().index() in self.carried
            and joint.index() not in self.moved
            for k in range(joint.num_positions())
        ]


def _above(body: RigidBody, carriers: dict[BodyIndex, Joint]) -> Iterator[Joint]:
    """The joints from a body to the world."""
    while (joint := carriers.get(body.index())) is not None:
        yield joint
        body = joint.parent_body()


def _refuse_carried(plant: MultibodyPlant, body: RigidBody, joint: Joint) -> None:
    raise ModelError(
        f"robot {plant.GetModelInstanceName(body.model_instance())}: its link "
        f"{body.name()!r} is carried by joint {joint.name()!r} of "
        f"{plant.GetModelInstanceName(joint.model_instance())!r}, which the law does "
        "not know: weld the base to the world, or give both as model_instance (those "
        "joints as prescribed)"
    )


def refuse_constraints(plant: MultibodyPlant) -> None:
    """Raises ModelError: with couplers and the like joints do otherwise than
    commanded."""
    if not plant.num_constraints():
        return
    names = [
        plant.GetModelInstanceName(ModelInstanceIndex(i))
        for i in range(plant.num_model_instances())
        if plant.GetJointIndices(ModelInstanceIndex(i))
    ]
    raise ModelError(
        f"the plant of {', '.join(names)} has {plant.num_constraints()} constraints "
        "that the control law does not know (<mimic>, AddCouplerConstraint, "
        "AddBallConstraint and the like): its joints would not do what is "
        "commanded; remove them, and lock or control the joints"
    )


def control_plant(
    plant: MultibodyPlant, scene_graph: SceneGraph, part: Part
) -> tuple[Diagram, MultibodyPlant, SceneGraph]:
    """A diagram with a plant of a part alone, and its scene of collision shapes.

    Names, masses, joints with their limits, damping and default positions, actuators,
    springs, gravity and the time step are those of the user's plant as they are now.
    Joints of what the robot carries, a gripper's, are locked where they are by default.

    Args:
        plant: finalized.
        scene_graph: where its geometry is registered.
        part: of the plant.

    Raises:
        ModelError: the plant has constraints between its joints, or the part a joint or
            a force that cannot be taken.
    """
    refuse_constraints(plant)
    builder = DiagramBuilder()
    copy, scene = AddMultibodyPlantSceneGraph(builder, plant.time_step())
    copier = _Copier(plant, copy, part)
    copier.copy_shapes(scene_graph)
    copier.copy_joints()
    copier.copy_forces()
    copy.Finalize()
    for body in plant.GetFloatingBaseBodies():
        if body in part.carried:
            copy.SetDefaultFloatingBaseBodyPose(
                copier.bodies[body],
                plant.GetDefaultFloatingBaseBodyPose(plant.get_body(body)),
            )
    return builder.Build(), copy, scene


class _Copier:
    """Adds to a plant what another one has."""

    def __init__(self, plant: MultibodyPlant, copy: MultibodyPlant, part: Part) -> None:
        self._plant, self._copy, self._part = plant, copy, part
        self._joints: dict[JointIndex, Joint] = {}
        self._context = plant.CreateDefaultContext()
        self.bodies = {BodyIndex(0): copy.world_body()}
        for body in map(plant.get_body, part.bodies):
            if body.index() not in self.bodies:
                self.bodies[body.index()] = copy.AddRigidBody(
                    body.name(),
                    self._instance(body.model_instance()),
                    body.default_spatial_inertia(),
                )
        self._frames = {}
        for i in map(FrameIndex, range(plant.num_frames())):
            frame = plant.get_frame(i)
            if frame.body().index() in self.bodies:
                self._frames[i] = self._copied_frame(frame)

    def _instance(self, instance: ModelInstanceIndex) -> ModelInstanceIndex:
        """The instance of the same name, which scoped names are made of."""
        name = self._plant.GetModelInstanceName(instance)
        if not self._copy.HasModelInstanceNamed(name):
            made = self._copy.AddModelInstance(name)
            if not self._plant.is_gravity_enabled(instance):
                self._copy.set_gravity_enabled(made, False)
        return self._copy.GetModelInstanceByName(name)

    def _copied_frame(self, frame: Frame) -> Frame:
        body = self.bodies[frame.body().index()]
        if frame.is_body_frame():
            return body.body_frame()
        return self._copy.AddFrame(
            FixedOffsetFrame(
                frame.name(),
                body.body_frame(),
                frame.GetFixedPoseInBodyFrame(),
                self._instance(frame.model_instance()),
            )
        )

    def copy_shapes(self, scene_graph: SceneGraph) -> None:
        inspector = scene_graph.model_inspector()
        for index, body in self.bodies.items():
            of = self._plant.get_body(index)
            for geometry in self._plant.GetCollisionGeometriesForBody(of):
                self._copy.RegisterCollisionGeometry(
                    body,
                    inspector.GetPoseInFrame(geometry),
                    inspector.GetShape(geometry),
                    inspector.GetName(geometry).rpartition("::")[2],
                    ProximityProperties(),
                )

    def copy_joints(self) -> None:
        for joint in map(self._plant.get_joint, self._plant.GetJointIndices()):
            if joint.child_body().index() in self.bodies and not joint.is_ephemeral():
                made = self._copy.AddJoint(self._copied_joint(joint))
                self._joints[joint.index()] = made
                if made.num_velocities():
                    _copy_numbers(joint, made)
        for i in self._plant.GetJointActuatorIndices():
            actuator = self._plant.get_joint_actuator(i)
            index = actuator.joint().index()
            if index not in self._part.moved:
                continue
            of = actuator.name(), self._joints[index], actuator.effort_limit()
            made = self._copy.AddJointActuator(*of)
            made.set_default_rotor_inertia(actuator.default_rotor_inertia())
            made.set_default_gear_ratio(actuator.default_gear_ratio())

    def _copied_joint(self, joint: Joint) -> Joint:
        ends = joint.frame_on_parent(), joint.frame_on_child()
        of = (joint.name(), *(self._frames[frame.index()] for frame in ends))
        if isinstance(joint, WeldJoint):
            return WeldJoint(*of, joint.X_FM())
        if joint.index() not in self._part.moved:
            X_FM = self._plant.CalcRelativeTransform(self._context, *ends)
            return WeldJoint(*of, X_FM)
        if isinstance(joint, RevoluteJoint):
            return RevoluteJoint(*of, joint.revolute_axis())
        if isinstance(joint, PrismaticJoint):
            return PrismaticJoint(*of, joint.translation_axis())
        if isinstance(joint, ScrewJoint):
            axis = screw_axis(joint, self._plant)
            return ScrewJoint(*of, axis, joint.screw_pitch(), 0.0)
        if isinstance(joint, PlanarJoint):
            return PlanarJoint(*of, np.zeros(3))
        if isinstance(joint, UniversalJoint | QuaternionFloatingJoint):
            return type(joint)(*of)
        raise ModelError(
            f"joint {joint.name()!r} is a {joint.type_name()} joint, whose velocities "
            "are not the rates of its positions; use revolute, prismatic, screw, "
            "universal or planar joints, or weld it"
        )

    def copy_forces(self) -> None:
        plant, copy = self._plant, self._copy
        gravity = plant.gravity_field().gravity_vector()
        copy.mutable_gravity_field().set_gravity_vector(gravity)
        for i in map(ForceElementIndex, range(plant.num_force_elements())):
            element = plant.get_force_element(i)
            if isinstance(element, UniformGravityFieldElement):
                continue
            joint = getattr(element, "joint", lambda: None)()
            if joint is not None and joint.index() not in self._part.moved:
                continue
            if isinstance(element, RevoluteSpring):
                numbers = element.default_nominal_angle(), element.default_stiffness()
            elif isinstance(element, PrismaticSpring):
                numbers = element.nominal_position(), element.stiffness()
            elif self._touches(element):
                raise ModelError(
                    f"the plant has a {type(element).__name__}, whose force the "
                    "control law does not know; leave it out"
                )
            else:
                continue
            copy.AddForceElement(type(element)(self._joints[joint.index()], *numbers))

    def _touches(self, element: ForceElement) -> bool:
        """Whether a force acts on what the robot carries; one of a kind that does not
        say on what, may."""
        names = ("bodyA", "bodyB", "link0", "link1")
        ends = [getattr(element, name)() for name in names if hasattr(element, name)]
        return not ends or any(end.index() in self._part.carried for end in ends)


def _copy_numbers(joint: Joint, made: Joint) -> None:
    """Damping, limits and default positions."""
    made.set_default_damping_vector(joint.default_damping_vector())
    made.set_position_limits(
        joint.position_lower_limits(), joint.position_upper_limits()
    )
    made.set_velocity_limits(
        joint.velocity_lower_limits(), joint.velocity_upper_limits()
    )
    made.set_default_positions(joint.default_positions())
