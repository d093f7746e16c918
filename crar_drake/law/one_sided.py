"""Least squares with residuals that count on one side only, solved exactly.

The lookahead weighs what approaches a constraint, and nothing that leaves it; the
torque limit what is beyond a limit.
"""

import numpy as np

from crar_drake.law.compilation import compiled
from crar_drake.law.vectors import (
    add_to,
    add_to_diagonal,
    backward,
    cholesky,
    cholesky_solve,
    forward,
    gram,
    times,
    transposed_times,
)

# The one-sided problems are solved exactly, usually in two or three passes.
_PASSES = 100
# A way as short as this, relative to where it leads, is rounding.
_NO_WAY = 1e-13


@compiled
def one_sided_minimum(
    M: np.ndarray,
    right: np.ndarray,
    rows: np.ndarray,
    desired: np.ndarray,
    x: np.ndarray,
) -> np.ndarray:
    """argmin x^T M x - 2 right^T x + sum max(0, desired_j - rows_j x)^2, (n,).

    Convex with a continuous gradient, so there is one minimum, and it is continuous in
    all that is given. Newton's method: each pass solves for the rows that are violated
    where the last one led, and ends where these are the same, which is exact. Until
    then it goes as far towards its solution as it leads downwards, by which it always
    comes to an end.

    Args:
        M: (n, n) symmetric positive definite.
        right: (n,).
        rows, desired: (C, n), (C,).
        x: (n,) where to begin: the minimum without rows.
    """
    active = times(rows, x) < desired
    if not active.any():
        return x
    for _ in range(_PASSES):
        A = np.flatnonzero(active)
        some = rows[A]
        normal = gram(some)
        add_to(normal, M)
        y = cholesky_solve(cholesky(normal), right + transposed_times(some, desired[A]))
        violated = times(rows, y) < desired
        if (violated == active).all():
            return y
        way = y - x
        if not np.abs(way).max() > _NO_WAY * np.abs(y).max():
            return y  # rows that just hold, to rounding, or NaN
        x = x + _lowest_on_way(M, right, rows, desired, x, way) * way
        active = times(rows, x) < desired
    return x


@compiled
def _lowest_on_way(M, right, rows, desired, x, way):
    """The share of the way to where the function of `one_sided_minimum` is lowest.

    Half its derivative by the share is continuous, grows, and is linear between the
    shares at which a row's violation begins or ends.
    """
    gap, rate = desired - times(rows, x), times(rows, way)
    active = gap > 0.0
    force, stiffness = 0.0, 0.0
    at = np.full(len(rate), np.inf)
    for j in range(len(rate)):
        if active[j]:
            force += rate[j] * gap[j]
            stiffness += rate[j] * rate[j]
        if active[j] == (rate[j] > 0.0) and rate[j] != 0.0:
            at[j] = max(gap[j] / rate[j], 0.0)
    slope = (way * (times(M, x) - right)).sum() - force
    curvature = (way * times(M, way)).sum() + stiffness
    share = 0.0
    for _ in range(len(at)):
        j = np.argmin(at)
        next_slope = slope + (at[j] - share) * curvature
        if not next_slope < 0.0:
            break
        slope, share = next_slope, at[j]
        at[j] = np.inf
        curvature += -rate[j] * rate[j] if active[j] else rate[j] * rate[j]
    return share - slope / curvature


# What a row may lack of its desired value [of the rows' units].
_LACK = 1e-7
# Where more rows hold than this, their number counts more than that of the unknowns.
_MANY = 40


@compiled
def one_sided_nearest(
    x_0: np.ndarray, rows: np.ndarray, desired: np.ndarray
) -> np.ndarray:
    """argmin |x - x_0|^2 + sum max(0, desired_j - rows_j x)^2, (n,).

    The same as `one_sided_minimum` finds with M = I, faster where few of many rows
    hold: through its dual, min |L^T l|^2 - 2 l^T (desired - rows x_0) over l >= 0 with
    L L^T = rows rows^T + I and x = x_0 + rows^T l, by the active sets of Lawson and
    Hanson (Solving Least Squares Problems, 1974, chapter 23). Each pass takes in the
    row that lacks the most, and lets go of those that would push the wrong way. Where
    many rows hold, that would take a hundred times as long as `one_sided_minimum`.

    Args:
        x_0: (n,) the minimum without rows.
        rows, desired: (C, n), (C,).
    """
    C = len(desired)
    active, push = np.zeros(C, dtype=np.bool_), np.zeros(C)
    at_first = desired - times(rows, x_0)
    x = x_0
    for _ in range(_PASSES + 3 * C):
        lacks, worst, most = desired - times(rows, x) - push, -1, _LACK
        for j in range(C):
            if not active[j] and lacks[j] > most:
                worst, most = j, lacks[j]
        if worst < 0:
            return x
        active[worst] = True
        while True:
            A = np.flatnonzero(active)
            if len(A) > _MANY:
                return one_sided_minimum(np.eye(len(x_0)), x_0, rows, desired, x_0)
            some = rows[A]
            normal = gram(np.ascontiguousarray(some.T))
            add_to_diagonal(normal, np.ones(len(A)))
            pushes = cholesky_solve(cholesky(normal), at_first[A])
            share, last = 1.0, -1
            for i in range(len(A)):
                before = push[A[i]]
                # The one that comes in pushes the right way, but for rounding.
                if not pushes[i] > 0.0 and before / (before - pushes[i]) <= share:
                    share, last = before / (before - pushes[i]), A[i]
            if last < 0:
                for i in range(len(A)):
                    push[A[i]] = pushes[i]
                break
            for i in range(len(A)):
                push[A[i]] += share * (pushes[i] - push[A[i]])
            active[last], push[last] = False, 0.0
            if last == worst:
                return x
        x = x_0 + transposed_times(some, pushes)
    return x


@compiled
def one_sided_nearest_in(
    root: np.ndarray, x_0: np.ndarray, rows: np.ndarray, desired: np.ndarray
) -> np.ndarray:
    """argmin |L^T (x - x_0)|^2 + sum max(0, desired_j - rows_j x)^2, (n,): what
    `one_sided_minimum` finds of M = L L^T, in as many passes as rows hold in the end.

    Args:
        root: (n, n) L, lower triangular, of `vectors.cholesky`.
        x_0: (n,) the minimum without rows.
        rows, desired: (C, n), (C,).
    """
    if not (times(rows, x_0) < desired).any():
        return x_0
    L = np.tril(root)
    stretched = np.ascontiguousarray(forward(L, np.ascontiguousarray(rows.T)).T)
    y = one_sided_nearest(transposed_times(L, x_0), stretched, desired)
    return backward(L, y)
