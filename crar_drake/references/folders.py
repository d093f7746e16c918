"""All files of a folder worked on in parallel; what was stopped continues.

What is done with each file is an `Operation`: it writes a motion with its certificate,
and has a line in one table for each motion. A bad file spoils no other.
"""

from __future__ import annotations

import csv
import io
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crar_drake.errors import CrarError, NoMotionError
from crar_drake.files import sole_writer, whole_file
from crar_drake.fresh_processes import given_or_fresh, in_batches
from crar_drake.motion.robots_own import is_reference
from crar_drake.references.certificate_files import (
    certificate_path,
    file_hash,
    read_certificate,
    robot_files,
)
from crar_drake.references.folder_page import PageRow, write_folder_page
from crar_drake.robot.description import load_robot_description

if TYPE_CHECKING:
    from crar_drake.references.pipeline import Operation

TABLES = ("cleaned.csv", "retargeted.csv")
# How their heading begins.
_FIRST_COLUMNS = ("file", "clip", "error")

# Names of files need not be text.
_ANY_NAME = "surrogateescape"

_CONVERSIONS = {"int": int, "float": float, "str": str}

# A process that has worked for so long gives back what it has [s].
_LONG = 60.0


# --- each file by itself ----------------------------------------------------------


@dataclass(frozen=True)
class FileResult:
    """What became of one file."""

    source: Path  # the file
    clips: tuple[Any, ...] = ()  # of its motions, one each; none if it failed
    error: str = ""  # why it failed, with its name; "" if it did not
    skipped: bool = False  # whether it did not fail: it holds no motion


# From a file, and perhaps its place, to what became of each of its motions.
Work = Callable[..., Sequence[Any]]


def each_file(
    files: Iterable[Sequence[Any]],
    begin: Callable[[], Work],
    *,
    jobs: int | None = None,
    executor: Executor | None = None,
) -> Iterator[FileResult]:
    """Yields what became of each file, as they are done.

    Args:
        files: each with what its work is called with besides.
        begin: makes what a process does with each file; it is sent to other processes.
        jobs: number of processes; by default one per core.
        executor: any `concurrent.futures` executor; by default such processes.

    Raises:
        CrarError: `begin` did.
    """
    with given_or_fresh(executor, jobs) as pool:
        batches = in_batches(pool, _do_some, tuple(files), begin, jobs=jobs)
        with closing(batches):
            for (source, *_), result in batches:
                died = isinstance(result, Exception)  # its process did
                yield _failed(source, str(result)) if died else result


def _do_some(
    files: Sequence[Sequence[Any]], begin: Callable[[], Work]
) -> list[FileResult]:
    """Files one after the other in a process of its own; the first ones alone if they
    took long, for others to have them soon."""
    work, until, found = begin(), time.monotonic() + _LONG, []
    for source, *rest in files:
        try:
            result = FileResult(source, tuple(work(source, *rest)))
        except NoMotionError as error:
            result = replace(_failed(source, str(error)), skipped=True)
        except CrarError as error:
            result = _failed(source, str(error))
        except Exception as error:
            result = _failed(source, f"{type(error).__name__}: {error}")
        found.append(result)
        if time.monotonic() > until:
            break
    return found


def _failed(source: Path, why: str) -> FileResult:
    named = why.startswith(str(source))
    return FileResult(source, error=why if named else f"{source}: {why}")


# --- which files ------------------------------------------------------------------


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
    if path.name not in TABLES:
        return False
    start = ",".join(_FIRST_COLUMNS).encode()
    try:
        with path.open("rb") as file:
            return file.read(len(start)) == start
    except OSError:  # whoever reads it says why
        return False


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


# --- a folder ---------------------------------------------------------------------


