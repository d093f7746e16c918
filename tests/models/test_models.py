"""The shipped robot models, read by Drake and compared with their READMEs."""

import fnmatch
import importlib
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuatorIndex

from crar_drake.judging.referee import Referee
from crar_drake.resources import data_folder
from crar_drake.robot.description import (
    load_robot_description,
    model_parser,
    robot_diagram,
)
from crar_drake.robot_import.pair_sampling import position_ranges

MODELS = data_folder("models")
ROBOTS = ("upper_body", "obstacle_arm", "tipping_cell")
WAIST = ("waist_x", "waist_y", "waist_z")


class Loaded:
    """A robot in a diagram, with the contexts to ask it."""

    def __init__(self, name: str) -> None:
        self.description = load_robot_description(name)
        self.diagram, self.plant, self.scene_graph = robot_diagram(self.description)
        self.root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)
        self._referee = Referee(self.plant, self.scene_graph, self.description.pairs)

    def positions(self, posture: dict[str, float]) -> np.ndarray:
        q = np.zeros(self.plant.num_positions())
        for joint, value in posture.items():
            q[self.plant.GetJointByName(joint).position_start()] = value
        return q

    def pair_distances(self, q: np.ndarray) -> dict[tuple[str, str], float]:
        """Leaves the context there."""
        self.plant.SetPositions(self.context, q)
        pairs = map(tuple, self.description.pairs)
        return dict(zip(pairs, self._referee.distances(q), strict=True))

    def random_positions(self, rng: np.random.Generator) -> np.ndarray:
        return rng.uniform(*position_ranges(self.plant))

    def moving_joints(self) -> list:
        joints = map(self.plant.get_joint, self.plant.GetJointIndices())
        return [joint for joint in joints if joint.num_velocities() > 0]


@pytest.fixture(scope="module")
def robots() -> dict[str, Loaded]:
    return {name: Loaded(name) for name in ROBOTS}


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest, robots: dict[str, Loaded]) -> Loaded:
    return robots[request.param]


@pytest.fixture
def upper_body(robots: dict[str, Loaded]) -> Loaded:
    return robots["upper_body"]


@pytest.mark.parametrize("name", ROBOTS)
def test_drake_has_nothing_to_warn_of(name: str) -> None:
    plant, description = MultibodyPlant(0.0), load_robot_description(name)
    parser = model_parser(plant, description)
    parser.SetStrictParsing()
    parser.AddModels(str(MODELS / name / description.model))


def test_upper_body_has_the_papers_joints(upper_body: Loaded) -> None:
    sides = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow")
    controlled = {"torso_yaw", "torso_pitch", "torso_roll"}
    controlled |= {f"{side}_{joint}" for side in ("left", "right") for joint in sides}
    assert len(controlled) == 11
    names = {joint.name() for joint in upper_body.moving_joints()}
    assert names == controlled | set(WAIST)
    assert upper_body.plant.num_velocities() == 14
    assert set(upper_body.description.prescribed_joints) == set(WAIST)


def test_every_joint_has_an_actuator_of_its_name(robot: Loaded) -> None:
    plant = robot.plant
    assert plant.num_actuators() == plant.num_velocities()
    for joint in robot.moving_joints():
        actuator = plant.GetJointActuatorByName(joint.name())
        assert actuator.joint().index() == joint.index()
        assert 0 < actuator.effort_limit() < np.inf
        assert 0 < joint.velocity_upper_limits()[0] < np.inf
        assert np.all(joint.default_damping_vector() == 0)


def test_limits(robot: Loaded) -> None:
    for joint in robot.moving_joints():
        lower = joint.position_lower_limits()[0]
        upper = joint.position_upper_limits()[0]
        if joint.name() == "torso_yaw":
            assert lower == -np.inf and upper == np.inf
        elif joint.name() not in WAIST:
            assert -np.pi - 1e-6 <= lower < 0 <= upper <= np.pi
    q_rest = robot.positions(robot.description.rest_posture)
    assert np.all(q_rest > robot.plant.GetPositionLowerLimits())
    assert np.all(q_rest < robot.plant.GetPositionUpperLimits())


def test_mass_matrix_is_positive_definite(robot: Loaded) -> None:
    rng = np.random.default_rng(0)
    for k in range(400):
        q = robot.random_positions(rng)
        if k % 2:  # right angles: where the axes of a shoulder align
            q = np.round(q / (np.pi / 2)) * np.pi / 2
        robot.plant.SetPositions(robot.context, q)
        mass_matrix = robot.plant.CalcMassMatrix(robot.context)
        # 1e-4 kg m^2 is a ball of 50 g and 70 mm: real, not rounding.
        assert np.linalg.eigvalsh(mass_matrix)[0] > 1e-4


