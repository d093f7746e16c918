"""A folder of reference motions in, cleaned ones out."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial
from math import degrees, nan
from pathlib import Path
from typing import Any

from crar_drake.references.clean_file import CleanedClip, FileCleaner, FileOptions
from crar_drake.references.cleaning import CleaningParameters
from crar_drake.references.folder_page import Figure
from crar_drake.references.folders import (
    CLEANED_TABLE,
    FolderWork,
    find_references,
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


def cleaning(
    folder: Path,
    out: Path,
    robot: str,
    parameters: CleaningParameters | None = None,
    **options: Any,
) -> FolderWork:
    """Each file of a folder cleaned into the same place below `out`, with cleaned.csv,
    which has a `CleanedClip` for each motion. Another `at_most` alone makes no file be
    cleaned again.

    Args:
        folder: with references in it or below.
        out: another folder.
        robot, parameters: as of `clean_file`.
        options: of all files, see `FileOptions`.

    Raises:
        MotionError: there is no such layout.
        CrarError: as `find_references`.
    """
    given = FileOptions(**options)
    if given.layout:
        layout_named(given.layout)
    parameters = parameters or CleaningParameters()
    parameters.validate()

    def gated(clip: CleanedClip) -> CleanedClip:
        return replace(clip, exceeded=given.at_most.exceeded(clip))

    return FolderWork(
        folder=folder,
        table=out / CLEANED_TABLE,
        row=CleanedClip,
        places={
            path: out / path.relative_to(folder) for path in find_references(folder)
        },
        begin=partial(FileCleaner, robot, parameters, given),
        figures=(*FIGURES, _BEFORE, *LEFT),
        note=lambda clip: clip.exceeded or clip.deepest,
        robot=robot,
        parameters=asdict(parameters),
        options=lambda _: given.certified(),
        again=gated,
    )
