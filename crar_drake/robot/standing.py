"""A robot that stands still on its soles, as the law sees it."""

from dataclasses import replace

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint

from crar_drake.errors import ModelError
from crar_drake.robot.description import (
    GROUND,
    RobotDescription,
    find_body,
    robot_diagram,
)
from crar_drake.robot.joints import names_by_joint


def standing_description(description: RobotDescription) -> RobotDescription:
    """The same robot with its base and legs still: its soles stand, the rest moves.

    Its base is welded where it rests, all joints between the base and a sole hold.
    Pairs with the ground, and pairs that cannot move against each other any more, are
    left out.

    Args:
        description: of a robot with soles and a base that floats.

    Raises:
        ModelError: it has no soles, none of them is carried by the base, or its base
            does not float.
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
    _, plant, _ = robot_diagram(description)
    names = names_by_joint(plant)
    legs = [names[joint.velocity_start()] for joint in leg_joints(plant, description)]
    held = description.prescribed_joints | dict.fromkeys(legs, "hold")
    carriers = _carriers(plant)

    def carrier(link: str) -> BodyIndex:
        """The first link from this one on that moves; the base if none does."""
        body = find_body(plant, link)
        while body.name() != description.base:
            joint = carriers.get(body.index())
            if joint is None:  # the world, or what is welded to it
                return find_body(plant, description.base).index()
            if joint.num_velocities() and names[joint.velocity_start()] not in held:
                break
            body = joint.parent_body()
        return body.index()

    pairs = [
        [a, b]
        for a, b in description.pairs
        if GROUND not in (a, b) and carrier(a) != carrier(b)
    ]
    return replace(
        description, root="fixed", prescribed_joints=held, pairs=pairs, ground=None
    )


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
