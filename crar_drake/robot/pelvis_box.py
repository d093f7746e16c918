"""What holds in all of the box that a base slides in: legs, soles, limits, pairs.

A leg of six joints whose sole stands has one posture for each place of the base. Its
joints are found at the nodes of a grid (Newton) and fitted by polynomials, which then
*are* what the legs do: so their rates are known without end, and what is left to be
shown is of explicit functions. Nothing of it is sampled.

*A point of a leg*, seen from the base, is a function x(p). Its N-th derivative along an
axis is at most B_N times the length of its chain, with the complete Bell polynomial of
the sums S_k of the joints' k-th derivatives; so the polynomial that it is at the N_x
times N_y times N_z Chebyshev nodes is off by at most

    e_x + L_x e_y + L_x L_y e_z,   e = B_N length / (2^(N-1) N!),                   (P1)

over s in [-1, 1] of each axis, with Lebesgue's constants L <= 2/pi ln(N) + 1. The
rates of that polynomial are at most the sums of its coefficients' magnitudes times
those of T'. This gives, over cells that are halved until it is so:

* how far corners of soles go from where they stand: the sum of all coefficients of
  x(p) + p - x_stand, and (P1);
* the distance of two shapes of legs and base: at a cell's middle, less what the ends or
  corners of both can move in the cell (a point amid these moves no farther than they);
* how far a capsule of a leg is from where it is held on the base: likewise.

Joints, their limits and speeds are polynomials, whose rates are bounded alike.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.polynomial import chebyshev
from pydrake.math import RigidTransform
from pydrake.multibody.tree import BodyIndex, JacobianWrtVariable, Joint, RigidBody
from scipy.fft import dctn

from crar_drake.equations.kinematics import link_poses, place_points
from crar_drake.equations.nearby import nearby_distances
from crar_drake.errors import ModelError
from crar_drake.robot.collision_pairs import shape_axis
from crar_drake.robot.description import GROUND, RobotDescription, find_body
from crar_drake.robot.model import ControlModel
from crar_drake.robot.moving_pelvis import MovingPelvis

_DEGREE = 6  # of the joints' polynomials in all
_FITTED = _DEGREE + 2  # nodes along an axis that they are fitted at
_MOST_NODES = 40  # N of (P1), along an axis
_CLOSE = 1e-6  # N is so large that e is less [m]
_SOLE = 5e-4  # corners of soles may go so far [m]
_APART = 0.008  # pairs of legs and base are at least so far apart in all of the box [m]
_LIMIT = 0.02  # legs keep so far from their limits [rad]
_HELD = 9  # places that legs may be held as at, on the base
_HALVINGS = 5  # of a cell, before it is given up
_SLOWER = 0.8  # share of their largest speed that legs may be asked for


def moving_pelvis(
    description: RobotDescription,
    legs: Sequence[Sequence[Joint]],
    pairs: Sequence[Sequence[str]],
    lower: np.ndarray,
    upper: np.ndarray,
    speed: float,
) -> MovingPelvis:
    """A base that slides in a box, and legs that follow.

    Args:
        description: of the robot, its base welded where it rests.
        legs: the joints of each, by names; six.
        pairs: of links that the base or legs carry.
        lower, upper: (3,) the box [m].
        speed: largest along each axis [m/s]; less if legs could not follow.

    Raises:
        ModelError: a leg has not six joints, or cannot follow; soles would not stand;
            a joint would be beyond its limit; or a pair is not shown to be apart.
    """
    robot = _Robot(description, legs, pairs)
    found = robot.fitted(lower, upper)
    sole_error = robot.sole_error(found)
    robot.check_limits(found)
    robot.check_pairs(found)
    return replace(
        robot.with_swellings(found),
        sole_error=sole_error,
        speed=robot.speed(found, speed),
    )


class _Robot:
    """The robot with its base welded, and what its legs carry."""

    def __init__(self, description, legs, pairs) -> None:
        self.what = f"robot {description.name}: standing.pelvis"
        self.watched = {
            link for pair in description.pairs if GROUND not in pair for link in pair
        }
        alone = replace(description, root="fixed", prescribed_joints={}, ground=None)
        self.model = model = ControlModel.FromDescription(
            replace(alone, pairs=[list(pair) for pair in pairs]), [], time_step=0.0
        )
        if model.pairs.not_examined:
            a, b = model.pairs.not_examined[0]
            raise ModelError(
                f"{self.what}: {a} - {b}: a shape is no capsule, sphere, box or convex "
                "mesh, so that nothing shows them apart while the pelvis moves"
            )
        self.plant, self.rest = model.plant, model.rest_positions()
        self.context = self.plant.CreateDefaultContext()
        names = list(model.position_names)
        self.names = tuple(joint for leg in legs for joint in leg)
        self.at = np.array([names.index(name) for name in self.names])
        self.legs = []
        for (sole, _), leg in zip(description.soles.items(), legs, strict=True):
            if len(leg) != 6:
                raise ModelError(
                    f"{self.what}: the leg of {sole} has {len(leg)} joints; it needs "
                    "six, so that its sole can stand wherever the pelvis is"
                )
            at = np.array([names.index(name) for name in leg])
            self.legs.append((find_body(self.plant, sole), at))
        self.soles = [np.array(x, dtype=float) for x in description.soles.values()]

    # --- the polynomials ----------------------------------------------------------

    def fitted(self, lower: np.ndarray, upper: np.ndarray) -> MovingPelvis:
        """The legs' joints, fitted."""
        s = np.array(list(product(chebyshev.chebpts1(_FITTED), repeat=3)))
        p = 0.5 * (lower + upper) + 0.5 * (upper - lower) * s
        joints = np.hstack([self._solved(*leg, p) for leg in self.legs])
        every = product(range(_DEGREE + 1), repeat=3)
        degrees = np.array([d for d in every if sum(d) <= _DEGREE])
        T = [chebyshev.chebvander(s[:, k], _DEGREE)[:, degrees[:, k]] for k in range(3)]
        coefficients = np.linalg.lstsq(T[0] * T[1] * T[2], joints, rcond=None)[0]
        powers = np.array([b for b in product(range(5), repeat=3) if 0 < sum(b) < 5])
        counts = [
            math.factorial(sum(b)) / math.prod(map(math.factorial, b))
            for b in powers.tolist()
        ]
        sups = [_sup(degrees, b) @ np.abs(coefficients) for b in powers]
        bounds = np.array(counts)[:, np.newaxis] * np.array(sups)
        return MovingPelvis(
            lower, upper, np.zeros(3), self.names, self.rest[self.at], degrees,
            coefficients, powers, bounds, 0.5 * (lower + upper), {}, 0.0,
        )  # fmt: skip

    def _solved(self, sole: RigidBody, at: np.ndarray, p: np.ndarray) -> np.ndarray:
        """(K, 6) joints of a leg whose sole stands while the base is at (K, 3)."""
        plant, context = self.plant, self.context
        W, frame = plant.world_frame(), sole.body_frame()
        plant.SetPositions(context, self.rest)
        stands = plant.EvalBodyPoseInWorld(context, sole)
        q, found = self.rest.copy(), np.empty((len(p), 6))
        for k in np.argsort(-p[:, 2]):  # from straight legs on, each from the last
            wanted = RigidTransform(stands.rotation(), stands.translation() - p[k])
            for _ in range(30):
                plant.SetPositions(context, q)
                X = plant.EvalBodyPoseInWorld(context, sole)
                turn = (wanted.rotation() @ X.rotation().inverse()).ToAngleAxis()
                off = wanted.translation() - X.translation()
                off = np.concatenate([turn.angle() * turn.axis(), off])
                if np.abs(off).max() < 1e-12:
                    break
                J = plant.CalcJacobianSpatialVelocity(
                    context, JacobianWrtVariable.kV, frame, np.zeros(3), W, W
                )[:, at]
                step = np.linalg.lstsq(J, off, rcond=None)[0]
                q[at] += step * min(1.0, 0.5 / max(np.abs(step).max(), 1e-9))
            else:
                x, y, z = 1e3 * p[k]
                raise ModelError(
                    f"{self.what}: the leg of {sole.name()} cannot follow to "
                    f"({x:.0f}, {y:.0f}, {z:.0f}) mm from where the robot rests; give "
                    "a smaller box, or a rest posture with knees that are bent more"
                )
            found[k] = q[at]
        return found

    def _configurations(self, pelvis: MovingPelvis, p: np.ndarray) -> np.ndarray:
        q = np.tile(self.rest, (len(p), 1))
        q[:, self.at] = pelvis.positions(p)
        return q

    # --- points of legs -----------------------------------------------------------

    def _points(self, pelvis: MovingPelvis, p: np.ndarray, placed: list) -> np.ndarray:
        """(K, P, 3) where points of links are, seen from the base at (K, 3)."""
        tree = self.model.joints.tree
        selection, first = self.model.joints.select(placed)
        X = link_poses(self._configurations(pelvis, p), tree, tree.every)
        return place_points(X, selection, first)

    def _placed(self, body: RigidBody, p_B: np.ndarray) -> tuple[int, np.ndarray]:
        frame, X = self.model.joints.place(body)
        return frame, np.append(X.multiply(p_B), 1.0)

    def _followed(
        self, pelvis: MovingPelvis, placed: list
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points of links as polynomials: coefficients (N_x, N_y, N_z, P, 3), and (P,)
        how far they are off, (P1) [m]."""
        tree = self.model.joints.tree
        own = np.zeros((_MOST_NODES, 3, len(self.rest)))
        for k in range(_MOST_NODES):
            own[k][:, self.at] = _along(pelvis.degrees, pelvis.coefficients, k + 1)
        bounds = np.zeros((_MOST_NODES, 3, len(placed)))  # of x's derivatives
        for i, (frame, local) in enumerate(placed):
            length, at = float(np.linalg.norm(local[:3])), frame
            S = np.zeros((_MOST_NODES, 3))
            while at:
                S += own[:, :, tree.position[at]]
                length += float(np.linalg.norm(tree.fixed[at][3, :3]))
                at = tree.parent[at]
            for k in range(3):
                bounds[:, k, i] = length * _bells(S[:, k])
        counts, off, growth = [], np.zeros(len(placed)), 1.0
        for k in range(3):
            N = np.arange(1, _MOST_NODES + 1)
            sizes = 2.0 ** (N - 1) * np.array([float(math.factorial(n)) for n in N])
            e = bounds[:, k] / sizes[:, np.newaxis]
            enough = np.flatnonzero(e.max(axis=1) < _CLOSE)
            n = int(enough[0]) if len(enough) else len(e) - 1
            counts.append(n + 1)
            off += growth * e[n]
            growth *= 2.0 / np.pi * np.log(n + 1.0) + 1.0
        # From 1 on, as of the cosine transform.
        nodes = product(*(-chebyshev.chebpts1(n) for n in counts))
        p = pelvis.middle + pelvis.half * np.array(list(nodes))
        x = self._points(pelvis, p, placed).reshape(*counts, len(placed), 3)
        c = dctn(x, type=2, axes=(0, 1, 2)) / math.prod(counts)
        for k in range(3):
            c[(*(slice(None),) * k, 0)] *= 0.5
        return c, off

    def sole_error(self, pelvis: MovingPelvis) -> float:
        """How far a corner of a sole goes from where it stands, at most [m].

        Raises:
            ModelError: a corner would go too far.
        """
        placed = [
            self._placed(body, corner)
            for (body, _), corners in zip(self.legs, self.soles, strict=True)
            for corner in corners
        ]
        c, off = self._followed(pelvis, placed)
        joints = self.model.joints
        X = link_poses(self.rest[np.newaxis], joints.tree, joints.tree.every)
        (stand,) = place_points(X, *joints.select(placed))
        c[0, 0, 0] += pelvis.middle - stand
        for k, first in enumerate(np.eye(3, dtype=int)):  # degree 1 along an axis
            c[(*first, slice(None), k)] += pelvis.half[k]
        sums = np.abs(c).sum(axis=(0, 1, 2))
        error = float((np.linalg.norm(sums, axis=1) + off).max())
        if error > _SOLE:
            raise ModelError(
                f"{self.what}: the soles would move by up to {1e3 * error:.2f} mm; "
                "give a smaller box, or a rest posture with knees that are bent more"
            )
        return error

    # --- limits -------------------------------------------------------------------

    def _slopes(self, pelvis: MovingPelvis) -> np.ndarray:
        """(3, L) bounds of the joints' rates, by the base's place [rad/m].

        At most the largest at the middles of cells, and what it can change in one.
        """
        p, half = _cells(pelvis, 16)
        s = (p - pelvis.middle) / pelvis.half
        share = half / pelvis.half
        found = np.empty((3, len(self.names)))
        for axis in range(3):
            each = np.eye(3, dtype=int)[axis]
            T = np.ones((len(s), len(pelvis.degrees)))
            for k in range(3):
                table = _derivatives(s[:, k], _DEGREE, each[k])
                T *= table[:, pelvis.degrees[:, k]]
            found[axis] = np.abs(T @ pelvis.coefficients).max(axis=0)
            for k in range(3):
                more = each + np.eye(3, dtype=int)[k]
                bend = _sup(pelvis.degrees, more) @ np.abs(pelvis.coefficients)
                found[axis] += bend * share[k]
        return found / pelvis.half[:, np.newaxis]

    def check_limits(self, pelvis: MovingPelvis) -> None:
        """Raises ModelError: a joint of a leg would come too near a limit."""
        p, half = _cells(pelvis, 16)
        at = pelvis.positions(p)
        more = half @ self._slopes(pelvis) + _LIMIT
        lower = self.plant.GetPositionLowerLimits()[self.at]
        upper = self.plant.GetPositionUpperLimits()[self.at]
        low, high = at.min(axis=0) - more, at.max(axis=0) + more
        for j in np.flatnonzero((low < lower) | (high > upper)):
            raise ModelError(
                f"{self.what}: {self.names[j]} would be from {low[j]:.2f} to "
                f"{high[j]:.2f} rad, {_LIMIT} to spare; its limits are {lower[j]:.2f} "
                f"and {upper[j]:.2f}: give a smaller box, or another rest posture"
            )

    def speed(self, pelvis: MovingPelvis, wanted: float) -> np.ndarray:
        """(3,) with which no joint of a leg is faster than it may be [m/s]."""
        asked = wanted * self._slopes(pelvis).sum(axis=0)
        limits = self.model.velocity_limits[self.at]
        return np.full(3, wanted * min(1.0, float((_SLOWER * limits / asked).min())))

    # --- pairs --------------------------------------------------------------------

    def _reach(self, pelvis: MovingPelvis, placed: list) -> tuple[np.ndarray, ...]:
        """(3, P) bounds of points' rates by the base's place, and (P,) of (P1)."""
        c, off = self._followed(pelvis, placed)
        degrees = np.indices(c.shape[:3]).reshape(3, -1).T
        c = np.abs(c).reshape(len(degrees), -1)
        rates = np.array([_sup(degrees, each) @ c for each in np.eye(3, dtype=int)])
        rates = np.linalg.norm(rates.reshape(3, len(placed), 3), axis=2)
        return rates / pelvis.half[:, np.newaxis], off

    def check_pairs(self, pelvis: MovingPelvis) -> None:
        """Raises ModelError: two links of legs and base are not shown to be apart."""
        pairs, placed, first = self.model.pairs, [], []
        for body, axes in zip(pairs.bodies, pairs.axes, strict=True):
            for axis in axes:
                first.append(len(placed))
                placed += [self._placed(body, p) for p in axis.ends]
        if not len(pairs):
            return
        rates, off = self._reach(pelvis, placed)
        rates = np.maximum.reduceat(rates, first, axis=1)  # of each: its fastest end
        off = np.maximum.reduceat(off, first)
        a, b = pairs.closed_axes
        rates, off = rates[:, a] + rates[:, b], 2.0 * (off[a] + off[b])
        everything = np.full((1, len(a)), np.inf)
        p, half = _cells(pelvis, 4)
        for _ in range(_HALVINGS):
            q = self._configurations(pelvis, p)
            d = nearby_distances(
                q, np.repeat(everything, len(q), 0), self.model.robot_ahead
            )
            near = np.flatnonzero(d.min(axis=0) < _APART)
            if len(near):
                break
            open_ = (d - (half @ rates + off) < _APART).any(axis=1)
            if not open_.any():
                return
            half = 0.5 * half
            ways = half * np.array(list(product((-1.0, 1.0), repeat=3)))
            p = (p[open_][:, np.newaxis] + ways).reshape(-1, 3)
        d = d.min(axis=0)
        worst = int(np.argmin(d))
        link_a, link_b = pairs.names[pairs.pair_of_shapes[pairs.closed_rows[worst]]]
        raise ModelError(
            f"{self.what}: {link_a} and {link_b} come within {1e3 * d[worst]:.0f} mm "
            f"while the pelvis moves; {1e3 * _APART:.0f} mm are kept: give a smaller "
            "box, or another rest posture"
        )

    def with_swellings(self, pelvis: MovingPelvis) -> MovingPelvis:
        """With where legs are held on the base, and how far their capsules go from
        there."""
        inspector, placed, links = self.model.scene_graph.model_inspector(), [], []
        moved = self.model.joints.moved_by
        names = list(self.model.velocity_names)
        velocities = [names.index(name) for name in self.names]
        for index in range(1, self.plant.num_bodies()):
            body = self.plant.get_body(BodyIndex(index))
            frame, _ = self.model.joints.place(body)
            if not moved[frame][velocities].any():
                continue
            for geometry in self.plant.GetCollisionGeometriesForBody(body):
                X_BG = inspector.GetPoseInFrame(geometry).GetAsMatrix34()
                axis = shape_axis(inspector.GetShape(geometry), X_BG)
                if axis is None:
                    continue
                if axis.hull is not None and body.name() in self.watched:
                    raise ModelError(
                        f"{self.what}: {body.name()}: a box or a mesh cannot be made "
                        "thicker; give the links of legs capsules or spheres"
                    )
                placed += [self._placed(body, p) for p in (axis.p_B0, axis.p_B1)]
                links += 2 * [body.name()]
        rates, off = self._reach(pelvis, placed)
        p, half = _cells(pelvis, 32)
        refs = np.tile(pelvis.middle, (_HELD, 1))
        refs[:, 2] = np.linspace(pelvis.lower[2], pelvis.upper[2], _HELD)
        still = self._points(pelvis, refs, placed)
        away = np.zeros((_HELD, len(placed)))
        for some in np.array_split(p, 64):
            d = self._points(pelvis, some, placed) - still[:, np.newaxis]
            away = np.maximum(away, np.linalg.norm(d, axis=3).max(axis=1))
        best = int(np.argmin(away.sum(axis=1)))
        found: dict[str, float] = {}
        for link, far in zip(links, away[best] + half @ rates + 2.0 * off, strict=True):
            found[link] = max(found.get(link, 0.0), float(far))
        return replace(pelvis, held=refs[best], swellings=found)


def _cells(pelvis: MovingPelvis, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The middles (K, 3) of cells of the box, so many along each axis, and (3,) half of
    their edges [m]."""
    at = (2.0 * np.arange(count) + 1.0) / count - 1.0
    s = np.array(np.meshgrid(at, at, at, indexing="ij")).reshape(3, -1).T
    return pelvis.middle + pelvis.half * s, pelvis.half / count


def _derivatives(s: np.ndarray, most: int, k: int) -> np.ndarray:
    """(K, most + 1) the k-th derivatives of T_0, ..., T_most at (K,)."""
    each = np.eye(most + 1)
    return np.array(
        [chebyshev.chebval(s, chebyshev.chebder(c, k) if k else c) for c in each]
    ).T


def _sup(degrees: np.ndarray, times: Sequence[int]) -> np.ndarray:
    """(M,) the largest magnitudes of terms T_a T_b T_c, derived so often by each of s.

    Those of T_n's k-th derivative is that at 1, (n^2 (n^2 - 1) ... ) / (1 3 5 ...).
    """
    found = np.ones(len(degrees))
    for n, k in zip(degrees.T.astype(float), times, strict=True):
        for i in range(k):
            found *= np.maximum(n * n - i * i, 0.0) / (2.0 * i + 1.0)
    return found


def _along(degrees: np.ndarray, coefficients: np.ndarray, k: int) -> np.ndarray:
    """(3, L) bounds of the joints' k-th derivatives along each axis."""
    each = k * np.eye(3, dtype=int)
    return np.array([_sup(degrees, times) @ np.abs(coefficients) for times in each])


def _bells(S: np.ndarray) -> np.ndarray:
    """The complete Bell polynomials B_1 to B_N of (N,) values."""
    B = [1.0]
    for n in range(len(S)):
        B.append(sum(math.comb(n, k) * B[n - k] * S[k] for k in range(n + 1)))
    return np.array(B[1:])
