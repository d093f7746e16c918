"""A robot's own SDF: read by Drake, as a tree of links.

Drake parses the file, so that poses, frames, nested models, includes and what an axis
is expressed in mean here what they mean there.

A joint whose frame is beside its child's origin gets a link without geometry, as have
the file's frames.
"""

import tempfile
from collections import Counter
from collections.abc import Sequence
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
    Inertia,
    Joint,
    Link,
    Loop,
    Shape,
    SourceRobot,
    drake_shape,
    weld,
)
from crar_drake.robot_import.source_urdf import check_tree
from crar_drake.robot_import.tree_reader import TreeReader

# Drake's joints, as a URDF calls them.
_KINDS = {"weld": "fixed", "ball_rpy": "ball", "quaternion_floating": "floating"}
_TINY = 1e-9  # [m]
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
        inspector = scene_graph.model_inspector()
        robot = _Reader(path, plant, inspector, copies.mimics).robot()
        return replace(robot, notes=(*copies.notes, *robot.notes))


class _Reader(TreeReader):
    """Turns a plant, which is not finalized, into links and joints."""

    def __init__(
        self,
        path: Path,
        plant: MultibodyPlant,
        inspector: SceneGraphInspector,
        mimics: dict[str, tuple[str, float, float]],
    ) -> None:
        super().__init__(path, [])
        self._plant, self._inspector, self._mimics = plant, inspector, mimics
        self._instances = [*map(ModelInstanceIndex, range(plant.num_model_instances()))]
        actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
        self._efforts = {a.joint().index(): a.effort_limit() for a in actuators}

    def robot(self) -> SourceRobot:
        """All of it."""
        plant = self._plant
        model = self._select_model()
        instances = [i for i in self._instances if self._model_of(i) == model]
        indices = (i for each in instances for i in plant.GetBodyIndices(each))
        bodies = [*map(plant.get_body, indices)]
        indices = (i for each in instances for i in plant.GetJointIndices(each))
        joints = [*map(plant.get_joint, indices)]
        self._bodies = _unique_names(bodies, model)
        self._taken |= set(self._bodies.values())
        self._bodies[plant.world_body().index()] = WORLD
        names = self._joint_names = _unique_names(joints, model)
        if any(self._name(joint.parent_body()) == WORLD for joint in joints):
            self._links[WORLD] = Link(WORLD)
        for body in bodies:
            self._add_link(body)
        loops = []
        for joint in joints:
            if self._is_carried(joint):
                loops.append((names[joint.index()], joint))
            else:
                self._add_joint(joint, names[joint.index()])
        self._add_frames(instances, joints)
        check_tree(read := self._tree())
        self._set_upright(read.root)
        robot = self._tree()  # another one, if a link was added that carries the root
        return replace(
            robot,
            name=robot_name(model, self._path),
            loops=tuple(self._loop(robot, *each) for each in loops),
            notes=tuple(self._notes),
        )

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
            raise ModelError(f"{self._path}: it has no joint that turns or slides")
        if len(moving) > 1:
            which = ", ".join(f"{name} ({n} joints)" for name, n in moving.items())
            raise ModelError(
                f"{self._path}: several of its models move: {which}; import a file "
                "that has, or includes, the one that is meant alone"
            )
        (model,) = moving
        names = dict.fromkeys(map(self._model_of, with_bodies))
        self._note_foreign([name for name in names if name != model])
        if plant.num_force_elements() > 1:
            self._notes.append("left out of the joints: springs")
        return model

    # --- links and joints -----------------------------------------------------------

    def _add_link(self, body: RigidBody) -> None:
        name, shapes = self._name(body), {"visual": [], "collision": []}
        frame = self._plant.GetBodyFrameIdOrThrow(body.index())
        for geometry in self._inspector.GetGeometries(frame, Role.kIllustration):
            own = self._inspector.GetName(geometry).rpartition("::")[2]
            kind = "collision" if own.startswith(COLLISION) else "visual"
            shape = self._shape(geometry)
            if shape is not None:
                shapes[kind].append(shape)
            else:
                self._notes.append(
                    f"link {name}: {own.removeprefix(COLLISION)}, which is no mesh, "
                    "box, cylinder, sphere, capsule or ellipsoid, is left out"
                )
        self._links[name] = Link(
            name, tuple(shapes["visual"]), tuple(shapes["collision"]), _inertia(body)
        )

    def _shape(self, geometry) -> Shape | None:
        X_LG = self._inspector.GetPoseInFrame(geometry)
        looks = self._inspector.GetIllustrationProperties(geometry)
        rgba = None
        if looks.HasProperty("phong", "diffuse"):
            colour = looks.GetProperty("phong", "diffuse")
            rgba = colour.r(), colour.g(), colour.b(), colour.a()
        return drake_shape(X_LG, self._inspector.GetShape(geometry), rgba)

    def _is_carried(self, joint: DrakeJoint) -> bool:
        """Whether another joint carries its child already: it closes a chain."""
        child = self._name(joint.child_body())
        return any(known.child == child for known in self._joints.values())

    def _add_joint(self, joint: DrakeJoint, name: str) -> None:
        parent, child = (
            self._name(body) for body in (joint.parent_body(), joint.child_body())
        )
        X_PF = joint.frame_on_parent().GetFixedPoseInBodyFrame()
        X_MC = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
        kind = joint.type_name()
        if kind not in ("revolute", "prismatic"):
            other = weld(name, parent, child, X_PF @ X_MC)
            self._joints[name] = replace(other, kind=_KINDS.get(kind, kind))
            return
        (lower,) = joint.position_lower_limits()
        (upper,) = joint.position_upper_limits()
        if kind == "revolute":
            axis = joint.revolute_axis()
            # Where the child's origin is on the axis, it may as well be the joint's.
            beside = np.linalg.norm(np.cross(axis, X_MC.translation())) > _TINY
        else:
            axis, beside = joint.translation_axis(), False
        if beside:
            stand_in = self._add_bare_link(f"{name}_link")
            self._weld(stand_in, child, X_MC)
            child, X_MC = stand_in, RigidTransform()
        turns = "revolute" if np.isfinite(lower) else "continuous"
        self._joints[name] = Joint(
            name,
            turns if kind == "revolute" else kind,
            parent,
            child,
            X_PF @ X_MC,
            X_MC.rotation().inverse() @ axis,
            float(lower),
            float(upper),
            self._efforts.get(joint.index()),
            float(joint.velocity_upper_limits()[0]),
            float(joint.default_damping_vector()[0]),
            *self._mimics.get(name, ()),
        )

    def _add_frames(self, instances, joints: Sequence[DrakeJoint]) -> None:
        """The file's frames become links without geometry, which frames can name."""
        of_joints = {
            frame.index()
            for joint in joints
            for frame in (joint.frame_on_parent(), joint.frame_on_child())
        }
        for instance in instances:
            for index in self._plant.GetFrameIndices(instance):
                frame: Frame = self._plant.get_frame(index)
                name = frame.name()
                hidden = name.startswith("__") or index in of_joints
                link = self._name(frame.body())
                # The world is no link of a robot that does not stand in it.
                if hidden or frame.is_body_frame() or link not in self._links:
                    continue
                name = self._add_bare_link(name, "_frame")
                self._weld(link, name, frame.GetFixedPoseInBodyFrame())

    def _set_upright(self, root: str) -> None:
        """A root link is taken to have z up. If it is turned in the world a link that
        is not carries it."""
        if root == WORLD:
            carried = [j for j in self._joints.values() if j.parent == WORLD]
            turned = [(j.child, j.X_PC, j.name) for j in carried if j.kind == "fixed"]
        else:
            (index,) = [index for index, name in self._bodies.items() if name == root]
            body = self._plant.get_body(index)
            turned = [(root, self._plant.GetDefaultFloatingBaseBodyPose(body), "")]
        for link, X_WL, joint in turned:
            R_WL = RigidTransform(X_WL.rotation())
            if R_WL.IsNearlyIdentity(1e-6):
                continue
            upright = self._add_bare_link(f"{link}_upright")
            if joint:
                X_WU = RigidTransform(X_WL.translation())
                self._joints[joint] = weld(joint, WORLD, upright, X_WU)
            self._weld(upright, link, R_WL)

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
            self._notes.append(
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
