"""Arrays that one process finds and the next one need not: in the user's cache.

Certificates are made by them. A file ends with the check sum of what is before it.
"""

import hashlib
import io
import zlib
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np

from crar_drake.equations.kept_programs import SOURCES
from crar_drake.errors import WriteError
from crar_drake.files import whole_file
from crar_drake.kept_files import digest_of, mark_used, remove_unused
from crar_drake.resources import cached

_LENGTH = 4  # of a check sum [B]


def place_of(
    kind: str, found_by: Sequence[str], depends_on: Iterable[np.ndarray]
) -> Path:
    """Where an array is kept, by the contents of all that it depends on.

    Args:
        kind: folder of the cache.
        found_by: the modules of `references` whose arithmetic finds it; that of
            `equations` counts anyway.
        depends_on: what it is found from.
    """
    digest = hashlib.sha256(_sources(tuple(found_by)).encode())
    for array in depends_on:
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return cached(kind) / f"{digest.hexdigest()[:32]}.npy"


@cache
def _sources(modules: tuple[str, ...]) -> str:
    here = [Path(__file__).with_name(f"{name}.py") for name in modules]
    return digest_of([*here, *SOURCES])


def read_kept(place: Path, dtype: np.dtype | type) -> np.ndarray | None:
    """The array of that type that is kept there; None if there is none."""
    with suppress(Exception):  # damage to a file shows in many ways
        kept = place.read_bytes()
        data, check_sum = kept[:-_LENGTH], kept[-_LENGTH:]
        array = np.load(io.BytesIO(data), allow_pickle=False)
        if array.dtype == dtype and check_sum == _sum_of(data):
            mark_used(place)
            return array
    return None


def _sum_of(data: bytes) -> bytes:
    return zlib.crc32(data).to_bytes(_LENGTH, "little")


def keep_array(place: Path, array: np.ndarray) -> None:
    """Keeps an array; without a cache it is only found again. What nobody used for
    long goes."""
    file = io.BytesIO()
    np.save(file, array)
    data = file.getvalue()
    with suppress(WriteError), whole_file(place) as path:
        path.write_bytes(data + _sum_of(data))
    remove_unused(place.parent)
