"""The measurement of compiled arithmetic: its table, its page, its refusals."""

import pytest

from crar_drake.errors import CrarError
from crar_drake.experiments import compiled_speed
from crar_drake.experiments.bench_report import text_of_page
from crar_drake.experiments.compiled_speed import HEADING, main, renewed

MODES = ("paper", "lookahead")

PAGE = f"# Speed\n\ntext\n\n{HEADING}\n\nold\n\n## One run\n\nothers\n"


def test_it_measures_and_renews_its_part_of_the_page(tmp_path, monkeypatch, capsys):
    pytest.importorskip("numba")
    monkeypatch.setattr(compiled_speed, "EXPERIMENTS", ["wrists"])
    page = tmp_path / "speed.md"
    page.write_text(PAGE)
    assert main(["--duration", "0.03", "--markdown", str(page)]) == 0
    text = page.read_text()
    before, after = text.split(HEADING)
    assert before == "# Speed\n\ntext\n\n"
    assert after.endswith("\n\n## One run\n\nothers\n")
    assert "old" not in text
    for order in ("In a row", "By turns"):
        assert f"{order}:" in after
    for mode in MODES:
        assert after.count(f"| wrists, {mode} | ") == 4
    assert "In a row:" in capsys.readouterr().out
    # The other command's tables leave this part alone.
    assert text_of_page(page) + "## One run\n\nothers\n" == text


def test_without_numba_it_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(compiled_speed, "HAS_NUMBA", False)
    page = tmp_path / "speed.md"
    page.write_text(PAGE)
    assert main(["--markdown", str(page)]) == 2
    assert "pip install 'crar-drake[compiled]'" in capsys.readouterr().err
    assert page.read_text() == PAGE


def test_answers_that_differ_are_an_error_not_a_figure(monkeypatch):
    monkeypatch.setattr(compiled_speed, "LARGEST_DIFFERENCE", -1.0)
    with pytest.raises(CrarError, match="wrists, paper: the compiled answers differ"):
        compiled_speed.measure("dance", 0.01, "wrists", "paper")


def test_a_page_without_the_heading_is_left_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(compiled_speed, "HAS_NUMBA", True)
    page = tmp_path / "speed.md"
    page.write_text("# Something else\n")
    assert main(["--markdown", str(page)]) == 2
    assert f"{page}: it has no line '{HEADING}'" in capsys.readouterr().err
    assert page.read_text() == "# Something else\n"
    assert renewed(f"{HEADING}\n", "text\n") == f"{HEADING}\n\ntext\n"
