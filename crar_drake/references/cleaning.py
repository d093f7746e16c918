"""Cleans a reference motion: the law on the pairs that matter, then all are examined.

Most of a whole robot's pairs of links are never near each other in one motion. So the
law watches those that the reference brings within `near`, and all are measured in what
comes out. A pair that came below the floor there is added, and the law runs again.
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
from crar_drake.references.margins import Margins, find_margins, pair_distances
from crar_drake.robot.description import RobotDescription

# So often pairs are added before all are watched.
_ROUNDS = 3


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
        self._all = Follower(description, rate, self._parameters)
        self._followers: dict[tuple[tuple[int, ...], float], Follower] = {}
        self.model, self.feet = self._all.model, self._all.feet

    def margins(self, q: np.ndarray) -> Margins:
        """What a motion (T, n) of the controlled joints keeps, by all pairs."""
        law, model = self._all.law, self.model
        fastest = law.speed_limits[model.controlled]
        return find_margins(model, law.mode, fastest, q, self._rate)

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
        floor = self._parameters.floor
        least = pair_distances(self.model, reference).min(axis=0)
        watched = least < self._parameters.near
        for _ in range(_ROUNDS):
            cleaned = self._follow(watched, reference, progress)
            now = pair_distances(self.model, cleaned.q).min(axis=0)
            missed = (now < floor) & ~watched
            if not missed.any():
                return replace(cleaned, num_watched=int(watched.sum()))
            watched |= missed | (now < self._parameters.near)
        watched[:] = True
        cleaned = self._follow(watched, reference, progress)
        return replace(cleaned, num_watched=len(watched))

    def _follow(self, watched, reference, progress) -> Cleaned:
        """With the longest steps of which none has to be scaled, or with the shortest:
        scaling holds up all joints, which shorter steps need less."""
        period, best = self._parameters.longest_period, None
        while best is None or (
            (best.admitted == SCALED).any()
            and period >= self._parameters.shortest_period
        ):
            found = self._follower(watched, period).follow(reference, progress)
            if best is None or _num_scaled(found) < _num_scaled(best):
                best = found
            period *= 0.5
        return best

    def _follower(self, watched: np.ndarray, period: float) -> Follower:
        """On some of the pairs; at least one."""
        first = period == self._parameters.longest_period
        if watched.all() and first:
            return self._all
        chosen = tuple(np.flatnonzero(watched).tolist()) or (0,)
        if (chosen, period) not in self._followers:
            pairs = [self.description.pairs[i] for i in chosen]
            description = replace(self.description, pairs=pairs)
            parameters = replace(self._parameters, longest_period=period)
            follower = Follower(description, self._rate, parameters)
            self._followers = {(chosen, period): follower}  # one is kept: it is large
        return self._followers[chosen, period]


def _num_scaled(cleaned: Cleaned) -> int:
    return int((cleaned.admitted == SCALED).sum())
