"""A joint velocity gain that adapts to how near the constraints are.

The paper asks for one after Eq. (33): "small values when the system is away from the
constraints and large values near the constraints".
"""

from __future__ import annotations

import numpy as np

from crar_drake.equations.compilation import compiled


@compiled
def adaptive_gain(far: float, near: float, nearness: np.ndarray) -> np.ndarray:
    """Gv of each joint, between its values far from and near to the constraints.

        Gv_i = far + (near - far) (1 - 1 / w_i)

    with w_i the weight of Eq. (27) that the joint would have if every pair and
    every limit were being approached. (The weight itself falls to 1 the moment that
    a constraint is not approached any more, and the gain would jump.)

    Args:
        far: gain where w_i = 1 [1/s].
        near: gain where w_i is infinite [1/s].
        nearness: (n,) w_i, at least 1.

    Returns:
        (n,) [1/s].
    """
    return far + (near - far) * (1.0 - 1.0 / nearness)
