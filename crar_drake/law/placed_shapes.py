"""Where pairs of shapes are, and how joints move them.

Of a whole robot's pairs few are looked at closely, and only the links that carry their
shapes are placed for them.
"""

import numpy as np

from crar_drake.law.capsule_distances import (
    distance_gradient_about_origin,
    nearest_points,
)
from crar_drake.law.compilation import Held, compiled
from crar_drake.law.kinematics import Robot, joint_motion, link_poses, place_points
from crar_drake.law.vectors import put, to_places


@compiled
def _place(at, i, X, r):
    """`place_points` of one alone, in place: (P, 3) `at`, from X (4 N, 3)."""
    j = r.first[i]
    p, q = r.selection[i, 0], r.selection[i, 1]
    s, t = r.selection[i, 2], r.selection[i, 3]
    for c in range(3):
        first_two = p * X[j, c] + q * X[j + 1, c]
        at[i, c] = first_two + s * X[j + 2, c] + t * X[j + 3, c]


@compiled
def place_pairs(
    points: np.ndarray, q: np.ndarray, some: np.ndarray, r: Robot
) -> np.ndarray:
    """The axes and corners of some pairs, in place, and S at one configuration.

    Args:
        points: (P, 3) those of `Robot.selection`, finite: of these the axes' are put
            where they are at q [m].
        q: (nq,) positions.
        some: (k,) which pairs of shapes.

    Returns:
        (6, nv) `joint_motion`, of the joints that move these shapes.
    """
    tree, pairs, axes = r.tree.value, r.pairs.value, 3 * len(r.order)
    hulls, in_plant = pairs.hulls.value, to_places(q, r.positions).reshape(1, -1)
    # The frames that carry the shapes.
    frames = np.zeros(len(tree.parent), dtype=np.bool_)
    for of in some:
        for start in (pairs.start_a[of], pairs.start_b[of]):
            frame = r.first[start] // 4
            while not frames[frame]:
                frames[frame] = True
                frame = tree.parent[frame]
    X = link_poses(in_plant, tree, frames)[0]
    for of in some:
        for start, hull in (
            (pairs.start_a[of], pairs.hull_a[of]),
            (pairs.start_b[of], pairs.hull_b[of]),
        ):
            _place(points, start, X, r)
            _place(points, start + pairs.to_vector, X, r)
            if hull >= 0:
                corner = start + hulls.after[hull]
                for i in range(corner, corner + hulls.corners[hull]):
                    _place(points, i, X, r)
    # A free joint has two frames, and six velocities with three points each.
    for i in range(axes):
        if frames[r.first[i] // 4]:
            _place(points, i, X, r)
    return joint_motion(points[:axes].reshape(1, -1, 3))[0]


@compiled
def distances_at(
    points: np.ndarray, q: np.ndarray, some: np.ndarray, r: Robot
) -> tuple[np.ndarray, np.ndarray]:
    """Distances of some pairs, and their gradients, Eq. (20): (k,) [m], (k, nv).

    Args:
        points, q, some, r: of `place_pairs`, in place likewise.
    """
    S, pairs = place_pairs(points, q, some, r), r.pairs.value
    d, n, p, _ = nearest_points(points, pairs, some)
    moves = pairs.moves[some]
    return d, distance_gradient_about_origin(n, p, S, moves)


@compiled
def own_velocities(
    S: np.ndarray, x: np.ndarray, moves: np.ndarray, links: np.ndarray, some: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Spatial velocities (k, 6), (k, 6) of both shapes of pairs, seen from what carries
    both.

    Args:
        S: (6, nv) `joint_motion`.
        x: (nv,) what each joint moves in a unit of time.
        moves: (Np, nv) of `ShapePairs`.
        links: (Np,) numbers, alike where `moves` are.
        some: (k,) which, those of the same links side by side.
    """
    a, b = np.zeros((len(some), 6)), np.zeros((len(some), 6))
    for k in range(len(some)):
        if k and links[some[k]] == links[some[k - 1]]:
            put(a[k], 0, a[k - 1])
            put(b[k], 0, b[k - 1])
            continue
        for j in range(len(x)):
            carries = moves[some[k], j]
            if carries != 0.0:
                V = a if carries > 0.0 else b
                for c in range(6):
                    V[k, c] += S[c, j] * x[j]
    return a, b


@compiled
def shape_distances(q: np.ndarray, robot: Held) -> np.ndarray:
    """The signed distances (T, Np) of all pairs of shapes in T configurations [m].

    Args:
        q: (T, nq) positions in the plant's order.
        robot: holds a `Robot`.
    """
    r = robot.value
    pairs, tree = r.pairs.value, r.tree.value
    every = np.arange(len(pairs.radii))
    found = np.empty((len(q), len(every)))
    for k in range(len(q)):
        X = link_poses(q[k : k + 1], tree, tree.every)
        points = place_points(X, r.selection, r.first)[0]
        d, _, _, _ = nearest_points(points, pairs, every)
        put(found[k], 0, d)
    return found
