"""The errors that a user can mend: each message names the thing and the remedy.

The command line prints them without a traceback and exits with code 2.
"""


class CrarError(ValueError):
    """Something the user gave is wrong; the message says what and what to do."""


class MotionError(CrarError):
    """A motion-capture file, its name, or its contents."""


class ModelError(CrarError):
    """A robot model, its description, or a plant handed to the controller."""


class ScenarioError(CrarError):
    """A scenario file or an option that overrides it."""
