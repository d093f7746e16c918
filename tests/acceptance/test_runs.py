"""What a run leaves and says, and what is live: served over UDP, played over HTTP."""

import html.parser
import re
import signal
import socket
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import matplotlib.image
import numpy as np
import product
import pytest
from attacks import judge_of

PATIENCE = 300.0  # for an answer, on a computer that does other things, too [s]
TIGHT = dict(rtol=1e-9, atol=1e-12)  # of the same sum, in another order


@dataclass(frozen=True)
class Run:
    """A finished command, and the folder of its files."""

    done: product.Finished
    folder: Path
    robot: str

    @cached_property
    def log(self) -> product.Log:
        return product.read_log(self.folder / product.RUN_FILES["log"])

    @cached_property
    def figures(self) -> dict:
        return product.read_figures(self.folder / product.RUN_FILES["figures"])


# Scenario, its robot, options, and the exit code: a proved one, an arm by a post under
# the paper's constraints, and one without constraints, whose hands run into the body.
RUNS = {
    "hands": (product.HANDS, product.BUILT_IN, {"duration": 0.5}, product.FINE),
    "arm": (product.BY_A_POST, product.ARM, {"duration": 0.5}, product.FINE),
    "unconstrained": ("free.yaml", product.BUILT_IN, {}, product.VIOLATED),
}
FREE = product.scenario(
    robot=product.BUILT_IN,
    motion=product.OTHER_MOTION,
    tasks=product.HAND_SETS["seven"],
    duration=4.5,
    constraints=product.FREE,
    period=0.005,
)


@pytest.fixture(scope="module", params=RUNS)
def run(request: pytest.FixtureRequest, tmp_path_factory) -> Run:
    """One of the runs."""
    folder = tmp_path_factory.mktemp("run")
    scenario, robot, options, code = RUNS[request.param]
    if scenario.endswith(".yaml"):
        (folder / scenario).write_text(FREE)
        scenario = folder / scenario
    out = folder / "it"
    done = product.command("simulate", scenario, out=out, no_page=True, **options)
    assert done.code == code, done.err
    return Run(done, out, robot)


def test_its_files(run: Run):
    """All but the page, which was not wanted; each is named on the screen."""
    names = {product.RUN_FILES[kind] for kind in ("log", "figures", "plot")}
    assert {path.name for path in run.folder.iterdir()} == names
    for name in names:
        assert str(run.folder / name) in run.done.out.replace("\n", "")


def test_its_last_line(run: Run):
    """OK, or what is violated; and so says the judge of its log, anew."""
    last = run.done.out.splitlines()[-1]
    violated, beyond = run.figures["penetrating"], run.figures["beyond a limit"]
    if run.done.code == product.FINE:
        assert last.startswith(product.HOLDS) and violated == beyond == 0
    else:
        assert last.startswith(product.BROKEN) and f"{violated} samples" in last
    judged = product.command("judge", run.folder / product.RUN_FILES["log"])
    assert judged.code == run.done.code
    assert judged.out.splitlines()[-1].startswith(last.partition(", but")[0])


def test_its_figures_are_those_of_its_log(run: Run):
    log, told = run.log, run.figures
    assert told["samples"] == len(log.time) and told["stopped"] == ""
    assert told["duration"] == pytest.approx(log.time[-1] - log.time[0])
    lengths = {name: (e**2).sum(axis=1) for name, e in log.errors.items()}
    for name, squares in lengths.items():
        np.testing.assert_allclose(told["errors"][name], rms(squares), **TIGHT)
    np.testing.assert_allclose(told["error"], rms([*lengths.values()]), **TIGHT)
    if log.turns:
        squares = [(e**2).sum(axis=1) for e in log.turns.values()]
        np.testing.assert_allclose(told["turn"], rms(squares), **TIGHT)
    sample, pair = np.unravel_index(log.distances.argmin(), log.distances.shape)
    assert told["distance"] == log.distances[sample, pair]
    assert told["pair"] == log.pairs[pair] and told["when"] == log.time[sample]
    moved = [log.joints.index(name) for name in log.controlled]
    q, v = log.q[:, moved], log.v[:, moved]
    inside = (log.distances < 0.0).any(axis=1)
    beyond = np.maximum(q - log.upper[moved], log.lower[moved] - q) > 1e-6
    fast = np.abs(v) - log.speeds[moved] > 1e-6
    assert told["penetrating"] == inside.sum()
    assert told["beyond a limit"] == beyond.any(axis=1).sum()
    assert told["violated"] == (inside | beyond.any(axis=1)).sum()
    assert told["too fast"] == fast.any(axis=1).sum()
    motors = [log.motors.index(name) for name in log.controlled]
    efforts = np.abs(log.efforts[:, motors])
    assert told["effort"] == efforts.max()
    assert told["strained"] == log.controlled[efforts.max(axis=0).argmax()]
    np.testing.assert_allclose(
        told["acceleration"], rms(log.commanded[:, moved] ** 2), **TIGHT
    )


