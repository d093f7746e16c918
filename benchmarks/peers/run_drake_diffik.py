"""Drake's DifferentialInverseKinematicsSystem with its collision constraint."""

from __future__ import annotations

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsSystem as DiffIk,
)
from pydrake.multibody.math import SpatialVelocity
from pydrake.planning import (
    DofMask,
    JointLimits,
    RobotDiagramBuilder,
    SceneGraphCollisionChecker,
)
from pydrake.systems.framework import BusValue

from benchmarks.peers.driver import Controller, NoAnswer, Problem, Targets, main

TRANSLATION = np.array([0, 0, 0, 1, 1, 1])


class DrakeDiffIk(Controller):
    """Settings: gain [1/s], cartesian_weight, posture_gain [1/s], collision_distance
    and influence_distance [m], limit_margin and limit_influence [rad]."""

    packages = ("drake", "numpy")

    def __init__(self, problem: Problem, period: float, settings: dict) -> None:
        self.gain = settings["gain"]
        builder = RobotDiagramBuilder(time_step=0.0)
        plant = builder.plant()
        (instance,) = builder.parser().AddModels(str(problem.folder / "robot.urdf"))
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(problem.base))
        model_name = plant.GetModelInstanceName(instance)
        plant.Finalize()
        checker = SceneGraphCollisionChecker(
            model=builder.Build(), robot_model_instances=[instance], edge_step_size=0.05
        )
        plant = checker.plant()
        index = {
            b: int(plant.GetBodyByName(b).index()) for p in problem.pairs for b in p
        }
        # 1 filters a pair, -1 marks what no robot body is part of.
        filters = checker.GetFilteredCollisionMatrix().copy()
        filters[filters == 0] = 1
        for a, b in problem.pairs:
            filters[index[a], index[b]] = filters[index[b], index[a]] = 0
        checker.SetCollisionFilterMatrix(filters)
        frames = [f"{model_name}::{link}" for link in problem.links]
        masks = {frame: TRANSLATION for frame in frames}
        recipe = DiffIk.Recipe()
        cost = DiffIk.LeastSquaresCost.Config()
        cost.cartesian_qp_weight = settings["cartesian_weight"]
        cost.cartesian_axis_masks = masks
        recipe.AddIngredient(DiffIk.LeastSquaresCost(cost))
        centering = DiffIk.JointCenteringCost.Config()
        centering.posture_gain = settings["posture_gain"]
        centering.cartesian_axis_masks = masks
        recipe.AddIngredient(DiffIk.JointCenteringCost(centering))
        collision = DiffIk.CollisionConstraint.Config()
        collision.safety_distance = settings["collision_distance"]
        collision.influence_distance = settings["influence_distance"]
        recipe.AddIngredient(DiffIk.CollisionConstraint(collision))
        limit = DiffIk.JointVelocityLimitConstraint.Config()
        limit.min_margin = settings["limit_margin"]
        limit.influence_margin = settings["limit_influence"]
        recipe.AddIngredient(
            DiffIk.JointVelocityLimitConstraint(limit, JointLimits(plant))
        )
        self.system = DiffIk(
            recipe=recipe,
            task_frame="world",
            collision_checker=checker,
            active_dof=DofMask(plant.num_positions(), True),
            time_step=period,
            K_VX=1.0,
            Vd_TG_limit=SpatialVelocity(np.full(3, 100.0), np.full(3, 100.0)),
        )
        self.context = self.system.CreateDefaultContext()
        self.system.get_input_port_nominal_posture().FixValue(
            self.context, problem.rest
        )
        self.plant, self.plant_context = plant, plant.CreateDefaultContext()
        self.bodies = [plant.GetBodyByName(link) for link in problem.links]
        self.frames = frames

    def solve(self, q: np.ndarray, v: np.ndarray, targets: Targets) -> np.ndarray:
        self.plant.SetPositions(self.plant_context, q)
        desired = BusValue()
        for i, body in enumerate(self.bodies):
            p = body.EvalPoseInWorld(self.plant_context).translation()
            wanted = targets.v_step[i] + self.gain * (targets.p[i] - p)
            desired.Set(self.frames[i], Value(SpatialVelocity(np.zeros(3), wanted)))
        system, context = self.system, self.context
        system.get_input_port_position().FixValue(context, q)
        system.get_input_port_desired_cartesian_velocities().FixValue(
            context, Value(desired)
        )
        try:
            return system.get_output_port_commanded_velocity().Eval(context)
        except RuntimeError as error:
            raise NoAnswer from error


if __name__ == "__main__":
    main(DrakeDiffIk)
