"""In which unit the positions of joints are."""

from __future__ import annotations

from collections.abc import Sequence

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint


def joint_units(plant: MultibodyPlant, names: Sequence[str]) -> list[str]:
    """(n,) "m" for each joint that slides, "rad" for each that turns.

    Args:
        plant: that has the joints.
        names: of joints with one position.
    """
    kinds = [plant.GetJointByName(name).type_name() for name in names]
    return ["m" if kind == PrismaticJoint.kTypeName else "rad" for kind in kinds]
