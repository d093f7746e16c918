"""Cleans a reference motion: in long steps or, if these are too long, shorter ones.

Where a step of the law has to be scaled towards braking, which holds up all joints, the
motion is followed again with steps half as long.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from crar_drake.equations.admission import SCALED
from crar_drake.references.following import (
    Cleaned,
    CleaningParameters,
    Follower,
)
from crar_drake.references.margins import Margins, find_margins
from crar_drake.robot.description import RobotDescription


class Cleaner:
    """Cleans references of one robot at one rate.

    Attributes:
        description: of the robot.
        model: of it, with all pairs.
        feet: task frames whose poses are kept.
    """

    def __init__(
        self,
        description: RobotDescription,
        rate: float,
        parameters: CleaningParameters | None = None,
    ) -> None:
        """Args and errors are those of `Follower`."""
        self.description = description
        self._rate, self._parameters = rate, parameters or CleaningParameters()
        follower = Follower(description, rate, self._parameters)
        self._followers = {self._parameters.longest_period: follower}
        self.model, self.feet = follower.model, follower.feet

    def margins(self, q: np.ndarray) -> Margins:
        """What a motion (T, n) of the controlled joints keeps, by all pairs.

        Speeds are shares of the robot's own limits, whatever share the law may use.
        """
        model = self.model
        fastest = model.velocity_limits[model.controlled]
        mode = self._follower(self._parameters.longest_period).law.mode
        return find_margins(model, mode, fastest, q, self._rate)

    def clean(
        self, reference: np.ndarray, progress: Callable[[int], None] | None = None
    ) -> Cleaned:
        """The reference under all constraints.

        Where its first frame is not clear, the robot begins in the configuration that
        the law retreats to from there, and catches up as it does everywhere.

        Args:
            reference: (T, n) positions of the controlled joints, in their order.
            progress: is told the frame that was reached.

        Raises:
            MotionError: no clear configuration was found near the first frame.
        """
        period, best = self._parameters.longest_period, None
        while best is None or (
            (best.admitted == SCALED).any()
            and period >= self._parameters.shortest_period
        ):
            found = self._follower(period).follow(reference, progress)
            if best is None or _num_scaled(found) < _num_scaled(best):
                best = found
            period *= 0.5
        return best

    def _follower(self, period: float) -> Follower:
        if period not in self._followers:
            parameters = replace(self._parameters, longest_period=period)
            follower = Follower(self.description, self._rate, parameters)
            self._followers[period] = follower
        return self._followers[period]


def _num_scaled(cleaned: Cleaned) -> int:
    return int((cleaned.admitted == SCALED).sum())
