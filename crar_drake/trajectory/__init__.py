"""Whole motions by one optimisation: all frames at once, under all constraints."""
