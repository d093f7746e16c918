"""The obstacles that somebody told of, where they may be at any time since."""

from crar_drake.law.obstacles import Obstacles
from crar_drake.teleoperation.messages import Heard, MessageError, ObstacleMessage

# So many are kept at most: a step has to be in time.
MOST = 100
_NONE = Obstacles([], [], [])


class HeardObstacles:
    """Obstacles by name, each with the instant it was heard of last.

    One of which nothing is heard stays, and grows by its speed: where nobody looks, a
    person may be anywhere. Only who says that it is gone takes it away.
    """

    def __init__(self, refused: str = "") -> None:
        """
        Args:
            refused: why the robot keeps off none; "" if it does.
        """
        self._refused = refused
        self._heard: dict[str, tuple[Heard, float]] = {}

    def __len__(self) -> int:
        return len(self._heard)

    def hear(self, message: ObstacleMessage, now: float) -> None:
        """Takes what is told.

        Args:
            now: the present instant [s].

        Raises:
            MessageError: there would be too many, or the robot keeps off none; then all
                stays as it was.
        """
        if self._refused:
            raise MessageError(self._refused)
        heard = dict(self._heard)
        for name, told in message.obstacles.items():
            if told is None:
                heard.pop(name, None)
            else:
                heard[name] = told, now
        if len(heard) > MOST:
            raise MessageError(f"more than {MOST} obstacles")
        self._heard = heard

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
