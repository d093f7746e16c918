"""The law alone: an arm's hand is sent through a post, and never touches it."""

import numpy as np

from crar_drake import (
    ControlLaw,
    ControlModel,
    LookaheadParameters,
    load_robot_description,
    position_tasks,
)

PERIOD = 0.005  # [s]
robot = load_robot_description("obstacle_arm")
model = ControlModel.FromDescription(robot, position_tasks(["tool"]))
law = ControlLaw(model, LookaheadParameters(period=PERIOD))

q, v = model.rest_positions(), np.zeros(model.plant.num_velocities())
targets = model.tasks_at(q)  # x, y, z, then velocities and accelerations
start = targets[:3].copy()
nearest = np.inf
for step in range(800):
    # To and fro in y, by half a metre, three times: through where the post stands.
    targets[1] = start[1] - 0.5 * np.sin(1.5 * np.pi * step * PERIOD)
    solution = law.step(q, v, targets)
    nearest = min(nearest, solution.signed_distances.min())
    assert solution.admission[3] == 1.0  # it could brake from here on a clear path
    q, v = np.split(solution.position_command, [len(q)])
print(f"nearest {1e3 * nearest:.1f} mm, the floor is 4 mm")
