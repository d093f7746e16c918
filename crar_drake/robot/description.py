"""What the controller cannot guess about a robot: a YAML file beside its model."""

# YAML loading reads the types of the fields, so no postponed annotations here.
import math
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from pathlib import Path

import numpy as np
from pydrake.geometry import HalfSpace, SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    MultibodyPlant,
)
from pydrake.multibody.tree import (
    BodyIndex,
    Frame,
    FrameIndex,
    Joint,
    QuaternionFloatingJoint,
    RigidBody,
    ScopedName,
)
from pydrake.systems.framework import Diagram, DiagramBuilder

from crar_drake.errors import ModelError, check_vector, nearest
from crar_drake.resources import data_folder, imported_robots_folder, install_command
from crar_drake.robot.environment import Fixture, add_environment
from crar_drake.yaml_files import load_yaml, read_text

# What `crar-drake import-robot` decided about a robot, beside its robot.yaml.
IMPORT_FILE = "import.yaml"

# What a motion can drive a prescribed joint with.
PRESCRIBED_SOURCES = ("waist.x", "waist.y", "waist.z", "waist.heading", "hold")

# What pairs call the world's half space, which `ground` adds.
GROUND = "ground"

# What becomes of the base.
ROOTS = ("fixed", "prescribed")

# Farther beyond its limit than this, a joint violates it [rad or m]. One number for
# all figures: it says what counts, not how that is computed.
LIMIT_TOLERANCE = 1e-6

# Farther below the floor, z = 0, a robot that stands on it does not [m].
FLOOR_TOLERANCE = 0.01

# Corners of a sole may be so far off a plane [m].
SOLE_TOLERANCE = 1e-3

# Faster by more than this than its limit, a joint violates it [rad/s or m/s].
SPEED_TOLERANCE = 1e-6


@dataclass
class RootPose:
    """Where a robot's base is in the world at rest, as a URDF's origin."""

    xyz: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # position [m]
    # roll, pitch and yaw, about the world's x, then y, then z [rad]
    rpy: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])


