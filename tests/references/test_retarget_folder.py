"""A folder of people's motions in, one of reference motions and a table out."""

import csv
import shutil
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest
from short_motions import short_amc
from small_reference_robots import reaching, write_csv, write_robot
from small_walker import walker

from crar_drake.commands import main
from crar_drake.errors import CrarError, MotionError
from crar_drake.motion.options import MotionOptions
from crar_drake.references import folders
from crar_drake.references.folders import find_references, work_through
from crar_drake.references.retarget_file import RetargetOptions, retarget_file

RATE = 15.0


class Here:
    """An executor that runs each call at once, and keeps the files asked for."""

    def __init__(self):
        self.files = []

    def submit(self, work, files, *rest):
        self.files += [path.name for path, _ in files]
        future = Future()
        try:
            future.set_result(work(files, *rest))
        except Exception as error:
            future.set_exception(error)
        return future


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    """The robot's folder, and one with two motions that can be read and two that
    cannot, beside what is no motion."""
    robot = tmp_path_factory.mktemp("walker")
    walker(robot)
    people = tmp_path_factory.mktemp("people")
    short_amc(people, "one")
    short_amc(people / "deep", "two", 46, "boxing")
    short_amc(people / "bare", "three")
    (people / "bare" / "three.asf").unlink()
    (people / "damaged.bvh").write_text("HIERARCHY\n")
    write_csv(people / "robot.csv", reaching(5, 30.0, 0.5))
    (people / "robot.certificate.json").write_text("{}")
    (people / "retargeted.csv").write_text("file,clip,error\n")
    return robot, people


def rows_of(out):
    with (out / "retargeted.csv").open(newline="") as stream:
        return {row["file"]: row for row in csv.DictReader(stream)}


def retarget(places, out, **options):
    robot, people = places
    pool = Here()
    jobs = options.pop("jobs", None)
    work = RetargetOptions(str(robot), **({"rate": RATE} | options))
    files = work_through(work, people, out, jobs=jobs, executor=pool)
    return files, sorted(pool.files)


def test_people_are_found_and_nothing_else(places, tmp_path, monkeypatch):
    work = RetargetOptions("")
    found = [str(path.relative_to(places[1])) for path in work.sources(places[1])]
    assert found == ["bare/three.amc", "damaged.bvh", "deep/two.amc", "one.amc"]
    monkeypatch.chdir(places[1])
    assert list(map(str, work.sources(Path(".")))) == found
    (tmp_path / "one.asf").write_text("")
    write_csv(tmp_path / "robot.csv", reaching(5, 30.0, 0.5))
    with pytest.raises(CrarError, match=r"no motions of people .*crar-drake clean"):
        work.sources(tmp_path)


def test_each_file_has_its_row_or_why_it_failed(places, tmp_path):
    robot, people = places
    files, _ = retarget(places, tmp_path / "out")
    assert [bool(file.error) for file in files] == [True, True, False, False]
    rows = rows_of(tmp_path / "out")
    assert "no skeleton lies beside" in rows["bare/three.amc"]["error"]
    assert "damaged.bvh" in rows["damaged.bvh"]["error"]
    motions = find_references(tmp_path / "out")
    assert [p.name for p in motions] == ["two.csv", "one.csv"]
    alone = retarget_file(people / "one.amc", tmp_path / "a.csv", str(robot), rate=RATE)
    (row,) = files[3].clips
    assert (tmp_path / "a.csv").read_bytes() == motions[1].read_bytes()
    assert row.frames == int(rows["one.amc"]["frames"]) == alone.frames == 8
    assert float(rows["one.amc"]["limbs_most"]) == alone.limbs_most == row.limbs_most
    assert rows["one.amc"]["farthest"] == alone.farthest and not row.violated
    page = (tmp_path / "out" / "retargeted.html").read_text()
    assert page.index("damaged.bvh") < page.index("deep/two.csv")
    assert f"<td>{np.degrees(alone.limbs_most):.1f}</td>" in page
    robot = ["--robot", str(robot)]
    assert main(["judge", str(tmp_path / "out"), *robot, "--certificate"]) == 0


