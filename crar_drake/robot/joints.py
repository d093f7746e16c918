"""The joints of a plant: names, units, speed limits, and those of a description; which
of its positions and velocities are controlled, and which prescribed."""

import math
from collections.abc import Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, PrismaticJoint, RevoluteJoint

from crar_drake.errors import ModelError
from crar_drake.robot.description import RobotDescription, find_joint

# No rest posture is farther beyond a limit: it is in degrees [rad].
_HALF_A_TURN = math.pi


def names_by_joint(plant: MultibodyPlant, *, of_positions: bool = False) -> list[str]:
    """Per velocity (or position) the joint's name; scoped where two models share it."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    plain = [joint.name() for joint in joints]
    names = [""] * (plant.num_positions() if of_positions else plant.num_velocities())
    for joint in joints:
        name = joint.name()
        if plain.count(name) > 1:
            name = f"{plant.GetModelInstanceName(joint.model_instance())}::{name}"
        # A joint's positions have names of their own only where they are others.
        if of_positions and joint.num_positions() != joint.num_velocities():
            start, suffixes = joint.position_start(), joint.position_suffix
            count = joint.num_positions()
        else:
            start = joint.position_start() if of_positions else joint.velocity_start()
            count, suffixes = joint.num_velocities(), joint.velocity_suffix
        for i in range(count):
            names[start + i] = name + (f".{suffixes(i)}" if count > 1 else "")
    return names


def check_described_joints(
    plant: MultibodyPlant, description: RobotDescription
) -> None:
    """Welds have no position to prescribe or to rest in, others not just one."""
    for name in description.prescribed_joints:
        if not find_joint(plant, name).num_velocities():
            raise ModelError(
                f"robot {description.name}: prescribed_joints: {name!r} is fixed; "
                "leave it out"
            )
    for name, value in description.rest_posture.items():
        joint = find_joint(plant, name)
        positions = joint.num_positions()
        if positions != 1 or not np.isfinite(value):
            raise ModelError(
                f"robot {description.name}: rest_posture: {name}: {value} for a "
                f"joint with {positions} positions; give finite values, to joints "
                "with one"
            )
        lower, upper = (
            joint.position_lower_limits()[0],
            joint.position_upper_limits()[0],
        )
        beyond = max(lower - value, value - upper)
        if isinstance(joint, RevoluteJoint) and beyond > _HALF_A_TURN:
            raise ModelError(
                f"robot {description.name}: rest_posture: {name}: {value:g} rad is far "
                f"beyond its limits, {lower:g} to {upper:g} rad; give radians (of "
                f"{value:g} degrees: {math.radians(value):.3f})"
            )


def joint_units(plant: MultibodyPlant, names: Sequence[str]) -> list[str]:
    """(n,) "m" for each joint that slides, "rad" for each that turns; all have one
    position."""
    kinds = [find_joint(plant, name).type_name() for name in names]
    return ["m" if kind == PrismaticJoint.kTypeName else "rad" for kind in kinds]


def speed_limits(plant: MultibodyPlant, description: RobotDescription) -> np.ndarray:
    """(nv,) largest speed of each velocity, inf where there is none [rad/s or m/s].

    Args:
        plant: finalized. Of two different limits of a joint the smaller magnitude
            counts; 0 says that none is stated.
        description: its `velocity_limits` count instead, for the joints they name.

    Raises:
        ModelError: it names a joint that does not exist or is fixed.
    """
    limits = np.minimum(
        np.abs(plant.GetVelocityLowerLimits()), np.abs(plant.GetVelocityUpperLimits())
    )
    limits[limits == 0.0] = np.inf  # what many exporters write for "unknown"
    for name, limit in description.velocity_limits.items():
        try:
            joint = find_joint(plant, name)
        except ModelError as error:
            raise ModelError(
                f"robot {description.name}: velocity_limits: {error}"
            ) from error
        if not joint.num_velocities():
            raise ModelError(
                f"robot {description.name}: velocity_limits: {name!r} is fixed; "
                "leave it out"
            )
        start = joint.velocity_start()
        limits[start : start + joint.num_velocities()] = limit
    return limits


def find_places(
    plant: MultibodyPlant, prescribed: Sequence[Joint], *, of_positions: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Where joints are in v, or in q: all others, and the prescribed in their order.

    Args:
        plant: finalized.
        prescribed: joints whose motion is known.
        of_positions: whether the places are those in q.
    """
    spans = [
        (joint.position_start(), joint.num_positions())
        if of_positions
        else (joint.velocity_start(), joint.num_velocities())
        for joint in prescribed
    ]
    found = [start + i for start, count in spans for i in range(count)]
    every = plant.num_positions() if of_positions else plant.num_velocities()
    others = np.setdiff1d(np.arange(every), found)
    return others, np.array(found, dtype=int)
