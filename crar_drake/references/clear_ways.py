"""Which ways of a reference, from a frame to the next, can be taken as they are."""

from __future__ import annotations

import numpy as np

from crar_drake.control.law import ControlLaw
from crar_drake.equations.nearby import keeps_level


class ClearWays:
    """The ways from each frame of a reference to the next, each asked when needed.

    A way goes straight in joint space. Where one is clear with the braking path that
    begins where it ends, as fast as it is itself, so is each state on it.
    """

    def __init__(self, law: ControlLaw, q: np.ndarray, rate: float) -> None:
        """
        Args:
            law: on a robot whose root is fixed, and whose watched shapes are capsules
                and spheres; its constraints are "lookahead".
            q: (T, nq) positions of the plant in each frame.
            rate: frames per second [Hz].
        """
        model, self._mode = law.model, law.mode
        self._margin = law.parameters.lookahead.distance_margin
        steps = np.diff(q, axis=0)
        # Each way, and the braking path.
        ways = (1.0 + self._mode.admission.T * rate) * steps
        controlled = model.controlled_positions
        speeds = np.abs(steps[:, controlled]) * rate
        ends = (q[:-1] + ways)[:, controlled]
        self._within = (
            (speeds <= law.speed_limits[model.controlled])
            & (ends >= model.lower)
            & (ends <= model.upper)
        ).all(axis=1)
        self._starts = np.ascontiguousarray(q[:, model.positions])
        self._ways = np.ascontiguousarray(ways[:, model.order])
        self._clear: dict[int, bool] = {}

    def clear(self, frame: int) -> bool:
        """Whether the way from a frame to the next, and braking from there, keeps the
        law's margin, and within all limits of joints."""
        if frame not in self._clear:
            self._clear[frame] = bool(self._within[frame]) and keeps_level(
                self._starts[frame],
                self._ways[frame],
                self._margin,
                self._mode.robot,
                self._mode.reaches,
            )
        return self._clear[frame]
