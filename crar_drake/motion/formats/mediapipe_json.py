"""JSON files of MediaPipe's pose landmarks, as people write them: there is no standard.

A list of frames, or a dict with one (`frames`) and perhaps `fps`. A frame is the list
of landmarks itself or a dict that has them, under one of the names that MediaPipe's
results have (`pose_world_landmarks`, `worldLandmarks` and others) or `landmarks`; the
first person's where there are several. A landmark is x, y, z as a dict or a list. A
frame without landmarks is a gap. Times of frames (`timestamp_ms`, `time` [s]) give the
rate.

World landmarks are needed: in metres, 0 between the hips, x to the right and y down in
the picture, z away from the camera. Those of the picture are not in metres. Source:
github.com/google/mediapipe, release 0.8.6 and docs/solutions/pose.md.
"""

import json
import os
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.formats.point_arrays import PointArrays, even_rate, one_rate
from crar_drake.motion.plausible import refuse_far
from crar_drake.motion.point_layouts import LAYOUTS
from crar_drake.motion.text_files import read_motion_text

_NAMES = LAYOUTS["MediaPipe-33"]
_WORLD = ("pose_world_landmarks", "poseWorldLandmarks", "world_landmarks")
_KEYS = (*_WORLD, "worldLandmarks", "landmarks", "landmark", "keypoints3D")
_TIMES = {"timestamp_ms": 1e-3, "time": 1.0, "timestamp": 1.0}  # to [s]
_RATES = ("fps", "frame_rate")
_HIPS = [_NAMES.index(f"{side}_hip") for side in ("left", "right")]

# World landmarks have the middle of the hips at 0, but for this [m].
_AT_ORIGIN = 0.06


def read_mediapipe(path: str | os.PathLike[str]) -> PointArrays:
    """Reads a JSON file of world landmarks.

    Raises:
        MotionError: it cannot be read, holds no frames of 33 landmarks, or those of the
            picture; the message names the line or the frame.
    """
    path = Path(path)
    try:
        held = json.loads(read_motion_text(path))
    except json.JSONDecodeError as error:
        raise MotionError(f"{path}:{error.lineno}: no JSON: {error.msg}") from None
    except RecursionError:
        raise MotionError(f"{path}: its lists are too many deep") from None
    frames = held.get("frames") if isinstance(held, dict) else held
    if not isinstance(frames, list) or not frames:
        raise MotionError(f"{path}: it has no list of frames")
    points = [_landmarks(path, k, frame) for k, frame in enumerate(frames, start=1)]
    if all(found is None for found in points):
        raise MotionError(
            f"{path}: no frame has landmarks ({', '.join(_KEYS)}, or lists of x, y, z)"
        )
    gap = np.full((len(_NAMES), 3), np.nan)
    positions = np.array([gap if found is None else found for found in points])
    refuse_far(str(path), positions)
    middle = np.abs(positions[:, _HIPS].mean(axis=1))
    if np.nanmedian(middle) > _AT_ORIGIN:
        raise MotionError(
            f"{path}: the hips are not about 0, so these are landmarks of the picture, "
            "which are not in metres; save pose_world_landmarks"
        )
    rate = next((held[k] for k in _RATES if isinstance(held, dict) and k in held), None)
    return PointArrays(
        _NAMES,
        positions,
        one_rate(str(path), rate) or even_rate(path, _times(frames)),
        "m",
    )


def _landmarks(path: Path, number: int, frame: object) -> np.ndarray | None:
    """(33, 3) of a frame; None if it has none."""
    while isinstance(frame, dict):
        frame = next((frame[key] for key in _KEYS if key in frame), None)
    if not frame:
        return None
    if isinstance(frame, list) and len(frame) < len(_NAMES):
        return _landmarks(path, number, frame[0])  # the first person's
    try:
        rows = [
            [row[axis] for axis in "xyz"] if isinstance(row, dict) else row[:3]
            for row in frame
        ]
        found = np.array(rows, dtype=float)
    except (TypeError, ValueError, LookupError):
        found = np.empty(0)
    if found.shape != (len(_NAMES), 3) or not np.isfinite(found).all():
        raise MotionError(
            f"{path}, frame {number}: no {len(_NAMES)} landmarks, each with numbers x, "
            "y, z"
        )
    return found


def _times(frames: list) -> list[float]:
    """Of the frames [s]; [] unless all have one."""
    for key, seconds in _TIMES.items():
        times = [frame.get(key) for frame in frames if isinstance(frame, dict)]
        if len(times) == len(frames) and all(isinstance(t, int | float) for t in times):
            return [seconds * t for t in times]
    return []
