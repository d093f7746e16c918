"""The pages of docs/measurements say what their results do."""

import shutil
import subprocess

import pytest

from benchmarks import continuity, page
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
    assert render(page) == page.read_text(encoding="utf-8")
    assert read_parts(page)


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


@pytest.mark.parametrize("name", NAMES)
def test_all_that_is_kept_is_shown_and_listed(name):
    text = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    assert all(f"<!-- {part} -->\n" in text for part in read_parts(PAGES / name))
    assert f"({name}.md)" in (PAGES / "README.md").read_text(encoding="utf-8")


def test_a_run_comes_through_to_its_page(tmp_path, capsys, no_new_processes):
    page = tmp_path / "continuity.md"
    shutil.copy(PAGES / page.name, page)
    results_of(page).parent.mkdir()
    shutil.copy(results_of(PAGES / page.name), results_of(page))
    before = read_parts(page)
    continuity.main(
        ["--motion", "dance", "--duration", "0.05", "--jobs", "1", "--page", str(page)]
    )
    after = read_parts(page)
    assert after["no preview"] == before["no preview"]
    assert [row[0] for row in after["defaults"].tables[0].rows][-1] == "all"
    assert str(tmp_path) not in page.read_text(encoding="utf-8")
    assert render(page) == page.read_text(encoding="utf-8")
    assert "another manner" in capsys.readouterr().out


def test_a_run_is_dirty_by_code_and_not_by_pages(tmp_path, monkeypatch):
    for name, path in (("ROOT", tmp_path), ("PAGES", tmp_path / "pages")):
        monkeypatch.setattr(page, name, path)
    code, written = tmp_path / "code.py", tmp_path / "pages" / "speed.md"
    written.parent.mkdir()
    for each in (code, written):
        each.write_text("before")
    for words in ("init -q", "add .", "-c user.name=a -c user.email=b commit -qm c"):
        subprocess.run(["git", *words.split()], cwd=tmp_path, check=True)
    written.write_text("after")
    assert not page.version_line().endswith("-dirty")
    code.write_text("after")
    assert page.version_line().endswith("-dirty")


def test_the_page_is_looked_for_before_anything_is_run(tmp_path):
    with pytest.raises(CrarError, match=r"none\.md"):
        continuity.main(["--page", str(tmp_path / "none.md")])


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
