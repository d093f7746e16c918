"""What the preview is for: hands that cross are followed more closely, and calmly."""

import json

import numpy as np
import pytest

from benchmarks.peers.compare import PERIOD
from benchmarks.peers.crossings import FARTHER, PARTS, by_time, error_within
from benchmarks.peers.driver import Problem, run
from benchmarks.peers.judge import Judge
from benchmarks.peers.peers import NO_PREVIEW
from benchmarks.peers.problem import write_crossings, write_problem
from benchmarks.peers.run_crar import Crar


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    """The folder, its cases and their judge."""
    folder = tmp_path_factory.mktemp("problem")
    write_problem(folder)
    cases = write_crossings(folder, range(3))
    data = json.loads((folder / "problem.json").read_text())
    return folder, cases, Judge(data["robot"], data["joints"], data["tasks"])


@pytest.fixture(scope="module")
def figures(problem):
    """Error, acceleration and smallest distance of three motions: with and without."""
    folder, cases, judge = problem
    return [
        [
            judge.figures(
                run(
                    Crar(Problem(folder), PERIOD, settings),
                    folder / f"{case}.npz",
                    PERIOD,
                )
            )
            for case in cases
        ]
        for settings in (FARTHER, NO_PREVIEW)
    ]


def test_hands_that_cross_are_followed_more_closely(figures):
    seen, blind = figures
    assert all(each.holds for each in seen)
    # Asked to keep 5 mm.
    assert min(each.smallest_distance for each in seen) >= 5e-3
    ratios = [a.error / b.error for a, b in zip(seen, blind, strict=True)]
    assert np.median(ratios) < 0.6


def test_and_hardly_less_calmly(figures):
    seen, blind = figures
    ratios = [
        a.rms_acceleration / b.rms_acceleration
        for a, b in zip(seen, blind, strict=True)
    ]
    assert np.median(ratios) < 1.2


def test_errors_are_told_by_time(problem, figures):
    """A robot that stays where it is, from a target that stays until 0.5 s."""
    folder, cases, judge = problem
    with np.load(folder / f"{cases[0]}.npz") as case:
        still = np.tile(case["q_start"], (len(case["time"]), 1))
        result = {"time": case["time"], "q": still, "p": case["p"]}
    squares = [
        error_within(judge, result, *part) ** 2 * (part[1] - part[0]) for part in PARTS
    ]
    whole = np.sqrt(np.mean(judge.errors(result) ** 2))
    assert np.sqrt(np.sum(squares) / 6.0) == pytest.approx(whole, rel=1e-3)
    assert error_within(judge, result, 0.0, 0.5) < 1e-9
    seen, blind = ([[one] for one in figures[i]] for i in range(2))
    table = by_time({"Pink": seen, "ours": blind})
    assert table.rows[0] == ["Pink", "1.00", "1.00", "1.00"]
    expected = [
        f"{b[0].error / a[0].error:.2f}" for a, b in zip(seen, blind, strict=True)
    ]
    assert table.rows[1] == ["ours", *expected]