@pytest.mark.parametrize(
    ("name", "clearance"), [("upper_body", 0.02), ("obstacle_arm", 0.05)]
)
def test_rest_posture_is_clear(
    robots: dict[str, Loaded], name: str, clearance: float
) -> None:
    robot = robots[name]
    q_rest = robot.positions(robot.description.rest_posture)
    for pair, distance in robot.pair_distances(q_rest).items():
        assert distance > clearance, pair
    # Nothing else touches either, so contact may be switched on.
    query = robot.scene_graph.get_query_output_port().Eval(
        robot.scene_graph.GetMyContextFromRoot(robot.root)
    )
    assert query.ComputePointPairPenetration() == []


@pytest.mark.parametrize(
    "posture",
    [
        pytest.param(
            {"left_shoulder_roll": 0.1, "right_shoulder_roll": -0.1},
            id="arms hanging straight",
        ),
        pytest.param(
            {"left_shoulder_pitch": -3.1, "right_shoulder_pitch": -3.1},
            id="arms up",
        ),
        pytest.param(
            {
                "left_shoulder_pitch": -0.9,
                "left_shoulder_yaw": -0.6,
                "left_elbow": -2.3,
                "right_shoulder_pitch": -0.5,
                "right_shoulder_yaw": 0.9,
                "right_elbow": -1.3,
            },
            id="one hand at the face, one before the belly",
        ),
    ],
)
def test_natural_poses_are_free(upper_body: Loaded, posture: dict) -> None:
    distances = upper_body.pair_distances(upper_body.positions(posture))
    assert min(distances.values()) > 0.01


def mirrored(robot: Loaded, q: np.ndarray) -> np.ndarray:
    """Returns q of the mirror image in the plane y = 0."""
    posture = {}
    for joint in robot.moving_joints():
        name = joint.name()
        sign = -1 if name.endswith(("_y", "_yaw", "_roll")) else 1
        other = name.replace("left_", "\0").replace("right_", "left_")
        posture[other.replace("\0", "right_")] = sign * q[joint.position_start()]
    return robot.positions(posture)


def test_left_and_right_are_mirror_images(upper_body: Loaded) -> None:
    plant, context = upper_body.plant, upper_body.context
    rng = np.random.default_rng(2)
    frames = upper_body.description.task_frames.values()
    swap = {"left": "right", "right": "left"}

    def other(name: str) -> str:
        side, _, rest = name.partition("_")
        return f"{swap[side]}_{rest}" if side in swap else name

    for _ in range(10):
        q = upper_body.random_positions(rng)
        q_mirror = mirrored(upper_body, q)
        assert np.all(q_mirror >= plant.GetPositionLowerLimits())
        assert np.all(q_mirror <= plant.GetPositionUpperLimits())

        plant.SetPositions(context, q)
        points = {
            name: plant.GetFrameByName(name).CalcPoseInWorld(context).translation()
            for name in frames
        }
        energy = plant.CalcPotentialEnergy(context)
        distances = upper_body.pair_distances(q)
        mass = np.sort(np.linalg.eigvalsh(plant.CalcMassMatrix(context)))

        mirror_distances = upper_body.pair_distances(q_mirror)
        for name, p_W in points.items():
            p_mirror = plant.GetFrameByName(other(name)).CalcPoseInWorld(context)
            np.testing.assert_allclose(
                p_mirror.translation(), p_W * [1, -1, 1], atol=1e-9
            )
        assert plant.CalcPotentialEnergy(context) == pytest.approx(energy)
        np.testing.assert_allclose(
            np.linalg.eigvalsh(plant.CalcMassMatrix(context)), mass, rtol=1e-6
        )
        by_names = {frozenset(pair): d for pair, d in mirror_distances.items()}
        for (a, b), distance in distances.items():
            # FCL's iteration stops at some tolerance, hence not equal to the bit.
            assert by_names[frozenset((other(a), other(b)))] == pytest.approx(
                distance, abs=1e-4
            )


def test_zero_configuration(upper_body: Loaded) -> None:
    plant, context = upper_body.plant, upper_body.context
    plant.SetPositions(context, np.zeros(plant.num_positions()))
    frames = upper_body.description.task_frames

    def p_W(point: str) -> np.ndarray:
        return (
            plant.GetFrameByName(frames[point]).CalcPoseInWorld(context).translation()
        )

    np.testing.assert_array_equal(p_W("waist"), np.zeros(3))
    for side, sign in (("left", 1), ("right", -1)):
        shoulder, elbow, wrist = (
            p_W(f"{side}_{point}") for point in ("shoulder", "elbow", "wrist")
        )
        np.testing.assert_allclose(
            shoulder, [0, sign * 0.129 * 1.3, 0.288 * 1.3], atol=1e-9
        )
        np.testing.assert_allclose(elbow - shoulder, [0, 0, -0.186 * 1.3], atol=1e-9)
        np.testing.assert_allclose(wrist - elbow, [0, 0, -0.146 * 1.3], atol=1e-9)
    assert p_W("neck")[2] > p_W("left_shoulder")[2]


