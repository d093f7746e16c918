"""Legs that follow a base which slides while the soles stand: polynomials of its place.

The base slides by p, (3,), and does not turn. Each joint of the legs is a polynomial of

    s = (p - middle) / half,      theta_j(p) = sum_m c_mj T_a(s_x) T_b(s_y) T_c(s_z),

with Chebyshev's T and the degrees (a, b, c) of the m-th term, within the box |s| <= 1.
`robot.pelvis_box` finds them, and how little the soles move by them. While the base
moves at the rate x, which changes at the rate y,

    theta_dot = D theta x,      theta_ddot = D^2 theta [x, x] + D theta y.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.equations.compilation import compiled


class Legs(NamedTuple):
    """L joints of legs that follow a base, by M terms; none if L is 0."""

    slide_q: np.ndarray  # (3,) which of the plant's positions are p
    slide_v: np.ndarray  # (3,) and which velocities
    leg_q: np.ndarray  # (L,) which positions follow
    leg_v: np.ndarray  # (L,) and which velocities
    middle: np.ndarray  # (3,) of the box [m]
    half: np.ndarray  # (3,) of its edges [m]
    degrees: np.ndarray  # (M, 3)
    coefficients: np.ndarray  # (M, L) [rad]
    powers: np.ndarray  # (B, 3) of s, from 1 to 4 in all
    bounds: np.ndarray  # (B, L) of |D^k theta [x, ..., x]|, by sum bounds |x / half|^b


@compiled(loops=True)
def leg_motion(
    p: np.ndarray, x: np.ndarray, legs: Legs
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """theta, D theta x and D^2 theta [x, x], (L,) each.

    Args:
        p: (3,) where the base is [m].
        x: (3,) its rate, or a displacement [m/s, m].
    """
    M, L = legs.coefficients.shape
    most = legs.degrees.max()
    t = np.zeros((3, 3, most + 2))  # axis; value and derivatives by s; degree
    r = np.empty(3)
    for k in range(3):
        s = (p[k] - legs.middle[k]) / legs.half[k]
        r[k] = x[k] / legs.half[k]
        t[k, 0, 0], t[k, 0, 1], t[k, 1, 1] = 1.0, s, 1.0
        for d in range(1, most):
            t[k, 0, d + 1] = 2.0 * s * t[k, 0, d] - t[k, 0, d - 1]
            t[k, 1, d + 1] = 2.0 * (t[k, 0, d] + s * t[k, 1, d]) - t[k, 1, d - 1]
            t[k, 2, d + 1] = 4.0 * t[k, 1, d] + 2.0 * s * t[k, 2, d] - t[k, 2, d - 1]
    at, rate, bend = np.zeros(L), np.zeros(L), np.zeros(L)
    for m in range(M):
        a, b, c = legs.degrees[m, 0], legs.degrees[m, 1], legs.degrees[m, 2]
        f, df, ddf = t[0, 0, a], t[0, 1, a] * r[0], t[0, 2, a] * r[0] ** 2
        g, dg, ddg = t[1, 0, b], t[1, 1, b] * r[1], t[1, 2, b] * r[1] ** 2
        h, dh, ddh = t[2, 0, c], t[2, 1, c] * r[2], t[2, 2, c] * r[2] ** 2
        value = f * g * h
        first = df * g * h + f * dg * h + f * g * dh
        second = ddf * g * h + f * ddg * h + f * g * ddh
        second += 2.0 * (df * dg * h + df * g * dh + f * dg * dh)
        for j in range(L):
            of = legs.coefficients[m, j]
            at[j] += of * value
            rate[j] += of * first
            bend[j] += of * second
    return at, rate, bend


@compiled(loops=True)
def leg_slopes(p: np.ndarray, x: np.ndarray, legs: Legs) -> np.ndarray:
    """D theta, D^2 theta x and D^3 theta [x, x], (3, L, 3): the slopes by p of what
    `leg_motion` gives.
    """
    M, L = legs.coefficients.shape
    most = legs.degrees.max()
    t = np.zeros((3, 4, most + 2))  # axis; derivatives, times x / half; degree
    for k in range(3):
        s, r = (p[k] - legs.middle[k]) / legs.half[k], x[k] / legs.half[k]
        t[k, 0, 0], t[k, 0, 1], t[k, 1, 1] = 1.0, s, 1.0
        for d in range(1, most):
            for n in range(4):
                t[k, n, d + 1] = 2.0 * s * t[k, n, d] - t[k, n, d - 1]
                if n:
                    t[k, n, d + 1] += 2.0 * n * t[k, n - 1, d]
    found = np.zeros((3, L, 3))
    f = np.empty((3, 3))
    for m in range(M):
        for k in range(3):
            # By p_k, of the term: its derivatives along x, by Leibniz.
            for i in range(3):
                r, d = x[i] / legs.half[i], legs.degrees[m, i]
                for n in range(3):
                    f[i, n] = t[i, n + (i == k), d] * r**n
            value = f[0, 0] * f[1, 0] * f[2, 0] / legs.half[k]
            first, second = 0.0, 0.0
            for i in range(3):
                a, b = (i + 1) % 3, (i + 2) % 3
                first += f[i, 1] * f[a, 0] * f[b, 0]
                second += f[i, 2] * f[a, 0] * f[b, 0]
                second += 2.0 * f[i, 1] * f[a, 1] * f[b, 0]
            first, second = first / legs.half[k], second / legs.half[k]
            for j in range(L):
                of = legs.coefficients[m, j]
                found[0, j, k] += of * value
                found[1, j, k] += of * first
                found[2, j, k] += of * second
    return found


@compiled(loops=True)
def leg_bounds(v: np.ndarray, a: np.ndarray, legs: Legs) -> np.ndarray:
    """(L, 4) bounds of the joints' first four derivatives by a parameter, by which the
    base has rates of at most v that change at most at the rates a, (3,) each.

    With D^k theta k-linear, and derivatives of p beyond the second 0, these are D[v],
    D^2[v, v] + D[a], D^3[v, v, v] + 3 D^2[v, a] and
    D^4[v, v, v, v] + 6 D^3[v, v, a] + 3 D^2[a, a].
    """
    L = legs.bounds.shape[1]
    found = np.zeros((L, 4))
    for b in range(len(legs.powers)):
        of_v, of_a, mixed, k = 1.0, 1.0, 0.0, 0
        for i in range(3):
            n = legs.powers[b, i]
            of_v *= (v[i] / legs.half[i]) ** n
            of_a *= (a[i] / legs.half[i]) ** n
            k += n
            if n:  # d/dv along a
                more = n * (v[i] / legs.half[i]) ** (n - 1) * a[i] / legs.half[i]
                for j in range(3):
                    if j != i:
                        more *= (v[j] / legs.half[j]) ** legs.powers[b, j]
                mixed += more
        for j in range(L):
            bound = legs.bounds[b, j]
            found[j, k - 1] += bound * of_v
            if k == 1:
                found[j, 1] += bound * of_a
            elif k == 2:
                found[j, 2] += 1.5 * bound * mixed
                found[j, 3] += 3.0 * bound * of_a
            elif k == 3:
                found[j, 3] += 2.0 * bound * mixed
    return found


def no_legs() -> Legs:
    """Of a base that stands still."""
    none, three = np.zeros(0, dtype=np.int64), np.zeros(3)
    return Legs(
        none, none, none, none, three, three + 1.0,
        np.zeros((0, 3), dtype=np.int64), np.zeros((0, 0)),
        np.zeros((0, 3), dtype=np.int64), np.zeros((0, 0)),
    )  # fmt: skip
