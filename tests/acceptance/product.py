"""The names of the product: every one that the acceptance suite uses stands here.

The suite judges what users see and outlives the inside of the package. Its tests speak
of concepts; this file says what the package calls them today. Renaming something
changes this file, and no test.
"""

import contextlib
import dataclasses
import importlib
import io
import json
import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import crar_drake  # which imports what is asked of it
import crar_drake.commands

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
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = crar_drake.commands.main([str(word) for word in argv])
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
    "catalogue": "show",
    "motion": "show",  # what is in a person's or a robot's motion
    "page": "show",  # of a log
    "compare": "show",
}

# Neutral name to the option, where it is not --name; with the command before it, where
# the same thing is called differently.
OPTIONS: dict[str, str] = {}

# Exit codes.
FINE, VIOLATED, REFUSED = 0, 1, 2

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
MEASURED_WITHIN = 1.001e-4  # by so much measured distances may be too large [m]
PAPER, FREE, PROVED = "paper", "none", "lookahead"  # constraints

ROBOT_FILE, IMPORT_FILE, URDF_FILE = "robot.yaml", "import.yaml", "robot.urdf"
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
    "braking_time": "controller.braking_time",
    "speed_share": "controller.velocity_scale",
}


def scenario(**values: object) -> str:
    """A scenario's text: a line for each value, in their order; those with a section in
    common share its line."""
    lines: dict[str, str] = {}
    for name, value in values.items():
        top, *ways = SCENARIO_KEYS[name].split(".")
        entry = "".join(f"{way}: {{" for way in ways[:-1])
        entry += f"{ways[-1]}: {value}{'}' * (len(ways) - 1)}" if ways else f"{value}"
        lines[top] = f"{lines[top]}, {entry}" if top in lines else entry
    keys = [SCENARIO_KEYS[name] for name in values]
    nested = {key.partition(".")[0] for key in keys if "." in key}
    return "".join(
        f"{top}: {{{text}}}\n" if top in nested else f"{top}: {text}\n"
        for top, text in lines.items()
    )


def leaf(name: str) -> str:
    """The last key of a scenario's value."""
    return SCENARIO_KEYS[name].rpartition(".")[2]


def mistake() -> type[Exception]:
    """What is raised where a user's input is wrong."""
    return crar_drake.CrarError


@dataclass
class Wired:
    """A controller beside a plant of the built-in robot, nothing else connected."""

    builder: Any  # pydrake's DiagramBuilder
    plant: Any
    scene_graph: Any
    robot: Any  # its model instance
    name: str = BUILT_IN  # of the robot
    watched: list[Any] | None = None  # pairs of links; None for the description's
    controller: Any = None

    @property
    def posture(self) -> Any:
        """The rest posture; (nq,)."""
        return self.controller.model.rest_positions()

    def ports(self) -> dict[str, tuple[Any, Any]]:
        """Name to the input port, and what to give it so that the robot stays."""
        model, q = self.controller.model, self.posture
        given = {"desired_tasks": model.tasks_at(q)}
        if model.n_p:
            given["desired_prescribed"] = model.prescribed_at(q)
        port = self.controller.GetInputPort
        return {name: (port(name), value) for name, value in given.items()}


# The port of the targets, among those above.
TARGETS = "desired_tasks"


def add_the_robot_too_late() -> None:
    """Adds a robot to a plant that is finalized."""
    crar_drake.AddRobot(put_in_plant(finalized=True).plant, BUILT_IN)


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


def load_robot(name: str) -> Any:
    """A robot's description."""
    return crar_drake.load_robot_description(name)


def point_links(robot: str) -> dict[str, str]:
    """The point of a robot to the link or frame that it is the origin of."""
    return dict(load_robot(robot).task_frames)


# What a run leaves in its folder, by what it is.
RUN_FILES = {
    "log": "log.npz",
    "figures": "summary.json",
    "plot": "plot.png",
    "page": "recording.html",
}
PAGE_OF_A_LOG = "playback.html"  # which is made later, beside it
PAGE_OF_SEVERAL = "out/compare.html"

# What the page of a run is made of, as a browser finds it.
PAGE_PARTS = {
    "title": "#crar-caption h1",
    "figures": "#crar-caption ul",
    "legend": "#crar-legend ul",
    "scene": "#crar-stage canvas",
    "play": "#crar-play",
    "time": "#crar-time",
    "speed": "#crar-speed",
    "keys": "#crar-keys",
    "time line": "#crar-timeline svg",
}
# What its script says and does, as JavaScript.
PAGE_IS_READY = "window.crar && crar.state"
PAGE_PLAYS, PAGE_TIME = "crar.state.playing", "crar.state.time"
PAGE_SEEK, PAGE_STOP = "crar.seek({})", "crar.play(false)"


@dataclass(frozen=True)
class Log:
    """A run's log: T samples."""

    time: Any  # (T,) [s]
    q: Any  # (T, n) positions
    v: Any  # (T, n) velocities
    commanded: Any  # (T, n) accelerations
    efforts: Any  # (T, m) of the motors [Nm or N]
    targets: dict[str, Any]  # point that has a place -> (T, 3) where it should be [m]
    errors: dict[str, Any]  # and by how much it is not there
    turns: dict[str, Any]  # point -> (T, 3) error of its orientation, if any [rad]
    distances: Any  # (T, P) of watched pairs [m]
    joints: list[str]  # of the columns of q
    motors: list[str]  # of the columns of efforts
    controlled: list[str]  # joints that the law moves
    pairs: list[str]  # (P,) "link - link"
    lower: Any  # (n,) limits
    upper: Any
    speeds: Any
    scenario: str  # its text


