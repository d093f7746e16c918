"""Pickles of data come out as Python's own reader has them; all others are refused."""

import gzip
import os
import pickle
import struct
import sys
import types
import zlib
from collections import OrderedDict
from pathlib import Path

import numpy as np
import pytest

from crar_drake.errors import MotionError
from crar_drake.motion.plain_pickle import read_plain_pickle, write_plain_pickle

DATA = {
    "clip": OrderedDict(
        dof=np.arange(12.0).reshape(3, 4),
        turned=np.asfortranarray(np.arange(6, dtype=np.float32).reshape(2, 3)),
        empty=np.zeros((0, 3)),
        big_endian=np.arange(3, dtype=">f8"),
        flags=np.array([True, False]),
        texts=np.array(["a", "bcd"]),
        fps=30,
        scalar=np.float64(0.1),
        small=np.float32(0.1),
        names=["a", "b"],
        nothing=None,
        mixed=(1, -2.5, 10**30, b"\x00\xff", "ü", True, {1, 2}, frozenset([3])),
        shared=None,
    )
}
DATA["clip"]["shared"] = DATA["clip"]["dof"]
# What NumPy's own pickles become: arrays in the machine's byte order.
NATIVE = {"clip": DATA["clip"] | {"big_endian": np.arange(3.0)}}


def same(a, b) -> bool:
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return type(a) is type(b) and all(map(same, a, b)) and len(a) == len(b)
    if isinstance(a, np.ndarray):
        return a.shape == b.shape and np.array_equal(a, b) and a.dtype == b.dtype
    return type(a) is type(b) and a == b


@pytest.mark.parametrize("protocol", range(6))
def test_every_protocol_reads_as_python_reads_it(tmp_path: Path, protocol: int):
    file = tmp_path / "a.pkl"
    file.write_bytes(pickle.dumps(DATA, protocol=protocol))
    assert same(pickle.loads(file.read_bytes()), read_plain_pickle(file))


@pytest.mark.parametrize("name", [b"numpy.core.multiarray", b"numpy._core.multiarray"])
def test_names_of_numpy_1_and_2(tmp_path: Path, name: bytes):
    data = pickle.dumps(np.arange(4.0), protocol=3)
    data = data.replace(b"numpy._core.multiarray", name)
    assert name in data
    (tmp_path / "a.pkl").write_bytes(data)
    assert np.array_equal(read_plain_pickle(tmp_path / "a.pkl"), np.arange(4.0))


def test_what_is_written_is_read_by_pickle_and_has_no_name_of_numpy_2(tmp_path: Path):
    file = tmp_path / "a.pkl"
    write_plain_pickle(file, DATA)
    assert same(NATIVE, pickle.loads(file.read_bytes()))
    assert same(NATIVE, read_plain_pickle(file))
    assert b"numpy._core" not in file.read_bytes()


# --- joblib -----------------------------------------------------------------------


class JoblibLike(pickle._Pickler):
    """Writes as joblib does: a description of an array, padding, then its bytes."""

    def save(self, obj, save_persistent_id=True):
        if not isinstance(obj, np.ndarray):
            return super().save(obj, save_persistent_id)
        wrapper = sys.modules["joblib.numpy_pickle"].NumpyArrayWrapper()
        fortran = obj.flags.f_contiguous and not obj.flags.c_contiguous
        wrapper.subclass, wrapper.shape, wrapper.dtype = (
            np.ndarray,
            obj.shape,
            obj.dtype,
        )
        wrapper.order, wrapper.allow_mmap = "F" if fortran else "C", True
        wrapper.numpy_array_alignment_bytes = 16
        super().save(wrapper)
        padding = 16 - (self.file.tell() + 1) % 16
        self.file.write(bytes([padding]) + b"\xff" * padding)
        self.file.write(obj.tobytes(order=wrapper.order))


@pytest.fixture
def joblib_file(tmp_path: Path, monkeypatch) -> Path:
    module = types.ModuleType("joblib.numpy_pickle")
    module.NumpyArrayWrapper = type(
        "NumpyArrayWrapper", (), {"__module__": "joblib.numpy_pickle"}
    )
    monkeypatch.setitem(sys.modules, "joblib", types.ModuleType("joblib"))
    monkeypatch.setitem(sys.modules, "joblib.numpy_pickle", module)
    with (tmp_path / "a.pkl").open("wb") as file:
        pickler = JoblibLike(file, protocol=3)
        pickler.file = file
        pickler.dump(DATA)
    return tmp_path / "a.pkl"


def test_a_file_as_joblib_writes_it(joblib_file: Path):
    assert same(DATA, read_plain_pickle(joblib_file))


