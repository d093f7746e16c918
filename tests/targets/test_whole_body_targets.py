"""A whole body on a small robot: tasks and root are on the retargeted motion."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_walker import walker

from crar_drake.errors import MotionError, ScenarioError
from crar_drake.motion.catalogue import load_performer
from crar_drake.robot.description import find_frame
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task, experiment_tasks, position_tasks
from crar_drake.simulation.diagram import PrepareScenario
from crar_drake.simulation.scenario import Scenario
from crar_drake.targets.motion import load_motion_targets
from crar_drake.targets.whole_body import WholeBodyMotion
from crar_drake.trajectory import retargeted_motion as kept
from crar_drake.trajectory.retargeted_motion import RATE, retargeted_motion
from crar_drake.trajectory.retargeting import RetargetingParameters

TASKS = [*experiment_tasks("whole-body"), Task(frame="head")]
FRAMES = 180  # of the dance, at 60 Hz


@pytest.fixture(scope="module")
def description(tmp_path_factory):
    return walker(tmp_path_factory.mktemp("walker"))


@pytest.fixture(scope="module")
def model(description) -> ControlModel:
    return ControlModel.FromDescription(description, TASKS)


def beginning(performer, frames=FRAMES):
    """The first frames alone."""
    parts = {
        name: {joint: x[:frames] for joint, x in getattr(performer, name).items()}
        for name in ("positions", "orientations", "hands")
    }
    return replace(performer, heading=performer.heading[:frames], **parts)


@pytest.fixture(scope="module")
def performer():
    return beginning(load_performer("dance"))


@pytest.fixture(scope="module")
def motion(model, performer):
    return WholeBodyMotion(model, performer, 6.0)


def set_frame(model, performer, k):
    """Drake's context with the robot in frame k of the retargeted motion."""
    retargeter, found = retargeted_motion(model.description, performer)
    plant = model.plant
    context = plant.CreateDefaultContext()
    for name, q in zip(retargeter.model.joint_names, found.q[k], strict=True):
        plant.GetJointByName(name).set_angle(context, q)
    X_WR = np.eye(4)
    X_WR[:3, :3], X_WR[:3, 3] = found.root_rotations[k], found.root_positions[k]
    base = plant.GetBodyByName(model.description.base)
    plant.SetFreeBodyPose(context, base, type(base.EvalPoseInWorld(context))(X_WR))
    return context


@pytest.mark.parametrize("k", [0, 17, 60, 89])
def test_tasks_and_root_are_where_drake_has_them_in_the_retargeted_frames(
    model, performer, motion, k
):
    context = set_frame(model, performer, k)
    desired = model.layout.unpack(motion.tasks_at(k / RATE))
    turned = iter(desired.R)
    points = dict(zip(model.layout.linear_tasks.tolist(), desired.p, strict=True))
    for i, task in enumerate(model.tasks):
        frame = find_frame(model.plant, model.description.task_frames[task.frame])
        X_WF = frame.CalcPoseInWorld(context)
        np.testing.assert_allclose(points[i], X_WF.translation(), atol=1e-9)
        if task.kind == "pose":
            R = X_WF.rotation().matrix()
            np.testing.assert_allclose(next(turned), R, atol=1e-9)
    q = model.plant.GetPositions(context)
    told = motion.prescribed_at(k / RATE)[:7]
    told[:4] *= np.sign(told[:4] @ q[model.root_positions[:4]])
    np.testing.assert_allclose(told, q[model.root_positions], atol=1e-9)


def test_tasks_have_their_derivatives(model, motion):
    layout, h = model.layout, 1e-5
    for time in np.linspace(0.1037, motion.duration - 0.1071, 9):
        before, here, after = (
            layout.unpack(motion.tasks_at(time + k * h)) for k in (-1, 0, 1)
        )
        rate = (after.p - before.p) / (2 * h)
        np.testing.assert_allclose(here.v[layout.linear_rows], rate, atol=1e-5)
        turn = Rotation.from_matrix(after.R @ before.R.swapaxes(1, 2)).as_rotvec()
        np.testing.assert_allclose(
            here.v[layout.angular_rows], turn / (2 * h), atol=1e-5
        )
        np.testing.assert_allclose(here.a, (after.v - before.v) / (2 * h), atol=1e-2)


def test_the_root_has_its_derivatives(motion):
    h = 1e-5
    for time in np.linspace(0.1037, motion.duration - 0.1071, 9):
        before, here, after = (motion.prescribed_at(time + k * h) for k in (-1, 0, 1))
        np.testing.assert_allclose(
            here[10:13], (after[4:7] - before[4:7]) / (2 * h), atol=1e-5
        )
        a, b = (Rotation.from_quat(x[[1, 2, 3, 0]]) for x in (before[:4], after[:4]))
        omega = (b * a.inv()).as_rotvec() / (2 * h)
        np.testing.assert_allclose(here[7:10], omega, atol=1e-5)
        rate = (after[7:13] - before[7:13]) / (2 * h)
        np.testing.assert_allclose(here[13:], rate, atol=1e-2)


def test_after_its_end_it_stands_still(model, motion):
    last, after = (
        model.layout.unpack(motion.tasks_at(motion.duration + t)) for t in (0.0, 1.0)
    )
    np.testing.assert_array_equal(after.p, last.p)
    np.testing.assert_array_equal(after.R, last.R)
    assert last.v.any() and not after.v.any() and not after.a.any()
    assert not motion.prescribed_at(motion.duration + 1.0)[7:].any()


