"""Every script in examples/ runs, and says what it should."""

import re
import runpy
import sys
from pathlib import Path

import pytest

THIS = Path(__file__).resolve()
EXAMPLES = THIS.parents[1] / "examples"


@pytest.fixture
def run_example(monkeypatch, capsys):
    """Runs a script as its own program, but in this process; what it prints."""

    def run(name: str, *arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def millimetres(text: str) -> float:
    return float(re.search(r"(-?[\d.]+) mm", text).group(1))


@pytest.mark.slow
def test_a_layers_example(run_example, tmp_path: Path, monkeypatch) -> None:
    """The hand stays off the post, a pose of each frame off itself, and so a run."""
    monkeypatch.chdir(tmp_path)
    assert 4.0 <= millimetres(run_example("law.py"))
    assert millimetres(run_example("motions.py").splitlines()[1]) > 0.0
    lines = run_example("runs.py", "0.3").splitlines()
    assert lines[0].endswith(": 0") and millimetres(lines[1]) > 0.0
    assert (tmp_path / "boxing" / "log.npz").exists()


@pytest.mark.slow
def test_a_filter_behind_drakes_inverse_kinematics(run_example) -> None:
    said = run_example("filter_diff_ik.py")
    # Without the filter the arm passes through the post, 89 mm deep.
    assert 4.0 <= millimetres(said) < 30.0 and " 0 violated" in said


@pytest.mark.slow
def test_a_filter_of_a_policys_actions(run_example) -> None:
    kinds, found = run_example("filter_a_policy.py", "6").splitlines()
    counts = {kind: int(n) for kind, n in re.findall(r"([a-z ]+): (\d+)", kinds)}
    assert sum(counts.values()) == 300 and counts["nominal"] > 50
    assert any("pair" in kind for kind in counts)
    assert 4.0 <= millimetres(found) < 30.0 and " 0 violated" in found


@pytest.mark.slow
def test_a_filter_before_a_robot_that_lags(run_example) -> None:
    off, found = run_example("filter_a_lagging_robot.py", "2.5").splitlines()
    # The command keeps 4 mm; the arm, which lags, what is left of it.
    assert 0.1 < float(re.search(r"([\d.]+) degrees", off)[1]) < 5.0
    assert 0.0 < millimetres(found) < 30.0 and " 0 violated" in found


@pytest.mark.slow
def test_a_cell_that_would_tip(run_example) -> None:
    """In contact with a floor it does so without balance, and not with it."""
    without, kept = run_example("tipping_cell.py", "4").splitlines()
    lean = [float(re.search(r"([\d.]+) degrees", line)[1]) for line in (without, kept)]
    assert lean[0] > 20.0 and lean[1] < 2.0
    assert kept.endswith("after 4.0 s")
    assert millimetres(kept) < 150.0  # it does not stand still, either


@pytest.mark.slow
def test_see_your_diagram(run_example, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    lines = run_example("see_your_diagram.py", "upper_body", "2.2", str(page))
    told = lines.splitlines()[-3:]
    assert told[0].endswith("links watch the post") and told[2] == str(page)
    # The wrist's target passes through the post; the arm stays beside it.
    assert 4.0 < millimetres(told[1]) < 30.0
    assert page.stat().st_size > 100_000


@pytest.mark.slow
def test_a_constraint_of_ones_own(run_example) -> None:
    said = run_example("own_constraint.py", "400")
    assert 0.0 <= millimetres(said) < 50.0
    assert int(re.search(r"(\d+) of 400 held back", said)[1]) > 0


def test_every_example_has_a_test() -> None:
    tested = re.findall(r'(?:run_example\(|EXAMPLES /) ?"(\w+\.py)"', THIS.read_text())
    # tests/commands/test_serve.py
    elsewhere = {"teleoperate.py", "lagging_robot.py"}
    assert {path.name for path in EXAMPLES.glob("*.py")} == {*tested, *elsewhere}


@pytest.mark.slow
def test_a_station(run_example, tmp_path: Path) -> None:
    page = tmp_path / "station.html"
    *targets, nearest = run_example("station.py", "3", str(page)).splitlines()
    assert len(targets) == 3 and page.stat().st_size > 1e5
    assert all(line.endswith("guaranteed") for line in targets)
    assert millimetres(nearest) >= 4.0


@pytest.mark.slow
def test_two_arms(run_example) -> None:
    *_, nearest, promise = run_example("two_arms.py", "2").splitlines()
    assert 4.0 <= millimetres(nearest) < 50.0 and promise == "guaranteed"


@pytest.mark.slow
def test_a_recording_in_a_diagram_of_ones_own(run_example) -> None:
    nearest, kept = run_example("follow_a_recording.py", "dance", "2").splitlines()
    assert millimetres(nearest) >= 4.0 and "in 100 % of" in kept
