"""How near a robot's legs are to each other, and which moves of a foot part them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable
from scipy.spatial.transform import Rotation

from crar_drake.motion.parted_legs import LegRoom
from crar_drake.motion.performer import SIDES
from crar_drake.robot.description import find_frame
from crar_drake.robot.model import ControlModel
from crar_drake.robot_import.link_outlines import links_outward
from crar_drake.targets.ankle_limits import LegSolver

# Between two legs: pairs keep 5 mm, and a lookahead holds legs back from farther on [m].
_ROOM = 0.012
# They are to be so far apart a moment later, too, if they went on as they do: half of the
# scenarios' horizon. Farther on, knees that pass each other would be beyond each other [s].
_AHEAD = 0.02
_DAMPING = 0.02  # [m] of a leg's Jacobian, which may be singular
_ARM = 0.2  # [m] by which its angular rows are to be compared with the linear ones


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
        plant, frames = model.plant, model.description.task_frames
        self._model, self._solvers, self._rate = model, solvers, rate
        self._at_rest = Rotation.from_matrix(
            model.description.rest_pose().rotation().matrix()
        )
        self._workspace = model.MakeWorkspace()
        links, self._feet, self._places, self._columns, self._moves = {}, {}, {}, {}, {}
        column = {v: i for i, v in enumerate(model.controlled.tolist())}
        for side in SIDES:
            joints = solvers[side].joints
            links[side] = set(
                links_outward(plant, joints[-1].child_body().body_frame())
            )
            self._feet[side] = find_frame(plant, frames[f"{side}_foot"])
            self._places[side] = [joint.position_start() for joint in joints]
            self._moves[side] = [joint.velocity_start() for joint in joints]
            self._columns[side] = [column[v] for v in self._moves[side]]
        left, right = (links[side] for side in SIDES)
        self._between = np.array(
            [
                row
                for row, (a, b) in enumerate(model.description.pairs)
                if (a in left and b in right) or (a in right and b in left)
            ],
            dtype=int,
        )

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
        R_WB = root_turns * self._at_rest
        quaternions = R_WB.as_quat()[:, [3, 0, 1, 2]]
        legs = {side: np.array(self._solvers[side].positions) for side in SIDES}
        ahead = {
            side: legs[side] + _AHEAD * self._rate * np.gradient(legs[side], axis=0)
            for side in SIDES
        }
        q = model.rest_positions()
        for t in range(count):
            for where in (legs, ahead):
                for side in SIDES:
                    q[self._places[side]] = where[side][t]
                found = model.evaluate_distances(self._workspace, q)
                row = self._between[found.d[self._between].argmin()]
                if _ROOM - found.d[row] > lacking[t]:
                    lacking[t] = _ROOM - found.d[row]
                    q[model.root_positions[:4]] = quaternions[t]
                    for side in SIDES:
                        g = found.dd_dq[row, self._columns[side]]
                        effects[side][t] = self._effect(side, q, g)
        return LegRoom(lacking, effects)

    def _effect(self, side: str, q: np.ndarray, g: np.ndarray) -> np.ndarray:
        """(3,) x, y [m/m] and turn about the vertical [m/rad] of the foot, by g (n,) of
        the leg's joints."""
        plant, context = self._model.plant, self._workspace.plant_context
        plant.SetPositions(context, q)
        world = plant.world_frame()
        J = plant.CalcJacobianSpatialVelocity(
            context,
            JacobianWrtVariable.kV,
            self._feet[side],
            np.zeros(3),
            world,
            world,
        )[:, self._moves[side]]
        scale = np.array([_ARM] * 3 + [1.0] * 3)
        J = scale[:, None] * J
        core = J @ J.T + _DAMPING**2 * np.eye(6)
        by_pose = scale * np.linalg.solve(core, J @ g)
        return by_pose[[3, 4, 2]]
