"""A robot that stands still on its soles, as the law sees it."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint
from pydrake.systems.framework import DiagramBuilder

from crar_drake.errors import ModelError
from crar_drake.robot.description import (
    GROUND,
    RobotDescription,
    StandingDescription,
    add_robot,
    find_body,
)
from crar_drake.robot.joints import names_by_joint
from crar_drake.robot.moving_pelvis import SLIDES
from crar_drake.robot.pelvis_box import moving_pelvis

# How fast a base that moves may be along each axis [m/s].
_SPEED = 0.3


def standing_description(
    description: RobotDescription, pelvis: Mapping[str, Sequence[float]] | None = None
) -> StandingDescription:
    """The same robot with its base and legs still: its soles stand, the rest moves.

    Its base is welded where it rests, all joints between the base and a sole hold.
    Pairs with the ground, and pairs that cannot move against each other any more, are
    left out.

    With a box for its pelvis the base slides in it instead, on three joints more
    (`SLIDES`). Legs are held on it and their capsules are so thick that those of the
    true legs, which follow the base, are inside; pairs of legs and base are left out,
    since they are apart in all of the box (`robot.pelvis_box`).

    Args:
        description: of a robot with soles and a base that floats.
        pelvis: "x", "y", "z" to the least and the largest place of the base along that
            axis of the world, from where it rests [m].

    Raises:
        ModelError: it has no soles, none of them is carried by the base, or its base
            does not float; or it could not stand in all of the box.
    """
    if not description.soles:
        raise ModelError(
            f"robot {description.name}: soles: there are none, so that it cannot "
            "stand; give link -> corners of its flat sole"
        )
    if description.root == "fixed":
        raise ModelError(
            f"robot {description.name}: root: fixed: its base is welded to the world "
            "and needs no feet; leave out standing (controller.balance alone keeps it "
            "from tipping), or take a whole body, whose root floats"
        )
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
    add_robot(plant, description)
    plant.Finalize()
    names = names_by_joint(plant)
    legs = [
        [
            names[joint.velocity_start()]
            for joint in leg_joints(plant, replace(description, soles={link: sole}))
        ]
        for link, sole in description.soles.items()
    ]
    held = description.prescribed_joints | dict.fromkeys(sum(legs, []), "hold")
    carriers = _carriers(plant)

    def carrier(link: str) -> BodyIndex:
        """The first link from this one on that moves; the base if none does."""
        body = find_body(plant, link)
        while body.name() != description.base:
            joint = carriers.get(body.index())
            if joint is None:  # the world, or what is welded to it
                still = pelvis is None
                return find_body(plant, description.base if still else link).index()
            if joint.num_velocities() and names[joint.velocity_start()] not in held:
                break
            body = joint.parent_body()
        return body.index()

    pairs, apart = [], []
    for a, b in description.pairs:
        if GROUND not in (a, b):
            (apart if carrier(a) == carrier(b) else pairs).append([a, b])
    changed = {
        **{each.name: getattr(description, each.name) for each in fields(description)},
        **{"root": "fixed", "prescribed_joints": held, "pairs": pairs, "ground": None},
    }
    if pelvis is None:
        return StandingDescription(**changed)
    base = find_body(plant, description.base).index()
    moving = moving_pelvis(
        description,
        legs,
        [pair for pair in apart if carrier(pair[0]) == base],
        *np.array([pelvis[axis] for axis in "xyz"], dtype=float).T,
        _SPEED,
    )
    joints = moving.positions(moving.held[np.newaxis])[0]
    changed["rest_posture"] = description.rest_posture | dict(
        zip(moving.joints, joints.tolist(), strict=True)
    )
    changed["velocity_limits"] = description.velocity_limits | dict(
        zip(SLIDES, moving.speed.tolist(), strict=True)
    )
    return StandingDescription(**changed, pelvis=moving)


def leg_joints(plant: MultibodyPlant, description: RobotDescription) -> list[Joint]:
    """The joints between a robot's base and its soles, each once, from the soles up.

    Raises:
        ModelError: there is no such base or sole, or no joint between them.
    """
    carriers = _carriers(plant)
    found: dict[str, Joint] = {}
    for link in description.soles:
        body = find_body(plant, link)
        while body.name() != description.base:
            joint = carriers.get(body.index())
            if joint is None:
                raise ModelError(
                    f"robot {description.name}: soles: {link!r} is not carried by the "
                    f"base {description.base!r}"
                )
            if joint.num_velocities():
                found[joint.name()] = joint
            body = joint.parent_body()
    if not found:
        raise ModelError(
            f"robot {description.name}: soles: no joint is between the base "
            f"{description.base!r} and {', '.join(description.soles)}"
        )
    return list(found.values())


def _carriers(plant: MultibodyPlant) -> dict[BodyIndex, Joint]:
    """The joint that carries each link."""
    joints = map(plant.get_joint, plant.GetJointIndices())
    return {joint.child_body().index(): joint for joint in joints}
