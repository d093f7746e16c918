"""Targets come over a network, safe commands go back: `crar-drake serve`."""
