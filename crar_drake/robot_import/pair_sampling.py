"""Which pairs of links are worth watching, by sampling configurations."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.equations.capsule_distances import capsule_distances
from crar_drake.robot_import.capsule_fitting import FittedCapsule

SAMPLES = 4000
_CLEAR = 0.005  # [m] that a pair keeps in the rest posture
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
    ends = [(name, c) for name in links for c in capsules[name]]
    first: dict[str, list[int]] = {name: [] for name in links}
    for index, (name, _) in enumerate(ends):
        first[name].append(index)
    rows = [
        (index, i, j)
        for index, (a, b) in enumerate(candidates)
        for i in first[a]
        for j in first[b]
    ]
    of_pair, i, j = np.array(rows, dtype=int).reshape(-1, 3).T
    starts = np.searchsorted(of_pair, np.arange(len(candidates)))
    p_L = {name: np.array([[c.p_L0, c.p_L1] for c in capsules[name]]) for name in links}
    radius = np.array([c.radius for _, c in ends])
    context = plant.CreateDefaultContext()

    def distances(q: np.ndarray) -> np.ndarray:
        plant.SetPositions(context, q)
        p_W = []
        for name in links:
            X = plant.EvalBodyPoseInWorld(context, bodies[name])
            p_W.append(p_L[name] @ X.rotation().matrix().T + X.translation())
        p_W = np.concatenate(p_W)
        d, *_ = capsule_distances(
            p_W[i, 0], p_W[i, 1], radius[i], p_W[j, 0], p_W[j, 1], radius[j]
        )
        return np.minimum.reduceat(d, starts)

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
        if d < _CLEAR
    }
    watched, smallest, overlapping, always, never = [], [], [], [], 0
    for index, pair in enumerate(candidates):
        alike = frozenset(pair) in touching and at_rest[index] < _NEAR
        if at_rest[index] < _CLEAR or alike:
            overlapping.append(list(pair))
        elif contacts[index] > _ALWAYS * samples:
            always.append(list(pair))
        elif least[index] > _NEAR:
            never += 1
        else:
            watched.append(list(pair))
            smallest.append(float(least[index]))
    return SampledPairs(watched, smallest, overlapping, always, never)
