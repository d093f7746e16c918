"""crar_drake's lookahead: driven like the peers, and as torque on a simulated robot."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from benchmarks.peers.driver import Controller, Problem, Targets, main, run
from benchmarks.peers.problem import describe
from crar_drake import (
    ControlLaw,
    ControlModel,
    CrarParameters,
    LookaheadParameters,
    load_robot_description,
    position_tasks,
)
from crar_drake.equations.compilation import IS_COMPILED
from crar_drake.robot.description import add_robot

PLANT_STEP = 1e-3  # [s] of the simulated robot


class Crar(Controller):
    """Settings: fields of `CrarParameters`, with those of `LookaheadParameters`
    under "lookahead"; "torque" true simulates the robot's dynamics, "compiled" true
    says that Numba is there."""

    packages = ("crar-drake", "drake", "numpy", "scipy")
    commands = "acceleration"

    def __init__(self, problem: Problem, period: float, settings: dict) -> None:
        settings = dict(settings)
        self.torque = settings.pop("torque", False)
        if settings.pop("compiled", False):  # which `compare.drive` sees to
            if not IS_COMPILED:
                sys.exit("the settings ask for Numba, and it is not installed or off")
            self.packages = (*self.packages, "numba")
        lookahead = LookaheadParameters(**settings.pop("lookahead", {}))
        self.description = describe(
            problem.folder, load_robot_description(problem.robot)
        )
        # What the law predicts is what the loop does: its step, or the plant's.
        model = ControlModel.FromDescription(
            self.description,
            position_tasks(problem.links),
            time_step=PLANT_STEP if self.torque else period,
        )
        assert list(model.joint_names) == problem.joints
        # No controller of the comparison knows of efforts.
        settings = {"respect_effort_limits": False} | settings
        self.law = ControlLaw(
            model, CrarParameters(period=period, lookahead=lookahead, **settings)
        )

    def reset(self, q: np.ndarray) -> None:
        self.law.reset()

    def solve(self, q: np.ndarray, v: np.ndarray, targets: Targets) -> np.ndarray:
        desired = (targets.p.ravel(), targets.v.ravel(), targets.a.ravel())
        solution = self.law.step(q, v, np.concatenate(desired))
        return solution.actuation if self.torque else solution.acceleration

    def record(
        self, case: Path, period: float, seconds: float | None
    ) -> dict[str, np.ndarray]:
        if self.torque:
            self.after = self._on_a_plant(np.load(case)["q_start"])
        return run(self, case, period, seconds)

    def _on_a_plant(self, start: np.ndarray) -> Callable:
        """What `after` is for torques, held for a period: on a plant without contact
        and limits, so that nothing but the controller keeps it from a violation."""
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, PLANT_STEP)
        add_robot(plant, self.description)
        for index in plant.GetJointIndices():
            joint = plant.get_joint(index)
            free = np.full(joint.num_positions(), np.inf)
            joint.set_position_limits(-free, free)
        for index in plant.GetJointActuatorIndices():
            plant.get_mutable_joint_actuator(index).set_effort_limit(np.inf)
        plant.Finalize()
        scene_graph.collision_filter_manager().Apply(
            CollisionFilterDeclaration().ExcludeWithin(
                GeometrySet(scene_graph.model_inspector().GetAllGeometryIds())
            )
        )
        simulator = Simulator(builder.Build())
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        plant.SetPositions(context, start)
        actuation = plant.get_actuation_input_port()
        actuation.FixValue(context, np.zeros(plant.num_actuators()))
        simulator.Initialize()

        def after(q, v, torque, period: float) -> tuple[np.ndarray, np.ndarray]:
            actuation.FixValue(context, torque)
            simulator.AdvanceTo(simulator.get_context().get_time() + period)
            x = plant.GetPositionsAndVelocities(context)
            return x[: len(q)], x[len(q) :]

        return after


if __name__ == "__main__":
    main(Crar)
