"""What the preview is for: hands that cross are followed more closely, and calmly."""

import json

import numpy as np
import pytest

from benchmarks.peers.compare import PERIOD
from benchmarks.peers.crossings import FARTHER
from benchmarks.peers.driver import Problem, run
from benchmarks.peers.judge import Judge
from benchmarks.peers.peers import NO_PREVIEW
from benchmarks.peers.problem import write_crossings, write_problem
from benchmarks.peers.run_crar import Crar


@pytest.fixture(scope="module")
def figures(tmp_path_factory):
    """Error, acceleration and smallest distance of three motions: with and without."""
    folder = tmp_path_factory.mktemp("problem")
    write_problem(folder)
    cases = write_crossings(folder, range(3))
    data = json.loads((folder / "problem.json").read_text())
    judge = Judge(data["robot"], data["joints"], data["tasks"])
    problem = Problem(folder)
    return [
        [
            judge.figures(
                run(Crar(problem, PERIOD, settings), folder / f"{case}.npz", PERIOD)
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
