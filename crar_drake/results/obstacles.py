"""What obstacles that move did in a run, by the independent judge."""

from collections.abc import Iterable, Sequence

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.judging.obstacle_judge import ObstacleFigures, ObstacleJudge
from crar_drake.results.log import SimulationLog
from crar_drake.simulation.scenario import Scenario


def judge_obstacles(
    log: SimulationLog,
    scenario: Scenario,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    pairs: Iterable[Sequence[str]],
) -> dict[str, ObstacleFigures]:
    """Judges all samples of a log, by the obstacles' names.

    Args:
        scenario: of the log, with the obstacles' names and the speed that is harmless.
        plant, scene_graph: with its robot.
    """
    known = np.isfinite(log.q).all(axis=1) & np.isfinite(log.v).all(axis=1)
    if not log.obstacles.size or not known.any():
        return {}
    links = [link for pair in pairs for link in pair]
    judge = ObstacleJudge(plant, scene_graph, links)
    found = judge.judge(
        log.time[known],
        log.q[known],
        log.v[known],
        log.obstacles[known].reshape(known.sum(), -1, 4),
        scenario.controller.contact_speed,
    )
    names = [obstacle.name for obstacle in scenario.obstacles]
    return dict(zip(names, found, strict=True))
