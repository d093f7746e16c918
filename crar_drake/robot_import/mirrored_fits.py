"""Capsules of all links; those of a link and of its mirror image are each other's."""

from collections.abc import Iterable, Mapping

import numpy as np

from crar_drake.robot_import.capsule_fitting import Fit
from crar_drake.robot_import.fit_cache import FitCache
from crar_drake.robot_import.meshes import Part
from crar_drake.robot_import.source_robot import SourceRobot

_MIRROR = np.diag([1.0, -1.0, 1.0])
_HALF_TURN = np.diag([-1.0, -1.0, 1.0])
_ALIKE = 0.01  # [m] that the boxes about a link and its image may differ by


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
        segments: Mapping[str, list[Part]],
        twins: Mapping[str, str],
        cache: FitCache,
    ) -> None:
        """
        Args:
            robot: at zero, one side is the other's image.
            segments: link to its real look, in its frame.
            twins: link to the same one of the other side.
            cache: of fits.
        """
        self._segments, self._cache, self._twins = segments, cache, twins
        self._R = {name: X.rotation().matrix() for name, X in robot.poses().items()}

    def fit(
        self, links: Iterable[str], excess: float, most: int
    ) -> dict[str, Fit | None]:
        """Link to its fit, of some links and their twins.

        Args:
            links: which.
            excess: how far a capsule may stick out of the hull [m].
            most: capsules a link, at most.
        """
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

    def _together(self, link: str, twin: str, excess: float, most: int):
        """Fits of a link and its twin; None where they are not worth it."""
        parts, others = self._segments[link], self._segments[twin]
        alone = None
        for image in (_MIRROR, _HALF_TURN):
            # From the link's frame to its twin's, with origins on each other.
            turned = self._R[twin].T @ image @ self._R[link]
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


def _alike(parts: list[Part], others: list[Part], image: np.ndarray) -> bool:
    """Whether the boxes about both are, to a centimetre."""
    a = np.concatenate([part.vertices for part in parts]) @ image.T
    b = np.concatenate([part.vertices for part in others])
    corners = [np.concatenate([v.min(axis=0), v.max(axis=0)]) for v in (a, b)]
    return bool(np.abs(corners[0] - corners[1]).max() < _ALIKE)
