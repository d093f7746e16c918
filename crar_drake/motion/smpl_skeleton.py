"""The skeletons of the body models SMPL and SMPL-X in the mean.

The models themselves (smpl.is.tue.mpg.de, smpl-x.is.tue.mpg.de) may be used for
research alone, after registration, and are no part of this project. Here are numbers of
our own, 22 offsets of each: near those of the neutral body in the mean shape, which
`smpl_humanoid.xml` of PHC (BSD-3-Clause) and `smplx_humanoid.xml` of ProtoMotions
(Apache-2.0) publish, but symmetric and in steps of 5 mm. A motion of AMASS keeps the
terms of AMASS, however it is read.

The model's axes M at rest: x to the left, y up, z ahead; a T-pose, palms down.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from crar_drake.motion.point_layouts import LAYOUTS

NAMES = LAYOUTS["SMPL-22"]
# Index of the joint that each hangs on; the models agree in the first 22.
PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)

# Axes of the body (x ahead, y to the left, z up) in M, as columns.
BODY_AXES = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])

# Offset from the parent in M [mm]; of the left side, of which the right is the mirror
# image; the pelvis's from the origin of the model.
_OFFSETS = {
    "SMPL": {
        "pelvis": (0, -225, 30),
        "left_hip": (70, -90, -5),
        "left_knee": (35, -380, -5),
        "left_ankle": (-15, -400, -45),
        "left_foot": (25, -50, 120),
        "spine1": (0, 110, -25),
        "spine2": (0, 135, 0),
        "spine3": (0, 55, 25),
        "neck": (0, 215, -45),
        "head": (0, 65, 50),
        "left_collar": (80, 120, -35),
        "left_shoulder": (95, 30, -10),
        "left_elbow": (255, -15, -25),
        "left_wrist": (250, 10, -5),
    },
    "SMPL-X": {
        "pelvis": (0, -350, 10),
        "left_hip": (60, -100, -25),
        "left_knee": (50, -370, -15),
        "left_ankle": (-30, -405, -25),
        "left_foot": (45, -60, 120),
        "spine1": (0, 110, -30),
        "spine2": (0, 130, -5),
        "spine3": (0, 50, 30),
        "neck": (0, 165, -30),
        "head": (0, 160, 20),
        "left_collar": (45, 85, -10),
        "left_shoulder": (110, 55, -15),
        "left_elbow": (265, -55, -35),
        "left_wrist": (250, 10, -10),
    },
}


def _table(offsets: Mapping[str, tuple[int, int, int]]) -> np.ndarray:
    rows = []
    for name in NAMES:
        side = name.startswith("right_")
        row = np.array(offsets[name.replace("right_", "left_")], dtype=float)
        rows.append(1e-3 * row * ([-1, 1, 1] if side else [1, 1, 1]))
    return np.array(rows)


# Model to (22, 3) offsets of NAMES from their parents, of the pelvis from 0 [m].
MEAN_OFFSETS: Mapping[str, np.ndarray] = MappingProxyType(
    {model: _table(offsets) for model, offsets in _OFFSETS.items()}
)


def offsets_of(joints: np.ndarray) -> np.ndarray:
    """(22, 3) offsets from the parents, of the first 22 joints at rest (J, 3)."""
    first = joints[: len(NAMES)]
    return first - np.vstack([np.zeros(3), first[list(PARENTS[1:])]])
