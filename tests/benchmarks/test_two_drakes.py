"""Two interpreters, by turns: the ratio of the rounds; what is said of a failure."""

import copy
import re
import sys

import pytest

from benchmarks import two_drakes
from benchmarks.two_drakes import main, measure_once
from crar_drake.errors import CrarError


@pytest.mark.slow
def test_one_measurement_is_of_this_copy(tmp_path, monkeypatch):
    """Whatever the working directory, with one thread, and of the interpreter given.

    The command that it runs takes one thread by starting itself again, whatever the
    environment says.
    """
    monkeypatch.chdir(tmp_path)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(name, "2")
    result = measure_once(sys.executable, "dance", 0.01)
    assert result["machine"]["python"] == sys.version.split()[0]
    assert result["machine"]["threads"] == "1"
    assert len(result["step"]) == 8 and result["step"][0]["steps"] == 11
    assert not list(tmp_path.iterdir())


def made_up(python: str, step: float) -> dict:
    times = {"cpu_median": step}
    orders = {"step": times, "bound": {"cpu_median": step / 4}}
    return {
        "machine": {
            "cpu": "abacus",
            "cores": 2,
            "load": 0.5,
            "threads": "1",
            "python": python,
            "numpy": "2.9",
            "drake": f"of {python}",
        },
        "step": [
            {
                "case": "wrists",
                "constraints": "paper",
                "in_a_row": orders,
                "by_turns": copy.deepcopy(orders),
            }
        ],
    }


def test_ratios_are_those_of_the_rounds(tmp_path, monkeypatch, capsys):
    """The machine gets slower from round to round, for both."""
    asked = []
    speed = {"old": 100e-6, "new": 80e-6}

    def measured(python, motion, duration):
        asked.append((python, motion, duration))
        slower = 1.0 + len([a for a in asked if a[0] == python])
        return made_up(python, speed[python] * slower)

    monkeypatch.setattr(two_drakes, "measure_once", measured)
    page = tmp_path / "page.md"
    page.write_text("<!-- two drakes -->\n<!-- end -->\n")
    options = ["--rounds", "3", "--duration", "0.5", "--page", str(page)]
    main(["old", "new", *options])
    assert asked == [("old", "dance", 0.5), ("new", "dance", 0.5)] * 3
    text = page.read_text()
    row = re.search(r"\| wrists, paper \| step \|.*", text)[0]
    assert row in capsys.readouterr().out
    said = " ".join(text.split())
    assert "Drake of old (Python old, NumPy 2.9) and Drake of new" in said
    row = re.search(r"\| wrists, paper \| step \| (.*) \|", text)[1]
    assert row == "300 | 240 | 0.80 (0.80 to 0.80)"
    assert "| 75 | 60 |" in text  # the bound


@pytest.mark.parametrize(
    "pythons, options, words",
    [
        (["no/such/python", sys.executable], [], "no/such/python does not run"),
        ([sys.executable] * 2, ["--rounds", "0"], "--rounds: 0"),
        ([sys.executable] * 2, ["--motion", "danse"], "did you mean"),
        ([sys.executable] * 2, ["--duration", "-1"], "cannot measure"),
    ],
)
def test_what_is_wrong_is_told(pythons, options, words):
    with pytest.raises(CrarError) as caught:
        main([*pythons, *options])
    assert words in str(caught.value)
