"""TRC files of markers or joint centres: OpenSim, OpenCap, Pose2Sim, Motion Analysis.

Text, with tabs between cells:

    PathFileType  4  (X/Y/Z)  NAME
    DataRate  CameraRate  NumFrames  NumMarkers  Units  ...
    60        60          100        21          mm     ...
    Frame#  Time  LSHO          RSHO          ...
                  X1  Y1  Z1    X2  Y2  Z2    ...
    1       0.0   ...

Units are m, cm, mm or in. An empty cell is a point that was not seen. Sources:
OpenSim's `TRCFileAdapter.cpp`; files of hsorby/trc-data-reader and of
perfanalytics/pose2sim.
"""

from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.formats.point_arrays import one_rate
from crar_drake.motion.performers.points import RecordedPoints
from crar_drake.motion.plausible import refuse_far
from crar_drake.motion.text_files import read_motion_text

_UNITS = {"m": "m", "meters": "m", "cm": "cm", "mm": "mm", "in": "in"}


def read_trc(path: Path) -> RecordedPoints:
    """Reads a TRC file.

    Raises:
        MotionError: it cannot be read, is damaged or none; the message names the line.
    """
    text = read_motion_text(path).split("\n")
    lines = [(i, line) for i, line in enumerate(text, start=1) if line.strip()]
    if len(lines) < 5 or not lines[0][1].startswith("PathFileType"):
        raise MotionError(
            f"{path}: it is no TRC file, which begins with a line PathFileType, and "
            "four more of heading"
        )
    header = dict(zip(lines[1][1].split(), lines[2][1].split(), strict=False))
    labels = tuple(cell.strip() for cell in lines[3][1].split("\t")[2:] if cell.strip())
    if not labels:
        raise MotionError(
            f"{path}:{lines[3][0]}: no names of points, with tabs between"
        )
    unit = _UNITS.get(header.get("Units", "").lower())
    if unit is None:
        raise MotionError(
            f"{path}:{lines[2][0]}: Units {header.get('Units', 'are missing')!r}: "
            f"known are {', '.join(_UNITS)}"
        )
    try:
        rate = one_rate(str(path), float(header.get("DataRate", "nan")))
    except ValueError:  # MotionError is one
        raise MotionError(
            f"{path}:{lines[2][0]}: DataRate {header.get('DataRate', 'is missing')!r} "
            "is no rate"
        ) from None
    count = 3 * len(labels)
    rows = [_row(path, number, line, count) for number, line in lines[5:]]
    if not rows:
        raise MotionError(f"{path}: the motion has no frames")
    positions = np.array(rows).reshape(len(rows), -1, 3)
    positions[~np.isfinite(positions).all(axis=2)] = np.nan
    refuse_far(str(path), positions)
    doubts = _cut_off(header.get("NumFrames", ""), len(rows))
    return RecordedPoints(labels, positions, rate, unit, doubts=doubts)


def _cut_off(stated: str, count: int) -> tuple[str, ...]:
    """A doubt if there are fewer frames than stated. Who cuts a motion to a part often
    leaves the heading as it was, so it is no error."""
    if not stated.isdecimal() or count >= int(stated):
        return ()
    return (f"{count} of {int(stated)} frames are there: cut off?",)


def _row(path: Path, number: int, line: str, count: int) -> list[float]:
    """The numbers of a line after frame and time; NaN where a cell is empty."""
    cells = (line.split("\t") if "\t" in line else line.split())[2:]
    if len(cells) > count and any(cell.strip() for cell in cells[count:]):
        raise MotionError(
            f"{path}:{number}: {len(cells)} values, but the heading names {count // 3} "
            "points"
        )
    cells = (cells + [""] * count)[:count]
    try:
        return [float(cell) if cell.strip() else np.nan for cell in cells]
    except ValueError as error:
        raise MotionError(f"{path}:{number}: {error}") from None
