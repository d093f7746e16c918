"""What the page shows of a simulation that goes on.

Meshcat brings the robot's shapes. Where they are, targets, near pairs and figures come
with frames, which `LiveScene.frame` makes, so that all of a picture is of one instant
and no browser is behind by what waits in a socket.
"""

import math
from dataclasses import replace

import numpy as np
from pydrake.geometry import Meshcat

from crar_drake.law.safety_filter import HOW, NOMINAL
from crar_drake.law.solution import STATUS_WORDS
from crar_drake.play.live_simulation import LiveSimulation
from crar_drake.play.pacing import Pacer
from crar_drake.results.drawn_robot import DrawnRobot
from crar_drake.results.marks import NEARNESS_STEPS
from crar_drake.results.recorded_page import spoken
from crar_drake.robot.description import GROUND
from crar_drake.simulation.visuals import set_surroundings
from crar_drake.strict_json import finite

PREFIX = "/crar/robot0"

# What the page calls what a law reports; else as that does.
_CALLED = {"blending": "blending in", "scaled": "slowed down"}
_PROMISES = {
    "none": "no constraints: nothing is guaranteed",
    "paper": "the paper's constraints: nothing is guaranteed",
}


class LiveScene:
    """Draws a live simulation.

    Attributes:
        robot: as it is drawn.
        outline: (P, 3) points that the camera should have in the picture [m].
    """

    def __init__(self, live: LiveSimulation, meshcat: Meshcat) -> None:
        """
        Args:
            live: the simulation.
            meshcat: to draw into; it is not kept.
        """
        self._live = live
        scenario = live.scenario
        set_surroundings(meshcat)
        colour = scenario.visualization.default_illustration_color
        # The robot itself, and the pairs that the controller reports on.
        simulated, pairs = live.setup.simulated, live.model.description.pairs
        drawn = replace(simulated.description, pairs=pairs)
        radii = live.obstacles()[:, 3].tolist()
        self.robot = DrawnRobot(drawn, meshcat, PREFIX, colour, radii)
        self._near = NEARNESS_STEPS[0] * scenario.warning_distance
        above = np.array([GROUND in names for names in live.model.pairs.names], bool)
        self._above_ground = above & (not above.all())
        _, points = self.robot.pose_links(live.positions())
        ball = [] if live.ball is None else [live.ball[None]]
        self.outline = np.vstack([points, live.path, *ball])

    def frame(self, pacer: Pacer, now: float, notice: str) -> dict:
        """What the page shows now, for JSON.

        Args:
            now: on the wall [s].
            notice: something to tell the person; "" for nothing.
        """
        live = self._live
        poses, _ = self.robot.pose_links(live.positions(), live.obstacles()[:, :3])
        parts = live.diagnostics()
        distances = parts["signed_distances"]
        # Feet are always near the ground, as in `SimulationLog.between_links`.
        distances = np.where(self._above_ground & (distances >= 0), np.inf, distances)
        targets = live.wanted()
        here = live.setup.simulated.tasks_at(live.positions())
        reached = here[live.model.layout.position_entries]
        admission = parts["admission"]
        status = STATUS_WORDS[float(parts["status"][0])]
        found = HOW.get(float(admission[0]), NOMINAL)
        return {
            "time": finite(live.time, 3),
            "paused": pacer.paused,
            "speed": pacer.speed,
            "rate": finite(pacer.rate(now, live.time), 3),
            "late": finite(0.0 if pacer.paused else pacer.late(now, live.time), 4),
            "behind": finite(pacer.behind, 2),
            "motion": live.moves,
            "phase": finite(live.phase, 2),
            "offsets": finite(live.offsets, 4),
            "ball": None if live.ball is None else finite(live.ball, 4),
            "poses": finite(poses.ravel(), 5),
            "targets": finite(targets, 4),
            "reached": finite(reached, 4),
            "error": finite(
                np.linalg.norm(targets - reached, axis=1).max(initial=0.0), 5
            ),
            "near": [
                [int(pair), finite(d, 5), *finite(ends, 4)]
                for pair, d, *ends in self.robot.near_pairs(distances, self._near)
            ],
            "smallest": finite(distances.min(initial=math.inf), 5),
            "status": _CALLED.get(status, status),
            "admitted": _CALLED.get(found, found),
            "promise": self._promise(distances.min(initial=math.inf), admission[3]),
            "notice": notice,
            "changes": len(live.events),
        }

    def _promise(self, smallest: float, clear: float) -> tuple[str, str]:
        """What is guaranteed: the kind, a class of the page's style, and words.

        Args:
            smallest: distance of a pair [m].
            clear: 1 if pairs and obstacles let the robot brake on a clear path.
        """
        live, mode = self._live, self._live.mode
        if smallest < 0.0:
            return "broken", f"links are inside each other ({mode})"
        if (found := live.beyond()) is not None:
            joint, far = found
            return "broken", f"{spoken(joint)} is {far:.2g} beyond its limit ({mode})"
        if mode != "lookahead":
            return "open", _PROMISES[mode]
        if live.pushed:
            return "open", "pushed: while a force acts nothing is guaranteed"
        if clear != 1.0:
            return "open", "lookahead: on its way back to where the constraints hold"
        if (found := live.holding_back()) is not None:
            obstacle, link = found
            near = f"{obstacle} is near the {spoken(link)}"
            return "holds", f"lookahead: {near}, so that it is slow"
        return "holds", "lookahead: the way to brake is clear"
