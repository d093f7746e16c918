"""Many files of reference motions, cleaned in parallel."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from crar_drake.references.adjusting import Frames
from crar_drake.references.change import ANY_CHANGE, AtMost
from crar_drake.references.clean_file import (
    CleanedClip,
    clean_file,
    cleaning_options,
)
from crar_drake.references.cleaning import CleaningParameters
from crar_drake.references.folders import (
    CLEANED_TABLE,
    FileResult,
    FolderWork,
    find_references,
    work_through,
)
from crar_drake.references.layouts import check_written, layout_named


def clean_folder(
    folder: Path,
    out: Path,
    robot: str,
    parameters: CleaningParameters | None = None,
    *,
    layout: str | None = None,
    rate: float | None = None,
    frames: Frames = (1, None),
    ground: bool = False,
    at_most: AtMost = ANY_CHANGE,
    jobs: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int, FileResult], None] | None = None,
) -> list[FileResult]:
    """Cleans each file of a folder into the same place below `out`.

    `out`/cleaned.csv has a `CleanedClip` for each motion of each file. Another
    `at_most` alone makes no file be cleaned again.

    Args:
        folder: with references in it or below.
        out: another folder.
        robot: name or folder of the robot.
        parameters, layout, rate, frames, ground, at_most: as of `clean_file`, of all
            files.
        jobs, executor, progress: as of `work_through`.

    Raises:
        MotionError: no file of the layout is written.
        ModelError, CrarError: as `find_references` and `work_through`.
    """
    if layout:
        check_written(f"FILE{layout_named(layout).suffix}", layout)
    parameters = parameters or CleaningParameters()
    parameters.validate()
    references = find_references(folder)

    def gated(clip: CleanedClip) -> CleanedClip:
        return replace(clip, exceeded=at_most.exceeded(clip))

    work = FolderWork(
        table=CLEANED_TABLE,
        row=CleanedClip,
        places={path: out / path.relative_to(folder) for path in references},
        do=partial(
            clean_file,
            robot=robot,
            parameters=parameters,
            layout=layout,
            rate=rate,
            frames=frames,
            ground=ground,
            at_most=at_most,
        ),
        robot=robot,
        parameters=asdict(parameters),
        options=lambda _: cleaning_options(layout, rate, frames, ground),
        again=gated,
    )
    return work_through(
        work, folder, out, jobs=jobs, executor=executor, progress=progress
    )
