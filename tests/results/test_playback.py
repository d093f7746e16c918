"""The page of a run or of several: what is in it, and what a browser makes of it."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_pages import look, read_data

from crar_drake.errors import CrarError
from crar_drake.law.parameters import with_constraints
from crar_drake.law.tasks import TaskLayout
from crar_drake.results import marks
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import load_logged_scenario
from crar_drake.results.playback import record_logs
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task, position_tasks
from crar_drake.simulation.scenario import Scenario
from docs.headless_browser import HeadlessBrowser, find_browser

TASKS = position_tasks(["left_wrist", "right_wrist"])
FPS = 32.0
ROUNDED = 2**-15 + 1e-6  # of poses and points, by the page: at most [m, 1]


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
        admission=np.full((T, 4), np.nan),
        balance=np.full((T, 3), np.nan),
        torque_limit=np.tile([1.0, 0.0], (T, 1)),
        obstacles=np.empty((T, 0)),
        position_names=np.array(model.position_names),
        velocity_names=np.array(model.velocity_names),
        actuator_names=np.array(model.position_names),
        controlled_names=np.array(model.joint_names),
        controlled_units=np.array(["rad"] * model.n),
        task_names=np.array(layout.names),
        task_kinds=np.array(layout.kinds),
        pair_names=np.array([f"{a} - {b}" for a, b in model.pairs.names]),
        lower=np.full(nv, -np.inf),
        upper=np.full(nv, np.inf),
        velocity_limits=np.full(nv, np.inf),
        effort_limits=np.full(nv, np.inf),
        scenario=scenario.to_yaml(),
    )


def at_rate(frames_per_second: float, log: SimulationLog) -> SimulationLog:
    """The same, to be recorded at that rate; by default it is FPS."""
    scenario = load_logged_scenario(log)
    scenario.visualization.publish_period = 1.0 / frames_per_second
    return replace(log, scenario=scenario.to_yaml())


@pytest.fixture(scope="module")
def log() -> SimulationLog:
    log = make_log("upper_body", TASKS, 3.0)
    pairs = load_robot_description("upper_body").pairs
    order = [pairs.index(["left_hand", "right_hand"])]
    # Let it be the hands that come near, not whatever pair is the first.
    distances = np.full_like(log.signed_distances, 0.1)
    distances[:, order] = log.signed_distances[:, :1]
    return replace(log, signed_distances=distances)


@pytest.fixture(scope="module")
def page(log, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("page") / "recording.html"
    record_logs([log], path)
    return path


@pytest.fixture(scope="module")
def browser() -> Iterator[HeadlessBrowser]:
    if find_browser() is None:
        pytest.skip("there is no Chromium to open the page in")
    with HeadlessBrowser(640, 480) as browser:
        yield browser


@pytest.fixture(scope="module")
def opened(browser, page) -> HeadlessBrowser:
    """The page of the log, which plays of its own, stopped."""
    browser.open(page)
    browser.wait_for("crar.state.playing && crar.state.time > 0.05")
    browser.evaluate("crar.play(false)")
    return browser


def test_links_are_where_the_joints_put_them(log, page):
    data = read_data(page)
    (run,), (robot,) = data["runs"], data["robots"]
    poses = run["poses"].reshape(run["frames"], -1, 7)
    assert run["frames"] == 97 and poses.shape[1] == len(robot["paths"])
    model = ControlModel.FromDescription(load_robot_description("upper_body"), TASKS)
    workspace = model.MakeWorkspace()
    for frame, sample in ((0, 0), (32, 100), (96, 300)):  # at the same times
        model.plant.SetPositions(workspace.plant_context, log.q[sample])
        for path, pose in zip(robot["paths"], poses[frame], strict=True):
            body = model.plant.GetBodyByName(path.rpartition("/")[2])
            X_WB = model.plant.EvalBodyPoseInWorld(workspace.plant_context, body)
            np.testing.assert_allclose(pose[:3], X_WB.translation(), atol=ROUNDED)
            w, x, y, z = X_WB.rotation().ToQuaternion().wxyz()
            sign = np.sign(pose[3:] @ [x, y, z, w])
            np.testing.assert_allclose(sign * pose[3:], [x, y, z, w], atol=ROUNDED)


def test_targets_and_the_points_that_should_be_there(log, tmp_path):
    error = np.tile([0.0, 0.02, 0.0, 0.0, 0.0, -0.01], (len(log.time), 1))
    error[200:] = np.nan  # no targets from 2 s on
    record_logs([at_rate(8.0, replace(log, task_error=error))], tmp_path / "page.html")
    (run,) = read_data(tmp_path / "page.html")["runs"]
    targets = run["targets"].reshape(25, 2, 3)
    reached = run["reached"].reshape(25, 2, 3)
    rise = 1.0 + 0.1 * np.arange(15) / 8.0
    np.testing.assert_allclose(targets[:15, 0, 2], rise, atol=ROUNDED)
    np.testing.assert_allclose(targets[:15, 1, :2], [[0.3, 0.0]] * 15, atol=ROUNDED)
    np.testing.assert_allclose(reached[:15, 0, 1], -0.02, atol=ROUNDED)
    np.testing.assert_allclose(reached[:15, 1, 2], rise + 0.01, atol=ROUNDED)
    assert np.isnan(targets[16:]).all() and np.isnan(reached[16:]).all()
    assert run["curve"]["error"][:190] == [0.02] * 190
    assert run["curve"]["error"][210:] == [None] * len(run["curve"]["error"][210:])


def test_near_pairs_end_on_the_surfaces(log, page):
    """Two points as far apart as the control model's closed form says."""
    (run,) = read_data(page)["runs"]
    near = run["near"].reshape(97, -1, 8)
    hands = [name for name in run["pairNames"]].index("left hand – right hand")
    shown = ~np.isnan(near[:, 0, 0])
    np.testing.assert_array_equal(np.flatnonzero(shown), np.arange(32, 64))
    assert np.isnan(near[:, 1:]).all()
    np.testing.assert_array_equal(near[shown, 0, 0], hands)
    np.testing.assert_allclose(near[shown, 0, 1], 0.01, atol=2**-18)
    model = ControlModel.FromDescription(load_robot_description("upper_body"), TASKS)
    workspace = model.MakeWorkspace()
    distances = model.signed_distances(log.q[100])
    _, _, *points = near[32, 0]
    a, b = np.array(points[:3]), np.array(points[3:])
    assert np.linalg.norm(a - b) == pytest.approx(distances[hands], abs=2e-5)
    # And each on the hull of its own hand.
    plant_context = workspace.plant_context
    model.plant.SetPositions(plant_context, log.q[100])
    query = model.scene_graph.get_query_output_port().Eval(
        workspace.scene_graph_context
    )
    for point, link in ((a, "left_hand"), (b, "right_hand")):
        shapes = model.plant.GetCollisionGeometriesForBody(
            model.plant.GetBodyByName(link)
        )
        away = query.ComputeSignedDistanceToPoint(point.astype(float), np.inf)
        own = [each.distance for each in away if each.id_G in shapes]
        assert own and abs(min(own)) < 2e-5


