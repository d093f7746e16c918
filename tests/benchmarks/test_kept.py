"""Results of long benchmarks that are kept by seed."""

import json

import pytest

from benchmarks import balance, kept
from benchmarks.balance import Tally
from benchmarks.kept import Kept, measured_by
from crar_drake.errors import CrarError


def test_what_was_kept_is_gone_on_with(tmp_path):
    first = Kept("some", 3, tmp_path)
    first.keep({"a": 1})
    first.keep({"b": float("-inf")})
    again = Kept("some", 3, tmp_path)
    assert again.results == {"a": 1, "b": float("-inf")}
    assert measured_by([first, again]) == ""
    assert Kept("some", 4, tmp_path).results == {}
    path = tmp_path / "some" / "seed-3.json"
    path.write_text(json.dumps({"versions": ["one older"], "results": {}}))
    older = Kept("some", 3, tmp_path)
    older.keep({"c": 2})
    assert measured_by([older]).startswith("Measured by ")
    assert "one older; " in measured_by([older]) or "; one older" in measured_by(
        [older]
    )
    path.write_text("{}")
    with pytest.raises(CrarError, match=r"seed-3.json: no results of a seed"):
        Kept("some", 3, tmp_path)


def test_episodes_that_were_done_are_not_done_again(tmp_path, monkeypatch):
    asked = []

    def run_at(subject, attack, dice):
        asked.append((subject, attack, dice))
        return Tally(steps=600, outside=int(subject == "loose"), farthest=-0.1)

    monkeypatch.setattr(balance, "run_at", run_at)
    monkeypatch.setattr(balance, "Kept", lambda name, seed: Kept(name, seed, tmp_path))
    subjects = {("a", "balance"): "kept", ("a", "without"): "loose"}
    balance.attack_all(subjects, 1200, 1)
    assert len(asked) == 3  # and one without
    found = balance.attack_all(subjects, 3000, 1)
    assert len(asked) == len(set(asked)) == 6
    total = Tally()
    for each in found.results.values():
        total.add(Tally(**each))
    assert (total.steps, total.outside, total.farthest) == (3600, 1, -0.1)
    assert total.violations == 1 and kept.ROOT not in tmp_path.parents
