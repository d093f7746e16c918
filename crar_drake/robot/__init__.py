"""From a robot's description to the numbers of one of its states."""
