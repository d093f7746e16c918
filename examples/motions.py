"""A person's dance for a robot's joints: how far off is what was never simulated?"""

import numpy as np

from crar_drake import (
    ControlModel,
    load_robot_description,
    position_tasks,
    solve_start_pose,
)
from crar_drake.judging.referee import Referee
from crar_drake.robot.task import EXPERIMENTS
from crar_drake.targets.motion import load_motion_targets

robot = load_robot_description("upper_body")
model = ControlModel.FromDescription(robot, position_tasks(EXPERIMENTS["upper-body"]))
motion = load_motion_targets("dance", model)  # read, filtered, scaled to the robot
referee = Referee(model.plant, model.scene_graph, robot.pairs)

frames, errors, nearest = np.arange(0.0, motion.duration, 0.5), [], np.inf
for time in frames:
    targets = motion.tasks_at(time)
    waist = motion.prescribed_at(time)[: model.n_p]
    q = solve_start_pose(model, targets, waist)  # as near as constraints allow
    there = model.layout.unpack(model.tasks_at(q)).p
    errors.append(np.linalg.norm(there - model.layout.unpack(targets).p, axis=1).mean())
    nearest = min(nearest, referee.distances(q).min())
print(f"{len(frames)} frames, points off by {1e3 * np.mean(errors):.0f} mm on average")
print(f"judged: nearest {1e3 * nearest:.1f} mm")
