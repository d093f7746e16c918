"""Constrained Resolved Acceleration Control as Drake systems.

The names that another project needs; `README.md` shows how they go together.
"""

from crar_drake.control_law import ControlLaw, Solution
from crar_drake.controller import CrarController
from crar_drake.diagram import AddCrarController, MakeCrarDiagram
from crar_drake.errors import CrarError, ModelError, MotionError, ScenarioError
from crar_drake.log import SimulationLog
from crar_drake.parameters import CrarParameters, LookaheadParameters
from crar_drake.robot import ControlModel
from crar_drake.robot_description import RobotDescription, load_robot_description
from crar_drake.scenario import Scenario, load_scenario
from crar_drake.task import EXPERIMENTS, Task, position_tasks

__version__ = "0.1.0"

__all__ = [
    "AddCrarController",
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
    "load_robot_description",
    "load_scenario",
    "position_tasks",
]
