"""Every script in examples/ runs, and says what it should."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from crar_drake.run import run_scenario
from crar_drake.simulation.scenario import load_scenario

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run_example(name: str, *arguments: str) -> str:
    finished = subprocess.run(
        [sys.executable, EXAMPLES / name, *arguments],
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert finished.returncode == 0, finished.stderr
    return finished.stdout


def millimetres(text: str) -> float:
    return float(re.search(r"(-?[\d.]+) mm", text).group(1))


@pytest.mark.slow
def test_build_and_simulate() -> None:
    lines = run_example("build_and_simulate.py", "0.6").splitlines()
    assert lines[0].startswith("task error at 0.6 s")
    assert millimetres(lines[1]) > 0.0


@pytest.mark.slow
def test_controller_in_your_diagram() -> None:
    lines = run_example("controller_in_your_diagram.py", "1.8").splitlines()
    # Ten per cent more mass costs millimetres, not more; and it does cost some.
    assert 0.1 < millimetres(lines[0]) < 10.0
    assert millimetres(lines[1]) > 0.0


@pytest.mark.slow
def test_playback_from_log(tmp_path: Path) -> None:
    scenario = load_scenario("obstacle_arm")
    scenario.duration = 0.2
    log = tmp_path / "log.npz"
    run_scenario(scenario).log.save(log)
    page = tmp_path / "page.html"
    out = run_example("playback_from_log.py", str(log), str(page))
    assert "0.2 s of 14 watched pairs" in out
    assert page.stat().st_size > 100_000
    assert list(tmp_path.glob("*.html")) == [page]


@pytest.mark.slow
def test_sweep_on_a_cluster(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="needs the extra: pip install .[cluster]")
    out = tmp_path / "results.csv"
    text = run_example("sweep_on_a_cluster.py", str(out), "0.1")
    assert [f"{n} of 4" for n in (1, 2, 3, 4)] == re.findall(r"^\d of 4", text, re.M)
    assert len(out.read_text().splitlines()) == 1 + 4
    assert "| clips | 2 | 2 |" in text and "## Failed" not in text


def test_every_example_has_a_test() -> None:
    tested = re.findall(r'run_example\(\s*"(\w+\.py)"', Path(__file__).read_text())
    elsewhere = {"teleoperate.py"}  # tests/commands/test_serve.py
    assert {path.name for path in EXAMPLES.glob("*.py")} == {*tested, *elsewhere}
