"""crar_drake's law of a robot that stands, with balance and without."""

from __future__ import annotations

import numpy as np

from benchmarks.peers.driver import Targets, main
from benchmarks.peers.floating import Floating
from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import (
    BalanceParameters,
    CrarParameters,
    LookaheadParameters,
)
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.standing import standing_description
from crar_drake.robot.task import position_tasks

TRACKED = ["left_wrist", "right_wrist"]


class Crar(Floating):
    """Settings: balance, whether it is kept; horizon [s], Kp [1/s^2] and damping [m]
    of the law. Root and legs stay."""

    packages = ("drake", "numpy", "scipy")

    def set_up(self, settings: dict) -> None:
        whole = load_robot_description(self.problem.robot)
        self.model = model = ControlModel.FromDescription(
            standing_description(whole), position_tasks(TRACKED), time_step=0.0
        )
        balance = None
        if settings["balance"]:
            margin = self.standing["margin"] + settings["inside"]
            balance = BalanceParameters(margin, self.standing["friction"])
        self.law = ControlLaw(
            model,
            CrarParameters(
                period=self.period,
                balance=balance,
                Kp=settings["Kp"],
                damping=settings["damping"],
                lookahead=LookaheadParameters(horizon=settings["horizon"]),
            ),
        )
        self.law.compile()
        self.at = [self.problem.joints.index(name) for name in model.position_names]

    def reset(self, q: np.ndarray) -> None:
        self.law.reset()
        self.prescribed = self.model.prescribed_at(self.model.rest_positions())

    def solve(self, q: np.ndarray, v: np.ndarray, targets: Targets) -> np.ndarray:
        desired = (targets.p.ravel(), targets.v.ravel(), targets.a.ravel())
        solution = self.law.step(
            q[7:][self.at], v[6:][self.at], np.concatenate(desired), self.prescribed
        )
        a = np.zeros_like(v)
        a[6:][self.at] = solution.acceleration
        return a


if __name__ == "__main__":
    main(Crar)
