"""Which links of a plant a judge asks for: those that more than one joint parts."""

import itertools
from collections.abc import Sequence

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex


def pairs_beyond_one_joint(
    plant: MultibodyPlant, bodies: Sequence[BodyIndex]
) -> list[tuple[int, int]]:
    """Pairs of links that more than one joint is between.

    Links that are welded to each other are one: their shapes overlap as they are
    built. Two links that one joint connects meet at that joint.

    Returns:
        Pairs of indices i < j of `bodies`. Links without any chain of joints between
        them are pairs, too.
    """
    welded = _welded(plant)
    joined = set()
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        ends = (joint.parent_body().index(), joint.child_body().index())
        joined.add(frozenset(welded[int(end)] for end in ends))
    return [
        (i, j)
        for i, j in itertools.combinations(range(len(bodies)), 2)
        if (pair := frozenset(welded[int(bodies[k])] for k in (i, j))) not in joined
        and len(pair) == 2
    ]


def _welded(plant: MultibodyPlant) -> dict[int, int]:
    """Each body to the first of those that it is welded to."""
    first = {}
    for i in range(plant.num_bodies()):
        group = plant.GetBodiesWeldedTo(plant.get_body(BodyIndex(i)))
        first[i] = min(int(body.index()) for body in group)
    return first
