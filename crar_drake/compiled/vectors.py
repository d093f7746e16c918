"""Compiled vector algebra on tuples of three, and Cholesky solves of small systems."""

from __future__ import annotations

import math

import numpy as np

from crar_drake.compiled.compiler import njit


@njit
def column(A, i):
    return A[0, i], A[1, i], A[2, i]


@njit
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit
def cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@njit
def along(p, s, u):
    return p[0] + s * u[0], p[1] + s * u[1], p[2] + s * u[2]


@njit
def unit(x):
    return min(max(x, 0.0), 1.0)


@njit
def factorize(A):
    """The lower Cholesky factor in the place of A's lower half."""
    for j in range(len(A)):
        for k in range(j):
            A[j, j] -= A[j, k] * A[j, k]
        A[j, j] = math.sqrt(A[j, j]) if A[j, j] > 0.0 else np.nan
        for i in range(j + 1, len(A)):
            for k in range(j):
                A[i, j] -= A[i, k] * A[j, k]
            A[i, j] /= A[j, j]


@njit
def solve(L, b):
    """x of L L^T x = b, from the lower factor."""
    x, n = b.copy(), len(b)
    for i in range(n):
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]
    return x


@njit
def add_square(A, g, weight):
    """A += weight g g^T, lower half."""
    for i in range(len(g)):
        for j in range(i + 1):
            A[i, j] += weight * g[i] * g[j]


@njit
def times(A, x):
    """A x."""
    y = np.zeros(len(A))
    for i in range(len(A)):
        for j in range(len(x)):
            y[i] += A[i, j] * x[j]
    return y


@njit
def transposed_times(A, x):
    """A^T x."""
    y = np.zeros(A.shape[1])
    for i in range(len(A)):
        for j in range(len(y)):
            y[j] += A[i, j] * x[i]
    return y
