"""The figures of a trajectory: one referee and one formula for all controllers."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crar_drake import ControlModel, load_robot_description, position_tasks
from crar_drake.judging.referee import Referee
from crar_drake.robot.description import LIMIT_TOLERANCE, find_frame

FROZEN_SPEED = 1e-6  # [rad/s] below which no joint moves
MOVING_SPEED = 0.05  # [m/s] of a target that asks for motion


@dataclass(frozen=True)
class Figures:
    """What a run is judged by.

    Attributes:
        smallest_distance: of any watched pair at any sample [m].
        penetrating: share of the samples where a pair penetrates.
        beyond_limit: share of the samples where a joint is beyond its limit.
        limit_excess: the farthest that a joint is beyond its limit [rad].
        failed: steps without an answer.
        frozen: steps in which no joint moves although a target does.
        error: rms over time and task points [m].
        rms_acceleration, peak_acceleration: of the joint velocities' differences
            over the control period, over time and joints [rad/s^2].
        clear_at: time after which nothing penetrates any more [s]; 0 if nothing ever
            does, infinite if something does at the end.
    """

    smallest_distance: float
    penetrating: float
    beyond_limit: float
    limit_excess: float
    failed: int
    frozen: int
    error: float
    rms_acceleration: float
    peak_acceleration: float
    clear_at: float

    @property
    def holds(self) -> bool:
        """Whether there is neither a violation nor a step without an answer."""
        return not (self.penetrating or self.beyond_limit or self.failed or self.frozen)


class Judge:
    """Judges configurations of the shipped robot, not of the files for the peers.

    Attributes:
        model: the shipped robot, with its waist where the rest posture has it.
    """

    def __init__(self, robot: str, joints: list[str], tasks: list[str]) -> None:
        description = load_robot_description(robot)
        self.model = model = ControlModel.FromDescription(
            description, position_tasks(tasks)
        )
        self._referee = Referee(model.plant, model.scene_graph, description.pairs)
        self._rest = model.rest_positions()
        self._columns = [model.position_names.index(joint) for joint in joints]
        self._workspace = model.MakeWorkspace()
        self._frames = [
            find_frame(model.plant, description.task_frames[task]) for task in tasks
        ]

    @classmethod
    def of(cls, folder: Path) -> Judge:
        """Of the problem in a folder."""
        data = json.loads((folder / "problem.json").read_text())
        return cls(data["robot"], data["joints"], data["tasks"])

    def whole(self, q: np.ndarray) -> np.ndarray:
        """Positions (T, nq) of the shipped robot with its joints at q (T, n)."""
        q_whole = np.tile(self._rest, (len(q), 1))
        q_whole[:, self._columns] = q
        return q_whole

    def points(self, q: np.ndarray) -> np.ndarray:
        """Task points (T, tasks, 3) in the world [m]."""
        plant, world = self.model.plant, self.model.plant.world_frame()
        context = self._workspace.plant_context
        points = np.empty((len(q), len(self._frames), 3))
        for k, q_k in enumerate(self.whole(q)):
            plant.SetPositions(context, q_k)
            for i, frame in enumerate(self._frames):
                X_WT = frame.CalcPose(context, world)
                points[k, i] = X_WT.translation()
        return points

    def errors(self, result: dict[str, np.ndarray]) -> np.ndarray:
        """(T, tasks) from each task point to its target [m], of what a driver
        recorded."""
        return np.linalg.norm(self.points(result["q"]) - result["p"], axis=2)

    def figures(self, result: dict[str, np.ndarray]) -> Figures:
        """Judges what a driver recorded, see `driver.run`."""
        time, q, v, p_d = (result[key] for key in ("time", "q", "v", "p"))
        period = time[1] - time[0]
        whole = self.whole(q)
        found = self._referee.violations(whole)
        acceleration = np.diff(v, axis=0) / period
        speed = np.linalg.norm(np.diff(p_d, axis=0), axis=2).max(axis=1) / period
        still = np.abs(v[1:]).max(axis=1) < FROZEN_SPEED
        no_answer = result["no_answer"].astype(bool)
        lower, upper = self._referee.lower, self._referee.upper
        num_beyond = np.sum(
            np.maximum(lower - whole, whole - upper) > LIMIT_TOLERANCE, axis=1
        )
        last = np.flatnonzero(found.count > num_beyond)  # penetrating samples
        clear_at = 0.0
        if len(last):
            clear_at = float(time[last[-1] + 1]) if last[-1] + 1 < len(time) else np.inf
        return Figures(
            smallest_distance=found.smallest_distance,
            penetrating=found.num_penetrating / found.num_samples,
            beyond_limit=found.num_beyond_limit / found.num_samples,
            limit_excess=found.largest_limit_excess if num_beyond.any() else 0.0,
            failed=int(no_answer.sum()),
            frozen=int((still & (speed > MOVING_SPEED) & ~no_answer).sum()),
            error=float(np.sqrt(np.mean(self.errors(result) ** 2))),
            rms_acceleration=float(np.sqrt(np.mean(acceleration**2))),
            peak_acceleration=float(np.abs(acceleration).max()),
            clear_at=clear_at,
        )
