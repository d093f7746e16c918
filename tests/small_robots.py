"""Small robots made of text, for tests that need a plant but no model file."""

from collections.abc import Sequence

import numpy as np
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, SceneGraph
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.systems.framework import DiagramBuilder

from crar_drake.law.controller import CrarController
from crar_drake.law.parameters import PaperParameters, Parameters
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.simulation.builders import AddCrarController

LINK = 0.3  # length of every link [m]
CAPSULE = '<capsule radius="0.04" length="0.2"/>'
AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}

SPHERE_POST = """
  <link name="post"><collision><origin xyz="0.2 0.5 0.1"/>
    <geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="post_weld" type="fixed"><parent link="base"/><child link="post"/></joint>
"""


def chain_urdf(
    axes: str = "zzz",
    *,
    rail: str = "",
    damping: float = 0.0,
    limits: tuple[float, float] | None = (-2.5, 2.5),
    shapes: Sequence[str] = (CAPSULE,),
    extra: str = SPHERE_POST,
    actuated: Sequence[str] | None = None,
    gear_ratio: float | None = None,
) -> str:
    """A chain of links along x, one revolute joint each, welded to the world.

    Links are base, l0, l1, ...; joints j0, j1, ...; the last link's end is `tip`.

    Args:
        axes: per joint "x", "y" or "z".
        rail: "y" to put the chain on a sliding joint `rail` along y.
        damping: of every revolute joint [N m s/rad].
        limits: of every revolute joint [rad]; None for continuous joints.
        shapes: collision shapes of each link, along x, side by side in y.
        extra: more URDF.
        actuated: joints with a transmission, in that order; by default all, in
            the order of the joints.
        gear_ratio: of every actuator, with a rotor inertia of 1e-4 kg m^2.
    """
    text = [
        '<robot name="chain" xmlns:drake="http://drake.mit.edu"><link name="base"/>'
    ]
    parent, joints = "base", []
    if rail:
        text.append(
            '<link name="cart"><inertial><mass value="2"/><inertia ixx="0.02" '
            'iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            '<joint name="rail" type="prismatic"><parent link="base"/>'
            f'<child link="cart"/><axis xyz="{AXES[rail]}"/>'
            '<limit lower="-3" upper="3"/></joint>'
        )
        parent = "cart"
        joints.append("rail")
    for i, axis in enumerate(axes):
        collision = "".join(
            f'<collision name="c{k}"><origin xyz="{LINK / 2} {0.06 * k} 0" '
            f'rpy="0 {np.pi / 2} 0"/><geometry>{shape}</geometry></collision>'
            for k, shape in enumerate(shapes)
        )
        kind, limit = "continuous", ""
        if limits is not None:
            kind = "revolute"
            limit = f'<limit lower="{limits[0]}" upper="{limits[1]}"/>'
        text.append(
            f'<link name="l{i}"><inertial><origin xyz="{LINK / 2} 0.01 0.02"/>'
            f'<mass value="{1.0 + 0.2 * i}"/><inertia ixx="0.004" iyy="0.01" '
            'izz="0.012" ixy="0.001" ixz="0" iyz="0"/></inertial>'
            f"{collision}</link>"
            f'<joint name="j{i}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="l{i}"/><origin xyz="{LINK if i else 0} 0 0"/>'
            f'<axis xyz="{AXES[axis]}"/>{limit}<dynamics damping="{damping}"/></joint>'
        )
        parent = f"l{i}"
        joints.append(f"j{i}")
    text.append(
        '<link name="tip"/><joint name="tip_weld" type="fixed">'
        f'<parent link="{parent}"/><child link="tip"/>'
        f'<origin xyz="{LINK} 0 0" rpy="0.3 -0.2 0.5"/></joint>'
    )
    gear = ""
    if gear_ratio is not None:
        gear = (
            f'<drake:gear_ratio value="{gear_ratio}"/><drake:rotor_inertia '
            'value="1e-4"/>'
        )
    for joint in joints if actuated is None else actuated:
        text.append(
            "<transmission><type>transmission_interface/SimpleTransmission</type>"
            f'<joint name="{joint}"><hardwareInterface>EffortJointInterface'
            f'</hardwareInterface></joint><actuator name="{joint}">{gear}</actuator>'
            "</transmission>"
        )
    return "".join(text) + extra + "</robot>"


def add_plant(
    builder: DiagramBuilder,
    urdf: str,
    *,
    time_step: float = 1e-3,
    sampled: bool = True,
    finalize: bool = True,
) -> tuple[MultibodyPlant, SceneGraph]:
    """The robot, its base welded to the world, in a builder; nothing collides."""
    plant, scene_graph = AddMultibodyPlant(
        MultibodyPlantConfig(
            time_step=time_step,
            use_sampled_output_ports=sampled and time_step > 0.0,
            discrete_contact_approximation="lagged",
        ),
        builder,
    )
    Parser(plant).AddModelsFromString(urdf, "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    if finalize:
        plant.Finalize()
        everything = GeometrySet(scene_graph.model_inspector().GetAllGeometryIds())
        scene_graph.collision_filter_manager().Apply(
            CollisionFilterDeclaration().ExcludeWithin(everything)
        )
    return plant, scene_graph


def add_controller(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    description: RobotDescription,
    tasks: Sequence[Task],
    parameters: Parameters | None = None,
    **others,
) -> CrarController:
    """The controller of a robot whose description is at hand: its pairs and prescribed
    joints, and its rest posture in the plant."""
    for name, position in description.rest_posture.items():
        plant.GetJointByName(name).set_default_positions([position])
    return AddCrarController(
        builder,
        plant,
        scene_graph,
        tasks,
        parameters,
        watch=description.pairs,
        prescribed=list(description.prescribed_joints),
        **others,
    )


def make_model(
    urdf: str,
    tasks: Sequence[Task] = (Task(frame="tip"),),
    *,
    time_step: float = 1e-3,
    **description,
) -> ControlModel:
    """A control model of the robot; `description` fills a RobotDescription."""
    plant, scene_graph = add_plant(DiagramBuilder(), urdf, time_step=time_step)
    return ControlModel.FromPlant(
        plant, scene_graph, RobotDescription(**description), tasks
    )


def random_state(model: ControlModel, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions of up to one radian and velocities, at random."""
    rng = np.random.default_rng(seed)
    nq = model.plant.num_positions()
    return rng.uniform(-1.0, 1.0, nq), rng.normal(size=nq)


def free_of_constraints(**changes) -> PaperParameters:
    """Parameters without constraints and without blending."""
    return PaperParameters(
        **({"constraints": "none", "blend_time": 0.0, "damping": 1e-6} | changes)
    )


def state_about_the_limits(
    model: ControlModel, rng: np.random.Generator, free: float
) -> tuple[np.ndarray, np.ndarray]:
    """Positions anywhere within the limits and a little beyond, and velocities.

    Prescribed joints are within +-`free`.
    """
    nv = len(model.position_names)
    lower, upper = np.full(nv, -free), np.full(nv, free)
    lower[model.controlled] = np.maximum(model.lower, -np.pi)
    upper[model.controlled] = np.minimum(model.upper, np.pi)
    span = upper - lower
    q = rng.uniform(lower - 0.01 * span, upper + 0.01 * span)
    return q, rng.normal(size=nv)
