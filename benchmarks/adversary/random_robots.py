"""Robots drawn at random: what no importer would ever write, one per seed.

`slides` alternate joints that turn with slides of a few centimetres, some of them
prescribed; `boxes` have mostly boxes; `random` have 1 to 6 joints of any kind. All
have whips (1 mm thick, 2 m long), joints with a range of nothing, joints without a
speed limit, weak motors, and posts in their way that stand or are moved.
"""

from itertools import combinations, count

import numpy as np
from pydrake.geometry import Box, Capsule, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    MultibodyPlant,
)
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
)
from pydrake.systems.framework import DiagramBuilder

from benchmarks.adversary.judge import Judge
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

KINDS = ("slides", "boxes", "random")
MOST_JOINTS = 6
SHAPES = {  # how often a link has a capsule, a sphere, a whip, a box
    "slides": [0.4, 0.6, 0.0, 0.0],
    "posts": [0.2, 0.2, 0.6, 0.0],
    "boxes": [0.2, 0.1, 0.1, 0.6],
    "random": [0.6, 0.25, 0.15, 0.0],
}
WHIP = Capsule(1e-3, 2.0)  # radius and length [m]
APART = 6e-3  # [m] that watched pairs are
SEEN = 0.1  # in this share of the poses at least
POSES = 300


def draw_robot(kind: str, seed: int) -> tuple[RobotDescription, Judge, ControlModel]:
    """The robot of a kind and a seed, with tasks; the judge has a plant of its own."""
    for attempt in count():
        drawn_from = (kind, [seed, KINDS.index(kind), attempt])
        plant, scene_graph, _, description = _draw(*drawn_from)
        description.pairs = _pairs_that_part(plant, scene_graph, description)
        if description.pairs:
            break
    prescribed = list(description.prescribed_joints)
    judge = Judge(plant, scene_graph, description.pairs, prescribed)
    rng = np.random.default_rng([seed, 1])
    links = [name for name in description.task_frames if name.startswith("link")]
    tasks = [
        Task(
            frame=link,
            kind=str(rng.choice(["position", "position", "pose"])),
            point=list(rng.normal(scale=0.1, size=3)),
            orientation_weight=0.3,
        )
        for link in sorted({links[-1], str(rng.choice(links))})
    ]
    plant, scene_graph, builder, _ = _draw(*drawn_from)
    model = ControlModel(builder.Build(), plant, scene_graph, description, tasks)
    return description, judge, model


def _draw(kind: str, seed: list[int]):
    """Plant, SceneGraph, their builder, and a description with every pair."""
    rng = np.random.default_rng(seed)
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(
        builder, float(rng.choice([0.0, 1e-3]))
    )
    # Short links on slides that are driven far out, and there many posts.
    long, fewest, far = (0.05, 8, 2.0) if kind == "slides" else (0.3, 1, 0.8)
    base = plant.AddRigidBody("base", _inertia(rng))
    plant.WeldFrames(plant.world_frame(), base.body_frame())
    _give_shape(plant, base, rng, kind, long)
    links, parents, prescribed = [base], {}, []
    joints = int(rng.integers(3 if kind == "slides" else 1, MOST_JOINTS + 1))
    first = rng.integers(2)
    for i in range(joints):
        # Mostly a chain, sometimes with branches.
        parent = links[-1] if rng.random() < 0.8 else links[rng.integers(len(links))]
        slides = (i + first) % 2 == 0 if kind == "slides" else rng.random() < 0.3
        link = _add_joint(plant, rng, f"{i}", parent, slides, "link", long)
        share = 0.5 if kind == "slides" and slides else 0.1
        if rng.random() < share and len(prescribed) < joints - 1:
            prescribed.append(f"joint{i}")
        _give_shape(plant, link, rng, kind, long)
        parents[link.name()] = parent.name()
        links.append(link)
    for i in range(int(rng.integers(fewest, 2 * fewest + 2))):
        if rng.random() < 0.5:
            post = _add_joint(plant, rng, f"_of_post{i}", base, True, "moved", far)
            prescribed.append(f"joint_of_post{i}")
        else:
            post = plant.AddRigidBody(f"post{i}", _inertia(rng))
            plant.WeldFrames(base.body_frame(), post.body_frame(), _place(rng, far))
        _give_shape(plant, post, rng, "posts" if kind == "slides" else kind, 0.3)
        links.append(post)
    plant.Finalize()
    fixed = [link.name() for link in links if link.name()[:4] in ("base", "post")]
    pairs = [
        [a.name(), b.name()]
        for a, b in combinations(links, 2)
        if parents.get(b.name()) != a.name()
        and not (a.name() in fixed and b.name() in fixed)
    ]
    description = RobotDescription(
        name=kind,
        prescribed_joints=dict.fromkeys(prescribed, "hold"),
        task_frames={link.name(): link.name() for link in links[1:]},
        pairs=pairs,
    )
    return plant, scene_graph, builder, description


