"""Obstacles that move by themselves, for the safety filter.

`docs/theory/moving-obstacles.md` has the theorem and its proof; the equations are in
`law.moving_obstacles` and `law.spheres`.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from crar_drake.errors import InputError, ScenarioError
from crar_drake.law.approach import Approach
from crar_drake.law.compilation import Held, hold
from crar_drake.law.moving_obstacles import (
    Evasion,
    Moving,
    Spheres,
    WorldLaw,
    are_clear,
    passing,
)
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.law.spheres import MovingSpheres
from crar_drake.law.step import Step
from crar_drake.law.tracking_error import joint_errors
from crar_drake.robot.model import ControlModel
from crar_drake.robot.watched_links import watched_links

# What is evaded is kept so much farther than the floor [m]. Of what was tried on other
# scenes than those of docs/measurements/scenes.md, this lets arms be touched the least
# that are free to move; with less they are caught, with more they reach less.
_KEPT_MORE = 0.04
# So fast a link may still go where it begins to evade who comes [m/s].
_FAST = 1.0
# What a row of (M5) lacks, beside what joints are changed by [1/m^2]: a link that they
# move by less than 6 cm per rad is left to itself.
_WEIGHT = 300.0
# Of whom nothing is heard for longer, nobody knows where to go [s].
_SEEN = 0.25

# What rounding takes of a sphere that is in another [m]: the floor has it to spare.
_ROUNDING = 1e-9


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
            radii, speeds = (
                np.array(np.broadcast_to(np.asarray(x, dtype=float), (n,)))
                for x in (radii, speeds)
            )
        except (TypeError, ValueError) as error:
            raise InputError(
                "obstacles: give (N, 3) centres, (N,) radii and (N,) speeds, or one "
                f"radius or speed for all: {error}"
            ) from None
        if centres.shape != (n, 3):
            raise InputError(
                f"obstacles: centres have shape {centres.shape}; it must be (N, 3)"
            )
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

    def __len__(self) -> int:
        return len(self.radii)

    def with_radii(self, radii: np.ndarray) -> Obstacles:
        """The same, with other radii (N,) [m]."""
        other = copy(self)
        other.radii = radii
        return other

    def name(self, i: int) -> str:
        """Its name, or its number."""
        return str(i) if self.names is None else self.names[i]


@dataclass(frozen=True)
class Seen:
    """What was measured last, and how it moves: a guess, of which nothing is proved."""

    spheres: Obstacles  # as they were measured
    velocity: np.ndarray  # (N, 3) of the centres; NaN while not known [m/s]
    age: np.ndarray  # (N,) how long ago each was measured [s]

    def later(self, period: float) -> Seen:
        """A period [s] on."""
        return Seen(self.spheres, self.velocity, self.age + period)


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


class ObstacleFilter:
    """What keeps the links of a robot from obstacles, or slow.

    Attributes:
        links: names of the links that count: those of watched pairs that move and have
            capsules or spheres.
        kept_at: d_e, the distance from what is evaded [m].
        constraint: of the step.
    """

    def __init__(
        self,
        model: ControlModel,
        gains: LookaheadParameters,
        approach: Approach,
        robot: Held,
        T: float,
    ) -> None:
        """
        Args:
            model, gains: of the law or the filter.
            approach: of the rows.
            robot: holds its `Robot` in closed form.
            T: braking time constant, which is fixed among obstacles [s].

        Raises:
            ScenarioError: a parameter does not go with obstacles.
        """
        period = float(gains.period)
        if not period < T:
            raise ScenarioError(
                f"controller.braking_time: with moving obstacles it ({T:g} s) "
                f"must be longer than the period ({period:g} s)"
            )
        speed = float(gains.contact_speed)  # v_ok
        errors = joint_errors(gains, model)
        links, self.links = watched_links(model, errors)
        self._floor = float(gains.safety_distance)
        numbers = passing(T, period, self._floor, speed)
        self._period, self._robot = period, robot
        self._evades, self._smoothed = gains.evade, 0.5 * T
        self.kept_at = self._floor + _KEPT_MORE
        slows = np.log(_FAST / (numbers.kappa * min(speed, _FAST)))  # (M1), to v_ok
        evasion = Evasion(1.0 / T, numbers.eta + numbers.T_star * slows, _WEIGHT)
        self._world = hold(WorldLaw(hold(links), numbers, evasion))
        self.constraint = MovingSpheres(robot, self._world, approach, self._floor)

    def regions(
        self,
        before: Regions | None,
        given: Obstacles | None,
        q: np.ndarray,
        v: np.ndarray,
    ) -> Regions | None:
        """Where obstacles are taken to be, at a state (n,), (n,): what is measured.

        Args:
            before: what the step before left.
            given: measured now; None if nothing was. It replaces all.
        """
        if given is None:
            return before
        if not len(given):
            return None
        places = _places(before, given)
        known = np.zeros(len(given), dtype=bool)
        some, was = np.flatnonzero(places >= 0), places[places >= 0]
        if len(some):
            old = before.spheres
            apart = np.linalg.norm(given.centres[some] - old.centres[was], axis=1)
            as_fast = given.speeds[some] <= old.speeds[was]
            within = apart + given.radii[some] <= old.radii[was] + _ROUNDING
            known[some] = as_fast & within & before.clear[was]
        too_fast = ()
        unknown = np.flatnonzero(~known)
        if len(unknown):
            known[unknown] = are_clear(
                q,
                v,
                _spheres(given, unknown),
                self._robot,
                self._world,
            )
        if len(some) and given.names is not None:
            meet = apart <= given.radii[some] + old.radii[was] + _ROUNDING
            too_fast = tuple(given.names[i] for i in some[~meet])
        seen = None
        if self._evades:
            seen = self._see(None if before is None else before.seen, places, given)
        return Regions(given, known, too_fast, seen)

    def _see(self, before: Seen | None, places: np.ndarray, given: Obstacles) -> Seen:
        """What is measured now, with velocities by the difference from before.

        Args:
            before: what was seen then, if anything.
            places: (N,) where each was among that, or -1.
            given: measured now.
        """
        n = len(given)
        velocity, age = np.full((n, 3), np.nan), np.zeros(n)
        some, was = np.flatnonzero(places >= 0), places[places >= 0]
        if before is None or not len(some):
            return Seen(given, velocity, age)
        old = before.spheres
        then = old.centres[was]
        passed = np.maximum(before.age[was], self._period)
        # In the same place, but larger: nobody looked since.
        same = (given.centres[some] == then).all(axis=1) & (
            given.radii[some] > old.radii[was]
        )
        fresh, at = some[~same], was[~same]
        rate = (given.centres[fresh] - then[~same]) / passed[~same, None]
        length = np.linalg.norm(rate, axis=1, keepdims=True)
        rate *= np.minimum(1.0, given.speeds[fresh, None] / np.maximum(length, 1e-12))
        # Smoothed; but the first difference is all that is known.
        share = (passed / (passed + self._smoothed))[~same, None]
        was_so = before.velocity[at]
        smoothed = was_so + share * (rate - was_so)
        velocity[fresh] = np.where(np.isnan(was_so), rate, smoothed)
        stale, at = some[same], was[same]
        velocity[stale], age[stale] = before.velocity[at], passed[same]
        radii = given.radii.copy()
        radii[stale] = old.radii[at]
        return Seen(given.with_radii(radii), velocity, age)

    def _moving(self, seen: Seen) -> Moving:
        """What is evaded: those that may move, where they are by now."""
        of = seen.spheres
        some = np.flatnonzero((of.speeds > 0.0) & (seen.age <= _SEEN))
        velocity = np.nan_to_num(seen.velocity[some])
        centres = of.centres[some] + seen.age[some, None] * velocity
        radii = of.radii[some] + self.kept_at
        return Moving(Spheres(centres, radii, of.speeds[some]), velocity)

    def place(self, regions: Regions) -> MovingSpheres:
        """The constraint, told where obstacles are taken to be."""
        moving = None if regions.seen is None else self._moving(regions.seen)
        shapes = _spheres(regions.spheres, slice(None))
        self.constraint.place(shapes, regions.clear, moving)
        return self.constraint

    def ran_into(self, regions: Regions, found: Step) -> tuple[str, str] | None:
        """The obstacle and the link that held back a step; None of none."""
        link, sphere = self.constraint.evaded
        check = found.objections.get(self.constraint.name)
        if check is not None:
            link, sphere = check.index
        return None if link < 0 else (regions.spheres.name(sphere), self.links[link])


def _spheres(of: Obstacles, which: np.ndarray | slice) -> Spheres:
    """Some of them, for the equations."""
    return Spheres(of.centres[which], of.radii[which], of.speeds[which])


def _places(before: Regions | None, given: Obstacles) -> np.ndarray:
    """(N,) where each was among those before, by its name or number; or -1."""
    places = np.full(len(given), -1)
    if before is None:
        return places
    old = before.spheres
    if (old.names is None) != (given.names is None):
        return places
    if given.names is None:
        both = min(len(old), len(given))
        places[:both] = np.arange(both)
        return places
    at = {name: i for i, name in enumerate(old.names)}
    return np.array([at.get(name, -1) for name in given.names])
