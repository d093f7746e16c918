"""The way from the measured pose onto the targets, with exact derivatives.

A robot that stands elsewhere than its first target would jump. For a stated time
the targets are therefore blended: at s = 0 they are the measured pose at rest, at
s = 1 the targets themselves, and position, velocity and acceleration belong
together all the way.
"""

import numpy as np

from crar_drake.law.compilation import compiled
from crar_drake.law.tasks import (
    DesiredTasks,
    TaskRows,
    rotation_from_quaternion,
    stack_rows,
)
from crar_drake.law.vectors import cross, dot, product, times, transposed_times


@compiled
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


@compiled
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


@compiled
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
    phi = rotation_vector(product(R_start.T, R_d))
    phi_dot = _inverse_left_jacobian(phi, transposed_times(R_start, omega))
    phi_ddot = _inverse_left_jacobian(
        phi,
        transposed_times(R_start, omega_dot)
        - _left_jacobian_dot(phi, phi_dot, phi_dot),
    )
    psi = s * phi
    psi_dot = s_dot * phi + s * phi_dot
    psi_ddot = s_ddot * phi + 2.0 * s_dot * phi_dot + s * phi_ddot
    return (
        product(R_start, rotation_from_vector(psi)),
        times(R_start, _left_jacobian(psi, psi_dot)),
        times(
            R_start,
            _left_jacobian(psi, psi_ddot) + _left_jacobian_dot(psi, psi_dot, psi_dot),
        ),
    )


@compiled
def blend_tasks(
    rows: TaskRows,
    start: np.ndarray,
    target: DesiredTasks,
    step: tuple[float, float, float],
) -> DesiredTasks:
    """Blends every task from `start` to `target`.

    Args:
        start: what was measured at the start, beginning with x_d of `TaskLayout`.
        target: the targets of this instant.
        step: (s, s_dot, s_ddot) of `smooth_step`.
    """
    Na, quaternions = len(target.R), start[rows.quaternion_entries].reshape(-1, 4)
    R_start = rotation_from_quaternion(quaternions)
    R, omega, omega_dot = np.empty((Na, 3, 3)), np.empty((Na, 3)), np.empty((Na, 3))
    for i in range(Na):
        at = rows.angular_rows[3 * i : 3 * i + 3]
        R[i], omega[i], omega_dot[i] = blend_rotations(
            R_start[i], target.R[i], target.v[at], target.a[at], step
        )
    at = rows.linear_rows
    p, v, a = blend_vectors(
        *(start[rows.position_entries], target.p.ravel()),
        *(target.v[at], target.a[at], step),
    )
    at, here = rows.joint_rows, start[rows.joint_entries]
    q, qdot, qddot = blend_vectors(here, target.q, target.v[at], target.a[at], step)
    return DesiredTasks(
        R,
        p.reshape(-1, 3),
        stack_rows(omega, v, qdot, rows),
        stack_rows(omega_dot, a, qddot, rows),
        q,
    )


@compiled
def rotation_vector(R: np.ndarray) -> np.ndarray:
    """Rotation vector (3,) [rad] of R (3, 3), of a length up to pi."""
    skew = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = np.sqrt(dot(skew, skew))
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    if sine > 1e-6:
        return skew * (angle / sine)
    if cosine > 0.0:
        return skew
    # Near 180 degrees the skew part vanishes; the axis is in the symmetric part.
    k = 0
    for i in range(1, 3):
        if R[i, i] > R[k, k]:
            k = i
    axis = 0.5 * (R[:, k] + R[k])
    axis[k] += 1.0
    axis /= np.sqrt(dot(axis, axis))
    return angle * (axis if dot(axis, skew) >= 0.0 else -axis)


@compiled
def rotation_from_vector(phi: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of a rotation vector (3,) [rad] (Rodrigues)."""
    a, b, _, _ = _coefficients(phi)
    theta2 = dot(phi, phi)
    S = np.array(
        [[0.0, -phi[2], phi[1]], [phi[2], 0.0, -phi[0]], [-phi[1], phi[0], 0.0]]
    )
    return np.eye(3) + (1.0 - b * theta2) * S + a * product(S, S)


@compiled
def _coefficients(phi: np.ndarray) -> tuple[float, float, float, float]:
    """a = (1-cos)/t^2, b = (t-sin)/t^3 and their derivatives by t, over t."""
    theta2 = dot(phi, phi)
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


@compiled
def _left_jacobian(phi: np.ndarray, x: np.ndarray) -> np.ndarray:
    """J_l(phi) x: the angular velocity of exp(phi) when phi changes by x."""
    a, b, _, _ = _coefficients(phi)
    once = cross(phi, x)
    return x + a * once + b * cross(phi, once)


@compiled
def _inverse_left_jacobian(phi: np.ndarray, y: np.ndarray) -> np.ndarray:
    """x of J_l(phi) x = y; J_l is regular for |phi| < 2 pi."""
    theta2 = dot(phi, phi)
    if theta2 < 1e-4:
        c = 1.0 / 12.0 + theta2 / 720.0 + theta2**2 / 30240.0
    else:
        theta = np.sqrt(theta2)
        c = (1.0 - 0.5 * theta / np.tan(0.5 * theta)) / theta2
    once = cross(phi, y)
    return y - 0.5 * once + c * cross(phi, once)


@compiled
def _left_jacobian_dot(
    phi: np.ndarray, phi_dot: np.ndarray, x: np.ndarray
) -> np.ndarray:
    """(d/dt J_l(phi)) x while phi changes by phi_dot."""
    a, b, a_slope, b_slope = _coefficients(phi)
    rate = dot(phi, phi_dot)
    once = cross(phi, x)
    return (
        a_slope * rate * once
        + a * cross(phi_dot, x)
        + b_slope * rate * cross(phi, once)
        + b * (cross(phi_dot, once) + cross(phi, cross(phi_dot, x)))
    )