def rms(squares: object) -> float:
    return float(np.sqrt(np.mean(squares)))


def test_its_log_is_of_the_robots_own_file(run: Run):
    """Joints, limits, distances, errors and motion, by a judge of the suite's own."""
    log, judge = run.log, judge_of(run.robot)
    columns = judge.at(log.joints)
    q = np.empty_like(log.q)
    q[:, columns] = log.q
    for ours, name in ((log.lower, "lower"), (log.upper, "upper")):
        moved = [log.joints.index(each) for each in log.controlled]
        np.testing.assert_array_equal(ours[moved], getattr(judge, name)[columns][moved])
    pairs = [frozenset(link.split("::")[-1] for link in pair) for pair in judge.pairs]
    order = [pairs.index(frozenset(name.split(" - "))) for name in log.pairs]
    assert len(order) == len(judge.pairs)
    np.testing.assert_allclose(
        log.distances,
        judge.distances(q)[:, order],
        rtol=0.0,
        atol=product.MEASURED_WITHIN,
    )
    links = product.point_links(run.robot)
    for point, desired in log.targets.items():
        there = judge.link_points(links[point], [[0.0, 0.0, 0.0]], q)[:, 0]
        np.testing.assert_allclose(log.errors[point], desired - there, atol=1e-9)
    # The plant's steps are implicit in speed: positions follow from those after.
    step = np.diff(log.time)[:, None]
    travel = np.abs(np.diff(log.q, axis=0) / step - log.v[1:])
    assert travel.max() < 0.05 + np.abs(np.diff(log.v, axis=0)).max()


def test_its_plot_shows_something(run: Run):
    """In several colours, on paper that is mostly white."""
    picture = matplotlib.image.imread(run.folder / product.RUN_FILES["plot"])[..., :3]
    assert min(picture.shape[:2]) > 600
    ink = (picture < 0.9).any(axis=2)
    assert 0.01 < ink.mean() < 0.6
    # Each sixth of its height has some.
    assert all(part.mean() > 0.003 for part in np.array_split(ink, 6))
    coloured = np.ptp(picture, axis=2) > 0.25
    assert coloured.mean() > 1e-3


# --- the page ---------------------------------------------------------------------


