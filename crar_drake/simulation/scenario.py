"""A scenario: one whole diagram as a YAML file.

`diagrams/README.md` shows the file. Plant, simulator and visualisation are
configured by Drake's own dataclasses.
"""

# YAML loading reads the types of the fields, so no postponed annotations here.
import math
import os
from dataclasses import dataclass, field
from pathlib import Path

from pydrake.common.yaml import yaml_dump, yaml_dump_typed, yaml_load_data
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import SimulatorConfig
from pydrake.visualization import VisualizationConfig

from crar_drake.errors import ModelError, ScenarioError, nearest
from crar_drake.law.parameters import (
    CONSTRAINTS,
    LookaheadParameters,
    PaperParameters,
)
from crar_drake.motion.conditioning import DEFAULT_CUTOFF
from crar_drake.motion.options import MotionOptions
from crar_drake.resources import data_folder
from crar_drake.robot.description import is_path
from crar_drake.robot.task import EXPERIMENTS, Task, experiment_tasks
from crar_drake.simulation.disturbances import Disturbances
from crar_drake.simulation.moving_obstacles import MovingObstacle, check_obstacles
from crar_drake.targets.keyframes import Keyframe
from crar_drake.yaml_files import load_yaml, read_text

# A log of more samples takes its memory from the run: 60 s at 1 ms take 100 MB.
MAX_LOG_SAMPLES = 60_000

# A simulation runs at about real time, and this is twelve days.
MAX_DURATION = 1e6  # [s]


def _plant_config() -> MultibodyPlantConfig:
    # What Drake would work out in each step beside the state, the forces in the joints
    # among it, is worked out where somebody asks for it.
    return MultibodyPlantConfig(
        time_step=1e-3,
        use_sampled_output_ports=False,
        discrete_contact_approximation="lagged",
    )


def _simulator_config() -> SimulatorConfig:
    return SimulatorConfig(max_step_size=1e-2)


def _visualization_config() -> VisualizationConfig:
    # A period that is a binary fraction keeps recorded frames evenly spaced.
    return VisualizationConfig(
        publish_period=1.0 / 32.0,
        publish_proximity=False,
        publish_contacts=False,
        publish_inertia=False,
    )


@dataclass
class SimulatedRobot:
    """What the simulated plant does of its own.

    All off by default: contact would push penetrating segments apart, limits would
    stop a joint and effort limits would clamp the torque, so that a violation by
    the controller could not be seen.
    """

    contact: bool = False  # segments collide, also with the environment
    position_limits: bool = False  # joints stop at their limits
    effort_limits: bool = False  # torques are clamped at the model's effort limits


@dataclass
class Standing:
    """A robot that stands on its soles, on a floor with contact and friction."""

    friction: float = 0.8  # Coulomb's coefficient of the floor


