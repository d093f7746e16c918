"""A constraint of one's own in the safety filter: a hand stays above a table.

python examples/own_constraint.py [steps]
"""

import sys

import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable

from crar_drake import SafetyFilter
from crar_drake.law import Rows, SafetyCheck, State, hard_rows, lowest_on_segment


class HandAbove:
    """A point of a link stays above a height [m].

    Lemma: braking keeps it, for the next braking path is a part of the present one. A
    height that the present path is below already is replaced by the lowest there.
    """

    name = "table"

    def __init__(self, model, link: str, height: float, reach: float) -> None:
        self._plant, self._link = model.plant, model.plant.GetFrameByName(link)
        self._context = model.MakeWorkspace().plant_context
        self._height, self._reach = height, reach  # no axis is farther from the point

    def height_at(self, q: np.ndarray) -> float:
        self._plant.SetPositions(self._context, q)
        return self._link.CalcPoseInWorld(self._context).translation()[2]

    def _gradient(self, q: np.ndarray) -> np.ndarray:
        self.height_at(q)
        world, at = self._plant.world_frame(), (self._link, np.zeros(3))
        return self._plant.CalcJacobianTranslationalVelocity(
            self._context, JacobianWrtVariable.kV, *at, world, world
        )[2]

    def is_safe(self, q: np.ndarray, v: np.ndarray, T: float) -> bool:
        return self._left(q, T * v, self._height) >= 0.0

    def _left(self, q: np.ndarray, x: np.ndarray, height: float) -> float:
        """What is left above a height on the segment from q by x [m]."""
        curvature = self._reach * np.abs(x).sum() ** 2
        way = lambda w: self.height_at(q + w * x)  # noqa: E731
        return lowest_on_segment(way, curvature, height) - height

    def begin(self, state: State) -> None:
        rest = state.q + state.T * state.v
        self._kept = min(self._height, self.height_at(state.q), self.height_at(rest))
        state.keep_rows |= self._kept < self._height

    def rows(self, state: State) -> Rows:
        rest = state.q + state.T * state.v
        g = self._gradient(rest)
        least = min((self._height + 0.01 - self.height_at(rest)) / state.T, 0.2)
        return hard_rows(g[None], np.array([least]))

    def examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        x = state.segment(s)  # to where it would come to rest
        left = self._left(state.q, x, self._kept)
        if left >= 0.0 or not correct:
            return SafetyCheck(left >= 0.0, left)
        g = self._gradient(state.q + x)
        more = (1e-3 - left) * state.T / (state.period * (state.period + state.T))
        return SafetyCheck(False, left, hard_rows(g[None], np.array([g @ s + more])))


def main(steps: int = 500) -> None:
    filter, rng = SafetyFilter("upper_body", period=0.01), np.random.default_rng(0)
    rest = filter.model.rest_positions()
    hand = HandAbove(filter.model, "left_hand", height=0.0, reach=1.5)
    table = hand.height_at(rest) - 0.05
    hand = HandAbove(filter.model, "left_hand", table, reach=1.5)
    filter.constraints.append(hand)
    lowest, held = np.inf, 0
    for k in range(steps):
        if k % 50 == 0:
            desired = rest + rng.uniform(-1.0, 1.0, len(rest))
        command = filter(desired)
        lowest = min(lowest, hand.height_at(command.q))
        held += command.report.why == hand.name
    print(f"lowest {1e3 * (lowest - table):.1f} mm above; {held} of {steps} held back")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500)
