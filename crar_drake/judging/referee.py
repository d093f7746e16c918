"""The independent judge of a motion: distances, joint and speed limits, plainly.

It shares no code with the controller's distances: here a minimum over candidates that
is right by convexity. It is meant for judging trajectories afterwards and for tests.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    HalfSpace,
    Mesh,
    SceneGraph,
    SceneGraphInspector,
    Sphere,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from crar_drake.errors import ModelError
from crar_drake.judging.referee_distances import (
    Axis,
    capsule_distance,
    distance_of_axes,
    polytope,
)
from crar_drake.robot.description import LIMIT_TOLERANCE, SPEED_TOLERANCE, find_body


@dataclass(frozen=True)
class Violations:
    """What a trajectory of T samples violates.

    Speed limits are a matter of their own: they count neither in `count` nor in
    `num_violated`, so that figures from before they were judged stay comparable.
    """

    num_samples: int  # T
    count: np.ndarray  # (T,) violated limits plus penetrating pairs (Fig. 2)
    num_penetrating: int  # samples with any d < 0
    num_beyond_limit: int  # samples with any joint more than 1e-6 beyond its limit
    num_violated: int  # samples with either
    smallest_distance: float  # over all pairs and samples [m]; infinite without pairs
    smallest_distance_pair: tuple[str, str] | None  # None without pairs
    largest_limit_excess: float  # over all joints and samples [rad or m]; 0 if none
    largest_limit_excess_joint: str | None  # that joint; None if no joint is outside
    # samples with any joint faster than its limit by more than 1e-6 rad/s (or m/s);
    # None where no velocities were given
    num_beyond_speed: int | None = None
    largest_speed_excess: float = 0.0  # [rad/s or m/s]; 0 if none
    largest_speed_excess_joint: str | None = None  # None if none is too fast


class Referee:
    """Judges configurations of a plant by its own context and formulas.

    Give it the plant with the limits that count: of the control model, since those
    of the simulated robot may be lifted. Collision filters play no part.

    Attributes:
        plant: that it was given.
        pairs: (Nc) watched pairs of links, as they were given.
        joint_names: (nq,) joint of each position; a joint with several positions
            has its name repeated.
        lower, upper: (nq,) position limits at construction [rad or m].
        velocity_names: (nv,) joint of each velocity, likewise.
        slowest, fastest: (nv,) velocity limits [rad/s or m/s]; infinite where there is
            none.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        pairs: Iterable[Sequence[str]],
        velocity_limits: np.ndarray | None = None,
    ) -> None:
        """
        Args:
            plant: finalized, and registered as a source of geometry.
            scene_graph: where it is registered.
            pairs: two links each, by name, plain or scoped; "world" for geometry
                that is fixed to the world.
            velocity_limits: (nv,) largest speeds that count [rad/s or m/s]; by default
                those of the plant, where a limit of 0 says that none is stated.

        Raises:
            ModelError: the plant is not finalized or not registered, a link does
                not exist, or has no collision shape, or one that is neither sphere
                nor capsule nor half space, nor a box or a convex hull (a mesh is one).
            ValueError: `velocity_limits` has another size, or a NaN.
        """
        if not plant.is_finalized():
            raise ModelError("the referee needs a finalized plant: call Finalize()")
        if not plant.geometry_source_is_registered():
            raise ModelError(
                "the referee needs a plant that is registered with a SceneGraph"
            )
        self.plant = plant
        self._context = plant.CreateDefaultContext()
        self.pairs = tuple((str(a), str(b)) for a, b in pairs)
        self.lower = plant.GetPositionLowerLimits()
        self.upper = plant.GetPositionUpperLimits()
        of_q, of_v = [""] * plant.num_positions(), [""] * plant.num_velocities()
        for joint in map(plant.get_joint, plant.GetJointIndices()):
            q, nq = joint.position_start(), joint.num_positions()
            v, nv = joint.velocity_start(), joint.num_velocities()
            of_q[q : q + nq] = [joint.name()] * nq
            of_v[v : v + nv] = [joint.name()] * nv
        self.joint_names, self.velocity_names = tuple(of_q), tuple(of_v)
        self.slowest, self.fastest = _speed_limits(plant, velocity_limits)

        inspector = scene_graph.model_inspector()
        shapes: dict[str, list[int]] = {}
        self._bodies, self._axes, self._body_of = [], [], []
        for name in (name for pair in self.pairs for name in pair):
            if name not in shapes:
                body = find_body(plant, name)
                axes = _body_axes(plant, inspector, body)
                first = len(self._axes)
                shapes[name] = list(range(first, first + len(axes)))
                self._body_of += [len(self._bodies)] * len(axes)
                self._bodies.append(body)
                self._axes += axes
        together = [
            (column, i, j)
            for column, (a, b) in enumerate(self.pairs)
            for i in shapes[a]
            for j in shapes[b]
        ]
        self._together = np.array(together, dtype=int).reshape(-1, 3)
        of_all = [[axis.start, axis.end] for axis in self._axes]
        self._ends_B = np.array(of_all).reshape(-1, 2, 3)
        self._radii = np.array([axis.radius for axis in self._axes])
        self._balls = np.array([axis.ball for axis in self._axes])
        hulls = np.array([axis.hull is not None for axis in self._axes], dtype=bool)
        self._plain = ~hulls & np.isfinite(self._radii)

    def distances(self, q: np.ndarray) -> np.ndarray:
        """Signed distance of each watched pair: the smallest over its shape pairs.

        Args:
            q: (nq,) positions of the plant.

        Returns:
            (Nc,) distances [m], in the order of `pairs`.

        Raises:
            ValueError: q has another size, or is not finite.
        """
        found = self.distances_below(q, math.inf)
        return np.array([found[column] for column in range(len(self.pairs))])

    def nearest(
        self, q: np.ndarray, bound: float = math.inf
    ) -> tuple[float, tuple[str, str] | None]:
        """The smallest distance of all pairs, if it is below a bound.

        Args:
            q: (nq,) positions of the plant.
            bound: what is farther apart than this is of no interest [m].

        Returns:
            The distance [m] and the pair, exact if the distance is below `bound`; else
            a distance that is not below it, or infinite and None.

        Raises:
            ValueError: q has another size, or is not finite.
        """
        near = self.distances_below(q, bound)
        if not near:
            return math.inf, None
        column = min(near, key=near.get)
        return near[column], self.pairs[column]

    def limit_excess(self, q: np.ndarray) -> np.ndarray:
        """By how much each position is outside its limits.

        Args:
            q: (..., nq) positions of the plant.

        Returns:
            (..., nq) excess [rad or m], in the order of `joint_names`; 0 within the
            limits, and where there are none.

        Raises:
            ValueError: q has another size, or is not finite.
        """
        q = _checked(q, "q", "position", self.joint_names)
        return np.maximum(0.0, np.maximum(self.lower - q, q - self.upper))

    def speed_excess(self, v: np.ndarray) -> np.ndarray:
        """By how much each velocity is outside its limits.

        Args:
            v: (..., nv) velocities of the plant.

        Returns:
            (..., nv) excess [rad/s or m/s], in the order of `velocity_names`; 0 within
            the limits, and where there are none.

        Raises:
            ValueError: v has another size, or is not finite.
        """
        v = _checked(v, "v", "velocity", self.velocity_names)
        return np.maximum(0.0, np.maximum(self.slowest - v, v - self.fastest))

    def violations(
        self, q_trajectory: np.ndarray, v_trajectory: np.ndarray | None = None
    ) -> Violations:
        """Judges every sample of a trajectory.

        A sample is violated if a pair has d < 0, or if a joint is beyond its limit
        by more than 1e-6 rad (or m). Speeds are counted apart.

        Args:
            q_trajectory: (T, nq) positions of the plant.
            v_trajectory: (T, nv) its velocities, for the speeds to be judged.

        Raises:
            ValueError: one has another shape, no sample, or is not finite.
        """
        q_trajectory = np.asarray(q_trajectory, dtype=float)
        if q_trajectory.ndim != 2 or len(q_trajectory) == 0:
            raise ValueError(
                f"q_trajectory must be (T, nq) with T > 0, not {q_trajectory.shape}"
            )
        excess = self.limit_excess(q_trajectory)
        num_limits = np.sum(excess > LIMIT_TOLERANCE, axis=1)
        num_penetrating_pairs = np.zeros(len(q_trajectory), dtype=int)
        smallest_distance, pair = math.inf, None
        for index, q in enumerate(q_trajectory):
            # Only what may be in contact, or the smallest so far, is worth a look.
            near = self.distances_below(q, max(smallest_distance, 0.0))
            num_penetrating_pairs[index] = sum(d < 0.0 for d in near.values())
            for column, d in near.items():
                if d < smallest_distance:
                    smallest_distance, pair = d, self.pairs[column]
        count = num_penetrating_pairs + num_limits

        return Violations(
            num_samples=len(q_trajectory),
            count=count,
            num_penetrating=int(np.sum(num_penetrating_pairs > 0)),
            num_beyond_limit=int(np.sum(num_limits > 0)),
            num_violated=int(np.sum(count > 0)),
            smallest_distance=float(smallest_distance),
            smallest_distance_pair=pair,
            **_largest("limit", excess, self.joint_names),
            **({} if v_trajectory is None else self._speeds(v_trajectory, len(count))),
        )

    def _speeds(self, v_trajectory: np.ndarray, num_samples: int) -> dict:
        """The fields of `Violations` that tell of speeds."""
        v_trajectory = np.asarray(v_trajectory, dtype=float)
        if v_trajectory.ndim != 2 or len(v_trajectory) != num_samples:
            raise ValueError(
                f"v_trajectory must be ({num_samples}, nv), not {v_trajectory.shape}"
            )
        excess = self.speed_excess(v_trajectory)
        beyond = int((excess > SPEED_TOLERANCE).any(axis=1).sum())
        return {
            "num_beyond_speed": beyond,
            **_largest("speed", excess, self.velocity_names),
        }

    def distances_below(self, q: np.ndarray, bound: float) -> dict[int, float]:
        """Distances of the pairs that may be nearer than `bound`, by pair number.

        All that are nearer are there; others may be.

        A shape lies in the ball about its axis' middle, so that the balls' distance
        is never more than the shapes'.
        """
        q = np.asarray(q, dtype=float)
        if q.ndim != 1:
            raise ValueError(f"q must be ({len(self.joint_names)},), not {q.shape}")
        q = _checked(q, "q", "position", self.joint_names)
        self.plant.SetPositions(self._context, q)
        if not len(self._together):
            return {}
        X_WB = [
            self.plant.EvalBodyPoseInWorld(self._context, body) for body in self._bodies
        ]
        X = np.array([each.GetAsMatrix34() for each in X_WB])[self._body_of]
        ends = self._ends_B @ X[:, :, :3].swapaxes(1, 2) + X[:, None, :, 3]
        columns, i, j = self._together.T
        centres = ends.mean(axis=1)
        apart = np.sqrt(np.square(centres[i] - centres[j]).sum(axis=1))
        # A hair of tolerance, for the rounding of the balls.
        near = apart < self._balls[i] + self._balls[j] + bound + 1e-9
        columns, i, j = columns[near], i[near], j[near]
        d = np.empty(len(columns))
        plain = self._plain[i] & self._plain[j]
        both = [
            of_end
            for k in (i[plain], j[plain])
            for of_end in (ends[k, 0], ends[k, 1], self._radii[k])
        ]
        d[plain], _, _ = capsule_distance(*both)
        for row in np.flatnonzero(~plain):
            placed = [
                self._axes[k].moved(X_WB[self._body_of[k]]) for k in (i[row], j[row])
            ]
            d[row] = distance_of_axes(*placed, enough=bound)
        found: dict[int, float] = {}
        for column, distance in zip(columns.tolist(), d.tolist(), strict=True):
            found[column] = min(distance, found.get(column, math.inf))
        return found


