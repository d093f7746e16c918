"""Whether a file holds a motion of a robot's own joints, or one of a person."""

import os
from mmap import PROT_READ, mmap
from pathlib import Path

import numpy as np

from crar_drake.motion.array_files import npy_header, npz_names
from crar_drake.motion.text_files import read_motion_text

# Suffixes of robot motions, each to the one that the same files usually have.
SUFFIXES = {
    **{usual: usual for usual in (".csv", ".npz", ".npy", ".pkl")},
    **{also: ".pkl" for also in (".pickle", ".joblib", ".p")},
}

# How names of files with labels of contacts end, which lie beside motions.
CONTACTS_SUFFIX = ".contacts.csv"

# Of which a robot's NPZ has one: the joints.
_NPZ_KEYS = {"joint_pos", "dof_positions", "qpos"}

# What a pickle of a person has for a key (WHAM's).
_PERSON = b"pose_world"

# Columns of the root's position in a CSV with a heading: BONES-SEED's, and others'.
NAMED_ROOT = tuple(f"root_translate{axis}" for axis in "XYZ")
HEADINGS = (NAMED_ROOT, ("root_x", "root_y", "root_z", "root_qw"))


def is_reference(path: str | os.PathLike[str]) -> bool:
    """Whether a path has the suffix of a robot motion; its contents are not asked."""
    path = Path(path)
    of_contacts = path.name.endswith(CONTACTS_SUFFIX)
    return path.suffix.lower() in SUFFIXES and not of_contacts


def holds_reference(path: str | os.PathLike[str]) -> bool:
    """Whether a file has the suffix of a robot motion, and does not hold a person's
    points instead: those are in a CSV with a heading that names no robot's root, an
    NPZ without joints, a pickle of WHAM, or an NPY without a
    dict or quaternions.

    A file that cannot be read is none; whoever reads it says why.
    """
    path = Path(path)
    if not is_reference(path):
        return False
    try:
        if path.suffix.lower() == ".csv":
            lines = read_motion_text(path).split("\n", 100)
            data = (line for line in lines if not line.lstrip().startswith("#"))
            first = next(filter(str.strip, data), "")
            return _is_numbers(first) or is_named(first)
        if path.suffix.lower() == ".npy":
            shape, dtype, _ = npy_header(path)
            if dtype.hasobject or len(shape) != 2 or not shape[0]:
                return dtype.hasobject
            quaternion = np.load(path, mmap_mode="r")[0, 3:7]
            return bool(abs(np.linalg.norm(quaternion) - 1.0) < 0.1)
        if SUFFIXES[path.suffix.lower()] == ".pkl":
            with (
                path.open("rb") as file,
                mmap(file.fileno(), 0, prot=PROT_READ) as data,
            ):
                return data.find(_PERSON) < 0
        if path.suffix.lower() == ".npz":
            return bool(_NPZ_KEYS & npz_names(path))
    except (OSError, ValueError):  # MotionError is one
        return False
    return True


def is_named(line: str) -> bool:
    """Whether a line is the heading of a robot's motion: it has columns of a root."""
    cells = {cell.strip() for cell in cells_of(line)}
    return any(cells >= set(names) for names in HEADINGS)


def _is_numbers(line: str) -> bool:
    try:
        return bool([float(cell) for cell in cells_of(line)])
    except ValueError:
        return False


def cells_of(line: str) -> list[str]:
    """The cells of a line: between commas, else semicolons, else blanks or tabs."""
    line = line.strip()
    if ";" in line:  # a comma beside it is a decimal one, which is no number
        return line.split(";")
    return line.split(",") if "," in line else line.split()
