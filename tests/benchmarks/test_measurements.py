"""The pages of docs/measurements say what their results do."""

import subprocess

import pytest

from benchmarks import recovery
from benchmarks.page import (
    PAGES,
    Part,
    Table,
    read_parts,
    render,
    results_of,
    write_part,
)
from crar_drake.errors import CrarError

NAMES = sorted(p.stem for p in PAGES.glob("*.md") if p.stem != "README")
PART = Part("a command", "a machine", "a law", [Table(["a"], [["1"]], "b")], "Found.")


@pytest.mark.parametrize("name", NAMES)
def test_a_page_is_what_its_results_make_of_it(name):
    page = PAGES / f"{name}.md"
    text, parts = page.read_text(encoding="utf-8"), read_parts(page)
    assert parts and render(page) == text
    assert all(f"<!-- {part} -->\n" in text for part in parts)
    assert f"({name}.md)" in (PAGES / "README.md").read_text(encoding="utf-8")


def test_a_page_leaves_out_what_the_results_keep():
    """A command runs as it stands; of a machine stays what durations depend on."""
    machine = "a processor, 2 cores; threads of BLAS 1; Python 3, NumPy 2; pink 4"
    command = "python -m b some_robot cmu:05_02 cmu:13_17 --n 1 --page docs/b.md"
    text = Part(command, machine, "crar_drake 0.1.0, commit 12ab", []).markdown()
    shown, about = text.split("\n\n")
    assert about == "a processor, 2 cores; pink 4. Commit 12ab.\n"
    done = subprocess.run(
        ["bash", "-c", f"python() {{ echo python $@; }}\n{shown}"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert f"{done.stdout.strip()} --page docs/b.md" == command


def test_the_page_is_looked_for_before_anything_is_run(tmp_path):
    with pytest.raises(CrarError, match=r"none\.md"):
        recovery.main(["--page", str(tmp_path / "none.md")])


def test_a_part_without_a_place_or_without_results_is_refused(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# Page\n\n<!-- here -->\n<!-- end -->\n")
    with pytest.raises(CrarError, match="no results of 'here'"):
        render(page)
    write_part(page, "here", PART)
    with pytest.raises(CrarError, match="elsewhere"):
        write_part(page, "elsewhere", PART)
    assert "    a command\n\nFound.\n\na machine. a law.\n\n### b\n" in page.read_text()
    results_of(page).write_text("{")
    with pytest.raises(CrarError, match="not the results"):
        render(page)
