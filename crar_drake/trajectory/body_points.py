"""Points that a robot's links carry, in the world, and how they move with root and
joints.

Unknowns y of a frame are the root's displacement from where it is given, a turn of it
and the joints: p_WR = p_0 + y_0:3, R_WR = exp(y_3:6) R_0, q = y_6:. A turn is a
rotation vector in the world's axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.law.compilation import Held, compiled
from crar_drake.law.kinematics import joint_motion, link_poses, place_points
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.trajectory.distance_rows import configurations

ROOT = 6  # unknowns of it
_SMALL = 1e-4  # [rad] below which a turn's Jacobian is taken from its series


def model_of_links(description: RobotDescription, links: Sequence[str]) -> ControlModel:
    """A robot with its root fixed, the tasks of which are where its links are."""
    # A link may be called like a task frame, which is elsewhere.
    bare = replace(description, root="fixed", pairs=[], task_frames={})
    tasks = [Task(frame=link, kind="pose") for link in links]
    return ControlModel.FromDescription(bare, tasks)


def turn_jacobian(turn: np.ndarray) -> np.ndarray:
    """(K, 3, 3) J with omega = J d(turn): of the rotation exp(turn), in the world's
    axes (K. M. Lynch and F. C. Park, "Modern Robotics", Eq. 8.37 gives its use).

    Args:
        turn: (K, 3) rotation vectors [rad].
    """
    angle = np.linalg.norm(turn, axis=1)[:, None, None]
    safe = np.where(angle > _SMALL, angle, 1.0)
    a = np.where(angle > _SMALL, (1.0 - np.cos(safe)) / safe**2, 0.5)
    b = np.where(angle > _SMALL, (safe - np.sin(safe)) / safe**3, 1.0 / 6.0)
    # Of the cross products turn x.
    of = np.ascontiguousarray(np.cross(turn[:, None], np.eye(3)).swapaxes(1, 2))
    return np.eye(3) + a * of + b * of @ of


@compiled
def place_links(
    q: np.ndarray, root: np.ndarray, p_root: np.ndarray, robot: Held
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where links are with the root turned, and how joints move what they carry.

    Args:
        q: (K, nq) positions in the plant's order.
        root: (K, 3, 3) from the model's world to where the root is turned.
        p_root: (3,) where the model's root is [m].
        robot: holds a `Robot` whose L tasks are poses of links.

    Returns:
        R (K, L, 3, 3), and p (K, L, 3) from the root [m]; and S (K, 6, nv), as of
        `joint_motion`, about the root.
    """
    r = robot.value
    tree, L, nv = r.tree.value, len(r.tasks.value.carries), len(r.order)
    K, first = len(q), 3 * nv
    R, p, S = np.empty((K, L, 3, 3)), np.empty((K, L, 3)), np.empty((K, 6, nv))
    for k in range(K):
        X = link_poses(q[k : k + 1], tree, tree.every)
        points = place_points(X, r.selection, r.first)[0]
        turned = np.empty((len(points), 3))
        for i in range(len(points)):
            # Joints' axes, slides and tasks' axes are directions, the others points.
            place = i < nv or first <= i < first + L
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            if place:
                x, y, z = x - p_root[0], y - p_root[1], z - p_root[2]
            for c in range(3):
                turned[i, c] = root[k, c, 0] * x + root[k, c, 1] * y + root[k, c, 2] * z
        S[k] = joint_motion(turned[:first].copy().reshape(1, first, 3))[0]
        for i in range(L):
            for c in range(3):
                p[k, i, c] = turned[first + i, c]
                for b in range(3):
                    R[k, i, c, b] = turned[first + L + 3 * i + b, c]
    return R, p, S


