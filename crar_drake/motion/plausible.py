"""How tall people are, by which a recording's unit is known or doubted; how far away
nobody is."""

import numpy as np

from crar_drake.errors import MotionError

# The skeletons of 13 CMU performers are 1.48 to 1.63 m tall, to the end of the head's
# bone and without soles: a tenth less than the performers. Children and giants are
# within these bounds; lengths in another unit are mostly not.
HEIGHTS = (0.8, 2.3)  # [m]
USUAL_HEIGHT = 1.6  # [m]

# In no unit is anybody so far away; squares of such numbers still are some.
_FARTHEST = 1e9


def refuse_far(where: str, positions: np.ndarray) -> None:
    """Raises MotionError, with the place, if a coordinate is beyond all sense."""
    farthest = np.abs(positions[~np.isnan(positions)]).max(initial=0.0)
    if farthest > _FARTHEST:
        raise MotionError(
            f"{where}: a coordinate is {farthest:.3g}: no unit makes a person of it"
        )
