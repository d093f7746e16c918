"""How `crar-drake play` ends: the question on a terminal, and Ctrl-C once and twice."""

import re
import signal
import socket
import subprocess
import sys
import urllib.request
from contextlib import suppress

import pytest

from crar_drake.commands import main
from crar_drake.play.live_simulation import LiveSimulation
from crar_drake.play.session import PlaySession
from crar_drake.results.log import SimulationLog

KEPT = "out/obstacle_arm_play"


@pytest.fixture
def terminal(monkeypatch, tmp_path):
    """An empty folder, somebody at a terminal, and a picture that takes no time."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(
        "crar_drake.results.plots.plot_run", lambda log, path, scenario: path.touch()
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
        + ["--port", "0", "--duration", "2", "--save", "kept"],
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
    assert {path.name for path in (tmp_path / "kept").iterdir()} == {
        *("log.npz", "plot.png", "recording.html", "summary.json")
    }
    assert SimulationLog.load(tmp_path / "kept" / "log.npz").time[-1] >= 1.9
    assert "recording.html" in out


def ctrl_c() -> None:
    signal.raise_signal(signal.SIGINT)


def answering(monkeypatch, answer) -> list[str]:
    """Lets somebody answer; the questions."""
    asked = []

    def say(question: str) -> str:
        asked.append(question)
        return answer()

    monkeypatch.setattr("builtins.input", say)
    return asked


def test_the_question_is_answered_by_no(terminal, monkeypatch, capsys):
    asked = answering(monkeypatch, lambda: " N ")
    assert play("--duration", "0.02") == 0
    assert asked == [f"keep the recording in {KEPT}? [Y/n] "]
    assert "nothing is kept" in capsys.readouterr().out
    assert not list(terminal.iterdir())


def end_of_input() -> str:
    raise EOFError


def test_no_answer_keeps_it(terminal, monkeypatch, capsys):
    monkeypatch.setattr(
        "crar_drake.results.playback.record_log", lambda log, path, **_: path.touch()
    )
    answering(monkeypatch, end_of_input)
    assert play("--duration", "0.02") == 0
    names = sorted(path.name for path in (terminal / KEPT).iterdir())
    assert names == ["log.npz", "plot.png", "recording.html", "summary.json"]
    assert "recording.html" in capsys.readouterr().out


def test_ctrl_c_at_the_question_keeps_the_log_and_makes_no_page(
    terminal, monkeypatch, capsys
):
    answering(monkeypatch, ctrl_c)
    assert play("--duration", "0.02") == 130
    assert sorted(p.name for p in (terminal / KEPT).iterdir())[0] == "log.npz"
    assert not (terminal / KEPT / "recording.html").exists()
    told = capsys.readouterr().err
    assert f"crar-drake playback {KEPT}/log.npz makes a page" in told


@pytest.mark.parametrize("where", ["in a step", "at the end", "after the end"])
def test_ctrl_c_twice_keeps_the_log(terminal, monkeypatch, capsys, where):
    """In a step that does not end, while the page is told, and once more after that."""
    usual = LiveSimulation.step

    def step(self: LiveSimulation) -> None:
        usual(self)
        if self.time > 0.042:
            ctrl_c()
            if where == "in a step":
                ctrl_c()
                pytest.fail("the step should be left")

    usual_end, closed = PlaySession.end, []

    def end(self: PlaySession, told: str = "") -> None:
        closed.append(told)
        usual_end(self, told)
        if where != "in a step" and len(closed) == 1:
            ctrl_c()

    usual_log = LiveSimulation.logged_scenario

    def logged_scenario(self: LiveSimulation):
        if where == "after the end":
            ctrl_c()
        return usual_log(self)

    monkeypatch.setattr(LiveSimulation, "step", step)
    monkeypatch.setattr(PlaySession, "end", end)
    monkeypatch.setattr(LiveSimulation, "logged_scenario", logged_scenario)
    made = []
    monkeypatch.setattr(
        "crar_drake.results.playback.record_log",
        lambda log, path, **_: (path.touch(), made.append(path)),
    )
    status = play("--save", "kept")
    log = SimulationLog.load(terminal / "kept" / "log.npz")
    assert log.time[-1] == pytest.approx(0.045)
    assert (terminal / "kept" / "summary.json").exists()
    # In a step the second one was used up; else it says that there is no time.
    assert status == (0 if where == "in a step" else 130)
    assert bool(made) == (where == "in a step")
    assert "Traceback" not in capsys.readouterr().err
