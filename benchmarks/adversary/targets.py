"""Targets as formulas: paths of points and turns of frames, packed for the law."""

from dataclasses import dataclass

import numpy as np

from crar_drake.law.tasks import TaskLayout

# A path is (p, v, a): a quantity (K, ...) over time and two derivatives.
Path = tuple[np.ndarray, np.ndarray, np.ndarray]


def waves(
    time: np.ndarray, amplitude: np.ndarray, frequency: np.ndarray, phase: np.ndarray
) -> Path:
    """Sums of sines: (..., W) amplitudes, frequencies [Hz], phases [rad]; (K, ...)."""
    omega = 2.0 * np.pi * frequency
    angle = omega * time.reshape(-1, *(1,) * amplitude.ndim) + phase
    s, c = amplitude * np.sin(angle), amplitude * np.cos(angle)
    return s.sum(axis=-1), (omega * c).sum(axis=-1), -(omega**2 * s).sum(axis=-1)


def chirp(
    time: np.ndarray, amplitude: np.ndarray, first: float, last: float, phase
) -> Path:
    """Sines whose frequency grows from `first` to `last` [Hz] in the time given."""
    rate = (last - first) / max(float(time[-1]), 1e-9)
    shape = (-1, *(1,) * amplitude.ndim)
    t = time.reshape(shape)
    angle = 2.0 * np.pi * (first * t + 0.5 * rate * t**2) + phase
    omega, slope = 2.0 * np.pi * (first + rate * t), 2.0 * np.pi * rate
    s, c = amplitude * np.sin(angle), amplitude * np.cos(angle)
    return s, omega * c, slope * c - omega**2 * s


def steps(time: np.ndarray, values: np.ndarray, times: np.ndarray) -> Path:
    """Values (S, ...) that hold from the times (S,) on; v and a are 0."""
    at = np.maximum(np.searchsorted(times, time, side="right") - 1, 0)
    p = values[at]
    return p, np.zeros_like(p), np.zeros_like(p)


def approach(time: np.ndarray, start: np.ndarray, end: np.ndarray, span: float) -> Path:
    """From start to end (...) with least jerk in `span` [s], and then there."""
    shape = (-1, *(1,) * start.ndim)
    x = np.clip(time / span, 0.0, 1.0).reshape(shape)
    way = end - start
    return (
        start + way * x**3 * (10.0 - 15.0 * x + 6.0 * x**2),
        way * 30.0 * (x * (1.0 - x)) ** 2 / span,
        way * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / span**2,
    )


def add(first: Path, second: Path) -> Path:
    """The sum of two paths."""
    return tuple(a + b for a, b in zip(first, second, strict=True))


def slowed(path: Path, fastest: float) -> Path:
    """A path (K, N, 3) about 0, made smaller where a point is faster than `fastest`."""
    speed = np.linalg.norm(path[1], axis=2).max(axis=0)
    scale = np.minimum(1.0, fastest / np.maximum(speed, 1e-9))[None, :, None]
    return tuple(scale * part for part in path)


@dataclass(frozen=True)
class Turn:
    """Frames that turn about axes that are fixed in the world.

    Attributes:
        start: (Na, 4) quaternions w x y z of no turn.
        axis: (Na, 3) unit vectors.
        angle: path (K, Na) [rad].
    """

    start: np.ndarray
    axis: np.ndarray
    angle: Path


def pack(layout: TaskLayout, points: Path, turn: Turn) -> np.ndarray:
    """[x_d; v_d; a_d] (K, layout.size) of points (K, Nl, 3) and turns."""
    K = len(points[0]) if len(layout.linear_tasks) else len(turn.angle[0])
    desired = np.zeros((K, layout.size))
    v = desired[:, layout.size_x : layout.size_x + layout.m]
    a = desired[:, layout.size_x + layout.m :]
    desired[:, layout.position_entries.ravel()] = points[0].reshape(K, -1)
    v[:, layout.linear_rows.ravel()] = points[1].reshape(K, -1)
    a[:, layout.linear_rows.ravel()] = points[2].reshape(K, -1)
    angle, rate, growth = turn.angle
    half = 0.5 * angle[:, :, None]
    spin = np.concatenate([np.cos(half), np.sin(half) * turn.axis], axis=2)
    x = _product(spin, np.broadcast_to(turn.start, spin.shape))
    desired[:, layout.quaternion_entries.ravel()] = x.reshape(K, -1)
    v[:, layout.angular_rows.ravel()] = (rate[:, :, None] * turn.axis).reshape(K, -1)
    a[:, layout.angular_rows.ravel()] = (growth[:, :, None] * turn.axis).reshape(K, -1)
    return desired


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternions a b, (..., 4) in the order w x y z."""
    w = a[..., :1] * b[..., :1] - (a[..., 1:] * b[..., 1:]).sum(axis=-1, keepdims=True)
    xyz = (
        a[..., :1] * b[..., 1:]
        + b[..., :1] * a[..., 1:]
        + np.cross(a[..., 1:], b[..., 1:])
    )
    return np.concatenate([w, xyz], axis=-1)
