"""Task variables and their error: Eqs. (4)-(8) and (11)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import compiled
from crar_drake.law.vectors import cross_rows

# The parts of each kind of task, in their order; and their numbers of rows of v, a, e
# and J, and of entries of x_d.
_PARTS = {
    "position": ("linear",),
    "orientation": ("angular",),
    "pose": ("angular", "linear"),
    "joint": ("joint",),
}
_SIZES = {"angular": (3, 4), "linear": (3, 3), "joint": (1, 1)}
KINDS = tuple(_PARTS)

_NO_JOINTS = np.zeros(0)


class TaskRows(NamedTuple):
    """A `TaskLayout` for the equations.

    Na tasks have a rotation, Nl a position, Nj are joints.
    """

    angular_tasks: np.ndarray  # (Na,)
    linear_tasks: np.ndarray  # (Nl,)
    angular_rows: np.ndarray  # (3 Na,) of v, a, e and J
    linear_rows: np.ndarray  # (3 Nl,)
    quaternion_entries: np.ndarray  # (4 Na,) of x_d
    position_entries: np.ndarray  # (3 Nl,)
    joint_rows: np.ndarray  # (Nj,) of v, a, e and J
    joint_entries: np.ndarray  # (Nj,) of x_d
    joints: np.ndarray  # (Nj,) which of the controlled joints each is


class DesiredTasks(NamedTuple):
    """The targets of one instant, in the order of a TaskLayout."""

    R: np.ndarray  # (Na, 3, 3) desired orientations R_WTd, of the tasks that have one
    p: np.ndarray  # (Nl, 3) desired positions p_WTd [m], of the tasks that have one
    v: np.ndarray  # (m,) desired velocities, Eq. (4) [rad/s, m/s].
    a: np.ndarray  # (m,) desired accelerations [rad/s^2, m/s^2]
    q: np.ndarray = _NO_JOINTS  # (Nj,) desired positions of joints [rad or m]


@dataclass(frozen=True)
class TaskLayout:
    """Eqs. (4), (7), (8): where each task stands in the stacked vectors.

    The rows of v, a, e and J follow the tasks in order. A pose has six rows,
    [omega; p_dot] as in Eq. (4), a position or an orientation three, a joint one.

    The vector of desired tasks is [x_d; v_d; a_d] (the layout that Drake's
    TrajectorySource with two derivatives emits for position tasks):

    * x_d: per task a position (x, y, z) [m], an orientation as a unit quaternion
      (w, x, y, z), for a pose the quaternion and then the position, or the position
      of a joint [rad or m];
    * v_d (m,): per task as in Eq. (4) [rad/s, m/s];
    * a_d (m,): its derivative [rad/s^2, m/s^2].

    All but joints are expressed in the world frame W. With position tasks of two
    wrists, say, x_d is [x, y, z of the left; x, y, z of the right], and the vector has
    18 entries.
    `pack` builds it and `unpack` takes it apart.

    Attributes:
        names: the tasks' names.
        kinds: per task "position", "orientation", "pose" or "joint".
        joints: (Nj,) of the tasks that are joints, which of the controlled joints;
            without a model, as when a log is read, it may be left out.
        m: number of rows of v, a, e and J.
        size_x: number of entries of x_d.
        of_rows: (m,) the task that each row belongs to.
        angular_tasks, linear_tasks, joint_tasks: (Na,), (Nl,), (Nj,) tasks with a
            rotation, with a position, and those that are joints.
        angular_rows, linear_rows: (Na, 3), (Nl, 3) their rows.
        quaternion_entries, position_entries: (Na, 4), (Nl, 3) their entries of x_d.
        joint_rows, joint_entries: (Nj,) of the tasks that are joints.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    joints: tuple[int, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        tasks, rows, entries = ({part: [] for part in _SIZES} for _ in range(3))
        of_rows: list[int] = []
        row = entry = 0
        for index, kind in enumerate(self.kinds):
            if kind not in KINDS:
                raise ValueError(f"kind of task {self.names[index]}: {kind!r}")
            for part in _PARTS[kind]:
                row_size, entry_size = _SIZES[part]
                tasks[part].append(index)
                rows[part].append(range(row, row + row_size))
                entries[part].append(range(entry, entry + entry_size))
                row, entry = row + row_size, entry + entry_size
                of_rows += [index] * row_size
        derived = {
            "m": row,
            "size_x": entry,
            "of_rows": _places(of_rows),
            "angular_tasks": _places(tasks["angular"]),
            "linear_tasks": _places(tasks["linear"]),
            "joint_tasks": _places(tasks["joint"]),
            "angular_rows": _places(rows["angular"], 3),
            "linear_rows": _places(rows["linear"], 3),
            "joint_rows": _places(rows["joint"]),
            "quaternion_entries": _places(entries["angular"], 4),
            "position_entries": _places(entries["linear"], 3),
            "joint_entries": _places(entries["joint"]),
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    @property
    def size(self) -> int:
        """Number of entries of [x_d; v_d; a_d]."""
        return self.size_x + 2 * self.m

    def rows_of(self, task: int) -> slice:
        """Returns the rows of task number `task` in v, a, e and J."""
        sizes = [sum(_SIZES[part][0] for part in _PARTS[k]) for k in self.kinds]
        start = sum(sizes[:task])
        return slice(start, start + sizes[task])

    @cached_property
    def rows(self) -> TaskRows:
        """The same indices for the equations."""
        *names, _ = TaskRows._fields
        joints = np.array(self.joints, dtype=int)
        return TaskRows(*(getattr(self, name).ravel() for name in names), joints)

    def unpack(self, desired: np.ndarray) -> DesiredTasks:
        """Splits [x_d; v_d; a_d] (size,) into its parts."""
        return unpack_tasks(np.ascontiguousarray(desired, dtype=float), self.rows)

    def pack(
        self,
        R: np.ndarray,
        p: np.ndarray,
        v: np.ndarray | None = None,
        a: np.ndarray | None = None,
        q: np.ndarray | None = None,
    ) -> np.ndarray:
        """Builds [x_d; v_d; a_d] (..., size) from rotations (..., Na, 3, 3), positions
        (..., Nl, 3), velocities (..., m), accelerations (..., m) and positions of the
        joints (..., Nj); those left out are 0."""
        R = np.asarray(R)
        desired = np.zeros((*R.shape[:-3], self.size))
        if q is not None:
            desired[..., self.joint_entries] = q
        desired[..., self.quaternion_entries] = quaternion_from_rotation(R)
        desired[..., self.position_entries] = p
        if v is not None:
            desired[..., self.size_x : self.size_x + self.m] = v
        if a is not None:
            desired[..., self.size_x + self.m :] = a
        return desired


def _places(of: Sequence, *shape: int) -> np.ndarray:
    return np.array(of, dtype=int).reshape(-1, *shape)


@compiled
def unpack_tasks(desired: np.ndarray, rows: TaskRows) -> DesiredTasks:
    """Splits [x_d; v_d; a_d] (size,) into its parts; see `TaskLayout`.

    A quaternion of zero length gives NaN.
    """
    m = num_rows(rows)
    size_x = len(desired) - 2 * m
    return DesiredTasks(
        rotation_from_quaternion(desired[rows.quaternion_entries].reshape(-1, 4)),
        desired[rows.position_entries].reshape(-1, 3),
        desired[size_x : size_x + m],
        desired[size_x + m :],
        desired[rows.joint_entries],
    )


@compiled
def num_rows(rows: TaskRows) -> int:
    """m of a layout."""
    return len(rows.angular_rows) + len(rows.linear_rows) + len(rows.joint_rows)


@compiled
def orientation_error(R: np.ndarray, R_d: np.ndarray) -> np.ndarray:
    """Eq. (11), upper part: 1/2 (n x n_d + s x s_d + c x c_d), (Na, 3) in W.

    Equals sin(theta) times the axis of the rotation from R to R_d, so it vanishes
    at 180 degrees too: from exactly there it gives no direction.

    Args:
        R: (Na, 3, 3) present orientations R_WT, columns n, s, c.
        R_d: (Na, 3, 3) desired orientations R_WTd.
    """
    n, s, c = R[:, :, 0], R[:, :, 1], R[:, :, 2]
    n_d, s_d, c_d = R_d[:, :, 0], R_d[:, :, 1], R_d[:, :, 2]
    return 0.5 * (cross_rows(n, n_d) + cross_rows(s, s_d) + cross_rows(c, c_d))


@compiled
def stack_rows(
    angular: np.ndarray, linear: np.ndarray, joints: np.ndarray, rows: TaskRows
) -> np.ndarray:
    """(m,) in the order of the tasks, orientation above position, from (Na, 3), (Nl, 3)
    and (Nj,)."""
    stacked = np.empty(num_rows(rows))
    stacked[rows.angular_rows] = angular.ravel()
    stacked[rows.linear_rows] = linear.ravel()
    stacked[rows.joint_rows] = joints
    return stacked


def task_weights(
    layout: TaskLayout,
    position_weights: Sequence[float],
    orientation_weights: Sequence[float],
) -> np.ndarray:
    """Row weights S (m,) of the tasks: J, v, a of Eqs. (5), (6) become S J, S v, S a.

    With them the damped least squares of Eq. (34) weighs metres against radians.

    Args:
        position_weights: per task, for its position rows [1], of a joint [m/rad].
        orientation_weights: per task, for its orientation rows [m/rad].
    """
    S = np.ones(layout.m)
    S[layout.angular_rows] = np.asarray(orientation_weights)[layout.angular_tasks, None]
    S[layout.linear_rows] = np.asarray(position_weights)[layout.linear_tasks, None]
    S[layout.joint_rows] = np.asarray(position_weights)[layout.joint_tasks]
    return S


@compiled
def rotation_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices (N, 3, 3) of quaternions (N, 4) in the order w x y z.

    The quaternion is normalised; a zero one gives NaN, which the caller refuses.
    """
    R = np.empty((len(quaternion), 3, 3))
    for i in range(len(quaternion)):
        length = np.sqrt((quaternion[i] ** 2).sum())
        scale = 1.0 / length if length > 0.0 else np.nan
        w, x = scale * quaternion[i, 0], scale * quaternion[i, 1]
        y, z = scale * quaternion[i, 2], scale * quaternion[i, 3]
        R[i, 0, 0] = 1 - 2 * (y * y + z * z)
        R[i, 0, 1] = 2 * (x * y - w * z)
        R[i, 0, 2] = 2 * (x * z + w * y)
        R[i, 1, 0] = 2 * (x * y + w * z)
        R[i, 1, 1] = 1 - 2 * (x * x + z * z)
        R[i, 1, 2] = 2 * (y * z - w * x)
        R[i, 2, 0] = 2 * (x * z - w * y)
        R[i, 2, 1] = 2 * (y * z + w * x)
        R[i, 2, 2] = 1 - 2 * (x * x + y * y)
    return R


def quaternion_from_rotation(R: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4), order w x y z, w >= 0, of rotations (..., 3, 3)."""
    if not R.size:
        return np.empty(R.shape[:-2] + (4,))
    # The eigenvector of the largest eigenvalue of this symmetric matrix is the
    # quaternion; unlike the trace formula it has no bad case.
    K = np.empty(R.shape[:-2] + (4, 4))
    K[..., 0, 0] = np.trace(R, axis1=-2, axis2=-1)
    K[..., 0, 1] = K[..., 1, 0] = R[..., 2, 1] - R[..., 1, 2]
    K[..., 0, 2] = K[..., 2, 0] = R[..., 0, 2] - R[..., 2, 0]
    K[..., 0, 3] = K[..., 3, 0] = R[..., 1, 0] - R[..., 0, 1]
    K[..., 1:, 1:] = R + np.swapaxes(R, -1, -2)
    K[..., [1, 2, 3], [1, 2, 3]] -= np.trace(R, axis1=-2, axis2=-1)[..., None]
    _, vectors = np.linalg.eigh(K)
    quaternion = vectors[..., -1]
    return np.where(quaternion[..., :1] < 0, -quaternion, quaternion)