def test_a_scenario_follows_all_joints_from_where_they_begin(description):
    scenario = Scenario(
        robot=description.folder, motion="dance", experiment="whole-body"
    )
    setup = PrepareScenario(scenario)
    model, performer = setup.model, load_performer("dance")
    context = set_frame(model, performer, 0)
    np.testing.assert_allclose(
        np.abs(setup.start_positions),
        np.abs(model.plant.GetPositions(context)),
        atol=1e-9,
    )
    names = model.layout.names
    assert names[: len(experiment_tasks("whole-body"))][-1] == "right_knee"
    assert set(model.joint_names) <= set(names) and len(set(names)) == len(names)
    context = set_frame(model, performer, 40)
    desired = model.layout.unpack(setup.motion.tasks_at(40 / RATE))
    joints = [x for x, kind in zip(names, model.layout.kinds, strict=True)]
    joints = joints[-len(desired.q) :]
    expected = [model.plant.GetJointByName(x).get_angle(context) for x in joints]
    np.testing.assert_allclose(desired.q, expected, atol=1e-9)


def test_what_was_asked_for_is_known(description, performer, monkeypatch):
    one = retargeted_motion(description, performer)
    again = retargeted_motion(replace(description), beginning(performer))
    assert again[1] is one[1]
    # Of any other part it is another motion.
    moved = {joint: p.copy() for joint, p in performer.positions.items()}
    moved["left_wrist"][5] += 1e-6
    asked = []
    monkeypatch.setattr(
        kept.Retargeter, "retarget", lambda *of: asked.append(of) or "other"
    )
    assert retargeted_motion(description, replace(performer, positions=moved))[1] == (
        "other"
    )
    other = replace(description, rest_posture={})
    assert retargeted_motion(other, performer)[1] == "other"
    slower = RetargetingParameters(cutoff=3.0)
    assert retargeted_motion(description, performer, RATE, slower)[1] == "other"
    assert retargeted_motion(description, performer, 20.0)[1] == "other"
    assert len(asked) == 4
    # No more than a few are kept: then the first is found anew.
    for rate in range(1, 9):
        retargeted_motion(description, performer, float(rate))
    assert retargeted_motion(description, performer)[1] == "other"
    kept._known.clear()


def test_legs_are_asked_to_keep_apart(tmp_path, performer):
    """Knees with balls that touch, where they are nearest, if nothing is asked; while a
    foot is in the air."""
    raised = dict(performer.positions)
    hip = raised["left_hip"]
    across = hip - raised["right_hip"]
    across = across / np.linalg.norm(across, axis=1)[:, None]
    ahead = Rotation.from_rotvec(-0.9 * across)
    for joint in ("left_knee", "left_ankle"):
        raised[joint] = hip + ahead.apply(raised[joint] - hip)
    performer = replace(performer, positions=raised)
    radius = 0.06
    thick = walker(tmp_path, knee=radius)

    def nearest(asked: float) -> float:
        retargeter, found = retargeted_motion(
            thick, performer, RATE, RetargetingParameters(between_legs=asked)
        )
        ways = retargeter.ways(
            found.root_positions,
            found.root_rotations,
            found.q,
            [("left_knee", "right_knee")],
        )
        left = found.targets.feet["left"]
        assert not (left.on_heel | left.on_ball).any()
        return float(np.linalg.norm(ways[0], axis=1).min()) - 2.0 * radius

    free = nearest(0.0)
    assert free > 0.004
    asked = free + 0.01
    assert nearest(asked) > asked


def test_points_relative_to_the_pelvis_are_refused(model, performer):
    """As of a pose estimator."""
    p = performer.positions
    still = {joint: q - p["pelvis"] + p["pelvis"][0] for joint, q in p.items()}
    with pytest.raises(MotionError, match="the pelvis never moves, although a foot"):
        WholeBodyMotion(model, replace(performer, positions=still), 6.0)


def test_a_performer_that_lacks_something_is_refused(model, performer):
    short = beginning(performer, 2)
    with pytest.raises(MotionError, match="0.017 s are too short: two frames at 30"):
        WholeBodyMotion(model, short, 6.0)
    headless = {joint: p for joint, p in performer.positions.items() if joint != "head"}
    with pytest.raises(MotionError, match="it has no head; leave that out"):
        WholeBodyMotion(model, replace(performer, positions=headless), 6.0)
    toeless = {k: p for k, p in performer.positions.items() if "toe" not in k}
    with pytest.raises(MotionError, match="no left_toe, right_toe, and so no feet"):
        toeless = replace(performer, positions=toeless, orientations={})
        WholeBodyMotion(model, toeless, 6.0)


def test_tasks_and_robots_that_cannot_follow_are_refused(description):
    fixed = replace(description, root="fixed")
    tasks = position_tasks(["left_knee"])
    with pytest.raises(ScenarioError, match="import it with --whole-body"):
        load_motion_targets("dance", ControlModel.FromDescription(fixed, tasks))
    tasks = [Task(frame="left_knee", kind="orientation")]
    with pytest.raises(ScenarioError, match="no orientation of left_knee"):
        load_motion_targets("dance", ControlModel.FromDescription(description, tasks))
    tasks = [Task(frame="neck"), Task(kind="joint", joint="left_shank_j")]
    with pytest.raises(ScenarioError, match="without a foot or a knee"):
        load_motion_targets("dance", ControlModel.FromDescription(description, tasks))
    frames = {k: v for k, v in description.task_frames.items() if k != "head"}
    headless = replace(description, task_frames=frames | {"crown": "head"})
    with pytest.raises(ScenarioError, match="no task_frame head"):
        load_motion_targets(
            "dance", ControlModel.FromDescription(headless, position_tasks(["head"]))
        )
