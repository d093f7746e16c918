"""Which implementation of the control law the parameters ask for."""

from __future__ import annotations

from crar_drake.control_law import ControlLaw
from crar_drake.errors import ScenarioError
from crar_drake.parameters import CrarParameters
from crar_drake.robot import ControlModel


def make_control_law(
    model: ControlModel, parameters: CrarParameters | None = None
) -> ControlLaw:
    """The law as `parameters.arithmetic` says: `ControlLaw`, or its compiled equal.

    Args:
        model: the robot, its tasks and watched pairs.
        parameters: gains and modes; by default `CrarParameters()`.

    Raises:
        ScenarioError: a parameter is out of range, Numba is missing, or compiled
            arithmetic does not cover the model or a parameter.
    """
    parameters = parameters or CrarParameters()
    if parameters.arithmetic != "compiled":
        return ControlLaw(model, parameters)
    from crar_drake.compiled.compiler import HAS_NUMBA

    if not HAS_NUMBA:
        raise ScenarioError(
            "controller.arithmetic: compiled needs Numba, which is not installed: "
            "pip install 'crar-drake[compiled]', or use numpy"
        )
    from crar_drake.compiled.law import CompiledLaw

    return CompiledLaw(model, parameters)
