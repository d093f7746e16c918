"""How fast those parts of two links approach each other that are near.

A link's farthest point moves the fastest, but where two links are near is often beside
an axis: a waist turns about a pin that its outer rim never gets close to. So surfaces
are divided into small parts, each within a ball. At a time when the distance d of two
surfaces is less than h, their nearest points are in parts whose balls are less than h
apart. With rho_j the distance from the axis of joint j of the farthest point of all
such balls of a link, min(d, h) changes no faster than sum_j |x_j| rho_j, over the
joints that `mesh_clearance` has.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from crar_drake.equations.compilation import compiled

# Parts are what is in a cell of a grid, and groups what is in so many of these each way
# [m].
_CELL, _CELLS = 8e-3, 4
_ROUNDED = 1e-9  # what doubles are off by, and more [m]


class Parts(NamedTuple):
    """Balls about the parts of a surface, and about groups of them."""

    groups: np.ndarray  # (G, 4) centres and radii [m]
    first: np.ndarray  # (G + 1,) the first part of each, and how many there are
    parts: np.ndarray  # (B, 4)


def divided(triangles: np.ndarray) -> Parts:
    """The parts of a surface.

    Args:
        triangles: (M, 3, 3) their corners [m].
    """
    corners = _halved(triangles, _CELL)
    cells = np.floor(corners.mean(axis=1) / _CELL).astype(int)
    order = np.lexsort([*cells.T, *(cells // _CELLS).T])
    corners, cells = corners[order], cells[order]
    starts, groups = (
        np.flatnonzero(np.append(True, np.diff(x, axis=0).any(axis=1)))
        for x in (cells, cells // _CELLS)
    )
    first = np.append(np.searchsorted(starts, groups), len(starts))
    return Parts(_balls(corners, groups), first, _balls(corners, starts))


def _halved(triangles: np.ndarray, longest: float) -> np.ndarray:
    """The same triangles, halved until no edge is longer [m]."""
    small = []
    while len(triangles):
        edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        large = edges.max(axis=1) > longest
        small.append(triangles[~large])
        triangles, k = triangles[large], edges[large].argmax(axis=1)[:, None]
        a, b, c = (
            np.take_along_axis(triangles, (k[..., None] + i) % 3, axis=1)[:, 0]
            for i in range(3)
        )
        middle = 0.5 * (a + b)
        halves = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        triangles = np.concatenate(halves)
    return np.concatenate(small)


def _balls(corners: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """(B, 4) about triangles (M, 3, 3) from each start to the next."""
    count = np.diff(np.append(starts, len(corners)))
    lower = np.minimum.reduceat(corners.min(axis=1), starts)
    upper = np.maximum.reduceat(corners.max(axis=1), starts)
    centres = 0.5 * (lower + upper)
    arms = corners - np.repeat(centres, count, axis=0)[:, None]
    far = np.linalg.norm(arms, axis=2).max(axis=1)
    radii = np.maximum.reduceat(far, starts) + _ROUNDED
    return np.column_stack([centres, radii])


@compiled
def place_balls(
    balls: np.ndarray, some: np.ndarray, R: np.ndarray, p: np.ndarray
) -> np.ndarray:
    """(2, B, 3) centres of some balls (B, 4) that a frame with R (2, 3, 3) and p (2, 3)
    carries, at a frame and the next; others are anywhere."""
    placed = np.empty((2, len(balls), 3))
    for i in range(len(balls)):
        if some[i]:
            for k in range(2):
                for x in range(3):
                    placed[k, i, x] = p[k, x]
                    for y in range(3):
                        placed[k, i, x] += R[k, x, y] * balls[i, y]
    return placed


@compiled
def are_near(
    a: np.ndarray, i: int, radius: float, b: np.ndarray, j: int, nearer: float
) -> bool:
    """Whether two balls, placed by `place_balls`, can be as near on a way as both radii
    together.

    Args:
        a, i, b, j: which are the i-th of a and the j-th of b.
        radius: the sum of theirs, and of how near [m].
        nearer: by how much two of the links' points can approach on the way [m].
    """
    ways, most = 0.0, 2.0 * radius + nearer
    for k in range(2):
        square = 0.0
        for x in range(3):
            square += (a[k, i, x] - b[k, j, x]) ** 2
        ways += np.sqrt(square)
        if ways >= most:
            return False
    return True


@compiled
def near_box(
    balls: np.ndarray,
    placed: np.ndarray,
    others: np.ndarray,
    R: np.ndarray,
    p: np.ndarray,
    nearer: float,
    h: float,
) -> np.ndarray:
    """Which of some balls can be as near to the box about others on a way as h and both
    radii together: all that can be so near to one of them, and some more.

    Args:
        balls, placed: (B, 4), and by `place_balls`.
        others: (C, 4), in a frame with R (2, 3, 3) and p (2, 3).
        nearer: as of `are_near`.
        h: [m].
    """
    low, high, radius = np.empty(3), np.empty(3), others[:, 3].max() + h + _ROUNDED
    for x in range(3):
        low[x], high[x] = others[:, x].min(), others[:, x].max()
    found, count = np.empty(len(balls), np.int64), 0
    for i in range(len(balls)):
        ways = 0.0
        for k in range(2):
            square = 0.0
            for x in range(3):
                at = 0.0
                for y in range(3):
                    at += R[k, y, x] * (placed[k, i, y] - p[k, y])
                square += max(low[x] - at, at - high[x], 0.0) ** 2
            ways += np.sqrt(square)
        if ways < 2.0 * (balls[i, 3] + radius) + nearer:
            found[count] = i
            count += 1
    return found[:count]


@compiled
def near_ball(
    balls: np.ndarray,
    placed: np.ndarray,
    first: int,
    last: int,
    other: np.ndarray,
    j: int,
    radius: float,
    nearer: float,
    found: np.ndarray,
) -> int:
    """How many of the balls first to last - 1 can be near the j-th other, and which, in
    `found`; arguments else as of `are_near`, with that ball's radius."""
    count = 0
    for i in range(first, last):
        if are_near(placed, i, balls[i, 3] + radius, other, j, nearer):
            found[count] = i
            count += 1
    return count


