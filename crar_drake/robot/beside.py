"""A robot's model beside other things in a plant: scoped names, filters of contact."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import yaml
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from crar_drake.errors import ModelError
from crar_drake.robot.description import (
    GROUND,
    RobotDescription,
    check_model,
    find_body,
    model_parser,
    place_robot,
)


def add_robot_beside(
    plant: MultibodyPlant,
    description: RobotDescription,
    prefix: str = "",
    X_WB: RigidTransform | None = None,
) -> tuple[RobotDescription, list[ModelInstanceIndex]]:
    """Parses a robot's model into a plant that may have other things, and places it.

    Its model instance is named after the description, or as its model directives say.
    Links of its model that it does not watch against each other are left out of
    contact.

    Args:
        prefix: of the names of its model instances.
        X_WB: pose of its base in the world; by default that of the description.

    Returns:
        The description with its names as they are in the plant; and the model instances
        that were added.

    Raises:
        ModelError: the model file cannot be parsed, there is a model instance of that
            name, or as `place_robot`.
    """
    check_model(description)
    if X_WB is not None and not description.base:
        raise ModelError(
            f"robot {description.name}: its model welds itself to the world; leave "
            "X_WB out, or change the model"
        )
    X_WB = description.rest_pose() if X_WB is None else X_WB
    try:
        directives = _directives(description, prefix)
        parser = model_parser(plant, description)
        instances = parser.AddModelsFromString(directives, "dmd.yaml")
    except RuntimeError as error:
        hint = "; give another prefix" if "already" in str(error) else ""
        raise ModelError(f"{_model(description)}: {error}{hint}") from error
    description = _scoped(plant, description, prefix, instances)
    place_robot(plant, description, X_WB)
    return description, instances


def _model(description: RobotDescription) -> Path:
    return (Path(description.folder) / description.model).absolute()


def _is_directives(description: RobotDescription) -> bool:
    """Whether its model names model instances of its own."""
    return description.model.endswith((".dmd.yaml", ".dmd.yml"))


def _joined(prefix: str, name: str) -> str:
    return f"{prefix}::{name}" if prefix else name


def _directives(description: RobotDescription, prefix: str) -> str:
    """Model directives that add the robot's model, under a prefix, and filters for the
    pairs of its links that it does not watch."""
    uri, own = f"file://{_model(description)}", _is_directives(description)
    if own:
        added = {"file": uri} | ({"model_namespace": prefix} if prefix else {})
        steps = [{"add_directives": added}]
        if prefix:
            steps.insert(0, {"add_model_instance": {"name": prefix}})
    else:
        name = _joined(prefix, description.name)
        steps = [{"add_model": {"name": name, "file": uri}}]
    alone = MultibodyPlant(0.0)
    parsed = model_parser(alone, description).AddModels(str(_model(description)))
    outside = {GROUND, *description.environment}
    watched = {
        frozenset(find_body(alone, name).index() for name in pair)
        for pair in description.pairs
        if not outside & set(pair)
    }
    # A link is a group of its own, which leaves out those before it.
    links = [index for instance in parsed for index in alone.GetBodyIndices(instance)]
    for i, index in enumerate(links):
        body = alone.get_body(index)
        instance = description.name
        if own:
            instance = alone.GetModelInstanceName(body.model_instance())
        left_out = [
            f"link_{k}"
            for k, other in enumerate(links[:i])
            if frozenset((index, other)) not in watched
        ]
        group = {
            "name": f"link_{i}",
            "members": [f"{_joined(prefix, instance)}::{body.name()}"],
            "ignored_collision_filter_groups": left_out,
        }
        steps.append({"add_collision_filter_group": group})
    return yaml.safe_dump({"directives": steps})


def _scoped(
    plant: MultibodyPlant,
    description: RobotDescription,
    prefix: str,
    instances: list[ModelInstanceIndex],
) -> RobotDescription:
    """The description with the names that its links, frames and joints have now."""
    has = plant.HasBodyNamed, plant.HasFrameNamed, plant.HasJointNamed

    def scoped(name: str) -> str:
        if name in description.environment:
            return f"{prefix}_{name}" if prefix else name
        if "::" in name and _is_directives(description):
            return _joined(prefix, name)
        element = name.rpartition("::")[2]
        for instance in instances:
            if any(named(element, instance) for named in has):
                return f"{plant.GetModelInstanceName(instance)}::{element}"
        return name

    def by_name(values: dict) -> dict:
        return {scoped(name): value for name, value in values.items()}

    points = description.task_frames.items()
    return replace(
        description,
        base=scoped(description.base),
        pairs=[[scoped(name) for name in pair] for pair in description.pairs],
        environment=by_name(description.environment),
        prescribed_joints=by_name(description.prescribed_joints),
        rest_posture=by_name(description.rest_posture),
        velocity_limits=by_name(description.velocity_limits),
        soles=by_name(description.soles),
        task_frames={point: scoped(frame) for point, frame in points},
    )
