"""From a motion and a robot to the desired tasks, over time."""
