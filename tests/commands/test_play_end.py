"""How `crar-drake play` ends: what is kept, whoever goes away, and by Ctrl-C twice."""

import os
import pty
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from contextlib import suppress
from pathlib import Path

import pytest

from crar_drake.commands import main
from crar_drake.play.live_simulation import LiveSimulation
from crar_drake.results.log import SimulationLog

KEPT = "out/obstacle_arm_play"
FILES = ["log.npz", "plot.png", "recording.html", "summary.json"]


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """An empty one, and a picture that takes no time."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "crar_drake.results.plots.plot_run", lambda log, path: path.touch()
    )
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield tmp_path
    signal.signal(signal.SIGINT, before)


def play(*arguments: str) -> int:
    return main(["play", "obstacle_arm", "--no-browser", "--port", "0", *arguments])


@pytest.mark.slow
def test_an_empty_message_to_meshcat_loses_nothing(tmp_path):
    """Any web page can send it; it ends the thread of Meshcat's web socket, whose
    destructor then waits for ever."""
    process = subprocess.Popen(
        [sys.executable, "-m", "crar_drake", "play", "obstacle_arm", "--no-browser"]
        + ["--port", "0", "--duration", "2", "--out", "kept"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    url = process.stdout.readline().split()[0]
    page = urllib.request.urlopen(url, timeout=60).read().decode()
    port = int(re.search(r'"meshcatPort": ?(\d+)', page)[1])
    with socket.create_connection(("127.0.0.1", port), timeout=60) as web:
        web.sendall(
            b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n"
            b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        )
        assert b"101 Switching" in web.recv(4096)
        web.sendall(b"\x81\x80\0\0\0\0")  # a text of no length
        with pytest.raises(ConnectionRefusedError):  # the thread has ended
            while process.poll() is None:
                with suppress(ConnectionResetError):
                    socket.create_connection(("127.0.0.1", port), timeout=60).close()
        out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    assert names(tmp_path / "kept") == FILES
    assert SimulationLog.load(tmp_path / "kept" / "log.npz").time[-1] >= 1.9
    assert "recording.html" in out


def ctrl_c() -> None:
    signal.raise_signal(signal.SIGINT)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("gone", ["terminal", "reader", "from the first"])
def test_whoever_goes_away_takes_nothing_along(gone, tmp_path):
    """A terminal, with two SIGHUPs; `| head`; and `>&- 2>&-`."""

    def begin() -> None:
        for number in (signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        if gone == "from the first":
            os.close(1)
            os.close(2)

    ours, theirs = pty.openpty() if gone == "terminal" else os.pipe()
    command = [sys.executable, "-m", "crar_drake", "play", "obstacle_arm"]
    command += ["--no-browser", "--port", "0", "--out", "kept"]
    if gone == "from the first":
        command += ["--duration", "0.5"]
    process = subprocess.Popen(
        command, cwd=tmp_path, stdout=theirs, stderr=theirs, preexec_fn=begin
    )
    os.close(theirs)
    with open(ours) as lines:
        if gone != "from the first":
            assert lines.readline().startswith("http://")
    if gone == "terminal":
        process.send_signal(signal.SIGHUP)
        process.send_signal(signal.SIGHUP)
    elif gone == "reader":
        process.send_signal(signal.SIGINT)
    assert process.wait(timeout=300) == 0
    assert names(tmp_path / "kept") == FILES
    assert len(SimulationLog.load(tmp_path / "kept" / "log.npz").time)


def test_a_defect_loses_nothing(folder, monkeypatch):
    def step(self: LiveSimulation) -> None:
        raise ZeroDivisionError("a defect of ours")

    monkeypatch.setattr(LiveSimulation, "step", step)
    monkeypatch.setattr(
        "crar_drake.results.playback.record_logs", lambda logs, path, **_: path.touch()
    )
    with pytest.raises(ZeroDivisionError):
        play()
    assert names(folder / KEPT) == FILES


@pytest.mark.parametrize("where", ["in a step", "after the end"])
def test_ctrl_c_twice_keeps_the_log(folder, monkeypatch, capsys, where):
    """In a step that does not end; and while it is found out what to keep."""
    usual = LiveSimulation.step

    def step(self: LiveSimulation) -> None:
        usual(self)
        if self.time > 0.042:
            ctrl_c()
            if where == "in a step":
                ctrl_c()
                pytest.fail("the step should be left")

    usual_log = LiveSimulation.logged_scenario

    def logged_scenario(self: LiveSimulation):
        if where == "after the end":
            signal.raise_signal(signal.SIGHUP)  # which is nothing new
            ctrl_c()
        return usual_log(self)

    monkeypatch.setattr(LiveSimulation, "step", step)
    monkeypatch.setattr(LiveSimulation, "logged_scenario", logged_scenario)
    made = []
    monkeypatch.setattr(
        "crar_drake.results.playback.record_logs",
        lambda logs, path, **_: (path.touch(), made.append(path)),
    )
    status = play("--out", "kept")
    log = SimulationLog.load(folder / "kept" / "log.npz")
    assert log.time[-1] == pytest.approx(0.045)
    # In a step the second one was used up; else it says that there is no time.
    assert status == (0 if where == "in a step" else 130)
    assert bool(made) == (where == "in a step")
    told = capsys.readouterr().err
    assert "Traceback" not in told
    if where == "after the end":
        assert names(folder / "kept") == ["log.npz"]
        assert "crar-drake show kept/log.npz makes a page" in told
