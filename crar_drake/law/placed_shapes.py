"""Where some pairs of shapes are in one configuration, and how joints move them.

Of a whole robot's pairs few are looked at closely, and only the links that carry their
shapes are placed for them.
"""

import numpy as np

from crar_drake.law.capsule_distances import ShapePairs, nearest_points
from crar_drake.law.collisions import distance_gradient_about_origin
from crar_drake.law.compilation import compiled
from crar_drake.law.kinematics import Robot, Tree, joint_motion, link_poses


@compiled
def place_some(
    at: np.ndarray,
    X: np.ndarray,
    selection: np.ndarray,
    first: np.ndarray,
    some: np.ndarray,
) -> None:
    """`place_points` of some alone, in one configuration, in place.

    Args:
        at: (P, 3) where they are put.
        X: (4 N, 3) of `link_poses`.
        selection, first: (P, 4), (P,) as there.
        some: (k,) which points.
    """
    for k in range(len(some)):
        i = some[k]
        j = first[i]
        p, q, r, s = selection[i, 0], selection[i, 1], selection[i, 2], selection[i, 3]
        for c in range(3):
            first_two = p * X[j, c] + q * X[j + 1, c]
            at[i, c] = first_two + r * X[j + 2, c] + s * X[j + 3, c]


@compiled
def needed_by(
    shapes: np.ndarray, pairs: ShapePairs, first: np.ndarray, tree: Tree, nv: int
) -> tuple[np.ndarray, np.ndarray]:
    """What has to be placed to know where shapes are, and how joints move them.

    Args:
        shapes: (k,) which of the pairs.
        first: (P,) of `place_points`, the joints' axes at its beginning.
        nv: number of velocities, each with three points. (A free joint has six of
            them, and two frames.)

    Returns:
        (N,) bool, the frames: those that carry the shapes. The points: the axes and
        corners of the shapes, and the axes of the joints that move these frames.
    """
    axes, hulls = 3 * nv, pairs.hulls.value
    frames = np.zeros(len(tree.parent), dtype=np.bool_)
    size = axes + 4 * len(shapes)
    for of in shapes:
        for hull in (pairs.hull_a[of], pairs.hull_b[of]):
            if hull >= 0:
                size += hulls.corners[hull]
    points = np.empty(size, dtype=np.int64)
    count = 0
    for of in shapes:
        for point in (
            pairs.start_a[of],
            pairs.vector_a[of],
            pairs.start_b[of],
            pairs.vector_b[of],
        ):
            points[count] = point
            count += 1
            frame = first[point] // 4
            while not frames[frame]:
                frames[frame] = True
                frame = tree.parent[frame]
        # Corners are in the frame of their hull's middle.
        for start, hull in (
            (pairs.start_a[of], pairs.hull_a[of]),
            (pairs.start_b[of], pairs.hull_b[of]),
        ):
            if hull >= 0:
                corner = start + hulls.after[hull]
                for point in range(corner, corner + hulls.corners[hull]):
                    points[count] = point
                    count += 1
    for point in range(axes):
        if frames[first[point] // 4]:
            points[count] = point
            count += 1
    return frames, points[:count]


@compiled
def place_pairs(
    points: np.ndarray, q: np.ndarray, shapes: np.ndarray, r: Robot
) -> np.ndarray:
    """The axes of some pairs, in place, and S at one configuration.

    Args:
        points: (P, 3) those of `Robot.selection`, finite: of these the axes' are put
            where they are at q [m].
        q: (nq,) positions.
        shapes: (k,) which pairs of shapes.

    Returns:
        (6, nv) `joint_motion`, of the joints that move these shapes.
    """
    tree = r.tree.value
    in_plant = np.empty((1, len(q)))
    for i in range(len(q)):
        in_plant[0, r.positions[i]] = q[i]
    frames, some = needed_by(shapes, r.pairs.value, r.first, tree, len(r.order))
    X = link_poses(in_plant, tree, frames)
    place_some(points, X[0], r.selection, r.first, some)
    return joint_motion(points[: 3 * len(r.order)].reshape(1, -1, 3))[0]


@compiled
def distances_at(
    points: np.ndarray, q: np.ndarray, shapes: np.ndarray, moves: np.ndarray, r: Robot
) -> tuple[np.ndarray, np.ndarray]:
    """Distances of some pairs, and their gradients, Eq. (20): (k,) [m], (k, nv).

    Args:
        points, q, shapes, r: of `place_pairs`, in place likewise.
        moves: (k, nv) of these pairs, see `distance_gradient_about_origin`.
    """
    S = place_pairs(points, q, shapes, r)
    d, n, p, _ = nearest_points(points, r.pairs.value, shapes)
    S = np.ascontiguousarray(S).reshape(1, 6, -1)
    return d, distance_gradient_about_origin(n, p, S, moves)[0]


@compiled
def own_velocities(
    S: np.ndarray, x: np.ndarray, alone: np.ndarray, pairs: np.ndarray
) -> np.ndarray:
    """Spatial velocities (k, 6) of shapes, seen from what carries both of a pair.

    Args:
        S: (6, nv) `joint_motion`.
        x: (nv,) what each joint moves in a unit of time.
        alone: (Np, nv) `a_alone` or `b_alone` of `Reaches`.
        pairs: (k,) which.
    """
    V = np.zeros((len(pairs), 6))
    for k in range(len(pairs)):
        moves = alone[pairs[k]]
        for j in range(len(x)):
            if moves[j] != 0.0:
                for c in range(6):
                    V[k, c] += S[c, j] * x[j]
    return V
