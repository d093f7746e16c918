"""What commands say of motions that they wrote, and of folders of them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crar_drake.commands.output import continuing, counted, final_line
from crar_drake.errors import plural

if TYPE_CHECKING:
    from crar_drake.references.folders import FileResult
    from crar_drake.references.pipeline import Operation, WrittenClip

# Files that are reported one by one.
_MOST_LINES = 10


def work_on(
    operation: Operation,
    folder: Path,
    out: Path,
    jobs: int | None,
    summary: Callable[[Sequence[Any]], list[str]],
) -> int:
    """Works on each file of a folder, and says what became of them.

    How many files are finished is drawn on stderr, or without a terminal written, a
    line for each; it says there where these are, if it is interrupted.

    Args:
        operation, folder, out, jobs: as of `work_through`.
        summary: of all motions, in words.

    Returns:
        The exit code: 1 if anything is violated or failed, 2 if there is no motion.
    """
    from crar_drake.references.folders import page_of, work_through

    with continuing(out), progress_bar() as bar:
        task = bar.add_task("", total=None)

        def show(done: int, total: int, newest: FileResult) -> None:
            ended = "skipped" if newest.skipped else "failed" if newest.error else ""
            what = f"{newest.source.name} {ended}".rstrip()
            if bar.disable:
                print(f"{done} of {total}: {what}", file=sys.stderr, flush=True)
            bar.update(task, completed=done, total=total, description=what)

        files = work_through(operation, folder, out, jobs=jobs, progress=show)
    clips = [clip for file in files for clip in file.clips]
    for line in summary(clips):
        print(line)
    _some(
        "violated: ",
        [
            f"{file.source} {clip.clip}".rstrip() + f": {'; '.join(violations([clip]))}"
            for file in files
            for clip in file.clips
            if clip.violated
        ],
        ", in the table",
    )
    skipped = [file.error for file in files if file.skipped]
    failed = [file.error for file in files if file.error and not file.skipped]
    _some("skipped: ", skipped, " skipped", sys.stderr)
    _some("failed: ", failed, " failed", sys.stderr)
    print(out / operation.table)
    print(page_of(out / operation.table))
    if len(skipped) == len(files):
        print(f"NOT JUDGED: {plural(len(files), 'file')}, and no motion in any")
        return 2
    bad = [*violations(clips), *counted(len(failed), "file", "failed")]
    return final_line(bad, left=[clip.left for clip in clips])


def _some(what: str, said: Sequence[str], more: str, to: Any = None) -> None:
    """Prints the first few of what is said, and how many more there are."""
    for words in said[:_MOST_LINES]:
        print(f"{what}{words}", file=to)
    if len(said) > _MOST_LINES:
        print(f"and {len(said) - _MOST_LINES} more{more}", file=to)


def violations(clips: Sequence[WrittenClip]) -> list[str]:
    """What motions violate, in a few words each; of one in more of them."""
    unclear = sum(c.unclear > 0 or c.meshes_unclear > 0 for c in clips)
    return [
        *counted(sum(c.penetrating for c in clips), "frame", "penetrate{s}"),
        *counted(sum(c.beyond_limit for c in clips), "frame", "beyond a joint limit"),
        *counted(sum(c.too_fast for c in clips), "frame", "beyond a speed limit"),
        *counted(
            sum(max(c.meshes_penetrating, 0) for c in clips),
            "frame",
            "with meshes that penetrate",
        ),
        *counted(unclear, "motion", "with a way between frames that is not clear"),
        *_of_each([c.exceeded for c in clips], "changed", "by more than is allowed"),
        *_of_each([c.faults for c in clips], "", "with faults"),
    ]


def _of_each(words: list[str], what: str, in_all: str) -> list[str]:
    """What is said of one motion; of several how many it is said of."""
    if len(words) == 1:
        return [f"{what}: {words[0]}".lstrip(": ")] if words[0] else []
    return counted(sum(map(bool, words)), "motion", f"{what} {in_all}".strip())


def written_lines(clip: WrittenClip) -> list[str]:
    """What a motion that was written still violates, and what nobody looked at."""
    lines = []
    if clip.deepest:
        lines.append(f"still penetrating, most at {clip.deepest}")
    if clip.near > clip.penetrating:
        lines.append(
            f"{clip.near} frames keep less than the margin, at them or on the way to "
            "the next"
        )
    if clip.meshes_penetrating < 0:
        lines.append(
            "no meshes were looked at: of links that nobody watches nothing is known"
        )
    if clip.meshes_penetrating > 0:
        lines.append(
            f"meshes penetrate in {clip.meshes_penetrating} frames; crar-drake judge "
            "tells of which links"
        )
    if clip.unclear:
        lines.append("a way between frames is not shown to be clear")
    if clip.meshes_unclear > 0:
        lines.append(
            "meshes touch, or are not shown to be clear, on "
            f"{clip.meshes_unclear} ways between frames"
        )
    return lines


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


def tell_files(out: Path) -> None:
    """Prints where a motion was written, its certificate, and labels beside it."""
    from crar_drake.references.certificate_files import certificate_path
    from crar_drake.references.contacts import contacts_path

    print(out)
    print(certificate_path(out), flush=True)
    if contacts_path(out).is_file():
        print(contacts_path(out), flush=True)
