"""The constraint modes: a class each. A new one is a file and a line in this table."""

from crar_drake.control.modes.lookahead import LookaheadMode
from crar_drake.control.modes.mode import Mode
from crar_drake.control.modes.paper import NoneMode, PaperMode

# The value of `controller.constraints` to its class.
MODES: dict[str, type[Mode]] = {
    "none": NoneMode,
    "paper": PaperMode,
    "lookahead": LookaheadMode,
}

__all__ = ["MODES", "Mode"]