@dataclass
class RobotDescription:
    """Names in a robot model; see `models/README.md` for the file.

    Every name is that of a joint, frame or link of the plant, alone where it is
    unique, else scoped (`arm::tool`).

    Attributes:
        name: the robot's name.
        model: URDF, SDF or model directives (.dmd.yaml), beside the file.
        base: link that is welded to the world, or that floats; "" where the model welds
            itself.
        root: "fixed": the base is welded to the world; "prescribed": it floats, and
            its pose is given, by a reference motion or by soles that stand. No law
            moves it (`refuse_floating`).
        root_pose: where the base is at rest.
        prescribed_joints: joint to what the motion drives it with: "waist.x",
            "waist.y", "waist.z" (the waist's position in the world), "waist.heading"
            (yaw of the performer's hips) or "hold" (stays where it starts).
        task_frames: name of a point that a motion has to a frame of the model.
        pairs: watched segment pairs, two links each; a link that is welded to the
            world counts as environment.
        ground: height of the ground in the world [m], a half space that pairs name
            "ground"; None for none, or for that of the plant.
        environment: name to what stands in the world, given as meshes; pairs name it as
            a link.
        rest_posture: joint to position [rad or m]; those not named are at 0.
        velocity_limits: joint to its largest speed [rad/s or m/s], instead of that of
            the model; infinite for none.
        range_share: share of each joint's range, about its middle, that may be used.
        soles: link to the (V, 3) corners of its flat sole, in the link's frame [m].
        folder: where `model` lies; filled in by `load_robot_description`.
    """

    name: str = "robot"
    model: str = ""
    base: str = ""
    root: str = "fixed"
    root_pose: RootPose = field(default_factory=RootPose)
    prescribed_joints: dict[str, str] = field(default_factory=dict)
    task_frames: dict[str, str] = field(default_factory=dict)
    pairs: list[list[str]] = field(default_factory=list)
    ground: float | None = None
    environment: dict[str, Fixture] = field(default_factory=dict)
    rest_posture: dict[str, float] = field(default_factory=dict)
    velocity_limits: dict[str, float] = field(default_factory=dict)
    range_share: float = 1.0
    soles: dict[str, list[list[float]]] = field(default_factory=dict)
    folder: str = ""

    def validate(self) -> None:
        """Checks what can be checked without the model.

        Raises:
            ModelError: names the entry and what it may be.
        """
        for mistake in self._mistakes():
            raise ModelError(f"robot {self.name}: {mistake}")
        for name, fixture in self.environment.items():
            fixture.validate(f"robot {self.name}: environment: {name}")
        for name in ("xyz", "rpy"):
            value = getattr(self.root_pose, name)
            check_vector(f"robot {self.name}: root_pose.{name}", value, ModelError)
        check_soles(self.soles, f"robot {self.name}")

    def _mistakes(self) -> Iterator[str]:
        if self.root not in ROOTS:
            yield f"root: {self.root!r} is none of {', '.join(ROOTS)}"
        if self.root != "fixed" and not self.base:
            yield (
                f"root: {self.root!r} needs the name of the link that floats; give it "
                "as base"
            )
        if not 0.0 < self.range_share <= 1.0:
            yield (
                f"range_share: {self.range_share} is no share; it is more than 0 and "
                "at most 1"
            )
        often = Counter(map(frozenset, self.pairs))
        for pair in self.pairs:
            if len(pair) != 2 or pair[0] == pair[1]:
                yield f"pairs: {pair} must name two different links"
            if often[frozenset(pair)] > 1:
                yield f"pairs: {pair} is there twice; it would count twice in Eq. (26)"
        watched = {name for pair in self.pairs for name in pair}
        if self.ground is not None and not math.isfinite(self.ground):
            yield f"ground: {self.ground} must be a height in metres"
        if self.ground is not None and GROUND not in watched:
            yield (
                f"ground: {self.ground}, but no pair names {GROUND!r}, so that nothing "
                f"keeps above it; add pairs such as [left_foot, {GROUND}]"
            )
        for name in self.environment:
            if name not in watched:
                yield (
                    f"environment: {name}: no pair names it, so that nothing keeps off "
                    f"it; add pairs such as [hand, {name}]"
                )
        for joint, source in self.prescribed_joints.items():
            if source not in PRESCRIBED_SOURCES:
                yield (
                    f"prescribed_joints: {joint}: {source!r} is none of "
                    f"{', '.join(PRESCRIBED_SOURCES)}"
                )
        driven = [j for j, source in self.prescribed_joints.items() if source != "hold"]
        if self.root != "fixed" and driven:
            yield (
                f"prescribed_joints: {', '.join(driven)}: the root floats, and its "
                "pose is given; say hold, or root: fixed"
            )
        for joint, limit in self.velocity_limits.items():
            if not is_speed_limit(limit):
                yield (
                    f"velocity_limits: {joint}: {limit} must be positive (.inf for no "
                    "limit)"
                )

    def refuse_floating(self) -> None:
        """Raises ModelError if the base floats: the law moves joints alone."""
        if self.root != "fixed":
            raise ModelError(
                f"robot {self.name}: root: {self.root}: its base {self.base!r} floats, "
                "and the law moves joints alone. Weld it (root: fixed), or take the "
                "robot's upper body; let it stand on its soles (standing in a "
                "scenario, standing_description); or make a reference motion of the "
                "whole body (crar-drake retarget)"
            )

    @property
    def stands(self) -> bool:
        """Whether it is one of `standing_description`: its root rests on its soles."""
        return bool(self.soles) and self.root == "fixed"

    def without_ground(self) -> "RobotDescription":
        """The same robot in the air: no ground, and no pair with it."""
        pairs = [pair for pair in self.pairs if GROUND not in pair]
        return replace(self, ground=None, pairs=pairs)

    def rest_pose(self) -> RigidTransform:
        """X_WB of the base at rest."""
        return RigidTransform(RollPitchYaw(self.root_pose.rpy), self.root_pose.xyz)


def check_soles(soles: dict[str, list[list[float]]], where: str) -> None:
    """Raises ModelError unless each sole is a flat polygon.

    Args:
        soles: link to the corners of its sole [m].
        where: what to call their owner in the message.
    """
    for link, corners in soles.items():
        name = f"{where}: soles: {link}"
        # Rows of unequal lengths are no array.
        if len(corners) < 3 or any(len(corner) != 3 for corner in corners):
            raise ModelError(
                f"{name}: {corners} must be at least three corners of three "
                "numbers each, [x, y, z] in the link's frame"
            )
        points = np.array(corners)
        if not np.isfinite(points).all():
            raise ModelError(f"{name}: {corners} must be finite numbers")
        # Singular values: the polygon's extents, the last one across it.
        extents = np.linalg.svd(points - points.mean(0), compute_uv=False)
        if extents[1] < SOLE_TOLERANCE:
            raise ModelError(f"{name}: the corners are on one line; give a polygon's")
        if len(extents) > 2 and extents[2] > SOLE_TOLERANCE:
            raise ModelError(
                f"{name}: the corners are {1e3 * extents[2]:.1f} mm off a plane; a "
                "sole is flat: give the corners of what touches a level floor"
            )


