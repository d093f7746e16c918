"""The names of the product: every one that the acceptance suite uses stands here.

The suite judges what users see and outlives the inside of the package. Its tests speak
of concepts; this file says what the package calls them today. Renaming something
changes this file, and no test.
"""

import contextlib
import io
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# --- commands -----------------------------------------------------------------------

PROGRAM = "crar-drake"
MODULE = "crar_drake"


@dataclass(frozen=True)
class Finished:
    """A command that has ended: its exit code and what it printed."""

    code: int
    out: str
    err: str


def run_command(*argv: object) -> Finished:
    """Runs the command line in this process; the exit code is as of the shell."""
    from crar_drake.commands import main

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main([str(word) for word in argv])
        except SystemExit as stopped:  # argparse
            code = stopped.code if isinstance(stopped.code, int) else 1
    return Finished(code or 0, out.getvalue(), err.getvalue())


def run_program(*argv: object, cwd: Path | None = None, **environment: str) -> Finished:
    """Runs the command line in a process of its own, as a shell does."""
    done = subprocess.run(
        [sys.executable, "-m", MODULE, *map(str, argv)],
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )
    return Finished(done.returncode, done.stdout, done.stderr)


def command(name: str, *what: object, **named: Any) -> Finished:
    """Runs a command in this process, by the neutral names of it and its options."""
    return run_command(*words(name, *what, **named))


def words(name: str, *what: object, **named: Any) -> list[str]:
    """The words of a command line, by neutral names."""
    return [COMMANDS[name], *map(str, what), *options(name, **named)]


def options(_command: str = "", /, **named: Any) -> list[str]:
    """The options of a command line, by neutral names; None and False are left out,
    and a list is an option for each."""
    words = []
    for name, value in named.items():
        for each in value if isinstance(value, list) else [value]:
            if each is None or each is False:
                continue
            words.append(option(name, _command))
            if each is not True:
                words.append(str(each))
    return words


def option(name: str, command: str = "") -> str:
    """An option by its neutral name, as it is typed."""
    general = OPTIONS.get(name, "--" + name.replace("_", "-"))
    return OPTIONS.get(f"{command} {name}", general)


# What is done to the command that does it.
COMMANDS = {
    "simulate": "run",
    "play": "play",
    "serve": "serve",
    "judge": "judge",
    "retarget": "retarget",
    "clean": "clean",
    "convert": "convert",
    "import": "import-robot",
    "catalogue": "list",
    "motion": "motion",  # what is in a person's or a robot's motion
    "page": "playback",  # of a log
    "compare": "compare",
}

# Neutral name to the option, where it is not --name; with the command before it, where
# the same thing is called differently.
OPTIONS: dict[str, str] = {
    "tasks": "--experiment",
    "simulate no_page": "--no-recording",
    "play out": "--save",
}

# Exit codes.
FINE, VIOLATED, REFUSED, INTERRUPTED = 0, 1, 2, 130

# Environment variables: the folder of CMU's motions, and that of users' caches.
MOCAP, CACHE = "CRAR_MOCAP_PATH", "XDG_CACHE_HOME"

# --- robots, models, scenarios, diagrams (section of SEEN) ----------------------------

ROOT = Path(__file__).resolve().parents[2]

# Robots that are shipped, and one that is imported by its name.
BUILT_IN, ARM, HUMANOID = "upper_body", "obstacle_arm", "g1_whole_body"
ROBOT_PACKAGE = "example-robot-data"  # has the humanoid's file
# Of the built-in robot.
JOINT, LINK, POINT = "left_elbow", "left_hand", "left_wrist"

# Scenarios that are shipped: the built-in robot with its hands, and an arm by a post.
HANDS, BY_A_POST, STANDING = "dance_wrists", "obstacle_arm", "g1_standing"
MOTION, OTHER_MOTION = "dance", "boxing"
TASKS = "wrists"
PAPER, FREE, PROVED = "paper", "none", "lookahead"  # constraints

ROBOT_FILE, IMPORT_FILE = "robot.yaml", "import.yaml"
MOTIONS_POINT = "left_elbow"  # as a table of a person's joints calls it
LAYOUT = "mjlab-npz"  # of a robot's motion
ROBOT_MOTION = ROOT / "examples" / "g1_boxing.csv"  # of the humanoid
CERTIFICATE = "{}.certificate.json"  # of a motion
# Sections of a robot's file, each with an entry and a name of the model in it.
ROBOT_SECTIONS = {
    "pairs": ("[left_hand, torso]", "torso"),
    "task_frames": ("left_elbow: left_forearm", "left_forearm"),
    "rest_posture": ("left_elbow:", "left_elbow"),
}


