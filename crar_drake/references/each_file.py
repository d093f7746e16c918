"""Files worked on several at a time, each by itself: a bad one spoils no other."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from crar_drake.errors import CrarError, NoMotionError
from crar_drake.fresh_processes import given_or_fresh, in_batches

# A process that has worked for so long gives back what it has [s].
_LONG = 60.0

# From a file, and perhaps its place, to what became of each of its motions.
Work = Callable[..., Sequence[Any]]


@dataclass(frozen=True)
class FileResult:
    """What became of one file."""

    source: Path  # the file
    clips: tuple[Any, ...] = ()  # of its motions, one each; none if it failed
    error: str = ""  # why it failed, with its name; "" if it did not
    skipped: bool = False  # whether it did not fail: it holds no motion


def result_of(work: Work, source: Path, *rest: Any) -> FileResult:
    """What became of a file; whatever is wrong is of this one."""
    try:
        return FileResult(source, tuple(work(source, *rest)))
    except NoMotionError as error:
        return replace(_failed(source, str(error)), skipped=True)
    except CrarError as error:
        return _failed(source, str(error))
    except Exception as error:
        return _failed(source, f"{type(error).__name__}: {error}")


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
    for file in files:
        found.append(result_of(work, *file))
        if time.monotonic() > until:
            break
    return found


def _failed(source: Path, why: str) -> FileResult:
    named = why.startswith(str(source))
    return FileResult(source, error=why if named else f"{source}: {why}")
