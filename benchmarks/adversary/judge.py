"""The adversary's judge: whole trajectories at once, in NumPy, and nothing shared.

It reads joints and shapes from the plant, and computes everything else itself: where
the links are, how far watched shapes are apart, and what that violates. Neither the
controller's kinematics and distances nor Drake's take part;
`tests/benchmarks/test_adversary.py` compares it with SceneGraph.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pydrake.geometry import Capsule, SceneGraph, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint, RigidBody, WeldJoint

from crar_drake.errors import ModelError
from crar_drake.robot.description import LIMIT_TOLERANCE, find_body

SPEED_TOLERANCE = 1e-6  # share of a speed limit that rounding may exceed it by
PATH_POINTS = 20  # of a braking path
WAY_POINTS = 8  # between one state and the next
CHUNK = 512  # configurations at a time, so that arrays stay in the caches

# Axes whose sine is below this have their distance at an end of one of them.
_PARALLEL = 1e-6


@dataclass
class Verdict:
    """What a trajectory violates.

    Attributes:
        states: how many were judged.
        penetrating: states with a pair at d < 0.
        beyond_limit: states with a controlled joint beyond its limit.
        too_fast: states with a controlled joint faster than its speed limit.
        ahead: control steps whose braking path ends with a joint beyond its limit.
        paths: braking paths, and ways from state to state, that were sampled.
        blocked: those of them on which a pair penetrates.
        clearance, pair: the smallest distance at a state [m], and of which pair.
        path_clearance, path_pair: the same on the sampled paths.
        excess, joint: the farthest beyond a limit, on paths too [rad or m].
        overspeed: the largest |v| over its limit; 0 where nothing has one.
        first: the first state that violates anything but speed; None if none does.
    """

    states: int = 0
    penetrating: int = 0
    beyond_limit: int = 0
    too_fast: int = 0
    ahead: int = 0
    paths: int = 0
    blocked: int = 0
    clearance: float = np.inf
    pair: str = ""
    path_clearance: float = np.inf
    path_pair: str = ""
    excess: float = 0.0
    joint: str = ""
    overspeed: float = 0.0
    first: int | None = None

    @property
    def unsafe(self) -> bool:
        """Whether a pair or a joint limit is violated, at a state or on a path."""
        return bool(self.penetrating + self.beyond_limit + self.ahead + self.blocked)

    @property
    def violated(self) -> bool:
        """The same, or a speed limit."""
        return self.unsafe or self.too_fast > 0


@dataclass(frozen=True)
class _Joint:
    """How a body hangs on another: X_PC(q) = before * motion(q) * after."""

    parent: int
    child: int
    before: tuple[np.ndarray, np.ndarray]  # (3, 3), (3,)
    after: tuple[np.ndarray, np.ndarray]
    column: int  # of q; -1 for a weld
    axis: np.ndarray  # (3,) in the frame on the parent
    turns: bool


@dataclass
class _Axes:
    """All watched capsule axes, in their bodies' frames."""

    body: list[int] = field(default_factory=list)
    start: list[np.ndarray] = field(default_factory=list)
    end: list[np.ndarray] = field(default_factory=list)
    radius: list[float] = field(default_factory=list)