@compiled
def move_points(
    frames: np.ndarray,
    links: np.ndarray,
    offsets: np.ndarray,
    R: np.ndarray,
    p: np.ndarray,
    S: np.ndarray,
    turning: np.ndarray,
    carries: np.ndarray,
    n: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Points of links from the root, (N, 3) [m], and their Jacobians (N, 3, 6 + n).

    Args:
        frames: (N,) at which of K frames each is asked.
        links: (N,) which link each is on.
        offsets: (N, 3) where on it [m].
        R, p, S: of `place_links`.
        turning: (K, 3, 3) `turn_jacobian`.
        carries: (L, nv) 1 where a joint moves a link.
        n: number of joints that are controlled, which come first.
    """
    arms, J = np.empty((len(links), 3)), np.zeros((len(links), 3, 6 + n))
    for i in range(len(links)):
        k, link = frames[i], links[i]
        for c in range(3):
            arms[i, c] = p[k, link, c]
            for b in range(3):
                arms[i, c] += R[k, link, c, b] * offsets[i, b]
            J[i, c, c] = 1.0
        x, y, z = arms[i]
        for j in range(3):
            a, b, c = turning[k, 0, j], turning[k, 1, j], turning[k, 2, j]
            J[i, 0, 3 + j] = b * z - c * y
            J[i, 1, 3 + j] = c * x - a * z
            J[i, 2, 3 + j] = a * y - b * x
        for j in range(n):
            if carries[link, j] != 0.0:
                a, b, c = S[k, 0, j], S[k, 1, j], S[k, 2, j]
                J[i, 0, 6 + j] = b * z - c * y + S[k, 3, j]
                J[i, 1, 6 + j] = c * x - a * z + S[k, 4, j]
                J[i, 2, 6 + j] = a * y - b * x + S[k, 5, j]
    return arms, J


@compiled
def lowest_points(
    frames: np.ndarray,
    links: np.ndarray,
    points: np.ndarray,
    radii: np.ndarray,
    first: np.ndarray,
    R: np.ndarray,
    z: np.ndarray,
    below: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The lowest points of links, where they are below a height: which of the frames
    (R,), which of the links that are given (R,), the point's height (R,) [m] and where
    it is on the link (R, 3).

    Args:
        frames: (S,) which of K.
        links: (I,) which of L.
        points, radii: (N, 3), (N,) balls on them, in their frames [m].
        first: (I + 1,) where those of each begin.
        R, z: R_WL (K, L, 3, 3) and heights (K, L) of the links' origins [m].
        below: see above [m].
    """
    reach = np.zeros(len(links))
    for i in range(len(links)):
        for j in range(first[i], first[i + 1]):
            a, b, c = points[j, 0], points[j, 1], points[j, 2]
            reach[i] = max(reach[i], np.sqrt(a * a + b * b + c * c) + radii[j])
    some = np.empty(len(frames) * len(links), np.int64)
    number, lowest, d = np.empty_like(some), np.empty_like(some), np.empty(len(some))
    used = 0
    for s in range(len(frames)):
        k = frames[s]
        for i in range(len(links)):
            link = links[i]
            if z[k, link] >= below + reach[i]:
                continue
            x, y, up = R[k, link, 2, 0], R[k, link, 2, 1], R[k, link, 2, 2]
            least, at = np.inf, 0
            for j in range(first[i], first[i + 1]):
                height = x * points[j, 0] + y * points[j, 1] + up * points[j, 2]
                height -= radii[j]
                if height < least:
                    least, at = height, j
            if least + z[k, link] < below:
                some[used], number[used], lowest[used] = s, i, at
                d[used] = least + z[k, link]
                used += 1
    return some[:used], number[:used], d[:used], points[lowest[:used]]


class Placed:
    """The links of a robot at K frames, and what their points do there."""

    def __init__(
        self,
        model: ControlModel,
        rest: np.ndarray,
        base: tuple[np.ndarray, np.ndarray],
        p_0: np.ndarray,
        R_0: np.ndarray,
        y: np.ndarray,
    ) -> None:
        """
        Args:
            model: of the robot, its root fixed; its L tasks are the poses of links.
            rest: (nq,) its rest posture.
            base: (3,), (3, 3) where its root is fixed.
            p_0, R_0: (K, 3) [m], (K, 3, 3) where the root is given.
            y: (K, 6 + n) the unknowns.
        """
        self._robot, self._n = model.robot, y.shape[1] - ROOT
        turn = Rotation.from_rotvec(y[:, 3:ROOT]).as_matrix()
        self.root_rotations, self.root_positions = turn @ R_0, p_0 + y[:, :3]
        self.R, self.from_root, self._S = place_links(
            configurations(model, rest, y[:, ROOT:]),
            self.root_rotations @ base[1].T,
            base[0],
            self._robot,
        )  # (K, L, 3, 3), (K, L, 3)
        self.turning = turn_jacobian(y[:, 3:ROOT])  # (K, 3, 3)

    def _moved(
        self, frames: np.ndarray, links: np.ndarray, offsets: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `move_points`."""
        links = np.ascontiguousarray(links, dtype=int)
        offsets = np.ascontiguousarray(offsets, dtype=float)
        carries = self._robot.value.tasks.value.carries
        placed = self.R, self.from_root, self._S, self.turning
        return move_points(frames, links, offsets, *placed, carries, self._n)

    def points(
        self, links: Sequence[int], offsets: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points of links: p_WP (K, P, 3) [m], and their Jacobians (K, P, 3, 6 + n).

        Args:
            links: (P,) which of the tasks each is on.
            offsets: (P, 3) p_LP in its frame [m].
        """
        K, P = len(self.R), len(links)
        arms, J = self._moved(
            np.repeat(np.arange(K), P), np.tile(links, K), np.tile(offsets, (K, 1))
        )
        points = self.root_positions[:, None] + arms.reshape(K, P, 3)
        return points, J.reshape(K, P, 3, -1)

    def heights(
        self, frames: np.ndarray, links: np.ndarray, offsets: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Of single points at single frames: z (N,) [m], and gradients (N, 6 + n).

        Args:
            frames, links: (N,) which of the K frames, and which of the tasks.
            offsets: (N, 3) p_LP in its frame [m].
        """
        arms, J = self._moved(frames, links, offsets)
        return self.root_positions[frames, 2] + arms[:, 2], J[:, 2]

    def turns(self, links: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Of links: R_WL (K, P, 3, 3), and angular Jacobians (K, P, 3, 6 + n)."""
        links = np.asarray(links, dtype=int)
        K, P, n = len(self.R), len(links), self._n
        J = np.zeros((K, P, 3, ROOT + n))
        J[..., 3:ROOT] = self.turning[:, None]
        carried = self._robot.value.tasks.value.carries[links, None, :n]  # (P, 1, n)
        J[..., ROOT:] = self._S[:, None, :3, :n] * carried
        return self.R[:, links], J
