"""Labels of contacts: in which frames each foot is on the floor.

A motion has them among its `extras`, as `foot_contacts` (T, F) of 0 and 1 and
`foot_names` (F,). Files of keys and values hold them under these keys; beside others of
one motion they stand in a CSV of their own, a column for each foot and a row for each
frame. One that is there goes when another motion is written to its name.
"""

from __future__ import annotations

import glob
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.files import write_whole
from crar_drake.motion.robots_own import CONTACTS_SUFFIX, is_reference
from crar_drake.references.layouts import Layout
from crar_drake.references.robot_motion import RobotMotion

LABELS = CONTACTS, FEET_NAMES = "foot_contacts", "foot_names"


def contacts_path(motion: Path) -> Path:
    """Where the labels of a file without room for them are."""
    return motion.with_name(motion.stem + CONTACTS_SUFFIX)


def as_extras(planted: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Labels as a motion's extras have them.

    Args:
        planted: foot to (T,) bool.
    """
    labels = np.stack(list(planted.values()), axis=1).astype(np.uint8)
    return {CONTACTS: labels, FEET_NAMES: np.array(list(planted))}


def labels_beside(motions: Sequence[RobotMotion], layout: Layout) -> bool:
    """Whether a file of these motions has their labels in a CSV beside it."""
    alone = len(motions) == 1 and not layout.has_room
    return alone and all(key in motions[0].extras for key in LABELS)


def read_beside(path: Path, frames: int) -> dict[str, np.ndarray]:
    """Labels of so many frames that are beside a file, as a motion's extras have them;
    none if there are none.

    Raises:
        MotionError: they are damaged, or of another motion.
    """
    place = contacts_path(path)
    if not place.is_file():
        return {}
    try:
        feet, *rows = (x.split(",") for x in place.read_text("utf-8").splitlines())
        labels = np.array(rows, dtype=np.uint8)
    except (ValueError, OverflowError):
        labels, feet = np.empty(0), []
    if labels.shape != (frames, len(feet)) or labels.max() > 1:
        raise MotionError(
            f"{place}: is to name the feet and have a row of 0 and 1 for each of the "
            f"{frames} frames of {path.name}: it is damaged, or of another motion; "
            "remove it, or write the motion again"
        )
    return {CONTACTS: labels, FEET_NAMES: np.array(feet)}


def remove_beside(path: Path) -> None:
    """Removes labels that were of another motion of that name; those of a motion that
    has only its stem, such as clean.csv beside clean.npz, stay."""
    others = path.parent.glob(f"{glob.escape(path.stem)}.*")
    if not any(is_reference(other) and other != path for other in others):
        contacts_path(path).unlink(missing_ok=True)


def write_beside(path: Path, motion: RobotMotion) -> None:
    """Writes a motion's labels to `contacts_path` of a file, whole or not at all."""
    rows = [motion.extras[FEET_NAMES], *motion.extras[CONTACTS]]
    text = "".join(",".join(map(str, row)) + "\n" for row in rows)
    write_whole(contacts_path(path), text)