def read_log(path: Path) -> Log:
    """Reads a log as the NumPy archive that the guide says it is."""
    with np.load(path) as archive:
        log = {name: archive[name] for name in archive.files}
    targets, errors, turns, row, entry = {}, {}, {}, 0, 0
    for point, kind in zip(log["task_names"], log["task_kinds"], strict=True):
        if kind in ("orientation", "pose"):
            turns[str(point)] = log["task_error"][:, row : row + 3]
            row, entry = row + 3, entry + 4  # targets are quaternions
        if kind in ("position", "pose"):
            targets[str(point)] = log["desired_tasks"][:, entry : entry + 3]
            errors[str(point)] = log["task_error"][:, row : row + 3]
            row, entry = row + 3, entry + 3
    assert row == log["task_error"].shape[1]
    names = ("position_names", "actuator_names", "controlled_names", "pair_names")
    return Log(
        *(log[name] for name in ("time", "q", "v", "desired_acceleration")),
        log["actuation"],
        *(targets, errors, turns),
        log["signed_distances"],
        *(log[name].tolist() for name in names),
        *(log["lower"], log["upper"], log["velocity_limits"]),
        str(log["scenario"]),
    )


# A run's figures, by neutral names.
FIGURES = {
    "duration": "duration",
    "samples": "samples",
    "error": "rms_task_error",  # of places, root mean square [m]
    "turn": "rms_orientation_error",
    "distance": "smallest_distance",
    "pair": "smallest_distance_pair",
    "when": "smallest_distance_time",
    "violated": "violated_samples",  # samples, and so below
    "penetrating": "penetrating_samples",
    "beyond a limit": "beyond_limit_samples",
    "too fast": "beyond_speed_samples",
    "effort": "peak_torque",
    "strained": "peak_torque_joint",
    "acceleration": "rms_acceleration",  # commanded, root mean square [rad/s^2]
    "warnings": "warnings",
    "stopped": "stopped",
}


def read_figures(path: Path) -> dict[str, Any]:
    """A run's figures; "errors" has those of each point."""
    told = json.loads(path.read_text())
    figures = {name: told[key] for name, key in FIGURES.items()}
    points = {point: each["rms_error"] for point, each in told["tasks"].items()}
    return figures | {"errors": points, "stance": told["stance"]}


def stance(told: dict[str, Any]) -> tuple[float, float | None]:
    """How far a robot that stood leaned [rad], and when it fell [s]."""
    return told["lean"], told["fell"]


