"""How closely the robot follows what it is told, by what it says of itself."""

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence

import numpy as np

# Commands are kept for so long beyond the latency [s].
_KEPT = 1.0


class FollowedRobot:
    """Compares measured positions with what was commanded for the same instant.

    What is measured arrives a latency after it was so. It is compared with the command
    of that instant, between two commands on the straight line.

    Attributes:
        latency: of measured positions [s].
        most: larger errors than this are too large [rad or m]; infinite for none.
        heard: when positions came last [s]; minus infinity if none ever did.
        positions: joint to where it was then [rad or m].
        error: the largest |measured - commanded| then [rad or m], NaN of nothing; and
        joint: of which joint, or None.
    """

    def __init__(
        self, names: Sequence[str], latency: float = 0.0, most: float = math.inf
    ) -> None:
        """
        Args:
            names: (nq,) of the positions of a command.
            latency, most: see the attributes.
        """
        self._at = {name: i for i, name in enumerate(names)}
        self.latency, self.most = latency, most
        self.heard, self.positions = -math.inf, {}
        self.error, self.joint = math.nan, None
        self._told: deque[tuple[float, np.ndarray]] = deque()

    @property
    def names(self) -> Collection[str]:
        """The joints that are compared."""
        return self._at.keys()

    def tell(self, at: float, q: np.ndarray) -> None:
        """Notes a command.

        Args:
            at: the instant that it is for [s].
            q: (nq,) where the robot is to be then [rad or m].
        """
        self._told.append((at, q))
        while self._told[0][0] < at - self.latency - _KEPT:
            self._told.popleft()

    def hear(self, positions: Mapping[str, float], now: float) -> None:
        """Compares what was measured with what was commanded.

        Args:
            positions: joint to position [rad or m], of some of `names`.
            now: when they came [s].
        """
        self.heard, self.positions = now, dict(positions)
        commanded = self._at_time(now - self.latency)
        if commanded is None:
            self.error, self.joint = math.nan, None
            return
        errors = {
            name: abs(x - commanded[self._at[name]]) for name, x in positions.items()
        }
        self.joint = max(errors, key=errors.get)
        self.error = float(errors[self.joint])

    def follows(self, now: float, timeout: float) -> bool:
        """Whether the robot may be told to move.

        Args:
            now: the present instant [s].
            timeout: measured positions that are older count no more [s].

        Returns:
            True if no error is too large; of a robot that says nothing, if none is.
        """
        if self.most == math.inf:
            return True
        return now - self.heard <= timeout and not self.error > self.most

    def _at_time(self, time: float) -> np.ndarray | None:
        """(nq,) what was commanded for an instant; None before the first command."""
        if not self._told or time < self._told[0][0]:
            return self._told[0][1] if self._told else None
        later = self._told[-1]
        for told in reversed(self._told):
            if told[0] <= time:
                span = later[0] - told[0]
                share = min((time - told[0]) / span, 1.0) if span > 0.0 else 0.0
                return told[1] + share * (later[1] - told[1])
            later = told
        return later[1]
