"""What a robot stands with: its masses, and the wrenches that the ground can give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.multibody.tree import BodyIndex
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from crar_drake.equations.balance import Ground, Masses
from crar_drake.equations.compilation import hold
from crar_drake.errors import ModelError
from crar_drake.robot.description import find_body
from crar_drake.robot.model import ControlModel

# Faces of the cone that differ by less are one [of unit normals].
_SAME = 1e-7


def find_masses(model: ControlModel) -> Masses:
    """The masses of a robot whose base is fixed.

    All bodies of the model's plant count but the world's own, those that nothing moves
    among them: what stands on the soles is the whole of them.

    Args:
        model: of the robot.

    Raises:
        ModelError: the base floats, or there is no gravity downwards.
    """
    plant, joints = model.plant, model.joints
    if model.num_free:
        raise ModelError(
            "balance: the base of the robot floats; give the description that stands "
            "on its soles (standing_description)"
        )
    down = plant.gravity_field().gravity_vector()
    if not down[2] < 0.0 or np.abs(down[:2]).max() > 1e-9:
        raise ModelError(f"balance: gravity is {down} m/s^2; it must point along -z")
    tree = joints.tree
    N = len(tree.parent)
    mass, moment = np.zeros(N), np.zeros((N, 3))
    about_frame = np.zeros((N, 3, 3))
    context = plant.CreateDefaultContext()
    for i in range(1, plant.num_bodies()):
        body = plant.get_body(BodyIndex(i))
        frame, X = joints.place(body)
        M = body.CalcSpatialInertiaInBodyFrame(context)
        if not M.get_mass() > 0.0:
            continue
        M = M.ReExpress(X.rotation()).Shift(-X.translation())
        mass[frame] += M.get_mass()
        moment[frame] += M.get_mass() * M.get_com()
        about_frame[frame] += M.CalcRotationalInertia().CopyToFullMatrix3()
    centre = moment / np.where(mass > 0.0, mass, 1.0)[:, None]
    own = [
        about - m * (c @ c * np.eye(3) - np.outer(c, c))
        for about, m, c in zip(about_frame, mass, centre, strict=True)
    ]
    square = 0.5 * np.trace(about_frame, axis1=1, axis2=2)
    velocity = np.zeros(N, dtype=int)
    velocity[joints.frame_of_velocity] = np.arange(len(joints.frame_of_velocity))
    turn, slide = np.zeros((N, 3)), np.zeros((N, 3))
    turn[joints.frame_of_velocity] = joints.turns
    slide[joints.frame_of_velocity] = joints.slides
    return Masses(
        hold(tree),
        velocity,
        turn,
        slide,
        mass,
        centre,
        np.array(own),
        np.linalg.norm(tree.fixed[:, 3, :3], axis=1),
        np.sqrt(square / np.where(mass > 0.0, mass, 1.0)),
        float(-down[2]),
    )


def sole_corners(
    model: ControlModel, soles: Mapping[str, Sequence[Sequence[float]]]
) -> list[np.ndarray]:
    """Where the soles are while the robot stands: of each (V, 3) corners in W [m].

    Args:
        model: of the robot.
        soles: link to the corners of its flat sole, in the link's frame [m].

    Raises:
        ModelError: a link is none of the robot's, or a joint that does not just hold
            moves it.
    """
    plant = model.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, model.rest_positions())
    held = {
        joint
        for joint, source in model.description.prescribed_joints.items()
        if source == "hold"
    }
    found = []
    for link, corners in soles.items():
        body = find_body(plant, link)
        frame, _ = model.joints.place(body)
        movers = np.flatnonzero(model.joints.moved_by[frame])
        moved = [model.velocity_names[i] for i in movers]
        if free := sorted(set(moved) - held):
            raise ModelError(
                f"soles: {link} is moved by {', '.join(free)}; a sole stands still: "
                "prescribe its joints as hold (standing_description)"
            )
        X = plant.EvalBodyPoseInWorld(context, body)
        found.append(X.multiply(np.array(corners, dtype=float).T).T)
    return found


def shrunk(corners: np.ndarray, margin: float) -> np.ndarray:
    """(V, 3) a sole's polygon with each edge `margin` farther inside.

    Args:
        corners: (V, 3) of a flat sole, which is convex [m].
        margin: [m].

    Raises:
        ModelError: its middle is no farther than that from an edge, or the corners span
            no area.
    """
    middle = corners.mean(axis=0)
    _, _, axes = np.linalg.svd(corners - middle)
    try:
        edges = ConvexHull((corners - middle) @ axes[:2].T).equations
    except QhullError:
        raise ModelError("soles: the corners of a sole are all in one line") from None
    inside = -edges[:, 2].max()  # of the middle
    if inside <= margin:
        raise ModelError(
            f"balance: a margin of {1e3 * margin:g} mm leaves nothing of a sole whose "
            f"middle is {1e3 * inside:.0f} mm from its edge"
        )
    edges[:, 2] += margin
    found = HalfspaceIntersection(edges, np.zeros(2)).intersections
    return middle + found @ axes[:2]


def ground_cone(soles: Sequence[np.ndarray], friction: float, margin: float) -> Ground:
    """K: the sum of what the ground can give at each corner of the soles, shrunk.

    At each it pushes within a pyramid of friction, whose edges are in the circular
    cone; so the faces bound the force's place, its slope, and the turn that friction
    stands, of all soles together (S. Caron, Q.-C. Pham, Y. Nakamura, "Stability of
    surface contacts for humanoid robots", ICRA 2015).

    Args:
        soles: of each (V, 3) corners in W [m].
        friction: coefficient.
        margin: that the soles are smaller by at each edge [m].

    Raises:
        ModelError: a sole has no area, or stands on edge.
    """
    about = np.mean([sole.mean(axis=0) for sole in soles], axis=0)
    wrenches = []
    for sole in soles:
        small = shrunk(sole, margin)
        _, _, axes = np.linalg.svd(small - small.mean(axis=0))
        normal = axes[2] * np.sign(axes[2][2])
        if not normal[2] > 0.1:
            raise ModelError("soles: a sole stands on edge in the rest posture")
        for along in (axes[0] + axes[1], axes[0] - axes[1]):
            for way in (along, -along):
                f = normal + friction * way / np.linalg.norm(way)
                wrenches += [np.append(np.cross(p - about, f), f) for p in small]
    w = np.array(wrenches)
    w /= w[:, 5:]  # of one vertical force each
    hull = ConvexHull(w[:, :5])
    faces = hull.equations
    keep = [
        i for i in range(len(faces))
        if np.abs(faces[:i] - faces[i]).max(axis=1, initial=0.0).min(initial=1.0)
        > _SAME
    ]  # fmt: skip
    rows = faces[keep]
    # Back to moments about the world's origin: r_M . (M - about x F) + ...
    moved = rows.copy()
    moved[:, 3:] -= np.cross(rows[:, :3], about)
    return Ground(
        np.ascontiguousarray(moved),
        np.linalg.norm(rows[:, :3], axis=1),
        np.linalg.norm(rows[:, 3:], axis=1),
        about,
    )
