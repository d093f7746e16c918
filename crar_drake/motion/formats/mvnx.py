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

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError, printable
from crar_drake.motion.formats.point_arrays import one_rate
from crar_drake.motion.joint_names import joints_by_name
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import JOINTS, Fact, Performer, repeated
from crar_drake.motion.performers.assemble import Recording, assemble
from crar_drake.motion.plausible import refuse_far
from crar_drake.motion.segment_tree import SegmentTree

_COLUMNS = {"position": 3, "orientation": 4}

_ARM = ("Shoulder", "UpperArm", "ForeArm", "Hand")
_LEG = ("UpperLeg", "LowerLeg", "Foot", "Toe")
# Chains of segments, each of which hangs on the one before.
_CHAINS = (
    ("Pelvis", "L5", "L3", "T12", "T8", "Neck", "Head"),
    *(("T8", *(side + part for part in _ARM)) for side in ("Left", "Right")),
    *(("Pelvis", *(side + part for part in _LEG)) for side in ("Left", "Right")),
)
_PARENT = {b: a for chain in _CHAINS for a, b in zip(chain, chain[1:], strict=False)}


def mvnx_performer(path: Path, name: str, options: MotionOptions) -> Performer:
    """The performer of an MVNX file: its first subject.

    Raises:
        MotionError: it cannot be read, is damaged, or has no poses of segments (the
            message names the line or the frame); a segment is missing, the file says no
            rate, or an option is given that it does not need.
    """
    try:
        recording = _read(path, name, options)
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
    return assemble(recording, options)


def _read(path: Path, name: str, options: MotionOptions) -> Recording:
    options.refuse(("unit", "up", "joints"), f"motion {name} is an MVNX")
    subjects, segments, stated = [], [], None
    rows: dict[str, list[np.ndarray]] = {key: [] for key in _COLUMNS}
    events = ElementTree.iterparse(path, ("start", "end"))
    for number, (event, element) in enumerate(events):
        tag = element.tag.rpartition("}")[2]
        if number == 0 and tag != "mvnx":
            raise MotionError(f"{path}: its first element is {tag}, not mvnx")
        if event == "start":
            if tag == "subject":
                subjects.append(printable(element.get("label", "")))
                stated = element.get("frameRate") if stated is None else stated
            continue
        if tag == "segment" and len(subjects) == 1:
            segments.append(printable(element.get("label", "")))
        elif tag == "frame":
            if element.get("type", "normal") == "normal" and len(subjects) == 1:
                for key, row in _row(path, element, rows, len(segments)).items():
                    rows[key].append(row)
            element.clear()
    if not segments or not rows["position"]:
        what = "frames with poses" if segments else "segments"
        raise MotionError(f"{path}: it has no {what}")
    p, Q = (np.array(rows[key]) for key in _COLUMNS)
    refuse_far(str(path), p)
    lengths = np.linalg.norm(Q, axis=2)
    off = np.argwhere(np.abs(lengths - 1.0) > 0.01)
    if len(off):
        frame, segment = off[0]
        raise MotionError(
            f"{path}, frame {frame + 1}: the orientation of {segments[segment]} has "
            f"length {lengths[frame, segment]:.3g}, and is no rotation"
        )
    rate, rate_source = options.rate_of(
        name, one_rate(str(path), None if stated is None else float(stated))
    )
    Q = Q[:, :, [1, 2, 3, 0]]
    R = Rotation.from_quat(Q.reshape(-1, 4)).as_matrix().reshape(*Q.shape[:2], 3, 3)
    index = {label: i for i, label in enumerate(segments)}
    parents = tuple(index.get(_PARENT.get(label), -1) for label in segments)
    tree = SegmentTree(
        tuple(segments), parents, np.moveaxis(p, 1, 0), np.moveaxis(R, 1, 0)
    )
    found = {j: i for j, i in joints_by_name(segments).items() if j in JOINTS}
    others = ", ".join(label or "without a name" for label in subjects[1:])
    return Recording(
        name=name,
        format="MVNX",
        frame_rate=rate,
        rate_source=rate_source,
        positions={joint: tree.positions[i] for joint, i in found.items()},
        joints={joint: f"{segments[i]}'s origin" for joint, i in found.items()},
        rotations={joint: tree.rotations[i] for joint, i in found.items()},
        body_axes=np.eye(3),
        unit_fact=Fact("unit", "m", "assumed", "as the format has it"),
        up="+z",
        bones=len(segments),
        bones_called="segments",
        same=repeated(Q.reshape(len(Q), -1)),
        notes=(f"other subjects in the file: {others}",) * bool(others),
        **tree.described(found),
    )


def _row(
    path: Path, frame: ElementTree.Element, before: dict[str, list], count: int
) -> dict[str, np.ndarray]:
    """Key to the numbers (count, k) that a frame has of as many segments.

    Args:
        before: the frames before it.
    """
    where = f"{path}, frame {len(before['position']) + 1}"
    texts = {child.tag.rpartition("}")[2]: child.text or "" for child in frame}
    missing = [key for key in _COLUMNS if key not in texts]
    if missing:
        raise MotionError(
            f"{where}: it has no {' and '.join(missing)}; export the segments' "
            "positions and orientations, too"
        )
    row = {}
    for key, columns in _COLUMNS.items():
        numbers, expected = np.array(texts[key].split(), dtype=float), columns * count
        if len(numbers) != expected or not np.isfinite(numbers).all():
            raise MotionError(
                f"{where}: {key} has {len(numbers)} numbers, or one that is none; "
                f"{count} segments have {expected}"
            )
        row[key] = numbers.reshape(count, columns)
    return row
