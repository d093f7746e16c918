"""Reads and writes the files of recorded human motion."""
