"""One robot: imported, set a task, run and judged, with nothing corrected by hand."""

import json
import shutil
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.robots.catalogue import Subject
from crar_drake.errors import CrarError, ModelError
from crar_drake.files import write_whole
from crar_drake.judging.mesh_judge import MeshJudge
from crar_drake.judging.referee import Referee
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.results import LOG
from crar_drake.results.log import SimulationLog
from crar_drake.results.summary import summarize
from crar_drake.robot.description import RobotDescription, load_robot_description
from crar_drake.robot.joints import joint_units
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import EXPERIMENTS, Task, position_tasks
from crar_drake.robot_import import import_robot
from crar_drake.run import run_scenario
from crar_drake.simulation.scenario import Scenario
from crar_drake.targets.keyframes import Keyframe

RESULT, ROBOT = "result.json", "robot"
SEVEN = "upper-body"
TOOL = "tool"

_PERIOD = 0.005  # [s] of control
_MESH_PERIOD = 0.05  # [s]

# An arm's tool visits places that its joints reach from the rest posture by turning
# this far or sliding this share of their range, with this much room between links, or
# half of that at rest.
_TURNS = 0.5  # [rad]
_SHARE = 0.25
_ROOM = 0.02  # [m]
_PLACES, _SECONDS = 4, 1.5


@dataclass
class Outcome:
    """What became of one robot.

    Attributes:
        why: what stopped it, in a sentence; "" where nothing did.
        imported: whether there is a robot.
        import_time: CPU time of the import [s].
        warnings: of the import's report.
        task: SEVEN or TOOL; "" where it was set none.
        duration: of the run [s].
        run_time: CPU time of run and log [s].
        size: of what moves: neck's height over the floor, or a tool's way from its
            nearest to its farthest place [m].
        error: rms, of the points, from when the targets are blended in [m].
        capsules, meshes: smallest distances [m]; infinite where nothing is watched.
        penetrating, meshes_penetrating: samples.
        mesh_samples: that the meshes were asked at.
        mesh_pairs: links whose meshes penetrate, the deepest first.
        beyond_limit, beyond_speed, samples: control steps.
        at_top_speed: share of these in which a joint is within 1 % of its speed limit.
    """

    why: str = ""
    imported: bool = False
    import_time: float = 0.0
    warnings: list[str] = field(default_factory=list)
    task: str = ""
    duration: float = 0.0
    run_time: float = 0.0
    size: float | None = None
    error: float | None = None
    capsules: float | None = None
    meshes: float | None = None
    penetrating: int = 0
    meshes_penetrating: int = 0
    mesh_samples: int = 0
    mesh_pairs: list[list[str]] = field(default_factory=list)
    beyond_limit: int = 0
    beyond_speed: int = 0
    samples: int = 0
    at_top_speed: float | None = None

    @property
    def violations_of_model(self) -> int:
        """Samples that violate what the controller knows: capsules, limits, speeds."""
        return self.penetrating + self.beyond_limit + self.beyond_speed

    @property
    def violations(self) -> int:
        """Samples that violate anything, by any judge; some count twice."""
        return self.violations_of_model + self.meshes_penetrating


def load_outcome(folder: Path) -> Outcome | None:
    """What an earlier run left in a robot's folder; None if nothing."""
    try:
        return Outcome(**json.loads((folder / RESULT).read_text()))
    except (OSError, ValueError, TypeError):
        return None


def try_robot(
    subject: Subject, path: Path, folder: Path, motion: str, duration: float | None
) -> Outcome:
    """Imports, runs and judges; the outcome and all files are in `folder` then.

    Errors that name what is wrong with a robot are outcomes; others are raised.

    Args:
        subject: the robot.
        path: of its file.
        folder: to write into.
        motion: of those with two arms, as a scenario names it.
        duration: of its run at most [s]; None for the whole motion.
    """
    outcome = Outcome()
    try:
        _try(outcome, subject, path, folder, motion, duration)
    except CrarError as error:
        outcome.why = str(error).replace(f"{path}: ", "").replace(f"{folder}/", "")
    write_whole(folder / RESULT, json.dumps(asdict(outcome), indent=2) + "\n")
    return outcome


def _try(outcome: Outcome, subject, path, folder: Path, motion, duration) -> None:
    # What an earlier import guessed would be kept.
    shutil.rmtree(folder / ROBOT, ignore_errors=True)
    start = time.process_time()
    report = import_robot(path, folder / ROBOT)
    outcome.import_time = time.process_time() - start
    outcome.imported, outcome.warnings = True, report.warnings
    description = load_robot_description(folder / ROBOT)
    scenario = _scenario(subject, description, folder / ROBOT, motion, duration)
    outcome.task = scenario.experiment or TOOL
    start = time.process_time()
    run_scenario(scenario, folder, record=False)
    outcome.run_time = time.process_time() - start
    log = SimulationLog.load(folder / LOG)
    outcome.duration = float(log.time[-1])
    _judge(outcome, log, scenario, description)