@compiled
def swept_by(
    balls: np.ndarray,
    near: np.ndarray,
    placed: np.ndarray,
    joints: np.ndarray,
    origins: np.ndarray,
    axes: np.ndarray,
    slides: np.ndarray,
    steps: np.ndarray,
) -> float:
    """How far joints move a point of some balls on a way at most [m].

    Args:
        balls: (B, 4); near: (B,) which of them.
        placed: of them, by `place_balls`.
        joints: that move them, the one that is next to the link first.
        origins, axes: (2, nv, 3) of joints in the world, at both ends [m], [1].
        slides: (nv,) how far each slides [m/rad or 1].
        steps: (nv,) by how much each moves [rad or m].
    """
    swept = 0.0
    for v in joints:
        if steps[v] == 0.0:
            continue
        farthest = 0.0
        for i in range(len(balls)):
            if near[i]:
                ways = 0.0
                for k in range(2):
                    x = placed[k, i, 0] - origins[k, v, 0]
                    y = placed[k, i, 1] - origins[k, v, 1]
                    z = placed[k, i, 2] - origins[k, v, 2]
                    a, b, c = axes[k, v, 0], axes[k, v, 1], axes[k, v, 2]
                    ways += np.sqrt(
                        (b * z - c * y) ** 2
                        + (c * x - a * z) ** 2
                        + (a * y - b * x) ** 2
                    )
                of_axis = axes[0, v, 0] ** 2 + axes[0, v, 1] ** 2 + axes[0, v, 2] ** 2
                radius = balls[i, 3] if of_axis > 0.0 else 0.0
                turned = swept if of_axis > 0.0 else 0.0
                farthest = max(farthest, (ways + turned) / 2.0 + radius)
        swept += steps[v] * (farthest + slides[v])
    return swept