def work_through(
    operation: Operation,
    folder: Path,
    out: Path,
    *,
    jobs: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int, FileResult], None] | None = None,
) -> list[FileResult]:
    """Works on each file of a folder, and writes what is made of it to the same place
    below another, or `apart` from it; there also a table, and in the end a page.

    A file whose certificate is there, of the same file, robot, parameters and options,
    is not done again.

    Args:
        operation: what is done with each.
        folder: with files in it or below.
        out: another folder.
        jobs, executor: as of `each_file`.
        progress: is called with (finished, all, newest).

    Raises:
        ModelError: there is no such robot, or it cannot be used.
        CrarError: there is no file; `out` is the files' folder or below it, or another
            process is writing to it. What is wrong with one file is reported of it, and
            is not fatal.
    """
    sources, table = operation.sources(folder), out / operation.table
    places = apart({p: operation.place(out / p.relative_to(folder)) for p in sources})
    if out.resolve().is_relative_to(folder.resolve()):
        # What is written would be taken for a motion the next time.
        raise CrarError(
            f"{out}: is the motions' own folder, or below it; name another (--out)"
        )
    robot = robot_files(load_robot_description(operation.robot))
    with sole_writer(table):
        kept = read_table(table, folder, operation.record)
        finished = {
            path: FileResult(path, tuple(map(operation.again, kept[path].clips)))
            for path, place in places.items()
            if path in kept and _is_done(operation, path, place, robot)
        }
        waiting = [pair for pair in places.items() if pair[0] not in finished]
        results = each_file(waiting, operation.begin, jobs=jobs, executor=executor)
        with closing(results):
            for result in results:
                finished[result.source] = result
                _write_table(table, folder, operation.record, finished)
                if progress is not None:
                    progress(len(finished), len(places), result)
        _write_table(table, folder, operation.record, finished)
        write_folder_page(
            page_of(table),
            f"{folder.absolute().name}: {table.stem}",
            f"Robot {operation.robot}. A click on a heading sorts by it; crar-drake "
            "show makes a page of two motions.",
            operation.figures,
            [
                PageRow(path, places[path], clip, result.error or operation.note(clip))
                for path, result in finished.items()
                for clip in result.clips or [None]
            ],
        )
    return [finished[path] for path in places]


def page_of(table: Path) -> Path:
    """Where the page of a table is."""
    return table.with_suffix(".html")


def _is_done(
    operation: Operation, source: Path, out: Path, robot: dict[str, str]
) -> bool:
    """Whether a file was done before, for the same robot (`robot_files`) and in the
    same way."""
    try:
        certificate = read_certificate(certificate_path(out))
        return (
            certificate["reference"]["sha256"] == file_hash(source)
            and certificate["motion"]["sha256"] == file_hash(out)
            and certificate["parameters"] == asdict(operation.parameters)
            and certificate["options"] == operation.options(source)
            and certificate["robot"]["files"] == robot
        )
    except (CrarError, KeyError, TypeError, OSError):
        return False


# --- the table --------------------------------------------------------------------


def _columns(record: type) -> dict[str, Callable[[str], Any]]:
    """Name of each column but the first ones to what converts it: numbers first, and of
    these the record's own before those that it inherits."""
    kinds = {field.name: field.type for field in fields(record)}
    own = record.__annotations__
    names = [name for name in kinds if name not in _FIRST_COLUMNS]
    names.sort(key=lambda name: (kinds[name] == "str", name not in own))
    return {name: _CONVERSIONS[kinds[name]] for name in names}


def _write_table(
    table: Path, folder: Path, record: type, files: Mapping[Path, FileResult]
) -> None:
    stream, names = io.StringIO(), [*_FIRST_COLUMNS, *_columns(record)]
    writer = csv.DictWriter(stream, names, lineterminator="\n")
    writer.writeheader()
    for path in sorted(files):
        row, result = {"file": path.relative_to(folder)}, files[path]
        if result.error:
            writer.writerow(row | {"error": result.error})
        writer.writerows(row | asdict(clip) for clip in result.clips)
    with whole_file(table) as temporary:
        temporary.write_text(stream.getvalue(), "utf-8", _ANY_NAME)


def read_table(table: Path, folder: Path, record: type) -> dict[Path, FileResult]:
    """Files that did not fail; none if there is no table, or one of other columns.

    A file of which a row is damaged is done again.
    """
    if not os.path.isfile(table):
        return {}
    columns = _columns(record)
    with open(table, newline="", encoding="utf-8", errors=_ANY_NAME) as stream:
        reader = csv.DictReader(stream)
        if {*(reader.fieldnames or ())} != {*_FIRST_COLUMNS, *columns}:
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
        files[path] = FileResult(path, (*before, record(clip=each["clip"], **values)))
    return {path: file for path, file in files.items() if path not in damaged}