def test_what_is_finished_in_the_same_way_is_not_done_again(
    places, tmp_path, monkeypatch
):
    out = tmp_path / "out"
    failing, all_of = ["damaged.bvh", "three.amc"], 4
    for options, count in (
        ({}, all_of),
        ({}, 2),
        ({"rate": 10.0}, all_of),
        ({"rate": 10.0, "person": MotionOptions(frame_rate=50.0)}, all_of),
        ({"rate": 10.0, "person": MotionOptions(frame_rate=50.0)}, 2),
    ):
        files, done = retarget(places, out, **options)
        assert len(done) == count and set(failing) <= set(done)
        assert [len(file.clips) for file in files] == [0, 0, 1, 1]
    # Another skeleton is another person.
    options = {"rate": 10.0, "person": MotionOptions(frame_rate=50.0)}
    asf = places[1] / "one.asf"
    before = asf.read_bytes()
    asf.write_bytes(before + b"\n")
    _, done = retarget(places, out, **options)
    asf.write_bytes(before)
    assert done == sorted([*failing, "one.amc"])
    # A batch that takes long gives back what it has.
    monkeypatch.setattr(folders, "_LONG", -1.0)
    files, done = retarget(places, tmp_path / "other", jobs=1)
    assert len(done) == 4 + 3 + 2 + 1 and len(files) == 4


def test_two_files_of_one_name_are_both_worked_on(places, tmp_path):
    people = tmp_path / "people"
    short_amc(people, "one")
    (people / "one.bvh").write_text("HIERARCHY\n")
    work = RetargetOptions(str(places[0]), rate=RATE)
    files = work_through(work, people, tmp_path / "out", executor=Here())
    assert not files[0].error and files[1].error.startswith(str(people / "one.bvh"))


def test_what_is_wrong_with_all_is_told_once(
    places, tmp_path, capsys, no_new_processes
):
    robot, people = places
    with pytest.raises(MotionError, match="there is no layout"):
        retarget(places, tmp_path / "out", layout="nonsense")
    with pytest.raises(CrarError, match="own folder, or below"):
        retarget(places, people / "out")
    legless = write_robot(tmp_path)
    arguments = ["retarget", str(people), "--out", str(tmp_path / "out")]
    assert main([*arguments, "--robot", str(legless), "--jobs", "1"]) == 2
    told = capsys.readouterr().err
    assert told.count("following a person needs the task_frames") == 1
    assert main(["retarget", "dance", "--robot", str(robot), "--jobs", "1"]) == 2
    assert "--jobs is for folders" in capsys.readouterr().err


def test_the_command_names_what_failed_and_continues(places, tmp_path, capsys):
    robot, people = places[0], tmp_path / "people"
    shutil.copytree(places[1], people)
    out = tmp_path / "out"
    arguments = ["retarget", str(people), "--robot", str(robot), "--out", str(out)]
    assert main([*arguments, "--rate", "15", "--jobs", "1"]) == 1
    said = capsys.readouterr()
    assert "2 motions, 20 frames: 0 violate something" in said.out
    assert said.out.endswith("VIOLATED: 2 files failed\n")
    failed = [line for line in said.err.splitlines() if line.startswith("failed:")]
    assert len(failed) == 2 and "three.amc" in failed[0] and "damaged" in failed[1]
    before = (out / "one.csv").stat().st_mtime_ns
    for path in (people / "bare" / "three.amc", people / "damaged.bvh"):
        path.unlink()
    assert main([*arguments, "--rate", "15", "--jobs", "1"]) == 0
    assert capsys.readouterr().out.endswith("OK\n")
    assert (out / "one.csv").stat().st_mtime_ns == before
