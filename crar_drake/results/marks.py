"""What the page and the plot of a run share: colours, a scale, and marked spans.

One colour has one meaning wherever a run is drawn.
"""

import numpy as np

from crar_drake.law.solution import STATUS_BLENDING, STATUS_BRAKING
from crar_drake.motion.planted_feet import runs
from crar_drake.results.log import SimulationLog

TARGET = "#8c45ff"  # violet, as in Meshcat: a target, and the error to it
VIOLATION = "#c1121f"  # crimson: a penetration, a joint beyond a limit
TOO_FAST = "#d6249f"  # magenta: a joint faster than its limit
SMALLEST = "#1f2933"  # nearly black: the smallest of all distances
JOINT = "#33658a"  # steel blue: joint angles, torque and power

OBSTACLE = "#c2703d"  # terracotta: what moves by itself, a person or a tool

# How near a pair is: the colour goes from the first to the last as the distance
# shrinks from the first one here to the last [m].
NEARNESS = ("#f7c948", "#f0803c", "#e02b20")
NEARNESS_STEPS = (3.0, 1.0, 0.25)  # of the warning distance

# The lines of single pairs that came near, the nearest first.
NEAR_PAIRS = ("#e02b20", "#f0803c", "#c99700", "#8c4a2f")

# The lines of single targets: the left one, and the right one or that in the middle, of
# a kind. Seven and more are distinguished by hue, the two of a kind by lightness.
TARGETS = (
    ("#4c1d95", "#b794f6"),  # violet
    ("#0b6b5d", "#3ec9b0"),  # green
    ("#9a5b00", "#f0b13c"),  # amber
    ("#111827", "#8a94a3"),  # grey
    ("#9d174d", "#f08bb8"),  # pink
)

# Spans of time in which the controller does not take the nominal step.
SPANS = {"blending": "#2a9d8f", "braking": "#5b6ee1", "torque limited": "#a8763e"}

# Of several runs in one picture, in their order.
RUNS = ("#0284c7", "#4d7c0f", "#334155", "#a16207", "#0f766e", "#78716c")

# Below it the scale of distances is roughly linear, above roughly logarithmic [m].
SCALE_UNIT = 0.002


def distance_height(distance: np.ndarray) -> np.ndarray:
    """Where a signed distance [m] stands on the scale that page and plot draw.

    The logarithm of 1 + |d| / 2 mm, with the sign of d: penetrations have a place on
    it, and 0, 5 and 20 mm are well apart. It is odd, smooth enough and increasing.
    """
    return np.sign(distance) * np.log10(1.0 + np.abs(distance) / SCALE_UNIT)


def distance_at(height: np.ndarray) -> np.ndarray:
    """The distance [m] that stands there: the inverse of `distance_height`."""
    return np.sign(height) * SCALE_UNIT * (10.0 ** np.abs(height) - 1.0)


def marked_spans(log: SimulationLog) -> dict[str, list[tuple[float, float]]]:
    """When the controller blended onto targets, braked, or was limited in torque.

    A sample stands for the time until the next one.

    Returns:
        For each key of `SPANS` the spans (start, end) [s], in order.
    """
    status = log.status[:, 0]
    marked = {
        "blending": status == STATUS_BLENDING,
        "braking": status >= STATUS_BRAKING,
        "torque limited": log.torque_limited | log.torque_clipped,
    }
    return {name: _spans(log.time, marked[name]) for name in SPANS}


def _spans(time: np.ndarray, marked: np.ndarray) -> list[tuple[float, float]]:
    """Runs of True in (T,) `marked`, sampled at `time` (T,) [s]."""
    last = len(time) - 1
    return [
        (float(time[start]), float(time[min(end, last)])) for start, end in runs(marked)
    ]
