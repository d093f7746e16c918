"""`crar-drake serve`, its client, and what it says at its end."""

import json
import os
import pty
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numba
import numpy as np
import pytest

from crar_drake.commands import main, serve
from crar_drake.commands.serve import tell_at_once
from crar_drake.errors import CrarError
from crar_drake.law.compilation import COMPILING, cache_folder, compiled
from crar_drake.teleoperation.serving import make_server

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "teleoperate.py"


@pytest.mark.slow
def test_a_recorded_motion_over_the_loopback_interface():
    """The client of examples/, with nonsense and losses."""
    server = make_server(rate=100.0)
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        client = subprocess.run(
            [sys.executable, EXAMPLE, "--port", str(server.address[1])]
            + ["--duration", "1.5", "--rate", "40", "--trouble", "0.2"],
            capture_output=True,
            text=True,
            timeout=900,
        )
    finally:
        server.stop()
        thread.join()
        server.close()
    assert client.returncode == 0, client.stderr
    assert "upper_body: left_wrist, right_wrist" in client.stdout
    assert "\n0 of " in client.stdout and "from target to answer: p50" in client.stdout
    messages = server.statistics.messages
    assert messages["taken"] > 30 and messages["malformed"] > 0


@pytest.mark.slow
def test_a_robot_that_lags_and_loses_messages_in_another_process():
    """The robot and the client of examples/, a tenth of all messages lost."""
    server = make_server(
        rate=100.0, start_measured=True, latency=0.01, tracking_error=0.5
    )
    thread = threading.Thread(target=server.run)
    thread.start()
    port = ["--port", str(server.address[1])]
    try:
        robot = subprocess.Popen(
            [sys.executable, EXAMPLE.with_name("lagging_robot.py"), *port]
            + ["--lag", "0.02", "--late", "0.01", "--loss", "0.1"],
            stdout=subprocess.PIPE,
            text=True,
        )
        while server._start_measured:
            assert thread.is_alive() and robot.poll() is None
            time.sleep(0.05)
        client = subprocess.run(
            [sys.executable, EXAMPLE, *port, "--duration", "3", "--rate", "40"],
            capture_output=True,
            text=True,
            timeout=900,
        )
        server.stop()
        said, _ = robot.communicate(timeout=900)
    finally:
        server.stop()
        thread.join()
        server.close()
    assert client.returncode == 0 and robot.returncode == 0, client.stderr
    assert re.search(r"\d+ commands: .*tracking", said), said
    off = float(re.search(r"at most ([\d.]+) rad", said).group(1))
    assert 0.0 < server.statistics.largest_error < 0.5 and off < 0.5
    assert server.statistics.messages["measured"] > 100
    assert "rad or m at most" in "\n".join(server.statistics.lines())


def swinging(line: str) -> tuple[socket.socket, list[dict]]:
    """A client whose targets have brought the robot to 1 rad/s, and what it heard.

    Args:
        line: the server's first.
    """
    port = int(re.search(r":(\d+)$", line).group(1))
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.connect(("127.0.0.1", port))
    client.settimeout(60.0)
    heard = [{"velocities": [0.0]}]
    while fastest(heard[-1]) < 1.0:
        target = {"left_wrist": {"position": [0.45, 0.2, 1.1]}}
        client.send(json.dumps({"targets": target}).encode())
        heard.append(json.loads(client.recv(65536)))
    return client, heard


def fastest(command: dict) -> float:
    return np.abs(command["velocities"]).max()


def heeds() -> None:
    """Also where whoever runs the tests ignores them."""
    for each in ("SIGINT", "SIGTERM", "SIGHUP"):
        signal.signal(getattr(signal, each), signal.SIG_DFL)


def serving(stdout: int, stderr: int) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "crar_drake", "serve", "--port", "0"],
        stdout=stdout, stderr=stderr, text=True, preexec_fn=heeds,
    )  # fmt: skip


