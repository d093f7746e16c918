"""Whether quaternions without a name for their columns are x y z w or w x y z.

Continuity does not tell: whatever the order, the angle from one sample to the next is
the same. What tells is that robots are mostly upright. Read in the wrong order, a root
that is upright and looks along +x is either upside down (1 0 0 0), or it is upright as
well but looks along -x (0 0 0 1). There that motions tend to start along +x is the only
evidence, a weak one.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

# How much less tilted one order must be than the other, on average [rad].
_CLEAR = np.radians(15.0)

# A motion that is more tilted than this in either order tells nothing [rad].
_UPRIGHT = np.radians(60.0)

_COLUMNS = {"wxyz": [1, 2, 3, 0], "xyzw": [0, 1, 2, 3]}


def guess_quaternion_order(quaternions: np.ndarray) -> tuple[str, str]:
    """Guesses the order of (T, 4) columns.

    Returns:
        "wxyz", "xyzw" or, without any evidence, ""; and the evidence in words.
    """
    read = {
        name: Rotation.from_quat(quaternions[:, columns])
        for name, columns in _COLUMNS.items()
    }
    tilt = {name: _mean_tilt(R) for name, R in read.items()}
    order, other = sorted(tilt, key=tilt.get)
    evidence = (
        f"as {order} the root's z axis is on average {np.degrees(tilt[order]):.0f} "
        f"degrees from the vertical, as {other} {np.degrees(tilt[other]):.0f}"
    )
    if tilt[order] > _UPRIGHT:
        return "", evidence
    if tilt[other] - tilt[order] >= _CLEAR:
        return order, f"sure: {evidence}"
    heading = {name: abs(_first_heading(R)) for name, R in read.items()}
    order, other = sorted(heading, key=heading.get)
    if heading[order] > np.pi / 4.0 or heading[other] < 3.0 * np.pi / 4.0:
        return "", evidence
    return order, (
        f"NOT sure: {evidence}; as {order} it looks along +x at first, as {other} "
        "along -x (say --layout if that is wrong)"
    )


def _mean_tilt(R: Rotation) -> float:
    """Of the z axis against the vertical [rad]."""
    cosines = R.apply([0.0, 0.0, 1.0])[:, 2]
    return float(np.arccos(np.clip(cosines, -1.0, 1.0)).mean())


def _first_heading(R: Rotation) -> float:
    """Of the x axis in the first frame [rad]."""
    x, y, _ = R[0].apply([1.0, 0.0, 0.0])
    return float(np.arctan2(y, x))