def robot_folder(robot: str) -> Path:
    """The files of a shipped robot."""
    return ROOT / "models" / robot


# A scenario's keys, by neutral names; a dot goes one level down.
SCENARIO_KEYS = {
    "robot": "robot",
    "motion": "motion",
    "tasks": "experiment",
    "duration": "duration",
    "about": "description",
    "constraints": "controller.constraints",
    "period": "controller.period",
    "braking_time": "controller.lookahead.horizon",
    "speed_share": "controller.velocity_scale",
}


def scenario(**values: object) -> str:
    """A scenario's text: a line for each value, in their order."""
    lines = []
    for name, value in values.items():
        *ways, last = SCENARIO_KEYS[name].split(".")
        start = "".join(f"{way}: {{" for way in ways)
        lines.append(f"{start}{last}: {value}{'}' * len(ways)}")
    return "\n".join(lines) + "\n"


def leaf(name: str) -> str:
    """The last key of a scenario's value."""
    return SCENARIO_KEYS[name].rpartition(".")[2]


def mistake() -> type[Exception]:
    """What is raised where a user's input is wrong."""
    from crar_drake import CrarError

    return CrarError


@dataclass
class Wired:
    """A controller beside a plant of the built-in robot, nothing else connected."""

    builder: Any  # pydrake's DiagramBuilder
    plant: Any
    scene_graph: Any
    robot: Any  # its description
    controller: Any = None

    @property
    def posture(self) -> Any:
        """The rest posture; (nq,)."""
        return self.controller.model.rest_positions()

    def ports(self) -> dict[str, tuple[Any, Any]]:
        """Name to the input port, and what to give it so that the robot stays."""
        model, q = self.controller.model, self.posture
        return {
            "desired_tasks": (
                self.controller.get_input_port_desired_tasks(),
                model.tasks_at(q),
            ),
            "desired_prescribed": (
                self.controller.get_input_port_desired_prescribed(),
                model.prescribed_at(q),
            ),
        }


# The port of the targets, among those above.
TARGETS = "desired_tasks"


def plant_of_the_robot(*, finalized: bool = True) -> Wired:
    """The built-in robot in a plant of 1 ms."""
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
    from pydrake.systems.framework import DiagramBuilder

    from crar_drake import AddRobot

    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    wired = Wired(builder, plant, scene_graph, AddRobot(plant, BUILT_IN))
    if finalized:
        plant.Finalize()
    return wired


def wire(wired: Wired, *points: str, **parameters: object) -> Wired:
    """Adds a controller whose tasks are positions of points."""
    from crar_drake import AddCrarController, CrarParameters, position_tasks

    wired.controller = AddCrarController(
        wired.builder,
        wired.plant,
        wired.scene_graph,
        wired.robot,
        position_tasks(list(points or [POINT])),
        CrarParameters(**parameters),
    )
    return wired


def add_the_robot_too_late() -> None:
    """Adds a robot to a plant that is finalized."""
    from crar_drake import AddRobot

    AddRobot(plant_of_the_robot().plant, BUILT_IN)


def simulate(wired: Wired, given: dict[str, tuple[Any, Any]], duration: float) -> Any:
    """Gives ports constant values, and simulates; the root context at the end."""
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.primitives import ConstantVectorSource

    for port, value in given.values():
        source = wired.builder.AddSystem(ConstantVectorSource(value))
        wired.builder.Connect(source.get_output_port(), port)
    simulator = Simulator(wired.builder.Build())
    simulator.AdvanceTo(duration)
    return simulator.get_context()


def guard(robot: str, period: float = 0.01) -> Any:
    """The filter of joint commands; to be called with positions."""
    from crar_drake import SafetyFilter

    return SafetyFilter(robot, period=period)


def load_robot(name: str) -> Any:
    """A robot's description."""
    from crar_drake import load_robot_description

    return load_robot_description(name)


# --- law and filter (section of LAW) --------------------------------------------------

# --- tracking (section of TRACKING) ---------------------------------------------------

# --- whole motions, imports, certificates (section of MOTIONS) ------------------------