class Judge:
    """Judges configurations and states of a plant whose joints have one position each.

    Attributes:
        pair_names: per shape pair "link a - link b".
        controlled: columns of q and v that limits count for.
        joint_names: their joints.
        lower, upper, fastest: (n,) their limits [rad, rad/s], infinite if none.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        pairs: Sequence[Sequence[str]],
        prescribed: Sequence[str] = (),
    ) -> None:
        """
        Args:
            plant: finalized.
            scene_graph: where it is registered.
            pairs: watched links, two each.
            prescribed: joints whose limits do not count.

        Raises:
            ModelError: a joint has several positions, or a watched shape is neither a
                capsule nor a sphere.
        """
        self._joints = _read_joints(plant)
        axes, of_body = _Axes(), {}
        for name in (name for pair in pairs for name in pair):
            if name not in of_body:
                of_body[name] = _read_axes(
                    plant, scene_graph, find_body(plant, name), axes
                )
        together = [
            (a, b, f"{first} - {second}")
            for first, second in pairs
            for a in of_body[first]
            for b in of_body[second]
        ]
        self.pair_names = [name for _, _, name in together]
        self._a = np.array([a for a, _, _ in together], dtype=int)
        self._b = np.array([b for _, b, _ in together], dtype=int)
        self._body = np.array(axes.body, dtype=int)
        self._start = np.array(axes.start).reshape(-1, 3)
        self._end = np.array(axes.end).reshape(-1, 3)
        self._radius = np.array(axes.radius)
        half = 0.5 * np.linalg.norm(self._end - self._start, axis=1)
        ball = half + self._radius
        self._radii = self._radius[self._a] + self._radius[self._b]
        self._balls = ball[self._a] + ball[self._b]
        self._num_bodies = plant.num_bodies()
        self.controlled, self.joint_names = _columns(plant, prescribed)
        c = self.controlled
        self.lower = plant.GetPositionLowerLimits()[c]
        self.upper = plant.GetPositionUpperLimits()[c]
        self.fastest = np.minimum(
            plant.GetVelocityUpperLimits(), -plant.GetVelocityLowerLimits()
        )[c]

    def axes(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ends of all watched axes in the world, (T, A, 3) each [m], for q (T, nq)."""
        T = len(q)
        R = np.zeros((self._num_bodies, T, 3, 3))
        p = np.zeros((self._num_bodies, T, 3))
        R[0] = np.eye(3)
        for joint in self._joints:
            (R_before, p_before), (R_after, p_after) = joint.before, joint.after
            R_P, p_P = R[joint.parent], p[joint.parent]
            R_F = R_P @ R_before
            p_F = p_P + R_P @ p_before
            if joint.column >= 0:
                x = q[:, joint.column]
                if joint.turns:
                    R_F = R_F @ _rotations(joint.axis, x)
                else:
                    p_F = p_F + (R_F @ joint.axis) * x[:, None]
            p[joint.child] = p_F + R_F @ p_after
            R[joint.child] = R_F @ R_after
        start = np.empty((T, len(self._body), 3))
        end = np.empty_like(start)
        for k, body in enumerate(self._body):
            start[:, k] = p[body] + R[body] @ self._start[k]
            end[:, k] = p[body] + R[body] @ self._end[k]
        return start, end

    def distances(self, q: np.ndarray) -> np.ndarray:
        """(T, N) signed distance of every watched shape pair [m], for q (T, nq)."""
        start, end = self.axes(np.asarray(q, dtype=float))
        shape = (len(start), len(self._a))
        d = segment_distances(
            *(x.reshape(-1, 3) for x in self._ends(start, end, slice(None)))
        )
        return d.reshape(shape) - self._radii

    def nearest(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The smallest distance (T,) [m] of each configuration, and its shape pair.

        Exact: a shape pair is left out only where its enclosing balls are farther
        apart than the distance of another pair.
        """
        q = np.asarray(q, dtype=float)
        d, pair = np.full(len(q), np.inf), np.zeros(len(q), dtype=int)
        if len(self._a):
            for low in range(0, len(q), CHUNK):
                part = slice(low, low + CHUNK)
                d[part], pair[part] = self._nearest(q[part])
        return d, pair

    def _nearest(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        start, end = self.axes(q)
        middle = 0.5 * (start + end)
        apart = middle[:, self._a] - middle[:, self._b]
        bound = np.sqrt(np.einsum("tni,tni->tn", apart, apart)) - self._balls
        rows = np.arange(len(q))
        guess = bound.argmin(axis=1)
        best = self._exact(start, end, rows, guess)
        row, column = np.nonzero(bound <= best[:, None])
        d = self._exact(start, end, row, column)
        table = np.full(bound.shape, np.inf)
        table[row, column] = d
        pair = table.argmin(axis=1)
        return table[rows, pair], pair

    def _exact(self, start, end, row, column) -> np.ndarray:
        a, b = self._a[column], self._b[column]
        d = segment_distances(start[row, a], end[row, a], start[row, b], end[row, b])
        return d - self._radii[column]

    def _ends(self, start, end, columns):
        a, b = self._a[columns], self._b[columns]
        return start[:, a], end[:, a], start[:, b], end[:, b]

    def excess(self, q: np.ndarray) -> np.ndarray:
        """(T, n) by how much controlled joints are beyond their limits, 0 within."""
        x = q[:, self.controlled]
        return np.maximum(0.0, np.maximum(self.lower - x, x - self.upper))

    def path_is_clear(
        self, q: np.ndarray, v: np.ndarray, horizon: float, margin: float = 0.0
    ) -> bool:
        """Whether braking from a state (nq,), (nv,) keeps `margin` [m], and limits."""
        path = q + np.linspace(0.0, horizon, 4 * PATH_POINTS)[:, None] * v
        within = self.excess(path).max(initial=0.0) == 0.0
        slow = np.all(np.abs(v[self.controlled]) <= self.fastest)
        return bool(within and slow and self.nearest(path)[0].min() >= margin)

    def judge(
        self,
        q: np.ndarray,
        v: np.ndarray,
        horizon: float,
        rng: np.random.Generator,
        share: float = 0.02,
        per_step: int = 1,
    ) -> Verdict:
        """Judges a trajectory.

        Where a braking path ends is judged at control steps, where it is claimed to be
        clear. In between it may bulge by |q_ddot| period^2 / 8 beyond both ends; the
        robot does not go there, for at the next control step it is back.

        Args:
            q, v: (K + 1, nq), (K + 1, nv) states.
            horizon: T of braking [s].
            rng: chooses the states whose paths are sampled.
            share: of the control steps; those nearest to a contact are added.
            per_step: states a control step.
        """
        with np.errstate(all="ignore"):
            d, pair = self.nearest(q)
            here = self.excess(q)
            there = self.excess(q[::per_step] + horizon * v[::per_step])
            rates = np.abs(v[:, self.controlled]) / self.fastest
        beyond = (here > LIMIT_TOLERANCE).any(axis=1)
        ahead = (there > LIMIT_TOLERANCE).any(axis=1)
        fast = (rates > 1.0 + SPEED_TOLERANCE).any(axis=1)
        chosen = np.unique(
            np.concatenate(
                [
                    np.flatnonzero(rng.random(len(there)) < share),
                    np.argsort(d[::per_step], kind="stable")[:3],
                ]
            )
        )
        chosen *= per_step
        path_d, path_pair = self._sampled_paths(q, v, horizon, chosen)
        k, j = int(d.argmin()), int(path_d.argmin())
        worst = here if here.max() >= there.max() else there
        joint = int(worst.max(axis=0).argmax())
        bad = (d < 0.0) | beyond
        bad[::per_step] |= ahead
        bad[chosen] |= path_d < 0.0
        return Verdict(
            states=len(q),
            penetrating=int((d < 0.0).sum()),
            beyond_limit=int(beyond.sum()),
            too_fast=int(fast.sum()),
            ahead=int(ahead.sum()),
            paths=len(chosen),
            blocked=int((path_d < 0.0).sum()),
            clearance=float(d[k]),
            pair=self._name(pair[k]),
            path_clearance=float(path_d[j]),
            path_pair=self._name(path_pair[j]),
            excess=float(worst.max()),
            joint=self.joint_names[joint] if worst.max() > 0.0 else "",
            overspeed=float(rates.max()),
            first=int(bad.argmax()) if bad.any() else None,
        )

    def _sampled_paths(self, q, v, horizon, chosen) -> tuple[np.ndarray, np.ndarray]:
        """Per chosen state the smallest distance on its braking path and on the way
        to the next state, and the shape pair."""
        times = np.linspace(0.0, horizon, PATH_POINTS)
        braking = q[chosen, None] + times[:, None] * v[chosen, None]
        following = q[np.minimum(chosen + 1, len(q) - 1)]
        shares = np.linspace(0.0, 1.0, WAY_POINTS)[:, None]
        way = q[chosen, None] + shares * (following - q[chosen])[:, None]
        points = np.concatenate([braking, way], axis=1)
        d, pair = self.nearest(points.reshape(-1, q.shape[1]))
        d, pair = d.reshape(len(chosen), -1), pair.reshape(len(chosen), -1)
        k = d.argmin(axis=1)
        rows = np.arange(len(chosen))
        return d[rows, k], pair[rows, k]

    def _name(self, pair: int) -> str:
        return self.pair_names[pair] if self.pair_names else ""


def segment_distances(
    a0: np.ndarray, a1: np.ndarray, b0: np.ndarray, b1: np.ndarray
) -> np.ndarray:
    """Distances (N,) of segments a0 a1 and b0 b1, (N, 3) ends each.

    The smallest of five candidates: each end against the other segment, and the
    common normal of both lines where it meets both of them inside.
    """
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    squared = np.minimum(
        np.minimum(_point_to_segment(a0, b0, v), _point_to_segment(a1, b0, v)),
        np.minimum(_point_to_segment(b0, a0, u), _point_to_segment(b1, a0, u)),
    )
    normal = np.cross(u, v)
    length = np.einsum("ni,ni->n", normal, normal)
    sizes = np.einsum("ni,ni->n", u, u) * np.einsum("ni,ni->n", v, v)
    crossing = length > _PARALLEL**2 * sizes
    per_length = np.divide(1.0, length, out=np.zeros_like(length), where=crossing)
    s = np.einsum("ni,ni->n", np.cross(v, w), normal) * per_length
    t = np.einsum("ni,ni->n", np.cross(u, w), normal) * per_length
    inside = crossing & (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
    across = np.einsum("ni,ni->n", w, normal) ** 2 * per_length
    return np.sqrt(np.where(inside, np.minimum(across, squared), squared))


def _point_to_segment(x, start, along) -> np.ndarray:
    """Squared distances (N,) of points to segments."""
    from_start = x - start
    length = np.einsum("ni,ni->n", along, along)
    share = np.divide(
        np.einsum("ni,ni->n", from_start, along),
        length,
        out=np.zeros_like(length),
        where=length > 0.0,
    )
    gap = from_start - np.clip(share, 0.0, 1.0)[:, None] * along
    return np.einsum("ni,ni->n", gap, gap)


def _rotations(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(T, 3, 3) rotations about a unit axis: Rodrigues' formula."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + s * K + (1.0 - c) * (K @ K)


def _parts(X: RigidTransform) -> tuple[np.ndarray, np.ndarray]:
    return X.rotation().matrix(), X.translation()


def _read_joints(plant: MultibodyPlant) -> list[_Joint]:
    """All joints, those of the world's children first."""
    waiting = [plant.get_joint(index) for index in plant.GetJointIndices()]
    known, joints = {0}, []
    while waiting:
        ready = [j for j in waiting if int(j.parent_body().index()) in known]
        if not ready:
            names = ", ".join(j.name() for j in waiting)
            raise ModelError(f"these joints do not hang on the world: {names}")
        for joint in ready:
            waiting.remove(joint)
            known.add(int(joint.child_body().index()))
            column, axis, turns = -1, np.zeros(3), False
            if isinstance(joint, RevoluteJoint):
                column, turns = joint.position_start(), True
                axis = joint.revolute_axis()
            elif isinstance(joint, PrismaticJoint):
                column, axis = joint.position_start(), joint.translation_axis()
            elif not isinstance(joint, WeldJoint):
                raise ModelError(
                    f"joint {joint.name()!r} is a {type(joint).__name__}; the judge "
                    "knows revolute, prismatic and fixed ones"
                )
            after = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
            if column < 0:
                after = joint.X_FM().multiply(after)
            joints.append(
                _Joint(
                    int(joint.parent_body().index()),
                    int(joint.child_body().index()),
                    _parts(joint.frame_on_parent().GetFixedPoseInBodyFrame()),
                    _parts(after),
                    column,
                    np.asarray(axis, dtype=float),
                    turns,
                )
            )
    return joints


def _read_axes(
    plant: MultibodyPlant, scene_graph: SceneGraph, body: RigidBody, axes: _Axes
) -> range:
    """Adds the shapes of a body, and returns their numbers."""
    inspector = scene_graph.model_inspector()
    first = len(axes.body)
    for geometry in plant.GetCollisionGeometriesForBody(body):
        shape = inspector.GetShape(geometry)
        if not isinstance(shape, (Capsule, Sphere)):
            raise ModelError(
                f"link {body.name()!r} has a {type(shape).__name__}; the judge knows "
                "capsules and spheres"
            )
        half = 0.5 * shape.length() if isinstance(shape, Capsule) else 0.0
        R, p = _parts(inspector.GetPoseInFrame(geometry))
        axes.body.append(int(body.index()))
        axes.start.append(p - half * R[:, 2])
        axes.end.append(p + half * R[:, 2])
        axes.radius.append(shape.radius())
    return range(first, len(axes.body))


def _columns(
    plant: MultibodyPlant, prescribed: Sequence[str]
) -> tuple[np.ndarray, list[str]]:
    """Columns of q of the joints that are not prescribed, and the joints' names."""
    found = {}
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        if joint.num_positions() and joint.name() not in prescribed:
            found[joint.position_start()] = joint.name()
    columns = sorted(found)
    return np.array(columns, dtype=int), [found[c] for c in columns]
