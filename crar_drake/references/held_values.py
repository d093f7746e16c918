"""What a file of a robot's motions holds: values by keys, whatever its container.

A CSV with a heading has a key for each column; a table without names is the value "".
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TextIO

import numpy as np

from crar_drake.errors import MotionError, NoMotionError
from crar_drake.files import whole_file
from crar_drake.motion.array_files import load_arrays, npy_header, npz_names
from crar_drake.motion.plain_pickle import (
    PlainUnpickler,
    RefusedPickle,
    for_any_numpy,
    read_plain_pickle,
    write_plain_pickle,
)
from crar_drake.motion.robots_own import HEADINGS, cells_of, is_named
from crar_drake.motion.text_files import read_motion_text
from crar_drake.references import locomujoco_npz

# To which times of frames are known, as files round them [s].
_KNOWN_TIMES = 1e-9, 1e-6, 6e-4

FRAME = "Frame"  # a column of a CSV that counts the lines

# What says the columns of a folder's `qpos`, at most so many folders above them; also
# the key that says so.
MANIFEST, _ABOVE = "manifest.json", 3


def read_held(path: Path, suffix: str) -> object:
    """What a file holds: a mapping of keys to values, unless it is damaged otherwise.

    Args:
        path: of the file.
        suffix: of its kind: .csv, .npz, .npy or .pkl.

    Raises:
        MotionError: it is damaged, or holds more than data.
    """
    return {".csv": _csv, ".npz": _npz, ".npy": _npy, ".pkl": read_plain_pickle}[
        suffix
    ](path)


def write_held(path: Path, suffix: str, held: Mapping[str, object]) -> None:
    """Writes such a file, whole or not at all; numbers of a CSV so that the same ones
    are read again."""
    if suffix == ".pkl":
        write_plain_pickle(path, held)
        return
    with whole_file(path) as temporary:
        if suffix == ".npz":
            np.savez(temporary, **held)
        elif suffix == ".npy":
            with temporary.open("wb") as file:
                _save_npy(file, held)
        else:
            with temporary.open("w", encoding="utf-8", newline="") as file:
                _write_csv(file, held)


# --- CSV --------------------------------------------------------------------------


def _csv(path: Path) -> dict[str, np.ndarray]:
    """The table as "", or its columns by name."""
    heading: list[str] = []
    rows: list[np.ndarray] = []
    lines = read_motion_text(path).split("\n")
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = cells_of(line)
        if not rows and not heading and is_named(line):
            heading = [cell.strip() for cell in cells]
            continue
        try:
            row = np.array([float(cell) for cell in cells])  # smaller than a list
        except ValueError:
            bad = next(cell.strip() for cell in cells if not _is_number(cell))
            known = ", or ".join(", ".join(names) for names in HEADINGS)
            header = f" (a heading has {known})" if not rows else ""
            # A table of words is something else than a motion with an odd heading.
            numbers = "\n".join(lines[number : number + 2])
            of_words = not rows and not any(map(_is_number, cells_of(numbers)))
            kind = NoMotionError if of_words else MotionError
            raise kind(
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
    table = np.array(rows)
    bad = np.argwhere(~np.isfinite(table))
    if len(bad):
        row, column = bad[0]
        raise MotionError(
            f"{path}, frame {row + 1}, column {column + 1}: {table[row, column]} is no "
            "finite number"
        )
    if not heading:
        return {"": table}
    if len(set(heading)) < len(heading):
        raise MotionError(f"{path}: its heading has a column there twice")
    return dict(zip(heading, table.T, strict=True))


def _write_csv(file: TextIO, held: Mapping[str, object]) -> None:
    if "" not in held:
        file.write(",".join(held) + "\n")
    rows = held[""] if "" in held else zip(*held.values(), strict=True)
    file.writelines(",".join(repr(x.item()) for x in row) + "\n" for row in rows)


def _is_number(cell: str) -> bool:
    with suppress(ValueError):
        float(cell)
        return True
    return False


# --- NumPy's files ----------------------------------------------------------------


def _npz(path: Path) -> dict[str, object]:
    names = npz_names(path)
    if "qpos" not in names:
        return load_arrays(path)
    if locomujoco_npz.MARKS & names:
        return load_arrays(path, locomujoco_npz.KEPT, skip_objects=True)
    held = load_arrays(path, skip_objects=True)
    return held if "fps" in held else _with_manifest(path, held)


def _with_manifest(path: Path, held: dict[str, np.ndarray]) -> dict[str, object]:
    """What any4hdmi says of all motions of a folder: names of the columns of `qpos`,
    and the time between frames [s].

    Raises:
        MotionError: the manifest beside the file is damaged, or of another robot.
    """
    for folder in path.absolute().parents[:_ABOVE]:
        place = folder / MANIFEST
        if not place.is_file():
            continue
        try:
            said = json.loads(place.read_text(encoding="utf-8"))
            names = [str(name) for name in said["qpos_names"]]
            rate = round(1.0 / float(said["timestep"]), 6)
        except (OSError, ValueError, KeyError, TypeError, ArithmeticError) as error:
            raise MotionError(
                f"{place}: is to say qpos_names and timestep of {path.name} ({error})"
            ) from None
        ends = [f"t{axis}" for axis in "xyz"] + [f"q{axis}" for axis in "wxyz"]
        root = [k for end in ends for k in range(len(names)) if names[k].endswith(end)]
        qpos = held["qpos"]
        if qpos.ndim != 2 or qpos.shape[1] != len(names) or sorted(root) != [*range(7)]:
            raise MotionError(
                f"{path}: qpos {qpos.shape} is not as {place} names it: the root as "
                f"tx, ty, tz, qw, qx, qy, qz and the joints, {len(names)} columns"
            )
        qpos = qpos[:, [*root, *range(7, len(names))]]
        return held | {
            "qpos": qpos,
            "joint_names": np.array(names[7:]),
            "fps": np.array(rate),
            MANIFEST: MANIFEST,
        }
    return held


def _npy(path: Path) -> object:
    _, dtype, offset = npy_header(path)
    if not dtype.hasobject:
        return load_arrays(path)
    try:
        held = PlainUnpickler(path.read_bytes()[offset:]).load()
    except RefusedPickle as error:
        raise MotionError(f"{path}: {error}") from None
    return held.item() if isinstance(held, np.ndarray) and not held.ndim else held


def _save_npy(file, held: Mapping[str, object]) -> None:
    if "" in held:
        np.save(file, held[""])
        return
    boxed = np.array(None, dtype=object)
    boxed[()] = dict(held)
    header = {"descr": "|O", "fortran_order": False, "shape": ()}
    np.lib.format.write_array_header_1_0(file, header)
    file.write(for_any_numpy(pickle.dumps(boxed, protocol=3)))


# --- what values are asked --------------------------------------------------------


def numbers(
    where: object, held: Mapping[str, object], key: str, *shape: int | None
) -> np.ndarray:
    """The numbers of that shape, in which None is any length; integers become floats.

    Raises:
        MotionError: `where` has none there, or others.
    """
    if key not in held:
        raise MotionError(f"{where}: it has no {key}")
    try:
        array = np.asarray(held[key])
    except ValueError:  # lists of several lengths
        array = np.empty(0, dtype=object)
    if array.ndim == len(shape) + 1 and array.shape[-1] == 1:
        array = array[..., 0]  # some tools keep an axis for a joint's angles
    fits = len(shape) == array.ndim and all(
        a in (None, b) for a, b in zip(shape, array.shape, strict=True)
    )
    if not fits or array.dtype.kind not in "fiu":
        wanted = ", ".join("any" if length is None else str(length) for length in shape)
        raise MotionError(
            f"{where}: {key or 'it'} is an array {array.shape} of {array.dtype}; "
            f"numbers of shape ({wanted}) are expected"
        )
    return array if array.dtype.kind == "f" else array.astype(float)


def texts(value: object) -> tuple[str, ...]:
    """Names in a list or an array; () of anything else."""
    if isinstance(value, list | tuple | np.ndarray):
        return tuple(str(name) for name in np.ravel(np.asarray(value, dtype=object)))
    return ()


def stated_rate(where: object, rate: object, key: str) -> float:
    """The rate that a file states [Hz], as one number or by the times of frames [s].

    Raises:
        MotionError: it is neither.
    """
    values = np.asarray(rate)
    if key == "time" and values.size > 1 and np.ptp(values) > 0.0:
        # The roundest rate whose frames are where times are, as well as they are known.
        frames, times = np.arange(len(values)), values - values[0]
        mean = frames[-1] / times[-1]
        for known in _KNOWN_TIMES:
            for rounded in (round(float(mean), digits) for digits in range(7)):
                if rounded and np.abs(times - frames / rounded).max() < known:
                    return rounded
        raise MotionError(f"{where}: times are not evenly apart: a motion has one rate")
    if values.size != 1 or values.dtype.kind not in "fiu" or key == "time":
        raise MotionError(f"{where}: {key} is {rate}, not one number")
    return float(values.reshape(()))


def joined(names: Sequence[str], most: int = 6) -> str:
    """Some names, for a sentence."""
    return ", ".join(str(name)[:30] for name in list(names)[:most]) or "no layout"
