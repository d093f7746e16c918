"""Measured states that no robot has: a sensor's glitch, another unit, an index that is
off by one. A law that believes them asks for torques that no motor has, either."""

import numpy as np

from crar_drake.robot.joints import joint_units
from crar_drake.robot.model import ControlModel

# A joint that turns sixteen times a second, or slides at 30 m/s, is none of a robot's;
# nor is one at three times the speed limit that is stated for it.
_FASTEST = {"rad": 100.0, "m": 30.0}  # [rad/s], [m/s]
_OVER_LIMIT = 3.0
# From rest to rest within a period this is more than any joint moves.
_JUMP = {"rad": 0.25, "m": 0.1}  # [rad], [m]
# The lookahead asks for at most this share of a speed that is believed: else it would
# take for a glitch what it did itself.
_ASKED = 0.99


def fastest_believed(model: ControlModel) -> np.ndarray:
    """(n,) speeds of the controlled joints beyond which a state is not believed
    [rad/s or m/s]."""
    units = joint_units(model.plant, model.joint_names)
    limits = model.velocity_limits[model.controlled]
    limits = np.where(np.isfinite(limits), _OVER_LIMIT * limits, 0.0)
    return np.maximum([_FASTEST[unit] for unit in units], limits)


def fastest_asked(model: ControlModel) -> np.ndarray:
    """(n,) speeds of the controlled joints that a law may ask for [rad/s or m/s]."""
    return _ASKED * fastest_believed(model)


class PlausibleStates:
    """Which measured states of the controlled joints are plausible."""

    def __init__(self, model: ControlModel, period: float) -> None:
        """
        Args:
            model: whose joints.
            period: of the controller [s].
        """
        self._q, self._v = model.controlled_positions, model.controlled
        self._period = period
        units = joint_units(model.plant, model.joint_names)
        self._fastest = fastest_believed(model)
        self._jump = np.array([_JUMP[unit] for unit in units])
        # An angle without limits may be given within one turn.
        ranges = model.upper - model.lower
        self._turn = np.where(np.isfinite(ranges), np.inf, 2.0 * np.pi)
        self._turns = np.flatnonzero(np.isfinite(self._turn))

    def believed(self, v: np.ndarray, before: np.ndarray | None) -> np.ndarray:
        """Velocities, those of joints that are too fast replaced by the ones before.

        Args:
            v: (nv,) measured.
            before: (nv,) believed a period or less ago; None for zeros.

        Returns:
            (nv,) `v` itself where no joint is too fast.
        """
        fast = self._v[np.abs(v[self._v]) > self._fastest]
        if not len(fast):
            return v
        v = v.copy()
        v[fast] = 0.0 if before is None else before[fast]
        return v

    def way(self, q0: np.ndarray, v0: np.ndarray, q: np.ndarray, v: np.ndarray) -> bool:
        """Whether joints may have come from one state to another in a period.

        Args:
            q0, v0: (nq,), (nv,) measured a control period ago, plausible speeds.
            q, v: (nq,), (nv,) measured now, plausible speeds.
        """
        moved = np.abs(q[self._q] - q0[self._q])
        if len(self._turns):
            turn = self._turn[self._turns]
            there = moved[self._turns] % turn
            moved[self._turns] = np.minimum(there, turn - there)
        fastest = np.maximum(np.abs(v[self._v]), np.abs(v0[self._v]))
        return bool((moved <= self._period * fastest + self._jump).all())
