"""From desired tasks and a state to the torque."""
