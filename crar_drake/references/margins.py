"""What a motion of the joints keeps from collisions and limits, frame by frame.

Between two frames a motion is taken to go straight in joint space, as those who play
or interpolate it do. The distance on the whole of such a way is bounded from below as
that of a braking path is, (A5) of `equations.admission`: by a bound, not by samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crar_drake.control.modes.lookahead import LookaheadMode
from crar_drake.equations.admission import reaching
from crar_drake.equations.free_joints import PLAIN
from crar_drake.equations.nearby import bounds_of_some, nearby_distances
from crar_drake.references.frame_targets import configurations
from crar_drake.robot.model import ControlModel

# A way's bound is sought so far below what its ends keep, then four times farther
# and so on, and is found to so much [m].
_FIRST_SLACK = 2e-4
_LARGEST_SLACK = 0.05


@dataclass(frozen=True)
class Margins:
    """Of T frames.

    Attributes:
        distance: (T,) the smallest of all watched pairs [m], negative in penetration.
        pair: (T,) which pair it is of.
        between: (T,) no distance on the way to the next frame is smaller [m]; of the
            last frame its own distance.
        limit: (T,) what is left to the nearest joint limit [rad or m].
        speed: (T,) on the way to the next frame, the largest share of its speed limit
            that a joint uses; of the last frame 0.
    """

    distance: np.ndarray
    pair: np.ndarray
    between: np.ndarray
    limit: np.ndarray
    speed: np.ndarray


def find_margins(
    model: ControlModel,
    mode: LookaheadMode,
    speed_limits: np.ndarray,
    q: np.ndarray,
    rate: float,
) -> Margins:
    """The margins of a motion.

    Args:
        model: of the robot, its root fixed; its watched pairs are capsules and spheres.
        mode: of it.
        speed_limits: (n,) of the controlled joints [rad/s or m/s].
        q: (T, n) their positions [rad or m].
        rate: frames per second [Hz].
    """
    frames = len(q)
    whole = configurations(model, model.rest_positions(), q)
    everything = np.full((frames, len(mode.reaches.value.rows)), np.inf)
    d = nearby_distances(whole, everything, mode.robot)
    nearest = d.argmin(axis=1)
    distance = d[np.arange(frames), nearest]
    pair = model.pairs.pair_of_shapes[nearest]
    between = distance.copy()
    for k in range(frames - 1):
        start, end = whole[k][model.positions], whole[k + 1][model.positions]
        between[k] = _on_way(start, end - start, d[k : k + 2], mode)
    speed = np.zeros(frames)
    speed[:-1] = (np.abs(np.diff(q, axis=0)) * rate / speed_limits).max(axis=1)
    limit = np.minimum(q - model.lower, model.upper - q).min(axis=1)
    return Margins(distance, pair, between, limit, speed)


def _on_way(start, x, d, mode: LookaheadMode) -> float:
    """A bound for all distances on the way from `start` to `start` + x [m].

    Args:
        start, x: (nv,) in the equations' order.
        d: (2, Nr) the distances at its ends [m].
        mode: of the pairs.
    """
    nearest = d.min()
    reaches = reaching(start, x, 0.0 * x, mode.reaches, PLAIN)
    low = 0.5 * (d[0] + d[1] - np.abs(x) @ reaches.value.farthest)
    # A bound is only as close as the level that was asked for: it is sought between one
    # that is shown and one that is not.
    slack, failed, shown = _FIRST_SLACK, 0.0, np.inf
    while slack < _LARGEST_SLACK and shown - failed > _FIRST_SLACK:
        rows = np.flatnonzero(low < nearest - slack)
        keeps = np.ones(len(rows), dtype=bool)
        if len(rows):
            level = nearest - slack
            found = bounds_of_some(start, x, level, rows, mode.robot, mode.reaches)
            keeps = found.at < 0.0
            low[rows[keeps]] = np.maximum(low[rows[keeps]], found.low[keeps])
        if keeps.all():
            shown = slack
        else:
            failed = slack
        slack = 4.0 * slack if np.isinf(shown) else 0.5 * (failed + shown)
    return float(low.min())
