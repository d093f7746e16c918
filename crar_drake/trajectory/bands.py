"""The normal equations of a motion: frames are coupled with the two after them alone.

Of L frames with m unknowns each the matrix is

    D_0  S_0' E_0
    S_0  D_1  S_1' E_1
    E_0  S_1  D_2  ...

with E diagonal. A Cholesky factorisation takes a time that is linear in L. Rows are
added to the bands as LAPACK has them, H (L, m, B) with B = 2 m + 1: of column c of
frame k the diagonal, then what is below. So element (i, c) of the block of frame k + a
with frame k is H[k, c, a m + i - c].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dsbmv
from scipy.linalg.lapack import dpbtrf, dpbtrs

from crar_drake.law.compilation import compiled


@dataclass
class Normal:
    """H x = b, symmetric positive definite."""

    H: np.ndarray  # (L, m, B) its bands, see the module
    b: np.ndarray  # (L, m)

    def of_frames(self, some: np.ndarray, b: np.ndarray) -> Normal:
        """Of some frames, in ascending order, the others held; to be added to.

        Args:
            some: (K,) which.
            b: (K, m) of them.
        """
        m, bands = self.H.shape[1:]
        # Copies rows in a third of the time that an index of an array takes.
        H = np.take(self.H, some, axis=0)
        for gap, first in ((np.diff(some) != 1, m), (some[2:] - some[:-2] != 2, 2 * m)):
            k = np.flatnonzero(gap)
            below = np.arange(bands) >= first - np.arange(m)[:, None]
            H[k] = np.where(below, 0.0, H[k])
        return Normal(H, b)

    def add_to_diagonal(self, frames: np.ndarray, values: np.ndarray) -> None:
        """Adds (K, m) values to the diagonal of H, of K different frames."""
        self.H[frames, :, 0] += values

    def times(self, x: np.ndarray) -> np.ndarray:
        """H x (L, m)."""
        bands = self._bands()
        found = dsbmv(len(bands) - 1, 1.0, bands, x.reshape(-1), lower=1)
        return found.reshape(x.shape)

    def solve(self) -> np.ndarray | None:
        """x (L, m); None if H, which is overwritten, is not positive definite."""
        factor, failed = dpbtrf(self._bands(), lower=1, overwrite_ab=1)
        if failed:
            return None
        x, _ = dpbtrs(factor, self.b.reshape(-1), lower=1)
        return x.reshape(self.b.shape)

    def _bands(self) -> np.ndarray:
        """(B, L m)."""
        return self.H.reshape(self.b.size, -1).T


@compiled
def add_squares(H: np.ndarray, b: np.ndarray, J: np.ndarray, r: np.ndarray) -> None:
    """Adds the least squares |J_k x_k + r_k|^2 of frames; rows have few numbers.

    Args:
        H, b: of a `Normal`.
        J: (L, R, m).
        r: (L, R).
    """
    some = np.empty(J.shape[2], dtype=np.int64)
    for k in range(len(J)):
        for row in range(J.shape[1]):
            count = 0
            for i in range(J.shape[2]):
                if J[k, row, i] != 0.0:
                    some[count] = i
                    count += 1
            for i in range(count):
                x = J[k, row, some[i]]
                b[k, some[i]] -= x * r[k, row]
                for j in range(i + 1):
                    H[k, some[j], some[i] - some[j]] += x * J[k, row, some[j]]


@compiled
def add_steps(
    H: np.ndarray,
    b: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    A: np.ndarray,
    B: np.ndarray,
    r: np.ndarray,
) -> None:
    """Adds the least squares |B x_l - A x_k + r|^2 of steps from a frame to the next.

    Args:
        H, b: of a `Normal`.
        before, after: (K,) the frames k and l = k + 1; -1 where that one is held.
        A, B: (K, F, m).
        r: (K, F).
    """
    m = A.shape[2]
    for step in range(len(A)):
        k, after_k = before[step], after[step]
        for row in range(A.shape[1]):
            for i in range(m):
                x, y = A[step, row, i], B[step, row, i]
                if k >= 0 and x != 0.0:
                    b[k, i] += x * r[step, row]
                    for j in range(i + 1):
                        H[k, j, i - j] += x * A[step, row, j]
                if after_k >= 0 and y != 0.0:
                    b[after_k, i] -= y * r[step, row]
                    for j in range(i + 1):
                        H[after_k, j, i - j] += y * B[step, row, j]
                    if k >= 0:
                        for j in range(m):
                            H[k, j, m + i - j] -= y * A[step, row, j]


@compiled
def add_rows(
    H: np.ndarray,
    b: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    share: np.ndarray,
    g: np.ndarray,
    weight: np.ndarray,
    target: np.ndarray,
) -> None:
    """Adds the rows of least squares weight |g ((1 - t) x_k + t x_l) - target|^2.

    Args:
        H, b: of a `Normal`.
        left, right: (R,) the frames k and l = k + 1; -1 where that one is held.
        share: (R,) t; rows with the same frame and share come one after the other.
        g: (R, m).
        weight, target: (R,); a weight may be 0.
    """
    # Rows of one sample come one after the other: their sum is added once. Of what is
    # symmetric the lower triangle is summed.
    m = g.shape[1]
    squares, h = np.zeros((m, m)), np.zeros(m)
    some, moving = 0, np.empty(m, dtype=np.int64)
    for r in range(len(g)):
        if weight[r] != 0.0:
            some, count = some + 1, 0
            for i in range(m):
                if g[r, i] != 0.0:
                    moving[count] = i
                    count += 1
            for a in range(count):
                i = moving[a]
                scaled = weight[r] * g[r, i]
                h[i] += scaled * target[r]
                for c in range(a + 1):
                    squares[i, moving[c]] += scaled * g[r, moving[c]]
        k, after, t = left[r], right[r], share[r]
        u = 1.0 - t
        if (
            r + 1 < len(g)
            and left[r + 1] == k
            and right[r + 1] == after
            and share[r + 1] == t
        ):
            continue
        if not some:
            continue
        some = 0
        for i in range(m):
            if k >= 0:
                b[k, i] += u * h[i]
            if after >= 0:
                b[after, i] += t * h[i]
            h[i] = 0.0
            for j in range(i + 1):
                product = squares[i, j]
                squares[i, j] = 0.0
                if k >= 0:
                    H[k, j, i - j] += u * u * product
                if after >= 0:
                    H[after, j, i - j] += t * t * product
                    if k >= 0:
                        H[k, j, m + i - j] += u * t * product
                        if i != j:
                            H[k, i, m + j - i] += u * t * product


@compiled
def along_rows(
    g: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    share: np.ndarray,
    x: np.ndarray,
) -> np.ndarray:
    """g ((1 - t) x_k + t x_l) of each row, (R,); arguments as of `add_rows`."""
    moved, moves = np.zeros(len(g)), np.zeros(len(x) + 1, dtype=np.bool_)
    for k in range(len(x)):
        moves[k] = x[k].any()
    for r in range(len(g)):
        k, after, t = left[r], right[r], share[r]
        total = 0.0
        if not (moves[k] or moves[after]):
            continue
        if k >= 0 and t < 1.0:
            for j in range(g.shape[1]):
                total += (1.0 - t) * g[r, j] * x[k, j]
        if after >= 0 and t > 0.0:
            for j in range(g.shape[1]):
                total += t * g[r, j] * x[after, j]
        moved[r] = total
    return moved
