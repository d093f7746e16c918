"""Another benchmark builds on what the crossings found: of the same motions only."""

import json
from dataclasses import fields

import pytest

from benchmarks.peers.compare import PeerError
from benchmarks.peers.crossings import told_before
from benchmarks.peers.judge import Figures

FIGURES = dict.fromkeys((field.name for field in fields(Figures)), 0.0)


@pytest.fixture
def out(tmp_path):
    """Left by `crossings --robot g1 --first 3 --seeds 3`, errors 30, 40 and 50 mm."""
    told = {
        "robot": "g1",
        "cases": ["crossing_3", "crossing_4", "crossing_5"],
        "figures": {"mink": [FIGURES | {"error": e} for e in (0.03, 0.04, 0.05)]},
    }
    (tmp_path / "crossings.json").write_text(json.dumps(told))
    return tmp_path


def test_some_of_the_motions_are_found(out):
    found = told_before(out, "g1", ["crossing_5", "crossing_4"])
    assert [figures.error for figures in found["mink"]] == [0.05, 0.04]


@pytest.mark.parametrize(
    ("robot", "cases"),
    [("upper_body", ["crossing_3"]), ("g1", ["crossing_5", "crossing_6"])],
)
def test_other_motions_are_refused(out, robot, cases):
    with pytest.raises(PeerError, match=r"crossings\.json .* same --robot"):
        told_before(out, robot, cases)


def test_nothing_found_is_refused(tmp_path):
    with pytest.raises(PeerError, match="run benchmarks"):
        told_before(tmp_path, "g1", ["crossing_0"])