def last_heard(client: socket.socket, heard: list[dict]) -> dict:
    """The last command of a server that has ended."""
    client.settimeout(0.2)
    try:
        while True:
            heard.append(json.loads(client.recv(65536)))
    except OSError:  # nothing more, or nobody there
        client.close()
    return heard[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    "first, others",
    [
        ("SIGINT", []),
        ("SIGHUP", ["SIGHUP", "SIGTERM", "SIGHUP"]),
        ("SIGINT", ["SIGHUP"]),
        ("SIGTERM", ["SIGINT"]),
    ],
)
def test_a_signal_brakes_and_only_ctrl_c_again_ends_at_once(first, others):
    process = serving(subprocess.PIPE, subprocess.PIPE)
    client, heard = swinging(process.stdout.readline())
    process.send_signal(getattr(signal, first))
    while heard[-1]["status"] != "braking":
        heard.append(json.loads(client.recv(65536)))
    for other in others:
        process.send_signal(getattr(signal, other))
    out, err = process.communicate(timeout=120)
    last = last_heard(client, heard)
    if others == ["SIGINT"]:
        assert process.returncode == 130 and "ended in motion" in err
        assert fastest(last) > 0.01
    else:
        assert process.returncode == 0 and not err and "steps:" in out
        assert last["status"] == "braking" and fastest(last) < 0.01


@pytest.mark.slow
def test_a_terminal_that_is_closed_brakes():
    """It takes stdout and stderr with it, and sends two SIGHUPs."""
    terminal, theirs = pty.openpty()
    process = serving(theirs, theirs)
    os.close(theirs)
    with open(terminal) as lines:
        client, heard = swinging(lines.readline())
    process.send_signal(signal.SIGHUP)
    process.send_signal(signal.SIGHUP)
    process.wait(timeout=120)
    last = last_heard(client, heard)
    assert process.returncode == 0
    assert last["status"] == "braking" and fastest(last) < 0.01


@pytest.mark.parametrize("reader", ["goes away", "does not read"])
def test_whoever_reads_its_lines_cannot_hold_it(reader, monkeypatch):
    theirs, ours = os.pipe()
    if reader == "goes away":
        os.close(theirs)
    monkeypatch.setattr(serve, "_STDERR", ours)
    for _ in range(1000):  # a pipe takes 64 kB
        tell_at_once("x" * 1000)
    if reader == "does not read":
        assert os.read(theirs, 2).startswith(b"x")


def test_the_command_ends_with_what_it_did(capsys):
    assert main(["serve", "--port", "0", "--duration", "0.2"]) == 0
    printed = capsys.readouterr().out
    assert "upper_body: UDP at 127.0.0.1:" in printed
    assert "messages: none" in printed and "smallest distance: 79" in printed


def _same(x):
    return x


def test_it_says_that_it_compiles(monkeypatch, capfd, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    cache_folder.cache_clear()

    def make(*_, **__):
        assert compiled(_same)(1.0) == 1.0
        raise CrarError("made")

    monkeypatch.setattr("crar_drake.teleoperation.serving.make_server", make)
    assert main(["serve"]) == 2
    assert COMPILING in capfd.readouterr().err
    cache_folder.cache_clear()


def test_a_start_posture_that_is_none(tmp_path, capsys):
    file = tmp_path / "start.json"
    wrong = {
        "[1.0]": "no JSON object",
        "{}": 'give {"joint": position, ...}',
        '{"left_elbow": true}': "is no number",
        '{"left_elbow": NaN}': "NaN is no number",
        '{"left_elbow": 1%s}' % ("0" * 400): "is not from -1000 to 1000",
        "{": "Expecting property name",
        "[" * 100_000: "recursion",
        '{"left_elbow": 1.0}': "beyond its limits",
    }
    for text, message in wrong.items():
        file.write_text(text)
        assert main(["serve", "--port", "0", "--start", str(file)]) == 2
        assert message in capsys.readouterr().err
    assert main(["serve", "--port", "0", "--start", str(tmp_path / "none")]) == 2
    assert "No such file" in capsys.readouterr().err
    file.write_text('{"left_elbow": -1.0}')
    assert main(["serve", "--port", "0", "--start", str(file), "--duration", "1"]) == 0