def _add_joint(plant, rng, name, parent, slides, prefix, farthest) -> RigidBody:
    """A body on a joint with a motor; limits, speed and effort as it comes."""
    link = plant.AddRigidBody(f"{prefix}{name}", _inertia(rng))
    on_parent = plant.AddFrame(
        FixedOffsetFrame(f"before{name}", parent.body_frame(), _place(rng, farthest))
    )
    axis = rng.normal(size=3)
    if rng.random() < 0.5:  # most axes are in line with something
        axis = np.eye(3)[rng.integers(3)]
    axis /= np.linalg.norm(axis)
    middle = rng.uniform(-0.3, 0.3) * (0.1 if slides else 1.0)
    half = 10.0 ** (rng.uniform(-2.0, -0.5) if slides else rng.uniform(-1.0, 0.5))
    half *= rng.choice([1.0, 0.0, 1.0 if slides else np.inf], p=[0.8, 0.1, 0.1])
    made = PrismaticJoint if slides else RevoluteJoint
    between = f"joint{name}", on_parent, link.body_frame(), axis
    damping = float(rng.choice([0.0, 0.5]))
    joint = plant.AddJoint(made(*between, middle - half, middle + half, damping))
    if rng.random() < 0.5:
        fastest = rng.uniform(0.3, 10.0)
        joint.set_velocity_limits([-fastest], [fastest])
    joint.set_default_positions([middle])
    effort = 10.0 ** rng.uniform(1.0, 3.0) if rng.random() < 0.3 else np.inf
    plant.AddJointActuator(f"motor{name}", joint, effort)
    return link


def _give_shape(plant: MultibodyPlant, body, rng, kind: str, longest: float) -> None:
    """A shape somewhere on the body."""
    name = rng.choice(["capsule", "sphere", "whip", "box"], p=SHAPES[kind])
    shape = {
        "capsule": Capsule(10.0 ** rng.uniform(-2.5, -1.2), longest * rng.random()),
        "sphere": Sphere(10.0 ** rng.uniform(-2.5, -1.0)),
        "whip": WHIP,
        "box": Box(*10.0 ** rng.uniform(-2.3, -0.5, 3)),
    }[str(name)]
    plant.RegisterCollisionGeometry(
        body, _place(rng, 0.3 * longest), shape, "shape", CoulombFriction()
    )


def _place(rng: np.random.Generator, farthest: float) -> RigidTransform:
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    R = R * np.sign(np.linalg.det(R))
    return RigidTransform(RotationMatrix(R), rng.uniform(-farthest, farthest, 3))


def _inertia(rng: np.random.Generator) -> SpatialInertia:
    return SpatialInertia.SolidSphereWithMass(rng.uniform(0.2, 4.0), 0.1)


def _pairs_that_part(plant, scene_graph, description) -> list[list[str]]:
    """The pairs that are apart often enough for all of them to be so at once, while
    prescribed joints rest."""
    rng = np.random.default_rng(0)
    lower = np.maximum(plant.GetPositionLowerLimits(), -np.pi)
    upper = np.minimum(plant.GetPositionUpperLimits(), np.pi)
    q = rng.uniform(lower, upper, (POSES, len(lower)))
    for name in description.prescribed_joints:
        joint = plant.GetJointByName(name)
        q[:, joint.position_start()] = joint.default_positions()
    d = Judge(plant, scene_graph, description.pairs).distances(q)
    kept = list(range(d.shape[1]))
    while kept and (d[:, kept] > APART).all(axis=1).mean() < SEEN:
        kept.remove(min(kept, key=lambda k: (d[:, k] > APART).mean()))
    return [description.pairs[k] for k in kept]
