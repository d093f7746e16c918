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
from crar_drake.equations.admission import farther
from crar_drake.equations.nearby import held_path_bounds, nearby_distances


class Nearby:
    """The pairs of a robot's shapes near a motion, and near the law's steps."""

    def __init__(self, law: ControlLaw) -> None:
        """
        Args:
            law: on a robot whose root is fixed, and whose watched shapes are capsules
                and spheres; its constraints are "lookahead".
        """
        model, ahead = law.model, law.parameters.lookahead
        self._mode: LookaheadMode = law.mode
        self._order = model.order
        self._lower, self._upper = model.lower, model.upper
        self._fastest = law.speed_limits[model.controlled]
        self._controlled = model.controlled_positions
        self._farthest = law.mode.reaches.value.farthest
        self._pair_of_shapes = model.pairs.pair_of_shapes
        self._gains = law.mode.admission
        self._farther = farther(np.zeros(len(model.order)), self._gains)
        self._margin, self._influence = ahead.distance_margin, ahead.influence_distance
        self._watched = np.zeros(len(self._farthest), dtype=bool)

    @property
    def num_watched(self) -> int:
        """Pairs of links that the law looked at since `begin`."""
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
        self._q, self._ways = q, (1.0 + self._gains.T * rate) * ways
        ends = (q[:-1] + self._ways)[:, self._controlled]
        self._within = (
            (speeds <= self._fastest) & (ends >= self._lower) & (ends <= self._upper)
        ).all(axis=1)
        self._watched[:] = False
        self._clear: dict[int, bool] = {}

    def clear(self, frame: int) -> bool:
        """Whether the way to the next frame, and braking from there as fast as on it,
        keeps the law's margin, and within all limits of joints."""
        if frame not in self._clear:
            within = bool(self._within[frame])
            self._clear[frame] = within and self._keeps_margin(frame)
        return self._clear[frame]

    def _keeps_margin(self, frame: int) -> bool:
        start, way = self._q[frame], self._ways[frame]
        enough = self._margin + 0.5 * self._travel(way)
        rows = self._nearer(start + 0.5 * way, enough)[1]
        if not len(rows):
            return True
        some = self._mode.of_some(rows)
        found = held_path_bounds(
            start[self._order],
            way[self._order],
            np.full(len(rows), self._margin),
            np.ones(len(rows), dtype=bool),
            some.robot,
            some.reaches,
        )
        return not (found.at >= 0.0).any()

    def watching(
        self, q: np.ndarray, v: np.ndarray, fastest: np.ndarray
    ) -> LookaheadMode:
        """The law's constraints, on the pairs that a step can be influenced by.

        Args:
            q, v: (nq,), (nv,) state of the plant.
            fastest: (nv,) a guess of |s| of the step, see `all_clear`.
        """
        travel = self._travel(self._gains.T * v)
        room = self._gains.floor + self._travel(self._farther * fastest)
        room = np.maximum(self._influence, room)
        d, rows = self._nearer(q, room + travel)
        if not len(rows):
            rows = np.array([d.argmin()])
        self._watched[rows] = True
        others = np.ones(len(d), dtype=bool)
        others[rows] = False
        self._others, self._room = others, (d - travel)[others]
        return self._mode.of_some(rows)

    def all_clear(self, s: np.ndarray) -> bool:
        """Whether a step leaves all pairs clear that `watching` left out.

        Args:
            s: (nv,) velocity of where the robot would come to rest, in the plant's
                order.
        """
        moved = self._travel(self._farther * s)[self._others]
        return bool((self._room - moved >= self._gains.floor).all())

    def _travel(self, x: np.ndarray) -> np.ndarray:
        """(A6) of all pairs, (Nr,) [m], for joints that move by x (nv,)."""
        return self._farthest @ np.abs(x[self._order])

    def _nearer(
        self, q: np.ndarray, enough: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(Nr,) bounds for the distances at q (nq,), and the rows that are nearer than
        `enough` (Nr,) [m]."""
        d = nearby_distances(q[None], enough[None], self._mode.robot)[0]
        return d, np.flatnonzero(d < enough)
