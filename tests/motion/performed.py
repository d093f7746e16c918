"""The performer of a file that a test has made."""

import os

from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import Performer


def performed(path: str | os.PathLike[str], **options) -> Performer:
    """As `load_performer`, with the options by name."""
    return load_performer(str(path), MotionOptions(**options))
