"""What is said to be possible with foresight is, by the judge of all controllers."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.peers import foresight
from benchmarks.peers.driver import Problem
from benchmarks.peers.foresight import Foresight
from benchmarks.peers.judge import Judge
from benchmarks.peers.problem import write_crossings, write_problem

LONG = 1001  # samples: until after the first crossing of the motion


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    made = tmp_path_factory.mktemp("problem")
    write_problem(made)
    write_crossings(made, [0])
    return made


def test_a_crossing_is_followed_clear_of_contact(folder, monkeypatch):
    data = json.loads((folder / "problem.json").read_text())
    judge = Judge(data["robot"], data["joints"], data["tasks"])
    motion = dict(np.load(folder / "crossing_0.npz"))
    # From 1 s on, where the first hands meet, as if it began there at rest.
    part = slice(1000, 1000 + LONG)
    q_start = motion["q_reference"][1000]
    cut = {"time": motion["time"][:LONG], "p": motion["p"][part], "q_start": q_start}
    reference = motion["q_reference"][part]
    monkeypatch.setattr(foresight, "WEIGHTS", (0.1, 1.6))
    case = Foresight(judge, Problem(folder), cut)
    (_, close), (_, calm) = case.trade([reference])
    figures = [judge.figures(found) for found in (close, calm)]

    assert judge.figures(close | {"q": reference[::5]}).smallest_distance < -0.01
    for found, told in zip((close, calm), figures, strict=True):
        assert told.holds and told.smallest_distance > 4e-3
        np.testing.assert_allclose(found["q"][0], q_start, atol=1e-6)
        np.testing.assert_allclose(found["v"][0], 0.0, atol=1e-5)
        differences = np.gradient(found["q"], found["time"], axis=0)
        np.testing.assert_allclose(found["v"][1:-1], differences[1:-1], atol=0.05)
    assert figures[0].error < figures[1].error
    assert figures[1].rms_acceleration < figures[0].rms_acceleration
