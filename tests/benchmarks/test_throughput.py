"""The throughput of a folder is of what was written, and comes to its page."""

import shutil

import pytest
from short_motions import short_amc
from small_reference_robots import reaching, write_csv, write_robot
from small_walker import walker

from benchmarks import throughput
from benchmarks.page import PAGES, read_parts, results_of
from crar_drake.errors import CrarError


def test_what_is_counted_is_what_was_written(tmp_path, capsys):
    folder, page = tmp_path / "motions", tmp_path / "throughput.md"
    folder.mkdir()
    robot = write_robot(tmp_path)
    for name, frames in (("a", 24), ("b", 31)):
        write_csv(folder / f"{name}.csv", reaching(frames, 30.0, 0.5))
    (folder / "bad.csv").write_text("1,2\n")
    shutil.copy(PAGES / page.name, page)
    results_of(page).parent.mkdir()
    shutil.copy(results_of(PAGES / page.name), results_of(page))
    arguments = [str(folder), "--robot", str(robot), "--jobs", "2"]
    throughput.main([*arguments, "--page", str(page)])
    part = read_parts(page)["clean"]
    row = dict(zip(part.tables[0].columns, part.tables[0].rows[0], strict=True))
    assert (row["clips"], row["frames"], row["processes"]) == ("2", "55", "2")
    assert row["of motion"] == f"{(23 + 30) / 30.0:.1f} s"
    processor = float(row["processor time"].split()[0])
    assert float(row["frames / s and core"]) == pytest.approx(55 / processor, rel=0.05)
    assert float(row["peak memory of a process"].split()[0]) > 100.0
    assert part.found == "1 files could not be done."
    assert "1 files could not be done." in capsys.readouterr().out
    assert sorted(p.name for p in folder.iterdir()) == ["a.csv", "b.csv", "bad.csv"]


def test_people_are_retargeted(tmp_path, no_new_processes):
    folder = tmp_path / "people"
    short_amc(folder, "one", 7)
    robot = tmp_path / "walker"
    robot.mkdir()
    walker(robot)
    row, failed = throughput.measure("retarget", folder, str(robot), 1)
    assert (row["clips"], row["frames"], failed) == ("1", "4", 0)
    assert row["of motion"] == "0.1 s"
    assert 0 <= int(row["solving, of all"].rstrip("%")) < 100


def test_a_folder_of_which_nothing_can_be_done_is_told(tmp_path, no_new_processes):
    (tmp_path / "motions").mkdir()
    (tmp_path / "motions" / "bad.csv").write_text("1,2\n")
    robot = write_robot(tmp_path)
    with pytest.raises(CrarError, match="no file could be done.*bad.csv"):
        throughput.measure("clean", tmp_path / "motions", str(robot), 1)
