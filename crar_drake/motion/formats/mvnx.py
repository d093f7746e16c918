"""MVNX files of Xsens: XML with the poses of 23 segments of a body.

    mvnx / subject label, frameRate / segments / segment label
                                    / frames / frame type="normal"
                                             / orientation: 4 numbers a segment, w x y z
                                             / position: 3 a segment [m]

The world has z up. Each segment's origin is its joint with the one that it hangs on;
unturned segments make a T-pose that faces x, palms down. Other frames ("identity",
"tpose") are none of the motion. Sources: section 14.4 of the MVN User Manual, and
io_anim_mvnx_utest/data/test_mocap.mvnx of github.com/andres-fr/blender-mvnx-io.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from crar_drake.errors import MotionError, printable
from crar_drake.motion.formats.point_arrays import one_rate
from crar_drake.motion.plausible import refuse_far

_COLUMNS = {"position": 3, "orientation": 4}


@dataclass(frozen=True)
class Mvnx:
    """Segments' poses over time."""

    segments: tuple[str, ...]  # (S,) labels
    positions: np.ndarray  # (T, S, 3) p_WS [m]
    quaternions: np.ndarray  # (T, S, 4) of R_WS, w x y z
    frame_rate: float  # samples per second [Hz]; 0 if the file does not say
    others: tuple[str, ...]  # labels of further subjects, who are not read


def read_mvnx(path: str | os.PathLike[str]) -> Mvnx:
    """Reads the first subject of an MVNX file.

    Raises:
        MotionError: it cannot be read, is damaged, or has no poses of segments; the
            message names the line or the frame.
    """
    path = Path(path)
    try:
        return _read(path)
    except ElementTree.ParseError as error:
        line, column = error.position
        raise MotionError(
            f"{path}:{line}: no MVNX file, or one that is damaged or cut off ({error})"
        ) from None
    except (ValueError, LookupError) as error:  # MotionError is a ValueError
        if isinstance(error, MotionError):
            raise
        raise MotionError(f"{path}: the file is damaged: {error}") from None
    except OSError as error:
        raise MotionError(f"{path}: cannot be read: {error.strerror}") from error


def _read(path: Path) -> Mvnx:
    subjects, segments, rate = [], [], None
    rows: dict[str, list[np.ndarray]] = {key: [] for key in _COLUMNS}
    events = ElementTree.iterparse(path, ("start", "end"))
    for number, (event, element) in enumerate(events):
        tag = element.tag.rpartition("}")[2]
        if number == 0 and tag != "mvnx":
            raise MotionError(f"{path}: its first element is {tag}, not mvnx")
        if event == "start":
            if tag == "subject":
                subjects.append(printable(element.get("label", "")))
                rate = element.get("frameRate") if rate is None else rate
            continue
        if tag == "segment" and len(subjects) == 1:
            segments.append(printable(element.get("label", "")))
        elif tag == "frame":
            if element.get("type", "normal") == "normal" and len(subjects) == 1:
                for key, row in _row(path, element, len(rows["position"])).items():
                    rows[key].append(row)
            element.clear()
    if not segments or not rows["position"]:
        what = "frames with poses" if segments else "segments"
        raise MotionError(f"{path}: it has no {what}")
    shaped = {}
    for key, columns in _COLUMNS.items():
        expected = columns * len(segments)
        for k, row in enumerate(rows[key]):
            if len(row) != expected or not np.isfinite(row).all():
                raise MotionError(
                    f"{path}, frame {k + 1}: {key} has {len(row)} numbers, or one that "
                    f"is none; {len(segments)} segments have {expected}"
                )
        shaped[key] = np.array(rows[key]).reshape(-1, len(segments), columns)
    refuse_far(str(path), shaped["position"])
    lengths = np.linalg.norm(shaped["orientation"], axis=2)
    off = np.argwhere(np.abs(lengths - 1.0) > 0.01)
    if len(off):
        frame, segment = off[0]
        raise MotionError(
            f"{path}, frame {frame + 1}: the orientation of {segments[segment]} has "
            f"length {lengths[frame, segment]:.3g}, and is no rotation"
        )
    return Mvnx(
        tuple(segments),
        shaped["position"],
        shaped["orientation"],
        one_rate(str(path), None if rate is None else float(rate)),
        tuple(subjects[1:]),
    )


def _row(path: Path, frame: ElementTree.Element, number: int) -> dict[str, np.ndarray]:
    """The numbers of a frame, by key."""
    texts = {child.tag.rpartition("}")[2]: child.text or "" for child in frame}
    missing = [key for key in _COLUMNS if key not in texts]
    if missing:
        raise MotionError(
            f"{path}, frame {number + 1}: it has no {' and '.join(missing)}; export "
            "the segments' positions and orientations, too"
        )
    return {key: np.array(texts[key].split(), dtype=float) for key in _COLUMNS}
