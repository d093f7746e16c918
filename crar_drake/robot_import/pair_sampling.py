"""Which pairs of links are worth watching, by sampling configurations."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.equations.capsule_distances import capsule_distances
from crar_drake.robot_import.capsule_fitting import FittedCapsule

SAMPLES = 4000
CLEAR = 0.005  # [m] that a pair keeps in the rest posture
_NEAR = 0.02  # [m]; a pair that never came nearer than this cannot meet
_ALWAYS = 0.95  # share of samples


@dataclass(frozen=True)
class SampledPairs:
    """What sampling found, in the words of MoveIt's setup assistant.

    Attributes:
        watched: pairs that can meet.
        least: smallest distance that each of them was sampled at [m].
        overlapping: pairs that are in contact (or nearly) in the rest posture, or
            are near while those of the other side are in contact.
        always: pairs in contact in nearly every configuration.
        never: number of pairs that met in no configuration.
    """

    watched: list[list[str]]
    least: list[float]
    overlapping: list[list[str]]
    always: list[list[str]]
    never: int


class Gaps:
    """Distances between the capsules of pairs of links."""

    def __init__(
        self,
        capsules: Mapping[str, Sequence[FittedCapsule]],
        pairs: Sequence[tuple[str, str]],
    ) -> None:
        """
        Args:
            capsules: link to its shapes, in its frame.
            pairs: of links that have some.
        """
        ends = [(name, c) for name, of_link in capsules.items() for c in of_link]
        first: dict[str, list[int]] = {name: [] for name in capsules}
        for index, (name, _) in enumerate(ends):
            first[name].append(index)
        rows = [
            (index, i, j)
            for index, (a, b) in enumerate(pairs)
            for i in first[a]
            for j in first[b]
        ]
        of_pair, self._i, self._j = np.array(rows, dtype=int).reshape(-1, 3).T
        self._starts = np.searchsorted(of_pair, np.arange(len(pairs)))
        self._p_L = {
            name: np.array([[c.p_L0, c.p_L1] for c in of_link])
            for name, of_link in capsules.items()
            if of_link
        }
        self._radius = np.array([c.radius for _, c in ends])

    def distances(self, poses: Mapping[str, RigidTransform]) -> np.ndarray:
        """(N,) of each pair, with the links at some poses [m]."""
        p = np.concatenate(
            [
                p_L @ poses[name].rotation().matrix().T + poses[name].translation()
                for name, p_L in self._p_L.items()
            ]
        )
        i, j, radius = self._i, self._j, self._radius
        d, *_ = capsule_distances(
            p[i, 0], p[i, 1], radius[i], p[j, 0], p[j, 1], radius[j]
        )
        return np.minimum.reduceat(d, self._starts)


def sample_pairs(
    plant: MultibodyPlant,
    capsules: Mapping[str, Sequence[FittedCapsule]],
    rest: np.ndarray,
    adjacent: set[frozenset[str]],
    samples: int = SAMPLES,
    twins: Mapping[str, str] | None = None,
) -> SampledPairs:
    """Samples joint positions uniformly within their limits.

    Args:
        plant: finalized.
        capsules: link to its shapes, in its frame; the order of the pairs.
        rest: (nq,) the rest posture.
        adjacent: pairs that a joint connects, which always touch.
        samples: number of configurations.
        twins: link to the same one of the robot's other side, which is treated alike
            although its capsules are fitted a little otherwise.
    """
    links = [name for name in capsules if capsules[name]]
    bodies = {name: plant.GetBodyByName(name) for name in links}
    welded = {
        name: {int(b.index()) for b in plant.GetBodiesWeldedTo(bodies[name])}
        for name in links
    }
    candidates = [
        (a, b)
        for a, b in itertools.combinations(links, 2)
        if frozenset((a, b)) not in adjacent and int(bodies[b].index()) not in welded[a]
    ]
    gaps = Gaps(capsules, candidates)
    context = plant.CreateDefaultContext()

    def distances(q: np.ndarray) -> np.ndarray:
        plant.SetPositions(context, q)
        return gaps.distances(
            {name: plant.EvalBodyPoseInWorld(context, bodies[name]) for name in links}
        )

    if not candidates:
        return SampledPairs([], [], [], [], 0)
    at_rest = distances(rest)
    rng = np.random.default_rng(0)
    lower = np.maximum(plant.GetPositionLowerLimits(), -np.pi)
    upper = np.minimum(plant.GetPositionUpperLimits(), np.pi)
    least = at_rest.copy()
    contacts = np.zeros(len(candidates))
    for q in rng.uniform(lower, upper, size=(samples, len(lower))):
        d = distances(q)
        least = np.minimum(least, d)
        contacts += d < 0.0
    touching = {
        frozenset((twins or {}).get(link, link) for link in pair)
        for pair, d in zip(candidates, at_rest, strict=True)
        if d < CLEAR
    }
    watched, smallest, overlapping, always, never = [], [], [], [], 0
    for index, pair in enumerate(candidates):
        alike = frozenset(pair) in touching and at_rest[index] < _NEAR
        if at_rest[index] < CLEAR or alike:
            overlapping.append(list(pair))
        elif contacts[index] > _ALWAYS * samples:
            always.append(list(pair))
        elif least[index] > _NEAR:
            never += 1
        else:
            watched.append(list(pair))
            smallest.append(float(least[index]))
    return SampledPairs(watched, smallest, overlapping, always, never)
