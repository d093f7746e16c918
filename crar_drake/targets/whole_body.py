"""A whole body's retargeted motion as what tasks and root are asked for, over time."""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from crar_drake.equations.tasks import quaternion_from_rotation
from crar_drake.errors import MotionError, ScenarioError
from crar_drake.motion.hand_orientations import HANDS, hand_orientations
from crar_drake.motion.performer import SIDES, Performer
from crar_drake.motion.quaternion_spline import QuaternionSpline
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import joint_tasks
from crar_drake.trajectory.retargeted_motion import RATE, retargeted_motion
from crar_drake.trajectory.retargeting import RetargetingParameters

FEET = tuple(f"{side}_foot" for side in SIDES)
KNEES = tuple(f"{side}_knee" for side in SIDES)
HEAD = "head"

# A joint counts so much beside points: it settles what they leave open [m/rad].
_JOINT_WEIGHT = 0.1


def follows_legs(model: ControlModel) -> bool:
    """Whether a task is a foot or a knee."""
    return any(task.frame in (*FEET, *KNEES) for task in model.tasks)


def with_joints(model: ControlModel, distances: str) -> ControlModel:
    """The model with all its joints among the tasks.

    Points leave open which of two ways an arm goes on from a singular pose: elbows come
    out bent backwards, and shoulders at their limits.

    Args:
        distances: as of `ControlModel`.
    """
    known = [task.joint for task in model.tasks]
    joints = [x for x in model.joint_names[: model.num_joints] if x not in known]
    return ControlModel(
        model.diagram,
        model.plant,
        model.scene_graph,
        model.description,
        [*model.tasks, *joint_tasks(joints, _JOINT_WEIGHT)],
        distances=distances,
    )


class WholeBodyMotion:
    """A motion of root and joints, and of the tasks that they carry.

    Joints and the root's position are on cubic splines through the frames, its
    orientation on one through their quaternions: q(t), twice continuously
    differentiable. Tasks follow by forward kinematics,

        x_d = x(q),    v_d = J v,    a_d = J v_dot + J_dot v.

    Attributes:
        duration: until the last frame; then everything stands still [s].
    """

    def __init__(
        self, model: ControlModel, performer: Performer, cutoff: float
    ) -> None:
        """
        Args:
            model: the robot; its root floats.
            performer: with legs.
            cutoff: of the low-pass [Hz].

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
        self._known = np.nan, None

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """q (nq,), v (nv,) and v_dot (nv,) at `time` [s], in the plant's order."""
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
        R, omega, alpha = self._turns(at)
        root = self._model.root_positions
        q[root[:4]], q[root[4:]] = quaternion_from_rotation(R), positions[self._moving]
        if time > self.duration:
            return q, np.zeros(len(positions)), np.zeros(len(positions))
        v, v_dot = self._positions(at, 1), self._positions(at, 2)
        v[self._turning], v_dot[self._turning] = omega, alpha
        return q, v, v_dot
