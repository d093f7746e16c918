"""Arrangements of points that body models and pose estimators give, by their number.

- SMPL: the first 22 or 24 joints of the SMPL, SMPL-H and SMPL-X body models, which
  AMASS is given in.
- COCO-17, H36M-17 (the Human3.6M skeleton of 17).
"""

import re
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

_SMPL = (
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle "
    "right_ankle spine3 left_foot right_foot neck left_collar right_collar head "
    "left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist"
).split()
_FACE = "nose left_eye right_eye left_ear right_ear".split()
_COCO = _FACE + [
    f"{side}_{joint}"
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in ("left", "right")
]
_H36M = (
    "pelvis right_hip right_knee right_ankle left_hip left_knee left_ankle spine neck "
    "nose head left_shoulder left_elbow left_wrist right_shoulder right_elbow "
    "right_wrist"
).split()

LAYOUTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "SMPL-22": tuple(_SMPL),
        "SMPL-24": (*_SMPL, "left_hand", "right_hand"),
        "COCO-17": tuple(_COCO),
        "H36M-17": tuple(_H36M),
    }
)

# A joint that has no point of its own is the mean of these, if all are there.
MEANS: Mapping[str, tuple[tuple[str, ...], ...]] = MappingProxyType(
    {
        "pelvis": (("left_hip", "right_hip"),),
        "neck": (("left_shoulder", "right_shoulder"),),
        "head": (("left_ear", "right_ear"), ("nose",)),
    }
)


def layout_of(names: tuple[str, ...], positions: np.ndarray) -> str:
    """The layout's name, or "" if it is none that is known.

    Args:
        names: of the points; empty if only their number is known.
        positions: (T, J, 3). Of 17 points the second to the third is a thigh, longer
            than to the fifth, the other hip, in H36M; between the eyes, shorter than to
            an ear, in COCO.
    """
    if names:
        lowered = {name.strip().lower() for name in names}
        return next((k for k, v in LAYOUTS.items() if lowered == set(v)), "")
    fitting = [k for k, v in LAYOUTS.items() if len(v) == positions.shape[1]]
    if len(fitting) < 2:
        return fitting[0] if fitting else ""
    thigh = np.linalg.norm(positions[:, 1] - positions[:, 2], axis=1)
    apart = np.linalg.norm(positions[:, 1] - positions[:, 4], axis=1)
    return "H36M-17" if np.nanmedian(thigh) > np.nanmedian(apart) else "COCO-17"


def are_numbered(names: tuple[str, ...]) -> bool:
    """Whether names are one text with the points' numbers, and so say nothing."""
    cut = [re.fullmatch(r"(.*?)[_ ]*(\d+)", name.strip()) for name in names]
    if not all(cut) or len({found[1] for found in cut}) > 1:
        return False
    numbers = [int(found[2]) for found in cut]
    return numbers == list(range(numbers[0], numbers[0] + len(numbers)))