class Elements(html.parser.HTMLParser):
    """The ids in a page, and addresses that it would ask for."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.asked: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id":
                self.ids.add(value)
            elif name in ("src", "href"):
                self.asked.append(value)


def test_the_page_of_a_log_and_of_two(tmp_path: Path, monkeypatch):
    """One file each, with all parts, that asks for nothing."""
    monkeypatch.chdir(tmp_path)
    for out in ("a", "b"):
        words = dict(duration=0.05, out=out, no_page=out == "a")
        assert product.command("simulate", product.HANDS, **words).code == product.FINE
    log = product.RUN_FILES["log"]
    assert product.command("page", f"a/{log}").code == product.FINE
    compared = product.command("compare", "a", "b", label=["one", "two"], overlay=True)
    assert compared.code == product.FINE and product.PAGE_OF_SEVERAL in compared.out
    whole = (tmp_path / "b" / product.RUN_FILES["page"]).read_text()
    later = (tmp_path / "a" / product.PAGE_OF_A_LOG).read_text()
    both = (tmp_path / product.PAGE_OF_SEVERAL).read_text()
    for text in (whole, later, both):
        page = Elements(text)
        parts = {
            re.match(r"#([\w-]+)", each)[1] for each in product.PAGE_PARTS.values()
        }
        assert parts <= page.ids
        assert all(address.startswith("data:") for address in page.asked)
    for name in (product.BUILT_IN, product.MOTION, product.PROVED):
        assert name in whole and name in later
    assert '"one"' in both and '"two"' in both


# --- on its own feet ----------------------------------------------------------------


def test_a_robot_that_stands(humanoid: str, mocap: Path, tmp_path: Path):
    """In contact with a floor; upright by its log, as by its figures."""
    out = tmp_path / "it"
    done = product.command(
        "simulate", product.STANDING, duration=0.3, out=out, no_page=True
    )
    assert done.code == product.FINE, done.err
    run = Run(done, out, humanoid)
    assert run.figures["distance"] == run.log.distances.min() > 0.0
    leaned, fell = product.stance(run.figures["stance"])
    w, x, y, z = run.log.q[:, :4].T
    upright = np.arccos(np.clip(1.0 - 2.0 * (x**2 + y**2), -1.0, 1.0))
    assert fell is None and upright.max() < 0.1
    # The figure is of the whole turn, that about the vertical included.
    assert upright.max() - 1e-6 <= leaned < 0.1
    assert abs(run.log.q[:, 6] - run.log.q[0, 6]).max() < 0.02


# --- served -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[tuple]:
    """A server of the built-in robot, and a client that is connected to it."""
    words = product.words("serve", port=0)
    with product.running(*words, cwd=tmp_path_factory.mktemp("served")) as started:
        process, line = started
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.connect(("127.0.0.1", product.port_of(line)))
            client.settimeout(PATIENCE)
            yield process, client


def test_it_serves_and_ends(server: tuple):
    """Hands are sent into one another; Ctrl-C brakes; nonsense does not matter."""
    process, client = server

    def ask(message: bytes) -> product.Served:
        client.send(message)
        return product.served(client.recv(65536))

    told = ask(product.DESCRIBE)
    left, right = told.stay.values()
    middle = {name: [left[0] + 0.1, 0.0, left[2]] for name in told.stay}
    assert not np.allclose(left, right)
    commands = []
    for k in range(200):
        if k % 10 == 3:
            client.send(b"\xff{" if k % 20 == 3 else product.to_points({"it": [0] * 3}))
        commands.append(ask(product.to_points(middle)))
    person = product.spheres(person=([2.0, 0.0, 1.0], 0.3, 0.1))
    commands.append(ask(person + b"\n" + product.to_points(middle)))
    process.send_signal(signal.SIGINT)
    while not commands[-1].brakes:
        commands.append(product.served(client.recv(65536)))
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == product.FINE and "Traceback" not in err
    client.settimeout(0.5)  # what is left in the socket
    try:
        while True:
            commands.append(product.served(client.recv(65536)))
    except OSError:
        pass
    assert np.abs(commands[-1].v).max() < 0.01 and "smallest distance" in out

    judge = judge_of(product.BUILT_IN)
    columns = judge.at(told.joints)
    q = np.empty((len(commands), len(judge.joints)))
    q[:, columns] = [command.q for command in commands]
    assert np.isfinite([command.efforts for command in commands]).all()
    assert (q >= judge.lower - 1e-9).all() and (q <= judge.upper + 1e-9).all()
    assert judge.distances(q).min() >= product.SAFETY_DISTANCE
    # The hands have come together as far as that leaves them.
    ways = judge.link_points(product.LINK, [[0.0, 0.0, 0.0]], q)[:, 0]
    assert np.linalg.norm(ways - ways[0], axis=1).max() > 0.1


# --- played -------------------------------------------------------------------------


def test_it_plays_and_ends(tmp_path: Path):
    """A hand's target is dragged to the other's, until Ctrl-C."""
    words = product.words("play", product.HANDS, no_browser=True, port=0, out="kept")
    with product.running(*words, cwd=tmp_path) as (process, line):
        url = re.match(r"http://127\.0\.0\.1:\d+/", line)[0]
        with urllib.request.urlopen(url, timeout=PATIENCE) as page:
            assert b"<canvas" in (text := page.read()) or b"<script" in text
        frame = product.next_frame(url)
        product.hold_motion(url)
        first = frame.targets
        by = [b - a for a, b in zip(*first, strict=True)]
        product.drag(url, 0, by)
        while not np.allclose(frame.drags[0], by):
            frame = product.next_frame(url, frame.number)
        until = frame.time + 1.0  # simulated
        while frame.time < until:
            frame = product.next_frame(url, frame.number)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == product.FINE and "Traceback" not in err, err
    kept = tmp_path / "kept"
    assert {path.name for path in kept.iterdir()} == set(product.RUN_FILES.values())
    log, judge = (
        product.read_log(kept / product.RUN_FILES["log"]),
        judge_of(product.BUILT_IN),
    )
    q = np.empty_like(log.q)
    q[:, judge.at(log.joints)] = log.q
    assert judge.distances(q).min() >= product.SAFETY_DISTANCE
    # The dragged target is where it was dragged to, and its hand has gone after it.
    (target, *_), (error, *_) = log.targets.values(), log.errors.values()
    assert np.linalg.norm(target[-1] - target[0]) > 0.5 * np.linalg.norm(by)
    reached = target - error
    assert np.linalg.norm(reached[-1] - reached[0]) > 0.05
