"""Links stay off spheres that move by themselves, or are slow.

Lemma: braking keeps it. A sphere of bounded speed V is within its radius and V t of
where it is now. Along the braking path each link keeps the safety distance d_0 and what
the sphere can come nearer until the robot is there, as long as the link is faster than
a contact speed v_ok; from there on it keeps d_0 of the sphere as it is. A period on the
robot is farther on the same segment, and t(u) = t(u') + period: (M1), (M2) of
`docs/theory/moving-obstacles.md`.

Rows: as those of pairs, of the nearest shape of each link; and where spheres that come
are evaded, (M5).
"""

import numpy as np

from crar_drake.errors import ScenarioError
from crar_drake.law.approach import Approach
from crar_drake.law.compilation import compiled, hold
from crar_drake.law.moving_obstacles import (
    MOVING,
    STILL,
    Spheres,
    World,
    evading_rows,
    harmless_share,
    line_bounds,
    passing,
    sphere_rows,
)
from crar_drake.law.obstacles import NOBODY, Obstacles, Regions, Seen, at_places
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.law.path_bounds import FALLING, FIRST, LOWEST
from crar_drake.law.projection import Rows, hard_rows, stacked
from crar_drake.law.step import SafetyCheck, State, Step
from crar_drake.law.tracking_error import joint_errors
from crar_drake.robot.model import ControlModel
from crar_drake.robot.watched_links import watched_links

# What is evaded is kept so much farther than the floor [m]. Of what was tried on other
# scenes than those of docs/measurements/scenes.md, this lets arms be touched the least
# that are free to move; with less they are caught, with more they reach less.
_KEPT_MORE = 0.04
# What a row of (M5) lacks, beside what joints are changed by [1/m^2]: a link that they
# move by less than 6 cm per rad is left to itself.
_WEIGHT = 300.0
# Of whom nothing is heard for longer, nobody knows where to go [s].
_SEEN = 0.25

# What rounding takes of a sphere that is in another [m]: the floor has it to spare.
_ROUNDING = 1e-9