@contextlib.contextmanager
def running(*argv: object, cwd: Path) -> Iterator[tuple[subprocess.Popen, str]]:
    """A command in a process of its own, and the first line that it printed. It heeds
    Ctrl-C (SIGINT), and ends with the block."""
    process = subprocess.Popen(
        [sys.executable, "-m", MODULE, *map(str, argv)],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A background job may ignore it, and so would its child.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    try:
        yield process, process.stdout.readline()
    finally:
        process.kill()
        process.communicate()


def port_of(line: str) -> int:
    """The port that a server's first line names."""
    return int(re.search(r"127\.0\.0\.1:(\d+)", line)[1])


# --- what is served over UDP

DESCRIBE = b'{"describe": true}'


def to_points(places: dict[str, Any]) -> bytes:
    """A message: where points should be [m]."""
    targets = {name: {"position": list(map(float, p))} for name, p in places.items()}
    return json.dumps({"targets": targets}).encode()


def spheres(**names: tuple[Any, float, float]) -> bytes:
    """A message: places [m], radii [m] and largest speeds [m/s] of spheres."""
    told = {
        name: {"position": list(map(float, p)), "radius": radius, "speed": speed}
        for name, (p, radius, speed) in names.items()
    }
    return json.dumps({"obstacles": told}).encode()


@dataclass(frozen=True)
class Served:
    """An answer: a description of what is served (joints and targets that would ask
    the robot to stay), or a command; what it is not has None."""

    joints: list[str] | None
    stay: dict[str, list[float]] | None
    q: list[float] | None
    v: list[float] | None
    efforts: list[float] | None
    brakes: bool


def served(answer: bytes) -> Served:
    """Reads an answer."""
    told = json.loads(answer)
    if "tasks" in told:
        stay = {name: each["position"] for name, each in told["targets"].items()}
        return Served(told["positions"], stay, None, None, None, False)
    values = (told[key] for key in ("positions", "velocities", "torques"))
    return Served(None, None, *values, told["status"] == "braking")


# What tells an answer from other messages in the guide.
ANSWER_HAS = {"positions", "torques"}

# --- what is played over HTTP


@dataclass(frozen=True)
class Frame:
    """What the page of a live run shows."""

    number: int  # of the frame
    time: float  # simulated [s]
    targets: list[list[float]]  # places of the points' targets [m]
    drags: list[list[float]]  # by how much they were dragged


def next_frame(url: str, after: int = 0) -> Frame:
    """Waits for a frame of a live run after the one of a number."""
    while True:
        with urllib.request.urlopen(f"{url}live?after={after}", timeout=60) as answer:
            told = json.load(answer)
        if frame := told["frame"]:
            values = (frame["time"], frame["targets"], frame["offsets"])
            return Frame(told["number"], *values)


def drag(url: str, target: int, by: list[float]) -> None:
    """Drags a target of a live run, by its number, by metres."""
    _ask(url, {"do": "offset", "task": target, "value": by})


def hold_motion(url: str) -> None:
    """Stops the motion of a live run where it is."""
    _ask(url, {"do": "motion", "value": False})


def _ask(url: str, what: dict[str, object]) -> None:
    headers = {"Content-Type": "application/json"}
    body = json.dumps(what).encode()
    asked = urllib.request.Request(f"{url}do", body, headers)
    urllib.request.urlopen(asked, timeout=60).close()


# --- what the pages show


@dataclass(frozen=True)
class Rule:
    """What becomes of a command in a page."""

    begins: str  # a regular expression for the command, with what it begins
    more: tuple[str, ...] | None = None  # words that make it short, if it is run here
    elsewhere: str = ""  # the test that does what it does, or why it is parsed only


_SHORT = ("--duration", "0.05", "--no-page")
# The first whose beginning fits; a command without any fails its test.
PAGE_RULES = [
    Rule(f"{PROGRAM} COMMAND --help", elsewhere="test_every_commands_help"),
    Rule(f"{PROGRAM} run [a-z0-9]+_standing", elsewhere="test_a_robot_that_stands"),
    Rule(f"{PROGRAM} run (g1|SCENARIO)", elsewhere="minutes of a humanoid's work"),
    Rule(f"{PROGRAM} run", _SHORT),
    Rule(f"{PROGRAM} judge out/g1", elsewhere="a motion of minutes of work"),
    Rule(rf"{PROGRAM} judge .*log\.npz", ()),
    Rule(
        f"{PROGRAM} (judge|clean) .*g1_",
        elsewhere="test_before_it_is_violated_and_after_it_is_not",
    ),
    Rule(f"{PROGRAM} retarget", elsewhere="test_it_moves_like_the_person_as_it_did"),
    Rule(f"{PROGRAM} show .*csv .*csv", ("--no-meshes",)),
    Rule(f"{PROGRAM} (convert|show)", ()),
    Rule(f"{PROGRAM} serve --joints", ("--port", "0", *_SHORT[:2])),
    Rule(f"{PROGRAM} serve", elsewhere="test_it_serves_and_ends"),
    Rule(f"{PROGRAM} play", elsewhere="test_it_plays_and_ends"),
    Rule(f"{PROGRAM} import-robot", elsewhere="test_a_humanoid"),
    Rule("python examples/filter_a_policy", ()),
    Rule("python ", elsewhere="tests/test_examples.py, or it measures for minutes"),
]
# What stands for a user's own, or for what takes long to import.
PAGE_WORDS = {"my_robot": BUILT_IN, "g1": BUILT_IN}
# What a page says of a command's end, and the exit code.
PAGE_CODES = {"VIOLATED": VIOLATED, "exit code 1": VIOLATED}


def parse_error(words: list[str]) -> str:
    """What the product's own parser says against a command line; "" if nothing."""
    try:
        crar_drake.commands.parse(crar_drake.commands.make_parser(), words)
    except crar_drake.CrarError as error:
        return str(error)
    return ""


# What README's program prints, and the largest error that it may name [mm].
README_SAYS, README_ERROR = r"wrists off by at most ([\d.]+) mm\n", 2.0

# Text of pages' programs to what stands in its place: names that a user has, and what
# a comment leaves to the reader.
SNIPPET_TEXTS = {
    '"my_robot"': f'"{BUILT_IN}"',
    "# ... simulator.AdvanceTo(...)": "Simulator(builder.Build()).AdvanceTo(0.01)",
}


class Given:
    """What a page's program takes for given: Drake's names, the public ones of the
    product, and a user's plant, robot, targets and the like, which belong together.
    Each is made when it is asked for."""

    def __init__(self, code: str) -> None:
        """
        Args:
            code: of the program, which says what it makes itself.
        """
        self.code = code

    def __getattr__(self, name: str) -> Any:
        if name in USERS_OWN:
            value = USERS_OWN[name](self)
            setattr(self, name, value)
            return value
        if name in crar_drake.__all__:
            return getattr(crar_drake, name)
        if name in LIBRARIES:
            return LIBRARIES[name]
        for module in OF_DRAKE:
            if hasattr(module := importlib.import_module(f"pydrake.{module}"), name):
                return getattr(module, name)
        raise AttributeError(name)


LIBRARIES = {"dataclasses": dataclasses, "Path": Path, "json": json, "socket": socket}
OF_DRAKE = ("geometry", "math", "multibody.tree", "systems.analysis", "visualization")


def _wired(given: Given) -> Wired:
    if "AddRobot" in given.code:
        return empty_plant()
    return put_in_plant(finalized="Finalize" not in given.code)


def _context(given: Given) -> Any:
    controller = given.controller  # which is added to the diagram first
    root = simulate(given.wired, given.wired.ports(), 0.01)
    return controller.GetMyContextFromRoot(root)


# What a user has, in pages' programs.
USERS_OWN = {
    "period": lambda given: 0.02,
    "centres": lambda given: ((1.0, 0.0, 1.0), (0.0, 1.5, 1.0)),  # of two persons
    "wired": _wired,
    "builder": lambda given: given.wired.builder,
    "plant": lambda given: given.wired.plant,
    "scene_graph": lambda given: given.wired.scene_graph,
    "robot": lambda given: given.wired.robot,
    "tasks": lambda given: tasks_of([("position", POINT)]),
    "parameters": lambda given: crar_drake.LookaheadParameters(),
    "controller": lambda given: add_controller(given.wired).controller,
    "model": lambda given: given.controller.model,
    "context": _context,
    "q": lambda given: given.model.rest_positions(),
    "v": lambda given: 0.0 * given.q,
    "desired_tasks": lambda given: given.model.tasks_at(given.q),
    "first_tasks": lambda given: given.desired_tasks,
    "desired_prescribed": lambda given: given.model.prescribed_at(given.q),
    "filter": lambda given: crar_drake.SafetyFilter(BUILT_IN, given.period),
    "wanted": lambda given: given.filter.model.rest_positions(),
    "q_measured": lambda given: given.wanted,
    "v_measured": lambda given: 0.0 * given.wanted,
}


def empty_plant(time_step: float = 1e-3) -> Wired:
    """A plant without a robot."""
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
    from pydrake.systems.framework import DiagramBuilder

    builder = DiagramBuilder()
    return Wired(builder, *AddMultibodyPlantSceneGraph(builder, time_step), None)


def robot_by_its_own_file(*, finalized: bool = True) -> Wired:
    """The built-in robot by Drake's parser, in a plant; its instance is its robot."""
    from pydrake.multibody.parsing import Parser

    wired, of = empty_plant(), facts(BUILT_IN)
    (wired.robot,) = Parser(wired.plant).AddModels(str(of.file))
    base = wired.plant.GetFrameByName(of.base)
    wired.plant.WeldFrames(wired.plant.world_frame(), base)
    if finalized:
        wired.plant.Finalize()
    return wired


def yaml_error(text: str, folder: Path) -> str:
    """What is wrong with YAML of a page, as a scenario, a robot's file or a table of a
    person's joints, or a part of them: what each of them says; "" if one takes it."""
    from crar_drake.motion.joint_names import load_joint_file

    whole = yaml.safe_load((robot_folder(BUILT_IN) / ROBOT_FILE).read_text())
    parts = {"robot": BUILT_IN, "motion": MOTION, "tasks": TASKS}
    scenario_part = yaml.safe_load(scenario(**parts))
    told, said = yaml.safe_load(text), []

    def load_joints(path: Path) -> None:
        load_joint_file(str(path), list(map(str, told.values())))

    for load, around in (
        (crar_drake.load_scenario, scenario_part),
        (crar_drake.load_robot_description, whole),
        (load_joints, {}),
    ):
        path = folder / ROBOT_FILE
        path.write_text(yaml.safe_dump(around | told))
        (folder / whole["model"]).touch()
        try:
            load(path)
        except crar_drake.CrarError as error:
            said.append(str(error))
        else:
            return ""
    return "\n".join(said)


# --- law and filter (section of LAW) --------------------------------------------------

# What guide and theory promise, unless it is changed.
SAFETY_DISTANCE = 4e-3  # of watched pairs [m]
TOUCHING_SPEED = 0.05  # no faster link is touched by what moves by itself [m/s]
GROUND_MARGIN, GROUND_FRICTION = 0.02, 0.5  # of a robot that stands [m], [1]
TIPPING = "tipping_cell"  # a shipped robot on a frame that may tip
HAND_SETS = {  # the paper's experiments: points that are tracked
    "wrists": "wrists",
    "seven": "upper-body",
}


@dataclass(frozen=True)
class RobotFacts:
    """What a robot's description says, for a judge who reads its model file."""

    file: Path  # of the model
    base: str  # the link that stands there:
    place: tuple[float, ...]  # [m]
    turn: tuple[float, ...]  # roll, pitch, yaw [rad]
    pairs: tuple[tuple[str, str], ...]  # of links that are watched
    prescribed: tuple[str, ...]  # joints whose motion is given
    soles: dict[str, list[list[float]]]  # link -> corners of its sole, in its frame [m]


def facts(robot: str | Path, *, stands: bool = False) -> RobotFacts:
    """Of a robot by its name or folder; `stands`: on its soles, base and legs still."""
    told = _described(robot, stands)
    pose = told.root_pose
    return RobotFacts(
        Path(told.folder) / told.model,
        told.base,
        tuple(pose.xyz),
        tuple(pose.rpy),
        tuple(tuple(pair) for pair in told.pairs),
        tuple(told.prescribed_joints),
        dict(told.soles),
    )


def _described(robot: str | Path, stands: bool) -> Any:
    told = crar_drake.load_robot_description(robot)
    return crar_drake.standing_description(told) if stands else told


def write_robot(
    folder: Path,
    urdf: str,
    *,
    pairs: list[list[str]],
    points: list[str],
    base: str = "base",
    prescribed: tuple[str, ...] = (),
    place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rest: dict[str, float] | None = None,
    soles: dict[str, list[list[float]]] | None = None,
    floats: bool = False,
) -> Path:
    """Writes a robot as a user does: its model, and what it does not say.

    Args:
        points: links whose origins can be tracked.
        prescribed: joints that stay, or are moved by somebody else.
        floats: whether the base is not welded to the world.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / URDF_FILE).write_text(urdf)
    told = {
        "name": "own",
        "model": URDF_FILE,
        "base": base,
        "root_pose": {"xyz": list(map(float, place))},
        "prescribed_joints": dict.fromkeys(prescribed, "hold"),
        "task_frames": {point: point for point in points},
        "pairs": [list(pair) for pair in pairs],
        "rest_posture": rest or {},
        "soles": soles or {},
    }
    if floats:
        told["root"] = "prescribed"
    (folder / ROBOT_FILE).write_text(yaml.safe_dump(told))
    return folder


def links_of(robot: str | Path, points: list[str]) -> list[str]:
    """The links whose origins are a robot's points."""
    told = _described(robot, stands=False)
    return [told.task_frames[point] for point in points]


def points_of(name: str) -> list[str]:
    """The points of one of HAND_SETS."""
    return list(crar_drake.EXPERIMENTS[HAND_SETS[name]])


@dataclass(frozen=True)
class LawStep:
    """A step of a law."""

    a: Any  # (n,) commanded accelerations of all joints, held for a period
    next_q: Any  # (n,) the state that they lead to
    next_v: Any
    torques: Any  # (n,) of the motors, by joint
    clipped: float  # by which share of its limit a motor's torque was beyond it [1]
    braking: bool  # since targets are no numbers
    as_desired: bool  # whether the nominal step was taken as it was
    blocked: tuple[str, str] | None  # the sphere that it runs into and the link
    distances: Any  # (P,) of the watched pairs [m]
    dq: Any  # (n_c,) the paper's constrained velocities of the controlled joints
    weights: Any  # (n_c,) the paper's W


class Law:
    """The law of tasks in a user's own loop, all tasks positions of points.

    Attributes:
        joints: (n,) names, the order of all vectors.
        controlled: (n_c,) indices of the joints that are not prescribed.
        rest: (n,) the rest posture.
        home: (P, 3) where the points are then [m].
        period: [s].
    """

    def __init__(
        self,
        robot: str | Path,
        points: list[str],
        *,
        period: float,
        paper: str | None = None,
        motors: bool = True,
        plant_step: float = 0.0,
        stands: bool = False,
        balance: bool = False,
        tracking_error: float = 0.0,
        blend: float | None = None,
        spheres: bool = False,
    ) -> None:
        """
        Args:
            robot: name or folder.
            paper: "velocity" or "acceleration": the law of the paper, at this level,
                with distances of SceneGraph.
            motors: whether their limits are kept.
            plant_step: time step of the plant [s], 0 if it is continuous.
            stands: on its soles, base and legs still.
            balance: whether it keeps to what the ground can give.
            tracking_error: how far joints may be from their commands [rad or m].
            blend: onto targets, in seconds; by default the product's.
            spheres: whether steps will be told of some that move.
        """
        told = _described(robot, stands)
        tasks = tasks_of([("position", point) for point in points])
        model = crar_drake.ControlModel.FromDescription(
            told, tasks, time_step=plant_step
        )
        given: dict[str, Any] = {"period": period, "effort_limits": motors}
        if paper:
            given["level"] = paper
        else:
            given["tracking_error"] = tracking_error
        if balance:
            given["balance"] = crar_drake.BalanceParameters()
        if blend is not None:
            given["blend_time"] = blend
        kind = crar_drake.PaperParameters if paper else crar_drake.LookaheadParameters
        chosen = kind(**given)
        if spheres:
            chosen = chosen.among_obstacles()
        self._law = crar_drake.ControlLaw(model, chosen)
        self._model = model
        self.period = period
        self.joints = list(model.position_names)
        self.controlled = list(model.controlled)
        self.prescribed = list(model.prescribed)
        self.rest = model.rest_positions()
        here = model.layout.unpack(model.tasks_at(self.rest))
        self.home = here.p.copy()
        self._of_motor = [
            model.plant.get_joint_actuator(i).joint().velocity_start()
            for i in model.plant.GetJointActuatorIndices()
        ]

    def restart(self) -> None:
        """The next step is a first one."""
        self._law.reset()

    def step(
        self,
        q: Any,
        v: Any,
        points: Any,
        rates: Any = 0.0,
        accelerations: Any = 0.0,
        *,
        prescribed: Any = None,
        spheres: "Spheres | None" = None,
    ) -> LawStep:
        """A step; points (P, 3), their rates and accelerations [m, m/s, m/s^2].

        Args:
            prescribed: (3, n_p) positions, velocities and accelerations of prescribed
                joints; by default they stay where they are at rest.
        """
        model = self._model
        at = np.broadcast_to(np.zeros((0, 3, 3)), (0, 3, 3))
        rates, accelerations = (
            np.broadcast_to(x, np.shape(points)).ravel() for x in (rates, accelerations)
        )
        tasks = model.layout.pack(at, points, rates, accelerations)
        if prescribed is None:
            given = model.prescribed_at(self.rest)
        else:
            given = np.ravel(prescribed)
        around = None if spheres is None else spheres.made()
        found = self._law.step(q, v, tasks, given, obstacles=around)
        torques = np.zeros(len(self.joints))
        torques[self._of_motor] = found.actuation
        n = len(self.joints)
        return LawStep(
            found.acceleration,
            found.position_command[:n],
            found.position_command[n:],
            torques,
            float(found.torque_limit[1]),
            float(found.status[0]) == 2.0,
            float(found.admission[0]) == 0.0,
            found.obstacle,
            found.signed_distances,
            found.constrained_velocity,
            found.constraint_weights,
        )


@dataclass(frozen=True)
class Spheres:
    """What moves by itself: centres (M, 3) [m], radii [m], bounds of speeds [m/s]."""

    centres: Any
    radii: Any
    speeds: Any
    names: tuple[str, ...] | None = None

    def made(self) -> Any:
        return crar_drake.Obstacles(self.centres, self.radii, self.speeds, self.names)


# Why a joint command is not passed on.
PAIR, LIMIT, SPEED, MOTOR = "pair", "joint limit", "joint speed", "motor"
SPHERE, RETURNING, NO_NUMBER = "obstacle", "catching up", "no number"


@dataclass(frozen=True)
class FilterStep:
    """What became of a desired joint command."""

    q: Any  # (n,) the state a period later
    v: Any
    a: Any  # (n,) the acceleration until then
    passed: bool  # whether the command is the desired one, bit by bit
    braking: bool  # whether nothing is left but to brake
    why: str  # one of the reasons above, or ""
    pair: tuple[str, str] | None  # what it is about
    joint: str | None
    safe_start: bool  # whether the step began with a braking path that is free
    clearance: float  # no watched distance is smaller on the next braking path [m]
    blocked: tuple[str, str] | None  # the sphere that it runs into and the link
    too_fast: tuple[str, ...]  # spheres that broke the bound of their speed
    error: float  # the largest difference of a measured joint from the command before
    error_joint: str | None  # of which joint


class JointFilter:
    """The filter of joint commands.

    Attributes:
        joints: (n,) names, the order of all vectors.
        rest: (n,) the rest posture.
        period, braking_time: [s].
    """

    def __init__(
        self,
        robot: str | Path,
        period: float,
        *,
        motors: bool = False,
        speeds: dict[str, float] | None = None,
        tracking_error: float = 0.0,
        evade: bool = False,
    ) -> None:
        """
        Args:
            robot: name or folder.
            motors: whether their limits are kept.
            speeds: joint to its largest speed, instead of the robot's [rad/s or m/s].
            tracking_error: how far joints may be from their commands [rad or m].
            evade: whether links get out of the way of spheres.
        """
        chosen = crar_drake.SafetyParameters(
            tracking_error=tracking_error, evade=evade, velocity_limits=speeds or {}
        )
        self._filter = made = crar_drake.SafetyFilter(
            robot, period, chosen, effort_limits=motors
        )
        self.joints = list(made.joint_names)
        self.rest = made.model.rest_positions()
        self.period = period
        self.braking_time = made.parameters.T

    def restart(self, q: Any = None, v: Any = None) -> None:
        """Begins at a state, or at rest."""
        self._filter.reset(q, v)

    def step(
        self,
        q: Any = None,
        v: Any = None,
        a: Any = None,
        *,
        measured: Any = None,
        spheres: Spheres | None = None,
    ) -> FilterStep:
        """The command for the end of the period."""
        around = None if spheres is None else spheres.made()
        found = self._filter(q, v, a, measured=measured, obstacles=around)
        told = found.report
        return FilterStep(
            *(found.q, found.v, found.a),
            told.how == "nominal",
            told.braking,
            told.why,
            told.pair,
            told.joint,
            told.clear,
            told.clearance,
            told.obstacle,
            told.too_fast,
            told.tracking_error,
            told.tracking_joint,
        )


# --- tracking (section of TRACKING) ---------------------------------------------------


def persons_targets(
    motion: str, points: str, folder: Path, time: Any
) -> tuple[Any, Any]:
    """What a person's motion asks of the built-in robot, as its scenario's diagram has
    it at times (K,).

    Args:
        motion: its name, "subject_trial" of CMU's.
        points: one of HAND_SETS.
        folder: for the scenario's file.

    Returns:
        (K, 3, P, 3) positions, velocities and accelerations of points, and (K, 3, n_p)
        of prescribed joints.
    """
    path = folder / "clip.yaml"
    tasks = HAND_SETS[points]
    path.write_text(scenario(robot=BUILT_IN, motion=f"cmu:{motion}", tasks=tasks))
    diagram = diagram_of(path)

    def sampled(name: str) -> Any:
        source = diagram.GetSubsystemByName(name)
        context, found = source.CreateDefaultContext(), []
        for t in time:
            context.SetTime(t)
            found.append(source.get_output_port().Eval(context))
        return np.array(found).reshape(len(time), 3, -1)

    targets, prescribed = sampled("desired_tasks"), sampled("desired_prescribed")
    return targets.reshape(len(time), 3, -1, 3), prescribed


# The controller's ports, and those of the filter, by neutral names.
INPUTS = {
    "state": "estimated_state",
    "targets": "desired_tasks",
    "prescribed": "desired_prescribed",
    "posture": "nominal_posture",
    "spheres": "obstacles",
}
OUTPUTS = {
    "torques": "actuation",
    "accelerations": "desired_acceleration",
    "command": "position_command",
    "told": "diagnostics",
}
FILTER_INPUTS = {
    "positions": "desired_position",
    "velocities": "desired_velocity",
    "accelerations": "desired_acceleration",
    "desired state": "desired_state",
    "measured state": "measured_state",
    "spheres": "obstacles",
}
FILTER_OUTPUTS = {
    "command": "command",
    "positions": "position_command",
    "accelerations": "acceleration_command",
    "told": "diagnostics",
}
# Of these, what holds the last update's answer, and the part of all that is told which
# answers now.
HELD = {"accelerations": "desired_acceleration", "command": "position_command"}
# What a controller tells of its step.
TOLD = {
    "errors": "task_error",
    "distances": "signed_distances",
    "status": "status",
    "admission": "admission",
    "torque limit": "torque_limit",
    "weights": "constraint_weights",
}
# Entries of these.
TOLD_ENTRIES = {
    "bound of distances": ("admission", 2),  # on the next braking path [m]
    "path is clear": ("admission", 3),
    "torque beyond limits": ("torque limit", 1),
}
TRACKS, BLENDS, BRAKES = 0.0, 1.0, 2.0  # status
BLEND = 0.5  # how long it blends in [s]
# What a scenario's diagram is made of, and what it gives out.
DIAGRAM_PARTS = {
    "plant": "plant",
    "controller": "crar_controller",
    "targets": "desired_tasks",
    "log of states": "log_state",
    "log of targets": "log_desired_tasks",
    "log of what is told": "log_diagnostics",
}
DIAGRAM_OUTPUTS = {"state": "state", "shapes": "query", "targets": "desired_tasks"}

Task = tuple[str, str]  # "position", "orientation", "pose" or "joint", and of what


def put_in_plant(
    robot: str = BUILT_IN, time_step: float = 1e-3, *, finalized: bool = False
) -> Wired:
    """A shipped robot in a plant."""
    wired = empty_plant(time_step)
    wired.robot, wired.name = crar_drake.AddRobot(wired.plant, robot), robot
    if finalized:
        wired.plant.Finalize()
    return wired


def says(wired: Wired) -> dict[str, Any]:
    """What the description of a robot in a plant says, as the guide has it."""
    told = load_robot(wired.name)
    return {
        "points": dict(told.task_frames),
        "pairs": [tuple(pair) for pair in told.pairs],
        "prescribed": list(told.prescribed_joints),
        "rest": dict(told.rest_posture),
    }


def watch(wired: Wired, pairs: list[tuple[str, str]]) -> None:
    """Adds pairs of links to those that the description has, before there is a
    controller."""
    wired.watched = [*load_robot(wired.name).pairs, *map(list, pairs)]


def tasks_of(tasks: list[Task]) -> list[Any]:
    """The product's own records of tasks."""
    return [
        crar_drake.Task(kind=kind, **{"joint" if kind == "joint" else "frame": name})
        for kind, name in tasks
    ]


def add_controller(
    wired: Wired,
    tasks: list[Task] | None = None,
    *,
    sphere_speeds: list[float] | None = None,
    own_file: bool = False,
    **parameters: object,
) -> Wired:
    """Adds a controller beside a plant, once that is finalized.

    Args:
        tasks: by default a position of POINT.
        sphere_speeds: bounds for what moves by itself [m/s].
        own_file: the robot is by its own file in the plant, among other things.
        parameters: its period [s] and the like, where they are not the product's.
    """
    told, tasks = load_robot(wired.name), tasks_of(tasks or [("position", POINT)])
    if own_file:
        tasks = [
            dataclasses.replace(task, frame=told.task_frames[task.frame])
            for task in tasks
        ]
    wired.controller = crar_drake.AddCrarController(
        *(wired.builder, wired.plant, wired.scene_graph, tasks),
        crar_drake.LookaheadParameters(**parameters),
        model_instance=wired.robot,
        watch=wired.watched or told.pairs,
        prescribed=list(told.prescribed_joints),
        obstacle_speeds=sphere_speeds or (),
    )
    return wired


def rest_in_plant(wired: Wired) -> None:
    """Makes the rest posture of the description that of the plant."""
    for name, position in load_robot(wired.name).rest_posture.items():
        joint = wired.plant.GetJointByName(name, wired.robot)
        joint.set_default_positions([position])


def packed(
    wired: Wired, R: Any, p: Any, v: Any = None, a: Any = None, q: Any = None
) -> Any:
    """Targets as the port takes them: rotations (Na, 3, 3) of tasks that have one,
    positions (Nl, 3), rows of velocities and accelerations, positions of joints."""
    return wired.controller.model.layout.pack(R, p, v, a, q)


def told(wired: Wired, root: Any) -> dict[str, Any]:
    """What the controller tells, by the names of TOLD and TOLD_ENTRIES.

    Args:
        root: the context of the whole diagram.
    """
    context = wired.controller.GetMyContextFromRoot(root)
    parts = wired.controller.diagnostics(context)
    found = {name: parts[key].copy() for name, key in TOLD.items()}
    return found | {name: found[of][i] for name, (of, i) in TOLD_ENTRIES.items()}


def place_told(wired: Wired, name: str) -> slice:
    """Where that stands in the port of all that is told."""
    return wired.controller.diagnostics_slices[TOLD[name]]


def without_diagram(
    wired: Wired, q: Any, v: Any, targets: Any, prescribed: Any
) -> dict[str, Any]:
    """What the law answers in a user's own loop, in place of the controller's outputs:
    all but what is told."""
    law = crar_drake.ControlLaw(wired.controller.model, wired.controller.law.parameters)
    found = law.step(q, v, targets, prescribed)
    return {
        "torques": law.torque(q, v),
        "accelerations": found.acceleration,
        "command": found.position_command,
    }


def start_near(wired: Wired, targets: Any) -> Any:
    """(nq,) a posture to begin in, near targets; prescribed joints as at rest."""
    model = wired.controller.model
    still = wired.posture[model.prescribed_positions]
    return crar_drake.solve_start_pose(model, targets, still)


def filter_system(
    robot: str, period: float, sphere_speeds: list[float] | None = None
) -> Any:
    """The filter of joint commands as a system of a diagram."""
    speeds = () if sphere_speeds is None else (sphere_speeds,)
    filter = crar_drake.SafetyFilter(robot, period)
    return crar_drake.SafetyFilterSystem(filter, *speeds)


def filter_told(system: Any, context: Any) -> tuple[bool, str, float]:
    """Of the filter's last command: whether it was passed on, why not (one of the
    reasons above), and the clearance of the braking path [m]."""
    values = system.GetOutputPort(FILTER_OUTPUTS["told"]).Eval(context)
    return bool(values[0] == 0.0), system.report(context).why, float(values[2])


def diagram_of(path: Path) -> Any:
    """The diagram of a scenario's file."""
    return crar_drake.MakeCrarDiagram(crar_drake.load_scenario(path))


# --- whole motions, imports, certificates (section of MOTIONS) ------------------------

ROBOT_MOTIONS = "CRAR_ROBOT_MOTIONS"  # environment variable: the folder of such

# Robots that are imported by their names: another humanoid's upper half, and an arm.
UPPER_HALF, INDUSTRIAL_ARM = "talos", "ur5_joint_limited_robot"

# What the last line begins with, where nothing is violated and where something is.
HOLDS, BROKEN = "OK", "VIOLATED"

# How the layouts of robots' motions are called, and how such files end.
LAYOUTS = {
    "w last": ("xyzw-csv", ".csv"),
    "w first": ("wxyz-csv", ".csv"),
    "named degrees": ("named-csv", ".csv"),
    "arrays, depth first": ("mjlab-npz", ".npz"),
    "arrays, breadth first": ("beyondmimic-npz", ".npz"),
    "pickle": ("gmr-pkl", ".pkl"),
}


@dataclass(frozen=True)
class Imported:
    """What an import has decided, as its files say."""

    # That are controlled: lower and upper limit, effort, speed (None: the file has
    # none); rad, Nm and rad/s, or m, N and m/s.
    joints: dict[str, tuple[float | None, ...]]
    points: dict[str, str]  # the person's that were found ("left wrist") -> link
    pairs: set[frozenset[str]]  # of links that are kept apart
    base: str  # "floating", "fixed", or "prescribed", which a motion moves about
    rest: dict[str, float]  # joint -> where it rests
    model: Path  # the URDF that was written


def imported(folder: Path) -> Imported:
    """Reads the folder of an imported robot."""
    decided = yaml.safe_load((folder / IMPORT_FILE).read_text())
    model = folder / URDF_FILE
    joints = {}
    for joint in ElementTree.parse(model).getroot().iter("joint"):
        limit = joint.find("limit")
        if joint.get("type") == "fixed" or limit is None:
            continue
        said = [limit.get(key) for key in ("lower", "upper", "effort", "velocity")]
        joints[joint.get("name")] = tuple(v if v is None else float(v) for v in said)
    frames, rest = decided["frames"], decided["rest_posture"]
    return Imported(
        joints,
        {name.replace("_", " "): place["link"] for name, place in frames.items()},
        {frozenset(pair) for pair in decided["pairs"]},
        decided["base"],
        {name: value for name, value in rest.items() if name in joints},
        model,
    )


def imported_by_name(robot: str) -> Path:
    """The folder of a robot that was imported without saying where to."""
    return Path(os.environ[CACHE]) / "crar-drake" / "robots" / robot


def certificate_of(motion: Path) -> Path:
    """Where the certificate of a written motion lies."""
    return motion.with_name(CERTIFICATE.format(motion.stem))


# Where a certificate says what; of lists of frames, those of its only clip.
CERTIFIED = {
    "hash of the motion": ("motion", "sha256"),
    "hash of the model": ("robot", "files", "robot.urdf"),
    "rate": ("motion", "rate"),
    "number of pairs": ("robot", "watched_pairs"),
    "distance at frames": ("clips", 0, "frames", "distance"),
    "distance between frames": ("clips", 0, "frames", "between"),
    "margin to limits": ("clips", 0, "frames", "limit"),
    "share of speed limits": ("clips", 0, "frames", "speed"),
    "smallest distance": ("clips", 0, "smallest", "distance"),
    "distance of meshes at frames": ("clips", 0, "meshes", "at_frames"),
    "not covered": ("not_covered", "pairs"),
}


def certified(certificate: dict, what: str) -> Any:
    """What a certificate, which was read as JSON, says by a neutral name."""
    for key in CERTIFIED[what]:
        certificate = certificate[key]
    return certificate


def certify(certificate: dict, what: str, value: Any) -> None:
    """Makes a certificate say something else."""
    *way, last = CERTIFIED[what]
    for key in way:
        certificate = certificate[key]
    certificate[last] = value
