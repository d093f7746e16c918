"""What Python hands to a compiled step, array by array.

An array goes into compiled code in a fifth of a microsecond, a tuple of arrays or a
`Held` takes ten times as long, and so does joining arrays to one before.
"""

import numpy as np

from crar_drake.law.compilation import compiled
from crar_drake.law.references import BlendStart, Targets


def hand_over(targets: Targets) -> tuple:
    """Targets as arguments of a compiled step, which begins with `take_over`."""
    return (
        targets.tasks,
        targets.prescribed,
        targets.posture,
        *targets.start,
        *targets.blend,
    )


@compiled
def take_over(
    tasks: np.ndarray,
    prescribed: np.ndarray,
    posture: np.ndarray,
    R: np.ndarray,
    p: np.ndarray,
    q_p: np.ndarray,
    q: np.ndarray,
    s: float,
    s_dot: float,
    s_ddot: float,
) -> Targets:
    """The targets out of `hand_over`."""
    return Targets(
        tasks, prescribed, posture, BlendStart(R, p, q_p, q), (s, s_dot, s_ddot)
    )