@compiled
def near_approach(
    R: np.ndarray,
    p: np.ndarray,
    frames: np.ndarray,
    a: Parts,
    b: Parts,
    joints_a: np.ndarray,
    joints_b: np.ndarray,
    origins: np.ndarray,
    axes: np.ndarray,
    slides: np.ndarray,
    steps: np.ndarray,
    nearer: np.ndarray,
    asked: np.ndarray,
    h: float,
) -> np.ndarray:
    """By how much min(d, h) can change on each way, (T - 1, 2) [m]: by the joints that
    move A, and by those that move B.

    Args:
        R, p: R_WF (T, N, 3, 3) and p_WF (T, N, 3) of all frames [m].
        frames: (2,) which carry the links A and B.
        a, b: their parts, in these frames.
        joints_a, joints_b: the joints that move A and not B, and B and not A, the one
            that is next to the link first.
        origins, axes: (T, nv, 3) of joints in the world [m], [1].
        slides: (nv,) how far each slides [m/rad or 1].
        steps: (T - 1, nv) by how much each joint moves [rad or m].
        nearer: (T - 1,) by how much any two of their points can approach [m].
        asked: (T - 1,) on which ways; 0 on others.
        h: [m].
    """
    found = np.zeros((len(steps), 2))
    every_a = np.ones(len(a.groups), dtype=np.bool_)
    every_b = np.ones(len(b.groups), dtype=np.bool_)
    of_a = np.empty(np.diff(a.first).max(), np.int64)
    of_b = np.empty(np.diff(b.first).max(), np.int64)
    for k in np.flatnonzero(asked):
        R_A, p_A = R[k : k + 2, frames[0]], p[k : k + 2, frames[0]]
        R_B, p_B = R[k : k + 2, frames[1]], p[k : k + 2, frames[1]]
        groups_a = place_balls(a.groups, every_a, R_A, p_A)
        groups_b = place_balls(b.groups, every_b, R_B, p_B)
        some_a = near_box(a.groups, groups_a, b.groups, R_B, p_B, nearer[k], h)
        some_b = near_box(b.groups, groups_b, a.groups, R_A, p_A, nearer[k], h)
        pairs, count = np.empty((len(some_a) * len(some_b), 2), np.int64), 0
        in_a = np.zeros(len(a.parts), dtype=np.bool_)
        in_b = np.zeros(len(b.parts), dtype=np.bool_)
        for i in some_a:
            for j in some_b:
                radius = a.groups[i, 3] + b.groups[j, 3] + h
                if are_near(groups_a, i, radius, groups_b, j, nearer[k]):
                    pairs[count, 0], pairs[count, 1] = i, j
                    count += 1
                    in_a[a.first[i] : a.first[i + 1]] = True
                    in_b[b.first[j] : b.first[j + 1]] = True
        if not count:
            continue
        parts_a = place_balls(a.parts, in_a, R_A, p_A)
        parts_b = place_balls(b.parts, in_b, R_B, p_B)
        near_a = np.zeros(len(a.parts), dtype=np.bool_)
        near_b = np.zeros(len(b.parts), dtype=np.bool_)
        for n in range(count):
            group, other = pairs[n]
            # What is near a part is near the ball about the group that it is in.
            radius = b.groups[other, 3] + h
            first, last = a.first[group], a.first[group + 1]
            num_a = near_ball(
                *(a.parts, parts_a, first, last, groups_b, other, radius, nearer[k]),
                of_a,
            )
            radius = a.groups[group, 3] + h
            first, last = b.first[other], b.first[other + 1]
            num_b = near_ball(
                *(b.parts, parts_b, first, last, groups_a, group, radius, nearer[k]),
                of_b,
            )
            for i in of_a[:num_a]:
                for j in of_b[:num_b]:
                    radius = a.parts[i, 3] + b.parts[j, 3] + h
                    if not (near_a[i] and near_b[j]) and are_near(
                        parts_a, i, radius, parts_b, j, nearer[k]
                    ):
                        near_a[i] = near_b[j] = True
        at, x = slice(k, k + 2), steps[k]
        found[k, 0] = swept_by(
            a.parts, near_a, parts_a, joints_a, origins[at], axes[at], slides, x
        )
        found[k, 1] = swept_by(
            b.parts, near_b, parts_b, joints_b, origins[at], axes[at], slides, x
        )
    return found