def test_prescribed_joints_are_the_waists_coordinates(upper_body: Loaded) -> None:
    plant, context = upper_body.plant, upper_body.context
    posture = {"waist_x": 0.3, "waist_y": -0.2, "waist_z": 0.7, "torso_yaw": 1.0}
    plant.SetPositions(context, upper_body.positions(posture))
    waist = plant.GetFrameByName("waist").CalcPoseInWorld(context)
    np.testing.assert_allclose(waist.translation(), [0.3, -0.2, 0.7], atol=1e-12)


def test_signs_of_the_joints(upper_body: Loaded) -> None:
    plant, context = upper_body.plant, upper_body.context

    def p_W(frame: str, posture: dict[str, float]) -> np.ndarray:
        plant.SetPositions(context, upper_body.positions(posture))
        return plant.GetFrameByName(frame).CalcPoseInWorld(context).translation()

    assert p_W("left_hand", {"left_shoulder_pitch": -1.0})[0] > 0.3  # forward
    assert p_W("left_hand", {"left_shoulder_roll": 1.0})[1] > 0.4  # outward
    assert p_W("right_hand", {"right_shoulder_roll": -1.0})[1] < -0.4
    assert p_W("left_hand", {"left_elbow": -1.5})[0] > 0.15  # forward
    assert p_W("neck", {"torso_pitch": 0.5})[0] > 0.1  # bends forward


@pytest.mark.parametrize(
    ("name", "model"), [("upper_body", "upper_body"), ("obstacle_arm", "arm")]
)
def test_total_mass_is_the_readmes(
    robots: dict[str, Loaded], name: str, model: str
) -> None:
    robot = robots[name]
    text = (MODELS / name / "README.md").read_text("utf-8")
    stated = re.search(r"Total mass of the \w+: ([\d.]+) kg", text)
    assert stated
    instance = robot.plant.GetModelInstanceByName(model)
    mass = robot.plant.CalcTotalMass(robot.context, [instance])
    assert mass == pytest.approx(float(stated.group(1)), abs=1e-3)


@pytest.mark.parametrize("name", ["upper_body", "obstacle_arm"])
def test_the_readme_states_efforts_and_speeds(
    robots: dict[str, Loaded], name: str
) -> None:
    text = (MODELS / name / "README.md").read_text("utf-8")
    rows = re.findall(
        r"^\| (`.*?`) \|.*\| ([\d.]+) Nm? \| ([\d.]+) (?:rad|m)/s \|$",
        text,
        re.MULTILINE,
    )
    stated = {
        pattern: (float(effort), float(speed))
        for patterns, effort, speed in rows
        for pattern in re.findall("`(.*?)`", patterns)
    }
    plant = robots[name].plant
    for joint in robots[name].moving_joints():
        # The right side is the mirror image.
        names = (joint.name(), joint.name().replace("right_", "left_"))
        (found,) = {
            pair
            for pattern, pair in stated.items()
            if any(fnmatch.fnmatchcase(n, pattern) for n in names)
        }
        effort = plant.GetJointActuatorByName(joint.name()).effort_limit()
        assert (effort, joint.velocity_upper_limits()[0]) == found, joint.name()


def test_efforts_hold_the_robot_up(robot: Loaded) -> None:
    rng = np.random.default_rng(3)
    plant, context = robot.plant, robot.context
    worst = np.zeros(plant.num_velocities())
    for k in range(2000):
        q = robot.random_positions(rng)
        if k % 2:
            q = np.round(q / (np.pi / 2)) * np.pi / 2  # outstretched
        q = np.clip(q, plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits())
        plant.SetPositions(context, q)
        worst = np.maximum(worst, np.abs(plant.CalcGravityGeneralizedForces(context)))
    for k in range(plant.num_actuators()):
        actuator = plant.get_joint_actuator(JointActuatorIndex(k))
        torque = worst[actuator.joint().velocity_start()]
        # Half of it is left to move with.
        assert torque < 0.5 * actuator.effort_limit(), actuator.name()


@pytest.mark.parametrize(
    ("module", "function", "file"),
    [
        ("make_upper_body", "upper_body_urdf", "upper_body/upper_body.urdf"),
        ("make_obstacle_arm", "obstacle_arm_urdf", "obstacle_arm/obstacle_arm.urdf"),
        ("make_obstacle_arm", "obstacle_urdf", "obstacle_arm/obstacle.urdf"),
        ("make_tipping_cell", "frame_urdf", "tipping_cell/frame.urdf"),
        ("make_shelf_arm", "shelf_obj", "shelf_arm/shelf.obj"),
    ],
)
def test_files_are_what_the_scripts_write(
    monkeypatch: pytest.MonkeyPatch, module: str, function: str, file: str
) -> None:
    monkeypatch.syspath_prepend(str(MODELS))
    text = getattr(importlib.import_module(module), function)()
    assert text == (MODELS / file).read_text("utf-8")


def test_picture_script_refuses_a_bad_pose(tmp_path: Path) -> None:
    result = subprocess.run(
        [
            sys.executable,
            str(MODELS / "render_picture.py"),
            str(MODELS / "upper_body" / "robot.yaml"),
            *("--pose", "left_elbow", "--out", str(tmp_path / "p.png")),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2
    assert "joint=value" in result.stderr
