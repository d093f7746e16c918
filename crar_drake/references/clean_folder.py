"""Many files of reference motions, cleaned in parallel."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import asdict, replace
from functools import partial
from math import degrees, nan
from pathlib import Path
from typing import Any

from crar_drake.references.clean_file import CleanedClip, FileCleaner, FileOptions
from crar_drake.references.cleaning import CleaningParameters
from crar_drake.references.each_file import FileResult
from crar_drake.references.folder_page import Figure
from crar_drake.references.folders import (
    CLEANED_TABLE,
    FolderWork,
    apart,
    find_references,
    work_through,
)
from crar_drake.references.layouts import layout_named

# What the page shows of a motion.
FIGURES = (
    Figure("joints changed, at most [deg]", lambda c: degrees(c.joints_worst), 1),
    Figure("rms [deg]", lambda c: degrees(c.joints_rms), 2),
    Figure("feet, at most [mm]", lambda c: 1e3 * c.feet_worst, 1),
    Figure("hands, at most [mm]", lambda c: 1e3 * c.hands_worst, 1),
    Figure("jerk, after / before", lambda c: c.jerk / (c.jerk_before or nan), 2),
)
LEFT = (
    Figure("frames", lambda c: c.frames),
    Figure("capsules penetrate in", lambda c: c.penetrating, bad=True),
    Figure("meshes in", lambda c: max(c.meshes_penetrating, 0), bad=True),
    Figure("ways not clear", lambda c: max(c.meshes_unclear, 0), bad=True),
    Figure("beyond limits in", lambda c: c.beyond_limit, bad=True),
    Figure("too fast in", lambda c: c.too_fast, bad=True),
    Figure("nearest [mm]", lambda c: 1e3 * c.nearest, 1),
    Figure("x real time", lambda c: c.times_real_time, 1),
)
_BEFORE = Figure("capsules penetrated in", lambda c: c.penetrating_before)


def clean_folder(
    folder: Path,
    out: Path,
    robot: str,
    parameters: CleaningParameters | None = None,
    *,
    jobs: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int, FileResult], None] | None = None,
    **options: Any,
) -> list[FileResult]:
    """Cleans each file of a folder into the same place below `out`.

    `out`/cleaned.csv has a `CleanedClip` for each motion of each file, and cleaned.html
    shows them. Another `at_most` alone makes no file be cleaned again.

    Args:
        folder: with references in it or below.
        out: another folder.
        robot: name or folder of the robot.
        parameters: what changing the least means, and what is kept.
        jobs, executor, progress: as of `work_through`.
        options: of all files, see `FileOptions`.

    Raises:
        MotionError: there is no such layout.
        ModelError, CrarError: as `find_references` and `work_through`.
    """
    given = FileOptions(**options)
    if given.layout:
        layout_named(given.layout)
    parameters = parameters or CleaningParameters()
    parameters.validate()
    references = find_references(folder)

    def gated(clip: CleanedClip) -> CleanedClip:
        return replace(clip, exceeded=given.at_most.exceeded(clip))

    work = FolderWork(
        table=CLEANED_TABLE,
        row=CleanedClip,
        places=apart({path: out / path.relative_to(folder) for path in references}),
        begin=partial(FileCleaner, robot, parameters, given),
        figures=(*FIGURES, _BEFORE, *LEFT),
        note=lambda clip: clip.exceeded or clip.deepest,
        robot=robot,
        parameters=asdict(parameters),
        options=lambda _: given.certified(),
        again=gated,
    )
    return work_through(
        work, folder, out, jobs=jobs, executor=executor, progress=progress
    )
