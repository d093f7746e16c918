"""Files of `torch.save`, read without PyTorch and without running what is in them.

Such a file is a zip: `NAME/data.pkl`, a pickle of plain containers in which a tensor is
a call of `torch._utils._rebuild_tensor_v2` with a storage, an offset, a size and
strides (in numbers), and `NAME/data/KEY`, the bytes of each storage. The pickle is read
by `plain_pickle`, with the names below besides. Files of PyTorch before 1.6 are no
zips, and are not read. Source: `torch/serialization.py` and `torch/_utils.py` of
github.com/pytorch/pytorch.
"""

import math
import os
import zipfile
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.array_files import LARGEST
from crar_drake.motion.plain_pickle import KNOWN, PlainUnpickler, RefusedPickle

# PyTorch's storages by their numbers' types in NumPy, little-endian.
_STORAGES = {
    "DoubleStorage": "<f8",
    "FloatStorage": "<f4",
    "HalfStorage": "<f2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ShortStorage": "<i2",
    "CharStorage": "|i1",
    "ByteStorage": "|u1",
    "BoolStorage": "|b1",
}

# Enumerations of ProtoMotions' files; what stands for them is their text.
_ENUMERATIONS = (
    ("protomotions.simulator.base_simulator.simulator_state", "StateConversion"),
)

# How often its own size a file's tensors may have, beyond what is small [bytes]: one
# that is expanded refers to the same numbers again and again.
_LARGEST_RATIO, _SMALL = 100, 64 * 2**20


def read_torch_zip(path: str | os.PathLike[str]) -> object:
    """What a file of `torch.save` holds: as `read_plain_pickle`, tensors as arrays.

    Raises:
        MotionError: it cannot be read, is no such file, is damaged, or holds more than
            tensors and plain data.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            return _TorchUnpickler(archive, path.stat().st_size).load()
    except RefusedPickle as error:
        raise MotionError(
            f"{path}: {error}; what PyTorch itself can load, save as arrays "
            "(`np.savez` of `tensor.numpy()`)"
        ) from None
    except OSError as error:
        raise MotionError(f"{path}: cannot be read: {error.strerror}") from error
    except Exception as error:
        # Python's reader of zips has errors of all kinds.
        raise MotionError(
            f"{path}: it is no zip of torch.save, or one that is damaged or cut off "
            f"({error}); files of PyTorch before 1.6 are not read"
        ) from None


class _Storage:
    """A named array of numbers in the zip."""

    def __init__(self, dtype: np.dtype, key: str, length: int) -> None:
        self.dtype, self.key, self.length = dtype, key, length


class _TorchUnpickler(PlainUnpickler):
    def __init__(self, archive: zipfile.ZipFile, size: int) -> None:
        pickles = [n for n in archive.namelist() if n.endswith("/data.pkl")]
        if len(pickles) != 1:
            raise RefusedPickle("it has no data.pkl, or several")
        self._archive = archive
        self._folder = pickles[0].removesuffix("data.pkl")
        order = self._folder + "byteorder"
        if order in archive.namelist() and self._bytes(order, 16).strip() != b"little":
            raise RefusedPickle("its bytes are big-endian")
        self._most = min(LARGEST, _SMALL + _LARGEST_RATIO * size)
        self._made = 0
        super().__init__(self._bytes(pickles[0], _SMALL))
        self.known = {
            **KNOWN,
            ("torch._utils", "_rebuild_tensor_v2"): self._tensor,
            **{("torch", name): np.dtype(kind) for name, kind in _STORAGES.items()},
            **dict.fromkeys(_ENUMERATIONS, str),
        }

    def _bytes(self, name: str, most: int) -> bytes:
        with self._archive.open(name) as file:
            data = file.read(most + 1)
        if len(data) > most:
            raise RefusedPickle(f"its {name} is too large")
        return data

    def persistent_load(self, pid: tuple) -> _Storage:
        """A storage: ("storage", type, key, device, length)."""
        _, dtype, key, _, length = pid
        return _Storage(dtype, key, length)

    def _tensor(self, storage, offset, size, stride, *rest) -> np.ndarray:
        if not isinstance(storage, _Storage):
            raise RefusedPickle("a tensor has no storage")
        numbers = (storage.length, offset, *size, *stride)
        if len(size) != len(stride) or min(numbers) < 0:
            raise RefusedPickle("a tensor is damaged")
        empty = 0 in size
        last = offset + sum((n - 1) * s for n, s in zip(size, stride, strict=True))
        if not empty and last >= storage.length:
            raise RefusedPickle("a tensor is larger than its storage")
        step = storage.dtype.itemsize
        self._made += math.prod(size) * step + storage.length * step
        if self._made > self._most:
            raise RefusedPickle("its tensors are too large for the file")
        name = f"{self._folder}data/{storage.key}"
        data = self._bytes(name, storage.length * step)
        if len(data) != storage.length * step:
            raise RefusedPickle("a tensor's storage is cut off")
        if empty:
            return np.zeros(size, storage.dtype)
        flat = np.frombuffer(data, storage.dtype)[offset:]
        strides = [step * s for s in stride]
        return np.lib.stride_tricks.as_strided(flat, size, strides).copy()
