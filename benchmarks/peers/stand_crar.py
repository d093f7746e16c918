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
from crar_drake.robot.moving_pelvis import SLIDES, WholeCommand
from crar_drake.robot.standing import standing_description
from crar_drake.robot.task import position_tasks
from crar_drake.simulation.scenario import Pelvis

_STAY = 20.0  # rate at which legs come back to where they follow the root [1/s]
TRACKED = ["left_wrist", "right_wrist"]


class Crar(Floating):
    """Settings: balance, whether it is kept; horizon [s], Kp [1/s^2] and damping [m]
    of the law; pelvis, whether it sways and squats. Else root and legs stay."""

    packages = ("drake", "numpy", "scipy")

    def set_up(self, settings: dict) -> None:
        whole = load_robot_description(self.problem.robot)
        box = Pelvis().box() if settings.get("pelvis") else None
        description = standing_description(whole, box)
        self.model = model = ControlModel.FromDescription(
            description, position_tasks(TRACKED), time_step=0.0
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
        # Velocities are the root's turn, its slide, and the joints'; positions have one
        # more before.
        at = {name: 3 + i for i, name in enumerate(SLIDES)}
        at |= {name: 6 + i for i, name in enumerate(self.problem.joints)}
        self.at = np.array([at[name] for name in model.position_names])
        begin = np.concatenate((self.standing["root"], np.zeros(len(at) - 3)))
        self.begin = begin[self.at + 1]
        self.command = WholeCommand(description.pelvis, model.position_names)

    def reset(self, q: np.ndarray) -> None:
        self.law.reset()
        self.prescribed = self.model.prescribed_at(self.model.rest_positions())

    def solve(self, q: np.ndarray, v: np.ndarray, targets: Targets) -> np.ndarray:
        desired = (targets.p.ravel(), targets.v.ravel(), targets.a.ravel())
        here, speed = q[self.at + 1] - self.begin, v[self.at]
        solution = self.law.step(here, speed, np.concatenate(desired), self.prescribed)
        # Legs are drawn to where they follow the root; all else is as asked.
        joints, _ = self.command(here, speed, solution.acceleration)
        drawn = _STAY**2 * (joints[0] - here) + 2.0 * _STAY * (joints[1] - speed)
        a = np.zeros_like(v)
        a[self.at] = joints[2] + drawn
        return a


if __name__ == "__main__":
    main(Crar)
