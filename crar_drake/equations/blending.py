"""The way from the measured pose onto the targets, with exact derivatives.

A robot that stands elsewhere than its first target would jump. For a stated time
the targets are therefore blended: at s = 0 they are the measured pose at rest, at
s = 1 the targets themselves, and position, velocity and acceleration belong
together all the way.
"""

from __future__ import annotations

import numpy as np

from crar_drake.equations.tasks import DesiredTasks, TaskLayout


def smooth_step(time: float, duration: float) -> tuple[float, float, float]:
    """Quintic s(t) from 0 to 1 with zero slope and curvature at both ends.

    Args:
        time: since the start [s].
        duration: of the blend [s]; 0 for none.

    Returns:
        s [1], its first [1/s] and its second derivative [1/s^2].
    """
    if time >= duration:
        return 1.0, 0.0, 0.0
    x = max(time, 0.0) / duration
    return (
        x**3 * (10.0 + x * (6.0 * x - 15.0)),
        30.0 * x**2 * (1.0 - x) ** 2 / duration,
        60.0 * x * (1.0 + x * (2.0 * x - 3.0)) / duration**2,
    )


def blend_vectors(
    start: np.ndarray,
    x: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    step: tuple[float, float, float],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """start + s (x - start) and its derivatives, for moving x and s.

    Args:
        start: measured value at the start.
        x, v, a: target, its velocity and its acceleration, shaped like `start`.
        step: (s, s_dot, s_ddot) of `smooth_step`.
    """
    s, s_dot, s_ddot = step
    gap = x - start
    return (
        start + s * gap,
        s_dot * gap + s * v,
        s_ddot * gap + 2.0 * s_dot * v + s * a,
    )


def blend_rotations(
    R_start: np.ndarray,
    R_d: np.ndarray,
    omega: np.ndarray,
    omega_dot: np.ndarray,
    step: tuple[float, float, float],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """R_start exp(s phi), with phi the rotation vector from R_start to R_d.

    Args:
        R_start: (3, 3) measured orientation at the start.
        R_d: (3, 3) target; omega, omega_dot (3,) its angular velocity [rad/s] and
            acceleration [rad/s^2], all in W.
        step: (s, s_dot, s_ddot) of `smooth_step`.

    Returns:
        Orientation (3, 3), angular velocity (3,) and acceleration (3,), in W. The
        way is not unique where the target is 180 degrees from the start.
    """
    s, s_dot, s_ddot = step
    phi = rotation_vector(R_start.T @ R_d)
    phi_dot = _inverse_left_jacobian(phi, R_start.T @ omega)
    phi_ddot = _inverse_left_jacobian(
        phi,
        R_start.T @ omega_dot - _left_jacobian_dot(phi, phi_dot, phi_dot),
    )
    psi = s * phi
    psi_dot = s_dot * phi + s * phi_dot
    psi_ddot = s_ddot * phi + 2.0 * s_dot * phi_dot + s * phi_ddot
    return (
        R_start @ rotation_from_vector(psi),
        R_start @ _left_jacobian(psi, psi_dot),
        R_start
        @ (_left_jacobian(psi, psi_ddot) + _left_jacobian_dot(psi, psi_dot, psi_dot)),
    )


def blend_tasks(
    layout: TaskLayout,
    R_start: np.ndarray,
    p_start: np.ndarray,
    target: DesiredTasks,
    step: tuple[float, float, float],
) -> DesiredTasks:
    """Blends every task of `layout` from (R_start, p_start) to `target`.

    Args:
        layout: which rows belong to which task.
        R_start: (Na, 3, 3) measured orientations at the start.
        p_start: (Nl, 3) measured positions at the start [m].
        target: the targets of this instant.
        step: (s, s_dot, s_ddot) of `smooth_step`.
    """
    v, a = np.empty(layout.m), np.empty(layout.m)
    R = np.empty_like(target.R)
    for i, rows in enumerate(layout.angular_rows):
        R[i], v[rows], a[rows] = blend_rotations(
            R_start[i], target.R[i], target.v[rows], target.a[rows], step
        )
    rows = layout.linear_rows
    p, v[rows], a[rows] = blend_vectors(
        p_start, target.p, target.v[rows], target.a[rows], step
    )
    return DesiredTasks(R=R, p=p, v=v, a=a)


def rotation_vector(R: np.ndarray) -> np.ndarray:
    """Rotation vector (3,) [rad] of R (3, 3), of a length up to pi."""
    skew = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = np.linalg.norm(skew)
    cosine = 0.5 * (np.trace(R) - 1.0)
    angle = np.arctan2(sine, cosine)
    if sine > 1e-6:
        return skew * (angle / sine)
    if cosine > 0.0:
        return skew
    # Near 180 degrees the skew part vanishes; the axis is in the symmetric part.
    symmetric = 0.5 * (R + R.T) + np.eye(3)
    axis = symmetric[:, np.argmax(np.diag(symmetric))]
    axis = axis / np.linalg.norm(axis)
    return angle * (axis if axis @ skew >= 0.0 else -axis)


def rotation_from_vector(phi: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of a rotation vector (3,) [rad] (Rodrigues)."""
    a, b, _, _ = _coefficients(phi)
    theta2 = phi @ phi
    S = np.array(
        [[0.0, -phi[2], phi[1]], [phi[2], 0.0, -phi[0]], [-phi[1], phi[0], 0.0]]
    )
    return np.eye(3) + (1.0 - b * theta2) * S + a * S @ S


def _coefficients(phi: np.ndarray) -> tuple[float, float, float, float]:
    """a = (1-cos)/t^2, b = (t-sin)/t^3 and their derivatives by t, over t."""
    theta2 = float(phi @ phi)
    if theta2 < 1e-4:
        return (
            0.5 - theta2 / 24.0 + theta2**2 / 720.0,
            1.0 / 6.0 - theta2 / 120.0 + theta2**2 / 5040.0,
            -1.0 / 12.0 + theta2 / 180.0,
            -1.0 / 60.0 + theta2 / 1260.0,
        )
    theta = np.sqrt(theta2)
    sine, cosine = np.sin(theta), np.cos(theta)
    return (
        (1.0 - cosine) / theta2,
        (theta - sine) / (theta * theta2),
        (theta * sine - 2.0 * (1.0 - cosine)) / theta2**2,
        (theta * (1.0 - cosine) - 3.0 * (theta - sine)) / (theta * theta2**2),
    )


def _left_jacobian(phi: np.ndarray, x: np.ndarray) -> np.ndarray:
    """J_l(phi) x: the angular velocity of exp(phi) when phi changes by x."""
    a, b, _, _ = _coefficients(phi)
    cross = np.cross(phi, x)
    return x + a * cross + b * np.cross(phi, cross)


def _inverse_left_jacobian(phi: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Solves J_l(phi) x = y; J_l is regular for |phi| < 2 pi."""
    J = np.stack([_left_jacobian(phi, unit) for unit in np.eye(3)], axis=1)
    return np.linalg.solve(J, y)


def _left_jacobian_dot(
    phi: np.ndarray, phi_dot: np.ndarray, x: np.ndarray
) -> np.ndarray:
    """(d/dt J_l(phi)) x while phi changes by phi_dot."""
    a, b, a_slope, b_slope = _coefficients(phi)
    rate = phi @ phi_dot
    cross = np.cross(phi, x)
    return (
        a_slope * rate * cross
        + a * np.cross(phi_dot, x)
        + b_slope * rate * np.cross(phi, cross)
        + b * (np.cross(phi_dot, cross) + np.cross(phi, np.cross(phi_dot, x)))
    )
