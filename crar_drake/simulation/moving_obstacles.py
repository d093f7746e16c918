"""Spheres that move through a simulation by themselves, as a scenario tells."""

# YAML loading reads the types of the fields, so no postponed annotations here.
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from crar_drake.errors import ScenarioError, check_vector

# What rounding may add to the speed between two keyframes [1].
_ROUNDING = 1e-9


@dataclass
class Place:
    """Where an obstacle is at one time."""

    time: float = 0.0  # since the start [s]
    xyz: list[float] = field(default_factory=list)  # of its centre, in the world [m]


@dataclass
class MovingObstacle:
    """A sphere that moves by itself, on straight lines."""

    name: str = ""  # of its own
    radius: float = 0.1  # [m]
    # that the controller is told to count with [m/s]; by default the largest of the
    # way. It must not be less.
    speed: float | None = None
    # where it is when; before the first and after the last it stands
    keyframes: list[Place] = field(default_factory=list)
    # where its centre is at first [m], instead of keyframes
    start: list[float] = field(default_factory=list)
    velocity: list[float] = field(default_factory=list)  # and its velocity [m/s]

    def validate(self) -> None:
        """Checks all that a file may say.

        Raises:
            ScenarioError: names the obstacle, the key and the remedy.
        """
        if not self.name:
            raise ScenarioError("obstacles: each needs a name")
        if not 0.0 < self.radius < np.inf:
            raise self._wrong("radius", f"{self.radius} m must be positive")
        if bool(self.keyframes) == bool(self.start):
            raise ScenarioError(
                f"obstacle {self.name}: give either keyframes or a start and a "
                f"velocity, not {'both' if self.start else 'neither'}"
            )
        if self.keyframes and self.velocity:
            raise self._wrong("velocity", "keyframes have their own; leave it out")
        for frame in self.keyframes:
            self._check_vector(f"keyframe at {frame.time:g} s, xyz", frame.xyz)
        times = [frame.time for frame in self.keyframes]
        if not (np.isfinite(times).all() and (np.diff(times) > 0.0).all()):
            raise self._wrong("keyframes", f"their times must increase: {times}")
        if self.start:
            self._check_vector("start", self.start)
            self._check_vector("velocity", self.velocity)
        if self.speed is None:
            return
        if not 0.0 <= self.speed < np.inf:
            raise self._wrong("speed", f"{self.speed} m/s must not be negative")
        fastest, where = self._fastest()
        if fastest > self.speed * (1.0 + _ROUNDING) + _ROUNDING:
            raise self._wrong(
                "speed",
                f"{self.speed:g} m/s is less than what it moves at{where}, "
                f"{fastest:.4g} m/s; raise it, or give it more time",
            )

    @property
    def fastest(self) -> float:
        """The bound of its speed that counts [m/s]."""
        return self._fastest()[0] if self.speed is None else self.speed

    def at(self, time: float) -> np.ndarray:
        """(3,) its centre at a time [s], in the world [m]."""
        if self.start:
            return np.asarray(self.start) + time * np.asarray(self.velocity)
        times, places = self._way()
        return np.array([np.interp(time, times, column) for column in places.T])

    def _way(self) -> tuple[np.ndarray, np.ndarray]:
        times = np.array([frame.time for frame in self.keyframes])
        return times, np.array([frame.xyz for frame in self.keyframes], dtype=float)

    def _fastest(self) -> tuple[float, str]:
        """The largest speed of its way [m/s], and where that is."""
        if self.start:
            return float(np.linalg.norm(self.velocity)), ""
        times, places = self._way()
        if len(times) == 1:
            return 0.0, ""
        speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)
        k = int(np.argmax(speeds))
        return float(speeds[k]), f" from {times[k]:g} to {times[k + 1]:g} s"

    def _check_vector(self, what: str, value: list[float]) -> None:
        check_vector(f"obstacle {self.name}: {what}", value)

    def _wrong(self, key: str, why: str) -> ScenarioError:
        return ScenarioError(f"obstacle {self.name}: {key}: {why}")


def check_obstacles(obstacles: Sequence[MovingObstacle]) -> None:
    """Raises ScenarioError if one is wrong, or two have one name."""
    names = [obstacle.name for obstacle in obstacles]
    for obstacle in obstacles:
        obstacle.validate()
        if names.count(obstacle.name) > 1:
            raise ScenarioError(f"obstacles: two are called {obstacle.name}")


class ObstacleSource(LeafSystem):
    """Where obstacles are, as functions of time, and shifted by hand.

    Output port: obstacles, (4 N,), x, y, z and radius of each in the world [m].
    """

    def __init__(self, obstacles: Sequence[MovingObstacle]) -> None:
        super().__init__()
        self.set_name("obstacles")
        self._obstacles = tuple(obstacles)
        self._shift = self.DeclareNumericParameter(
            BasicVector(np.zeros(3 * len(self._obstacles)))
        )
        self.DeclareVectorOutputPort(
            "obstacles",
            4 * len(self._obstacles),
            self._Calc,
            {self.time_ticket(), self.all_parameters_ticket()},
        )

    def shift(self, context: Context, by: np.ndarray) -> None:
        """Moves obstacles off their ways by (N, 3) [m], in a context of the system."""
        parameter = context.get_mutable_numeric_parameter(int(self._shift))
        parameter.SetFromVector(by.ravel())

    def _Calc(self, context: Context, output: BasicVector) -> None:
        shift = context.get_numeric_parameter(int(self._shift)).value().reshape(-1, 3)
        time = context.get_time()
        spheres = [
            (*(obstacle.at(time) + by), obstacle.radius)
            for obstacle, by in zip(self._obstacles, shift, strict=True)
        ]
        output.SetFromVector(np.concatenate(spheres))
