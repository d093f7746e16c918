"""Capsules that hold a link's triangles wholly, so that what clears them clears these.

A fit leaves vertices outside by some millimetres. Covering grows its capsules until
every triangle of the link lies in their union: each triangle is divided until its
pieces are small, each piece is given to the capsule that needs to grow the least to
hold its three corners, and a capsule, which is convex, holds the piece with them.
"""

from dataclasses import replace

import numpy as np

from crar_drake.robot_import.capsule_fitting import Fit, judged
from crar_drake.robot_import.meshes import Part

# A piece of a triangle has no longer edge than this [m].
LONGEST_EDGE = 4e-3
# That a corner on a capsule's surface is within it in spite of rounding [m].
_ROUNDING = 1e-7


def covered(fit: Fit, parts: list[Part]) -> tuple[Fit, float]:
    """A fit whose capsules are grown to hold all triangles of a link's parts; the
    largest growth of a radius [m]."""
    growth = np.zeros(len(fit.capsules))
    corners = np.concatenate([_pieces(part) for part in parts])
    outside = np.stack(
        [
            capsule.distance(corners.reshape(-1, 3)).reshape(-1, 3).max(axis=1)
            for capsule in fit.capsules
        ]
    )
    # The farthest first: a capsule that has grown for it may hold others for nothing.
    for piece in np.argsort(-outside.min(axis=0)):
        if outside[:, piece].min() <= 0.0:
            break
        missing = outside[:, piece] - growth
        if missing.min() <= 0.0:
            continue
        nearest = int(np.argmin(missing))
        growth[nearest] += missing[nearest] + _ROUNDING
    capsules = tuple(
        replace(capsule, radius=capsule.radius + more)
        for capsule, more in zip(fit.capsules, growth.tolist(), strict=True)
    )
    return judged(capsules, parts), float(growth.max())


def _pieces(part: Part) -> np.ndarray:
    """(N, 3, 3) corners of the pieces that a part's triangles are divided into [m]."""
    import trimesh

    vertices, faces = np.asarray(part.vertices), np.asarray(part.faces)
    edges = vertices[faces[:, [1, 2, 0]]] - vertices[faces]
    if np.linalg.norm(edges, axis=2).max(initial=0.0) > LONGEST_EDGE:
        vertices, faces = trimesh.remesh.subdivide_to_size(
            vertices, faces, LONGEST_EDGE, max_iter=16
        )
    return vertices[faces]
