"""Which links of a plant a judge asks for: those that more than one joint parts."""

import itertools
from collections.abc import Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from crar_drake.robot.description import RobotDescription, find_joint, zero_positions

Pairs = list[tuple[int, int]]


def pairs_by_joints(
    plant: MultibodyPlant, bodies: Sequence[BodyIndex]
) -> tuple[Pairs, Pairs]:
    """Pairs of links that more than one joint is between, and those with one.

    Links that are welded to each other are one: their shapes overlap as they are
    built. Two links that one joint connects meet at that joint.

    Returns:
        Pairs of indices i < j of `bodies`. Links without any chain of joints between
        them are of the first kind, too.
    """
    welded = [
        min(int(each.index()) for each in plant.GetBodiesWeldedTo(plant.get_body(body)))
        for body in map(BodyIndex, range(plant.num_bodies()))
    ]
    joined = set()
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        ends = (joint.parent_body().index(), joint.child_body().index())
        joined.add(frozenset(welded[int(end)] for end in ends))
    beyond, one_joint = [], []
    for i, j in itertools.combinations(range(len(bodies)), 2):
        pair = frozenset(welded[int(bodies[k])] for k in (i, j))
        if len(pair) == 2:
            (one_joint if pair in joined else beyond).append((i, j))
    return beyond, one_joint


def postures_as_built(
    plant: MultibodyPlant, description: RobotDescription
) -> list[np.ndarray]:
    """(nq,) positions of the plant each: the rest posture, and zero. Meshes that meet
    in both do so as they are built."""
    limits = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    zero = np.clip(zero_positions(plant), *limits)
    rest = zero.copy()
    for name, value in description.rest_posture.items():
        rest[find_joint(plant, name).position_start()] = value
    return [rest, zero]
