"""A scenario's robot, moved live from a browser: `crar-drake play`."""
