"""Many files of reference motions, cleaned in parallel; a stopped one continues."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable
from concurrent.futures import Executor, Future, as_completed
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path

from crar_drake.errors import CrarError
from crar_drake.files import sole_writer, whole_file
from crar_drake.fresh_processes import FreshProcesses
from crar_drake.motion.robots_own import is_reference
from crar_drake.references.clean_file import (
    NUMBERS,
    CleanedClip,
    clean_file,
    number_from,
)
from crar_drake.references.cleaning import CleaningParameters
from crar_drake.references.motion_certificate import (
    certificate_path,
    file_hash,
    read_certificate,
    robot_files,
)
from crar_drake.robot.description import load_robot_description

_HEADER = ("file", "clip", "error", *NUMBERS, "deepest")


@dataclass(frozen=True)
class CleanedFile:
    """What became of one file.

    Attributes:
        reference: the file.
        clips: of its motions; none if it failed.
        error: why it failed; "".
    """

    reference: Path
    clips: tuple[CleanedClip, ...] = ()
    error: str = ""


def find_references(folder: Path) -> list[Path]:
    """Files in a folder and below that may be robot motions, in order of their names.

    Raises:
        CrarError: there is none.
    """
    found = sorted(p for p in folder.rglob("*") if p.is_file() and is_reference(p))
    if not found:
        raise CrarError(f"{folder}: no robot motions (.csv, .npz, .pkl) in it or below")
    return found


def clean_folder(
    folder: Path,
    out: Path,
    robot: str,
    parameters: CleaningParameters | None = None,
    *,
    layout: str | None = None,
    rate: float | None = None,
    jobs: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int, CleanedFile], None] | None = None,
) -> list[CleanedFile]:
    """Cleans each file of a folder into the same place below `out`.

    A file whose certificate is there, of the same reference, robot and parameters, is
    not cleaned again. `out`/cleaned.csv has a line for each motion of each file.

    Args:
        folder: with references in it or below.
        out: another folder.
        robot: name or folder of the robot.
        parameters, layout, rate: as of `clean_file`, of all files.
        jobs: number of processes; by default one per core.
        executor: any `concurrent.futures` executor; by default such processes.
        progress: is called with (finished, all, newest).

    Raises:
        ModelError: there is no such robot.
        CrarError: there are no files, `out` is the folder itself or below it, or
            another process is writing to it. What is wrong with one file is reported of
            it, and is not fatal.
    """
    references = find_references(folder)
    if out.resolve().is_relative_to(folder.resolve()):
        # Its files would be taken for references the next time.
        raise CrarError(
            f"{out}: is the references' own folder, or below it; name another (--out)"
        )
    parameters = parameters or CleaningParameters()
    parameters.validate()
    files = robot_files(load_robot_description(robot))
    table = out / "cleaned.csv"
    places = {path: out / path.relative_to(folder) for path in references}
    with sole_writer(table):
        kept = _read_table(table, folder)
        finished = {
            path: kept[path]
            for path in references
            if path in kept
            and _is_done(path, places[path], files, parameters, layout, rate)
        }
        finished |= _without_own_certificate(places)
        waiting = [path for path in references if path not in finished]
        own = nullcontext(executor) if executor is not None else FreshProcesses(jobs)
        with own as pool:
            futures: dict[Future, Path] = {
                pool.submit(
                    _clean_one, path, places[path], robot, parameters, layout, rate
                ): path
                for path in waiting
            }
            try:
                for future in as_completed(futures):
                    path = futures[future]
                    try:
                        result = future.result()
                    except RuntimeError as error:  # its process died
                        result = CleanedFile(path, error=str(error))
                    finished[path] = result
                    _write_table(table, folder, finished)
                    if progress is not None:
                        progress(len(finished), len(references), result)
            except BaseException:
                for future in futures:
                    future.cancel()
                raise
        _write_table(table, folder, finished)
    return [finished[path] for path in references]


def _clean_one(
    reference: Path,
    out: Path,
    robot: str,
    parameters: CleaningParameters,
    layout: str | None,
    rate: float | None,
) -> CleanedFile:
    """A file, in a process of its own."""
    try:
        clips = clean_file(reference, out, robot, parameters, layout=layout, rate=rate)
    except CrarError as error:
        return CleanedFile(reference, error=str(error))
    except Exception as error:  # whatever it is, it is of this file
        return CleanedFile(reference, error=f"{type(error).__name__}: {error}")
    return CleanedFile(reference, tuple(clips))


def _without_own_certificate(places: dict[Path, Path]) -> dict[Path, CleanedFile]:
    """References whose certificate another one's would replace: all but the first."""
    owners: dict[Path, Path] = {}
    failed = {}
    for reference, out in sorted(places.items()):
        owner = owners.setdefault(certificate_path(out), reference)
        if owner != reference:
            why = (
                f"{reference}: its certificate would be that of {owner.name}; rename "
                "one of them"
            )
            failed[reference] = CleanedFile(reference, error=why)
    return failed


def _is_done(
    reference: Path,
    out: Path,
    robot: dict[str, str],
    parameters: CleaningParameters,
    layout: str | None,
    rate: float | None,
) -> bool:
    """Whether a file was cleaned before, for the same robot (`robot_files`) and in the
    same way."""
    try:
        certificate = read_certificate(certificate_path(out))
        return (
            certificate["reference"]["sha256"] == file_hash(reference)
            and certificate["motion"]["sha256"] == file_hash(out)
            and certificate["parameters"] == asdict(parameters)
            and certificate["options"] == {"layout": layout, "rate": rate}
            and certificate["robot"]["files"] == robot
        )
    except (CrarError, KeyError, TypeError, OSError):
        return False


def _write_table(table: Path, folder: Path, files: dict[Path, CleanedFile]) -> None:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_HEADER)
    for path in sorted(files):
        name, result = path.relative_to(folder), files[path]
        if result.error:
            writer.writerow([name, "", result.error, *("" for _ in NUMBERS), ""])
        for clip in result.clips:
            row = [getattr(clip, number) for number in NUMBERS]
            writer.writerow([name, clip.clip, "", *row, clip.deepest])
    with whole_file(table) as temporary:
        temporary.write_text(stream.getvalue())


def _read_table(table: Path, folder: Path) -> dict[Path, CleanedFile]:
    """Files that did not fail; none if there is no table, or one of other columns.

    A file of which a row is damaged is cleaned again.
    """
    if not os.path.isfile(table):
        return {}
    with open(table, newline="", encoding="utf-8", errors="replace") as stream:
        reader = csv.DictReader(stream)
        if tuple(reader.fieldnames or ()) != _HEADER:
            return {}
        try:
            rows = list(reader)
        except csv.Error:  # a field of 130 kB
            return {}
    files: dict[Path, CleanedFile] = {}
    damaged: set[Path] = set()
    for row in rows:
        if row["error"]:
            continue
        path = folder / row["file"]
        try:
            numbers = {name: number_from(name, row[name]) for name in NUMBERS}
        except (TypeError, ValueError):  # no number, or none there
            damaged.add(path)
            continue
        before = files[path].clips if path in files else ()
        clip = CleanedClip(clip=row["clip"], deepest=row["deepest"], **numbers)
        files[path] = CleanedFile(path, (*before, clip))
    return {path: file for path, file in files.items() if path not in damaged}
