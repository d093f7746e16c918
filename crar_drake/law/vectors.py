"""Vectors and small systems of equations: what the equations are computed with.

Vectors stand in the rows of arrays (N, 3). All is written in loops, which Numba
compiles faster than array expressions; SciPy's LAPACK is out of its reach.
"""

import math

import numpy as np

from crar_drake.law.compilation import compiled


@compiled
def cross_rows(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of the rows of two (N, 3) arrays."""
    c = np.empty(a.shape)
    for i in range(len(a)):
        c[i, 0] = a[i, 1] * b[i, 2] - a[i, 2] * b[i, 1]
        c[i, 1] = a[i, 2] * b[i, 0] - a[i, 0] * b[i, 2]
        c[i, 2] = a[i, 0] * b[i, 1] - a[i, 1] * b[i, 0]
    return c


@compiled
def gram(A: np.ndarray) -> np.ndarray:
    """A^T A (n, n) of A (k, n), symmetric to the last bit."""
    rows, n = A.shape
    M = np.zeros((n, n))
    # Four rows at once, in their order: M is read and written a quarter as often.
    by_four = rows - rows % 4
    for k in range(0, by_four, 4):
        for i in range(n):
            a, b, c, d = A[k, i], A[k + 1, i], A[k + 2, i], A[k + 3, i]
            if a == 0.0 and b == 0.0 and c == 0.0 and d == 0.0:
                continue  # a pair's gradient has few joints, a joint's row one
            for j in range(i + 1):
                first = M[i, j] + a * A[k, j] + b * A[k + 1, j]
                M[i, j] = first + c * A[k + 2, j] + d * A[k + 3, j]
    for k in range(by_four, rows):
        for i in range(n):
            a = A[k, i]
            if a == 0.0:
                continue
            for j in range(i + 1):
                M[i, j] += a * A[k, j]
    for i in range(n):
        for j in range(i):
            M[j, i] = M[i, j]
    return M


@compiled
def times(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A x (m,) of A (m, n) and x (n,), contiguous or not."""
    m, n = A.shape
    y = np.empty(m)
    # Four rows at once: each of the sums waits for itself, but not for the others.
    by_four = m - m % 4
    for i in range(0, by_four, 4):
        a, b, c, d = 0.0, 0.0, 0.0, 0.0
        for j in range(n):
            a += A[i, j] * x[j]
            b += A[i + 1, j] * x[j]
            c += A[i + 2, j] * x[j]
            d += A[i + 3, j] * x[j]
        y[i], y[i + 1], y[i + 2], y[i + 3] = a, b, c, d
    for i in range(by_four, m):
        a = 0.0
        for j in range(n):
            a += A[i, j] * x[j]
        y[i] = a
    return y


@compiled
def transposed_times(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A^T x (n,) of A (m, n) and x (m,), contiguous or not."""
    m, n = A.shape
    y = np.zeros(n)
    # Four rows at once, in their order, as in `gram`.
    by_four = m - m % 4
    for i in range(0, by_four, 4):
        a, b, c, d = x[i], x[i + 1], x[i + 2], x[i + 3]
        p, q, r, s = A[i], A[i + 1], A[i + 2], A[i + 3]
        for j in range(n):
            y[j] = y[j] + p[j] * a + q[j] * b + r[j] * c + s[j] * d
    for i in range(by_four, m):
        for j in range(n):
            y[j] += A[i, j] * x[i]
    return y


@compiled
def cholesky(A: np.ndarray) -> np.ndarray:
    """The lower Cholesky factor L of A (n, n); what stands above it means nothing.

    Where A is not positive definite (a NaN or an overflow) the factor holds NaN.
    """
    n = len(A)
    L = np.zeros((n, n))
    # A row of L begins where that of A does: most joints are coupled to few.
    first = np.empty(n, dtype=np.int64)
    for i in range(n):
        row, begin = L[i], 0
        while begin < i and A[i, begin] == 0.0:
            begin += 1
        first[i] = begin
        pivot = A[i, i]
        # Two columns at once: the row is read half as often, and neither sum waits.
        by_two = i - (i - begin) % 2
        for j in range(begin, by_two, 2):
            x, y = L[j], L[j + 1]
            a, b = A[i, j], A[i, j + 1]
            for k in range(max(begin, min(first[j], first[j + 1])), j):
                a -= row[k] * x[k]
                b -= row[k] * y[k]
            a /= x[j]
            b = (b - a * y[j]) / y[j + 1]
            row[j], row[j + 1] = a, b
            pivot = pivot - a * a - b * b
        for j in range(by_two, i):
            a, x = A[i, j], L[j]
            for k in range(max(begin, first[j]), j):
                a -= row[k] * x[k]
            a /= x[j]
            row[j] = a
            pivot -= a * a
        row[i] = math.sqrt(pivot) if pivot > 0.0 else np.nan
    return L


@compiled
def backward(L: np.ndarray, b: np.ndarray) -> np.ndarray:
    """L^-T b (n,) of b (n,), L lower triangular."""
    x = b.copy()
    for i in range(len(L) - 1, -1, -1):
        x[i] /= L[i, i]
        for k in range(i):
            x[k] -= L[i, k] * x[i]
    return x


@compiled
def cholesky_solve(L: np.ndarray, b: np.ndarray) -> np.ndarray:
    """x (n,) of L L^T x = b (n,), from the lower factor."""
    x = b.copy()
    for i in range(len(b)):
        a, row = x[i], L[i]
        for k in range(i):
            a -= row[k] * x[k]
        x[i] = a / row[i]
    return backward(L, x)


@compiled
def forward(L: np.ndarray, B: np.ndarray) -> np.ndarray:
    """L^-1 B (n, m) of B (n, m), L lower triangular."""
    X = B.copy()
    for i in range(len(L)):
        row = X[i]
        for k in range(i):
            share, above = L[i, k], X[k]
            if share != 0.0:
                for c in range(len(row)):
                    row[c] -= share * above[c]
        for c in range(len(row)):
            row[c] /= L[i, i]
    return X


@compiled
def cholesky_solve_matrix(L: np.ndarray, B: np.ndarray) -> np.ndarray:
    """X (n, m) of L L^T X = B (n, m), from the lower factor."""
    X = np.empty(B.shape)
    for c in range(B.shape[1]):
        X[:, c] = cholesky_solve(L, B[:, c].copy())
    return X


@compiled
def put(x: np.ndarray, at: int, values: np.ndarray) -> None:
    """x[at:] begins with the values (k,) then, in place; x (n,), n >= at + k.

    Compiled where it is written, each such assignment takes as long as a function: it
    brings an error message with it.
    """
    for i in range(len(values)):
        x[at + i] = values[i]


@compiled
def to_places(x: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(n,) the entries of x (n,), each at its place."""
    y = np.empty(len(x))
    y[places] = x
    return y


@compiled
def add_to_diagonal(A: np.ndarray, x: np.ndarray) -> None:
    """A += diag(x), in place; A (n, n), x (n,)."""
    for i in range(len(x)):
        A[i, i] += x[i]


@compiled
def add_to(A: np.ndarray, B: np.ndarray) -> None:
    """A += B, in place; A, B (n, m).

    Of a sum of matrices Numba goes through the entries one by one.
    """
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            A[i, j] += B[i, j]


@compiled
def product(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """A B of small matrices, contiguous or not; A may be sparse, B is finite."""
    C = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            a = A[i, k]
            if a == 0.0:
                continue  # most are: of joints that do not carry a link
            for j in range(B.shape[1]):
                C[i, j] += a * B[k, j]
    return C


@compiled
def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b, all (3,)."""
    return np.array(
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    )


@compiled
def dot(a: np.ndarray, b: np.ndarray) -> float:
    """a . b of (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