class MovingSpheres:
    """The constraint of moving obstacles; `place` tells of them before each step.

    Attributes:
        links: names of the links that count: those of watched pairs that move and have
            capsules or spheres.
        kept_at: d_e, the distance from what is evaded [m].
        clear: (N,) bool, of which spheres the state is known to be safe.
    """

    name = "obstacle"

    def __init__(
        self,
        model: ControlModel,
        gains: LookaheadParameters,
        approach: Approach,
        T: float,
    ) -> None:
        """
        Args:
            model, gains: of the law or the filter.
            approach: of the rows.
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
        floor = float(gains.safety_distance)
        self._links, self.links = watched_links(model, joint_errors(gains, model))
        self._numbers = passing(T, period, floor, float(gains.contact_speed))
        self._world = hold(World(self._links, self._numbers))
        self._approach, self.kept_at = approach, floor + _KEPT_MORE
        nothing = Seen(NOBODY, np.zeros((0, 3)), np.zeros(0))
        self._nobody = Regions(
            NOBODY, np.zeros(0, dtype=bool), seen=nothing if gains.evade else None
        )

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
        before = before or self._nobody
        old, places = before.spheres, given.places_in(before.spheres)
        apart = np.linalg.norm(given.centres - at_places(old.centres, places), axis=1)
        radii = at_places(old.radii, places)
        within = apart + given.radii <= radii + _ROUNDING
        within &= given.speeds <= at_places(old.speeds, places)
        clear = within & (at_places(before.clear, places) == 1.0)
        unknown = np.flatnonzero(~clear)
        if len(unknown):
            of = _spheres(given, unknown), self._numbers.floor, -np.inf
            clear[unknown] = ~self._present(q, v, *of).any(axis=(0, 1))
        too_fast, seen = (), before.seen
        if given.names is not None:
            leapt = apart > given.radii + radii + _ROUNDING
            too_fast = tuple(given.names[i] for i in np.flatnonzero(leapt))
        if seen is not None:
            seen = seen.anew(given, places, self._numbers.period, 0.5 * self._numbers.T)
        return Regions(given, clear, too_fast, seen)

    def _present(
        self,
        q: np.ndarray,
        v: np.ndarray,
        spheres: Spheres,
        moving: float | np.ndarray,
        still: float,
    ) -> np.ndarray:
        """What `line_bounds` finds lacking on the present braking path, of what all
        links are to keep of spheres, all alike or (N,) [m]."""
        keep = np.empty((2, len(self.links), len(spheres.radius)))
        keep[MOVING], keep[STILL] = moving, still
        return line_bounds(q, v, 0.0, keep, LOWEST, spheres, self._world)[0]

    def place(self, regions: Regions) -> None:
        """Tells where obstacles are taken to be."""
        self._spheres, self.clear = _spheres(regions.spheres), regions.clear
        self._seen, self._evading = regions.seen, None
        self._evaded = (-1, -1)

    def evaded(self, seen: Seen) -> tuple[Spheres, np.ndarray]:
        """Those that may move, where they are by now, with d_e in their radii; and
        (N, 3) their velocities [m/s]."""
        of = seen.spheres
        some = np.flatnonzero((of.speeds > 0.0) & (seen.age <= _SEEN))
        velocity = np.nan_to_num(seen.velocity[some])
        centres = of.centres[some] + seen.age[some, None] * velocity
        radii = of.radii[some] + self.kept_at
        return Spheres(centres, radii, of.speeds[some]), velocity

    def is_safe(self, q: np.ndarray, v: np.ndarray, T: float) -> bool:
        """Among obstacles T is fixed."""
        return T == self._numbers.T

    def begin(self, state: State) -> None:
        floor = self._numbers.floor
        asked = self._spheres, np.where(self.clear, -np.inf, floor), floor
        # What links are to keep: the floor, or as much as braking is shown to keep.
        self._keep = floor - self._present(state.q, state.v, *asked)
        if self._seen is not None:
            self._evade(state)

    def _evade(self, state: State) -> None:
        """Asks for rows if what is desired leaves (M5)."""
        desired = state.desired
        if desired is None:
            desired = state.whole(state.nominal)
        after = _after(state, desired)
        moving = self.evaded(self._seen)
        g, least, who = evading_rows(state.q, after, *moving, self._world)
        lacks = least - g @ after
        if not (lacks > 0.0).any():
            return
        rows = _rows_of_s(g, least, state.T / state.period, state, desired)
        self._evading = rows._replace(weight=np.full(len(least), _WEIGHT))
        state.keep_rows = True
        self._evaded = tuple(who[np.argmax(lacks)])

    def rows(self, state: State) -> Rows:
        s = state.whole(state.nominal)
        of = self._spheres, self._approach, self._world
        g, least = sphere_rows(state.q, state.v, s, *of)
        # They are of the same acceleration over their own T.
        rows = _rows_of_s(g, least, state.T / self._numbers.T, state, s)
        return rows if self._evading is None else stacked([rows, self._evading])

    def examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        line = state.q, _after(state, s), self._numbers.period
        of = self._spheres, self._world
        if not correct:
            safe, clearance, worst = _first_lack(*line, self._keep, *of)
            return SafetyCheck(safe, clearance, index=worst)
        lacks, clearance = line_bounds(*line, self._keep, FALLING, *of)
        if not lacks.any():
            return SafetyCheck(True, clearance)
        _, *worst = np.unravel_index(np.argmax(lacks), lacks.shape)
        # No rows: a correction would leap to where the sphere cannot come any more.
        failed = self._links.carried[lacks.any(axis=(0, 2))].any(axis=0)
        change = state.period / state.T * s
        share = harmless_share(state.q, state.v, change, self._world)
        return SafetyCheck(False, clearance, None, failed, tuple(worst), "", share)

    def clear_after(self, braked: bool) -> np.ndarray:
        """(N,) bool, of which spheres the next state is safe: the present one is, or
        the step was shown to keep the safety distance, which braking is not."""
        if braked:
            return self.clear
        return self.clear | (self._keep[MOVING] >= self._numbers.floor).all(axis=0)

    def ran_into(self, regions: Regions, found: Step) -> tuple[str, str] | None:
        """The obstacle and the link that held back a step; None of none."""
        link, sphere = self._evaded
        check = found.objections.get(self.name)
        if check is not None:
            link, sphere = check.index
        names = str(regions.spheres.keys[sphere]), self.links[link]
        return None if link < 0 else names


@compiled
def _first_lack(q, v, before, keep, spheres, world):
    """Whether `line_bounds` finds nothing lacking; its clearance; the link and sphere
    of what it finds first. Arrays take time to hand out."""
    lacks, clearance = line_bounds(q, v, before, keep, FIRST, spheres, world)
    worst, (_, links, N) = np.argmax(lacks), lacks.shape
    return not lacks.any(), clearance, (worst // N % links, worst % N)


def _spheres(of: Obstacles, which: np.ndarray | slice = slice(None)) -> Spheres:
    """Some of them, for the equations."""
    return Spheres(of.centres[which], of.radii[which], of.speeds[which])


def _after(state: State, s: np.ndarray) -> np.ndarray:
    """(nv,) the velocity to which a step s (nv,) leads, a period on [rad/s or m/s]."""
    return state.v + state.period / state.T * (s - state.v)


def _rows_of_s(
    g: np.ndarray, least: np.ndarray, factor: float, state: State, s: np.ndarray
) -> Rows:
    """Rows on a velocity (nv,) as those on s, which changes by a factor more; the
    joints that are not controlled do as s (nv,) says."""
    now = g @ state.v
    return hard_rows(g, now + factor * (least - now), s[state.n :])
