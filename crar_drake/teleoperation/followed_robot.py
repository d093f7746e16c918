"""How closely the robot follows what it is told, by what it says of itself."""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from crar_drake.errors import few

# Commands are kept for so long beyond the latency [s].
_KEPT = 1.0
_MOST_NAMED = 4  # joints in a sentence


class FollowedRobot:
    """Compares measured positions with what was commanded for the same instant.

    What is measured arrives a latency after it was so, joint by joint or together. It
    is compared with the command of that instant, between two commands on the straight
    line. Of each joint what was heard last counts.

    Attributes:
        latency: of measured positions [s].
        most: larger errors than this are too large [rad or m]; infinite for none.
        names: of the joints, each with one position.
    """

    def __init__(
        self, names: Sequence[str], latency: float = 0.0, most: float = math.inf
    ) -> None:
        """
        Args:
            names: (nq,) the joint of each position of a command.
            latency, most: see the attributes.
        """
        self._at = {name: i for i, name in enumerate(names) if names.count(name) == 1}
        self.names: Collection[str] = self._at.keys()
        self.latency, self.most = latency, most
        self._measured: dict[str, float] = {}
        self._heard = dict.fromkeys(self._at, -math.inf)  # when [s]
        self._errors = dict.fromkeys(self._at, math.nan)
        self._told: deque[tuple[float, np.ndarray]] = deque()

    @property
    def positions(self) -> Mapping[str, float]:
        """Joint to where it was when it was heard last [rad or m]."""
        return self._measured

    @property
    def joint(self) -> str | None:
        """That was farthest from its command when it was heard last; None of none."""
        known = {name: x for name, x in self._errors.items() if not math.isnan(x)}
        return max(known, key=known.get, default=None)

    @property
    def error(self) -> float:
        """|measured - commanded| of `joint` then [rad or m]; NaN of none."""
        return self._errors.get(self.joint, math.nan)

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
        commanded = self._at_time(now - self.latency)
        for name, x in positions.items():
            self._measured[name], self._heard[name] = x, now
            if commanded is not None:
                self._errors[name] = abs(x - float(commanded[self._at[name]]))

    def unheard(self, now: float, timeout: float) -> str:
        """The joints of which nothing was heard, in words; "" of none.

        Args:
            now: the present instant [s].
            timeout: what is older does not count [s].
        """
        silent = [name for name, at in self._heard.items() if now - at > timeout]
        return few(silent, _MOST_NAMED)

    def reason_to_brake(self, now: float, timeout: float) -> str | None:
        """Why the robot may not be told to move; None if it may.

        Args:
            now, timeout: as of `unheard`.
        """
        if self.most == math.inf:
            return None
        if silent := self.unheard(now, timeout):
            return f"not heard: {silent}"
        return f"not followed: {self.joint}" if self.error > self.most else None

    def _at_time(self, time: float) -> np.ndarray | None:
        """(nq,) what was commanded for an instant; None before the first command."""
        if not self._told:
            return None
        later = bisect_right(self._told, time, key=lambda told: told[0])
        at_0, q_0 = self._told[max(later - 1, 0)]
        at_1, q_1 = self._told[min(later, len(self._told) - 1)]
        span = at_1 - at_0
        share = min((time - at_0) / span, 1.0) if span > 0.0 else 0.0
        return q_0 + share * (q_1 - q_0)
