r"""What drivers of robots with a root that floats share: the loop and its coordinates.

Imports NumPy only, as `driver` does. Positions are Drake's: the root's quaternion
(w, x, y, z), its place in the world, the joints in the problem's order; velocities are
the root's turn and speed in the world, and the joints'. A controller answers with
accelerations, which are held for a period:

    x(t) = x + t v + t^2/2 a,    v(t) = v + t a,    R(t) = exp(t w + t^2/2 w') R.

A step without an answer stops the robot: v = 0.

Pinocchio has the place first, the quaternion's w last, and the root's velocity in its
own axes; `to_pinocchio` and `from_pinocchio` turn one into the other.
"""

import json
import time
from pathlib import Path

import numpy as np

from benchmarks.peers.driver import Controller, NoAnswer, Targets

ROOT_POSITIONS, ROOT_VELOCITIES = 7, 6


def matrix(quaternion: np.ndarray) -> np.ndarray:
    """(3, 3) of a unit quaternion (w, x, y, z)."""
    w, u = quaternion[0], quaternion[1:]
    return (w * w - u @ u) * np.eye(3) + 2.0 * (np.outer(u, u) + w * cross(u))


def cross(u: np.ndarray) -> np.ndarray:
    """(3, 3) that multiplies by u from the left in a cross product."""
    return np.array([[0.0, -u[2], u[1]], [u[2], 0.0, -u[0]], [-u[1], u[0], 0.0]])


def turned(quaternion: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """A unit quaternion (4,) after a turn about (3,) in the world [rad]."""
    angle = float(np.linalg.norm(turn))
    u = 0.5 * np.sinc(0.5 * angle / np.pi) * turn
    c, (w, v) = np.cos(0.5 * angle), (quaternion[0], quaternion[1:])
    found = np.concatenate([[c * w - u @ v], c * v + w * u + np.cross(u, v)])
    return found / np.linalg.norm(found)


def after(q: np.ndarray, v: np.ndarray, a: np.ndarray, t: float) -> np.ndarray:
    """Positions (7 + n,) when accelerations (6 + n,) were held for t [s]."""
    step = t * v + 0.5 * t * t * a
    return np.concatenate([turned(q[:4], step[:3]), q[4:] + step[3:]])


def to_pinocchio(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pinocchio's positions and velocities."""
    R = matrix(q[:4])
    return (
        np.concatenate([q[4:7], q[1:4], q[:1], q[7:]]),
        np.concatenate([R.T @ v[3:6], R.T @ v[:3], v[6:]]),
    )


def from_pinocchio(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Accelerations (6 + n,) in the world of Pinocchio's (6 + n,).

    Args:
        q, v: the state, in the order of this module.
        a: of the root in its own axes, which turn: linear, angular; and the joints'.
    """
    R = matrix(q[:4])
    return np.concatenate([R @ a[3:6], R @ a[:3] + np.cross(v[:3], v[3:6]), a[6:]])


class Floating(Controller):
    """A controller of a robot that stands, its root not held.

    Settings of all: inside, how much farther than the margin the soles are made
    smaller [m].

    Attributes:
        problem: as `driver` reads it.
        standing: what `standing.py` wrote besides: root (7,), its rest place;
            friction; efforts (n,) [Nm]; soles, each with its link, frame in the
            middle, corners (4, 3) in the link less the margin [m], length and width of
            a rectangle in them [m].
    """

    commands = "acceleration"

    def __init__(self, problem, period: float, settings: dict) -> None:
        self.problem, self.period = problem, period
        self.standing = json.loads((problem.folder / "standing.json").read_text())
        # A pyramid of four faces inside the cone.
        self.pyramid = self.standing["friction"] / np.sqrt(2.0)
        self.set_up(settings)

    def set_up(self, settings: dict) -> None:
        """Makes what `solve` needs, at rest."""
        raise NotImplementedError

    def rest(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (7 + n,) and velocities (6 + n,) at rest."""
        q = np.concatenate([self.standing["root"], self.problem.rest])
        return q, np.zeros(len(q) - 1)

    def record(
        self, case: Path, period: float, seconds: float | None
    ) -> dict[str, np.ndarray]:
        """Runs a case from rest.

        Returns:
            time (T,), q (T, 7 + n), v and a (T, 6 + n) at the steps' begin; step_time
            (T,) [s]; no_answer (T,).
        """
        data = np.load(case)
        stride = round(period / (data["time"][1] - data["time"][0]))
        data = {key: data[key][::stride] for key in ("time", "p", "v", "a")}
        steps = len(data["time"]) - 1
        if seconds is not None:
            steps = min(steps, round(seconds / period))
        q, v = self.rest()
        self.reset(q)
        Q, V, A = [], [], []
        step_time, no_answer = np.empty(steps), np.zeros(steps, dtype=bool)
        for k in range(steps):
            p, p_d, p_dd = (data[key][k] for key in ("p", "v", "a"))
            targets = Targets(p, p_d, p_dd, (data["p"][k + 1] - p) / period)
            start = time.process_time()
            try:
                a = self.solve(q, v, targets)
            except NoAnswer:
                a = np.full_like(v, np.nan)
            step_time[k] = time.process_time() - start
            if not np.isfinite(a).all():
                # Stands at once: no command, and a state that is still one.
                no_answer[k], v = True, np.zeros_like(v)
                a = np.zeros_like(v)
            Q.append(q)
            V.append(v)
            A.append(a)
            q, v = after(q, v, a, period), v + period * a
        return {
            "time": data["time"][:steps],
            "q": np.array(Q),
            "v": np.array(V),
            "a": np.array(A),
            "step_time": step_time,
            "no_answer": no_answer,
        }
