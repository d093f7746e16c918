"""Points of a robot that are to be somewhere, and how far they are from there.

Where points are is found by the judge of this folder, from the robot's own file.
"""

import numpy as np
import product
from attacks import Run, assert_nothing_is_violated, judge_of, run

PERIOD = 5e-3  # of all laws here [s]
APART = 0.02  # of watched pairs, in postures that are clear [m]
INSIDE = 0.05  # their joints are off their limits [rad or m]
FREE = np.pi  # and off the rest posture, where they have none [rad]
WAY = np.linspace(0.0, 1.0, 33)  # between two postures


class Robot:
    """A robot whose law is to bring points to their targets."""

    def __init__(self, robot: str, points: list[str], *, stands: bool = False) -> None:
        self.judge = judge_of(robot, stands=stands)
        self.law = product.Law(robot, points, period=PERIOD, stands=stands)
        frames = product.point_links(robot)
        self._places = [self._place(frames[point]) for point in points]
        assert np.abs(self.points(self.rest[None])[0] - self.law.home).max() < 1e-9

    @property
    def rest(self) -> np.ndarray:
        """(n,) the rest posture."""
        return self.law.rest

    def _place(self, name: str) -> tuple[str, np.ndarray]:
        """The link of a frame, and where the frame's origin is in it (1, 3) [m]."""
        frame = self.judge.plant.GetFrameByName(name.split("::")[-1])
        X_BF = frame.GetFixedPoseInBodyFrame()
        return frame.body().scoped_name().get_full(), X_BF.translation()[None]

    def points(self, q: np.ndarray) -> np.ndarray:
        """(N, P, 3) where the points are at positions (N, n) [m]."""
        found = [self.judge.link_points(link, p, q) for link, p in self._places]
        return np.concatenate(found, axis=1)

    def is_clear(self, far: np.ndarray) -> np.ndarray:
        """(...) whether all distances (..., P) are APART, or as at rest if less."""
        at_rest = self.judge.distances(self.rest[None])[0]
        return (far > np.minimum(APART, 0.9 * at_rest)).all(axis=-1)

    def postures(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """(count, n) random ones within limits; prescribed joints are as at rest."""
        judge, moved = self.judge, self.law.controlled
        low, high, rest = judge.lower[moved], judge.upper[moved], self.rest[moved]
        low = np.where(np.isfinite(low), low, rest - FREE) + INSIDE
        high = np.where(np.isfinite(high), high, rest + FREE) - INSIDE
        q = np.tile(self.rest, (count, 1))
        q[:, moved] = rng.uniform(low, high, (count, len(moved)))
        return q

    def follow(
        self, targets: np.ndarray, prescribed: np.ndarray | None = None
    ) -> tuple[np.ndarray, Run]:
        """The errors (K, P) [m] at targets (K, 3, P, 3), a row a period, and what the
        robot did; nothing is violated."""
        found = run(self.law, targets, prescribed=prescribed, instants=2)
        assert_nothing_is_violated(self.judge, self.law, found)
        at = self.points(found.q[:: found.instants])
        return np.linalg.norm(at - targets[:, 0], axis=2), found
