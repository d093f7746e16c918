"""`crar-drake serve`, its client, and what it says at its end."""

import subprocess
import sys
import threading
from pathlib import Path

import pytest

from crar_drake.commands import main
from crar_drake.commands.serve import GATE
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


def test_the_command_ends_with_what_it_did(capsys):
    assert main(["serve", "--port", "0", "--duration", "0.2"]) == 0
    printed = capsys.readouterr().out
    assert "upper_body: UDP at 127.0.0.1:" in printed
    assert "messages: none" in printed and "smallest distance: 79" in printed


def test_the_defaults_are_those_of_the_gate():
    assert Gate(**{name: default for name, (_, default, _) in GATE.items()}) == Gate()


def test_what_cannot_be_served(capsys):
    assert main(["serve", "--port", "99999", "--duration", "1"]) == 2
    assert "99999 must be from 0 to 65535" in capsys.readouterr().err
    assert main(["serve", "--speed", "-1"]) == 2
    assert main(["serve", "no_such"]) == 2
    assert "no scenario 'no_such'" in capsys.readouterr().err
