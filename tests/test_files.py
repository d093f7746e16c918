"""Files that appear whole, places that cannot be written, and locks that end."""

import multiprocessing
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from crar_drake.errors import CrarError, WriteError
from crar_drake.files import (
    check_file,
    check_folder,
    sole_writer,
    turn_to_write,
    whole_file,
    whole_set,
)

WAIT = 300.0  # [s] longer than any process here needs, also on a busy computer

HOLDER = """
import sys, time
from crar_drake.files import sole_writer, turn_to_write
which, path = sys.argv[1:]
with {"sole": sole_writer, "turn": turn_to_write}[which](path):
    print("held", flush=True)
    sys.stdin.readline()
"""


@pytest.fixture
def hold():
    """Starts processes that hold a lock till they are told or killed."""
    processes = []

    def start(which: str, path: Path) -> subprocess.Popen:
        process = subprocess.Popen(
            [sys.executable, "-c", HOLDER, which, str(path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        assert process.stdout.readline() == "held\n"
        return process

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def test_a_file_that_fails_leaves_no_trace(tmp_path):
    with pytest.raises(WriteError, match="c.txt: could not be written: No space left"):
        with whole_file(tmp_path / "a/b/c.txt") as temporary:
            temporary.write_text("half")
            with open("/dev/full", "w") as full:  # the system's own error
                full.write("x")
    assert list(tmp_path.iterdir()) == [], "nor the folders made for it"

    (tmp_path / "a").mkdir()
    with pytest.raises(ZeroDivisionError):
        with whole_file(tmp_path / "a/b/c.txt"):
            raise ZeroDivisionError
    assert list(tmp_path.rglob("*")) == [tmp_path / "a"], "it was there before"

    with whole_file(tmp_path / "a/b/c.txt") as temporary:
        temporary.write_text("whole")
    assert (tmp_path / "a/b/c.txt").read_text() == "whole"
    assert [path.name for path in (tmp_path / "a/b").iterdir()] == ["c.txt"]


def test_places_that_cannot_be_written_are_known_before(tmp_path):
    check_folder(tmp_path / "not/there/yet")
    check_file(tmp_path / "not/there/yet.txt")
    (tmp_path / "file").write_text("")
    check_file(tmp_path / "file")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]

    with pytest.raises(WriteError, match="file is a file; name another folder"):
        check_folder(tmp_path / "file/below")
    with pytest.raises(WriteError, match="this is a folder; name a file"):
        check_file(tmp_path)
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(WriteError, match="link is a link to nothing"):
        check_folder(tmp_path / "link")
    with pytest.raises(WriteError, match="may not be written to"):
        check_folder(tmp_path / ("long" * 100))


def test_a_folder_without_permission_is_known_before(tmp_path):
    if os.geteuid() == 0:
        folder = Path("/proc/self")  # where not even root may make files
        if not folder.exists():
            pytest.skip("root may write everywhere here")
    else:
        folder = tmp_path / "locked"
        folder.mkdir(mode=0o555)
    with pytest.raises(WriteError, match="may not be written to"):
        check_folder(folder / "below")
    with pytest.raises(WriteError, match="may not be written to"):
        check_file(folder / "below.txt")
    with pytest.raises(WriteError, match="below.txt: could not be written"):
        with whole_file(folder / "below.txt"):
            pass


@pytest.mark.parametrize("end", ["told", "killed"])
def test_only_one_process_writes_and_the_other_one_is_named(tmp_path, hold, end):
    out = tmp_path / "deep/results.csv"
    process = hold("sole", out)
    with pytest.raises(CrarError, match=rf"results.csv: process {process.pid} on "):
        with sole_writer(out):
            pytest.fail("two at once")
    with sole_writer(tmp_path / "deep/other.csv"):
        pass  # another file is free
    if end == "told":
        process.communicate("go\n", timeout=WAIT)
        assert process.returncode == 0
    else:  # its file stays, and must lock nothing
        process.kill()
        process.wait(WAIT)
    with sole_writer(out):
        pass
    assert list((tmp_path / "deep").iterdir()) == [], "the lock leaves no file"


def _count(folder: str, times: int) -> None:
    counter = Path(folder, "counter")
    while times:
        try:
            with sole_writer(counter):
                value = int(counter.read_text())
                counter.write_text(f"{value + 1:06d}")
        except CrarError:
            continue
        times -= 1


def test_the_lock_holds_while_many_come_and_go(tmp_path):
    """Reading and writing a counter loses counts if ever two do it at once."""
    (tmp_path / "counter").write_text("0")
    spawn = multiprocessing.get_context("spawn")
    processes = [
        spawn.Process(target=_count, args=(str(tmp_path), 80)) for _ in range(3)
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join(WAIT)
        assert process.exitcode == 0
    assert int((tmp_path / "counter").read_text()) == 240
    assert [path.name for path in tmp_path.iterdir()] == ["counter"]


def test_a_set_of_files_is_written_in_turn(tmp_path, hold):
    process = hold("turn", tmp_path / "run")
    entered = threading.Event()

    def write() -> None:
        with turn_to_write(tmp_path / "run"):
            entered.set()

    thread = threading.Thread(target=write)
    thread.start()
    assert not entered.wait(0.3)
    process.communicate("go\n", timeout=WAIT)
    assert entered.wait(WAIT)
    thread.join(WAIT)
    assert list((tmp_path / "run").iterdir()) == []


def test_a_set_of_files_appears_whole_or_not_at_all(tmp_path):
    folder = tmp_path / "a" / "b"
    with pytest.raises(RuntimeError), whole_set(folder) as made:
        (made / "one.txt").write_text("1")
        raise RuntimeError
    assert not (tmp_path / "a").exists()
    folder.mkdir(parents=True)
    (folder / "kept.txt").write_text("kept")
    (folder / "one.txt").write_text("old")
    with whole_set(folder, "last.txt") as made:
        (made / "below").mkdir()
        (made / "below" / "two.txt").write_text("2")
        (made / "one.txt").write_text("1")
        (made / "last.txt").write_text("3")
        assert (folder / "one.txt").read_text() == "old"
    found = {p.name: p.read_text() for p in folder.rglob("*") if p.is_file()}
    assert found == {
        "kept.txt": "kept",
        "one.txt": "1",
        "two.txt": "2",
        "last.txt": "3",
    }


def test_an_extra_is_installed_from_the_checkout_where_there_is_one(monkeypatch):
    from crar_drake import resources

    command = resources.install_command("robots")
    checkout = Path(command.removeprefix("pip install '").partition("[")[0])
    assert (checkout / "pyproject.toml").is_file() and command.endswith("[robots]'")
    monkeypatch.setattr(resources, "_PACKAGE", Path("/nowhere/crar_drake"))
    assert resources.install_command("c3d") == "pip install 'crar-drake[c3d]'"
