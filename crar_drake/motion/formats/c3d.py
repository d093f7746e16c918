"""Markers of a C3D file, read by ezc3d.

The format is the biomechanics community's (www.c3d.org): parameters, then the points
of each frame in the unit that POINT:UNITS says; a hidden point has a negative residual,
or stands at 0 0 0, or is NaN.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError

_UNITS = {"mm": "mm", "cm": "cm", "m": "m", "in": "in", "": ""}


@dataclass(frozen=True)
class Markers:
    """Labelled points of a C3D file.

    Attributes:
        labels: as in the file, subject prefixes included.
        positions: (T, M, 3) [file units]; NaN where a point is hidden.
        frame_rate: samples per second [Hz]; 0 if the file does not say.
        unit: a key of `options.UNITS`, or "" if the file does not say.
        measures: what the file says of the subject, e.g. "LKneeWidth" [file units].
    """

    labels: tuple[str, ...]
    positions: np.ndarray
    frame_rate: float  # [Hz]
    unit: str
    measures: Mapping[str, float]


def read_c3d(path: str | os.PathLike[str]) -> Markers:
    """Reads the points of a C3D file.

    Raises:
        MotionError: ezc3d is not installed, the file is missing or none, or has no
            points or frames.
    """
    path = Path(path)
    try:
        import ezc3d
    except ImportError as error:
        raise MotionError(
            f"{path}: C3D files need ezc3d: pip install 'crar-drake[c3d]'"
        ) from error
    if not path.is_file():
        raise MotionError(f"{path}: there is no such motion file; check the path")
    try:
        c3d = ezc3d.c3d(str(path))
    except Exception as error:  # ezc3d raises what its C++ throws, of many kinds
        raise MotionError(f"{path}: not a readable C3D file: {error}") from error
    parameters = c3d["parameters"]
    points = parameters["POINT"]
    labels = tuple(label.strip() for label in _value(points, "LABELS", []))
    # Beyond 255 labels a second list goes on.
    for number in range(2, 10):
        labels += tuple(
            label.strip() for label in _value(points, f"LABELS{number}", [])
        )
    data = np.moveaxis(c3d["data"]["points"][:3], 0, -1)
    positions = np.swapaxes(data, 0, 1).astype(float)  # (T, M, 3)
    labels = labels[: positions.shape[1]]
    if not labels or not positions.size:
        what = "no frames" if labels else "no labelled points"
        raise MotionError(f"{path}: it has {what}")
    positions = positions[:, : len(labels)]
    residuals = c3d["data"]["meta_points"]["residuals"][0, : len(labels)].T
    hidden = (residuals < 0.0) | np.all(positions == 0.0, axis=-1)
    positions[hidden] = np.nan
    unit = " ".join(_value(points, "UNITS", [""])[:1]).strip().lower()
    if unit not in _UNITS:
        raise MotionError(
            f"{path}: POINT:UNITS {unit!r} is not known; say the unit: --unit"
        )
    rates = _value(points, "RATE", [])
    rate = float(rates[0]) if len(rates) else 0.0
    return Markers(
        labels,
        positions,
        rate if math.isfinite(rate) and rate > 0.0 else 0.0,
        _UNITS[unit],
        _measures(parameters),
    )


def _value(group, name: str, default):
    return group[name]["value"] if name in group else default


def _measures(parameters) -> dict[str, float]:
    """Single numbers of PROCESSING, where Vicon writes a subject's measures."""
    if "PROCESSING" not in parameters:
        return {}
    group = parameters["PROCESSING"]
    found = {}
    for name in group:
        value = group[name].get("value", []) if hasattr(group[name], "get") else []
        if len(value) == 1 and isinstance(value[0], float) and value[0] > 0.0:
            found[name] = float(value[0])
    return found
