"""crar_drake's lookahead, driven like the peers."""

from __future__ import annotations

import numpy as np

from benchmarks.peers.driver import Controller, Problem, Targets, main
from benchmarks.peers.problem import describe
from crar_drake import (
    ControlLaw,
    ControlModel,
    LookaheadParameters,
    PaperGains,
    load_robot_description,
    position_tasks,
)


class Crar(Controller):
    """Settings: fields of `LookaheadParameters`; `nominal` holds those of
    `PaperGains`."""

    packages = ("crar-drake", "drake", "numpy", "scipy", "numba")
    commands = "acceleration"

    def __init__(self, problem: Problem, period: float, settings: dict) -> None:
        # No controller of the comparison knows of efforts.
        settings = {"effort_limits": False} | settings
        if "nominal" in settings:
            settings["nominal"] = PaperGains(**settings["nominal"])
        description = describe(problem.folder, load_robot_description(problem.robot))
        # What the law predicts is what the loop does.
        model = ControlModel.FromDescription(
            description, position_tasks(problem.links), time_step=period
        )
        assert list(model.joint_names) == problem.joints
        self.law = ControlLaw(model, LookaheadParameters(period=period, **settings))

    def reset(self, q: np.ndarray) -> None:
        self.law.reset()

    def solve(self, q: np.ndarray, v: np.ndarray, targets: Targets) -> np.ndarray:
        desired = (targets.p.ravel(), targets.v.ravel(), targets.a.ravel())
        return self.law.step(q, v, np.concatenate(desired)).acceleration


if __name__ == "__main__":
    main(Crar)
