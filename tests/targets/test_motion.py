"""What a motion drives the prescribed joints with."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from scipy.spatial.transform import Rotation
from small_robots import add_plant

from crar_drake.errors import ScenarioError
from crar_drake.motion.catalogue import load_performer
from crar_drake.robot.description import RobotDescription, load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task, position_tasks
from crar_drake.run import run_scenario
from crar_drake.simulation.diagram import load_desired_motion
from crar_drake.simulation.scenario import Scenario
from crar_drake.targets.motion import load_motion_targets, segment_lengths

POINTS = {  # of a standing robot, in its trunk's frame [m]
    "neck": (0.0, 0.0, 0.4),
    "left_shoulder": (0.0, 0.2, 0.4),
    "left_elbow": (0.0, 0.2, 0.1),
    "left_wrist": (0.0, 0.2, -0.1),
    "right_shoulder": (0.0, -0.2, 0.4),
    "right_elbow": (0.0, -0.2, 0.1),
    "right_wrist": (0.0, -0.2, -0.1),
    "left_hand": (0.0, 0.2, -0.18),
}
WAIST = (0.05, 0.02, 0.9)  # away from the heading's axis
BASE = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1", "heading": "0 0 1", "lean": "0 1 0"}


def trunk_urdf() -> str:
    inertia = (
        '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
        'iyz="0"/></inertial>'
    )
    parts, parent = ['<link name="base"/>'], "base"
    for name, axis in BASE.items():
        kind = "continuous" if name in ("heading", "lean") else "prismatic"
        parts.append(
            f'<link name="{name}_link">{inertia}</link><joint name="{name}" '
            f'type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<axis xyz="{axis}"/></joint><transmission name="t_{name}">'
            "<type>transmission_interface/SimpleTransmission</type>"
            f'<joint name="{name}"/><actuator name="{name}"/></transmission>'
        )
        parent = f"{name}_link"
    for name, p in {"waist": (0, 0, 0), **POINTS}.items():
        xyz = " ".join(map(str, np.add(p, WAIST)))
        parts.append(f'<frame name="{name}" link="{parent}" xyz="{xyz}" rpy="0 0 0"/>')
    return f'<robot name="trunk">{"".join(parts)}</robot>'


def trunk(tasks: list[Task]) -> ControlModel:
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, trunk_urdf())
    description = RobotDescription(
        name="trunk",
        prescribed_joints={
            "heading": "waist.heading",
            "x": "waist.x",
            "y": "waist.y",
            "z": "waist.z",
        },
        task_frames={name: name for name in ("waist", *POINTS)},
    )
    return ControlModel.FromPlant(plant, scene_graph, description, tasks)


@pytest.fixture(scope="module")
def model() -> ControlModel:
    return trunk(position_tasks(["left_wrist"]))


HAND_TASKS = [  # 15 rows
    Task(frame="left_hand", kind="orientation", name="turn"),
    Task(frame="left_wrist"),
    Task(frame="left_hand", kind="pose", name="grip"),
    Task(frame="left_hand", name="reach"),
]


@pytest.fixture(scope="module")
def with_hands() -> ControlModel:
    return trunk(HAND_TASKS)


def test_waist_and_heading_are_the_performers(model):
    """At every time the robot's waist is where the motion's is, and as turned."""
    motion = load_motion_targets("dance", model)
    dancer = load_performer("dance")
    p_waist = dancer.positions["pelvis"]
    scale = segment_lengths(model)["waist"] / dancer.hip_height
    context = model.plant.CreateDefaultContext()
    waist = model.plant.GetFrameByName("waist")
    names = list(model.description.prescribed_joints)
    for frame in range(0, dancer.num_frames, 97):
        time = frame / dancer.frame_rate
        if time > motion.duration:
            break
        q = motion.prescribed_at(time)
        whole = np.zeros(model.plant.num_positions())
        for name, value in zip(names, q, strict=True):
            whole[model.plant.GetJointByName(name).position_start()] = value
        model.plant.SetPositions(context, whole)
        X = waist.CalcPoseInWorld(context)
        expected = p_waist[frame] * scale
        expected[:2] -= p_waist[0, :2] * scale
        # The low-pass moves a fast dancer by a few millimetres.
        np.testing.assert_allclose(X.translation(), expected, atol=0.02)
        turned = X.rotation().ToRollPitchYaw().yaw_angle() - dancer.heading[frame]
        assert abs(np.angle(np.exp(1j * turned))) < 0.05
    assert np.ptp(dancer.heading) > np.pi  # it does turn


def test_the_heading_is_followed_beyond_a_full_turn(model):
    motion = load_motion_targets("dance", model)
    times = np.linspace(0.0, motion.duration, 500)
    heading = np.array([motion.prescribed_at(t)[0] for t in times])
    assert np.abs(np.diff(heading)).max() < 1.0  # no jump by a whole turn


def test_positions_alone_take_drakes_source(model):
    scenario = Scenario(motion="dance", experiment="wrists")
    motion = load_desired_motion(scenario, model)
    assert isinstance(motion.MakeTaskSource(), TrajectorySource)


def test_hands_are_turned_as_the_performers(with_hands):
    """In the order of the layout, the hand 8 cm ahead of the wrist."""
    scenario = Scenario(motion="dance", tasks=HAND_TASKS)
    motion = load_desired_motion(scenario, with_hands)
    performer = load_performer("dance")
    R_WH = performer.hands["left_hand"]
    wrist = load_motion_targets("dance", trunk(position_tasks(["left_wrist"])))
    source = motion.MakeTaskSource()
    context = source.CreateDefaultContext()
    for frame in range(0, performer.num_frames, 53):
        time = frame / performer.frame_rate
        context.SetTime(time)
        value = source.get_output_port().Eval(context)
        np.testing.assert_array_equal(value, motion.tasks_at(time))
        desired = with_hands.layout.unpack(value)
        turned, grip = desired.R
        np.testing.assert_array_equal(turned, grip)
        # The low-pass turns a fast dancer's hand by a few degrees.
        assert Rotation.from_matrix(turned @ R_WH[frame].T).magnitude() < 0.1
        p_wrist, p_grip, p_reach = desired.p
        np.testing.assert_allclose(p_wrist, wrist.tasks_at(time)[:3], atol=1e-12)
        np.testing.assert_allclose(p_grip, p_wrist + 0.08 * turned[:, 0], atol=1e-12)
        np.testing.assert_array_equal(p_grip, p_reach)


@pytest.mark.parametrize("t", [0.4, 3.21, 7.5, 11.03])
def test_derivatives_of_hands(with_hands, t):
    motion = load_desired_motion(Scenario(motion="dance", tasks=HAND_TASKS), with_hands)
    h = 1e-5
    layout = with_hands.layout
    before, now, after = (layout.unpack(motion.tasks_at(t + k * h)) for k in (-1, 0, 1))
    turn = Rotation.from_matrix(after.R @ before.R.swapaxes(1, 2)).as_rotvec()
    v = now.v
    np.testing.assert_allclose(v[layout.angular_rows], turn / (2 * h), atol=1e-5)
    rate = (after.p - before.p) / (2 * h)
    np.testing.assert_allclose(v[layout.linear_rows], rate, atol=1e-5)
    np.testing.assert_allclose(now.a, (after.v - before.v) / (2 * h), atol=1e-2)


def test_hands_stand_still_after_the_end(with_hands):
    motion = load_desired_motion(Scenario(motion="dance", tasks=HAND_TASKS), with_hands)
    layout = with_hands.layout
    last = layout.unpack(motion.tasks_at(motion.duration))
    after = layout.unpack(motion.tasks_at(motion.duration + 1.0))
    np.testing.assert_allclose(after.R, last.R, atol=1e-12)
    np.testing.assert_allclose(after.p, last.p, atol=1e-12)
    assert last.v.any() and not after.v.any() and not after.a.any()


@pytest.mark.parametrize(
    "task, words",
    [
        (
            Task(frame="left_wrist", kind="orientation"),
            ["no orientation of left_wrist"],
        ),
        (Task(frame="neck", kind="pose", name="nod"), ["task nod", "left_hand"]),
        (Task(frame="lean_link"), ["task lean_link", "left_wrist", "keyframes"]),
        (Task(kind="joint", joint="lean"), ["task lean", "no joint positions"]),
    ],
)
def test_refused_tasks(task, words):
    with pytest.raises(ScenarioError) as caught:
        load_motion_targets("dance", trunk([task]))
    for word in words:
        assert word in str(caught.value)


def test_a_link_that_is_called_hand_is_no_task_frame():
    model = ControlModel.FromDescription(
        load_robot_description("upper_body"),
        [Task(frame="left_hand", kind="orientation")],
    )
    with pytest.raises(ScenarioError, match="upper_body has no task_frame left_hand"):
        load_motion_targets("dance", model)


def test_a_hand_is_turned_in_a_closed_loop(tmp_path):
    """The shipped robot, its left hand's orientation instead of its wrist's place."""
    shipped = load_robot_description("upper_body")
    text = (Path(shipped.folder) / "robot.yaml").read_text()
    text = text.replace(
        f"model: {shipped.model}", f"model: {Path(shipped.folder) / shipped.model}"
    ).replace("task_frames:", "task_frames:\n  left_hand: left_hand\n#")
    (tmp_path / "robot.yaml").write_text(text)
    tasks = [Task(frame="left_hand", kind="orientation"), Task(frame="right_wrist")]
    scenario = Scenario(robot=str(tmp_path), motion="dance", tasks=tasks, duration=1.0)
    result = run_scenario(scenario, record=False)
    assert result.summary.violated_samples == 0
    model, log = result.setup.model, result.log
    workspace = model.MakeWorkspace()
    state = model.evaluate(workspace, log.q[-1], log.v[-1])
    desired = model.layout.unpack(log.desired_tasks[-1])
    assert Rotation.from_matrix(state.R[0] @ desired.R[0].T).magnitude() < 0.1
