"""CSV files: a line a frame, the root's pose, then the joints; without a heading:

========  =====================================================================
columns   what
========  =====================================================================
1 to 3    x y z of the root in the world [m]
4 to 7    the root's orientation: x y z w (Unitree's retargeted LAFAN1 data set,
          BeyondMimic's input) or w x y z (ProtoMotions, kimodo)
from 8    the joints [rad], in the order of the robot's model, depth first
========  =====================================================================

Neither names, rate nor the order of the quaternion are in the file. With a heading, see
`named_csv`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.files import whole_file
from crar_drake.motion.robots_own import NAMED_ROOT, cells_of, is_named
from crar_drake.motion.text_files import read_motion_text
from crar_drake.references.held_values import check_quaternions
from crar_drake.references.named_csv import read_named_csv
from crar_drake.references.quaternion_order import guess_quaternion_order
from crar_drake.references.robot_motion import RobotMotion

# Of both kinds; Unitree's data set says so in its text, kimodo's files by their length.
USUAL_RATE = 30.0  # [Hz]

_ORDERS = {"xyzw-csv": "xyzw", "wxyz-csv": "wxyz"}


def read_csv(
    path: Path,
    layout: str | None,
    rate: float | None,
    joint_names: Sequence[str] | None,
) -> tuple[RobotMotion]:
    """Reads a CSV file; `layout` None guesses the quaternion's order.

    Raises:
        MotionError: a line is damaged, or nothing tells the order.
    """
    heading, table = _read_table(path)
    if layout is not None and (layout == "named-csv") != bool(heading):
        has = "a heading" if heading else "no heading"
        raise MotionError(f"{path}: it has {has}, which is not as {layout} has it")
    if heading:
        return read_named_csv(path, heading, table, rate)
    quaternions = table[:, 3:7]
    check_quaternions(path, "the root's quaternion (columns 4 to 7)", quaternions)
    guesses = []
    order = _ORDERS.get(layout or "")
    if order is None:
        order, evidence = guess_quaternion_order(quaternions)
        if not order:
            raise MotionError(
                f"{path}: whether the quaternion's columns are xyzw or wxyz cannot be "
                f"guessed ({evidence}); say it with --layout xyzw-csv or wxyz-csv, if "
                f"the first 7 of its {table.shape[1]} columns are the root, and the "
                "others joints"
            )
        guesses.append(f"quaternions are {order}: {evidence}")
    if rate is None:
        rate = USUAL_RATE
        guesses.append(
            f"{rate:g} Hz, the usual rate of such files, which do not say it"
        )
    if order == "xyzw":
        quaternions = quaternions[:, [3, 0, 1, 2]]
    return (
        RobotMotion(
            joint_names=tuple(joint_names or ()),
            root_positions=table[:, :3].copy(),
            root_quaternions=quaternions.copy(),
            joint_positions=table[:, 7:].copy(),
            rate=float(rate),
            layout=f"{order}-csv",
            source=str(path),
            guesses=tuple(guesses),
        ).as_read(),
    )


def write_csv(path: str | os.PathLike[str], motion: RobotMotion, layout: str) -> None:
    """Writes a CSV file; each number so that it is read as the same one again."""
    quaternions = motion.root_quaternions
    if _ORDERS[layout] == "xyzw":
        quaternions = quaternions[:, [1, 2, 3, 0]]
    table = np.hstack([motion.root_positions, quaternions, motion.joint_positions])
    with whole_file(path) as temporary, temporary.open("w", encoding="ascii") as file:
        for row in table.tolist():
            file.write(",".join(map(repr, row)) + "\n")


def _read_table(path: Path) -> tuple[list[str], np.ndarray]:
    """Names of the columns, [] where there are none, and (T, C) numbers."""
    heading: list[str] = []
    rows: list[list[float]] = []
    lines = read_motion_text(path).split("\n")
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = cells_of(line)
        if not rows and not heading and is_named(line):
            heading = cells
            continue
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            bad = next(cell.strip() for cell in cells if not _is_number(cell))
            header = f" (a heading has {', '.join(NAMED_ROOT)})" if not rows else ""
            raise MotionError(
                f"{path}, line {number}: {bad[:40]!r} is no number{header}"
            ) from None
        expected = len(heading or (rows or [row])[0])
        if len(row) != expected:
            raise MotionError(
                f"{path}, line {number}: {len(row)} columns, but {expected} in the "
                "lines before: the line, or the file, is cut off"
            )
        rows.append(row)
    if not rows:
        raise MotionError(f"{path}: the file is empty")
    if not heading and len(rows[0]) < 8:
        raise MotionError(
            f"{path}: {len(rows[0])} columns; a robot's motion has x, y, z, the four "
            "of a quaternion, and at least one joint"
        )
    table = np.array(rows)
    bad = np.argwhere(~np.isfinite(table))
    if len(bad):
        row, column = bad[0]
        raise MotionError(
            f"{path}, frame {row + 1}, column {column + 1}: {table[row, column]} is no "
            "finite number"
        )
    return heading, table


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
