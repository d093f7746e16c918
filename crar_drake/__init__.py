"""Constrained Resolved Acceleration Control as Drake systems.

The names that another project needs; `README.md` shows how they go together.
"""

import importlib
from typing import TYPE_CHECKING, Any

from crar_drake.version import __version__ as __version__

if TYPE_CHECKING:
    from crar_drake.errors import (
        CrarError,
        CrarWarning,
        InputError,
        ModelError,
        MotionError,
        ScenarioError,
    )
    from crar_drake.law.control_law import ControlLaw
    from crar_drake.law.controller import CrarController
    from crar_drake.law.obstacles import Obstacles
    from crar_drake.law.parameters import (
        BalanceParameters,
        LookaheadParameters,
        PaperGains,
        PaperParameters,
        SafetyParameters,
    )
    from crar_drake.law.records import Solution
    from crar_drake.law.safety_filter import (
        FilterCommand,
        FilterReport,
        SafetyFilter,
    )
    from crar_drake.law.safety_filter_system import SafetyFilterSystem
    from crar_drake.law.standing_law import StandingLaw
    from crar_drake.law.tasks import TaskLayout
    from crar_drake.results.log import SimulationLog
    from crar_drake.robot.description import RobotDescription, load_robot_description
    from crar_drake.robot.model import ControlModel
    from crar_drake.robot.standing import standing_description
    from crar_drake.robot.task import EXPERIMENTS, Task, joint_tasks, position_tasks
    from crar_drake.simulation.builders import (
        AddCrarController,
        AddRobot,
        AddStandingController,
        MakeControlModel,
    )
    from crar_drake.simulation.contact_ground import add_contact_ground
    from crar_drake.simulation.diagram import MakeCrarDiagram
    from crar_drake.simulation.scenario import Scenario, load_scenario
    from crar_drake.targets.motion_source import MotionSource
    from crar_drake.targets.pose_targets import PoseTargets
    from crar_drake.targets.start_pose import solve_start_pose

# Public name to its module. They are imported when first asked for: Drake and SciPy
# take two seconds, which `crar-drake --help` and a mistyped option need not wait for.
_MODULES = {
    "AddCrarController": "simulation.builders",
    "AddRobot": "simulation.builders",
    "AddStandingController": "simulation.builders",
    "BalanceParameters": "law.parameters",
    "ControlLaw": "law.control_law",
    "ControlModel": "robot.model",
    "CrarController": "law.controller",
    "CrarError": "errors",
    "CrarWarning": "errors",
    "EXPERIMENTS": "robot.task",
    "FilterCommand": "law.safety_filter",
    "FilterReport": "law.safety_filter",
    "InputError": "errors",
    "LookaheadParameters": "law.parameters",
    "MakeControlModel": "simulation.builders",
    "MakeCrarDiagram": "simulation.diagram",
    "ModelError": "errors",
    "MotionError": "errors",
    "MotionSource": "targets.motion_source",
    "PaperGains": "law.parameters",
    "PaperParameters": "law.parameters",
    "PoseTargets": "targets.pose_targets",
    "Obstacles": "law.obstacles",
    "RobotDescription": "robot.description",
    "SafetyParameters": "law.parameters",
    "SafetyFilter": "law.safety_filter",
    "SafetyFilterSystem": "law.safety_filter_system",
    "Scenario": "simulation.scenario",
    "ScenarioError": "errors",
    "SimulationLog": "results.log",
    "Solution": "law.records",
    "StandingLaw": "law.standing_law",
    "Task": "robot.task",
    "TaskLayout": "law.tasks",
    "add_contact_ground": "simulation.contact_ground",
    "joint_tasks": "robot.task",
    "load_robot_description": "robot.description",
    "load_scenario": "simulation.scenario",
    "position_tasks": "robot.task",
    "solve_start_pose": "targets.start_pose",
    "standing_description": "robot.standing",
}

__all__ = [
    "AddCrarController",
    "AddRobot",
    "AddStandingController",
    "BalanceParameters",
    "ControlLaw",
    "ControlModel",
    "CrarController",
    "CrarError",
    "CrarWarning",
    "EXPERIMENTS",
    "FilterCommand",
    "FilterReport",
    "InputError",
    "LookaheadParameters",
    "MakeControlModel",
    "MakeCrarDiagram",
    "ModelError",
    "MotionError",
    "MotionSource",
    "Obstacles",
    "PaperGains",
    "PaperParameters",
    "PoseTargets",
    "RobotDescription",
    "SafetyFilter",
    "SafetyFilterSystem",
    "SafetyParameters",
    "Scenario",
    "ScenarioError",
    "SimulationLog",
    "Solution",
    "StandingLaw",
    "Task",
    "TaskLayout",
    "add_contact_ground",
    "joint_tasks",
    "load_robot_description",
    "load_scenario",
    "position_tasks",
    "solve_start_pose",
    "standing_description",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(f"{__name__}.{_MODULES[name]}")
    return getattr(module, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
