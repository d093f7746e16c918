"""Robots of any size, made of text, to see how a control step grows.

Arms of up to seven small links stand around a base, among small spheres: some
within the arms' reach, some metres away. Every number comes from a fixed seed.
"""

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from benchmarks.step_timing import Samples
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import Parameters
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

LINKS_PER_ARM = 7
NUM_SPHERES = 15  # near ones, and as many far ones
FAR = 3.0  # how far the far ones are at least [m]
PERIOD = 5e-3  # control period [s]

_LENGTH, _RADIUS = 0.05, 0.008  # of a link [m]
ON_A_LINK = f"0 0 {_LENGTH}"  # where the next one begins
_CIRCLE = 0.10  # radius on which the arms stand [m]
_AXES = ("1 0 0", "0 1 0", "0 0 1")
_SEED = 1


def make_robot(
    num_joints: int, num_tasks: int, near_pairs: int, far_pairs: int = 0
) -> ControlModel:
    """A control model with just so many joints, tasks and watched pairs.

    Each pair is a link and a sphere of the surroundings. A smaller number of pairs
    is a part of a larger one.

    Args:
        num_joints: n, all controlled.
        num_tasks: position tasks, of different links, the arms' ends first.
        near_pairs: watched pairs that stay within the influence distance.
        far_pairs: watched pairs that are metres apart.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, PERIOD)
    Parser(plant).AddModelsFromString(robot_urdf(num_joints), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    links = [f"link{i}" for i in range(num_joints)]
    pairs = _choose(links, "near", near_pairs) + _choose(links, "far", far_pairs)
    # The ends of the arms, then what is before them, and so on.
    place = {i: (LINKS_PER_ARM - 1 - i % LINKS_PER_ARM, i) for i in range(num_joints)}
    tracked = sorted(range(num_joints), key=place.__getitem__)[:num_tasks]
    if len(tracked) < num_tasks:
        raise ValueError(f"{num_tasks} tasks need as many links, not {num_joints}")
    return ControlModel(
        builder.Build(),
        plant,
        scene_graph,
        RobotDescription(name=f"{num_joints} joints", pairs=pairs),
        [Task(frame=links[i], point=[0.0, 0.0, _LENGTH]) for i in tracked],
    )


def make_samples(
    model: ControlModel, parameters: Parameters, num_steps: int
) -> Samples:
    """Control steps of the robot as its tasks go around small circles.

    The commanded accelerations are integrated as they are: no plant, no contact.

    Args:
        model: from `make_robot`.
        parameters: of the controller.
        num_steps: K.
    """
    law = ControlLaw(model, parameters)
    q = np.tile([0.3, -0.3, 0.0, 0.3, -0.2, 0.2, 0.1], 1 + model.n // 7)[: model.n]
    v = np.zeros(model.n)
    start = model.evaluate(model.MakeWorkspace(), q, v).p
    period, radius, rate = parameters.period, 0.02, 3.0
    phases = np.arange(len(start))
    rows = []
    for k in range(num_steps):
        angles = rate * k * period + phases
        c, s, zero = np.cos(angles), np.sin(angles), np.zeros(len(start))
        tasks = model.layout.pack(
            np.empty((0, 3, 3)),
            start + radius * np.stack([c, s, zero], axis=1),
            radius * rate * np.stack([-s, c, zero], axis=1).ravel(),
            -radius * rate**2 * np.stack([c, s, zero], axis=1).ravel(),
        )
        vdot = law.step(q, v, tasks).acceleration
        rows.append((q, v, tasks, np.zeros(0)))
        q = q + period * v + 0.5 * period**2 * vdot
        v = v + period * vdot
    return Samples(*(np.array(column) for column in zip(*rows, strict=True)))


def robot_urdf(num_joints: int) -> str:
    """The robot's URDF: links link0, link1, ... with joints and actuators joint0,
    joint1, ..., and the spheres near0, ..., far0, ... on the base."""
    arms = -(-num_joints // LINKS_PER_ARM)
    text = ['<robot name="arms"><link name="base"/>']
    for i in range(num_joints):
        arm, place = divmod(i, LINKS_PER_ARM)
        if place == 0:
            x, y = _CIRCLE * _on_circle(arm, arms)
            parent, origin = "base", f"{x:.9g} {y:.9g} 0"
        else:
            parent, origin = f"link{i - 1}", ON_A_LINK
        text.append(link_urdf(i, parent, origin))
    rng = np.random.default_rng(_SEED)
    for k in range(NUM_SPHERES):
        # Inside the circle of arms, at the height of their middle.
        angle, distance = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 0.04)
        near = [distance * np.cos(angle), distance * np.sin(angle)]
        near.append(rng.uniform(0.15, 0.2))
        away = rng.normal(size=3)
        away *= rng.uniform(FAR + 1.0, FAR + 2.0) / np.linalg.norm(away)
        for name, p in ((f"near{k}", near), (f"far{k}", away)):
            text.append(sphere_urdf(name, p, 0.005))
    return "".join(text) + "</robot>"


def link_urdf(i: int, parent: str, origin: str) -> str:
    """Link and joint number i, on a parent, with an actuator."""
    return (
        f'<link name="link{i}"><inertial><origin xyz="0 0 {_LENGTH / 2}"/>'
        '<mass value="0.2"/><inertia ixx="1e-4" iyy="1e-4" izz="5e-5" ixy="0" '
        f'ixz="0" iyz="0"/></inertial><collision><origin xyz="0 0 {_LENGTH / 2}"/>'
        f'<geometry><capsule radius="{_RADIUS}" length="{_LENGTH - 2 * _RADIUS}"/>'
        "</geometry></collision></link>"
        f'<joint name="joint{i}" type="revolute"><parent link="{parent}"/>'
        f'<child link="link{i}"/><origin xyz="{origin}"/>'
        f'<axis xyz="{_AXES[i % LINKS_PER_ARM % 3]}"/>'
        '<limit lower="-2.5" upper="2.5"/></joint>'
        "<transmission><type>transmission_interface/SimpleTransmission</type>"
        f'<joint name="joint{i}"><hardwareInterface>EffortJointInterface'
        f'</hardwareInterface></joint><actuator name="joint{i}"/></transmission>'
    )


def sphere_urdf(name: str, p: Sequence[float], radius: float) -> str:
    """A link that is a sphere on the base [m]."""
    return (
        f'<link name="{name}"><collision><geometry><sphere radius="{radius:g}"/>'
        f'</geometry></collision></link><joint name="{name}" type="fixed">'
        f'<parent link="base"/><child link="{name}"/>'
        f'<origin xyz="{p[0]:.9g} {p[1]:.9g} {p[2]:.9g}"/></joint>'
    )


def _on_circle(arm: int, arms: int) -> np.ndarray:
    angle = 2.0 * np.pi * arm / arms
    return np.array([np.cos(angle), np.sin(angle)])


def _choose(links: list[str], what: str, count: int) -> list[list[str]]:
    """The first `count` of all pairs of a link and a sphere, in a random order."""
    every = [[link, f"{what}{k}"] for link in links for k in range(NUM_SPHERES)]
    if count > len(every):
        raise ValueError(f"{len(links)} links have {len(every)} pairs, not {count}")
    order = np.random.default_rng(_SEED).permutation(len(every))[:count]
    return [every[i] for i in order]
