"""Percentiles of a time that is measured for hours, in a memory that does not grow."""

import numpy as np

_BIN = 1e-5  # [s]
_BINS = 20_000  # up to 0.2 s


class Latencies:
    """A histogram in steps of 10 us up to 0.2 s; what is longer counts as that."""

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS + 1, dtype=np.int64)
        self.longest = 0.0

    def add(self, seconds: float) -> None:
        """Counts one."""
        self._counts[min(max(int(seconds / _BIN), 0), _BINS)] += 1
        self.longest = max(self.longest, seconds)

    @property
    def count(self) -> int:
        """How many there are."""
        return int(self._counts.sum())

    def percentile(self, share: float) -> float:
        """The time that a share of all is not longer than [s]; NaN of none.

        Args:
            share: in (0, 100].
        """
        if not self.count:
            return float("nan")
        reached = np.cumsum(self._counts) >= share / 100.0 * self.count
        return float((np.argmax(reached) + 1) * _BIN)
