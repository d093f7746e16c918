"""Links whose capsules meet where their meshes do not get closer ones.

A capsule that sticks out by 2 cm can touch another one where the meshes are 4 cm apart:
the pair then cannot be watched, if that is so at rest, or the joints between the links
lose much of their ranges. Such links are fitted again, with a smaller excess.
"""

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.robot_import.capsule_fitting import Capsules
from crar_drake.robot_import.import_report import ImportReport
from crar_drake.robot_import.link_fits import LinkFits
from crar_drake.robot_import.meshes import Looks, Surfaces
from crar_drake.robot_import.pair_sampling import (
    CLEAR,
    NEAR,
    PairDistances,
    position_ranges,
)
from crar_drake.robot_import.source_robot import SourceRobot, poses_in
from crar_drake.robot_import.watched_pairs import candidate_pairs

# What the excess is multiplied by, until it helps.
_SMALLER = (0.5, 0.25)
_MORE = 2  # times as many capsules as usual, at most
_SAMPLES = 400  # postures
_LOOKED_AT = 12  # of those in which capsules touch, by meshes
_LOST = 0.1  # share of the postures that a pair may lose
_AT_REST = 0.01  # [m] that meshes are apart which need not touch at rest


def tighten(
    plant: MultibodyPlant,
    robot: SourceRobot,
    segments: Looks,
    rest: np.ndarray,
    fits: LinkFits,
    report: ImportReport,
) -> bool:
    """Fits links again that stand in each other's way; whether there are any.

    The plant is finalized and has the report's capsules; `rest` (nq,) is its posture.
    """
    choices, own = report.choices, report.capsules()
    pairs = [
        pair for pair in candidate_pairs(robot, own) if len(robot.between(*pair)) > 1
    ]
    if choices.pairs is not None:
        asked = {frozenset(pair) for pair in choices.pairs}
        pairs = [pair for pair in pairs if frozenset(pair) in asked]
    if not pairs:
        return False
    lost = _Lost(plant, segments, rest)
    tightened: dict[str, float] = {}
    for pair in lost.in_the_way(own, pairs):
        best = lost.of(report.capsules(), pair)
        if best <= _LOST:
            continue  # an earlier one's links were the same
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
            changed = {name: fit.capsules for name, fit in new.items()}
            left = lost.of(report.capsules() | changed, pair)
            if left <= _LOST or (smaller == _SMALLER[-1] and left < 0.7 * best):
                report.fits |= new
                tightened |= {name: fit.excess for name, fit in new.items()}
                break
    report.note(
        "fitted more closely, since their capsules met others where meshes are "
        f"{1e3 * NEAR:.0f} mm apart, or at rest",
        [f"{name} ({1e3 * excess:.0f} mm)" for name, excess in tightened.items()],
    )
    return bool(tightened)


class _Lost:
    """How many postures are lost to capsules that touch where meshes do not."""

    def __init__(
        self, plant: MultibodyPlant, segments: Looks, rest: np.ndarray
    ) -> None:
        self._plant, self._rest = plant, rest
        self._surfaces = Surfaces(segments)
        lower, upper = position_ranges(plant)
        rng = np.random.default_rng(0)
        self._q = rng.uniform(lower, upper, size=(_SAMPLES, len(lower)))

    def in_the_way(
        self, capsules: Capsules, pairs: Sequence[tuple[str, str]]
    ) -> list[tuple[str, str]]:
        """Pairs that lose too many postures, or the one at rest; the worst first."""
        d, at_rest = self._distances(capsules, pairs)
        suspects = np.flatnonzero(
            ((d < 0.0).mean(axis=0) > _LOST) | (at_rest < CLEAR)
        ).tolist()
        share = {pairs[k]: self._share(pairs[k], d[:, k], at_rest[k]) for k in suspects}
        found = [pair for pair in share if share[pair] > _LOST]
        return sorted(found, key=lambda pair: -share[pair])

    def of(self, capsules: Capsules, pair: tuple[str, str]) -> float:
        """Share of the postures that a pair loses; above 1 where the one at rest is."""
        d, at_rest = self._distances(capsules, [pair])
        return self._share(pair, d[:, 0], at_rest[0])

    def _distances(
        self, capsules: Capsules, pairs: Sequence[tuple[str, str]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """(K, N) of pairs in the postures, and (N,) at rest [m]."""
        distances = PairDistances(self._plant, capsules, pairs)
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
        return self._surfaces.gap(poses_in(self._plant, q, pair), *pair)
