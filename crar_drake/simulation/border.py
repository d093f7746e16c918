"""What of a plant a controller sees, and what a user has to know of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex

from crar_drake.errors import ModelError, few, tell
from crar_drake.robot.collision_pairs import WatchedPairs, shape_axis
from crar_drake.robot.control_plant import Part
from crar_drake.robot.description import RobotDescription, find_body
from crar_drake.robot.model import ControlModel
from crar_drake.robot.reach import lengths_of_slides
from crar_drake.robot.task import Task, check_tasks

Pair = tuple[BodyIndex, BodyIndex]
Instances = ModelInstanceIndex | Sequence[ModelInstanceIndex]

# More pairs than these are more than anybody reads in a warning.
_MOST = 4


class Border:
    """A part of a plant as one controller takes it.

    Attributes:
        instances: of the robot, sorted.
        locked: places in q of joints that count as locked, to defaults [rad or m].
        name: of the robot, its model instances.
        said: what a user has to know, a line each.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        model_instance: Instances | None,
        strict: bool,
    ) -> None:
        """Args, errors: as of `AddCrarController`."""
        for name, given, kind in (
            ("plant", plant, MultibodyPlant),
            ("scene_graph", scene_graph, SceneGraph),
        ):
            if not isinstance(given, kind):
                raise ModelError(f"{name} cannot be a {type(given).__name__}")
        if not plant.is_finalized():
            raise ModelError("the plant is not finalized: call plant.Finalize() first")
        self.instances = sorted(_instances(plant, model_instance))
        self._plant, self._scene_graph, self._strict = plant, scene_graph, strict
        self._part = Part(plant, self.instances)
        self.name = ", ".join(map(plant.GetModelInstanceName, self.instances))
        rest = plant.GetDefaultPositions()
        self.locked = {i: rest[i] for i in self._part.locked}
        self.said: list[str] = []
        self._model: ControlModel | None = None

    def scoped(self, name: str) -> str:
        """A name with that of its model instance, if the robot alone has it."""
        plant = self._plant
        named = plant.HasBodyNamed, plant.HasFrameNamed, plant.HasJointNamed
        owners = [
            plant.GetModelInstanceName(instance)
            for instance in self._part.instances
            if "::" not in name and any(has(name, instance) for has in named)
        ]
        return f"{owners[0]}::{name}" if len(owners) == 1 else name

    def model(
        self,
        tasks: Sequence[Task],
        watch: Sequence[Sequence[str]] | None,
        prescribed: Sequence[str],
    ) -> ControlModel:
        """The control model; args, errors and warnings as of `AddCrarController`."""
        tasks, names = check_tasks(tasks), prescribed
        if isinstance(names, str) or not all(isinstance(name, str) for name in names):
            raise ModelError(f"prescribed: {names!r} must be a list of joints' names")
        description = RobotDescription(
            name=self.name,
            prescribed_joints={self.scoped(name): "hold" for name in names},
            task_frames={t.frame: self.scoped(t.frame) for t in tasks if t.frame},
        )

        def make(pairs: Sequence[Pair]) -> ControlModel:
            named = [[self._full_name(body) for body in pair] for pair in pairs]
            described = replace(description, pairs=named)
            of = self._plant, self._scene_graph, described, tasks
            model = ControlModel.FromPlant(*of, self._part)
            model.border = self
            return model

        def inside(model: ControlModel) -> np.ndarray:
            return model.signed_distances(model.rest_positions()) <= 0.0

        candidates = self._candidates(self._part.bodies)
        if watch is not None:
            pairs = [self._pair(pair) for pair in watch]
            self._model = model = make(pairs)
            self._say(
                [pair for pair, bad in zip(pairs, inside(model), strict=True) if bad],
                "are inside one another at rest; nothing is promised of them",
            )
            known = set(map(frozenset, pairs))
            self._say(
                [pair for pair in candidates if frozenset(pair) not in known],
                "can touch and are not watched; watch them, or exclude their contact "
                "by a collision filter",
            )
            return model
        examined, reason = self._examined(candidates)
        self._say(
            [pair for pair in candidates if pair not in examined],
            f"can touch and cannot be watched: {reason}",
        )
        model = make(examined)
        meet = inside(model)
        apart = [pair for pair, bad in zip(examined, meet, strict=True) if not bad]
        self._say(
            [pair for pair, bad in zip(examined, meet, strict=True) if bad],
            "meet at rest and are not watched; give shapes or default positions that "
            "leave room, or exclude their contact by a collision filter",
        )
        if not apart:
            raise ModelError(
                f"robot {self.name}: no pair of shapes is left to watch: none may "
                "touch by the plant's shapes and collision filters; give the links "
                "collision shapes, or watch=[] if nothing is to be kept apart"
            )
        self._model = make(apart) if meet.any() else model
        return self._model

    def can_touch(self, other: Border) -> bool:
        """Whether robots of two controllers may, by filters and how far they reach."""
        if other._plant is not self._plant:
            return False
        both = self._part.carried | other._part.carried
        meets = any(
            (a in self._part.carried) != (b in self._part.carried)
            for a, b in self._candidates(both, other._part)
        )
        if not meets:
            return False
        (p, r), (x, s) = _balls(self._model), _balls(other._model)
        apart = np.linalg.norm(p[:, None] - x, axis=2)
        return bool((apart < r[:, None] + s).any())

    def tell(self, line: str) -> None:
        """Warns of what a user has to know.

        Raises:
            ModelError: it is strict.
        """
        self.said.append(line)
        tell(f"robot {self.name}: {line}", self._strict)

    def _pair(self, names: Sequence[str]) -> Pair:
        two = not isinstance(names, str) and len(names) == 2
        if not two or not all(isinstance(name, str) for name in names):
            raise ModelError(
                f"watch: {names!r} is no pair; give a list of pairs of links, "
                '[["hand", "table"], ...]'
            )
        bodies = [find_body(self._plant, self.scoped(name)) for name in names]
        for body in bodies:
            if body.index() not in self._part.bodies:
                raise ModelError(
                    f"watch: link {body.name()!r} of "
                    f"{self._plant.GetModelInstanceName(body.model_instance())!r} "
                    "moves by itself; the controller sees its robot, what hangs on it, "
                    "and what is welded to the world"
                )
        return bodies[0].index(), bodies[1].index()

    def _candidates(self, bodies: Iterable[BodyIndex], *others: Part) -> list[Pair]:
        """The pairs of some bodies that may touch, and move against each other."""
        inspector, plant = self._scene_graph.model_inspector(), self._plant
        of = {
            shape: index
            for index in bodies
            for shape in plant.GetCollisionGeometriesForBody(plant.get_body(index))
        }
        found = {
            tuple(sorted((of[a], of[b])))
            for a, b in inspector.GetCollisionCandidates()
            if a in of and b in of
        }
        moved = [part.moved_by for part in (self._part, *others)]
        return sorted(
            (a, b) for a, b in found if any(by.get(a) != by.get(b) for by in moved)
        )

    def _examined(self, pairs: list[Pair]) -> tuple[list[Pair], str]:
        """Those whose distances are known, and why the last of the others' are not."""
        inspector, good, reason = self._scene_graph.model_inspector(), [], ""
        for pair in pairs:
            bodies = tuple(self._plant.get_body(index) for index in pair)
            try:
                WatchedPairs(self._plant, inspector, [bodies])
            except ModelError as error:
                reason = str(error)
            else:
                good.append(pair)
        return good, reason

    def _say(self, pairs: Sequence[Pair], what: str) -> None:
        if pairs:
            named = [" - ".join(self._plain(body) for body in pair) for pair in pairs]
            self.tell(f"{few(named, _MOST)} {what}")

    def _full_name(self, index: BodyIndex) -> str:
        return self._plant.get_body(index).scoped_name().get_full()

    def _plain(self, index: BodyIndex) -> str:
        name = self._plant.get_body(index).name()
        return (
            name if self._plant.NumBodiesWithName(name) == 1 else self._full_name(index)
        )


