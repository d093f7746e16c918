"""What the law's tasks are asked in each of its steps from frame to frame."""

from __future__ import annotations

import numpy as np

from crar_drake.equations.kinematics import task_motion
from crar_drake.robot.model import ControlModel

# Targets are found for so many frames at once.
_BLOCK = 8


class FrameTargets:
    """A reference's targets, found when they are asked for.

    Attributes:
        q: (K, n) the reference in the law's steps, on straight lines between frames.
        v: (K, n) velocities, such that the law's prediction leads from each of q to
            the next: v_k = (q_k - q_(k-1)) / h, with a_k = (v_(k+1) - v_k) / h.
    """

    def __init__(
        self,
        model: ControlModel,
        poses: ControlModel | None,
        rest: np.ndarray,
        reference: np.ndarray,
        steps: int,
        period: float,
    ) -> None:
        """
        Args:
            model: of the robot and its tasks, joints before poses.
            poses: with those that are poses alone, without pairs; None if none is.
            rest: (nq,) its rest posture.
            reference: (T, n) positions of the controlled joints.
            steps: of the law in a frame.
            period: h, of a step [s].
        """
        q = reference
        if steps > 1 and len(reference) > 1:
            share = np.arange(steps)[:, None] / steps
            between = reference[:-1, None] + share * np.diff(reference, axis=0)[:, None]
            q = np.vstack([between.reshape(-1, reference.shape[1]), reference[-1:]])
        self.q, self.v = q, np.diff(q, axis=0, prepend=q[:1]) / period
        self._a = np.diff(self.v, axis=0, append=self.v[-1:]) / period
        self._model, self._poses, self._rest = model, poses, rest
        self._size = _BLOCK * steps
        self._block, self._found = -1, np.zeros((0, 0))

    def at(self, first: int, last: int) -> np.ndarray:
        """(last - first, layout.size) of some steps of a frame."""
        block, begin = divmod(first, self._size)
        if block != self._block:
            start = block * self._size
            self._found = self._of(slice(start, start + self._size))
            self._block = block
        return self._found[begin : begin + last - first]

    def _of(self, some: slice) -> np.ndarray:
        """(k, layout.size) [x_d; v_d; a_d]."""
        layout, poses = self._model.layout, self._poses
        joints = layout.rows.joints
        q, v, a = self.q[some], self.v[some], self._a[some]
        R, p = np.zeros((len(q), 0, 3, 3)), np.zeros((len(q), 0, 3))
        v_d, a_d = v[:, joints], a[:, joints]
        if poses is not None:
            R, p, v_poses, a_poses = task_motion(
                configurations(poses, self._rest, q),
                velocities(poses, v),
                velocities(poses, a),
                poses.robot_by_pair,
            )
            v_d, a_d = np.hstack([v_d, v_poses]), np.hstack([a_d, a_poses])
        return layout.pack(R, p, v_d, a_d, q[:, joints])


def configurations(model: ControlModel, rest: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(..., nq) of the plant, the prescribed joints as in `rest`, from (..., n)."""
    whole = np.empty((*q.shape[:-1], len(rest)))
    whole[...] = rest
    whole[..., model.controlled_positions] = q
    return whole


def velocities(model: ControlModel, v: np.ndarray) -> np.ndarray:
    """(..., nv) of the plant, the prescribed joints at rest, from (..., n)."""
    whole = np.zeros((*v.shape[:-1], model.n + model.n_p))
    whole[..., model.controlled] = v
    return whole
