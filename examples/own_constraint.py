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

    def _at(self, q: np.ndarray) -> float:
        self._plant.SetPositions(self._context, q)
        return self._link.CalcPoseInWorld(self._context).translation()[2]

    def _gradient(self, q: np.ndarray) -> np.ndarray:
        world, self._at_q = self._plant.world_frame(), self._at(q)
        return self._plant.CalcJacobianTranslationalVelocity(
            *(self._context, JacobianWrtVariable.kV, self._link, np.zeros(3)),
            *(world, world),
        )[2]

    def begin(self, state: State) -> None:
        rest = state.q + state.T * state.v
        self._kept = min(self._height, self._at(state.q), self._at(rest))
        state.recovering |= self._kept < self._height

    def rows(self, state: State) -> Rows:
        g = self._gradient(state.q + state.T * state.v)
        least = min((self._height + 0.01 - self._at_q) / state.T, 0.2)
        return hard_rows(g[None], np.array([least]))

    def examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        x = state.segment(s)  # to where it would come to rest
        curvature = self._reach * np.abs(x).sum() ** 2
        way = lambda w: self._at(state.q + w * x)  # noqa: E731
        left = lowest_on_segment(way, curvature, self._kept) - self._kept
        if left >= 0.0 or not correct:
            return SafetyCheck(left >= 0.0, left)
        g = self._gradient(state.q + x)
        more = (1e-3 - left) * state.T / (state.period * (state.period + state.T))
        return SafetyCheck(False, left, hard_rows(g[None], np.array([g @ s + more])))


def main(steps: int = 500) -> None:
    filter, rng = SafetyFilter("upper_body", period=0.01), np.random.default_rng(0)
    hand = HandAbove(filter.model, "left_hand", 0.9, reach=1.5)
    filter.constraints.append(hand)
    lowest, held = np.inf, 0
    for k in range(steps):
        if k % 50 == 0:
            desired = rng.uniform(filter.model.lower, filter.model.upper)
        command = filter(desired)
        lowest = min(lowest, hand._at(command.q))
        held += command.report.why == hand.name
    print(f"lowest {lowest:.4f} m; the table held back {held} of {steps} commands")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500)
