"""What obstacles that move did in a run, by the independent judge."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.judging.obstacle_judge import ObstacleJudge
from crar_drake.results.log import SimulationLog
from crar_drake.simulation.scenario import Scenario


@dataclass(frozen=True)
class ObstacleFigures:
    """What one obstacle did."""

    smallest_distance: float  # of a watched link [m]
    link: str  # that one
    time: float  # when [s]
    contact_samples: int  # in which it touches a link
    fast_contacts: int  # those in which that link is faster there than `contact_speed`
    fastest_contact: float  # the largest speed of a link where it was touched [m/s]

    def in_words(self) -> str:
        """Where it was nearest, and how fast links were that it touched."""
        text = f"{self.link}, at {self.time:.2f} s"
        if self.contact_samples:
            several = "s" if self.contact_samples > 1 else ""
            text += (
                f"; touches in {self.contact_samples} sample{several} a link that "
                f"moves at up to {1e3 * self.fastest_contact:.0f} mm/s"
            )
        return text


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
        log.q[known],
        log.v[known],
        log.obstacles[known].reshape(known.sum(), -1, 4),
        scenario.controller.contact_speed,
    )
    return {
        obstacle.name: ObstacleFigures(
            one.smallest_distance,
            one.link,
            float(log.time[known][one.index]),
            one.touching,
            one.violations,
            one.fastest,
        )
        for obstacle, one in zip(scenario.obstacles, found, strict=True)
    }
