"""The page of a log: what is drawn when, and what a browser makes of it."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from browser import Look, look_at
from spy_meshcat import SpyMeshcat

from crar_drake.equations.tasks import TaskLayout
from crar_drake.errors import CrarError, ModelError
from crar_drake.results.log import SimulationLog
from crar_drake.results.playback import record_log, save_recording
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task, position_tasks
from crar_drake.simulation.scenario import Scenario

LEFT, RIGHT = (
    f"/drake/illustration/upper_body/{side}_hand/near" for side in ("left", "right")
)
TASKS = position_tasks(["left_wrist", "right_wrist"])
FPS = 32.0


@pytest.fixture(scope="module")
def meshcat() -> SpyMeshcat:
    return SpyMeshcat()


def make_log(robot: str, tasks: list[Task], duration: float) -> SimulationLog:
    """A made-up run at 100 Hz: every joint swings, and the targets rise by 0.1 m/s.

    All pairs are 0.1 m apart, but the first is nearer than 0.02 m from 1 s to 2 s.
    """
    model = ControlModel.FromDescription(load_robot_description(robot), tasks)
    time = np.arange(round(duration / 0.01) + 1) * 0.01
    rest = model.plant.GetPositions(model.MakeWorkspace().plant_context)
    for name, value in model.description.rest_posture.items():
        rest[model.position_names.index(name)] = value
    layout: TaskLayout = model.layout
    R = np.tile(np.eye(3), (len(layout.angular_tasks), 1, 1))
    rest_p = np.tile([0.3, 0.0, 1.0], (len(layout.linear_tasks), 1))
    desired = [layout.pack(R, rest_p + [0.0, 0.0, 0.1 * t]) for t in time]
    distances = np.full((len(time), len(model.pairs)), 0.1)
    near = (time > 0.995) & (time < 1.995)
    distances[near, 0] = 0.01
    T, nv = len(time), len(model.position_names)
    scenario = Scenario(robot=robot, motion="dance", tasks=list(tasks))
    return SimulationLog(
        time=time,
        q=rest + 0.4 * np.sin(2.0 * time)[:, np.newaxis],
        v=np.zeros((T, nv)),
        actuation=np.zeros((T, nv)),
        desired_acceleration=np.zeros((T, nv)),
        desired_tasks=np.array(desired),
        task_error=np.zeros((T, layout.m)),
        signed_distances=distances,
        constraint_weights=np.ones((T, model.n)),
        status=np.zeros((T, 1)),
        resting_margins=np.full((T, 2), np.nan),
        admission=np.full((T, 4), np.nan),
        torque_limit=np.tile([1.0, 0.0], (T, 1)),
        position_names=np.array(model.position_names),
        velocity_names=np.array(model.velocity_names),
        actuator_names=np.array(model.position_names),
        controlled_names=np.array(model.joint_names),
        task_names=np.array(layout.names),
        task_kinds=np.array(layout.kinds),
        pair_names=np.array([f"{a} - {b}" for a, b in model.pairs.names]),
        lower=np.full(nv, -np.inf),
        upper=np.full(nv, np.inf),
        velocity_limits=np.full(nv, np.inf),
        scenario=scenario.to_yaml(),
    )


@pytest.fixture(scope="module")
def log() -> SimulationLog:
    log = make_log("upper_body", TASKS, 3.0)
    pairs = load_robot_description("upper_body").pairs
    order = [pairs.index(["left_hand", "right_hand"])]
    # Let it be the hands that come near, not whatever pair is the first.
    distances = np.full_like(log.signed_distances, 0.1)
    distances[:, order] = log.signed_distances[:, :1]
    return replace(log, signed_distances=distances)


@dataclass(frozen=True)
class Recorded:
    """The page of `log`, and what the overlay drew for it."""

    page: Path
    visibility: list[tuple[str, bool, float]]
    moved: list[tuple[str, np.ndarray, float]]
    cameras: list[tuple[np.ndarray, np.ndarray]]


@pytest.fixture(scope="module")
def recorded(log, meshcat, tmp_path_factory) -> Recorded:
    path = tmp_path_factory.mktemp("page") / "recording.html"
    meshcat.forget()
    record_log(log, path, frames_per_second=FPS, meshcat=meshcat)
    return Recorded(
        path, list(meshcat.visibility), list(meshcat.moved), list(meshcat.cameras)
    )


@pytest.fixture(scope="module")
def seen(recorded, tmp_path_factory) -> Look:
    return look_at(
        recorded.page,
        tmp_path_factory.mktemp("browser"),
        times=(0.5, 1.5, 2.5),
        paths=(LEFT[1:], RIGHT[1:]),
    )


def test_playback_shows_a_near_pair_while_it_is_near(recorded):
    start = [entry for entry in recorded.visibility if entry[2] == 0.0]
    # Every watched link once, all far.
    links = {name for p in load_robot_description("upper_body").pairs for name in p}
    assert len(start) == len(links) == len({path for path, _, _ in start})
    assert not any(value for _, value, _ in start)
    # Then only the changes, and only of the two hands: near from 1.00 to 1.99 s,
    # interpolated to the threshold between samples.
    changes = [entry for entry in recorded.visibility if entry[2] > 0.0]
    assert [(p, v) for p, v, _ in changes] == [
        (LEFT, True), (RIGHT, True), (LEFT, False), (RIGHT, False)
    ]  # fmt: skip
    assert [t for _, _, t in changes] == [1.0, 1.0, 2.0, 2.0]


def test_playback_moves_the_targets(recorded):
    left = [
        (p, t) for path, p, t in recorded.moved if path == "/crar/targets/left_wrist"
    ]
    times = np.array([t for _, t in left])
    np.testing.assert_array_equal(times, np.arange(3 * 32 + 1) / 32)
    expected = [[0.3, 0.0, 1.0 + 0.1 * t] for t in times]
    np.testing.assert_allclose([p for p, _ in left], expected, atol=1e-12)
    assert len(recorded.moved) == 2 * len(left)  # the other wrist, and nothing else


def test_view_holds_everything(recorded):
    camera, target = recorded.cameras[-1]
    # The last target is seen within the 41.9 degrees of the zoomed camera.
    ray = recorded.moved[-1][1] - camera
    axis = target - camera
    angle = np.arccos(ray @ axis / np.linalg.norm(ray) / np.linalg.norm(axis))
    assert angle < np.arctan(np.tan(np.deg2rad(37.5)) / 2.0)
    # From the front, from above, and no farther than a hall is long.
    assert camera[0] > target[0] and camera[2] > target[2]
    assert 1.0 < np.linalg.norm(axis) < 8.0


def test_page_is_self_contained(recorded):
    text = recorded.page.read_text()
    assert not re.findall(r"<(?:script|link|img)[^>]*(?:src|href)\s*=", text)
    assert all(url.startswith("data:") for url in re.findall(r'fetch\("([^"]*)', text))
    assert 2_000_000 < len(text) < 6_000_000


def test_page_in_a_browser(seen):
    assert seen.errors == []
    assert seen.requests == []
    assert seen.playing
    # All tracks repeat together, as long as the log; nobody counts to a million.
    np.testing.assert_allclose(seen.durations, 3.0)
    assert min(seen.repetitions) > 1000


def test_browser_shows_the_robot_and_it_moves(seen):
    first, _, last = seen.images
    robot = np.abs(last - seen.without_robot).max(axis=2) > 0.1
    assert 0.01 < robot.mean() < 0.5
    assert (np.abs(last - first).max(axis=2) > 0.1).mean() > 0.005


def test_browser_shows_the_warning_while_near(seen):
    assert seen.visible == [[False, False], [True, True], [False, False]]
    # Red is on no other thing in the picture.
    red = [
        ((im[..., 0] > 0.5) & (im[..., 1] < 0.6 * im[..., 0])
         & (im[..., 2] < 0.6 * im[..., 0])).sum()
        for im in seen.images
    ]  # fmt: skip
    assert red[1] > 50 and red[0] == red[2] == 0


@pytest.mark.parametrize("kind, targets", [("pose", 1), ("orientation", 0)])
def test_log_of_another_robot(meshcat, tmp_path, kind, targets):
    log = make_log("obstacle_arm", [Task(frame="tool", kind=kind)], 0.5)
    log.signed_distances[:, 0] = 0.01  # the upper arm at the post
    meshcat.forget()
    record_log(log, tmp_path / "arm.html", frames_per_second=8.0, meshcat=meshcat)
    assert (tmp_path / "arm.html").stat().st_size > 2e6
    assert len(meshcat.moved) == 5 * targets
    # Both wear a shell: a link of the arm, and one that is welded to the world.
    assert {path for path, value, _ in meshcat.visibility if value} == {
        "/drake/illustration/arm/upper_arm/near",
        "/drake/illustration/obstacle/post/near",
    }


def test_log_that_cannot_be_played(log, tmp_path):
    empty = replace(log, time=log.time[:0], q=log.q[:0])
    with pytest.raises(CrarError, match="log is empty"):
        record_log(empty, tmp_path / "page.html")
    with pytest.raises(CrarError, match="frames_per_second: 0"):
        record_log(log, tmp_path / "page.html", frames_per_second=0)
    with pytest.raises(CrarError, match="13 positions but robot upper_body 14"):
        record_log(replace(log, q=log.q[:, 1:]), tmp_path / "page.html")
    with pytest.raises(CrarError, match="29 watched pairs but robot upper_body 30"):
        record_log(
            replace(log, signed_distances=log.signed_distances[:, 1:]),
            tmp_path / "page.html",
        )
    elsewhere = log.scenario.replace("robot: upper_body", "robot: gone")
    with pytest.raises(ModelError, match="no robot 'gone'"):
        record_log(replace(log, scenario=elsewhere), tmp_path / "page.html")
    assert not list(tmp_path.iterdir())


def test_page_appears_whole_or_not_at_all(meshcat, tmp_path):
    (tmp_path / "page.html").mkdir()  # stands where the page should go
    with pytest.raises(CrarError, match="page.html: could not be written"):
        save_recording(meshcat, tmp_path / "page.html")
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]
