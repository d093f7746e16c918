"""Which shapes can be near in a motion: balls first, distances where these do not say.

Most pairs of a whole robot are far apart at any time. The balls about two shapes bound
their distance from below, for a tenth of the effort.
"""

from __future__ import annotations

import numpy as np

from crar_drake.equations.admission import sizes_of
from crar_drake.equations.capsule_distances import nearest_points
from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.kinematics import link_poses, place_points


@compiled
def nearby_distances(q: np.ndarray, enough: np.ndarray, robot: Held) -> np.ndarray:
    """Bounds from below for the distances of pairs of shapes, exact where it matters.

    Args:
        q: (T, nq) positions in the plant's order.
        enough: (T, Nr) [m]: a pair is examined only if the balls about its shapes are
            not so far apart.
        robot: holds a `Robot` with a row for each pair of capsules and spheres.

    Returns:
        (T, Nr) the signed distances where they were examined, else those of the balls,
        at least `enough` [m].
    """
    r = robot.value
    pairs = r.pairs.value
    count = enough.shape[1]
    radius = np.empty(count)
    for i in range(count):
        radius[i] = (
            0.5 * (np.sqrt(pairs.sizes.uu[i]) + np.sqrt(pairs.sizes.vv[i]))
            + pairs.sizes.radii[i]
        )
    found = np.empty((len(q), count))
    for k in range(len(q)):
        X = link_poses(q[k : k + 1], r.tree.value)
        points = place_points(X, r.selection, r.first)[0]
        some = np.zeros(count, dtype=np.bool_)
        for i in range(count):
            a, u = points[pairs.start_a[i]], points[pairs.vector_a[i]]
            b, v = points[pairs.start_b[i]], points[pairs.vector_b[i]]
            apart = 0.0
            for c in range(3):
                apart += (a[c] - b[c] + 0.5 * (u[c] - v[c])) ** 2
            found[k, i] = np.sqrt(apart) - radius[i]
            some[i] = not found[k, i] >= enough[k, i]
        rows = np.flatnonzero(some)
        d, _, _, _ = nearest_points(
            points[pairs.start_a[rows]],
            points[pairs.vector_a[rows]],
            points[pairs.start_b[rows]],
            points[pairs.vector_b[rows]],
            sizes_of(pairs.sizes, rows),
        )
        for j in range(len(rows)):
            found[k, rows[j]] = d[j]
    return found
