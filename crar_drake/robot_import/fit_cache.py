"""Fits that an earlier import made are used again: fitting takes most of the time."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from crar_drake.files import write_whole
from crar_drake.robot_import import capsule_fitting
from crar_drake.robot_import.capsule_fitting import Fit, FittedCapsule, fit_link
from crar_drake.robot_import.meshes import Part


class FitCache:
    """Fits by what they were made from: the shapes, the bounds and the code."""

    def __init__(self, path: Path) -> None:
        """
        Args:
            path: JSON file; a missing or unreadable one is an empty cache.
        """
        self._path = path
        self._used: dict[str, list] = {}
        self._code = Path(capsule_fitting.__file__).read_bytes()
        try:
            self._known = json.loads(path.read_text())
        except (OSError, ValueError):
            self._known = {}

    def fit(
        self, parts: list[Part], most: int, excess: float, image: Sequence[Part] = ()
    ) -> Fit | None:
        """`fit_link`, or what it answered to the same before."""
        key = self._key([*parts, *image], f"{most} {excess} {len(parts)}")
        if key not in self._known:
            fit = fit_link(parts, most, excess, image)
            self._known[key] = None if fit is None else _to_json(fit)
        self._used[key] = self._known[key]
        return None if self._known[key] is None else _from_json(self._known[key])

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


def _to_json(fit: Fit) -> list:
    shapes = [[*c.p_L0, *c.p_L1, c.radius] for c in fit.capsules]
    return [
        [[float(v) for v in shape] for shape in shapes],
        fit.coverage,
        fit.volume_ratio,
        fit.farthest,
        fit.excess,
    ]


def _from_json(entry: list) -> Fit:
    shapes, *figures = entry
    capsules = tuple(
        FittedCapsule(np.array(s[:3]), np.array(s[3:6]), s[6]) for s in shapes
    )
    return Fit(capsules, *figures)
