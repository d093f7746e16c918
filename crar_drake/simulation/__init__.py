"""From a scenario to a diagram that Drake simulates and shows."""
