"""Steps of a motion that those beside them do not explain."""

import numpy as np


def leaps(steps: np.ndarray, threshold: float) -> list[tuple[int, float]]:
    """(frame after it, from 0; size) of each step that is a leap.

    The size is by how much it differs from the steps beside it: a fast motion has fast
    neighbours.

    Args:
        steps: (T - 1, k) from each frame to the next.
        threshold: what larger steps are leaps, in their unit.
    """
    if len(steps) < 3:
        return []
    index = np.arange(len(steps))
    # The first and the last step are compared with the two beside them.
    before = np.where(index > 0, index - 1, 2)
    after = np.where(index < len(steps) - 1, index + 1, len(steps) - 3)
    excess = np.minimum(
        np.linalg.norm(steps - steps[before], axis=1),
        np.linalg.norm(steps - steps[after], axis=1),
    )
    return [(int(i) + 1, float(excess[i])) for i in np.flatnonzero(excess > threshold)]