def test_curves_keep_every_peak(log, tmp_path):
    time = np.arange(20001) * 1e-3
    distances = np.full((len(time), log.signed_distances.shape[1]), 0.1)
    distances[7777, 3] = -0.004  # one sample
    long = log.samples(np.zeros(len(time), dtype=int))
    long = replace(long, time=time, signed_distances=distances)
    record_logs([at_rate(1.0, long)], tmp_path / "p.html")
    curve = read_data(tmp_path / "p.html")["runs"][0]["curve"]
    assert len(curve["distance"]) <= 1500
    assert min(curve["distance"]) == -0.004
    at = curve["time"][int(np.argmin(curve["distance"]))]
    assert at == pytest.approx(7.777, abs=0.02)


def test_browser_shows_what_is_near_while_it_is(opened):
    def red(image: np.ndarray) -> int:
        r, g, b = np.moveaxis(image, 2, 0)
        return int(((r > 0.5) & (g < 0.62 * r) & (b < 0.62 * r)).sum())

    before, near, after = (red(look(opened, t)) for t in (0.5, 1.5, 2.5))
    # Red is on no other thing in the picture.
    assert before == after == 0 and near > 30


def hide_robot(browser: HeadlessBrowser, hidden: bool) -> None:
    change = "disableAll()" if hidden else "enable(0)"
    browser.evaluate(
        "viewer.scene_tree.find(['crar', 'robot0']).object.traverse("
        f"o => {{ if (o.isMesh) o.layers.{change}; }})"
    )


