"""The adversary's attacks written for the peers, and who judges them."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.peers import attacked
from benchmarks.peers.judge import Judge as Referee
from benchmarks.peers.problem import write_problem


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("attacked")
    write_problem(path)
    return path


@pytest.fixture(scope="module")
def witness(folder) -> attacked.Witness:
    return attacked.Witness(folder)


def referee(witness) -> Referee:
    return Referee("upper_body", list(witness.model.joint_names), ["neck"])


def recorded(q: np.ndarray, period: float = 1e-3) -> dict[str, np.ndarray]:
    """What a driver would have written of these configurations."""
    v = np.vstack([np.zeros(q.shape[1]), np.diff(q, axis=0) / period])
    steps = len(q) - 1
    return {
        "time": period * np.arange(steps + 1),
        "q": q,
        "v": v,
        "p": np.zeros((steps + 1, 1, 3)),
        "no_answer": np.zeros(steps, dtype=bool),
    }


def test_harm_is_what_the_referee_finds(folder, witness) -> None:
    """The reference of the comparison penetrates; Drake's distances say the same."""
    q = np.load(folder / "crossing.npz")["q_reference"][::5]
    result = recorded(q, 5e-3)
    result["no_answer"][3] = True
    harm, figures = witness.harm(result), referee(witness).figures(result)
    assert harm.clearance == pytest.approx(figures.smallest_distance, abs=1e-9)
    assert harm.clearance < -0.05
    assert harm.penetrating == round(figures.penetrating * len(q)) > 0
    assert harm.beyond_limit == round(figures.beyond_limit * len(q)) > 0
    assert harm.excess == pytest.approx(figures.limit_excess, abs=1e-12)
    assert (harm.violated, harm.no_answer, harm.episodes) == (1, 1, 1)


def test_attacks_start_clear_and_at_rest(folder, witness) -> None:
    """By the referee; and what swings has the velocities of its positions."""
    cases = attacked.write_attacks(folder, witness, attacked.ATTACKS, range(2))
    judge = referee(witness)
    for name in (name for names in cases.values() for name in names):
        case = np.load(folder / f"{name}.npz")
        figures = judge.figures(recorded(np.tile(case["q_start"], (2, 1))))
        assert figures.smallest_distance > 0.0, name
        assert figures.beyond_limit == 0.0, name
        assert case["p"].shape == case["v"].shape == (1001, 7, 3)
    for name in (*cases["sine"], *cases["search"], *cases["squeeze"]):
        case = np.load(folder / f"{name}.npz")
        slope = (case["p"][2:] - case["p"][:-2]) / 2e-3
        scale = np.abs(case["v"]).max()
        assert np.abs(slope - case["v"][1:-1]).max() < 0.01 * scale, name