@dataclass
class Scenario:
    """One whole diagram: robot, motion, tasks, controller, simulation, recording.

    Attributes:
        description: one line for `crar-drake show`.
        robot: name of a shipped or imported robot, or path of a robot.yaml or of
            its folder.
        motion: name of a motion (`dance`, `cmu:05_02`, a path); "" if `keyframes`
            say where the tasks go.
        skeleton: path of the motion's .asf, where it is not beside the motion.
        frame_rate: samples per second of the motion [Hz]; by default what the file
            states, else that of the CMU database.
        unit, up, facing, joints: of a motion that is no AMC, where what is inferred is
            wrong; see `motion.options.MotionOptions`.
        cutoff: of the low-pass on the motion [Hz].
        experiment: a task set of the paper, "wrists" or "upper-body"; "" if `tasks`
            lists them.
        tasks: what is tracked.
        keyframes: task name to its keyframes, instead of a motion.
        controller: parameters of the law: `constraints: lookahead` (the default),
            `paper` or `none` says of which.
        standing: for a robot with soles that nothing but the ground carries; legs and
            root stay, the upper body follows. None for a root that is fixed.
        simulated_robot: what the simulated plant does of its own; of a robot that
            stands, contact and effort limits are always there.
        disturbances: how the simulated robot differs from what the controller
            believes; none by default.
        obstacles: spheres that move by themselves; constraints "lookahead" keep the
            robot off them, or slow, where the plant's time step is the control period
            (`docs/theory/moving-obstacles.md`).
        duration: of the simulation, at most MAX_DURATION [s]; by default that of the
            motion.
        warning_distance: segments nearer than this are near: the recording tells
            their distance, and the colour of nearness grows from three times it on
            [m].
        log_period: of log.npz [s]; by default the control period, or of runs with
            more than MAX_LOG_SAMPLES steps the multiple of it that keeps to them.
        plant_config, simulator_config: Drake's own.
        visualization: Drake's own, of which `publish_period` [s] (between frames of the
            recording) and `default_illustration_color` count.
    """

    description: str = ""
    robot: str = "upper_body"
    motion: str = ""
    skeleton: str = ""
    frame_rate: float | None = None  # [Hz]
    unit: str = ""
    up: str = ""
    facing: str = ""
    joints: str = ""
    cutoff: float = DEFAULT_CUTOFF  # [Hz]
    experiment: str = ""
    tasks: list[Task] = field(default_factory=list)
    keyframes: dict[str, list[Keyframe]] = field(default_factory=dict)
    controller: LookaheadParameters | PaperParameters = field(
        default_factory=LookaheadParameters
    )
    standing: Standing | None = None
    simulated_robot: SimulatedRobot = field(default_factory=SimulatedRobot)
    disturbances: Disturbances = field(default_factory=Disturbances)
    obstacles: list[MovingObstacle] = field(default_factory=list)
    duration: float | None = None  # [s]
    warning_distance: float = 0.02  # [m]
    log_period: float | None = None  # [s]
    plant_config: MultibodyPlantConfig = field(default_factory=_plant_config)
    simulator_config: SimulatorConfig = field(default_factory=_simulator_config)
    visualization: VisualizationConfig = field(default_factory=_visualization_config)

    @property
    def law_parameters(self) -> LookaheadParameters | PaperParameters:
        """The controller's parameters, as its obstacles ask for."""
        if self.obstacles and isinstance(self.controller, LookaheadParameters):
            return self.controller.among_obstacles()
        return self.controller

    def validate(self) -> None:
        """Checks what can be checked without the robot and the motion.

        Raises:
            ScenarioError: names the field, its value and the remedy.
        """
        self.controller.validate()
        self.disturbances.validate()
        check_obstacles(self.obstacles)
        if self.standing is not None:
            self._validate_standing(self.standing)
            if self.obstacles:
                raise ScenarioError(
                    "obstacles: a robot that stands on its own soles keeps off none "
                    "that move; leave out obstacles or standing"
                )
        if bool(self.motion) == bool(self.keyframes):
            raise ScenarioError(
                "give either motion (a file or name) or keyframes (poses), not "
                f"{'both' if self.motion else 'neither'}"
            )
        if bool(self.experiment) == bool(self.tasks):
            raise ScenarioError(
                "give either experiment or tasks, not "
                f"{'both' if self.experiment else 'neither'}"
            )
        if self.experiment and self.experiment not in EXPERIMENTS:
            raise ScenarioError(
                f"experiment: {self.experiment!r} is unknown"
                f"{nearest(self.experiment, EXPERIMENTS)}"
            )
        if self.frame_rate is not None and self.keyframes:
            raise ScenarioError(
                "frame_rate: keyframes have times of their own; leave it out"
            )
        self.motion_options()
        positive = ("duration", "frame_rate", "cutoff", "warning_distance")
        for name in (*positive, "log_period"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < float("inf"):
                raise ScenarioError(f"{name}: {value} must be positive")
        if self.duration is not None and self.duration > MAX_DURATION:
            raise ScenarioError(
                f"duration: {self.duration:g} s would take about "
                f"{self.duration / 86400.0:,.0f} days to simulate, since that runs at "
                f"about real time; at most {MAX_DURATION:g} s are simulated at once"
            )
        for task in self.tasks:
            try:
                task.validate()
            except ModelError as error:
                raise ScenarioError(f"tasks: {error}") from error
        if not self.plant_config.time_step >= 0.0:
            raise ScenarioError(
                f"plant_config.time_step: {self.plant_config.time_step} must be "
                "positive, or 0 for a continuous plant"
            )
        if not self.visualization.publish_period > 0.0:
            raise ScenarioError(
                f"visualization.publish_period: {self.visualization.publish_period} "
                "must be positive"
            )
        if self.simulator_config.start_time != 0.0:
            raise ScenarioError(
                f"simulator_config.start_time: {self.simulator_config.start_time:g} s "
                "must be 0, where every motion starts"
            )
        check_multiple(
            "controller.period", self.controller.period, self.plant_config.time_step
        )

    def _validate_standing(self, standing: Standing) -> None:
        friction = standing.friction
        if not 0.0 < friction < math.inf:
            raise ScenarioError(f"standing.friction: {friction} must be positive")
        if not self.plant_config.time_step > 0.0:
            raise ScenarioError(
                "plant_config.time_step: 0: a robot that stands needs a discrete "
                "plant, whose contact is solved in steps; choose e.g. 0.001"
            )

    def motion_options(self) -> MotionOptions:
        """What the scenario says of its motion beyond the file.

        Raises:
            MotionError: a unit or an axis is none.
        """
        return MotionOptions(
            self.skeleton, self.frame_rate, self.unit, self.up, self.facing, self.joints
        )

    def task_list(self) -> list[Task]:
        """The tasks, whether listed or of an experiment."""
        if self.experiment:
            return experiment_tasks(self.experiment)
        return self.tasks

    def log_period_for(self, duration: float) -> float:
        """The period that a run of `duration` [s] is logged at [s]."""
        period = self.controller.period
        if self.log_period is not None:
            return self.log_period
        return period * max(1, math.ceil(duration / period / MAX_LOG_SAMPLES))

    def to_yaml(self) -> str:
        """The scenario as YAML text, every field written out but settings of Drake's
        that are as by default: another Drake has others."""
        text = yaml_load_data(yaml_dump_typed(self))
        changed = yaml_load_data(yaml_dump_typed(self, defaults=Scenario()))
        for name in ("plant_config", "simulator_config", "visualization"):
            del text[name]
            if name in changed:
                text[name] = changed[name]
        return yaml_dump(text)


def check_multiple(name: str, period: float, time_step: float) -> None:
    """Raises ScenarioError unless `period` is a multiple of the plant's step.

    Args:
        name: of the period, for the message.
        period: [s].
        time_step: of the discrete plant [s]; 0 for a continuous one, which takes
            any period.
    """
    ratio = period / time_step if time_step > 0.0 else 1.0
    if abs(ratio - round(ratio)) > 1e-6 * ratio or round(ratio) < 1:
        raise ScenarioError(
            f"{name}: {period:g} s is not a multiple of the plant's time step "
            f"{time_step:g} s; choose e.g. {max(round(ratio), 1) * time_step:g}"
        )


def scenario_names() -> list[str]:
    """Names of the shipped scenarios."""
    return sorted(path.stem for path in data_folder("diagrams").glob("*.yaml"))


def load_scenario(scenario: str | os.PathLike[str]) -> Scenario:
    """Loads a scenario file by path, or a shipped one by name.

    Paths in the file (robot, motion, skeleton, joints) are looked for beside it, then
    in the working directory.

    Raises:
        ScenarioError: there is no such file, it is no YAML in UTF-8, has an unknown
            key or one twice, or a value is of another type or out of range; the
            message names file, key and line.
    """
    path = Path(scenario)
    if not path.is_file():
        shipped = data_folder("diagrams") / f"{path.stem}.yaml"
        if path.parent.name not in ("", "diagrams") or not shipped.is_file():
            raise ScenarioError(
                f"no scenario {str(scenario)!r}: neither a file nor one of the shipped "
                f"ones{nearest(path.stem, scenario_names())}"
            )
        path = shipped
    parsed = parse_scenario(read_text(path, ScenarioError), str(path))
    # A file may name what lies beside it, wherever it is run from.
    for name in ("robot", "motion", "skeleton", "joints"):
        beside = path.parent / getattr(parsed, name)
        there = beside.is_file() or (name == "robot" and _is_robot(beside))
        if getattr(parsed, name) and there:
            setattr(parsed, name, str(beside))
    robot = Path(parsed.robot)
    if is_path(parsed.robot) and not robot.is_file() and not _is_robot(robot):
        raise ScenarioError(
            f"{path}: robot: there is no robot {parsed.robot!r}, neither in "
            f"{path.parent.absolute()} nor in {Path.cwd()}"
        )
    return parsed


def _is_robot(folder: Path) -> bool:
    return (folder / "robot.yaml").is_file()


def parse_scenario(text: str, source: str = "scenario") -> Scenario:
    """Parses and validates a scenario's YAML text.

    Raises:
        ScenarioError: as `load_scenario`.
    """
    scenario = load_yaml(
        text,
        Scenario,
        source,
        ScenarioError,
        manual="diagrams/README.md",
        defaults=Scenario(),
        kinds={"controller": ("constraints", CONSTRAINTS)},
    )
    try:
        scenario.validate()
    except ScenarioError as error:
        raise ScenarioError(f"{source}: {error}") from error
    return scenario
