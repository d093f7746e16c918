"""What the plan is for: hands that cross are followed more closely, and calmly."""

import json

import numpy as np

from benchmarks.peers.crossings import FARTHER, by_time, error_within, row
from benchmarks.peers.driver import Problem, run
from benchmarks.peers.judge import Judge
from benchmarks.peers.peers import PAPER
from benchmarks.peers.problem import write_crossings, write_problem
from benchmarks.peers.run_crar import Crar
from benchmarks.peers.runs import PERIOD


def test_hands_that_cross_are_followed_more_closely_and_hardly_less_calmly(tmp_path):
    write_problem(tmp_path)
    cases = write_crossings(tmp_path, range(3))
    data = json.loads((tmp_path / "problem.json").read_text())
    judge = Judge(data["robot"], data["joints"], data["tasks"])
    seen, blind = [], []
    for settings, figures in ((FARTHER, seen), (PAPER, blind)):
        crar = Crar(Problem(tmp_path), PERIOD, settings)
        for case in cases:
            made = run(crar, tmp_path / f"{case}.npz", PERIOD)
            figures.append(judge.figures(made))
            assert error_within(judge, made, 0.0, 0.5) < figures[-1].error
    assert all(each.holds for each in seen)
    # Asked to keep 5 mm.
    assert min(each.smallest_distance for each in seen) >= 5e-3
    pairs = list(zip(seen, blind, strict=True))
    assert np.median([a.error / b.error for a, b in pairs]) < 0.6
    calm = [a.rms_acceleration / b.rms_acceleration for a, b in pairs]
    assert np.median(calm) < 1.2
    # The tables, as if the paper's law were a peer's.
    told = row("ours", seen, [one.error for one in blind])
    assert told[1] == "3 of 3" and float(told[4]) < 0.6
    table = by_time({"Pink": [[one] for one in blind], "ours": [[one] for one in seen]})
    assert table.rows[0] == ["Pink", "1.00", "1.00", "1.00"]
