"""Mesh files as trimesh reads them, less what it drops or misreads without a word."""

from __future__ import annotations

import json
import struct
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crar_drake.errors import ModelError

if TYPE_CHECKING:
    import trimesh

# Files whose format defines y as up.
Y_UP = (".gltf", ".glb")
# What is up in a file -> rotation to z up, as COLLADA defines it.
Z_UP = {
    "x": np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]]),
    "y": np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]),
    "z": np.eye(4),
}

_FAN = 6  # the mode of a glTF primitive that is a fan of triangles
_STL_HEAD, _STL_TRIANGLE = 84, 50  # bytes of a binary STL
_HEAD = 20_000  # bytes of a text that begin it


def read_meshes(path: Path, where: str) -> list[trimesh.Trimesh]:
    """The meshes of a file that have triangles, as they stand there.

    Args:
        path: of a file in a format that trimesh reads.

    Raises:
        ModelError: it cannot be read, is cut off, or has what would be lost.
    """
    import trimesh

    suffix = path.suffix.lower()
    if suffix in Y_UP and (unread := _unread_of_gltf(path)):
        raise ModelError(
            f"{where} has {unread}, which are not read; save it without them, or as OBJ"
        )
    try:
        # Unprocessed: what trimesh takes for broken, it leaves out without a word.
        if suffix == ".stl":
            stl = BytesIO(_whole_stl(path.read_bytes()))
            scene = trimesh.load_scene(stl, file_type="stl", process=False)
        else:
            scene = trimesh.load_scene(path, process=False)
        bodies = scene.dump()
    except Exception as error:  # each format's reader has errors of its own
        raise ModelError(f"{where} cannot be read: {error}") from error
    return [b for b in bodies if isinstance(b, trimesh.Trimesh) and len(b.faces)]


def _whole_stl(data: bytes) -> bytes:
    """A binary STL without what follows its triangles; a text as it is.

    ValueError where it has fewer triangles than it says.
    """
    count = int.from_bytes(data[80:_STL_HEAD], "little")
    length = _STL_HEAD + _STL_TRIANGLE * count
    if b"facet" in data[:_HEAD] or len(data) < _STL_HEAD:
        return data
    if len(data) < length:
        there = (len(data) - _STL_HEAD) // _STL_TRIANGLE
        raise ValueError(f"it is cut off: {there} of {count} triangles are there")
    return data[:length]


def _unread_of_gltf(path: Path) -> str:
    """What a glTF file's shape needs and trimesh drops or misreads without a word."""
    data = path.read_bytes()
    try:
        if data[:4] == b"glTF":
            (length,) = struct.unpack_from("<I", data, 12)
            data = data[20 : 20 + length]
        content = json.loads(data)
        packed = [e for e in content.get("extensionsRequired", ()) if "mesh" in e]
        if packed:
            return f"vertices of {', '.join(packed)}"
        if any("sparse" in accessor for accessor in content.get("accessors", ())):
            return "sparse accessors"
        primitives = [p for m in content.get("meshes", ()) for p in m["primitives"]]
        if any(primitive.get("mode") == _FAN for primitive in primitives):
            return "triangle fans"
    except (ValueError, LookupError, TypeError, AttributeError, struct.error):
        pass  # trimesh says what is wrong
    return ""
