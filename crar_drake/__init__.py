"""Constrained Resolved Acceleration Control as Drake systems.

The names that another project needs; `README.md` shows how they go together.
"""

import importlib
from typing import TYPE_CHECKING, Any

from crar_drake.version import __version__ as __version__

if TYPE_CHECKING:  # as type checkers read that a name is public
    from crar_drake.errors import (
        CrarError as CrarError,
        CrarWarning as CrarWarning,
        InputError as InputError,
        ModelError as ModelError,
        MotionError as MotionError,
        ScenarioError as ScenarioError,
    )
    from crar_drake.law.control_law import ControlLaw as ControlLaw
    from crar_drake.law.controller import CrarController as CrarController
    from crar_drake.law.obstacles import Obstacles as Obstacles
    from crar_drake.law.parameters import (
        BalanceParameters as BalanceParameters,
        LookaheadParameters as LookaheadParameters,
        PaperGains as PaperGains,
        PaperParameters as PaperParameters,
        SafetyParameters as SafetyParameters,
    )
    from crar_drake.law.safety_filter import (
        FilterCommand as FilterCommand,
        FilterReport as FilterReport,
        SafetyFilter as SafetyFilter,
    )
    from crar_drake.law.safety_filter_system import (
        SafetyFilterSystem as SafetyFilterSystem,
    )
    from crar_drake.law.solution import Solution as Solution
    from crar_drake.law.standing_law import StandingLaw as StandingLaw
    from crar_drake.law.tasks import TaskLayout as TaskLayout
    from crar_drake.results.log import SimulationLog as SimulationLog
    from crar_drake.robot.description import (
        RobotDescription as RobotDescription,
        load_robot_description as load_robot_description,
    )
    from crar_drake.robot.model import ControlModel as ControlModel
    from crar_drake.robot.standing import standing_description as standing_description
    from crar_drake.robot.task import (
        EXPERIMENTS as EXPERIMENTS,
        Task as Task,
        joint_tasks as joint_tasks,
        position_tasks as position_tasks,
    )
    from crar_drake.simulation.builders import (
        AddCrarController as AddCrarController,
        AddRobot as AddRobot,
        AddStandingController as AddStandingController,
        MakeControlModel as MakeControlModel,
    )
    from crar_drake.simulation.contact_ground import (
        add_contact_ground as add_contact_ground,
    )
    from crar_drake.simulation.diagram import MakeCrarDiagram as MakeCrarDiagram
    from crar_drake.simulation.scenario import (
        Scenario as Scenario,
        load_scenario as load_scenario,
    )
    from crar_drake.targets.motion_source import MotionSource as MotionSource
    from crar_drake.targets.pose_targets import PoseTargets as PoseTargets
    from crar_drake.targets.start_pose import solve_start_pose as solve_start_pose

# Modules to the public names that are in them. They are imported when first asked for:
# Drake and SciPy take two seconds, which `crar-drake --help` and a mistyped option need
# not wait for.
_NAMES = {
    "errors": "CrarError CrarWarning InputError ModelError MotionError ScenarioError",
    "law.control_law": "ControlLaw",
    "law.controller": "CrarController",
    "law.obstacles": "Obstacles",
    "law.parameters": "BalanceParameters LookaheadParameters PaperGains "
    "PaperParameters SafetyParameters",
    "law.solution": "Solution",
    "law.safety_filter": "FilterCommand FilterReport SafetyFilter",
    "law.safety_filter_system": "SafetyFilterSystem",
    "law.standing_law": "StandingLaw",
    "law.tasks": "TaskLayout",
    "results.log": "SimulationLog",
    "robot.description": "RobotDescription load_robot_description",
    "robot.model": "ControlModel",
    "robot.standing": "standing_description",
    "robot.task": "EXPERIMENTS Task joint_tasks position_tasks",
    "simulation.builders": "AddCrarController AddRobot AddStandingController "
    "MakeControlModel",
    "simulation.contact_ground": "add_contact_ground",
    "simulation.diagram": "MakeCrarDiagram",
    "simulation.scenario": "Scenario load_scenario",
    "targets.motion_source": "MotionSource",
    "targets.pose_targets": "PoseTargets",
    "targets.start_pose": "solve_start_pose",
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = sorted(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(f"{__name__}.{_MODULES[name]}")
    return getattr(module, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