def test_a_compressed_file_as_joblib_writes_it(joblib_file: Path):
    data = joblib_file.read_bytes()
    streams = gzip.compress(data[:99]) + gzip.compress(data[99:])
    for packed in (zlib.compress(data, 3), gzip.compress(data), streams):
        joblib_file.write_bytes(packed)
        assert same(DATA, read_plain_pickle(joblib_file))
        joblib_file.write_bytes(packed[: len(packed) // 2])
        with pytest.raises(MotionError, match="cut off"):
            read_plain_pickle(joblib_file)


def test_joblib_itself(tmp_path: Path):
    joblib = pytest.importorskip("joblib")
    for compress in (0, 3, ("gzip", 3), ("xz", 3), ("lzma", 3), ("bz2", 3)):
        joblib.dump(DATA, tmp_path / "a.pkl", compress=compress)
        assert same(DATA, read_plain_pickle(tmp_path / "a.pkl"))
    write_plain_pickle(tmp_path / "b.pkl", DATA)
    assert same(NATIVE, joblib.load(tmp_path / "b.pkl"))


# --- hostile ----------------------------------------------------------------------


class Does:
    """What a hostile pickle does when Python's own reader loads it."""

    def __init__(self, function, *arguments):
        self.reduced = function, arguments

    def __reduce__(self):
        return self.reduced


def hostile(marker: str) -> dict[str, bytes]:
    """Pickles that make a file, or try other tricks; only data may pass."""
    touch = f"open({marker!r}, 'w')"
    text = marker.encode()
    numpy_call = b"cnumpy\n%s\n(X" + struct.pack("<I", len(text)) + text + b"tR."
    array = pickle.dumps(np.arange(3.0), protocol=3)
    return {
        "system": pickle.dumps(Does(os.system, f"touch {marker}")),
        "eval": pickle.dumps(Does(eval, touch)),
        "exec, protocol 0": pickle.dumps(Does(exec, touch), protocol=0),
        "open": pickle.dumps(Does(open, marker, "w")),
        "getattr": pickle.dumps(Does(getattr, np.arange(3.0), "tofile")),
        "import": pickle.dumps(Does(__import__, "os")),
        "in a list": pickle.dumps([1, {"a": Does(os.system, f"touch {marker}")}]),
        "numpy.fromfile": numpy_call % b"fromfile",
        "numpy.load": numpy_call % b"load",
        "dotted name": b"\x80\x04\x8c\x05numpy\x8c\x0endarray.tofile\x93.",
        "dotted module": b"cnumpy.core.multiarray\n_reconstruct.__globals__\n.",
        "inst": b"(S'touch'\nios\nsystem\n.",
        "obj": b"(cos\nsystem\nS'touch'\no.",
        "persistent id": b"Pabc\n.",
        "extension": b"\x80\x02\x82\x01.",
        "new with keywords": b"\x80\x04cnumpy\ndtype\n)}\x92.",
        "attributes of a dict": b"}}b.",
        "call of data": b"X\x03\x00\x00\x00abc)R.",
        "call of a list": b"])R.",
        "subclass of arrays": array.replace(b"cnumpy\nndarray", b"cnumpy\nmatrix"),
        "objects": pickle.dumps(np.array([None, 1], dtype=object)),
        "records": pickle.dumps(np.zeros(2, dtype=[("a", "f8"), ("b", "O")])),
        "dates": pickle.dumps(np.array(["2020-01-01"], dtype="M8[D]")),
        "shape beyond the data": array.replace(b"K\x03\x85", b"K\x7f\x85"),
        "negative shape": array.replace(b"K\x03\x85", b"J\xff\xff\xff\xff\x85"),
        "bytes beyond the file": b"\x80\x04\x8e" + struct.pack("<Q", 2**62) + b"a.",
        "texts beyond the file": b"X\xff\xff\xff\x7fa.",
        "out of band": b"\x80\x05\x97.",
        "no end": b"]",
        "nothing on the stack": b".",
        "noise": bytes(range(200, 256)) * 9,
        "memo": b"h\x07.",
        "dict of dicts as keys": b"}}]s.",
        "array as key": b"}" + array[2:-1] + b"Ns.",
    }


@pytest.mark.parametrize("trick", hostile("x"))
def test_a_hostile_pickle_is_refused_and_does_nothing(tmp_path: Path, trick: str):
    marker = tmp_path / "marker"
    file = tmp_path / "a.pkl"
    file.write_bytes(hostile(str(marker))[trick])
    with pytest.raises(MotionError, match=r"a\.pkl: .{10,}"):
        read_plain_pickle(file)
    assert not marker.exists()


def test_the_tricks_are_real(tmp_path: Path):
    """Python's own reader falls for the first ones."""
    marker = tmp_path / "marker"
    pickle.loads(hostile(str(marker))["system"])
    assert marker.exists()


def test_the_message_names_what_was_named(tmp_path: Path):
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(Does(os.system, "true")))
    with pytest.raises(MotionError, match=r"it names posix\.system, which is no plain"):
        read_plain_pickle(tmp_path / "a.pkl")
    (tmp_path / "a.pkl").write_bytes(b"ctorch._utils\n_rebuild_tensor_v2\n.")
    with pytest.raises(MotionError, match="save tensors as arrays"):
        read_plain_pickle(tmp_path / "a.pkl")


def test_a_file_that_unpacks_to_far_more_is_refused(tmp_path: Path):
    packer = zlib.compressobj(9)
    zeros = bytes(2**20)
    data = b"".join(packer.compress(zeros) for _ in range(200)) + packer.flush()
    (tmp_path / "a.pkl").write_bytes(data)
    with pytest.raises(MotionError, match="unpacks to more than"):
        read_plain_pickle(tmp_path / "a.pkl")


def test_every_cut_of_a_file_is_refused(tmp_path: Path):
    data = pickle.dumps(DATA)
    file = tmp_path / "a.pkl"
    for end in range(0, len(data) - 1, 7):
        file.write_bytes(data[:end])
        with pytest.raises(MotionError):
            read_plain_pickle(file)


def test_a_changed_byte_never_ends_in_a_traceback(tmp_path: Path):
    data = bytearray(pickle.dumps(DATA))
    random = np.random.default_rng(0)
    file = tmp_path / "a.pkl"
    for place in random.integers(0, len(data), 300):
        changed = bytearray(data)
        changed[place] = random.integers(256)
        file.write_bytes(changed)
        try:
            read_plain_pickle(file)
        except MotionError:
            pass