def _balls(model: ControlModel) -> tuple[np.ndarray, np.ndarray]:
    """Centres (N, 3) and radii (N,) of balls that a robot's shapes do not leave [m]."""
    plant, joints = model.plant, model.joints
    inspector, tree = model.scene_graph.model_inspector(), joints.tree
    step = np.linalg.norm(tree.fixed[:, 3, :3], axis=1)
    limits = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    farthest = np.maximum(*np.abs(limits))[tree.position]
    slide = lengths_of_slides(joints)
    slide[slide > 0.0] *= farthest[slide > 0.0]
    centres, radii = [], []
    for body in map(plant.get_body, map(BodyIndex, range(1, plant.num_bodies()))):
        frame, X_FB = joints.place(body)
        for shape in plant.GetCollisionGeometriesForBody(body) if frame else ():
            X_BG = inspector.GetPoseInFrame(shape).GetAsMatrix34()
            axis = shape_axis(inspector.GetShape(shape), X_BG)
            far = [np.linalg.norm(X_FB.multiply(end)) for end in axis.ends]
            radius, at = axis.radius + max(far) + slide[frame], frame
            while tree.parent[at]:
                radius, at = radius + step[at], tree.parent[at]
                radius += slide[at]
            centres.append(tree.fixed[at, 3, :3])
            radii.append(radius)
    return np.array(centres).reshape(-1, 3), np.array(radii)


def _instances(
    plant: MultibodyPlant, given: Instances | None
) -> list[ModelInstanceIndex]:
    """Those of the robot, as `AddCrarController` takes them."""
    every = map(ModelInstanceIndex, range(plant.num_model_instances()))
    moving = [i for i in every if plant.num_actuators(i)]
    if given is None:
        if len(moving) > 1:
            names = ", ".join(map(plant.GetModelInstanceName, moving))
            raise ModelError(
                f"model_instance: {names} have actuators; say which of them is the "
                "robot (or give a list, for one controller of several)"
            )
        if not moving:
            raise ModelError(
                "the plant has no actuator: a robot needs one at each joint "
                "(transmissions in a URDF)"
            )
        return moving
    if isinstance(given, ModelInstanceIndex | str):
        given = [given]
    if not given:
        raise ModelError("model_instance: [] is no robot; leave it out, or name one")
    for instance in given:
        if not isinstance(instance, ModelInstanceIndex):
            raise ModelError(
                f"model_instance: {instance!r} is none; give what AddRobot, "
                "Parser.AddModels or plant.GetModelInstanceByName returns"
            )
    return list(given)
