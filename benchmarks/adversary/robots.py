"""The robots that are attacked, each with the tasks that it is attacked through."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

from benchmarks.adversary.judge import Judge
from benchmarks.adversary.random_robots import KINDS, draw_robot
from crar_drake.errors import CrarError, nearest
from crar_drake.law.safety_filter import SafetyFilter
from crar_drake.robot.description import RobotDescription, load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import EXPERIMENTS, Task, position_tasks

# Shipped or imported robots; the jaw is the adversary's own. Of the others each episode
# draws one of its own.
ROBOTS = ("upper_body", "obstacle_arm", "shelf_arm", "g1", "talos", "jaw", *KINDS)
ASKED_FOR = ("boxes", "shelf_arm")  # attacked only if they are named
_OWN = {"jaw": Path(__file__).parent / "jaw"}


def _poses(*frames: str) -> list[Task]:
    return [Task(frame=frame, kind="pose", orientation_weight=0.3) for frame in frames]


_HUMANOID = {
    "wrists": position_tasks(EXPERIMENTS["wrists"]),  # m < n
    "points": position_tasks(EXPERIMENTS["upper-body"]),  # m > n
}
TASKS = {
    "upper_body": _HUMANOID | {"poses": _poses("left_wrist", "right_wrist")},
    "g1": _HUMANOID | {"poses": _poses("left_hand", "right_hand")},
    "talos": _HUMANOID | {"poses": _poses("left_wrist", "right_wrist")},
    "obstacle_arm": {
        "pose": _poses("tool"),
        "position": position_tasks(["tool"]),
    },
    "shelf_arm": {"pose": _poses("tool"), "position": position_tasks(["tool"])},
    "jaw": {"position": position_tasks(["hand"]), "pose": _poses("hand")},
}


@dataclass
class Subject:
    """A robot under attack.

    Attributes:
        name: of the robot.
        description: of it.
        judge: of its states, on a plant of its own.
        models: by the name of a task set; filled when first asked for.
        filters: by the period and the share of the motors' limits, with judges of all
            joints; likewise.
    """

    name: str
    description: RobotDescription
    judge: Judge
    models: dict[str, ControlModel] = field(default_factory=dict)
    filters: dict[tuple[float, float], tuple[SafetyFilter, Judge]] = field(
        default_factory=dict
    )

    def task_set(self, episode: int) -> str:
        """The task sets take turns; a robot that was drawn has one."""
        names = list(TASKS.get(self.name, ["drawn"]))
        return names[episode % len(names)]

    def model(self, task_set: str) -> ControlModel:
        """The control model with these tasks."""
        if task_set not in self.models:
            self.models[task_set] = ControlModel.FromDescription(
                self.description, TASKS[self.name][task_set]
            )
        return self.models[task_set]

    def filter(self, period: float, motors: float = 0.0) -> tuple[SafetyFilter, Judge]:
        """The filter of the robot's joints, and a judge that counts all of them.

        Args:
            period: of the filter [s].
            motors: the share of the motors' limits that it may use; 0 for no limits.
        """
        if (period, motors) not in self.filters:
            model = self.model(self.task_set(0))
            judged = model.plant, model.scene_graph, self.description.pairs
            description = replace(self.description, prescribed_joints={})
            model = ControlModel(model.diagram, *judged[:2], description, [])
            if motors:
                model.actuator_limits = motors * model.actuator_limits
            filter = SafetyFilter(model, period, effort_limits=motors > 0.0)
            self.filters[period, motors] = filter, Judge(*judged)
        return self.filters[period, motors]


_SUBJECTS: dict[str, Subject] = {}


def load_subject(robot: str, seed: int = 0) -> Subject:
    """The robot of that name, made once per process; or the one drawn with that seed.

    Raises:
        CrarError: there is no such robot here, or it is not imported yet.
    """
    if robot not in ROBOTS:
        raise CrarError(f"robot {robot!r} is not attacked here{nearest(robot, ROBOTS)}")
    if robot in KINDS:
        return _draw_subject(robot, seed)
    if robot not in _SUBJECTS:
        description = load_robot_description(_OWN.get(robot, robot))
        # A model of its own, so that nothing is shared with the controller's.
        own = ControlModel.FromDescription(
            description, next(iter(TASKS[robot].values()))
        )
        judge = Judge(
            own.plant,
            own.scene_graph,
            description.pairs,
            [name for name in own.prescribed_names],
        )
        _SUBJECTS[robot] = Subject(robot, description, judge)
    return _SUBJECTS[robot]


@lru_cache(maxsize=2 * len(KINDS))
def _draw_subject(kind: str, seed: int) -> Subject:
    description, judge, model = draw_robot(kind, seed)
    return Subject(kind, description, judge, {"drawn": model})
