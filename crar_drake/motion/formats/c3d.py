"""Markers of a C3D file, read by ezc3d.

The format is the biomechanics community's (www.c3d.org): parameters, then the points
of each frame in the unit that POINT:UNITS says; a hidden point has a negative residual,
or stands at 0 0 0, or is NaN.
"""

import importlib.util
import json
import math
import struct
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError, printable
from crar_drake.motion.performers.points import RecordedPoints
from crar_drake.resources import install_command

_CHILD = Path(__file__).with_name("ezc3d_child.py")
_PATIENCE = 60.0  # [s]
_SLOWEST = 1e6  # [bytes/s]
_MEMORY = 2**32  # [bytes]; what libraries reserve is most of it

_UNITS = ("mm", "cm", "m", "in", "")


def read_c3d(path: Path) -> RecordedPoints:
    """Reads the points of a C3D file.

    Raises:
        MotionError: ezc3d is not installed, the file is missing or none, or has no
            points or frames.
    """
    if importlib.util.find_spec("ezc3d") is None:
        raise MotionError(f"{path}: C3D files need ezc3d: {install_command('c3d')}")
    if not path.is_file():
        raise MotionError(f"{path}: there is no such motion file; check the path")
    _check_whole(path)
    parameters, data, residuals = _read_by_ezc3d(path)
    points = parameters["POINT"]
    # Beyond 255 labels a second list goes on.
    lists = ["LABELS", *(f"LABELS{number}" for number in range(2, 10))]
    labels = tuple(printable(x.strip()) for name in lists for x in points.get(name, []))
    positions = np.moveaxis(data, 0, -1).swapaxes(0, 1).astype(float)  # (T, M, 3)
    labels = labels[: positions.shape[1]]
    if not labels or not positions.size:
        what = "no frames" if labels else "no labelled points"
        raise MotionError(f"{path}: it has {what}")
    positions = positions[:, : len(labels)]
    hidden = (residuals[: len(labels)].T < 0.0) | np.all(positions == 0.0, axis=-1)
    positions[hidden] = np.nan
    unit = " ".join(points.get("UNITS", [""])[:1]).strip().lower()
    if unit not in _UNITS:
        raise MotionError(
            f"{path}: POINT:UNITS {unit!r} is not known; say the unit: --unit"
        )
    rates = points.get("RATE", [])
    rate = float(rates[0]) if len(rates) else 0.0
    return RecordedPoints(
        labels,
        positions,
        rate if math.isfinite(rate) and rate > 0.0 else 0.0,
        unit,
        _measures(parameters["PROCESSING"]),
    )


def _check_whole(path: Path) -> None:
    """Refuses a file that is cut off, of which ezc3d makes zeros, or never returns.

    Byte 2 of a file is 80; its first block says how many points and frames there are,
    and where parameters and data begin, in blocks of 512 bytes (www.c3d.org).
    """
    data = path.read_bytes()
    place = 512 * (data[0] - 1) if data else -1
    if len(data) < 512 or data[1] != 80 or place < 0:
        raise MotionError(f"{path}: not a readable C3D file, or one that is cut off")
    if len(data) < place + 4 or len(data) < place + 512 * data[place + 2]:
        raise MotionError(f"{path}: the file is cut off in its parameters")
    order = ">" if data[place + 3] == 86 else "<"  # MIPS
    points, analog, first, last = struct.unpack_from(f"{order}4H", data, 2)
    (begin,) = struct.unpack_from(f"{order}H", data, 16)
    # The scale is a float, negative where the numbers are floats: its sign's byte.
    sign = data[12] if order == ">" else data[13 if data[place + 3] == 85 else 15]
    size = (4 * points + analog) * (4 if sign & 0x80 else 2)
    frames = last - first + 1
    have = max(0, len(data) - 512 * (begin - 1))
    if frames > 0 and have < frames * size:
        raise MotionError(
            f"{path}: the file is cut off in its data: {have // size} of {frames} "
            "frames are there"
        )


def _read_by_ezc3d(path: Path) -> tuple[dict, np.ndarray, np.ndarray]:
    """What `ezc3d_child` tells: parameters by group, points (3, M, T), residuals."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "points.npz"
        size = path.stat().st_size
        command = [sys.executable, "-P", _CHILD, path, out, str(_MEMORY + 50 * size)]
        try:
            finished = subprocess.run(
                command,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_PATIENCE + size / _SLOWEST,
            )
        except subprocess.TimeoutExpired:
            why = "ezc3d does not come to an end"
        else:
            if finished.returncode == 0:
                with np.load(out) as read:
                    parameters = json.loads(str(read["parameters"]))
                    return parameters, read["points"], read["residuals"]
            said = finished.stderr.strip().split("\n")[-1]
            why = said if finished.returncode == 1 else "ezc3d crashes"
    raise MotionError(f"{path}: not a readable C3D file: {printable(why)}")


def _measures(group: Mapping[str, list]) -> dict[str, float]:
    """Single numbers of PROCESSING, where Vicon writes a subject's measures."""
    return {
        name: float(value[0])
        for name, value in group.items()
        if len(value) == 1 and isinstance(value[0], float) and value[0] > 0.0
    }
