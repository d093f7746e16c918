"""What `clean` says of a folder, and `judge` of what it left there."""

from dataclasses import replace

import pytest
from small_reference_robots import reaching, write_csv, write_robot

from crar_drake.commands import main
from crar_drake.references.clean_folder import CleanedFile, clean_folder


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
    files = clean_folder(references, out, str(robot), jobs=1)
    (clip,) = files[1].clips
    files[1] = CleanedFile(files[1].reference, (replace(clip, penetrating=3),))
    where = "crar_drake.references.clean_folder.clean_folder"
    monkeypatch.setattr(where, lambda *arguments, **options: files)
    arguments = ["clean", str(references), "--robot", str(robot), "--out", str(out)]
    assert main(arguments) == 1
    lines = capsys.readouterr().out.splitlines()
    assert f"violated: {references / 'b.csv'}: 3 frames penetrate" in lines
    assert not any("a.csv" in line for line in lines)
    assert lines[-1] == "VIOLATED: 3 frames penetrate"
