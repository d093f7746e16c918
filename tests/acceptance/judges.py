"""A judge of robots, by Drake's parser and formulas of its own.

It reads the robot's own file. Poses are those of the joints' frames, one after the
other, of many states at once; distances are exhaustive: of two segments the smallest of
all candidates, for each pair of shapes. Torques and what the ground must give are
Drake's inverse dynamics. Nothing here comes from the product.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Capsule, HalfSpace, QueryObject, SceneGraph, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint, MultibodyForces, RigidBody
from pydrake.systems.framework import Diagram, DiagramBuilder
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, HalfspaceIntersection

CHUNK = 4000  # states whose distances are computed at once
TINY = 1e-30


class RobotJudge:
    """What is true of a robot at its states.

    Attributes:
        plant, scene_graph: parsed from the file, the base welded where it stands.
        context: of the plant, at the state of whoever used it last.
        joints: (n,) names of the joints, each with one position, in the plant's order:
            that of all vectors.
        lower, upper, speeds, efforts: (n,) their limits, infinite where there are none.
        pairs: (P,) names of the two links of each watched pair.
    """

    def __init__(
        self,
        file: Path,
        pairs: Iterable[Sequence[str]] = (),
        *,
        base: str = "",
        place: ArrayLike = (0.0, 0.0, 0.0),
        turn: ArrayLike = (0.0, 0.0, 0.0),
        time_step: float = 0.0,
    ) -> None:
        """
        Args:
            file: URDF, SDF or model directives.
            pairs: links that are watched, two each.
            base: the link that is welded to the world; "" if the file does so.
            place, turn: of the base, in metres and by roll, pitch and yaw [rad].
            time_step: of the plant [s], 0 if it is continuous.
        """
        self._file, self._base = Path(file), base
        self._X_WB = RigidTransform(RollPitchYaw(turn), place)
        self.plant, self.scene_graph, diagram = self._parse(time_step, welded=True)
        self._root = diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self._root)
        every = [self.plant.get_joint(i) for i in self.plant.GetJointIndices()]
        self._carriers = {int(j.child_body().index()): j for j in every}
        moving = sorted(
            (j for j in every if j.num_positions()), key=lambda j: j.position_start()
        )
        if any(j.num_positions() != 1 for j in moving):
            raise ValueError("joints have one position each")
        self.joints = [j.name() for j in moving]
        self.lower = self.plant.GetPositionLowerLimits()
        self.upper = self.plant.GetPositionUpperLimits()
        speeds = self.plant.GetVelocityUpperLimits()
        self.speeds = np.where(speeds > 0.0, speeds, np.inf)
        self.damping = np.array([j.default_damping_vector()[0] for j in moving])
        self.efforts = np.full(len(moving), np.inf)
        for i in self.plant.GetJointActuatorIndices():
            motor = self.plant.get_joint_actuator(i)
            if motor.effort_limit() > 0.0:
                self.efforts[motor.joint().velocity_start()] = motor.effort_limit()
        self.pairs = [tuple(pair) for pair in pairs]
        self._gather_shapes()

    # --- the robot ----------------------------------------------------------------

    def _parse(
        self, time_step: float, welded: bool
    ) -> tuple[MultibodyPlant, SceneGraph, Diagram]:
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step)
        parser = Parser(plant)
        package = self._file.parent / "package.xml"
        if package.is_file():
            parser.package_map().AddPackageXml(str(package))
        parser.AddModels(str(self._file))
        if welded and self._base:
            frame = find_link(plant, self._base).body_frame()
            plant.WeldFrames(plant.world_frame(), frame, self._X_WB)
        plant.Finalize()
        return plant, scene_graph, builder.Build()

    def _gather_shapes(self) -> None:
        """The segments and radii of all links of pairs, planes, and who meets whom."""
        bodies, ends, radii, planes = [], [], [], {}
        self._of_link: dict[str, list[int]] = {}
        inspector = self.scene_graph.model_inspector()
        for name in sorted({link for pair in self.pairs for link in pair}):
            body = find_link(self.plant, name)
            self._of_link[name] = []
            for shape_id in self.plant.GetCollisionGeometriesForBody(body):
                shape, X = (
                    inspector.GetShape(shape_id),
                    inspector.GetPoseInFrame(shape_id),
                )
                half, radius = 0.0, 0.0
                if isinstance(shape, Capsule):
                    half, radius = 0.5 * shape.length(), shape.radius()
                elif isinstance(shape, Sphere):
                    radius = shape.radius()
                elif isinstance(shape, HalfSpace):
                    planes[len(radii)] = X.rotation().col(2)
                else:
                    raise ValueError(f"{name}: no judge of a {type(shape).__name__}")
                axis = half * X.rotation().col(2)
                self._of_link[name].append(len(radii))
                bodies.append(int(body.index()))
                ends.append((X.translation() - axis, X.translation() + axis))
                radii.append(radius)
        self._bodies, self._radii = bodies, np.array(radii)
        self._ends = np.array(ends).reshape(-1, 2, 3)
        met = [
            (number, a, b)
            for number, pair in enumerate(self.pairs)
            for a in self._of_link[pair[0]]
            for b in self._of_link[pair[1]]
        ]
        swapped = [(k, b, a) if a in planes else (k, a, b) for k, a, b in met]
        self._on_plane = [
            (*each, planes[each[2]]) for each in swapped if each[2] in planes
        ]
        rest = [each for each in swapped if each[2] not in planes]
        self._met = np.array(rest, dtype=int).reshape(-1, 3)

    def at(self, names: Sequence[str]) -> list[int]:
        """Where joints of these names stand in all vectors."""
        return [self.joints.index(name.split("::")[-1]) for name in names]

    # --- poses and distances ------------------------------------------------------

    def poses(self, q: np.ndarray) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """Rotation (N, 3, 3) and place (N, 3) in the world of each body, by its index.

        Args:
            q: (N, n) positions [rad or m].
        """
        N = len(q)
        world = int(self.plant.world_body().index())
        known = {world: (np.broadcast_to(np.eye(3), (N, 3, 3)), np.zeros((N, 3)))}

        def find(body: int) -> tuple[np.ndarray, np.ndarray]:
            if body not in known:
                joint = self._carriers[body]
                R, p = find(int(joint.parent_body().index()))
                X_PF = joint.frame_on_parent().GetFixedPoseInBodyFrame()
                R, p = moved(R, p, X_PF.rotation().matrix(), X_PF.translation())
                R, p = moved(R, p, *across(joint, q))
                X_MB = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
                known[body] = moved(R, p, X_MB.rotation().matrix(), X_MB.translation())
            return known[body]

        for i in range(self.plant.num_bodies()):
            find(i)
        return known

    def link_points(self, name: str, points: ArrayLike, q: np.ndarray) -> np.ndarray:
        """(N, K, 3) where points (K, 3) of a link are in the world [m]."""
        R, p = self.poses(q)[int(find_link(self.plant, name).index())]
        return np.einsum("nij,kj->nki", R, np.array(points)) + p[:, None]

    def segments(self, q: np.ndarray) -> np.ndarray:
        """(N, S, 2, 3) both ends of each shape's axis in the world [m]."""
        poses = self.poses(q)
        found = np.empty((len(q), len(self._radii), 2, 3))
        for s, body in enumerate(self._bodies):
            R, p = poses[body]
            found[:, s] = np.einsum("nij,kj->nki", R, self._ends[s]) + p[:, None]
        return found

    def distances(self, q: np.ndarray) -> np.ndarray:
        """(N, P) signed distances of the watched pairs [m], at positions (N, n)."""
        q = np.asarray(q, dtype=float)
        found = np.full((len(q), len(self.pairs)), np.inf)
        for first in range(0, len(q), CHUNK):
            part = slice(first, first + CHUNK)
            axes = self.segments(q[part])
            pair, a, b = self._met.T
            far = segment_distances(
                *(axes[:, of, end] for of in (a, b) for end in (0, 1))
            )
            far -= self._radii[a] + self._radii[b]
            for column, number in enumerate(pair):
                here = found[part, number]
                np.minimum(here, far[:, column], out=here)
            for number, a, b, normal in self._on_plane:
                R, p = self.poses(q[part])[self._bodies[b]]
                height = np.einsum(
                    "nki,nij,j->nk", axes[:, a] - axes[:, b, :1], R, normal
                ).min(axis=1)
                here = found[part, number]
                np.minimum(here, height - self._radii[a], out=here)
        return found

    def to_spheres(
        self, q: np.ndarray, centres: np.ndarray, radii: np.ndarray
    ) -> tuple[np.ndarray, list[str]]:
        """Distances (N, L, M) of each link from spheres, and the links' names.

        Args:
            q: (N, n) positions.
            centres: (N, M, 3) of the spheres at each of them [m].
            radii: (M,) [m].
        """
        axes, links = self.segments(q), list(self._of_link)
        p, r = axes[:, :, None, 0], axes[:, :, None, 1]
        far = segment_distances(p, r, centres[:, None], centres[:, None])
        far -= self._radii[:, None] + radii
        return np.stack([far[:, self._of_link[x]].min(axis=1) for x in links], 1), links

    def surface_speeds(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(N, L) a speed that no point of a link's surface exceeds [m/s]: of the axis'
        faster end, and how fast the link turns times the shape's radius.

        The links are those of `to_spheres`; derivatives are differences.
        """
        h = 1e-6
        before, after = self.segments(q - h * v), self.segments(q + h * v)
        ends = np.linalg.norm((after - before) / (2.0 * h), axis=-1).max(axis=-1)
        before, after = self.poses(q - h * v), self.poses(q + h * v)
        turning = np.array(
            [
                np.linalg.norm(after[b][0] - before[b][0], axis=(1, 2))
                / (2.0 * h * np.sqrt(2.0))
                for b in self._bodies
            ]
        ).T
        fastest = ends + turning * self._radii
        of_links = self._of_link.values()
        return np.stack([fastest[:, shapes].max(axis=1) for shapes in of_links], 1)

    def query(self) -> QueryObject:
        """SceneGraph's own answers, at the state of `context`."""
        of = self.scene_graph.GetMyContextFromRoot(self._root)
        return self.scene_graph.get_query_output_port().Eval(of)

    # --- forces -------------------------------------------------------------------

    def torques(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(N, n) efforts of the joints [Nm or N], by Drake's inverse dynamics.

        Args:
            q, v, a: (N, n) positions, velocities, accelerations.
        """
        plant, found = self.plant, []
        forces = MultibodyForces(plant)
        # A discrete plant damps by the velocity after its step.
        damped = self.damping * (v + plant.time_step() * a)
        for q_k, v_k, a_k in zip(q, v, a, strict=True):
            plant.SetPositions(self.context, q_k)
            plant.SetVelocities(self.context, v_k)
            plant.CalcForceElementsContribution(self.context, forces)
            found.append(plant.CalcInverseDynamics(self.context, a_k, forces))
        return np.array(found) + damped

    def ground_wrenches(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> np.ndarray:
        """(N, 6) the moment about the world's origin, and the force, that must hold the
        base while it stands still and the joints move so [Nm, N].

        Drake's inverse dynamics of the same file with a base that floats.
        """
        plant, _, _ = self._parse(0.0, welded=False)
        context, forces = plant.CreateDefaultContext(), MultibodyForces(plant)
        base = find_link(plant, self._base)
        names = {self.joints[i]: i for i in range(len(self.joints))}
        ours, q_at, v_at = [], [], []
        for i in plant.GetJointIndices():
            joint = plant.get_joint(i)
            if joint.name() in names and joint.num_positions() == 1:
                ours.append(names[joint.name()])
                q_at.append(joint.position_start())
                v_at.append(joint.velocity_start())
        first = base.floating_velocities_start_in_v()
        found = []
        for q_k, v_k, a_k in zip(q, v, a, strict=True):
            positions, rates = (
                plant.GetPositions(context),
                np.zeros((2, plant.num_velocities())),
            )
            positions[q_at] = q_k[ours]
            rates[0, v_at], rates[1, v_at] = v_k[ours], a_k[ours]
            plant.SetPositions(context, positions)
            plant.SetVelocities(context, rates[0])
            plant.SetFreeBodyPose(context, base, self._X_WB)
            plant.CalcForceElementsContribution(context, forces)
            tau = plant.CalcInverseDynamics(context, rates[1], forces)
            moment, force = tau[first : first + 3], tau[first + 3 : first + 6]
            arm = np.cross(self._X_WB.translation(), force)
            found.append(np.concatenate((moment + arm, force)))
        return np.array(found)


def find_link(plant: MultibodyPlant, name: str) -> RigidBody:
    """The one link of that name, alone or scoped ("arm::hand")."""
    bodies = [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]
    (found,) = (b for b in bodies if name in (b.name(), b.scoped_name().get_full()))
    return found


def moved(
    R: np.ndarray, p: np.ndarray, R_next: np.ndarray, p_next: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Poses (N, 3, 3), (N, 3) followed by a transform, one for all or N of them."""
    return R @ R_next, p + (R @ p_next[..., None])[..., 0]


def across(joint: Joint, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a joint does between its two frames: R (N, 3, 3) or (3, 3), p (N, 3)."""
    kind, N = joint.type_name(), len(q)
    if kind == "weld":
        X = joint.X_FM()
        return X.rotation().matrix(), np.tile(X.translation(), (N, 1))
    at = q[:, joint.position_start()]
    if kind == "prismatic":
        return np.eye(3), at[:, None] * joint.translation_axis()
    if kind == "revolute":
        x, y, z = joint.revolute_axis()
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        s, c = np.sin(at)[:, None, None], np.cos(at)[:, None, None]
        return np.eye(3) + s * K + (1.0 - c) * (K @ K), np.zeros((N, 3))
    raise ValueError(f"{joint.name()}: no judge of a {kind} joint")


def segment_distances(p1, q1, p2, q2) -> np.ndarray:
    """Distances (...) of segments from p1 to q1 (..., 3) and from p2 to q2.

    The smallest of five candidates: each of the four ends with the nearest point of the
    other segment, and the nearest points of both lines, where these are inside.
    """
    d1, d2, r = q1 - p1, q2 - p2, p1 - p2
    a, e, b = (d1 * d1).sum(-1), (d2 * d2).sum(-1), (d1 * d2).sum(-1)
    c, f = (d1 * r).sum(-1), (d2 * r).sum(-1)

    def far(s, t):
        return np.linalg.norm(r + s[..., None] * d1 - t[..., None] * d2, axis=-1)

    best = np.full(np.broadcast_shapes(a.shape, e.shape), np.inf)
    for end in (0.0, 1.0):
        s = np.full_like(best, end)
        best = np.minimum(best, far(s, np.clip((f + b * s) / (e + TINY), 0.0, 1.0)))
        best = np.minimum(best, far(np.clip((b * s - c) / (a + TINY), 0.0, 1.0), s))
    across = a * e - b * b
    skew = across > 1e-12 * a * e
    safe = np.where(skew, across, 1.0)
    s, t = (b * f - c * e) / safe, (a * f - b * c) / safe
    inside = skew & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    s, t = np.clip(s, 0.0, 1.0), np.clip(t, 0.0, 1.0)
    return np.where(inside, np.minimum(best, far(s, t)), best)


class Ground:
    """What a flat floor can give a robot on soles that stand.

    Attributes:
        corners: (V, 3) of the hull of all soles, smaller by the margin at every edge.
    """

    def __init__(self, corners: np.ndarray, margin: float, friction: float) -> None:
        """
        Args:
            corners: (C, 3) of all soles, on one level floor [m].
            margin: that is kept from the hull's edges [m].
            friction: coefficient.
        """
        self.friction = friction
        self._edges = ConvexHull(corners[:, :2]).equations.copy()
        self._edges[:, 2] += margin
        self._height = float(corners[:, 2].mean())
        inside = HalfspaceIntersection(self._edges, corners[:, :2].mean(axis=0))
        places = inside.intersections
        self.corners = np.column_stack([places, np.full(len(places), self._height)])
        # A pyramid about the cone, lest a force on the cone be said to be missing.
        turns = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
        wide = friction / np.cos(np.pi / len(turns))
        around = np.column_stack([wide * np.cos(turns), wide * np.sin(turns)])
        self._rays = np.column_stack([around, np.ones(len(turns))])

    def outside(self, wrenches: np.ndarray) -> np.ndarray:
        """(N,) how far the centre of pressure is outside the polygon [m], negative
        inside; infinite where the floor would have to pull.

        Args:
            wrenches: (N, 6) moment about the world's origin, and force.
        """
        moment, force = wrenches[:, :3], wrenches[:, 3:]
        pushes = force[:, 2] > 1e-9
        up = np.where(pushes, force[:, 2], 1.0)
        x = (-moment[:, 1] + self._height * force[:, 0]) / up
        y = (moment[:, 0] + self._height * force[:, 1]) / up
        far = self._edges[:, :2] @ np.array([x, y]) + self._edges[:, 2:]
        return np.where(pushes, far.max(axis=0), np.inf)

    def slopes(self, wrenches: np.ndarray) -> np.ndarray:
        """(N,) the force along the floor over that upwards."""
        force = wrenches[:, 3:]
        return np.linalg.norm(force[:, :2], axis=1) / np.maximum(force[:, 2], 1e-9)

    def lacks(self, wrenches: np.ndarray) -> np.ndarray:
        """(N,) what is missing of each wrench, over its size, if forces inside friction
        cones at the corners give the rest: 0 where the floor can give it all."""
        rays = np.tile(self._rays, (len(self.corners), 1))
        places = np.repeat(self.corners, len(self._rays), axis=0)
        A = np.column_stack([np.cross(places, rays), rays]).T
        sizes = np.linalg.norm(wrenches, axis=1)
        return np.array(
            [nnls(A, w / s)[1] for w, s in zip(wrenches, sizes, strict=True)]
        )
