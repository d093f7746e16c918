"""Whether a performer hangs by the pelvis."""

import numpy as np

from crar_drake.motion.performer import SIDES, Performer

# No camera sees a person's pelvis so still while a foot goes so far [m].
_STILL, _STEP = 1e-3, 0.1


def pinned_pelvis(performer: Performer) -> str:
    """What to say of points that are relative to the pelvis; "" if they are not.

    Pose estimators give such: the pelvis never moves, and feet slide to and fro.
    """
    p = performer.positions
    feet = [p[f"{side}_ankle"] for side in SIDES if f"{side}_ankle" in p]
    farthest = max((np.ptp(foot, axis=0).max() for foot in feet), default=0.0)
    if np.ptp(p["pelvis"], axis=0).max() > _STILL or farthest < _STEP:
        return ""
    return (
        f"the pelvis never moves, although a foot does by {farthest:.2f} m: the points "
        "are relative to it, as pose estimators give them"
    )
