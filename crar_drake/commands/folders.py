"""What commands say of a folder whose files they worked on."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crar_drake.commands.output import continuing, counted, final_line
from crar_drake.errors import plural

if TYPE_CHECKING:
    from crar_drake.references.each_file import FileResult
    from crar_drake.references.folders import FolderWork

# Files that are reported one by one.
_MOST_LINES = 10


def work_on(work: FolderWork, jobs: int | None) -> list[FileResult]:
    """Does it, and draws how many files are finished, on stderr, or without a terminal
    writes a line for each; says there where these are, if it is interrupted."""
    from crar_drake.references.folders import work_through

    with continuing(work.table.parent), progress_bar() as bar:
        task = bar.add_task("", total=None)

        def show(done: int, total: int, newest: FileResult) -> None:
            ended = "skipped" if newest.skipped else "failed" if newest.error else ""
            what = f"{newest.source.name} {ended}".rstrip()
            if bar.disable:
                print(f"{done} of {total}: {what}", file=sys.stderr, flush=True)
            bar.update(task, completed=done, total=total, description=what)

        return work_through(work, jobs=jobs, progress=show)


@contextmanager
def frames_bar() -> Iterator[Callable[[int, int], None]]:
    """Yields a callback that draws how far a motion is, on stderr; says there if
    anything has to be compiled first."""
    from crar_drake.law.compilation import when_compiling

    with (
        progress_bar() as bar,
        when_compiling(lambda line: print(line, file=sys.stderr)),
    ):
        task = bar.add_task("", total=None)
        yield lambda frame, frames: bar.update(task, completed=frame, total=frames)


def progress_bar():
    """Rich's, on stderr; none where nobody looks at it."""
    from rich import progress
    from rich.console import Console

    console = Console(stderr=True)
    return progress.Progress(
        progress.BarColumn(bar_width=20),
        progress.MofNCompleteColumn(),
        progress.TextColumn("{task.description}", markup=False),
        progress.TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def report_files(
    files: Sequence[FileResult],
    violated: Callable[[Sequence[Any]], list[str]],
    table: Path,
) -> int:
    """Prints which motions violate something and which files failed, then what was
    written, and OK or VIOLATED.

    Args:
        files: what became of them.
        violated: what motions violate, in a few words each; of one in more of them.
        table: that was written, with its page beside it.

    Returns:
        The exit code: 1 if anything is violated or failed, 2 if there is no motion.
    """
    from crar_drake.references.folders import page_of

    left = [(file, clip) for file in files for clip in file.clips if clip.violated]
    for file, clip in left[:_MOST_LINES]:
        which = f"{file.source} {clip.clip}".rstrip()
        print(f"violated: {which}: {'; '.join(violated([clip]))}")
    if len(left) > _MOST_LINES:
        print(f"and {len(left) - _MOST_LINES} more, in the table")
    skipped = [file for file in files if file.skipped]
    for file in skipped[:_MOST_LINES]:
        print(f"skipped: {file.error}", file=sys.stderr)
    if len(skipped) > _MOST_LINES:
        print(f"and {len(skipped) - _MOST_LINES} more skipped", file=sys.stderr)
    failed = [file for file in files if file.error and not file.skipped]
    for file in failed[:_MOST_LINES]:
        print(f"failed: {file.error}", file=sys.stderr)
    if len(failed) > _MOST_LINES:
        print(f"and {len(failed) - _MOST_LINES} more failed", file=sys.stderr)
    print(table)
    print(page_of(table))
    clips = [clip for file in files for clip in file.clips]
    if len(skipped) == len(files):
        print(f"NOT JUDGED: {plural(len(files), 'file')}, and no motion in any")
        return 2
    bad = [*violated(clips), *counted(len(failed), "file", "failed")]
    return final_line(bad, left=[clip.left for clip in clips])
