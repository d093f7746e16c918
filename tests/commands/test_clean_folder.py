"""What `clean` says of a folder, and `judge` of what it left there."""

import csv
from dataclasses import replace

import pytest
from small_reference_robots import reaching, write_csv, write_robot

from crar_drake.commands import main
from crar_drake.references.clean_file import CleanOptions
from crar_drake.references.folders import FileResult, find_references, work_through


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    robot = tmp_path_factory.mktemp("robot")
    references = tmp_path_factory.mktemp("references")
    write_robot(robot)
    write_csv(references / "a.csv", reaching(24, 30.0, 1.0))
    write_csv(references / "b.csv", reaching(20, 30.0, 0.9))
    return robot, references, robot / "out"


def test_a_cleaned_folder_is_judged_without_its_table(folders, capsys):
    robot, references, out = map(str, folders)
    arguments = ["--robot", robot]
    assert main(["clean", references, *arguments, "--out", out, "--jobs", "1"]) == 0
    said = capsys.readouterr().out
    assert "2 motions: capsules penetrated in 1 and do in 0" in said
    assert (folders[2] / "cleaned.csv").is_file()
    assert main(["judge", out, *arguments, "--certificate"]) == 0
    assert capsys.readouterr().out.count("nothing refutes it") == 2
    main(["judge", out, *arguments, "--jobs", "1"])
    said = capsys.readouterr().out
    assert "2 motions" in said and "0 files cannot be used" in said


def test_what_is_still_violated_is_told_with_its_file(folders, monkeypatch, capsys):
    robot, references, out = folders
    files = work_through(CleanOptions(str(robot)), references, out, jobs=1)
    (clip,) = files[1].clips
    files[1] = FileResult(files[1].source, (replace(clip, penetrating=3),))
    where = "crar_drake.references.folders.work_through"
    monkeypatch.setattr(where, lambda *arguments, **options: files)
    arguments = ["clean", str(references), "--robot", str(robot), "--out", str(out)]
    assert main(arguments) == 1
    lines = capsys.readouterr().out.splitlines()
    assert f"violated: {references / 'b.csv'}: 3 frames penetrate" in lines
    assert not any("a.csv" in line for line in lines)
    assert lines[-1] == "VIOLATED: 3 frames penetrate"


def test_what_changed_by_more_is_named_and_nothing_is_cleaned_again(
    folders, tmp_path, capsys, no_new_processes
):
    robot, references, _ = map(str, folders)
    out = tmp_path / "out"
    arguments = ["clean", references, "--robot", robot, "--out", str(out)]
    assert main([*arguments, "--jobs", "1"]) == 0
    times = {path: path.stat().st_mtime_ns for path in out.glob("?.c*")}
    assert len(times) == 4
    capsys.readouterr()
    assert main([*arguments, "--at-most", "joints=0.1deg"]) == 1
    said = capsys.readouterr().out
    assert "VIOLATED: 1 motion changed by more than is allowed" in said
    (named,) = [line for line in said.splitlines() if line.startswith("violated:")]
    assert "a.csv: changed: joints by " in named
    assert times == {path: path.stat().st_mtime_ns for path in times}
    with (out / "cleaned.csv").open(newline="") as stream:
        rows = {row["file"]: row for row in csv.DictReader(stream)}
    page = (out / "cleaned.html").read_text()
    assert page.index("a.csv") < page.index("b.csv") and ">violated<" in page
    assert rows["a.csv"]["exceeded"] in named and not rows["b.csv"]["exceeded"]
    assert main([*arguments, "--frames", "3:", "--jobs", "1"]) == 0
    assert len((out / "a.csv").read_text().splitlines()) == 22


def test_a_table_is_no_motion_and_a_motion_of_its_name_is_one(tmp_path):
    (tmp_path / "deep").mkdir()
    write_csv(tmp_path / "a.csv", reaching(5, 30.0, 0.5))
    for name in ("cleaned.csv", "retargeted.csv"):
        (tmp_path / name).write_text("file,clip,error,frames\n")
        write_csv(tmp_path / "deep" / name, reaching(5, 30.0, 0.5))
    (tmp_path / "other.csv").write_text("file,clip,error,frames\n")  # who knows
    found = [str(p.relative_to(tmp_path)) for p in find_references(tmp_path)]
    deep = ["deep/cleaned.csv", "deep/retargeted.csv"]
    assert found == ["a.csv", *deep, "other.csv"]


def test_without_a_terminal_each_file_has_a_line(tmp_path, capsys):
    robot, references = write_robot(tmp_path), tmp_path / "references"
    references.mkdir()
    write_csv(references / "a.csv", reaching(24, 30.0, 0.5))
    (references / "b.csv").write_text("1,2\n")
    arguments = ["clean", str(references), "--robot", str(robot), "--jobs", "1"]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert sorted(line for line in lines if " of 2: " in line) == [
        "1 of 2: a.csv",
        "2 of 2: b.csv failed",
    ]
