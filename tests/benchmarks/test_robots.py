"""The table of robots: what is kept of a trial, and the page that is made of it."""

import json
from dataclasses import asdict

from benchmarks.robots import __main__ as command
from benchmarks.robots.catalogue import SUBJECTS, Subject, folder_name
from benchmarks.robots.page import tables, told
from benchmarks.robots.trial import RESULT, SEVEN, TOOL, Outcome, load_outcome

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
