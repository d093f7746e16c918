"""`crar-drake play`: in a real browser over the real socket, and what it refuses."""

import json
import re
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from crar_drake.commands import main
from crar_drake.judging.referee import Referee
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import load_logged_robot
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import position_tasks
from docs.headless_browser import HeadlessBrowser, find_browser

WAIT = 300.0  # for what takes seconds on a computer that does nothing else [s]

FRAME = "crar.state.frame"
MESHES = """
(() => {
    let meshes = 0;
    crar.viewer.scene_tree.find(["crar", "robot0"]).object.traverse(
        object => { if (object.isMesh) meshes += 1; });
    return meshes > 20;
})()
"""
LEFT_HAND = (
    "crar.viewer.scene_tree.find(['crar', 'robot0', 'upper_body', 'left_hand'])"
    ".object.matrix.elements"
)
INTO_THE_BODY = """
(({targets, offsets}) => {
    const goals = [[0.0, -0.05, 0.8], [0.0, 0.05, 0.8]];
    return Promise.all(goals.map((goal, task) => fetch("do", {
        method: "POST", headers: {"Content-Type": "application/json"},
        body: JSON.stringify({do: "offset", task, value:
            goal.map((x, i) => x - targets[task][i] + offsets[task][i])}),
    }))).then(() => true);
})(crar.state.frame)
"""


def press(browser: HeadlessBrowser, name: str) -> None:
    browser.evaluate(f"document.getElementById('live-{name}').click()")


def frame(browser: HeadlessBrowser) -> dict:
    return json.loads(browser.evaluate(f"JSON.stringify({FRAME})"))


def drag_a_target(browser: HeadlessBrowser, task: int, by: tuple[int, int]) -> None:
    """With the mouse, from where it is on the page."""
    x, y = browser.evaluate(
        "(() => { const {views} = crar.stage, box = "
        "document.getElementById('crar-stage').getBoundingClientRect();"
        "const {camera, scene} = crar.viewer;"
        f"const p = crar.state.frame.targets[{task}];"
        "const v = camera.position.clone().set(p[0], p[2], -p[1]).project(camera);"
        "return [box.left + (1 + v.x) * views[0].w / 2,"
        "box.top + (1 - v.y) * views[0].h / 2]; })()"
    )
    steps = [(x + by[0] * k / 4, y + by[1] * k / 4) for k in range(5)]
    browser.drag(steps)


@pytest.mark.slow
@pytest.mark.skipif(find_browser() is None, reason="there is no Chromium")
def test_a_session_in_a_browser(tmp_path):
    """All that a person does, until Ctrl-C, and what is left of it."""
    process = subprocess.Popen(
        [sys.executable, "-m", "crar_drake", "play", "dance_wrists", "--no-browser"]
        + ["--port", "0", "--out", "kept"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A background job may ignore SIGINT, and so would its child.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    try:
        url = re.match(r"http://127\.0\.0\.1:\d+/", process.stdout.readline())[0]
        with HeadlessBrowser(420, 320) as browser:
            browser.send("Page.navigate", url=url)
            browser.wait_for(f"window.crar?.state && {FRAME}?.time > 0.2")
            # Meshcat's own socket brings the robot, and it moves.
            browser.wait_for(MESHES)
            first = browser.evaluate(LEFT_HAND)
            browser.wait_for(
                f"JSON.stringify({LEFT_HAND}) !== JSON.stringify({json.dumps(first)})"
            )
            assert "clear" in browser.evaluate(
                "document.getElementById('live-promise').textContent"
            )
            press(browser, "motion")
            browser.wait_for(f"!{FRAME}.motion")
            press(browser, "pause")
            browser.wait_for(f"{FRAME}.paused")
            held = frame(browser)["time"]
            # What is dragged while it stands counts when it goes on.
            drag_a_target(browser, 0, (60, -40))
            browser.wait_for(f"Math.hypot(...{FRAME}.offsets[0]) > 0.05")
            assert frame(browser)["time"] == held
            press(browser, "step")
            browser.wait_for(f"{FRAME}.time > {held}")
            assert frame(browser)["time"] == pytest.approx(held + 0.005)
            browser.evaluate(
                "(input => { input.value = Math.log(2); input.dispatchEvent("
                "new Event('input')); })(document.getElementById('live-speed-slider'))"
            )
            browser.wait_for(f"Math.abs({FRAME}.speed - 2) < 0.05")
            press(browser, "pause")
            browser.wait_for(f"!{FRAME}.paused")
            # Where the targets are is as old as the frame, and they move: asked again,
            # once that was answered.
            deadline = time.monotonic() + WAIT
            while not frame(browser)["smallest"] < 0.05:
                assert time.monotonic() < deadline, frame(browser)
                assert browser.evaluate(INTO_THE_BODY)
            near = frame(browser)["time"]
            browser.wait_for(f"{FRAME}.time > {near + 0.2}")
            done = frame(browser)["changes"]
            press(browser, "push")  # so short that a slow browser may not see it act
            browser.wait_for(f"{FRAME}.changes > {done}")
            assert browser.complaints == []
            process.send_signal(signal.SIGINT)
            notice = "document.getElementById('live-notice').textContent"
            browser.wait_for(f"/ended after/.test({notice})")
            assert browser.complaints == []
        out, err = process.communicate(timeout=WAIT)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0, err
    assert "Traceback" not in err
    kept = tmp_path / "kept"
    names = ["log.npz", "plot.png", "recording.html", "summary.json"]
    assert sorted(path.name for path in kept.iterdir()) == names
    assert "played live" in (kept / "recording.html").read_text(encoding="utf-8")
    judge(SimulationLog.load(kept / "log.npz"))


def judge(log: SimulationLog) -> None:
    """By the referee: 4 mm until the push, with the hands dragged into the body."""
    description = load_logged_robot(log)
    model = ControlModel.FromDescription(description, position_tasks(["left_wrist"]))
    referee = Referee(model.plant, model.scene_graph, description.pairs)
    pushed = re.search(r"([\d.]+) s: left_wrist pushed", log.scenario)
    calm = log.q[log.time < float(pushed[1])][::4]
    distances = np.array([referee.distances(q).min() for q in calm])
    assert 4e-3 <= distances.min() < 0.05
    np.testing.assert_allclose(np.diff(log.time), 0.005, atol=1e-9)  # no step skipped


@pytest.mark.parametrize(
    "arguments, why",
    [
        (["--speed", "-1"], "'-1' is not a positive number"),
        (["obstacle_arm", "--motion", "dance"], "has keyframes of its own"),
        (["--host", ""], "--host is empty"),
        (["--host", "b\u00fccher..de"], "is no address of a computer"),
        (["--host", "192.0.2.1"], "--host must be an address of this computer"),
        (["--out", "file"], "file is a file; name another folder"),
    ],
)
def test_what_cannot_be_played(tmp_path, monkeypatch, capsys, arguments, why):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert main(["play", "--no-browser", *arguments, "--duration", "0.01"]) == 2
    assert re.search(why, capsys.readouterr().err)


def test_a_port_in_use(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert main(["play", "--no-browser", "--port", port]) == 2
    assert f"HTTP at 127.0.0.1:{port}: " in capsys.readouterr().err
