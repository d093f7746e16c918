"""The obstacles that somebody told of, where they may be at any time since."""

from crar_drake.errors import few
from crar_drake.law.obstacles import Obstacles
from crar_drake.strict_json import MessageError
from crar_drake.teleoperation.messages import Heard, ObstacleMessage

# So many are kept at most: a step has to be in time.
MOST = 100
_MOST_REFUSED, _MOST_NAMED = 1000, 3
_NONE = Obstacles([], [], [])


class HeardObstacles:
    """Obstacles by name, each with the instant it was heard of last.

    One of which nothing is heard stays, and grows by its speed: where nobody looks, a
    person may be anywhere. Only who says that it is gone takes it away. While there is
    one that is refused, the robot must not move.
    """

    def __init__(self, keeps_off_none: str = "") -> None:
        """
        Args:
            keeps_off_none: why the robot keeps off none; "" if it does.
        """
        self._keeps_off_none = keeps_off_none
        self._heard: dict[str, tuple[Heard, float]] = {}
        self._refused: set[str] = set()

    def __len__(self) -> int:
        return len(self._heard)

    @property
    def reason_to_brake(self) -> str | None:
        """Which ones are refused, in words; None if none is."""
        if not self._refused:
            return None
        return f"obstacle refused: {few(sorted(self._refused), _MOST_NAMED)}"

    def hear(self, message: ObstacleMessage, now: float) -> None:
        """Takes what is told.

        Args:
            now: the present instant [s].

        Raises:
            MessageError: some are refused, since there would be too many, or the robot
                keeps off none; the others are taken.
        """
        if message.obstacles is None:
            self._heard.clear()
            self._refused.clear()
            return
        refused = False
        for name, told in message.obstacles.items():
            self._refused.discard(name)
            if told is None:
                self._heard.pop(name, None)
            elif not self._keeps_off_none and (
                name in self._heard or len(self._heard) < MOST
            ):
                self._heard[name] = told, now
            else:
                refused = True
                if len(self._refused) < _MOST_REFUSED:
                    self._refused.add(name)
        if refused:
            raise MessageError(
                self._keeps_off_none
                or f"more than {MOST} obstacles: take away who left, or all by "
                '{"obstacles": null}'
            )

    def at(self, now: float) -> Obstacles:
        """Where they are at most.

        Args:
            now: the present instant [s].
        """
        spheres = [
            (of.position, of.radius + of.speed * abs(now - heard), of.speed)
            for of, heard in self._heard.values()
        ]
        if not spheres:
            return _NONE
        centres, radii, speeds = zip(*spheres, strict=True)
        return Obstacles(centres, radii, speeds, tuple(self._heard))