def _scenario(
    subject: Subject,
    description: RobotDescription,
    robot: Path,
    motion: str,
    duration: float | None,
) -> Scenario:
    """The task that a robot can do by what the import found of it.

    Raises:
        ModelError: it found neither two arms nor a tool.
    """
    frames = description.task_frames
    scenario = Scenario(
        robot=str(robot),
        controller=LookaheadParameters(period=_PERIOD, effort_limits=False),
    )
    if set(EXPERIMENTS[SEVEN]) <= set(frames):
        scenario.experiment = SEVEN
        scenario.motion, scenario.duration = motion, duration
    elif TOOL in frames:
        scenario.tasks = [Task(frame=TOOL)]
        scenario.keyframes = {TOOL: _visits(description)}
        scenario.duration = scenario.keyframes[TOOL][-1].time
    else:
        raise ModelError(
            "it has no task here: the import found neither two mirrored arms nor a "
            "single longest chain of four or more joints"
        )
    return scenario


def _visits(description: RobotDescription) -> list[Keyframe]:
    """Where the tool goes and when; from the rest posture and back to it."""
    model = ControlModel.FromDescription(description, position_tasks([TOOL]))
    rest, columns = model.rest_positions(), model.controlled_positions
    referee = Referee(model.plant, model.scene_graph, description.pairs)
    slides = np.array(joint_units(model.plant, model.joint_names)) == "m"
    ways = model.upper - model.lower
    ways = np.where(np.isfinite(ways), ways, 0.0)
    reach = np.where(slides, _SHARE * ways, _TURNS)
    lower = np.maximum(rest[columns] - reach, model.lower)
    upper = np.minimum(rest[columns] + reach, model.upper)
    rng = np.random.default_rng(0)
    places, room = [rest], -np.inf
    if len(description.pairs):
        # Neighbours may be nearer than that wherever they are.
        room = min(_ROOM, 0.5 * referee.distances(rest).min())
    for _ in range(1000):
        q = rest.copy()
        q[columns] = rng.uniform(lower, upper)
        if not len(description.pairs) or referee.distances(q).min() > room:
            places.append(q)
        if len(places) == _PLACES:
            break
    else:
        raise ModelError("no posture beside that at rest was found clear of itself")
    places.append(rest)
    points = [model.layout.unpack(model.tasks_at(q)).p.ravel() for q in places]
    return [Keyframe(_SECONDS * i, [float(c) for c in p]) for i, p in enumerate(points)]


def _judge(
    outcome: Outcome,
    log: SimulationLog,
    scenario: Scenario,
    description: RobotDescription,
) -> None:
    """Fills in what judges say that share nothing with the controller."""
    model = ControlModel.FromDescription(description, scenario.task_list())
    late = log.samples(log.time >= scenario.controller.blend_time)
    outcome.error = summarize(late).rms_task_error
    pairs = description.without_ground().pairs
    speeds = scenario.controller.speed_limits(model)
    found = Referee(model.plant, model.scene_graph, pairs, speeds).violations(
        log.q, log.v
    )
    outcome.samples = len(log.time)
    outcome.at_top_speed = top_speed_share(log, speeds)
    outcome.capsules = found.smallest_distance if len(pairs) else None
    outcome.penetrating = found.num_penetrating
    outcome.beyond_limit, outcome.beyond_speed = (
        found.num_beyond_limit,
        found.num_beyond_speed,
    )
    period = float(np.median(np.diff(log.time)))
    verdict = MeshJudge(description).judge(
        log.q[:: max(1, round(_MESH_PERIOD / period))]
    )
    if verdict.num_pairs:
        outcome.meshes = float(verdict.nearest.distance)
    outcome.mesh_samples = len(verdict.frames)
    outcome.meshes_penetrating = verdict.num_penetrating
    outcome.mesh_pairs = [list(each.pair) for each in verdict.penetrations]
    outcome.size = _size(model, scenario, log)


def top_speed_share(log: SimulationLog, speeds: np.ndarray) -> float:
    """In how many samples a joint is within 1 % of its speed limit [0, 1]."""
    return float(np.mean((np.abs(log.v) > 0.99 * speeds).any(axis=1)))


def _size(model: ControlModel, scenario: Scenario, log: SimulationLog) -> float:
    """How tall the neck stands, or how far the tool is to go [m]."""
    if scenario.experiment:
        neck = model.plant.GetFrameByName(model.description.task_frames["neck"])
        context = model.plant.CreateDefaultContext()
        model.plant.SetPositions(context, model.rest_positions())
        return float(neck.CalcPoseInWorld(context).translation()[2])
    points: Sequence = [frame.xyz for frame in scenario.keyframes[TOOL]]
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return float(gaps.max())
