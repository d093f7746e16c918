"""All files of a folder worked on in parallel; what was stopped continues.

What is to be done with each file is a `FolderWork`: it writes a motion with its
certificate (`motion_certificate`), and has a line in one table for each motion.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from crar_drake.errors import CrarError
from crar_drake.files import sole_writer, whole_file
from crar_drake.motion.robots_own import is_reference
from crar_drake.references.certificate_files import (
    certificate_path,
    file_hash,
    read_certificate,
    robot_files,
)
from crar_drake.references.each_file import FileResult, Work, each_file
from crar_drake.references.folder_page import Figure, PageRow, write_folder_page
from crar_drake.robot.description import load_robot_description

CLEANED_TABLE, RETARGETED_TABLE = "cleaned.csv", "retargeted.csv"
# How their heading begins.
_FIRST_COLUMNS = ("file", "clip", "error")

# Names of files need not be text.
_ANY_NAME = "surrogateescape"

_CONVERSIONS = {"int": int, "float": float, "str": str}


@dataclass(frozen=True)
class FolderWork:
    """What is to be done with the files of a folder."""

    folder: Path  # that they are in, or below
    table: Path  # a CSV in another folder, which what is written is in, or below
    # of it: a dataclass whose fields are numbers and texts, `clip` among them
    row: type
    # each file to that which is to be written of it, or `apart` from it
    places: Mapping[Path, Path]
    begin: Callable[[], Work]  # from a file and its place to its rows (`each_file`)
    # of a row, for the page; the first one says which motion is the worst
    figures: Sequence[Figure]
    note: Callable[[Any], str]  # what else the page says of a row
    robot: str  # name or folder of the robot
    parameters: dict  # what certificates have of them, if nothing is to be done again,
    options: Callable[[Path], dict]  # and of a file's options
    # what a row becomes that was kept of a file that is not done again
    again: Callable[[Any], Any] = lambda row: row


def find_references(folder: Path) -> list[Path]:
    """Files in a folder and below that may be robot motions, in order of their names;
    tables of such folders are none.

    Raises:
        CrarError: there is none.
    """
    found = sorted(
        path
        for path in folder.rglob("*")
        if is_reference(path) and path.is_file() and not is_table(path)
    )
    if not found:
        raise CrarError(f"{folder}: no robot motions (.csv, .npz, .pkl) in it or below")
    return found


def references_in(paths: Iterable[Path]) -> list[Path]:
    """Files, and those in folders and below, each once.

    Raises:
        CrarError: a folder has none (`find_references`).
    """
    found: list[Path] = []
    for path in paths:
        found += find_references(path) if path.is_dir() else [path]
    return list(dict.fromkeys(found))


def is_table(path: Path) -> bool:
    """Whether a file is the table of a folder that was worked on."""
    if path.name not in (CLEANED_TABLE, RETARGETED_TABLE):
        return False
    start = ",".join(_FIRST_COLUMNS).encode()
    try:
        with path.open("rb") as file:
            return file.read(len(start)) == start
    except OSError:  # whoever reads it says why
        return False


def work_through(
    work: FolderWork,
    *,
    jobs: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int, FileResult], None] | None = None,
) -> list[FileResult]:
    """Does the work on each file of a folder, and writes the table, and in the end a
    page beside it (`page_of`).

    A file whose certificate is there, of the same file, robot, parameters and options,
    is not done again.

    Args:
        work: what is to be done.
        jobs, executor: as of `each_file`.
        progress: is called with (finished, all, newest).

    Raises:
        ModelError: there is no such robot, or it cannot be used.
        CrarError: the table's folder is the files' own or below it, or another process
            is writing to it. What is wrong with one file is reported of it, and is not
            fatal.
    """
    work = replace(work, places=apart(work.places))
    table, out = work.table, work.table.parent
    if out.resolve().is_relative_to(work.folder.resolve()):
        # What is written would be taken for a motion the next time.
        raise CrarError(
            f"{out}: is the motions' own folder, or below it; name another (--out)"
        )
    files = robot_files(load_robot_description(work.robot))
    with sole_writer(table):
        kept = _read_table(table, work.folder, work.row)
        finished = {
            path: FileResult(path, tuple(map(work.again, kept[path].clips)))
            for path, place in work.places.items()
            if path in kept and _is_done(work, path, place, files)
        }
        waiting = [pair for pair in work.places.items() if pair[0] not in finished]
        results = each_file(waiting, work.begin, jobs=jobs, executor=executor)
        with closing(results):
            for result in results:
                finished[result.source] = result
                _write_table(work, finished)
                if progress is not None:
                    progress(len(finished), len(work.places), result)
        _write_table(work, finished)
        _write_page(work, finished)
    return [finished[path] for path in work.places]


def page_of(table: Path) -> Path:
    """Where the page of a table is."""
    return table.with_suffix(".html")


def _write_page(work: FolderWork, files: Mapping[Path, FileResult]) -> None:
    page = page_of(work.table)
    write_folder_page(
        page,
        f"{work.folder.absolute().name}: {page.stem}",
        f"Robot {work.robot}. A click on a heading sorts by it; crar-drake show "
        "makes a page of two motions.",
        work.figures,
        [
            PageRow(path, work.places[path], clip, result.error or work.note(clip))
            for path, result in files.items()
            for clip in result.clips or [None]
        ],
    )


def apart(places: Mapping[Path, Path]) -> dict[Path, Path]:
    """Places of files, none of which has another's certificate: walk.bvh beside
    walk.npz becomes walk-npz.csv beside walk.csv."""
    taken: set[Path] = set()
    found = {}
    for source, out in sorted(places.items()):
        suffix = source.suffix[1:].lower()
        while certificate_path(out) in taken:
            out = out.with_stem(f"{out.stem}-{suffix}")
        taken.add(certificate_path(out))
        found[source] = out
    return found


def _is_done(work: FolderWork, source: Path, out: Path, robot: dict[str, str]) -> bool:
    """Whether a file was done before, for the same robot (`robot_files`) and in the
    same way."""
    try:
        certificate = read_certificate(certificate_path(out))
        return (
            certificate["reference"]["sha256"] == file_hash(source)
            and certificate["motion"]["sha256"] == file_hash(out)
            and certificate["parameters"] == work.parameters
            and certificate["options"] == work.options(source)
            and certificate["robot"]["files"] == robot
        )
    except (CrarError, KeyError, TypeError, OSError):
        return False


# --- the table --------------------------------------------------------------------


def _columns(row: type) -> dict[str, Callable[[str], Any]]:
    """Name of each column but the first ones to what converts it: numbers first, and of
    these the row's own before those that it inherits."""
    kinds = {field.name: field.type for field in fields(row)}
    own = [name for name in kinds if name in row.__annotations__]
    names = [*own, *(name for name in kinds if name not in own)]
    names.sort(key=lambda name: kinds[name] == "str")
    return {
        name: _CONVERSIONS[kinds[name]] for name in names if name not in _FIRST_COLUMNS
    }


