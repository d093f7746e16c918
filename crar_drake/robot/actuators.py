"""The actuators of a plant: which effort moves which joint, and how strong they are."""

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.errors import ModelError


class Actuators:
    """How the efforts of a plant's joints are shared among its actuators.

    Attributes:
        limits: (nu,) largest effort of each, infinite where there is none [Nm or N].
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
        # The actuators of one joint share its effort; one alone is quicker to pick.
        self._from_efforts = B.T / np.maximum(B.sum(axis=1), 1.0)
        alone = np.array_equal(self._from_efforts @ B, np.eye(nu))
        self._picked = B.argmax(axis=0) if alone else None
        self._in_order = np.array_equal(self._picked, np.arange(nv))
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

    def efforts(self, of_joints: np.ndarray) -> np.ndarray:
        """(nu, ...) in the order of the actuators, from (nv, ...) by joint."""
        if self._picked is None:
            return self._from_efforts @ of_joints
        return of_joints if self._in_order else of_joints[self._picked]
