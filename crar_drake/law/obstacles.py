"""Obstacles that move by themselves: what is measured of them, and what is known since.

`docs/theory/moving-obstacles.md` has the theorem and its proof; the constraint is in
`law.spheres`.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from crar_drake.errors import InputError


class Obstacles:
    """N spheres, measured now; never changed.

    Attributes:
        centres: (N, 3) in the world [m].
        radii: (N,) [m].
        speeds: (N,) no point of them is faster, until they are measured again [m/s].
        names: (N,) of each; None where nobody says which is which.
    """

    def __init__(
        self,
        centres: ArrayLike,
        radii: ArrayLike,
        speeds: ArrayLike,
        names: tuple[str, ...] | None = None,
    ) -> None:
        """
        Args:
            centres: (N, 3) in the world [m].
            radii, speeds: (N,), or one for all [m], [m/s].
            names: (N,) of each, each once; those of a call before that have the same
                names are the same.

        Raises:
            InputError: a size is wrong, or a number is none, or negative.
        """
        try:
            centres = np.array(centres, dtype=float, order="C")
            if not centres.size:
                centres = centres.reshape(0, 3)
            n = len(centres)
            if centres.shape != (n, 3):
                raise ValueError(f"centres have shape {centres.shape}")
            radii, speeds = (
                np.array(np.broadcast_to(np.asarray(x, dtype=float), (n,)))
                for x in (radii, speeds)
            )
        except (TypeError, ValueError) as error:
            raise InputError(
                "obstacles: give (N, 3) centres, (N,) radii and (N,) speeds, or one "
                f"radius or speed for all: {error}"
            ) from None
        sizes = {"radii": radii, "speeds": speeds}
        for what, value in {"centres": centres, **sizes}.items():
            bad = ~np.isfinite(value) | ((value < 0.0) & (what in sizes))
            if bad.any():
                of = np.flatnonzero(bad.reshape(n, -1).any(axis=1))[0]
                raise InputError(
                    f"obstacles: {what} of sphere {of} are {value[of]}: they must be "
                    f"finite{' and not negative' if what in sizes else ''}"
                )
        if names is not None:
            names = tuple(map(str, names))
            if len(names) != n or len(set(names)) != n:
                raise InputError(f"obstacles: give {n} different names, or none")
        self.centres, self.radii, self.speeds = centres, radii, speeds
        self.names = names

    @staticmethod
    def of_port(values: np.ndarray, speeds: np.ndarray) -> Obstacles:
        """Those of an input port (4 N,), [x; y; z; radius] of each [m]."""
        spheres = values.reshape(-1, 4)
        return Obstacles(spheres[:, :3], spheres[:, 3], speeds)

    def __len__(self) -> int:
        return len(self.radii)

    def with_radii(self, radii: np.ndarray) -> Obstacles:
        """The same, with other radii (N,) [m]."""
        other = copy(self)
        other.radii = radii
        return other

    @property
    def keys(self) -> Sequence[str | int]:
        """(N,) of each its name, or its number."""
        return range(len(self)) if self.names is None else self.names

    def places_in(self, before: Obstacles) -> np.ndarray:
        """(N,) where each was among those before, by its name or number; or -1."""
        at = {key: i for i, key in enumerate(before.keys)}
        return np.array([at.get(key, -1) for key in self.keys], dtype=int)


NOBODY = Obstacles([], [], [])
NO_PORT = "there is no port for obstacles: give obstacle_speeds when it is made"


def checked_speeds(system: str, speeds: Sequence[float]) -> np.ndarray:
    """(N,) bounds of obstacles' speeds [m/s]; raises InputError, with the name of a
    system that is made with them: one is not a number, infinite or negative."""
    try:
        return Obstacles(np.zeros((len(speeds), 3)), 0.0, speeds).speeds
    except (TypeError, InputError) as error:
        raise InputError(f"{system}: obstacle_speeds are {speeds!r}: {error}") from None


def at_places(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Those of values (N, ...) that are at places (M,); NaN at -1."""
    missing = np.full((1, *values.shape[1:]), np.nan)
    return np.concatenate((values, missing))[places]


@dataclass(frozen=True)
class Seen:
    """What was measured last, and how it moves: a guess, of which nothing is proved."""

    spheres: Obstacles  # as they were measured
    velocity: np.ndarray  # (N, 3) of the centres; NaN while not known [m/s]
    age: np.ndarray  # (N,) how long ago each was measured [s]

    def later(self, period: float) -> Seen:
        """A period [s] on."""
        return Seen(self.spheres, self.velocity, self.age + period)

    def anew(
        self, given: Obstacles, places: np.ndarray, period: float, smoothed: float
    ) -> Seen:
        """What is measured now, with velocities by the difference from before.

        Args:
            given: measured now, the M of them.
            places: (M,) where each was before, or -1.
            period: between two measurements at least [s].
            smoothed: time constant of the velocities' low-pass [s].
        """
        then, radii = (
            at_places(of, places) for of in (self.spheres.centres, self.spheres.radii)
        )
        passed = np.maximum(at_places(self.age, places), period)
        # In the same place, but larger: nobody looked since.
        stale = (given.centres == then).all(axis=1) & (given.radii > radii)
        rate = (given.centres - then) / passed[:, None]
        length = np.linalg.norm(rate, axis=1)
        rate *= np.minimum(1.0, given.speeds / np.maximum(length, 1e-12))[:, None]
        # Smoothed; but the first difference is all that is known.
        was, share = at_places(self.velocity, places), passed / (passed + smoothed)
        velocity = np.where(np.isnan(was), rate, was + share[:, None] * (rate - was))
        return Seen(
            given.with_radii(np.where(stale, radii, given.radii)),
            np.where(stale[:, None], was, velocity),
            np.where(stale, passed, 0.0),
        )


@dataclass(frozen=True)
class Regions:
    """Where obstacles are taken to be at a step, R_k of the theorem."""

    spheres: Obstacles  # of which each obstacle is in one
    clear: np.ndarray  # (N,) bool, whether the state is known to be clear of each
    # of the named ones that were measured where they could not be, had they kept the
    # bound of their speed
    too_fast: tuple[str, ...] = ()
    seen: Seen | None = None  # what is evaded; None where nothing is

    def later(self, period: float, clear: np.ndarray | None = None) -> Regions:
        """A period [s] on, where nothing is measured, with what is then clear."""
        of = self.spheres
        grown = of.with_radii(of.radii + period * of.speeds)
        seen = None if self.seen is None else self.seen.later(period)
        return Regions(grown, self.clear if clear is None else clear, seen=seen)
