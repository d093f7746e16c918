"""The table of robots: what is kept of a trial, and the page that is made of it."""

import json
from dataclasses import asdict

import pytest

from benchmarks.robots import __main__ as command
from benchmarks.robots import verdicts
from benchmarks.robots.catalogue import SUBJECTS, Subject, folder_name
from benchmarks.robots.page import tables, told
from benchmarks.robots.trial import RESULT, SEVEN, TOOL, Outcome, load_outcome
from benchmarks.robots.verdicts import VERDICTS, Verdict

DANCER = Outcome(
    imported=True,
    task=SEVEN,
    duration=4.0,
    size=1.2,
    error=0.06,
    capsules=0.005,
    meshes=-0.002,
    meshes_penetrating=3,
    mesh_samples=80,
    mesh_pairs=[["hip", "hand"], ["head", "hand"], ["foot", "hand"]],
    at_top_speed=0.25,
    samples=800,
    warnings=["pairs: some", "facing: some"],
)


def cells(text: str, name: str) -> list[str]:
    (line,) = [line for line in text.splitlines() if line.startswith(f"| {name} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_the_page():
    dancer, arm, lame = SUBJECTS[0], SUBJECTS[13], SUBJECTS[-1]
    outcomes = [
        (dancer, DANCER),
        (arm, Outcome(task=TOOL, size=0.5, error=0.001, samples=100)),
        (lame, Outcome(why="it has no arms")),
    ]
    found = told(outcomes)
    text = "".join(table.markdown() for table in tables(outcomes))
    assert "3 were tried. 2 of these ran, 1 the dance and 1 an arm" in found
    assert "1 without any violation" in found
    assert "pictures of 0 dancers were looked at: 0 dance recognisably, 0" in found
    row = cells(text, dancer.name)
    assert row[2:4] == ["seven points", "not looked at"] and row[5:10] == [
        "60 mm",
        "5 %",
        "5.0 mm",
        "-2.0 mm",
        "meshes 3 of 80, hip and hand; head and hand; 1 more",
    ]
    assert row[10:] == ["25 %", "2"]
    assert cells(text, arm.name)[4:] == ["1 mm", "0 %", "–", "–", "0", "–", "–"]
    assert cells(text, lame.name)[-1] == "it has no arms"
    assert f"Not tried: {SUBJECTS[1].name}" in found


def test_a_verdict_is_of_the_run_that_was_looked_at(monkeypatch):
    seen = {SUBJECTS[0].name: Verdict(0.061), SUBJECTS[1].name: Verdict(0.08)}
    monkeypatch.setattr(verdicts, "VERDICTS", seen)
    outcomes = [(SUBJECTS[0], DANCER), (SUBJECTS[1], DANCER)]
    text = "".join(table.markdown() for table in tables(outcomes))
    assert [cells(text, s.name)[3] for s in SUBJECTS[:2]] == ["yes", "not looked at"]
    # Meshes penetrate, capsules do not.
    looked_at = "pictures of 1 dancers were looked at: 1 dance recognisably, 1 of"
    assert looked_at in told(outcomes)


def test_every_verdict_is_of_a_robot():
    assert set(VERDICTS) <= {subject.name for subject in SUBJECTS}


def test_what_has_a_result_is_not_tried_again(tmp_path, monkeypatch, capsys):
    subject = Subject("Some robot", "no-such-package", "robot.urdf", "arm")
    known = SUBJECTS[0]
    monkeypatch.setattr(command, "SUBJECTS", [subject, known])
    monkeypatch.setattr(Subject, "path", lambda s: None if s is subject else tmp_path)
    folder = tmp_path / folder_name(known)
    folder.mkdir()
    (folder / RESULT).write_text(json.dumps(asdict(DANCER)))
    assert load_outcome(folder) == DANCER and load_outcome(tmp_path) is None
    command.main(["--out", str(tmp_path)])
    shown = capsys.readouterr().out
    assert "the package no-such-package is not installed" in shown
    assert cells(shown, known.name)[5].startswith("60 mm")


def test_unknown_names_are_refused(capsys):
    with pytest.raises(SystemExit):
        command.main(["--only", "Nobody"])
    assert "no robot 'Nobody'; there are: G1;" in capsys.readouterr().err


def test_folders_are_apart():
    names = [folder_name(subject) for subject in SUBJECTS]
    assert len(set(names)) == len(names)
