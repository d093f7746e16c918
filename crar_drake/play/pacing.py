"""Simulated time against the clock on the wall: speed, pause, and how late it is."""

from collections import deque

# More than this is not made up for: a simulation that was held up goes on at the wished
# speed, not faster [s].
_PATIENCE = 0.1
_WINDOW = 1.0  # of the rate that is reported [s]

SLOWEST, FASTEST = 0.05, 4.0


class Pacer:
    """Says when the next step is due.

    No step is left out: where the computer is too slow, simulated time falls behind,
    and what it has fallen behind by is reported.

    Attributes:
        paused: whether simulated time stands.
        speed: simulated seconds in a real one, as wished.
        behind: the sum of all delays that were given up on [s].
    """

    def __init__(self, now: float, *, speed: float = 1.0) -> None:
        """
        Args:
            now: on the wall [s].
            speed: as the attribute.
        """
        self.paused, self.speed, self.behind = False, _in_bounds(speed), 0.0
        self._anchor = (now, 0.0)  # on the wall and in the simulation
        self._recent: deque[tuple[float, float]] = deque()

    def set_speed(self, speed: float, now: float, time: float) -> None:
        """Changes the speed; now on the wall it is `time` in the simulation [s]."""
        self.speed = _in_bounds(speed)
        self._restart(now, time)

    def set_paused(self, paused: bool, now: float, time: float) -> None:
        """Holds simulated time, or lets it go on."""
        self.paused = paused
        self._restart(now, time)

    def wait(self, now: float, time: float) -> float:
        """How long until the step that leads on from `time` is due [s].

        Negative if it is late; more than a tenth of a second is given up on.
        """
        wall, began = self._anchor
        left = wall + (time - began) / self.speed - now
        if left < -_PATIENCE:
            self.behind -= left
            self._anchor = (now, time)
        return left

    def late(self, now: float, time: float) -> float:
        """How late the next step is, 0 if it is not due yet [s]."""
        wall, began = self._anchor
        return max(0.0, now - wall - (time - began) / self.speed)

    def rate(self, now: float, time: float) -> float:
        """Simulated seconds in a real one over the last second; 0 at first, and while
        it is paused. To be asked again and again."""
        if self.paused:
            return 0.0
        self._recent.append((now, time))
        while len(self._recent) > 2 and now - self._recent[1][0] >= _WINDOW:
            self._recent.popleft()
        wall, began = self._recent[0]
        return (time - began) / (now - wall) if now > wall else 0.0

    def _restart(self, now: float, time: float) -> None:
        self._anchor = (now, time)
        self._recent.clear()


def _in_bounds(speed: float) -> float:
    return min(max(speed, SLOWEST), FASTEST)
