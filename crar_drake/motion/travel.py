"""Whether a performer goes where the feet take them, or hangs by the pelvis."""

import numpy as np

from crar_drake.motion.performer import SIDES, Performer, Points

# No camera sees a person's pelvis so still while a foot goes so far [m].
_STILL, _STEP = 1e-3, 0.1

# Of points of the feet those stand that are lowest [m] and slow [m/s], to this.
_AS_LOW, _AS_SLOW = 0.01, 0.3
_ITERATIONS = 10


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


def travelling(p: Points, rate: float) -> dict[str, np.ndarray]:
    """Points that are relative to the pelvis, taken along by feet that stand.

    In each frame the lowest point of the feet is on the floor. Across, the velocity v
    is that by which low points of the feet stand still: the mean of -v_i, their
    velocities beside the pelvis, with weights exp(-h_i / 1 cm) / (1 + (|v_i + v| / 0.3
    m/s)^2) by height and by what is left of speed, found by iteration. Nobody leaves
    the floor: a jump is a crouch, and who runs or hops loses the way of the flight.

    Args:
        p: ankles and toes among them, z up [m].
        rate: samples per second [Hz].
    """
    ankles, toes = (
        np.stack([p[f"{side}_{joint}"] for side in SIDES], axis=1)
        for joint in ("ankle", "toe")
    )
    lower = np.arange(len(toes)), toes[:, :, 2].argmin(axis=1)
    above = np.median((ankles[lower] - toes[lower])[:, 2])  # of a flat foot, mostly
    feet = np.concatenate([ankles - [0.0, 0.0, above], toes], axis=1)
    lowest = feet[:, :, 2].min(axis=1)
    height = feet[:, :, 2] - lowest[:, None]
    low = np.exp(-(height[1:] + height[:-1]) / (2.0 * _AS_LOW))
    v_i = np.diff(feet[:, :, :2], axis=0) * rate
    weights = low
    for _ in range(_ITERATIONS):
        share = weights / weights.sum(axis=1, keepdims=True)
        v = -np.einsum("ti,tij->tj", share, v_i)
        left = np.linalg.norm(v_i + v[:, None], axis=2)
        weights = low / (1.0 + (left / _AS_SLOW) ** 2)
    shift = np.zeros_like(feet[:, 0])
    shift[1:, :2] = np.cumsum(v, axis=0) / rate
    shift[:, 2] = -lowest
    return {joint: points + shift for joint, points in p.items()}
