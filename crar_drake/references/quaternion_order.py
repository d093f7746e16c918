"""Whether quaternions without a name for their columns are x y z w or w x y z.

Continuity does not tell: whatever the order, the angle from one sample to the next is
the same. What tells is that robots are mostly upright: their root's z axis points up.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

# How much more upright one order must be than the other, as the mean cosine of the
# angle between the root's z axis and the vertical. Where less, nothing is guessed.
_CLEAR = 0.5


def upright_cosines(quaternions: np.ndarray) -> tuple[float, float]:
    """Mean cosine of the root's tilt if (T, 4) columns are w x y z, and if x y z w."""
    wxyz = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]])
    xyzw = Rotation.from_quat(quaternions)
    up = np.array([0.0, 0.0, 1.0])
    return (
        float(wxyz.apply(up)[:, 2].mean()),
        float(xyzw.apply(up)[:, 2].mean()),
    )


def guess_quaternion_order(quaternions: np.ndarray) -> tuple[str, str]:
    """Guesses the order of (T, 4) columns.

    Returns:
        "wxyz", "xyzw" or, where the evidence is weak, ""; and the evidence in words.
    """
    wxyz, xyzw = upright_cosines(quaternions)
    order = "wxyz" if wxyz > xyzw else "xyzw"
    better, worse = max(wxyz, xyzw), min(wxyz, xyzw)
    other = "xyzw" if order == "wxyz" else "wxyz"
    degrees = [np.degrees(np.arccos(np.clip(c, -1.0, 1.0))) for c in (better, worse)]
    evidence = (
        f"as {order} the root's z axis is on average {degrees[0]:.0f} degrees from the "
        f"vertical, as {other} {degrees[1]:.0f}"
    )
    if better - worse < _CLEAR or better < _CLEAR:
        return "", evidence
    return order, evidence