def _speed_limits(
    plant: MultibodyPlant, given: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """(nv,) the least and the largest velocities, see `Referee`."""
    slowest, fastest = plant.GetVelocityLowerLimits(), plant.GetVelocityUpperLimits()
    if given is None:
        stated = (slowest != 0.0) & (fastest != 0.0)
        return np.where(stated, slowest, -np.inf), np.where(stated, fastest, np.inf)
    limits = np.array(given, dtype=float)
    if limits.shape != fastest.shape or np.isnan(limits).any():
        raise ValueError(
            f"velocity_limits must be {fastest.shape} without NaN, not {limits}"
        )
    return -limits, limits


def _checked(
    values: np.ndarray, what: str, kind: str, names: Sequence[str]
) -> np.ndarray:
    """(..., N) values of joints. A comparison with NaN is false: it would pass as no
    violation.

    Raises:
        ValueError: one is not finite, or they are not as many.
    """
    values = np.asarray(values, dtype=float)
    if values.shape[-1:] != (len(names),):
        raise ValueError(f"{what} must be ({len(names)},), not {values.shape[-1:]}")
    for place in np.argwhere(~np.isfinite(values)):
        name, value = names[place[-1]], values[tuple(place)]
        raise ValueError(f"{kind} of joint {name!r} is {value}")
    return values


def _largest(what: str, excess: np.ndarray, names: Sequence[str]) -> dict:
    """The fields of `Violations` with the largest of (T, N) excesses, if any is."""
    joint = names[excess.argmax() % len(names)] if excess.any() else None
    return {
        f"largest_{what}_excess": float(excess.max(initial=0.0)),
        f"largest_{what}_excess_joint": joint,
    }


def _body_axes(
    plant: MultibodyPlant, inspector: SceneGraphInspector, body: RigidBody
) -> list[Axis]:
    """The collision shapes of a body as axes with a radius."""
    axes = []
    for geometry in plant.GetCollisionGeometriesForBody(body):
        shape = inspector.GetShape(geometry)
        X_BG = inspector.GetPoseInFrame(geometry)
        if isinstance(shape, HalfSpace):
            up = X_BG.multiply(np.array([0.0, 0.0, 1.0]))
            axes.append(Axis(X_BG.translation(), up, math.inf))
            continue
        if isinstance(shape, Box | Convex | Mesh):
            hull = polytope(X_BG.multiply(_corners(shape).T).T)
            middle = hull.points.mean(axis=0)
            axes.append(Axis(middle, middle, 0.0, hull))
            continue
        if isinstance(shape, Sphere):
            half_length = 0.0
        elif isinstance(shape, Capsule):
            half_length = 0.5 * shape.length()
        else:
            raise ModelError(
                f"link {body.name()!r}: collision geometry "
                f"{inspector.GetName(geometry)!r} is a {type(shape).__name__}; the "
                "referee knows only Sphere, Capsule, Box, Convex, Mesh and HalfSpace"
            )
        # Drake's capsule lies along z of its geometry frame, centred.
        p_B0 = X_BG.multiply(np.array([0.0, 0.0, -half_length]))
        p_B1 = X_BG.multiply(np.array([0.0, 0.0, half_length]))
        axes.append(Axis(p_B0, p_B1, shape.radius()))
    if not axes:
        raise ModelError(
            f"link {body.name()!r} is in a watched pair, but has no collision geometry"
        )
    return axes


def _corners(shape: Box | Convex | Mesh) -> np.ndarray:
    """(N, 3) points in the geometry frame of which a shape is the hull [m]."""
    if isinstance(shape, Box):
        return shape.size() * (np.indices((2, 2, 2)).reshape(3, -1).T - 0.5)
    hull = shape.GetConvexHull()
    return np.array([hull.vertex(i) for i in range(hull.num_vertices())])