def is_speed_limit(value: float) -> bool:
    """Whether a largest speed makes sense: positive, perhaps infinite, not NaN."""
    return isinstance(value, Real) and not math.isnan(value) and value > 0.0


def robot_names() -> list[str]:
    """Names of the shipped robots, those to be imported among them."""
    models = data_folder("models")
    files = [*models.glob("*/robot.yaml"), *models.glob(f"*/{IMPORT_FILE}")]
    return sorted({path.parent.name for path in files})


def import_file(robot: str) -> Path | None:
    """The import file of a shipped robot whose model is not; None for others."""
    path = data_folder("models") / robot / IMPORT_FILE
    return path if robot and path.is_file() else None


def load_robot_description(robot: str | os.PathLike[str]) -> RobotDescription:
    """Loads a robot by name, or any `robot.yaml` (or its folder) by path.

    A name is that of a shipped robot, or of one that `crar-drake import-robot` has
    put into the user's cache. A relative path starts at the working directory.

    Raises:
        ModelError: there is no such robot, it is not imported yet, or its file is
            not a description; the message names file, key and line.
    """
    if not isinstance(robot, str | os.PathLike):
        raise ModelError(
            f"a robot is given by its name or path, not as {type(robot).__name__}"
        )
    path = Path(robot)
    if path.is_dir():
        path = path / "robot.yaml"
    if not path.is_file():
        path = _by_name(str(robot))
    description = load_yaml(
        read_text(path, ModelError),
        RobotDescription,
        str(path),
        ModelError,
        manual="models/README.md",
    )
    description.folder = str(path.parent)
    if not (path.parent / description.model).is_file():
        raise ModelError(
            f"{path}: model: {description.model!r} is not a file beside it"
        )
    description.validate()
    return description


def whole_body_name(robot: str) -> str:
    """The name of a robot's whole body, which reference motions are of.

    It is NAME_whole_body, where NAME alone is of the upper body, and else the name
    itself; a path stays what it is.
    """
    longer = f"{robot}_whole_body"
    if Path(robot).exists() or longer not in {*robot_names(), *imported_names()}:
        return robot
    return longer


def lasting_name(robot: str) -> str:
    """How a log names a robot: a name as it is, a path so that it is found from
    every working directory."""
    path = Path(robot)
    if robot and (path.is_file() or (path / "robot.yaml").is_file()):
        return os.path.abspath(robot)
    return robot


def is_path(robot: str) -> bool:
    """Whether a robot that is not there was meant as a path, not as a name."""
    return "/" in robot or os.sep in robot or robot.endswith((".yaml", ".yml"))


def _by_name(name: str) -> Path:
    """The robot.yaml of a shipped or imported robot."""
    if is_path(name):
        wanted = Path(name).absolute()
        if wanted.suffix not in (".yaml", ".yml"):
            wanted /= "robot.yaml"
        raise ModelError(f"robot {name!r}: there is no file {wanted}")
    shipped = data_folder("models") / name / "robot.yaml"
    if shipped.is_file():
        return shipped
    imported = imported_robots_folder() / name / "robot.yaml"
    source = import_file(name)
    if source is not None:
        if not imported.is_file():
            raise ModelError(
                f"robot {name!r} is not imported yet; its model is not shipped: "
                f"run `crar-drake import-robot {name}` once (it needs "
                f"`{install_command('robots')}`)"
            )
        made_from = imported.with_name(IMPORT_FILE)
        if not made_from.is_file() or made_from.read_bytes() != source.read_bytes():
            raise ModelError(
                f"robot {name!r} was imported with another {IMPORT_FILE} than the one "
                f"shipped now: run `crar-drake import-robot {name}` again"
            )
    if name and imported.is_file():
        return imported
    hint = nearest(name, {*robot_names(), *imported_names()})
    if name and "did you mean" not in hint:
        hint += (
            f"; a robot that was imported once is made again by `crar-drake "
            f"import-robot {name}`, or by import-robot and the path of its URDF"
        )
    raise ModelError(
        f"no robot {name!r}: neither a robot.yaml nor one of the shipped robots, nor "
        f"one imported into {imported_robots_folder()}{hint}"
    )


