"""Constrained Resolved Acceleration Control as Drake systems.

The names that another project needs; `README.md` shows how they go together.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from crar_drake.control.controller import CrarController
    from crar_drake.control.law import ControlLaw, Solution, make_control_law
    from crar_drake.control.parameters import CrarParameters, LookaheadParameters
    from crar_drake.diagram import AddCrarController, AddRobot, MakeCrarDiagram
    from crar_drake.equations.tasks import TaskLayout
    from crar_drake.errors import CrarError, ModelError, MotionError, ScenarioError
    from crar_drake.log import SimulationLog
    from crar_drake.robot import ControlModel
    from crar_drake.robot_description import RobotDescription, load_robot_description
    from crar_drake.scenario import Scenario, load_scenario
    from crar_drake.start_pose import solve_start_pose
    from crar_drake.task import EXPERIMENTS, Task, position_tasks

__version__ = "0.1.0"

# Public name to its module. They are imported when first asked for: Drake and SciPy
# take two seconds, which `crar-drake --help` and a mistyped option need not wait for.
_MODULES = {
    "AddCrarController": "diagram",
    "AddRobot": "diagram",
    "ControlLaw": "control.law",
    "ControlModel": "robot",
    "CrarController": "control.controller",
    "CrarError": "errors",
    "CrarParameters": "control.parameters",
    "EXPERIMENTS": "task",
    "LookaheadParameters": "control.parameters",
    "MakeCrarDiagram": "diagram",
    "ModelError": "errors",
    "MotionError": "errors",
    "RobotDescription": "robot_description",
    "Scenario": "scenario",
    "ScenarioError": "errors",
    "SimulationLog": "log",
    "Solution": "control.law",
    "Task": "task",
    "TaskLayout": "equations.tasks",
    "load_robot_description": "robot_description",
    "load_scenario": "scenario",
    "make_control_law": "control.law",
    "position_tasks": "task",
    "solve_start_pose": "start_pose",
}

__all__ = [
    "AddCrarController",
    "AddRobot",
    "ControlLaw",
    "ControlModel",
    "CrarController",
    "CrarError",
    "CrarParameters",
    "EXPERIMENTS",
    "LookaheadParameters",
    "MakeCrarDiagram",
    "ModelError",
    "MotionError",
    "RobotDescription",
    "Scenario",
    "ScenarioError",
    "SimulationLog",
    "Solution",
    "Task",
    "TaskLayout",
    "load_robot_description",
    "load_scenario",
    "make_control_law",
    "position_tasks",
    "solve_start_pose",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(f"{__name__}.{_MODULES[name]}")
    return getattr(module, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
