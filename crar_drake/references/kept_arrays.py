"""Arrays that one process finds and the next one need not: in the user's cache."""

import hashlib
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import numpy as np

from crar_drake.errors import WriteError
from crar_drake.files import whole_file
from crar_drake.resources import cached


def place_of(kind: str, depends_on: Iterable[np.ndarray]) -> Path:
    """Where an array is kept, by the contents of all that it depends on."""
    digest = hashlib.sha256()
    for array in depends_on:
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return cached(kind) / f"{digest.hexdigest()[:32]}.npy"


def read_kept(place: Path, dtype: np.dtype | type) -> np.ndarray | None:
    """The array of that type that is kept there; None if there is none."""
    with suppress(Exception):  # damage to a file shows in many ways
        array = np.load(place, allow_pickle=False)
        if array.dtype == dtype:
            return array
    return None


def keep_array(place: Path, array: np.ndarray) -> None:
    """Keeps an array; without a cache it is only found again."""
    with suppress(WriteError), whole_file(place) as path:
        np.save(path, array)
