"""Where the watched shapes of a robot are, by Drake's own kinematics.

And a small robot with every kind of joint that the controller's kinematics knows.
"""

import numpy as np
from pydrake.geometry import Capsule, HalfSpace, SceneGraph, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    MultibodyPlant,
)
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    JacobianWrtVariable,
    PlanarJoint,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    ScrewJoint,
    SpatialInertia,
    UniversalJoint,
    WeldJoint,
)
from pydrake.systems.framework import DiagramBuilder

from crar_drake.law.capsule_distances import capsule_distances
from crar_drake.law.compilation import hold
from crar_drake.law.kinematics import Robot
from crar_drake.law.path_bounds import Reaches
from crar_drake.robot.collision_pairs import WatchedPairs
from crar_drake.robot.kinematics import JointTree
from crar_drake.robot.model import ControlModel
from crar_drake.robot.reach import find_reaches


class MovingShapes:
    """The pairs of shapes of a plant, row by row; configurations in some order.

    Attributes:
        robot, reaches, held: what the admission works with; `held` are the reaches.
        order: (nv,) places in the plant's v of the entries of q, v, x here.
        lower, upper: (nv,) limits in that order.
        rows: per pair of shapes (body a, ends in a, radius a, body b, ends, radius); of
            a half space b "ends" at its surface and below; a is then an end of a shape.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        pairs: list[tuple[RigidBody, RigidBody]],
        robot: Robot,
        reaches: Reaches,
    ) -> None:
        self.plant, self.robot, self.reaches = plant, robot, reaches
        self.held = hold(reaches)
        self.context = plant.CreateDefaultContext()
        self.order = np.array(robot.order)
        self.lower = plant.GetPositionLowerLimits()[self.order]
        self.upper = plant.GetPositionUpperLimits()[self.order]
        inspector = scene_graph.model_inspector()
        self.rows, self._flat = [], []
        for a, b in pairs:
            for geometry_a in plant.GetCollisionGeometriesForBody(a):
                for geometry_b in plant.GetCollisionGeometriesForBody(b):
                    ends, radius = self._axis(inspector, geometry_a)
                    axis_b = self._axis(inspector, geometry_b)
                    shape_a, shape_b = (
                        inspector.GetShape(g) for g in (geometry_a, geometry_b)
                    )
                    each = [ends]
                    if isinstance(shape_b, HalfSpace):
                        each = [ends[[0, 0]], ends[[1, 1]]]
                        each = each[: 1 if isinstance(shape_a, Sphere) else 2]
                    for ends_a in each:
                        self.rows.append((a, ends_a, radius, b, *axis_b))
                        self._flat.append(isinstance(shape_b, HalfSpace))

        known = {body.index(): body for row in self.rows for body in (row[0], row[3])}
        self._bodies = list(known.values())
        places = list(known)
        self._of = [
            np.array([places.index(row[k].index()) for row in self.rows])
            for k in (0, 3)
        ]
        self._ends = [np.array([row[k] for row in self.rows]) for k in (1, 4)]

    @staticmethod
    def of(model: ControlModel) -> "MovingShapes":
        plant = model.plant
        reaches = find_reaches(
            model.joints,
            model.pairs,
            model.order,
            plant.GetPositionLowerLimits(),
            plant.GetPositionUpperLimits(),
        )
        bodies = model.pairs.bodies
        pairs = [
            (bodies[a], bodies[b])
            for a, b in zip(model.pairs.body_a, model.pairs.body_b, strict=True)
        ]
        return MovingShapes(plant, model.scene_graph, pairs, model.robot.value, reaches)

    @staticmethod
    def _axis(inspector, geometry) -> tuple[np.ndarray, float]:
        """(2, 3) ends of a shape's axis in its body, and its radius."""
        shape, X = inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry)
        if isinstance(shape, HalfSpace):
            below = X.multiply(np.array([0.0, 0.0, -1.0]))
            return np.array([X.translation(), below]), 0.0
        half = 0.5 * shape.length() if isinstance(shape, Capsule) else 0.0
        ends = [X.multiply(np.array([0.0, 0.0, z])) for z in (-half, half)]
        return np.array(ends), shape.radius()

    def set(self, q: np.ndarray) -> None:
        in_plant = np.empty(len(q))
        in_plant[self.order] = q
        self.plant.SetPositions(self.context, in_plant)

    def ends(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(Ns, 2, 3) ends of the axes of a, and of b, in W."""
        self.set(q)
        poses = np.array(
            [
                self.plant.EvalBodyPoseInWorld(self.context, body).GetAsMatrix34()
                for body in self._bodies
            ]
        )
        R, p = poses[:, :, :3], poses[:, None, :, 3]
        a, b = (
            ends @ R[of].swapaxes(1, 2) + p[of]
            for of, ends in zip(self._of, self._ends, strict=True)
        )
        return a, b

    def distances(self, configurations: np.ndarray) -> np.ndarray:
        """(K, Ns) signed distances in K configurations."""
        found = [self.ends(q) for q in configurations]
        a, b = (np.concatenate(x) for x in zip(*found, strict=True))
        radius_a, radius_b = (
            np.tile([row[k] for row in self.rows], len(found)) for k in (2, 5)
        )
        d, *_ = capsule_distances(
            a[:, 0], a[:, 1], radius_a, b[:, 0], b[:, 1], radius_b
        )
        # Axes of half spaces are a metre long.
        height = ((b[:, 0] - b[:, 1]) * (a[:, 0] - b[:, 0])).sum(axis=1) - radius_a
        d = np.where(np.tile(self._flat, len(found)), height, d)
        return d.reshape(len(found), -1)

    def on_path(self, start: np.ndarray, end: np.ndarray, samples: int) -> np.ndarray:
        """(samples, Ns) distances on the straight way between two configurations."""
        t = np.linspace(0.0, 1.0, samples)[:, None]
        return self.distances(start + t * (end - start))

    def end_jacobian(self, body: RigidBody, p_B: np.ndarray) -> np.ndarray:
        """(3, nv) of a point of a body, in the present context."""
        W = self.plant.world_frame()
        J = self.plant.CalcJacobianTranslationalVelocity(
            self.context, JacobianWrtVariable.kV, body.body_frame(), p_B, W, W
        )
        return J[:, self.order]

    def carries(self, body: RigidBody) -> np.ndarray:
        """(nv,) whether a joint moves a body: asked at a general configuration."""
        self.set(np.linspace(0.1, 0.4, len(self.order)))
        W = self.plant.world_frame()
        J = self.plant.CalcJacobianSpatialVelocity(
            self.context, JacobianWrtVariable.kV, body.body_frame(), np.ones(3), W, W
        )
        return np.abs(J[:, self.order]).max(axis=0) > 1e-9

    def random_configuration(self, rng: np.random.Generator) -> np.ndarray:
        """Anywhere within the limits; unlimited joints within +-2."""
        return rng.uniform(np.maximum(self.lower, -2.0), np.minimum(self.upper, 2.0))


def every_joint() -> tuple[MultibodyPlant, SceneGraph]:
    """A plant of bodies with shapes, all joints' frames at general poses.

    world - planar - cart - revolute - trunk - prismatic - slider - universal - fork
    - screw - drill; and trunk - revolute - arm - weld - hand - prismatic - finger.
    """
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    names = (
        "cart",
        "trunk",
        "slider",
        "fork",
        "drill",
        "arm",
        "hand",
        "finger",
    )
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    body = {name: plant.AddRigidBody(name, inertia) for name in names}
    body["world"] = plant.world_body()
    rng = np.random.default_rng(11)

    def pose(size: float = 0.15) -> RigidTransform:
        turn = RollPitchYaw(rng.uniform(-1.0, 1.0, 3))
        return RigidTransform(turn, rng.uniform(-size, size, 3))

    def ends(name: str, parent: str, child: str):
        frames = [
            plant.AddFrame(FixedOffsetFrame(f"{name}{k}", frame.body_frame(), pose()))
            for k, frame in enumerate((body[parent], body[child]))
        ]
        return name, *frames

    axis = np.array([0.6, 0.0, 0.8])
    plant.AddJoint(PlanarJoint(*ends("planar", "world", "cart"), 3 * [0.0]))
    for name, parent, child, limits in (
        ("waist", "cart", "trunk", (-2.0, 2.0)),
        ("shoulder", "trunk", "arm", (-1.5, 2.5)),
    ):
        plant.AddJoint(RevoluteJoint(*ends(name, parent, child), axis, *limits))
    for name, parent, child, limits in (
        ("slide", "trunk", "slider", (-0.3, 0.4)),
        ("thumb", "hand", "finger", (0.1, 0.25)),
    ):
        plant.AddJoint(PrismaticJoint(*ends(name, parent, child), axis, *limits))
    plant.AddJoint(UniversalJoint(*ends("universal", "slider", "fork")))
    plant.AddJoint(ScrewJoint(*ends("screw", "fork", "drill"), axis, 0.2, 0.0))
    plant.AddJoint(WeldJoint(*ends("weld", "arm", "hand"), pose()))
    friction = CoulombFriction(1.0, 1.0)
    for name, shapes in {
        "cart": [Capsule(0.05, 0.3)],
        "fork": [Capsule(0.03, 0.2), Sphere(0.06)],
        "drill": [Capsule(0.02, 0.25)],
        "hand": [Sphere(0.05), Capsule(0.03, 0.15)],
        "finger": [Capsule(0.02, 0.2)],
    }.items():
        for k, shape in enumerate(shapes):
            plant.RegisterCollisionGeometry(
                body[name], pose(), shape, f"{name}{k}", friction
            )
    plant.RegisterCollisionGeometry(
        plant.world_body(), pose(0.5), Sphere(0.1), "post", friction
    )
    plant.Finalize()
    limits = {"planar": 3 * [np.inf], "universal": [1.5, 1.0], "screw": [4.0]}
    for name, upper in limits.items():
        joint = plant.GetJointByName(name)
        joint.set_position_limits(-np.array(upper), np.array(upper))
    return plant, scene_graph


EVERY_PAIR = [
    ("drill", "hand"),
    ("fork", "finger"),
    ("drill", "cart"),
    ("fork", "world"),
    ("finger", "cart"),
    ("hand", "world"),
]


def shapes_of_every_joint(like: Robot) -> MovingShapes:
    """The robot of `every_joint`, its joints in the reverse order.

    Args:
        like: any robot, from which what has nothing to do with shapes is taken.
    """
    plant, scene_graph = every_joint()
    order = np.arange(plant.num_velocities())[::-1].copy()
    return shapes_of(plant, scene_graph, EVERY_PAIR, order, like)


def shapes_of(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    names: list[tuple[str, str]],
    order: np.ndarray,
    like: Robot,
) -> MovingShapes:
    """The robot of a plant without a free joint.

    Args:
        names: of the watched bodies, in pairs.
        order: (nv,) places in the plant's v.
        like: any robot, from which what has nothing to do with shapes is taken.
    """
    pairs = [
        tuple(
            plant.world_body() if name == "world" else plant.GetBodyByName(name)
            for name in pair
        )
        for pair in names
    ]
    watched = WatchedPairs(plant, scene_graph.model_inspector(), pairs)
    joints = JointTree(plant)
    nv = plant.num_velocities()
    reaches = find_reaches(
        joints,
        watched,
        order,
        plant.GetPositionLowerLimits(),
        plant.GetPositionUpperLimits(),
    )
    placed = joints.axes(order)
    points, vectors = [], []
    for body, axes in zip(watched.bodies, watched.axes, strict=True):
        for axis in axes:
            points.append(joints.point(body, axis.p_B0))
            vectors.append(joints.vector(body, axis.p_B1 - axis.p_B0))
    first_axis = len(placed)
    placed += points + vectors
    links = np.array([joints.place(body)[0] for body in watched.bodies])
    carried = joints.moved_by[links][:, order].astype(float)
    selection, first = joints.select(placed)
    robot = like._replace(
        order=order,
        positions=order,
        n=nv,
        tree=hold(joints.tree),
        selection=selection,
        first=first,
        pairs=hold(
            watched.for_equations(
                first_axis, carried[watched.body_a] - carried[watched.body_b]
            )[0]
        ),
    )
    return MovingShapes(plant, scene_graph, pairs, robot, reaches)