def imported_names() -> list[str]:
    """Names of the robots in the user's cache."""
    found = imported_robots_folder().glob("*/robot.yaml")
    return sorted(path.parent.name for path in found)


def add_robot(plant: MultibodyPlant, description: RobotDescription) -> None:
    """Parses the robot's model into a plant that is registered with a SceneGraph, and
    places it (`place_robot`). The plant is not finalized, and has nothing else (see
    `robot.beside`).

    Raises:
        ModelError: the model file cannot be parsed, or as `place_robot`.
    """
    check_model(description)
    model = Path(description.folder) / description.model
    try:
        model_parser(plant, description).AddModels(str(model))
    except RuntimeError as error:
        raise ModelError(f"{model}: {error}") from error
    for joint in map(plant.get_joint, plant.GetJointIndices()):
        lower, upper = joint.position_lower_limits(), joint.position_upper_limits()
        if np.isfinite(upper - lower).all():
            inset = 0.5 * (1.0 - description.range_share) * (upper - lower)
            joint.set_position_limits(lower + inset, upper - inset)
    place_robot(plant, description, description.rest_pose())


def robot_diagram(
    description: RobotDescription, time_step: float = 0.0
) -> tuple[Diagram, MultibodyPlant, SceneGraph]:
    """A diagram of a robot alone (`add_robot`), its plant, finalized, and its scene.

    Args:
        time_step: of the plant [s]; 0 if continuous.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step)
    add_robot(plant, description)
    plant.Finalize()
    return builder.Build(), plant, scene_graph


def check_model(description: RobotDescription) -> None:
    """Raises ModelError if the description has no model, which could be parsed."""
    if not description.model:
        raise ModelError(
            f"robot {description.name}: the description has no model, which could be "
            "parsed; of a robot that is in a plant of yours give "
            "ControlModel.FromPlant(plant, scene_graph, description, tasks)"
        )


def model_parser(plant: MultibodyPlant, description: RobotDescription) -> Parser:
    """A parser that knows the package in the description's folder."""
    parser = Parser(plant)
    # Drake wants to see a folder.
    package = (Path(description.folder) / "package.xml").absolute()
    if package.is_file():
        parser.package_map().AddPackageXml(str(package))
    return parser


def place_robot(
    plant: MultibodyPlant, description: RobotDescription, X_WB: RigidTransform
) -> None:
    """Welds the base of a robot in the plant to the world, unless it floats.

    A ground that the description has is added to the world's shapes, and a link for
    each thing of its environment.

    Args:
        X_WB: pose of the base in the world.

    Raises:
        ModelError: there is no such base, or it cannot be welded; or there is a ground,
            and a link "ground" as well; or a mesh of the environment cannot be used.
    """
    folder = Path(description.folder)
    model = folder / description.model
    if description.ground is not None:
        if plant.HasBodyNamed(GROUND):
            raise ModelError(
                f"{model}: there is a link {GROUND!r} already; leave ground out of "
                f"robot {description.name}"
            )
        _add_ground(plant, description.ground)
    try:
        add_environment(plant, description.environment, folder)
    except ModelError as error:
        raise ModelError(f"robot {description.name}: {error}") from error
    if not description.base:
        return
    if description.root != "fixed":
        body = find_body(plant, description.base)
        plant.SetDefaultFloatingBaseBodyPose(body, X_WB)
        return
    base = find_frame(plant, description.base)
    try:
        plant.WeldFrames(plant.world_frame(), base, X_WB)
    except RuntimeError as error:  # e.g. the model has welded it already
        raise ModelError(f"{model}: base: {description.base!r}: {error}") from error


def _add_ground(plant: MultibodyPlant, height: float) -> None:
    """A half space on the world itself, whose surface is at a height in it [m].

    On a link that is welded to the world it would be among the shapes that move, in
    whose tree of bounding boxes the infinite one makes Drake 1.51 and 1.58 crash now
    and then.
    """
    plant.RegisterCollisionGeometry(
        plant.world_body(),
        RigidTransform([0.0, 0.0, height]),
        HalfSpace(),
        f"{GROUND}_{plant.num_collision_geometries()}",
        CoulombFriction(1.0, 1.0),
    )


