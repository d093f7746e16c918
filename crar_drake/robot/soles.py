"""What a robot stands with: its masses, and the wrenches that the ground can give."""

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.tree import BodyIndex
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from crar_drake.errors import ModelError
from crar_drake.law.balance import WrenchCone
from crar_drake.law.dynamics import Masses
from crar_drake.robot.description import FLOOR_TOLERANCE, find_body
from crar_drake.robot.dynamics import find_masses
from crar_drake.robot.model import ControlModel

# Faces of the cone that differ by less are one [of unit normals].
_SAME = 1e-7


def masses_on_soles(model: ControlModel) -> Masses:
    """The masses of a robot whose base is fixed.

    What stands on the soles counts, those bodies that nothing moves among them, as a
    table or a frame on wheels. What is welded to the world beside it does not.

    Args:
        model: of the robot, whose description has soles.

    Raises:
        ModelError: there is no gravity downwards, or something moves that does not
            stand on the soles.
    """
    down = model.plant.gravity_field().gravity_vector()
    if not down[2] < 0.0 or np.abs(down[:2]).max() > 1e-9:
        raise ModelError(f"balance: gravity is {down} m/s^2; it must point along -z")
    return find_masses(model.plant, model.joints, _on_soles(model))


def _on_soles(model: ControlModel) -> set[int]:
    """Indices of the bodies that stand on the soles: what is joined to their links,
    however, but through the world. What is above a sole of the world is all there is.
    """
    plant, soles = model.plant, model.description.soles
    world = int(plant.world_body().index())
    feet = {int(find_body(plant, link).index()): link for link in soles}
    if world in feet:
        return set(range(plant.num_bodies())) - {world}
    ends = [
        {int(joint.parent_body().index()), int(joint.child_body().index())}
        for joint in map(plant.get_joint, plant.GetJointIndices())
    ]
    found, more = set(), {next(iter(feet))}
    while more:
        found |= more
        near = [pair for pair in ends if pair & found and world not in pair]
        more = set().union(*near) - found
    what = f"robot {model.description.name}: soles"
    if apart := [link for i, link in feet.items() if i not in found]:
        raise ModelError(
            f"{what}: {', '.join(apart)}: nothing but the world joins it to "
            f"{next(iter(soles))}, so that each stands alone; weld one to the other"
        )
    for i in set(range(plant.num_bodies())) - found:
        body = plant.get_body(BodyIndex(i))
        if model.joints.place(body)[0]:
            raise ModelError(
                f"{what}: {body.name()} moves, but does not stand on "
                f"{', '.join(soles)}: it is joined to the world beside it; weld it to "
                "what stands on the soles"
            )
    return found


def sole_corners(model: ControlModel) -> list[np.ndarray]:
    """Where the soles are while the robot stands: of each (V, 3) corners in W [m].

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
    for link, corners in model.description.soles.items():
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
    """(V, 3) the polygon about points of a plane, each edge `margin` farther inside.

    Args:
        corners: (P, 3), those inside the polygon may be among them [m].
        margin: [m].

    Raises:
        ModelError: nothing is left of it, or the points are in one line or in no plane.
    """
    middle = corners.mean(axis=0)
    _, _, axes = np.linalg.svd(corners - middle)
    off = np.abs((corners - middle) @ axes[2]).max()
    if off > FLOOR_TOLERANCE:
        raise ModelError(
            f"soles: at rest their corners are up to {1e3 * off:.0f} mm off the plane "
            "through them; they are to touch one floor"
        )
    try:
        edges = ConvexHull((corners - middle) @ axes[:2].T).equations
    except QhullError:
        raise ModelError("soles: the corners are all in one line") from None
    # The point that is farthest from all edges, and how far it is.
    rows = np.column_stack([edges[:, :2], np.ones(len(edges))])
    free = [(None, None)] * 3
    *inmost, inside = linprog([0, 0, -1], rows, -edges[:, 2], bounds=free).x
    if inside <= margin:
        raise ModelError(
            f"balance: a margin of {1e3 * margin:g} mm leaves nothing of soles whose "
            f"hull is {2e3 * inside:.0f} mm wide"
        )
    edges[:, 2] += margin
    found = HalfspaceIntersection(edges, np.array(inmost)).intersections
    return middle + found @ axes[:2]


def ground_cone(
    soles: Sequence[np.ndarray], friction: float, margin: float
) -> WrenchCone:
    """K: the sum of what the ground can give at the corners of the soles' hull, shrunk.

    At each it pushes within a pyramid of friction, whose edges are in the circular
    cone; so the faces bound the force's place, its slope, and the turn that friction
    stands, of all soles together (S. Caron, Q.-C. Pham, Y. Nakamura, "Stability of
    surface contacts for humanoid robots", ICRA 2015). A force at a point of the hull is
    the sum of shares of it, each as steep, at corners of soles: the ground can give it.

    Args:
        soles: of each (V, 3) corners in W [m].
        friction: coefficient.
        margin: that their hull is smaller by at each edge [m].

    Raises:
        ModelError: as of `shrunk`, or the soles stand on edge.
    """
    small = shrunk(np.concatenate(soles), margin)
    about = small.mean(axis=0)
    _, _, axes = np.linalg.svd(small - about)
    normal = axes[2] * np.sign(axes[2][2])
    if not normal[2] > 0.1:
        raise ModelError("soles: they stand on edge in the rest posture")
    wrenches = []
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
    return WrenchCone(
        np.ascontiguousarray(moved),
        np.linalg.norm(rows[:, :3], axis=1),
        np.linalg.norm(rows[:, 3:], axis=1),
        about,
    )
