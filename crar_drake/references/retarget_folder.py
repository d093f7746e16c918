"""Many files of people's motions, retargeted in parallel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from functools import partial
from math import degrees
from pathlib import Path
from typing import Any

from crar_drake.errors import CrarError
from crar_drake.motion.catalogue import MOTION_SUFFIXES
from crar_drake.motion.robots_own import holds_reference
from crar_drake.references.certificate_files import SUFFIX
from crar_drake.references.clean_file import CleanedClip
from crar_drake.references.clean_folder import LEFT
from crar_drake.references.folder_page import Figure
from crar_drake.references.folders import (
    RETARGETED_TABLE,
    FileResult,
    FolderWork,
    is_table,
    work_through,
)
from crar_drake.references.layouts import layout_named
from crar_drake.references.retarget_file import (
    CLEANING,
    FileRetargeter,
    RetargetedClip,
    RetargetOptions,
)

LAYOUT = "xyzw-csv"  # that is written if none is named

# What the page shows of a motion.
FIGURES = (
    Figure("limbs off, 95 % [deg]", lambda r: degrees(r.limbs_most), 1),
    Figure("median [deg]", lambda r: degrees(r.limbs_median), 1),
    Figure("of all limbs, 95 % [deg]", lambda r: degrees(r.farthest_most), 1),
    Figure("left knee, median [deg]", lambda r: degrees(r.left_knee), 1),
    Figure("right knee [deg]", lambda r: degrees(r.right_knee), 1),
    Figure("feet slip [mm]", lambda r: 1e3 * r.slip, 1),
    Figure("lowest point [mm]", lambda r: 1e3 * r.lowest, 1),
    Figure("root accelerates, rms [m/s²]", lambda r: r.root, 1),
    Figure("the person's [m/s²]", lambda r: r.persons_root, 1),
    *LEFT,
)


@dataclass(frozen=True, kw_only=True)
class RetargetedRow(CleanedClip):
    """What became of a person's motion, in one line; `seconds` are of all.

    What it inherits is of the motion before and after cleaning, both the robot's.
    """

    # of arms and legs, how far the farthest limb is off in direction, in the median
    # [rad]
    limbs_median: float
    limbs_most: float  # and in 95 % of the frames [rad]
    farthest_most: float  # of all limbs, in 95 % of the frames [rad]
    left_knee: float  # how much more it bends than the person's in the median [rad]
    right_knee: float  # and how much the right one [rad]
    slip: float  # the longest way that a planted foot slips [m]
    lowest: float  # the lowest point of all links, over the floor [m]
    root: float  # how it accelerates, rms [m/s^2],
    root_peak: float  # and at most [m/s^2]
    persons_root: float  # and the person's, scaled, rms [m/s^2]
    persons_root_peak: float  # and at most [m/s^2]
    farthest: str  # that limb


def find_people(folder: Path) -> list[Path]:
    """Files in a folder and below that may be motions of people, in order of their
    names; skeletons, motions of robots and certificates are none.

    Raises:
        CrarError: there is none.
    """
    found = sorted(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in MOTION_SUFFIXES
        and path.is_file()
        and not path.name.endswith(SUFFIX)
        and not is_table(path)
        and not holds_reference(path)
    )
    if not found:
        suffixes = ", ".join(MOTION_SUFFIXES)
        raise CrarError(
            f"{folder}: no motions of people ({suffixes}) in it or below; of robots' "
            "own there may be some, which crar-drake clean takes"
        )
    return found


def retarget_folder(
    folder: Path,
    out: Path,
    robot: str,
    *,
    jobs: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int, FileResult], None] | None = None,
    **options: Any,
) -> list[FileResult]:
    """Retargets each file of a folder into the same place below `out`.

    `out`/retargeted.csv has a `RetargetedRow` for each, and retargeted.html shows them.

    Args:
        folder: with people's motions in it or below; of an AMC with its ASF beside it.
        out: another folder.
        robot: as of `retarget_file`.
        jobs, executor, progress: as of `work_through`.
        options: of all files, see `RetargetOptions`; the layout is LAYOUT by default.

    Raises:
        MotionError: there is no such layout.
        ModelError, CrarError: as `find_people` and `work_through`.
    """
    given = RetargetOptions(**options)
    given = replace(given, layout=given.layout or LAYOUT)
    suffix = layout_named(given.layout).suffix
    work = FolderWork(
        table=RETARGETED_TABLE,
        row=RetargetedRow,
        places={
            path: (out / path.relative_to(folder)).with_suffix(suffix)
            for path in find_people(folder)
        },
        begin=partial(_RowOfFile, robot, given),
        figures=FIGURES,
        note=lambda row: row.deepest or row.faults or f"farthest off: {row.farthest}",
        robot=robot,
        parameters=asdict(CLEANING),
        options=given.certified,
    )
    return work_through(
        work, folder, out, jobs=jobs, executor=executor, progress=progress
    )


class _RowOfFile:
    """From a file and its place to its row; made as a `FileRetargeter` is."""

    def __init__(self, robot: str, options: RetargetOptions) -> None:
        self._retargeter = FileRetargeter(robot, options)

    def __call__(self, motion: Path, out: Path) -> Sequence[RetargetedRow]:
        return [row_of(self._retargeter(motion, out))]


def row_of(clip: RetargetedClip) -> RetargetedRow:
    """What a table has of a motion."""
    of_cleaning = asdict(clip.cleaned) | {"seconds": clip.seconds}
    return RetargetedRow(
        **of_cleaning,
        limbs_median=clip.limbs_median,
        limbs_most=clip.limbs_most,
        farthest_most=clip.limbs[clip.farthest][1],
        left_knee=clip.knees["left"][0],
        right_knee=clip.knees["right"][0],
        slip=clip.slip,
        lowest=clip.lowest,
        root=clip.root[0],
        root_peak=clip.root[1],
        persons_root=clip.persons_root[0],
        persons_root_peak=clip.persons_root[1],
        farthest=clip.farthest,
    )
