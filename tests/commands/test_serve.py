"""`crar-drake serve`, its client, and what it says at its end."""

import json
import os
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
from crar_drake.commands.serve import GATE, NeverWaiting
from crar_drake.errors import CrarError
from crar_drake.law.compilation import COMPILING
from crar_drake.teleoperation.serving import make_server
from crar_drake.teleoperation.target_stream import Gate

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
        while not server.robot.positions:
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


def swinging(process) -> tuple[socket.socket, list[dict]]:
    """A client whose targets have brought the robot to 1 rad/s, and what it heard."""
    port = int(re.search(r":(\d+)$", process.stdout.readline()).group(1))
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


@pytest.mark.slow
@pytest.mark.parametrize(
    "first, second",
    [
        ("SIGINT", None),
        ("SIGINT", "SIGHUP"),
        ("SIGTERM", "SIGINT"),
        ("SIGHUP", "SIGTERM"),
    ],
)
def test_a_signal_brakes_and_a_second_one_ends_at_once(first, second):
    def heeds():  # also where whoever runs the tests ignores them
        for each in ("SIGINT", "SIGTERM", "SIGHUP"):
            signal.signal(getattr(signal, each), signal.SIG_DFL)

    process = subprocess.Popen(
        [sys.executable, "-m", "crar_drake", "serve", "--port", "0"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heeds,
    )  # fmt: skip
    client, heard = swinging(process)
    process.send_signal(getattr(signal, first))
    while heard[-1]["status"] != "braking":
        heard.append(json.loads(client.recv(65536)))
    if second:
        process.send_signal(getattr(signal, second))
    out, err = process.communicate(timeout=120)
    client.settimeout(0.2)
    try:
        while True:
            heard.append(json.loads(client.recv(65536)))
    except OSError:  # nothing more, or nobody there
        client.close()
    if second:
        assert process.returncode == 130 and "ended in motion" in err
        assert fastest(heard[-1]) > 0.01
    else:
        assert process.returncode == 0 and not err and "steps:" in out
        assert heard[-1]["status"] == "braking" and fastest(heard[-1]) < 0.01


@pytest.mark.parametrize("reader", ["goes away", "does not read"])
def test_whoever_reads_its_lines_cannot_hold_it(reader, monkeypatch):
    theirs, ours = os.pipe()
    if reader == "goes away":
        os.close(theirs)
    monkeypatch.setattr(serve, "_STDERR", ours)
    told = NeverWaiting()
    for _ in range(1000):  # a pipe takes 64 kB
        told.write("x" * 1000)
    if reader == "does not read":
        assert os.read(theirs, 2).startswith(b"x")


def test_the_command_ends_with_what_it_did(capsys):
    assert main(["serve", "--port", "0", "--duration", "0.2"]) == 0
    printed = capsys.readouterr().out
    assert "upper_body: UDP at 127.0.0.1:" in printed
    assert "messages: none" in printed and "smallest distance: 79" in printed


def test_it_says_that_it_compiles(monkeypatch, capfd):
    def make(*_, **__):
        numba.njit(lambda x: x + 1.0)(1.0)
        raise CrarError("made")

    monkeypatch.setattr("crar_drake.teleoperation.serving.make_server", make)
    monkeypatch.setattr(serve, "NeverWaiting", Printing)
    assert main(["serve"]) == 2
    assert COMPILING in capfd.readouterr().err


class Printing:
    def write(self, line: str) -> None:
        print(line, file=sys.stderr)


def test_the_defaults_are_those_of_the_gate():
    assert Gate(**{name: default for name, (_, default, _) in GATE.items()}) == Gate()


def test_a_start_posture_that_is_none(tmp_path, capsys):
    file = tmp_path / "start.json"
    wrong = {
        "[1.0]": 'give {"joint": position, ...}',
        '{"left_elbow": true}': 'give {"joint": position, ...}',
        '{"left_elbow": NaN}': 'give {"joint": position, ...}',
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
