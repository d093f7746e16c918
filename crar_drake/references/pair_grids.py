"""Signed distances of two links with two joints between them, on a grid of these.

Such a distance depends on the two joints alone (`pair_tables`). Where a motion is to be
changed it is asked for again and again, at places close to each other. So it is
measured at the corners of the cells that motions go through, kept in the user's cache,
and interpolated. A cell is divided into four until its centre says that interpolating
is close enough. What is known of a cell depends on nothing but the cell.

Nothing that is certified depends on these, nor are they as close as nearest points:
`mesh_clearance` measures anew.
"""

from __future__ import annotations

import numpy as np

from crar_drake.equations.compilation import compiled
from crar_drake.references.kept_arrays import keep_array, place_of, read_kept
from crar_drake.references.mesh_pairs import FOUND_BY
from crar_drake.references.nearest_points import NearestPoints
from crar_drake.references.pair_tables import PairTable

# Edges of the largest cells: of a joint that turns, and of one that slides [rad], [m].
_TURN, _SLIDE = 0.08, 8e-3
_FINEST = 3  # so often a cell is divided, at most
# Interpolating is off by less than this at a cell's centre [m], or than this share of
# the smallest distance.
_CLOSE, _SHARE = 1e-4, 0.1
# Of what is farther apart the hulls are asked alone [m].
_FAR = 1e-2
_WORTH_KEEPING = 5  # cells more than were kept before
_MIDDLE, _COLUMNS = np.int64(1) << 20, np.int64(1) << 21  # of numbers of cells
_REACH = 2.0 ** (20 - _FINEST)  # how far from 0 there are cells [edges]

# key: which cell, see `key_of`. d: at its corners, NaN where surfaces meet and no way
# out is known [m]: of low and high positions of the second joint, at the low one of the
# first, then at the high one. divided: whether it is.
_CELL = np.dtype([("key", np.int64), ("d", float, 4), ("divided", bool)])
_CORNERS = np.array([[0, 0], [0, 2], [2, 0], [2, 2], [1, 1]])  # in half edges


class PairGrid:
    """Of one pair of meshes A and B.

    Attributes:
        table: of the pair.
    """

    def __init__(self, table: PairTable) -> None:
        """
        Args:
            table: of the pair.
        """
        self.table = table
        self._points = NearestPoints(table.meshes, *table.pair)
        self._edges = np.where(table.turns, _TURN, _SLIDE)
        found_by = "pair_grids", "nearest_points", *FOUND_BY
        self._place = place_of("grids", found_by, table.depends_on)
        cells = read_kept(self._place, _CELL)
        self._set(np.zeros(0, dtype=_CELL) if cells is None else cells)
        self._num_kept = len(self._cells)
        self._known: dict[tuple[int, int], float] = {}

    def find(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (S,), negative where surfaces meet, NaN without a way out [m], and
        their derivatives (S, 2) by the joints.

        Args:
            at: (S, 2) positions of the joints [rad or m].
        """
        at = np.ascontiguousarray(at)
        while True:
            d, slopes, lacks = interpolated(at, self._edges, *self._fields)
            lacking = lacks >= 0
            if not lacking.any():
                return d, slopes
            for level in range(_FINEST + 1):
                some = at[lacks == level]
                cells = np.floor(some / (self._edges * 0.5**level)).astype(int)
                self._measure(np.unique(cells, axis=0), level)

    def keep(self) -> None:
        """Writes what was measured to the cache, if it is more than is there."""
        if len(self._cells) >= self._num_kept + _WORTH_KEEPING:
            keep_array(self._place, self._cells)
            self._num_kept = len(self._cells)

    def _set(self, cells: np.ndarray) -> None:
        self._cells = cells[np.argsort(cells["key"])]
        self._fields = [self._cells[name].copy() for name in ("key", "d", "divided")]

    def _measure(self, cells: np.ndarray, level: int) -> None:
        """Adds cells (K, 2) of a level."""
        if not len(cells):
            return
        finer = 2 ** (_FINEST - level)
        places = (2 * cells[:, None] + _CORNERS) * finer  # in half the finest edges
        d = self._at(places.reshape(-1, 2)).reshape(-1, 5)
        off = np.abs(d[:, 4] - d[:, :4].mean(axis=1))
        close = off <= np.maximum(_CLOSE, _SHARE * np.abs(d.min(axis=1)))
        more = np.zeros(len(cells), dtype=_CELL)
        more["key"] = [key_of(i, j, level) for i, j in cells]
        more["d"], more["divided"] = d[:, :4], ~close & (level < _FINEST)
        self._set(np.concatenate([self._cells, more]))

    def _at(self, places: np.ndarray) -> np.ndarray:
        """Distances at places (K, 2), which are counted in half the finest edges."""
        asked = [(int(i), int(j)) for i, j in places]
        new = [place for place in dict.fromkeys(asked) if place not in self._known]
        if new:
            R, p = self.table.placed(np.array(new) * self._edges * 0.5 ** (_FINEST + 1))
            found = self._points.signed(R, p, _FAR)
            self._known.update(zip(new, found, strict=True))
        return np.array([self._known[place] for place in asked])


@compiled
def key_of(i: int, j: int, level: int) -> int:
    """The number of a cell: along the first joint, the second one, and its level."""
    return (level * _COLUMNS + i + _MIDDLE) * _COLUMNS + j + _MIDDLE


@compiled
def interpolated(
    at: np.ndarray,
    edges: np.ndarray,
    keys: np.ndarray,
    corners: np.ndarray,
    divided: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Linearly along both joints: distances (S,) and derivatives (S, 2); and (S,) the
    level of the cell that is not known, else -1.

    Args:
        at: (S, 2) places.
        edges: (2,) of the largest cells.
        keys: (C,) of cells, in ascending order.
        corners: (C, 4) their distances.
        divided: (C,) whether they are.
    """
    d, slopes = np.full(len(at), np.nan), np.full((len(at), 2), np.nan)
    lacks = np.full(len(at), -1)
    cell, i, j, scale = -1, 0.0, 0.0, 1.0
    for k in range(len(at)):
        x, y = at[k, 0] / edges[0], at[k, 1] / edges[1]
        if not (abs(x) < _REACH and abs(y) < _REACH):
            continue
        # Often it is the cell of the place before.
        if cell < 0 or np.floor(x * scale) != i or np.floor(y * scale) != j:
            level, scale = 0, 1.0
            while True:
                i, j = np.floor(x * scale), np.floor(y * scale)
                key = key_of(int(i), int(j), level)
                cell = np.searchsorted(keys, key)
                if cell == len(keys) or keys[cell] != key:
                    cell, lacks[k] = -1, level
                    break
                if not divided[cell]:
                    break
                level, scale = level + 1, 2.0 * scale
            if cell < 0:
                continue
        u, v = x * scale - i, y * scale - j
        of = corners[cell]
        low, high = (1.0 - v) * of[0] + v * of[1], (1.0 - v) * of[2] + v * of[3]
        d[k] = (1.0 - u) * low + u * high
        slopes[k, 0] = (high - low) * scale / edges[0]
        along = (1.0 - u) * (of[1] - of[0]) + u * (of[3] - of[2])
        slopes[k, 1] = along * scale / edges[1]
    return d, slopes, lacks
