"""Labels of contacts: in which frames each foot is on the floor.

A motion has them among its `extras`, as `foot_contacts` (T, F) of 0 and 1 and
`foot_names` (F,). Files of keys and values hold them under these keys; beside others of
one motion they stand in a CSV of their own, a column for each foot and a row for each
frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from crar_drake.files import write_whole
from crar_drake.motion.robots_own import CONTACTS_SUFFIX
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


def write_beside(path: Path, motion: RobotMotion) -> None:
    """Writes a motion's labels to `contacts_path` of a file, whole or not at all."""
    rows = [motion.extras[FEET_NAMES], *motion.extras[CONTACTS]]
    text = "".join(",".join(map(str, row)) + "\n" for row in rows)
    write_whole(contacts_path(path), text)
