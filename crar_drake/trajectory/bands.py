"""The normal equations of a motion: frames are coupled with the two after them alone.

Of L frames with m unknowns each the matrix is

    D_0  S_0' E_0
    S_0  D_1  S_1' E_1
    E_0  S_1  D_2  ...

with E diagonal. A Cholesky factorisation of its 2 m bands takes a time that is linear
in L.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpbtrs

from crar_drake.equations.compilation import compiled


@dataclass
class Normal:
    """H x = b, symmetric positive definite.

    Attributes:
        D: (L, m, m) blocks of H on its diagonal, of which the lower triangles count.
        S: (L - 1, m, m) below them: of frame k + 1 with frame k.
        E: (L - 2, m) the diagonals of the blocks below these.
        b: (L, m).
    """

    D: np.ndarray
    S: np.ndarray
    E: np.ndarray
    b: np.ndarray

    def copy(self) -> Normal:
        """The same, whose D, S and b may be added to."""
        return Normal(self.D.copy(), self.S.copy(), self.E, self.b.copy())

    def add_to_diagonal(self, frames: np.ndarray, values: np.ndarray) -> None:
        """Adds (K, m) values to the diagonals of the blocks D of K frames."""
        n = np.arange(self.D.shape[1])
        np.add.at(self.D, (frames[:, None], n, n), values)

    def solve(self) -> np.ndarray | None:
        """x (L, m); None if H is not positive definite.

        LAPACK has the lower triangle by columns: from the diagonal 2 m places down.
        """
        frames, m = self.b.shape
        columns = np.zeros((frames, m, 2 * m + 1))
        for c in range(m):
            columns[:, c, : m - c] = self.D[:, c:, c]
            columns[:-1, c, m - c : 2 * m - c] = self.S[:, :, c]
        columns[:-2, :, 2 * m] = self.E
        bands = columns.reshape(frames * m, -1).T
        factor, failed = dpbtrf(bands, lower=1, overwrite_ab=1)
        if failed:
            return None
        x, _ = dpbtrs(factor, self.b.reshape(-1), lower=1)
        return x.reshape(frames, m)


def _add_rows_loops(D, S, b, left, right, share, g, weight, target):
    # Rows of one sample come one after the other: their sum is added once. Of what is
    # symmetric the lower triangle is summed.
    m = g.shape[1]
    H, h = np.zeros((m, m)), np.zeros(m)
    some = 0
    for r in range(len(g)):
        if weight[r] != 0.0:
            some += 1
            for i in range(m):
                scaled = weight[r] * g[r, i]
                if scaled != 0.0:
                    h[i] += scaled * target[r]
                    for j in range(i + 1):
                        H[i, j] += scaled * g[r, j]
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
                product = H[i, j]
                H[i, j] = 0.0
                if k >= 0:
                    D[k, i, j] += u * u * product
                if after >= 0:
                    D[after, i, j] += t * t * product
                    if k >= 0:
                        S[k, i, j] += u * t * product
                        if i != j:
                            S[k, j, i] += u * t * product


@compiled(loops=_add_rows_loops)
def add_rows(
    D: np.ndarray,
    S: np.ndarray,
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
        D, S, b: of a `Normal`.
        left, right: (R,) the frames k and l = k + 1; -1 where that one is held.
        share: (R,) t; rows with the same frame and share come one after the other.
        g: (R, m).
        weight, target: (R,); a weight may be 0.
    """
    squares = (weight[:, None, None] * g[:, :, None]) * g[:, None, :]
    pulls = (weight * target)[:, None] * g
    for frames, shares in ((left, 1.0 - share), (right, share)):
        there = frames >= 0
        by = shares[there]
        np.add.at(D, frames[there], (by * by)[:, None, None] * squares[there])
        np.add.at(b, frames[there], by[:, None] * pulls[there])
    both = (left >= 0) & (right >= 0)
    by = (share * (1.0 - share))[both]
    np.add.at(S, left[both], by[:, None, None] * squares[both])


def _along_rows_loops(g, left, right, share, x):
    moved = np.zeros(len(g))
    for r in range(len(g)):
        k, after, t = left[r], right[r], share[r]
        total = 0.0
        if k >= 0 and t < 1.0:
            for j in range(g.shape[1]):
                total += (1.0 - t) * g[r, j] * x[k, j]
        if after >= 0 and t > 0.0:
            for j in range(g.shape[1]):
                total += t * g[r, j] * x[after, j]
        moved[r] = total
    return moved


@compiled(loops=_along_rows_loops)
def along_rows(
    g: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    share: np.ndarray,
    x: np.ndarray,
) -> np.ndarray:
    """g ((1 - t) x_k + t x_l) of each row, (R,); arguments as of `add_rows`."""
    wide = np.vstack((x, np.zeros((1, x.shape[1]))))  # -1: a frame that is held
    by = share.reshape(-1, 1)
    return ((1.0 - by) * wide[left] * g + by * wide[right] * g).sum(axis=1)
