"""The actuators of a plant: which effort moves which joint, and how strong they are."""

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.errors import ModelError


class Actuators:
    """How the efforts of a plant's joints are shared among its actuators.

    Attributes:
        limits: (nu,) largest effort of each, infinite where there is none [Nm or N].
        of_joints: (nu, nv) the efforts of each by those of the joints [1].
        joint_limits: (nv,) the same per joint; 0 where no actuator is.
    """

    def __init__(
        self, plant: MultibodyPlant, names: list[str], unactuated: np.ndarray
    ) -> None:
        """
        Args:
            plant: finalized.
            names: (nv,) of the joints, for messages.
            unactuated: indices in v of a free root, which no actuator moves; every
                other joint has one.

        Raises:
            ModelError: a joint has none, or the root has one.
        """
        B = plant.MakeActuationMatrix()
        nv, nu = B.shape
        idle = np.setdiff1d(np.flatnonzero(~B.any(axis=1)), unactuated)
        if len(idle):
            raise ModelError(
                "every joint must be actuated, but these are not: "
                f"{', '.join(names[i] for i in idle)}; add actuators "
                "(transmissions in a URDF, of joints with an effort limit that is not "
                "0), or weld the joints"
            )
        # The actuators of one joint share its effort.
        self.of_joints = np.ascontiguousarray(B.T / np.maximum(B.sum(axis=1), 1.0))
        self.limits, self.joint_limits = np.full(nu, np.inf), np.zeros(nv)
        for index in plant.GetJointActuatorIndices():
            actuator = plant.get_joint_actuator(index)
            limit, count = actuator.effort_limit(), actuator.num_inputs()
            start = actuator.joint().velocity_start()
            if start in unactuated:
                raise ModelError(
                    f"root: an actuator moves {actuator.joint().name()!r}, which "
                    "floats; leave it out"
                )
            self.joint_limits[start : start + count] += limit
            start = actuator.input_start()
            self.limits[start : start + count] = limit
