"""Files as `torch.save` writes them, byte by byte, without PyTorch."""

import struct
import zipfile
from pathlib import Path

import numpy as np

STORAGES = {"f4": "Float", "f8": "Double", "i8": "Long", "b1": "Bool"}


class Raw(bytes):
    """Opcodes that leave one value."""


def named(module: str, name: str, *arguments: object) -> Raw:
    """A call of a function that the file names."""
    inside = b"".join(opcodes(argument, {}) for argument in arguments)
    return Raw(f"c{module}\n{name}\n".encode() + b"(" + inside + b"tR")


def opcodes(value: object, storages: dict[str, bytes], offset: int = 0) -> bytes:
    """What leaves a value on the stack; the bytes of arrays are put into `storages`."""
    if isinstance(value, Raw):
        return value
    if isinstance(value, bool):
        return b"\x88" if value else b"\x89"
    if isinstance(value, int):
        return b"J" + struct.pack("<i", value)
    if isinstance(value, float):
        return b"G" + struct.pack(">d", value)
    if isinstance(value, str):
        return b"X" + struct.pack("<I", len(value.encode())) + value.encode()
    if isinstance(value, tuple):
        return b"(" + b"".join(opcodes(x, storages) for x in value) + b"t"
    if isinstance(value, dict):
        pairs = (opcodes(x, storages) for pair in value.items() for x in pair)
        return b"}(" + b"".join(pairs) + b"u"
    array = np.asarray(value)
    key = str(len(storages))
    step = array.itemsize
    strides = tuple(stride // step for stride in array.strides)
    last = sum((n - 1) * s for n, s in zip(array.shape, strides, strict=True))
    flat = np.lib.stride_tricks.as_strided(array, (last + 1,), (step,))
    padding = np.full(offset, 7, array.dtype)
    storages[key] = padding.tobytes() + flat.tobytes()
    kind = STORAGES[array.dtype.str[1:]]
    return tensor(key, kind, len(flat) + offset, offset, array.shape, strides)


def tensor(key, kind, length, offset, size, stride) -> Raw:
    """A tensor of a storage."""
    storage = (
        b"(" + opcodes("storage", {}) + f"ctorch\n{kind}Storage\n".encode()
        + opcodes(key, {}) + opcodes("cpu", {}) + opcodes(length, {}) + b"tQ"
    )  # fmt: skip
    hooks = b"\x89ccollections\nOrderedDict\n)R"
    view = opcodes(offset, {}) + opcodes(tuple(size), {}) + opcodes(tuple(stride), {})
    return Raw(b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + view + hooks + b"tR")


def write_torch(
    path: Path, value: object, *, order: str = "little", storages=None, offset: int = 0
) -> Path:
    """Writes a file; `storages` replaces bytes, in which arrays begin at `offset`."""
    held: dict[str, bytes] = {}
    if isinstance(value, dict):
        value = {
            k: Raw(opcodes(x, held, offset)) if isinstance(x, np.ndarray) else x
            for k, x in value.items()
        }
    data = b"\x80\x02" + opcodes(value, held) + b"."
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a/data.pkl", data)
        archive.writestr("a/byteorder", order)
        for key, content in (storages or held).items():
            archive.writestr(f"a/data/{key}", content)
        archive.writestr("a/version", "3\n")
    return path
