"""The constraint modes: a class each. A new one is a file and a line in this table, and
its name in `control.parameters`."""

from crar_drake.control.modes.lookahead import LookaheadMode
from crar_drake.control.modes.mode import Mode
from crar_drake.control.modes.paper import NoneMode, PaperMode
from crar_drake.control.parameters import CrarParameters

# The value of `controller.constraints` to its class.
MODES: dict[str, type[Mode]] = {
    "none": NoneMode,
    "paper": PaperMode,
    "lookahead": LookaheadMode,
}


def validate(parameters: CrarParameters) -> None:
    """Checks parameters one by one, and that they go with their constraint mode.

    Raises:
        ScenarioError: names the field, its value and what it may be.
    """
    parameters.validate()
    MODES[parameters.constraints].check(parameters)


__all__ = ["MODES", "Mode", "validate"]
