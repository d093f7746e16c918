"""Links whose capsules meet where their meshes do not get closer ones.

A capsule that sticks out by 2 cm can touch another one where the meshes are 4 cm apart:
the pair then cannot be watched, if that is so at rest, or the joints between the links
lose much of their ranges. Such links are fitted again, with a smaller excess.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.robot_import.alarms import joints_between
from crar_drake.robot_import.capsule_fitting import Fit
from crar_drake.robot_import.import_report import ImportReport
from crar_drake.robot_import.meshes import Part
from crar_drake.robot_import.mirrored_fits import LinkFits
from crar_drake.robot_import.pair_sampling import (
    CLEAR,
    NEAR,
    PairDistances,
    candidate_pairs,
)
from crar_drake.robot_import.surface_distances import Surfaces

# What the excess is multiplied by, until it helps.
_SMALLER = (0.5, 0.25)
_MORE = 2  # times as many capsules as usual, at most
_SAMPLES = 400  # postures
_LOOKED_AT = 12  # of those in which capsules touch, by meshes
_LOST = 0.1  # share of the postures that a pair may lose
_AT_REST = 0.01  # [m] that meshes are apart which need not touch at rest


def tighten(
    plant: MultibodyPlant,
    robot,
    locked: Mapping[str, float],
    segments: Mapping[str, Sequence[Part]],
    rest: np.ndarray,
    adjacent: set[frozenset[str]],
    fits: LinkFits,
    report: ImportReport,
) -> bool:
    """Fits links again that stand in each other's way; whether there are any.

    Args:
        plant: finalized.
        robot: as it was read.
        locked: joint to the position at which it is welded [rad or m].
        segments: link to its real look, in its frame.
        rest: (nq,) the rest posture.
        adjacent: pairs that a joint connects, which always touch.
        fits: what fits.
        report: its fits are changed.
    """
    choices = report.choices

    def shown(changed: Mapping[str, Fit]) -> dict:
        own = {**report.fits, **changed}
        return {n: f.capsules for n, f in own.items() if n not in report.covered}

    pairs = [
        pair
        for pair in candidate_pairs(plant, shown({}), adjacent)
        if joints_between(robot, locked, *pair) > 1
    ]
    if choices.pairs is not None:
        asked = {frozenset(pair) for pair in choices.pairs}
        pairs = [pair for pair in pairs if frozenset(pair) in asked]
    if not pairs:
        return False
    lost = _Lost(plant, segments, rest)
    tightened: dict[str, float] = {}
    for pair in lost.in_the_way(shown({}), pairs):
        if lost.of(shown({}), pair) <= _LOST:
            continue  # an earlier one's links were the same
        best = lost.of(shown({}), pair)
        for links, smaller in ((ls, s) for s in _SMALLER for ls in (*zip(pair), pair)):
            found = fits.fit(
                links, smaller * choices.excess, _MORE * choices.most_capsules
            )
            new = {
                name: fit
                for name, fit in found.items()
                if fit is not None
                and name not in report.covered
                and fit.excess < report.fits[name].excess
            }
            if not new:
                continue
            left = lost.of(shown(new), pair)
            if left <= _LOST or (smaller == _SMALLER[-1] and left < 0.7 * best):
                report.fits |= new
                tightened |= {name: fit.excess for name, fit in new.items()}
                break
    if tightened:
        report.notes.append(
            "fitted more closely, since their capsules met others where meshes are "
            f"{1e3 * NEAR:.0f} mm apart, or at rest: "
            + ", ".join(
                f"{name} ({1e3 * excess:.0f} mm)" for name, excess in tightened.items()
            )
        )
    return bool(tightened)


class _Lost:
    """How many postures are lost to capsules that touch where meshes do not."""

    def __init__(self, plant, segments, rest: np.ndarray) -> None:
        self._plant, self._rest = plant, rest
        self._context = plant.CreateDefaultContext()
        self._surfaces = Surfaces(segments)
        self._q: np.ndarray | None = None

    def in_the_way(self, capsules, pairs) -> list[tuple[str, str]]:
        """Pairs that lose too many postures, or the one at rest; the worst first."""
        distances = PairDistances(self._plant, capsules, pairs)
        d, at_rest = self._distances(distances)
        suspects = np.flatnonzero(
            ((d < 0.0).mean(axis=0) > _LOST) | (at_rest < CLEAR)
        ).tolist()
        share = {pairs[k]: self._share(pairs[k], d[:, k], at_rest[k]) for k in suspects}
        found = [pair for pair in share if share[pair] > _LOST]
        return sorted(found, key=lambda pair: -share[pair])

    def of(self, capsules, pair: tuple[str, str]) -> float:
        """Share of the postures that a pair loses; above 1 where the one at rest is."""
        distances = PairDistances(self._plant, capsules, [pair])
        d, at_rest = self._distances(distances)
        return self._share(pair, d[:, 0], at_rest[0])

    def _distances(self, distances: PairDistances) -> tuple[np.ndarray, np.ndarray]:
        if self._q is None:
            lower, upper = distances.lower, distances.upper
            rng = np.random.default_rng(0)
            self._q = rng.uniform(lower, upper, size=(_SAMPLES, len(lower)))
        blocks = np.array_split(self._q, max(1, _SAMPLES // 50))
        d = np.concatenate([distances.of_all(block) for block in blocks])
        return d, distances.of_all(self._rest[np.newaxis])[0]

    def _share(self, pair: tuple[str, str], d: np.ndarray, at_rest: float) -> float:
        share = 0.0
        touching = np.flatnonzero(d < 0.0)
        if len(touching) > _LOST * len(d):
            some = touching[:: max(1, len(touching) // _LOOKED_AT)][:_LOOKED_AT]
            apart = [self._gap(pair, self._q[k]) >= NEAR for k in some]
            share = len(touching) / len(d) * float(np.mean(apart))
        if at_rest < CLEAR and self._gap(pair, self._rest) >= _AT_REST:
            # The deeper, the more is lost, so that what comes near is seen.
            return 1.0 + share + (CLEAR - at_rest)
        return share

    def _gap(self, pair: tuple[str, str], q: np.ndarray) -> float:
        self._plant.SetPositions(self._context, q)
        X: dict[str, RigidTransform] = {
            name: self._plant.EvalBodyPoseInWorld(
                self._context, self._plant.GetBodyByName(name)
            )
            for name in pair
        }
        return self._surfaces.gap(X, *pair)
