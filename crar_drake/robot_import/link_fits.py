"""Capsules of all links; those of a link and of its mirror image are each other's.

Fits that an earlier import made are used again: fitting takes most of the time.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from crar_drake.files import write_whole
from crar_drake.robot_import import capsule_fitting
from crar_drake.robot_import.anatomy import HALF_TURN, MIRROR
from crar_drake.robot_import.capsule_fitting import Fit, FittedCapsule, fit_link
from crar_drake.robot_import.meshes import Looks, Part, vertices_of
from crar_drake.robot_import.source_robot import SourceRobot

# What reading a damaged file of fits raises.
_DAMAGED = (ValueError, TypeError, AttributeError, LookupError, RecursionError)

_ALIKE = 0.01  # [m] that the boxes about a link and its image may differ by


class FitCache:
    """Fits by what they were made from: the shapes, the bounds and the code."""

    def __init__(self, path: Path) -> None:
        """A JSON file; one that is missing or damaged is an empty cache."""
        self._path = path
        self._used: dict[str, list | None] = {}
        self._code = Path(capsule_fitting.__file__).read_bytes()
        self._known: dict[str, Fit | None] = {}
        with suppress(OSError, *_DAMAGED):
            kept = json.loads(path.read_text(encoding="utf-8"))
            self._known = {key: _from_json(entry) for key, entry in kept.items()}

    def fit(
        self,
        parts: Sequence[Part],
        most: int,
        excess: float,
        image: Sequence[Part] = (),
    ) -> Fit | None:
        """`fit_link`, or what it answered to the same before."""
        key = self._key([*parts, *image], f"{most} {excess} {len(parts)}")
        if key not in self._known:
            self._known[key] = fit_link(parts, most, excess, image)
        self._used[key] = _to_json(self._known[key])
        return self._known[key]

    def save(self) -> None:
        """Keeps what this import used."""
        write_whole(self._path, json.dumps(self._used))

    def _key(self, parts: list[Part], bounds: str) -> str:
        digest = hashlib.sha256(self._code)
        digest.update(bounds.encode())
        for part in parts:
            digest.update(np.round(part.vertices, 7).tobytes())
            digest.update(np.asarray(part.faces, dtype=np.int64).tobytes())
        return digest.hexdigest()


def _to_json(fit: Fit | None) -> list | None:
    if fit is None:
        return None
    shapes = [[*c.p_L0.tolist(), *c.p_L1.tolist(), c.radius] for c in fit.capsules]
    return [shapes, fit.coverage, fit.volume_ratio, fit.farthest, fit.excess]


def _from_json(entry: list | None) -> Fit | None:
    if entry is None:
        return None
    shapes, *figures = entry
    capsules = []
    for *ends, radius in shapes:
        p_L0, p_L1 = np.array(ends, dtype=float).reshape(2, 3)
        capsules.append(FittedCapsule(p_L0, p_L1, float(radius)))
    return Fit(tuple(capsules), *map(float, figures))


class LinkFits:
    """Fits links one by one, with the same links of the other side.

    A link's image need not have the same triangles, only nearly the same shape: the
    capsules of both hold both, and stick out of neither's hull by more than is allowed.
    Links that look alike but are not, or whose frames at zero are no images of each
    other, need more capsules together than alone and are fitted alone.
    """

    def __init__(
        self,
        robot: SourceRobot,
        segments: Looks,
        twins: Mapping[str, str],
        cache: FitCache,
    ) -> None:
        """`twins` says which link of the robot's other side is the same one."""
        self._segments, self._cache, self._twins = segments, cache, twins
        self._R = {name: X.rotation().matrix() for name, X in robot.poses().items()}

    def fit(
        self, links: Iterable[str], excess: float, most: int
    ) -> dict[str, Fit | None]:
        """Link to its fit, of some links and their twins: see `fit_link`."""
        fits: dict[str, Fit | None] = {}
        for link in links:
            if link in fits:
                continue
            twin = self._twins.get(link)
            if twin in self._segments and twin != link:
                together = self._together(link, twin, excess, most)
                if together is not None:
                    fits |= together
                    continue
            fits[link] = self._cache.fit(self._segments[link], most, excess)
        return fits

    def _together(
        self, link: str, twin: str, excess: float, most: int
    ) -> dict[str, Fit] | None:
        """Fits of a link and its twin; None where they are not worth it."""
        parts, others = self._segments[link], self._segments[twin]
        alone = None
        for image in (MIRROR, HALF_TURN):
            # From the link's frame to its twin's, with origins on each other.
            turned = self._R[twin].T @ np.diag(image) @ self._R[link]
            if not _alike(parts, others, turned):
                continue
            brought = [
                Part(part.vertices @ turned, part.faces, part.rgba) for part in others
            ]
            both = self._cache.fit(parts, most, excess, brought)
            if both is None:
                continue
            mirrored = both.imaged(turned, others)
            if both.good(excess) and mirrored.good(excess):
                return {link: both, twin: mirrored}
            alone = alone or [
                self._cache.fit(shape, most, excess) for shape in (parts, others)
            ]
            if not all(fit is not None and fit.good(excess) for fit in alone):
                return {link: both, twin: mirrored}
        return None


def _alike(parts: Sequence[Part], others: Sequence[Part], image: np.ndarray) -> bool:
    """Whether the boxes about both are, to a centimetre."""
    a, b = vertices_of(parts) @ image.T, vertices_of(others)
    apart = [a.min(axis=0) - b.min(axis=0), a.max(axis=0) - b.max(axis=0)]
    return bool(np.abs(apart).max() < _ALIKE)
