"""What measures the project: speed, faults, recovery, parameters, peers."""
