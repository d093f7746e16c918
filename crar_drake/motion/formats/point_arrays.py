"""Arrays of points: what pose estimators and body models give.

NPZ: `positions` (or `joints`, `keypoints`, `poses3d`, or the only such array) of shape
(T, J, 3), and, if they are there, `names` (J,) and `frame_rate` (or `fps`,
`mocap_framerate`).
NPY: the array alone. CSV: a heading with a column per number, `NAME_x`, `NAME_y`,
`NAME_z`, and perhaps `time` in seconds; names that are numbers alone (`point_0_x`) say
nothing.
"""

import csv
import re
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError, NoMotionError, printable
from crar_drake.motion.array_files import load_arrays
from crar_drake.motion.performers.points import RecordedPoints
from crar_drake.motion.plausible import refuse_far
from crar_drake.motion.point_layouts import are_numbered
from crar_drake.motion.text_files import read_motion_text

_ARRAYS = ("positions", "joints", "keypoints", "keypoints_3d", "joints3d", "poses3d")
_NAMES = ("names", "joint_names", "labels")
RATES = ("frame_rate", "fps", "mocap_framerate", "mocap_frame_rate", "framerate")
_UNIT = "unit"


def read_point_arrays(path: Path) -> RecordedPoints:
    """Reads an NPZ, NPY or CSV file of points.

    Raises:
        MotionError: the file is missing, damaged, or has no array (T, J, 3); of a CSV
            the message names file and line.
    """
    if path.suffix.lower() == ".csv":
        return _read_csv(path)
    arrays = load_arrays(path)
    if path.suffix.lower() == ".npy":
        return RecordedPoints((), _checked(path, "the array", arrays[""]), 0.0)
    return _of_npz(path, arrays)


def _of_npz(path: Path, arrays: dict[str, np.ndarray]) -> RecordedPoints:
    def first(names: tuple[str, ...]) -> np.ndarray | None:
        return next((arrays[name] for name in names if name in arrays), None)

    points = first(_ARRAYS)
    if points is None:
        fitting = [
            key
            for key, array in arrays.items()
            if array.ndim == 3 and array.shape[-1] == 3
        ]
        if len(fitting) != 1:
            held = ", ".join(f"{key} {array.shape}" for key, array in arrays.items())
            raise NoMotionError(
                f"{path}: no array {_ARRAYS[0]} of shape (T, J, 3); the file holds "
                f"{held or 'nothing'}"
            )
        points = arrays[fitting[0]]
    rate = first(RATES)
    names = first(_NAMES)
    positions = _checked(path, "the positions", points)
    listed = (
        tuple(printable(str(name)) for name in np.ravel(names))
        if names is not None
        else ()
    )
    if listed and len(listed) != positions.shape[1]:
        raise MotionError(
            f"{path}: {len(listed)} names for {positions.shape[1]} points"
        )
    return RecordedPoints(
        listed,
        positions,
        one_rate(str(path), rate),
        str(arrays[_UNIT]) if _UNIT in arrays else "",
    )


def one_rate(where: str, rate: object) -> float:
    """The rate [Hz] that a file has as an array or number; 0 where it has none.

    Raises:
        MotionError: it is not one positive number.
    """
    if rate is None:
        return 0.0
    values = np.ravel(rate)
    if values.size != 1 or values.dtype.kind not in "fiu" or not 0 < values[0] < np.inf:
        raise MotionError(f"{where}: the frame rate must be one positive number")
    return float(values[0])


def _checked(path: Path, what: str, array: np.ndarray) -> np.ndarray:
    if array.ndim != 3 or array.shape[-1] != 3 or array.dtype.kind not in "fiu":
        raise MotionError(
            f"{path}: {what} must be numbers of shape (T, J, 3), not {array.dtype} "
            f"{array.shape}"
        )
    if not len(array):
        raise MotionError(f"{path}: the motion has no frames")
    positions = array.astype(float)
    positions[~np.isfinite(positions).all(axis=2)] = np.nan
    refuse_far(f"{path}: {what}", positions)
    return positions


def _read_csv(path: Path) -> RecordedPoints:
    lines = read_motion_text(path).split("\n")
    # A comment is an empty row, so that lines keep their numbers.
    rows = csv.reader("" if line.startswith("#") else line for line in lines)
    heading = [cell.strip() for cell in next(filter(None, rows), [])]
    columns: dict[str, dict[str, int]] = {}
    time = None
    for i, cell in enumerate(heading):
        found = re.fullmatch(r"(.+?)[\s_.:]*([xyzXYZ])", cell)
        if cell.lower() in ("time", "t", "timestamp"):
            time = i
        elif found and cell.lower() not in ("frame", "index"):
            columns.setdefault(found[1], {})[found[2].lower()] = i
    points = {name: axes for name, axes in columns.items() if len(axes) == 3}
    if not points:
        raise NoMotionError(
            f"{path}:{rows.line_num}: expected a heading such as left_hip_x, "
            f"left_hip_y, left_hip_z; found {', '.join(heading[:6]) or 'nothing'}"
        )
    order = [axes[axis] for axes in points.values() for axis in "xyz"]
    values, times = [], []
    for row in rows:
        if not any(cell.strip() for cell in row):
            continue
        line = rows.line_num
        if len(row) != len(heading):
            raise MotionError(
                f"{path}:{line}: {len(row)} values, but the heading has {len(heading)}"
            )
        try:
            # An empty cell is a point that was not seen.
            values.append([float(row[i]) if row[i].strip() else np.nan for i in order])
            if time is not None:
                times.append(float(row[time]))
        except ValueError as error:
            raise MotionError(f"{path}:{line}: {error}") from error
    if not values:
        raise MotionError(f"{path}: the motion has no frames")
    positions = np.array(values).reshape(len(values), -1, 3)
    return RecordedPoints(
        () if are_numbered(tuple(points)) else tuple(points),
        _checked(path, "the columns", positions),
        _even_rate(path, times),
    )


def _even_rate(path: Path, times: list[float]) -> float:
    """The rate of times [s] that are evenly spaced [Hz]; 0 of fewer than two.

    Raises:
        MotionError: they are not.
    """
    if len(times) < 2:
        return 0.0
    steps = np.diff(times)
    step = float(np.median(steps))
    if not step > 0.0 or np.abs(steps - step).max() > 0.5 * step:
        raise MotionError(
            f"{path}: its times are not evenly spaced; resample it to a constant rate"
        )
    return (len(times) - 1) / (times[-1] - times[0])