def zero_positions(plant: MultibodyPlant) -> np.ndarray:
    """(nq,) all joints at 0, and what floats at the origin, not turned."""
    q = np.zeros(plant.num_positions())
    q[quaternion_starts(plant)] = 1.0
    return q


def quaternion_starts(plant: MultibodyPlant) -> list[int]:
    """Where in q the quaternion (w x y z) of each body that floats begins."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    floating = [j for j in joints if isinstance(j, QuaternionFloatingJoint)]
    return [joint.position_start() for joint in floating]


def find_root(
    plant: MultibodyPlant, description: RobotDescription
) -> QuaternionFloatingJoint | None:
    """The joint by which a robot's base floats; None if nothing does.

    Raises:
        ModelError: something floats (or turns as a ball) of which the description does
            not say what moves it, or what it says to float does not.
    """
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    many = [joint for joint in joints if joint.num_positions() > joint.num_velocities()]
    body, root = None, None
    if description.root != "fixed":
        body = find_body(plant, description.base)
        root = next((j for j in many if j.child_body().index() == body.index()), None)
    for joint in many:
        if joint is root:
            continue
        name = joint.child_body().name()
        raise ModelError(
            f"robot {description.name}: link {name!r} has a joint with more positions "
            f"than velocities ({joint.type_name()}), and nothing says what moves it: "
            "weld it (plant.WeldFrames; of a robot.yaml, "
            f"base: {name} and root: fixed), or write root: prescribed, if "
            "it is the base of a whole body (retarget, or standing on its soles); "
            "loose things and ball joints cannot be in the control model"
        )
    if body is not None and root is None:
        raise ModelError(
            f"robot {description.name}: root: {description.root!r}, but its base "
            f"{body.name()!r} does not float by a quaternion in the plant; leave out "
            "what joins it to the world, or write root: fixed"
        )
    if root is not None and root.parent_body() != plant.world_body():
        raise ModelError(
            f"robot {description.name}: root: {description.root!r}, but its base "
            f"{root.child_body().name()!r} floats on {root.parent_body().name()!r}; "
            "let it float on the world"
        )
    return root


def find_frame(plant: MultibodyPlant, name: str) -> Frame:
    """The frame (or link) of that name, plain or scoped; ModelError if none."""
    return _find(plant, name, "frame", "GetFrameByName", frame_names)


def find_body(plant: MultibodyPlant, name: str) -> RigidBody:
    """The link of that name, plain or scoped; ModelError if none.

    "ground" is the world, if no link has that name.
    """
    if name == GROUND and not plant.HasBodyNamed(GROUND):
        return plant.world_body()
    return _find(plant, name, "link", "GetBodyByName", link_names)


def find_joint(plant: MultibodyPlant, name: str) -> Joint:
    """The joint of that name, plain or scoped; ModelError if none."""
    return _find(plant, name, "joint", "GetJointByName", _joint_names)


def _find(plant, name, what, getter, names):
    scoped = ScopedName.Parse(name)
    try:
        if scoped.get_namespace():
            instance = plant.GetModelInstanceByName(scoped.get_namespace())
            return getattr(plant, getter)(scoped.get_element(), instance)
        return getattr(plant, getter)(name)
    except RuntimeError as error:
        if "multiple" in str(error):
            owners = [each for each in names(plant) if each.endswith(f"::{name}")]
            raise ModelError(
                f"{what} {name!r} is in several models; write {' or '.join(owners)}"
            ) from error
        raise ModelError(
            f"the plant has no {what} {name!r}{nearest(name, names(plant))}"
        ) from error


def frame_names(plant: MultibodyPlant) -> list[str]:
    """Of all models in the plant, as in `link_names`."""
    frames = [plant.get_frame(FrameIndex(i)) for i in range(plant.num_frames())]
    return _unambiguous(plant, frames)


def link_names(plant: MultibodyPlant) -> list[str]:
    """Of all models in the plant; scoped where several have one name."""
    bodies = [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]
    return _unambiguous(plant, bodies)


def _joint_names(plant: MultibodyPlant) -> list[str]:
    return _unambiguous(plant, [plant.get_joint(i) for i in plant.GetJointIndices()])


def _unambiguous(
    plant: MultibodyPlant, named: Sequence[RigidBody | Frame | Joint]
) -> list[str]:
    plain = Counter(each.name() for each in named)
    return [
        each.name()
        if plain[each.name()] == 1
        else f"{plant.GetModelInstanceName(each.model_instance())}::{each.name()}"
        for each in named
    ]
