"""NumPy's files of arrays, from anywhere: damaged ones are refused."""

import zipfile
from collections.abc import Container
from pathlib import Path
from typing import BinaryIO

import numpy as np

from crar_drake.errors import MotionError

LARGEST = 4 * 2**30  # that a file may unpack to [bytes]


def npy_header(path: Path) -> tuple[tuple[int, ...], np.dtype, int]:
    """Shape and type of an NPY file's array, and where its data begin.

    Raises:
        MotionError: it cannot be read, or is none.
    """
    try:
        with path.open("rb") as file:
            return *_header(file), file.tell()
    except OSError as error:
        raise MotionError(f"{path}: cannot be read: {error.strerror}") from error
    except Exception as error:
        # The header is Python, and so are the errors of its reader.
        raise MotionError(
            f"{path}: it is no NPY file, or one that is damaged ({error})"
        ) from None


def _header(file: BinaryIO) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type of the array that begins here."""
    version = np.lib.format.read_magic(file)
    read = {(1, 0): np.lib.format.read_array_header_1_0}.get(
        version, np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read(file)
    return shape, dtype


def npz_names(path: Path) -> set[str]:
    """Names of the arrays in an NPZ file; none if it cannot be read as one."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {name.removesuffix(".npy") for name in archive.namelist()}
    except (OSError, zipfile.BadZipFile):
        return set()


def load_arrays(
    path: Path, only: Container[str] | None = None, *, skip_objects: bool = False
) -> dict[str, np.ndarray]:
    """The arrays of an NPZ file by name, or the one of an NPY file as "".

    Args:
        only: names of those that are wanted, if not all are; others may hold objects.
        skip_objects: whether wanted ones that hold objects are left out, not refused.

    Raises:
        MotionError: it cannot be read, is damaged, holds objects, or unpacks to more
            than LARGEST.
    """
    try:
        if path.suffix.lower() == ".npy":
            return {"": np.load(path, allow_pickle=False)}
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > LARGEST:
            raise MotionError(
                f"{path}: it unpacks to more than {LARGEST / 2**30:g} GiB"
            )
        with np.load(path, allow_pickle=False) as file:
            wanted = [key for key in file.files if only is None or key in only]
            if skip_objects:
                wanted = [key for key in wanted if not _holds_objects(file, key)]
            return {key: file[key] for key in wanted}
    except MotionError:
        raise
    except ValueError as error:
        # What NumPy says of arrays that are objects is how to run their code.
        why = "" if "pickle" in str(error) else f" ({error})"
        raise MotionError(
            f"{path}: one of its arrays is damaged or holds objects, which are not "
            f"read{why}"
        ) from None
    except MemoryError:
        raise MotionError(
            f"{path}: one of its arrays says that it is larger than the memory"
        ) from None
    except Exception as error:
        # Each unpacker, and NumPy's reader of headers, has errors of its own.
        if isinstance(error, OSError) and error.filename is not None:
            raise MotionError(f"{path}: cannot be read: {error.strerror}") from error
        kind = "NPY" if path.suffix.lower() == ".npy" else "NPZ"
        raise MotionError(
            f"{path}: it is no {kind} file, or one that is damaged, cut off or "
            f"encrypted ({error})"
        ) from None


def _holds_objects(file: np.lib.npyio.NpzFile, key: str) -> bool:
    with file.zip.open(f"{key}.npy") as member:
        return _header(member)[1].hasobject
