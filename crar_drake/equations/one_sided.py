"""Least squares with residuals that count on one side only, solved exactly.

The lookahead weighs what approaches a constraint, and nothing that leaves it; the
torque limit what is beyond a limit.
"""

from __future__ import annotations

import numpy as np

from crar_drake.equations.compilation import compiled
from crar_drake.equations.vectors import (
    add_to,
    cholesky,
    cholesky_solve,
    gram,
    largest,
    select_rows,
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
) -> tuple[np.ndarray, np.ndarray, int]:
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

    Returns:
        (n,) the minimum; (C,) bool, the rows that are violated there; the passes.
    """
    active = times(rows, x) < desired
    passes = 0
    if not active.any():
        return x, active, passes
    while passes < _PASSES:
        passes += 1
        A = np.flatnonzero(active)
        some = select_rows(rows, A)
        normal = gram(some)
        add_to(normal, M)
        y = cholesky_solve(cholesky(normal), right + transposed_times(some, desired[A]))
        violated = times(rows, y) < desired
        if (violated == active).all():
            return y, active, passes
        way = y - x
        if not largest(way) > _NO_WAY * largest(y):
            return y, active, passes  # rows that just hold, to rounding, or NaN
        x = x + _lowest_on_way(M, right, rows, desired, x, way) * way
        active = times(rows, x) < desired
    return x, active, passes


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
