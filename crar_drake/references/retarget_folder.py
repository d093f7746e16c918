"""A folder of people's motions in, reference motions out."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial
from math import degrees
from pathlib import Path
from typing import Any

from crar_drake.errors import CrarError
from crar_drake.motion.catalogue import MOTION_SUFFIXES
from crar_drake.motion.robots_own import holds_reference
from crar_drake.references.certificate_files import SUFFIX
from crar_drake.references.clean_folder import LEFT
from crar_drake.references.folder_page import Figure
from crar_drake.references.folders import (
    RETARGETED_TABLE,
    FolderWork,
    is_table,
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


def retargeting(folder: Path, out: Path, robot: str, **options: Any) -> FolderWork:
    """Each file of a folder retargeted into the same place below `out`, with
    retargeted.csv, which has a `RetargetedClip` for each.

    Args:
        folder: with people's motions in it or below; of an AMC with its ASF beside it.
        out: another folder.
        robot: as of `retarget_file`.
        options: of all files, see `RetargetOptions`; the layout is LAYOUT by default.

    Raises:
        MotionError: there is no such layout.
        CrarError: as `find_people`.
    """
    given = RetargetOptions(**options)
    given = replace(given, layout=given.layout or LAYOUT)
    suffix = layout_named(given.layout).suffix
    return FolderWork(
        folder=folder,
        table=out / RETARGETED_TABLE,
        row=RetargetedClip,
        places={
            path: (out / path.relative_to(folder)).with_suffix(suffix)
            for path in find_people(folder)
        },
        begin=partial(FileRetargeter, robot, given),
        figures=FIGURES,
        note=lambda row: row.deepest or row.faults or f"farthest off: {row.farthest}",
        robot=robot,
        parameters=asdict(CLEANING),
        options=given.certified,
    )