def _write_table(work: FolderWork, files: Mapping[Path, FileResult]) -> None:
    names = list(_columns(work.row))
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*_FIRST_COLUMNS, *names])
    for path in sorted(files):
        name, result = path.relative_to(work.folder), files[path]
        if result.error:
            writer.writerow([name, "", result.error, *("" for _ in names)])
        for clip in result.clips:
            writer.writerow([name, clip.clip, "", *(getattr(clip, n) for n in names)])
    with whole_file(work.table) as temporary:
        temporary.write_text(stream.getvalue(), "utf-8", _ANY_NAME)


def _read_table(table: Path, folder: Path, row: type) -> dict[Path, FileResult]:
    """Files that did not fail; none if there is no table, or one of other columns.

    A file of which a row is damaged is done again.
    """
    if not os.path.isfile(table):
        return {}
    columns = _columns(row)
    with open(table, newline="", encoding="utf-8", errors=_ANY_NAME) as stream:
        reader = csv.DictReader(stream)
        if tuple(reader.fieldnames or ()) != (*_FIRST_COLUMNS, *columns):
            return {}
        try:
            rows = list(reader)
        except csv.Error:  # a field of 130 kB
            return {}
    files: dict[Path, FileResult] = {}
    damaged: set[Path] = set()
    for each in rows:
        if each["error"]:
            continue
        path = folder / each["file"]
        try:
            values = {name: of(each[name]) for name, of in columns.items()}
        except (TypeError, ValueError):  # no number, or none there
            damaged.add(path)
            continue
        before = files[path].clips if path in files else ()
        files[path] = FileResult(path, (*before, row(clip=each["clip"], **values)))
    return {path: file for path, file in files.items() if path not in damaged}
