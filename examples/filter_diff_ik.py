"""Drake's differential inverse kinematics, told of no post, before a filter."""

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody import inverse_kinematics
from pydrake.multibody.math import SpatialVelocity
from pydrake.planning import DofMask, RobotDiagramBuilder, SceneGraphCollisionChecker
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BusValue, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from crar_drake import (
    AddRobot,
    SafetyFilter,
    SafetyFilterSystem,
    load_robot_description,
)
from crar_drake.judging.referee import Referee

DiffIK, PERIOD = inverse_kinematics.DifferentialInverseKinematicsSystem, 0.01  # [s]
robot = RobotDiagramBuilder(time_step=0.0)
arms = [AddRobot(robot.plant(), "obstacle_arm")]
robot.plant().Finalize()
model = robot.Build()
plant, at_rest = model.plant(), model.plant().CreateDefaultContext()
X_WT = plant.GetFrameByName("tool").CalcPoseInWorld(at_rest)


class Target(LeafSystem):
    """The tool's pose, to and fro in y by half a metre: through the post."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareAbstractOutputPort("poses", lambda: Value(BusValue()), self._calc)

    def _calc(self, context, output) -> None:
        y, poses = -0.5 * np.sin(1.5 * np.pi * context.get_time()), BusValue()
        poses.Set("arm::tool", Value(RigidTransform([0.0, y, 0.0]) @ X_WT))
        output.set_value(poses)


checker = SceneGraphCollisionChecker(
    model=model, robot_model_instances=arms, edge_step_size=0.05
)
recipe, joints = DiffIK.Recipe(), DofMask(plant.num_positions(), True)
recipe.AddIngredient(DiffIK.LeastSquaresCost(DiffIK.LeastSquaresCost.Config()))
fastest = SpatialVelocity(np.full(3, 3.0), np.ones(3))
builder = DiagramBuilder()
safe = SafetyFilterSystem(SafetyFilter("obstacle_arm", PERIOD))
ik = DiffIK(recipe, "world", checker, joints, PERIOD, 0.2, fastest)
for system in (target := Target(), safe, ik):
    builder.AddSystem(system)
builder.Connect(target.get_output_port(), ik.get_input_port_desired_cartesian_poses())
builder.Connect(safe.get_output_port_position_command(), ik.get_input_port_position())
builder.Connect(ik.get_output_port(), safe.get_input_port_desired_velocity())
log = LogVectorOutput(safe.get_output_port_position_command(), builder, PERIOD)
simulator = Simulator(builder.Build())
context = ik.GetMyMutableContextFromRoot(simulator.get_mutable_context())
ik.get_input_port_nominal_posture().FixValue(context, plant.GetPositions(at_rest))
simulator.AdvanceTo(2.0)
q = log.FindLog(simulator.get_context()).data().T
pairs = load_robot_description("obstacle_arm").pairs
found = Referee(plant, model.scene_graph(), pairs).violations(q)
print(f"nearest {1e3 * found.smallest_distance:.1f} mm, {found.num_violated} violated")
