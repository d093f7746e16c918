"""Cases that are run once, and again where their results do not count any more."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial

import pytest

from benchmarks.kept_cases import run_cases, source_digest
from crar_drake.errors import CrarError, WriteError


@dataclass(frozen=True)
class Result:
    """The square of a number, to the last bit, and words with quotes."""

    case: float
    square: float = float("nan")
    words: str = 'left, "hand"\n'
    error: str = ""


@pytest.fixture
def run(tmp_path):
    """Runs some numbers; those that were not there, and the results."""
    ran = []

    def square(case: float) -> Result:
        ran.append(case)
        if case < 0.0:
            raise ValueError("negative")
        return Result(case, case * case)

    def run(cases, pool=None, **settings):
        ran.clear()
        keep = dict(made_of="a", parse=lambda each: Result(**each)) | settings
        failed = lambda case, why: Result(case, error=why)  # noqa: E731
        path = tmp_path / "it" / "kept.json"
        results = run_cases(
            square, cases, path, nullcontext(pool), failed=failed, **keep
        )
        return list(ran), results

    return run


def test_what_is_finished_is_kept(run, tmp_path):
    cases = [0.1 + 0.2, 2.0, 2.0, 1.0 / 3.0]
    ran, results = run(cases)
    assert ran == [cases[i] for i in (0, 1, 3)] and [r.case for r in results] == ran
    again, same = run(cases)
    assert not again and same == results
    with ThreadPoolExecutor(2) as pool:
        more, _ = run([*cases, 7.0], pool)
    assert more == [7.0]
    path = tmp_path / "it" / "kept.json"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:1] + lines[2:]))  # a result is lost
    assert run(cases)[0] == cases[:1]


@pytest.mark.parametrize("text", ["name,age\nx,3\n", '{"made_of": "a"}', "[]", ""])
def test_what_are_no_results_stays(run, tmp_path, text):
    path = tmp_path / "it" / "kept.json"
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(CrarError, match="not a file of results; give another --out"):
        run([1.0])
    assert path.read_text() == text


def test_a_folder_is_refused_before_a_case_is_run(run, tmp_path):
    (tmp_path / "it" / "kept.json").mkdir(parents=True)
    with pytest.raises(WriteError, match="this is a folder"):
        run([1.0])


def test_what_is_of_something_else_is_run_again_and_kept_aside(run, tmp_path, capsys):
    run([1.0, 2.0])
    kept = (tmp_path / "it" / "kept.json").read_text()
    assert run([1.0, 2.0], made_of="b")[0] == [1.0, 2.0]
    old = tmp_path / "it" / "kept.old.json"
    assert old.read_text() == kept and f"now in {old}" in capsys.readouterr().err
    assert run([1.0], made_of="c")[0] == [1.0] and old.read_text() == kept
    assert '"made_of": "b"' in old.with_name("kept.old2.json").read_text()
    assert run([1.0, 2.0], made_of="b")[0] == [1.0, 2.0]
    whole = partial(lambda result: result.case == 1.0)
    assert run([1.0, 2.0], made_of="b", is_whole=whole)[0] == [2.0]


def test_a_case_that_fails_ends_no_run_and_is_tried_again(run):
    for _ in range(2):
        ran, results = run([-1.0, 3.0], made_of="c")
        assert -1.0 in ran and results[1].square == 9.0
        assert results[0].error == "ValueError: negative"


def test_the_digest_changes_with_a_source_and_with_settings(tmp_path):
    first = source_digest(tmp_path)
    assert source_digest(tmp_path) == first != source_digest(tmp_path, settings="s")
    (tmp_path / "law.py").write_text("x = 1\n")
    assert source_digest(tmp_path) != first
