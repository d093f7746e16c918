"""mink among spheres that move: bodies of MuJoCo's that are placed by hand."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import mink
import mujoco
import numpy as np

from benchmarks.peers.driver import Guard, Problem, Spheres, main
from benchmarks.peers.run_mink import collision_limit, geoms_of, solved


class MinkGuard(Guard):
    """Settings: those of `collision_limit`; spheres, how many there are."""

    packages = ("mink", "mujoco", "daqp", "qpsolvers", "numpy")

    def __init__(self, problem: Problem, period: float, settings: dict) -> None:
        self.period, self.problem, self.settings = period, problem, settings
        self.configuration: mink.Configuration | None = None

    def set_up(self, spheres: Spheres) -> None:
        """Makes the model, with so many spheres."""
        problem, settings = self.problem, self.settings
        robot = ET.parse(problem.folder / "robot_mujoco.xml").getroot()
        names = [f"sphere_{i}" for i in range(len(spheres.radii))]
        for name, radius in zip(names, spheres.radii, strict=True):
            body = ET.SubElement(
                robot.find("worldbody"), "body", {"name": name, "mocap": "true"}
            )
            shape = {"name": name, "type": "sphere", "size": f"{radius}"}
            ET.SubElement(body, "geom", shape)
        model = mujoco.MjModel.from_xml_string(ET.tostring(robot, encoding="unicode"))
        assert [model.joint(i).name for i in range(model.nq)] == problem.joints
        self.configuration = mink.Configuration(model)
        self.posture = mink.PostureTask(model, cost=1.0)
        geoms = geoms_of(model)
        guarded = [geom for link in problem.guarded for geom in geoms[link]]
        limits = zip(problem.joints, problem.velocity_limits, strict=True)
        self.limits = [
            mink.ConfigurationLimit(model),
            collision_limit(model, problem, settings, [(guarded, names)]),
            mink.VelocityLimit(model, dict(limits)),
        ]

    def guard(self, q: np.ndarray, v: np.ndarray, spheres: Spheres) -> np.ndarray:
        if self.configuration is None:
            self.set_up(spheres)
        self.configuration.data.mocap_pos[:] = spheres.centres
        self.configuration.update(q)
        self.posture.set_target(q + self.period * v)
        return solved(self.configuration, [self.posture], self.period, self.limits)


if __name__ == "__main__":
    main(MinkGuard)
