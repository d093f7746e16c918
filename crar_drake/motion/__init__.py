"""From a motion-capture file to a trajectory that fits a robot."""