def test_targets_are_seen_through_the_links(opened):
    """As much of their violet as if there were no robot."""
    colour = np.array([int(marks.TARGET[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0

    def violet() -> int:
        image = look(opened, 0.5)
        return int((np.abs(image - colour).max(axis=2) < 0.05).sum())

    seen = violet()
    hide_robot(opened, True)
    assert seen == violet() > 10
    hide_robot(opened, False)


@pytest.mark.parametrize("size", [(1280, 800), (390, 844), (800, 300)])
def test_all_that_moves_fits_the_window_and_fills_it(opened, page, size):
    opened.resize(*size)
    opened.settle()
    camera, projection = (
        np.array(opened.evaluate(f"viewer.{name}.toArray()")).reshape(4, 4).T
        for name in ("camera.matrixWorldInverse", "camera.projectionMatrix")
    )
    opened.resize(640, 480)
    outline = np.array(read_data(page)["outline"]).reshape(-1, 3)
    # Meshcat's world has y upwards.
    y_up = np.column_stack([outline[:, 0], outline[:, 2], -outline[:, 1]])
    clip = projection @ camera @ np.vstack([y_up.T, np.ones(len(y_up))])
    seen = clip[:2] / clip[3]
    assert (clip[3] > 0.0).all() and (np.abs(seen) < 1.0).all()
    # In one of the two directions both sides are reached, but for the margin.
    assert np.max(np.minimum(seen.max(axis=1), -seen.min(axis=1))) > 0.85


def test_keys(opened):
    def time() -> float:
        return opened.evaluate("crar.state.time")

    opened.evaluate("crar.seek(1.0)")
    opened.press("ArrowRight")
    assert time() == pytest.approx(1.0 + 1.0 / FPS)
    opened.press("ArrowLeft")
    opened.press("ArrowLeft")
    assert time() == pytest.approx(1.0 - 1.0 / FPS)
    opened.press("ArrowRight", shift=True)
    assert time() == pytest.approx(2.0 - 1.0 / FPS)
    opened.press("End")
    assert time() == 3.0
    opened.press("Home")
    assert time() == 0.0
    opened.press("ArrowUp")
    assert opened.evaluate("crar.state.speed") == 2.0
    opened.press("ArrowDown")
    opened.press("Space", " ")
    assert opened.evaluate("crar.state.playing") is True
    opened.wait_for("crar.state.time > 0.05")
    opened.press("Space", " ")
    stopped = time()
    opened.settle()
    assert time() == stopped and opened.evaluate("crar.state.playing") is False


def test_the_cursor_follows_and_can_be_dragged(opened):
    box = opened.evaluate(
        "(({x, y, width, height}) => [x, y, width, height])"
        "(document.querySelector('#crar-timeline svg').getBoundingClientRect())"
    )
    # Where the time line begins and ends is told by its grid.
    left, right = opened.evaluate(
        "['x1', 'x2'].map(name => Number(document.querySelector("
        "'#crar-timeline .grid').getAttribute(name)))"
    )

    def cursor() -> float:
        moved = opened.evaluate(
            "document.querySelector('#crar-timeline .handle').getAttribute('transform')"
        )
        return float(re.search(r"[-\d.]+", moved)[0])

    y = box[1] + 0.3 * box[3]
    at = [box[0] + left + share * (right - left) for share in (0.1, 0.3, 0.5)]
    opened.drag([(x, y) for x in at])
    assert opened.evaluate("crar.state.time") == pytest.approx(1.5, abs=0.02)
    assert cursor() == pytest.approx(0.5 * (left + right), abs=2.0)
    # Let go: the mouse moves it no more; beyond the end is the end.
    opened.evaluate("crar.seek(0.75)")
    assert cursor() == pytest.approx(0.75 * left + 0.25 * right, abs=0.5)
    opened.drag([(at[0], y), (box[0] + box[2] + 50.0, y)])
    assert opened.evaluate("crar.state.time") == 3.0
    reading = opened.evaluate(
        "crar.seek(1.5), document.querySelector('#crar-timeline .reading').textContent"
    )
    assert "10 mm" in reading and "left hand – right hand" in reading


def test_phones_begin_with_what_matters(opened):
    opened.resize(390, 844)
    opened.settle()
    legend = "document.getElementById('crar-legend').open"
    assert opened.evaluate(legend) is False
    share = opened.evaluate(
        "document.getElementById('crar-stage').clientHeight / innerHeight"
    )
    assert share > 0.5
    # From here to the end nothing moves, such as controls into a second row.
    opened.evaluate("crar.seek(0)")
    height = "document.getElementById('crar-controls').clientHeight"
    assert opened.evaluate(height) < 50
    wide = "document.documentElement.scrollWidth <= innerWidth"
    assert opened.evaluate(wide) is True
    assert opened.evaluate("viewer.gui.domElement.style.display") == "none"
    opened.resize(1280, 800)
    opened.settle()
    assert opened.evaluate(legend) is True
    opened.resize(640, 480)


def named(log: SimulationLog, motion: str, constraints: str) -> SimulationLog:
    scenario = Scenario(robot="upper_body", motion=motion, tasks=list(TASKS))
    scenario.controller = with_constraints(scenario.controller, constraints)
    return replace(log, scenario=scenario.to_yaml())


def test_names_are_text_and_nothing_else(log, browser, tmp_path):
    evil = "</script><script>window.evil = 1</script><img src=x onerror=alert(1)>"
    names = log.pair_names.copy().astype("U200")
    names[:] = [f"{evil} {i}" for i in range(len(names))]
    evil_log = at_rate(4.0, replace(named(log, evil, "none"), pair_names=names))
    record_logs([evil_log], tmp_path / "evil.html")
    browser.open(tmp_path / "evil.html", "#t=1.5")
    assert browser.evaluate("[crar.state.playing, crar.state.time]") == [False, 1.5]
    assert browser.evaluate("window.evil === undefined")
    assert browser.evaluate("document.images.length") == 0
    # Of a path, the last part is the motion's name.
    assert "script><img src=x onerror=alert(1)>" in browser.evaluate("document.title")
    reading = "document.querySelector('#crar-timeline .reading')"
    assert evil in browser.evaluate(f"{reading}.textContent")
    browser.resize(390, 844)
    browser.settle()
    assert browser.evaluate(f"{reading}.getBoundingClientRect().right") <= 390
    assert "10 mm · </scr" in browser.evaluate(f"{reading}.textContent")
    browser.resize(640, 480)
    assert browser.complaints == []


def test_two_runs_in_one_page(log, browser, tmp_path):
    modes = ("none", "lookahead")
    runs = [at_rate(8.0, named(log, "dance", mode)) for mode in modes]
    runs[0].signed_distances[150, 0] = -0.03
    labels = ["none", "lookahead"]
    page = tmp_path / "compare.html"
    record_logs(runs, page, labels=labels)
    data = read_data(page)
    assert [run["robot"] for run in data["runs"]] == [0, 0], "it is drawn once"
    assert [run["label"] for run in data["runs"]] == labels
    browser.open(page, "#t=1.5")
    views = "crar.stage.views.map(v => [v.x, v.y, v.w, v.h, v.runs.length])"
    left, right = browser.evaluate(views)
    assert left[0] == 0 and right[0] == left[2] == 320 and left[4] == right[4] == 1
    # Both robots are there: each half has much that the other view's sky has not.
    image = look(browser, 1.5)
    halves = image[:, :320], image[:, 320:640]
    assert all((half.std(axis=2) > 0.02).mean() > 0.2 for half in halves)
    robot = [(half.max(axis=2) < 0.25).mean() for half in halves]
    assert min(robot) > 0.002 and max(robot) < 3.0 * min(robot)
    curves = "document.querySelectorAll('#crar-timeline .curve').length"
    assert browser.evaluate(curves) == 4
    text = browser.evaluate("document.querySelector('#crar header').innerText")
    assert "−30.0 mm" in text and "lookahead" in text
    # Laid over each other, by the key and back.
    browser.press("KeyO", "o")
    browser.settle()
    ((_, _, width, _, runs_shown),) = browser.evaluate(views)
    assert (width, runs_shown) == (640, 2)
    browser.press("KeyO", "o")
    assert len(browser.evaluate(views)) == 2
    assert browser.complaints == []


def test_none_or_too_many_to_compare(log, tmp_path):
    for count in (0, len(marks.RUNS) + 1):
        with pytest.raises(CrarError, match=f"{count} runs cannot be compared"):
            record_logs([log] * count, tmp_path / "p.html", labels=["x"] * count)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind, targets", [("pose", 1), ("orientation", 0)])
def test_log_of_another_robot(browser, tmp_path, kind, targets):
    log = make_log("obstacle_arm", [Task(frame="tool", kind=kind)], 0.5)
    log.signed_distances[:, 0] = 0.01  # the upper arm at the post
    record_logs([at_rate(8.0, log)], tmp_path / "arm.html")
    data = read_data(tmp_path / "arm.html")
    (run,) = data["runs"]
    assert run["targets"].size == 5 * targets * 3
    assert run["curve"]["unit"] == ("m" if targets else "rad")
    # One of the pair is welded to the world, and is drawn but not moved.
    assert not any("post" in path for path in data["robots"][0]["paths"])
    near = run["near"].reshape(5, -1, 8)
    assert (np.abs(near[:, 0, 1] - 0.01) < 2**-18).all()
    assert np.isfinite(near[:, 0]).all()
    if not targets:
        browser.open(tmp_path / "arm.html", "#t=0.25")
        assert browser.complaints == []


def test_log_that_cannot_be_played(log, tmp_path):
    empty = replace(log, time=log.time[:0], q=log.q[:0])
    with pytest.raises(CrarError, match="log is empty"):
        record_logs([empty], tmp_path / "page.html")
    with pytest.raises(CrarError, match="no finite positions"):
        record_logs(
            [replace(log, q=np.full_like(log.q, np.nan))], tmp_path / "page.html"
        )
    assert not list(tmp_path.iterdir())
