"""Motions of a whole robot that others published: read, written, converted, judged."""
