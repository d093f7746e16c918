"""A whole body's retargeted motion as what tasks and root are asked for, over time."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from crar_drake.equations.tasks import quaternion_from_rotation
from crar_drake.errors import MotionError, ScenarioError
from crar_drake.motion.hand_orientations import HANDS, hand_orientations
from crar_drake.motion.performer import SIDES, Performer
from crar_drake.motion.quaternion_spline import QuaternionSpline
from crar_drake.robot.model import ControlModel
from crar_drake.trajectory.retargeted_motion import RATE, retargeted_motion
from crar_drake.trajectory.retargeting import RetargetingParameters

FEET = tuple(f"{side}_foot" for side in SIDES)
KNEES = tuple(f"{side}_knee" for side in SIDES)
HEAD = "head"


def follows_legs(model: ControlModel) -> bool:
    """Whether a task is a foot, a knee or a joint."""
    return any(
        task.kind == "joint" or task.frame in (*FEET, *KNEES) for task in model.tasks
    )


class WholeBodyMotion:
    """A motion of root and joints, and of the tasks that they carry.

    Joints and the root's position are on cubic splines through the frames, its
    orientation on one through their quaternions: q(t), twice continuously
    differentiable. Tasks follow by forward kinematics,

        x_d = x(q),    v_d = J v,    a_d = J v_dot + J_dot v.

    Who holds accelerations for a period h lags half a period behind those of the
    instant: where a foot lands, by millimetres. With v_dot = (v(t + h) - v(t)) / h
    joints have their own velocities again at the end of each period. And a discrete
    plant moves by the velocity that it has at the *end* of its step, so that velocities
    that are the motion's at the ends take it half a step ahead; it gets those of half a
    step before.

    Attributes:
        duration: until the last frame; then everything stands still [s].
    """

    def __init__(
        self, model: ControlModel, performer: Performer, cutoff: float, hold: float
    ) -> None:
        """
        Args:
            model: the robot; its root floats.
            performer: with legs.
            cutoff: of the low-pass [Hz].
            hold: the period h [s]; 0 for accelerations of the instant.

        Raises:
            MotionError: the performer lacks something.
            ModelError, ScenarioError: the robot does.
        """
        description = model.description
        if description.root == "fixed":
            raise ScenarioError(
                f"robot {description.name}: its root is fixed, so that its feet cannot "
                "follow a motion; say root: prescribed in its robot.yaml, or import it "
                "with --whole-body"
            )
        frames = {task.frame for task in model.tasks}
        if HEAD in frames and HEAD not in performer.positions:
            raise MotionError(
                f"motion {performer.name}: it has no head; leave that out"
            )
        if frames & set(HANDS):
            hand_orientations(performer)  # says why, if there are none
        retargeter, found = retargeted_motion(
            description, performer, RATE, RetargetingParameters(cutoff=cutoff)
        )
        if len(found.q) < 2:
            raise MotionError(
                f"motion {performer.name}: {performer.duration:.3f} s are too short: "
                f"two frames at {RATE:g} Hz are needed"
            )
        time = np.arange(len(found.q)) / RATE
        names = [*model.velocity_names]
        self._joints = [names.index(name) for name in retargeter.model.joint_names]
        self._turning, self._moving = np.split(model.unactuated, 2)
        positions = np.zeros((len(time), len(names)))
        positions[:, self._joints] = found.q
        positions[:, self._moving] = found.root_positions
        self._positions = CubicSpline(time, positions)
        quaternions = Rotation.from_matrix(found.root_rotations).as_quat()
        self._turns = QuaternionSpline(time, quaternions)
        self.duration = float(time[-1])
        self._model, self._workspace = model, model.MakeWorkspace()
        self._q = model.rest_positions()
        self._in_q = [model.position_names.index(names[j]) for j in self._joints]
        self._hold, self._late = hold, 0.5 * model.plant.time_step() * (hold > 0.0)
        self._known = np.nan, None

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """q (nq,), v (nv,) and v_dot (nv,) to be asked for at `time` [s], in the
        plant's order."""
        if time != self._known[0]:
            self._known = time, self._at(time)
        return self._known[1]

    def tasks_at(self, time: float) -> np.ndarray:
        """[x_d; v_d; a_d] (layout.size,) at `time` [s]."""
        model = self._model
        q, v, v_dot = self.at(time)
        state = model.evaluate(self._workspace, q, v)
        a = state.J @ v_dot[model.controlled] + state.J_p @ v_dot[model.prescribed]
        a += state.Jdot_qdot
        q_of_tasks = state.q[model.layout.rows.joints]
        return model.layout.pack(state.R, state.p, state.v, a, q_of_tasks)

    def prescribed_at(self, time: float) -> np.ndarray:
        """`desired_prescribed` (prescribed_size,) at `time` [s]."""
        model = self._model
        q, v, v_dot = self.at(time)
        return np.concatenate(
            [
                q[model.prescribed_positions],
                v[model.prescribed],
                v_dot[model.prescribed],
            ]
        )

    def _at(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        q, at = self._q.copy(), min(time, self.duration)
        positions = self._positions(at)
        q[self._in_q] = positions[self._joints]
        R, _, alpha = self._turns(at)
        root = self._model.root_positions
        q[root[:4]], q[root[4:]] = quaternion_from_rotation(R), positions[self._moving]
        before = max(time - self._late, 0.0)
        v = self._velocities(before)
        if self._hold > 0.0:
            return q, v, (self._velocities(before + self._hold) - v) / self._hold
        v_dot = np.zeros_like(v)
        if time <= self.duration:
            v_dot = self._positions(time, 2)
            v_dot[self._turning] = alpha
        return q, v, v_dot

    def _velocities(self, time: float) -> np.ndarray:
        """(nv,) at `time` [s]; 0 after the end."""
        if time > self.duration:
            return np.zeros(len(self._model.velocity_names))
        v = self._positions(time, 1)
        v[self._turning] = self._turns(time)[1]
        return v
