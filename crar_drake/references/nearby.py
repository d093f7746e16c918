"""Which pairs of shapes can matter to a step; of the others it is shown that none can.

Most of a whole robot's pairs are far apart at any time. Where joints move by |x_j|, no
distance changes by more than (A6) of `equations.admission`. So a pair that is farther
apart than that, and than the law's influence, need not be looked at: the step is the
same to the last bit, and just as surely clear.
"""

from __future__ import annotations

import numpy as np

from crar_drake.control.law import ControlLaw
from crar_drake.control.modes.lookahead import LookaheadMode
from crar_drake.equations.admission import farther, path_bounds
from crar_drake.equations.nearby import nearby_distances


class Nearby:
    """The pairs of a robot's shapes near a motion, and near the law's steps.

    Attributes:
        spare: pairs that are so much farther away than those that matter are looked
            at, too, lest others be chosen in every step [m].
    """

    spare = 0.05

    def __init__(self, law: ControlLaw) -> None:
        """
        Args:
            law: on a robot whose root is fixed, and whose watched shapes are capsules
                and spheres; its constraints are "lookahead".
        """
        model, ahead = law.model, law.parameters.lookahead
        self._mode: LookaheadMode = law.mode
        self._robot = law.mode.robot
        self._order = model.order
        self._lower, self._upper = model.lower, model.upper
        self._fastest = law.speed_limits[model.controlled]
        self._controlled = model.controlled_positions
        self._farthest = law.mode.reaches.value.farthest
        self._pair_of_shapes = model.pairs.pair_of_shapes
        self._gains = law.mode.admission
        self._margin, self._influence = ahead.distance_margin, ahead.influence_distance
        self._some: LookaheadMode | None = None
        self._chosen = np.zeros(len(self._farthest), dtype=bool)
        self._watched = self._chosen.copy()

    @property
    def num_watched(self) -> int:
        """Pairs of links that were looked at since `begin`."""
        return len(np.unique(self._pair_of_shapes[self._watched]))

    def begin(self, q: np.ndarray, rate: float) -> None:
        """A new reference.

        Args:
            q: (T, nq) positions of the plant.
            rate: frames per second [Hz].
        """
        ways = np.diff(q, axis=0)
        speeds = np.abs(ways[:, self._controlled]) * rate
        # Each way, and the braking path that begins where it ends.
        self._ways = (1.0 + self._gains.T * rate) * ways
        ends = (q[:-1] + self._ways)[:, self._controlled]
        self._within = (
            (speeds <= self._fastest) & (ends >= self._lower) & (ends <= self._upper)
        ).all(axis=1)
        travel = 0.5 * np.abs(self._ways[:, self._order]) @ self._farthest.T
        enough = self._margin + travel
        middles = q[:-1] + 0.5 * self._ways
        near = nearby_distances(middles, enough, self._robot) < enough
        rows = np.flatnonzero(near.any(axis=0))
        self._near, self._q = np.ascontiguousarray(near[:, rows]), q
        self._near_mode = self._mode.of_some(rows) if len(rows) else None
        self._watched[:] = False
        self._some = None
        self._clear = np.full(len(ways), -1)

    def clear(self, frame: int) -> bool:
        """Whether the way to the next frame, and braking from there as fast as on it,
        keeps the law's margin, and within all limits of joints."""
        if self._clear[frame] < 0:
            self._clear[frame] = self._within[frame] and self._keeps_margin(frame)
        return bool(self._clear[frame])

    def _keeps_margin(self, frame: int) -> bool:
        asked = self._near[frame]
        if not asked.any():
            return True
        mode, order = self._near_mode, self._order
        found = path_bounds(
            self._q[frame][order],
            self._ways[frame][order],
            np.full(len(asked), self._margin),
            asked,
            mode.robot.value,
            mode.reaches,
        )
        return not (found.at >= 0.0).any()

    def watching(self, q: np.ndarray, v: np.ndarray, spare: float) -> LookaheadMode:
        """The law's constraints, on the pairs that a step can be influenced by.

        Args:
            q, v: (nq,), (nv,) state of the plant.
            spare: pairs so much farther away are to be among them, too [m].
        """
        travel = self._farthest @ (self._gains.T * np.abs(v[self._order]))
        enough = self._influence + max(spare, self.spare) + travel
        room = nearby_distances(q[None], enough[None], self._robot)[0] - travel
        needed = room < self._influence + spare - self.spare
        if self._some is None or (needed & ~self._chosen).any():
            self._chosen = room < self._influence + spare
            if not self._chosen.any():
                self._chosen[room.argmin()] = True
            self._some = self._mode.of_some(np.flatnonzero(self._chosen))
            self._watched |= self._chosen
            self._far = self._farthest[~self._chosen]
        self._room = room[~self._chosen]
        return self._some

    def all_clear(self, s: np.ndarray) -> bool:
        """Whether a step leaves all other pairs clear, with the floor and more.

        Args:
            s: (nv,) velocity of where the robot would come to rest, in the plant's
                order.
        """
        moved = farther(s, self._gains) * np.abs(s[self._order])
        left = self._room - self._far @ moved
        return not len(left) or left.min() >= self._gains.floor
