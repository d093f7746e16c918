"""The control step with its arithmetic compiled: a prototype, for measuring only."""
