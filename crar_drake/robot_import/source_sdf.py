"""A robot's own SDF: read by Drake, as a tree of links.

Drake parses the file, so that poses, frames, nested models, includes and what an axis
is expressed in mean here what they mean there.

A joint whose frame is beside its child's origin gets a link without geometry, as have
the file's frames.
"""

import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydrake.geometry import Role, SceneGraphInspector
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import (
    Frame,
    Joint as DrakeJoint,
    ModelInstanceIndex,
    RigidBody,
)
from pydrake.systems.framework import DiagramBuilder

from crar_drake.errors import ModelError
from crar_drake.robot_import.robot_files import robot_name
from crar_drake.robot_import.sdf_copies import COLLISION, SdfCopies
from crar_drake.robot_import.source_robot import (
    WORLD,
    Geometry,
    Inertia,
    Joint,
    Link,
    Loop,
    Shape,
    SourceRobot,
)
from crar_drake.robot_import.source_tree import SourceTree

# Drake's joints, as a URDF calls them.
_KINDS = {"weld": "fixed", "ball_rpy": "ball", "quaternion_floating": "floating"}
_OPEN = 1e-3  # [m] by which a closed chain may gape


def read_sdf(path: Path, package_paths: Sequence[Path] = ()) -> SourceRobot:
    """Reads an SDF and resolves its meshes and what it includes.

    Of a world only the robot is taken: the model that has joints which turn or slide.

    Args:
        package_paths: as `read_urdf` has them.

    Raises:
        ModelError: Drake cannot read it, or it has no such model or several, or its
            links are not one tree, or a mesh, model or package is not there.
    """
    with tempfile.TemporaryDirectory() as folder:
        copies = SdfCopies(Path(folder), package_paths)
        copy = copies.of(path)
        plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
        try:
            Parser(plant).AddModels(str(copy))
        except RuntimeError as error:
            said = copies.told_of_originals(str(error))
            place = "" if str(path) in said else f"{path}: "
            raise ModelError(f"{place}{said}") from error
        return _Reader(path, plant, scene_graph.model_inspector(), copies).read()


