"""How near a robot's legs are to each other, and which moves of a foot part them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.motion.parted_legs import LegRoom
from crar_drake.motion.performer import SIDES
from crar_drake.robot.model import ControlModel
from crar_drake.robot_import.link_outlines import links_outward
from crar_drake.targets.ankle_limits import LegSolver

# Between two legs: pairs keep 5 mm, a lookahead holds them back from farther on [m].
_ROOM = 0.012
# They are to be so far apart a moment later, too, if they went on as they do, for half
# of the scenarios' horizon: farther on, knees that pass would be beyond each other [s].
_AHEAD = 0.02
_DAMPING = 0.02  # [m] of a leg's Jacobian, which may be singular
_ARM = 0.2  # [m] by which its angular rows are compared with the linear ones


class LegClearance:
    """The watched pairs of links of which either leg has one."""

    def __init__(
        self, model: ControlModel, solvers: Mapping[str, LegSolver], rate: float
    ) -> None:
        """
        Args:
            model: the robot.
            solvers: side to who finds the positions of that leg's joints.
            rate: of the samples [Hz].
        """
        self._model, self._solvers, self._rate = model, solvers, rate
        self._workspace = model.MakeWorkspace()
        rest = model.description.rest_pose().rotation().matrix()
        self._at_rest = Rotation.from_matrix(rest)
        column = {v: i for i, v in enumerate(model.controlled.tolist())}
        self._places, self._columns, links = {}, {}, []
        for side, solver in solvers.items():
            self._places[side] = [joint.position_start() for joint in solver.joints]
            self._columns[side] = [column[j.velocity_start()] for j in solver.joints]
            hip = solver.joints[-1].child_body()
            links.append(links_outward(model.plant, hip.body_frame()))
        left, right = links
        between = [
            row
            for row, (a, b) in enumerate(model.description.pairs)
            if (a in left and b in right) or (a in right and b in left)
        ]
        self._between = np.array(between, dtype=int)

    def room(self, root_turns: Rotation) -> LegRoom:
        """Of the legs as the solvers found them last.

        Args:
            root_turns: T of them, of the base from its rest: what is x and y of a foot.
        """
        model, count = self._model, len(root_turns)
        lacking = np.zeros(count)
        effects = {side: np.zeros((count, 3)) for side in SIDES}
        if not len(self._between):
            return LegRoom(lacking, effects)
        quaternions = (root_turns * self._at_rest).as_quat()[:, [3, 0, 1, 2]]
        legs = {side: np.array(self._solvers[side].positions) for side in SIDES}
        speeds = {s: self._rate * np.gradient(legs[s], axis=0) for s in SIDES}
        ahead = {side: legs[side] + _AHEAD * speeds[side] for side in SIDES}
        q = model.rest_positions()
        for t in range(count):
            for where in (legs, ahead):
                for side in SIDES:
                    q[self._places[side]] = where[side][t]
                found = model.evaluate_distances(self._workspace, q)
                row = self._between[found.d[self._between].argmin()]
                if _ROOM - found.d[row] <= lacking[t]:
                    continue
                lacking[t] = _ROOM - found.d[row]
                q[model.root_positions[:4]] = quaternions[t]
                for side in SIDES:
                    solver = self._solvers[side]
                    free = ~solver.stopped(legs[side][t])
                    g = found.dd_dq[row, self._columns[side]][free]
                    effects[side][t] = _by_foot(solver.jacobian(q)[:, free], g)
        return LegRoom(lacking, effects)


def _by_foot(J: np.ndarray, g: np.ndarray) -> np.ndarray:
    """(3,) how something changes with a foot's place, x and y, and its turn about the
    vertical, where it does so with the leg's joints by g (n,); J (6, n) of the foot."""
    scale = np.array([_ARM] * 3 + [1.0] * 3)
    J = scale[:, None] * J
    core = J @ J.T + _DAMPING**2 * np.eye(6)
    by_pose = scale * np.linalg.solve(core, J @ g)
    return by_pose[[3, 4, 2]]
