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

from crar_drake.law.approach import Approach
from crar_drake.law.compilation import Held, compiled
from crar_drake.law.moving_obstacles import (
    Levels,
    Moving,
    Spheres,
    braking_line,
    command_line,
    evading_rows,
    line_bounds,
    own_reach,
    present_levels,
    sphere_rows,
)
from crar_drake.law.pairs import of_controlled
from crar_drake.law.projection import Rows, stacked
from crar_drake.law.step import SafetyCheck, State
from crar_drake.law.vectors import times


class MovingSpheres:
    """The constraint of moving obstacles; `place` tells of them before each step.

    Attributes:
        clear: (N,) bool, of which spheres the state is known to be safe.
    """

    name = "obstacle"

    def __init__(
        self, robot: Held, world: Held, approach: Approach, floor: float
    ) -> None:
        """
        Args:
            robot: holds a `Robot` in closed form, all of whose joints are controlled.
            world: holds `WorldLaw`.
            approach: of the rows.
            floor: d_0 [m].
        """
        self._robot, self._world, self._approach = robot, world, approach
        self._floor = floor
        self.place(None, np.zeros(0, dtype=bool), None)

    def place(
        self, spheres: Spheres | None, clear: np.ndarray, moving: Moving | None
    ) -> None:
        """Tells where spheres are.

        Args:
            spheres: (N,) of them; None if there are none.
            clear: as of the attribute.
            moving: those that are evaded; None if none is.
        """
        self._spheres, self.clear, self._moving = spheres, clear, moving
        self._evading: Rows | None = None
        self.evaded = (-1, -1)

    def is_safe(self, q: np.ndarray, v: np.ndarray, T: float) -> bool:
        """Among obstacles T is fixed."""
        return T == self._world.value.numbers.T

    def begin(self, state: State) -> None:
        if self._spheres is None:
            return
        line = braking_line(state.q, state.v, self._world)
        self._levels = present_levels(
            line, self.clear, self._spheres, self._robot.value, self._world
        )
        if self._moving is not None:
            self._evade(state)

    def _share(self, state: State) -> float:
        """Of T that the spheres are known to be passed over, in the state's [1]: until
        T has come to theirs nothing is shown of them."""
        return self._world.value.numbers.T / state.T

    def _over_own(self, state: State, s: np.ndarray) -> np.ndarray:
        """(nv,) s of the same acceleration over their own T."""
        share = self._share(state)
        return s if share == 1.0 else state.v + share * (s - state.v)

    def _evade(self, state: State) -> None:
        """Asks for rows if what is desired leaves (M5)."""
        desired, period = state.desired, state.period
        if desired is None:
            desired = state.whole(state.nominal)
        after = state.v + period / state.T * (desired - state.v)
        g, least, who = evading_rows(
            *(state.q, state.v, after, self._moving, self._robot.value, self._world)
        )
        if not len(least):
            return
        now = times(g, state.v)
        by = now + (least - now) * (state.T / period)
        rows = of_controlled(g, by, desired, state.n)
        weight = np.full(len(by), self._world.value.evasion.weight)
        self._evading, state.keep_rows = rows._replace(weight=weight), True
        self.evaded = tuple(who[int(np.argmax(least - times(g, after)))])

    def rows(self, state: State) -> Rows | None:
        if self._spheres is None:
            return None
        s, share = state.whole(state.nominal), self._share(state)
        g, least = sphere_rows(
            *(state.q, state.v, self._over_own(state, s), self._spheres),
            *(self._approach, self._robot.value, self._world),
        )
        least = (least - (1.0 - share) * times(g, state.v)) / share
        rows = of_controlled(g, least, s, state.n)
        return rows if self._evading is None else stacked([rows, self._evading])

    def examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        if self._spheres is None:
            return SafetyCheck(True, np.inf)
        safe, clearance, link, sphere, moved = check_spheres(
            *(state.q, state.v, self._over_own(state, s), self._levels, correct),
            *(self._spheres, self._robot, self._world),
        )
        if safe:
            return SafetyCheck(True, clearance)
        # No rows: a correction would leap to where the sphere cannot come any more.
        joints = moved > 0.0 if moved.any() else None
        share = 0.0
        if self._share(state) == 1.0:
            share = harmless_share(state.q, state.v, s, self._world)
        return SafetyCheck(False, clearance, None, joints, (link, sphere), share=share)

    def clear_after(self, braked: bool) -> np.ndarray:
        """(N,) bool, of which spheres the next state is safe: the present one is, or
        the step was shown to keep the safety distance, which braking is not."""
        if self._spheres is None or braked:
            return self.clear
        return self.clear | (self._levels.moving >= self._floor).all(axis=0)


@compiled
def harmless_share(q: np.ndarray, v: np.ndarray, s: np.ndarray, world: Held) -> float:
    """The share of s (nv,) that leads to a state as slow as is harmless, at most 1."""
    links, numbers = world.value.links.value, world.value.numbers
    reach = own_reach(braking_line(q, v, world), links) + links.turned
    left = numbers.kappa * (numbers.harmless - times(reach, np.abs(v)))
    asked = (numbers.period / numbers.T) * times(reach, np.abs(s))
    share = 1.0
    for i in range(len(left)):
        if asked[i] > 0.0:
            share = min(share, 0.999 * left[i] / asked[i])
    return max(share, 0.0)


@compiled
def check_spheres(
    q: np.ndarray,
    v: np.ndarray,
    s: np.ndarray,
    levels: Levels,
    all_of_them: bool,
    spheres: Spheres,
    robot: Held,
    world: Held,
) -> tuple[bool, float, int, int, np.ndarray]:
    """Whether a step, and the braking path that it leads to, keep off all spheres.

    Args:
        q, v, s: (nv,), (nv,), (nv,) state and step.
        levels: what links are to keep.
        all_of_them: whether all that are too near are looked for.
        spheres: (N,) of them.
        robot, world: hold `Robot` and `WorldLaw`.

    Returns:
        Whether they do; the clearance [m]; the link and the sphere that lack the most;
        where all are looked for (nv,) 1 for the joints that move what is too near.
    """
    links, numbers = world.value.links.value, world.value.numbers
    v_next = v + numbers.period / numbers.T * (s - v)
    line = command_line(q, v_next, world)
    found = line_bounds(line, levels, not all_of_them, spheres, robot.value, world)
    moved = np.zeros(len(q))
    if not found.clear and all_of_them:
        for i in range(len(found.failed)):
            if found.failed[i].any():
                moved = np.maximum(moved, links.carried[i])
    return found.clear, found.clearance, found.link, found.sphere, moved