class _Reader(SourceTree):
    """Turns a plant, which is not finalized, into links and joints."""

    def __init__(
        self,
        path: Path,
        plant: MultibodyPlant,
        inspector: SceneGraphInspector,
        copies: SdfCopies,
    ) -> None:
        super().__init__(path, copies.notes)
        self._plant, self._inspector, self._mimics = plant, inspector, copies.mimics
        self._instances = [*map(ModelInstanceIndex, range(plant.num_model_instances()))]
        actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
        self._efforts = {a.joint().index(): a.effort_limit() for a in actuators}

    def read(self) -> SourceRobot:
        """All of it."""
        plant = self._plant
        model = self._select_model()
        instances = [i for i in self._instances if self._model_of(i) == model]
        bodies = [plant.get_body(i) for m in instances for i in plant.GetBodyIndices(m)]
        indices = [i for each in instances for i in plant.GetJointIndices(each)]
        joints = [*map(plant.get_joint, indices)]
        self._bodies = _unique_names(bodies, model)
        self.taken |= set(self._bodies.values())
        self._bodies[plant.world_body().index()] = WORLD
        names = _unique_names(joints, model)
        self.reserved = set(names.values())
        if any(self._name(joint.parent_body()) == WORLD for joint in joints):
            self.add_link(Link(WORLD))
        for body in bodies:
            self.add_link(self._link(body))
        carried, loops = set(), []
        for joint in joints:
            # What another joint carries already closes a chain.
            if joint.child_body().index() in carried:
                loops.append((names[joint.index()], joint))
            else:
                carried.add(joint.child_body().index())
                self._read_joint(joint, names[joint.index()])
        for link, name, X_LF in self._frames(instances, joints):
            self.add_frame(link, name, "_frame", X_LF)
        if (root := self.robot().root) != WORLD:
            (index,) = [index for index, name in self._bodies.items() if name == root]
            X_WL = plant.GetDefaultFloatingBaseBodyPose(plant.get_body(index))
            upright, X_UL = self.stand(root, X_WL, mounted=False)
            if upright:
                self.weld(upright, root, X_UL)
        robot = self.robot()
        loops = [self._loop(robot, *each) for each in loops]
        return self.finished(robot_name(model, self.path), loops)

    def _name(self, body: RigidBody) -> str:
        return self._bodies[body.index()]

    # --- which model is the robot ---------------------------------------------------

    def _model_of(self, instance: ModelInstanceIndex) -> str:
        """The outermost of nested models."""
        return self._plant.GetModelInstanceName(instance).partition("::")[0]

    def _select_model(self) -> str:
        """The model that moves."""
        plant = self._plant
        with_bodies = [i for i in self._instances[1:] if plant.GetBodyIndices(i)]
        moving = Counter(
            self._model_of(joint.model_instance())
            for joint in map(plant.get_joint, plant.GetJointIndices())
            if joint.type_name() in ("revolute", "prismatic")
        )
        if not moving:
            raise ModelError(f"{self.path}: it has no joint that turns or slides")
        if len(moving) > 1:
            which = ", ".join(f"{name} ({n} joints)" for name, n in moving.items())
            raise ModelError(
                f"{self.path}: several of its models move: {which}; import a file "
                "that has, or includes, the one that is meant alone"
            )
        (model,) = moving
        names = dict.fromkeys(map(self._model_of, with_bodies))
        self.note_foreign([name for name in names if name != model])
        if plant.num_force_elements() > 1:
            self.notes.append("left out of the joints: springs")
        return model

    # --- links and joints -----------------------------------------------------------

    def _link(self, body: RigidBody) -> Link:
        name, inspector = self._name(body), self._inspector
        visual, collision = [], []
        frame = self._plant.GetBodyFrameIdOrThrow(body.index())
        for geometry in inspector.GetGeometries(frame, Role.kIllustration):
            own = inspector.GetName(geometry).rpartition("::")[2]
            shape = inspector.GetShape(geometry)
            if not isinstance(shape, Geometry):
                self.notes.append(
                    f"link {name}: {own.removeprefix(COLLISION)}, which is no mesh, "
                    "box, cylinder, sphere, capsule or ellipsoid, is left out"
                )
                continue
            looks, rgba = inspector.GetIllustrationProperties(geometry), None
            if looks.HasProperty("phong", "diffuse"):
                colour = looks.GetProperty("phong", "diffuse")
                rgba = colour.r(), colour.g(), colour.b(), colour.a()
            of_kind = collision if own.startswith(COLLISION) else visual
            of_kind.append(Shape(inspector.GetPoseInFrame(geometry), shape, rgba))
        return Link(name, tuple(visual), tuple(collision), _inertia(body))

    def _read_joint(self, joint: DrakeJoint, name: str) -> None:
        kind = _KINDS.get(joint.type_name(), joint.type_name())
        parent, child = self._name(joint.parent_body()), self._name(joint.child_body())
        X_PF = joint.frame_on_parent().GetFixedPoseInBodyFrame()
        X_MC = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
        if kind == "fixed" and parent == WORLD:
            parent, X_PF = self.stand(child, X_PF @ X_MC, mounted=True)
            X_MC = RigidTransform()
        read = Joint(name, kind, parent, child, X_PF)
        if kind in ("revolute", "prismatic"):
            (lower,) = joint.position_lower_limits()
            (upper,) = joint.position_upper_limits()
            turns = kind == "revolute"
            mimic, multiplier, offset = self._mimics.get(name, ("", 1.0, 0.0))
            read = replace(
                read,
                kind="continuous" if turns and not np.isfinite(lower) else kind,
                axis=joint.revolute_axis() if turns else joint.translation_axis(),
                lower=float(lower),
                upper=float(upper),
                effort=self._efforts.get(joint.index()),
                velocity=float(joint.velocity_upper_limits()[0]),
                damping=float(joint.default_damping_vector()[0]),
                mimic=mimic,
                multiplier=multiplier,
                offset=offset,
            )
        self.add_joint(read, X_MC)

    def _frames(
        self, instances, joints: Sequence[DrakeJoint]
    ) -> Iterator[tuple[str, str, RigidTransform]]:
        """The file's frames: of each its link, its name and its pose there."""
        of_joints = {
            frame.index()
            for joint in joints
            for frame in (joint.frame_on_parent(), joint.frame_on_child())
        }
        for instance in instances:
            for index in self._plant.GetFrameIndices(instance):
                frame: Frame = self._plant.get_frame(index)
                name, link = frame.name(), self._name(frame.body())
                hidden = name.startswith("__") or index in of_joints
                # The world is no link of a robot that does not stand in it.
                if not hidden and not frame.is_body_frame() and link in self.links:
                    yield link, name, frame.GetFixedPoseInBodyFrame()

    def _loop(self, robot: SourceRobot, name: str, joint: DrakeJoint) -> Loop:
        """The joints between two links that a joint ties together; a note tells if
        the chain is open where they are locked unless somebody says otherwise."""
        nearest = {n: min(max(j.lower, 0.0), j.upper) for n, j in robot.joints.items()}
        X = robot.poses(nearest)
        p_F, p_M = (
            X[self._name(frame.body())].multiply(
                frame.GetFixedPoseInBodyFrame().translation()
            )
            for frame in (joint.frame_on_parent(), joint.frame_on_child())
        )
        gap = float(np.linalg.norm(p_F - p_M))
        if gap > _OPEN and joint.type_name() != "prismatic":
            self.notes.append(
                f"{name} closes a chain, which gapes by {1e3 * gap:.0f} mm with its "
                "joints nearest to zero: give them positions in locked that close it"
            )
        ends = self._name(joint.parent_body()), self._name(joint.child_body())
        return Loop(name, tuple(j.name for j in robot.between(*ends)))


def _unique_names(elements: Sequence, model: str) -> dict:
    """Indices of bodies or joints to their names, with that of the nested model where
    two have the same."""
    count = Counter(element.name() for element in elements)
    return {
        element.index(): element.name()
        if count[element.name()] == 1
        else element.scoped_name()
        .get_full()
        .removeprefix(f"{model}::")
        .replace("::", "_")
        for element in elements
    }


def _inertia(body: RigidBody) -> Inertia | None:
    """A link's mass and central inertia; None where the file gives none."""
    M_L = body.default_spatial_inertia()
    mass, p_LC = M_L.get_mass(), M_L.get_com()
    moments = M_L.Shift(p_LC).CalcRotationalInertia().CopyToFullMatrix3()
    # What SDF says of a link without an inertia.
    if mass == 1.0 and not p_LC.any() and np.array_equal(moments, np.eye(3)):
        return None
    return Inertia(mass, RigidTransform(p_LC), moments)
