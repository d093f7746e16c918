"""crar_drake's safety filter among spheres that move."""

from __future__ import annotations

import numpy as np

from benchmarks.peers.driver import Guard, Problem, Spheres, main
from benchmarks.peers.problem import describe
from crar_drake import SafetyParameters, load_robot_description
from crar_drake.law.obstacles import Obstacles
from crar_drake.law.safety_filter import SafetyFilter


class CrarGuard(Guard):
    """Settings: fields of `SafetyParameters`."""

    packages = ("crar-drake", "drake", "numpy", "numba")

    def __init__(self, problem: Problem, period: float, settings: dict) -> None:
        self.filter = SafetyFilter(
            describe(problem.folder, load_robot_description(problem.robot)),
            period,
            SafetyParameters(**settings),
        )
        assert list(self.filter.joint_names) == problem.joints
        self.filter.compile(obstacles=True)

    def reset(self, q: np.ndarray) -> None:
        self.filter.reset(q)

    def guard(self, q: np.ndarray, v: np.ndarray, spheres: Spheres) -> np.ndarray:
        names = tuple(f"sphere {i}" for i in range(len(spheres.radii)))
        around = Obstacles(spheres.centres, spheres.radii, spheres.speeds, names)
        return self.filter(v=v, obstacles=around).v


if __name__ == "__main__":
    main(CrarGuard)
