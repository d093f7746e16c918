"""How a base slides over soles that stand, and how its legs follow."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from crar_drake.equations.moving_legs import Legs, leg_motion

SLIDES = ("base_x", "base_y", "base_z")  # joints that carry such a base


@dataclass(frozen=True)
class MovingPelvis:
    """A box that a base slides in, along the world's axes, and the legs below.

    What is said of it holds in all of the box; `robot.pelvis_box` shows it.
    """

    lower: np.ndarray  # (3,) from where to where the base may go from rest [m]
    upper: np.ndarray
    speed: np.ndarray  # (3,) along each axis, at which legs keep their limits [m/s]
    joints: tuple[str, ...]  # (L,) names of the legs' joints
    rest: np.ndarray  # (L,) these where the robot rests: there its soles stand
    degrees: np.ndarray  # as the next three, of `equations.moving_legs.Legs`
    coefficients: np.ndarray
    powers: np.ndarray
    bounds: np.ndarray
    # (3,) a place in the box; to the law, legs are on the base as they are there [m]
    held: np.ndarray
    # link of a leg to how far its capsules go from where they then are [m]
    swellings: dict[str, float]
    sole_error: float  # how far a corner of a sole goes from where it stands [m]

    @property
    def middle(self) -> np.ndarray:
        """(3,) of the box [m]."""
        return 0.5 * (self.lower + self.upper)

    @property
    def half(self) -> np.ndarray:
        """(3,) half of the box's edges [m]."""
        return 0.5 * (self.upper - self.lower)

    def positions(self, p: np.ndarray) -> np.ndarray:
        """(K, L) of the legs' joints where the base is at (K, 3) [rad]."""
        s = (p - self.middle) / self.half
        most = int(self.degrees.max())
        x, y, z = (
            chebyshev.chebvander(s[:, k], most)[:, self.degrees[:, k]] for k in range(3)
        )
        return (x * y * z) @ self.coefficients

    def motion(self, p: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(3, L) positions, velocities and accelerations of the legs' joints, of those
        (3,) of the base [rad, rad/s, rad/s^2]."""
        legs = self.legs(np.arange(3), np.arange(3), *np.zeros((2, 0), dtype=int))
        at, rate, bend = leg_motion(p, v, legs)
        return np.array([at, rate, bend + leg_motion(p, a, legs)[1]])

    def legs(
        self,
        slide_q: Sequence[int],
        slide_v: Sequence[int],
        leg_q: Sequence[int],
        leg_v: Sequence[int],
    ) -> Legs:
        """For the equations, with where in q and v slides and joints are."""
        indices = (
            np.array(x, dtype=np.int64) for x in (slide_q, slide_v, leg_q, leg_v)
        )
        return Legs(
            *indices, self.middle, self.half,
            np.ascontiguousarray(self.degrees, dtype=np.int64),
            np.ascontiguousarray(self.coefficients),
            np.ascontiguousarray(self.powers, dtype=np.int64),
            np.ascontiguousarray(self.bounds),
        )  # fmt: skip


class WholeCommand:
    """A command of the robot as the law sees it, as one of the robot on its soles."""

    def __init__(self, pelvis: MovingPelvis | None, names: Sequence[str]) -> None:
        """
        Args:
            pelvis: of the robot; None where base and legs stand still.
            names: (n,) joints of the command, each with one position.
        """
        self._pelvis = pelvis
        if pelvis is not None:
            names = list(names)
            self._slides = [names.index(name) for name in SLIDES]
            self._legs = [names.index(name) for name in pelvis.joints]

    def __call__(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions, velocities and accelerations: (3, n) of the joints, those of the
        legs as they follow, and (3, 3) of the base from where it rests [m].

        Args:
            q, v, a: (n,) of the command.
        """
        joints = np.array([q, v, a])
        if self._pelvis is None:
            return joints, np.zeros((3, 3))
        base = joints[:, self._slides]
        joints[:, self._legs] = self._pelvis.motion(*base)
        return joints, base
