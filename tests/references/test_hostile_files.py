"""Small files that ask for much time or memory are refused at once."""

import pickle
import struct
import tracemalloc
import zipfile
from collections import OrderedDict

import numpy as np
import pytest

from crar_drake.errors import MotionError
from crar_drake.motion.plain_pickle import read_plain_pickle
from crar_drake.motion.plain_unpickler import PlainUnpickler
from crar_drake.references.npz_layouts import read_npz

NESTED = b")" + b"2\x86" * 60  # a tuple of itself twice, 60 deep: 2^60 entries
COLLIDING = [k * (2**61 - 1) for k in range(1, 20001)]
# The same hash in a table of up to 2^20 entries, and as long as 40 more bits are not.
CLOSE = [k << 40 for k in range(1, 20001)]
ARRAY = pickle.dumps(np.arange(3.0), protocol=3)


def text(value: bytes) -> bytes:
    return b"X" + struct.pack("<I", len(value)) + value


def joblib_array(shape: bytes) -> bytes:
    """An array as joblib writes it, of any shape."""
    return (
        b"\x80\x03cjoblib.numpy_pickle\nNumpyArrayWrapper\n)\x81}("
        + text(b"subclass") + b"cnumpy\nndarray\n"
        + text(b"shape") + shape
        + text(b"dtype") + b"cnumpy\ndtype\n(" + text(b"f8") + b"tR"
        + b"ub."
    )  # fmt: skip


DEEP = b")" + b"\x85" * 20000

TRICKS = {
    "key": b"}" + NESTED + b"K\x01s.",
    "keys": b"}(" + NESTED + b"K\x01u.",
    "dict": b"(" + NESTED + b"K\x01d.",
    "set": b"\x80\x04\x8f(" + NESTED + b"\x90.",
    "frozenset": b"\x80\x04(" + NESTED + b"\x91.",
    "called set": b"cbuiltins\nset\n](" + NESTED + b"e\x85R.",
    "ordered": b"ccollections\nOrderedDict\n](" + NESTED + b"K\x01\x86e\x85R.",
    "module": b"\x80\x04" + NESTED + text(b"array") + b"\x93.",
    "name": b"\x80\x04" + text(b"numpy") + NESTED + b"\x93.",
    "equal keys": b"}(" + DEEP + b"N" + DEEP + b"Nu.",
    "colliding keys": pickle.dumps(dict.fromkeys(COLLIDING)),
    "close keys": pickle.dumps(dict.fromkeys(CLOSE)),
    "colliding set": b"cbuiltins\nset\n" + pickle.dumps(COLLIDING)[:-1] + b"\x85R.",
    "bytes as length": joblib_array(b"B\x01\x00\x00\x00a\x8a\x05\0\0\0\0\x02\x86"),
    "huge lengths": joblib_array(b"(\x8a\xff" + b"\x7f" * 255 + b"2" * 999 + b"t"),
    "type of types": ARRAY.replace(text(b"f8"), text(b"(1 1)i4,i4")),
    "type of a long name": ARRAY.replace(text(b"f8"), text(b"y" * 10**6)),
    "latin letters": b"c_codecs\nencode\nq\x00" + text(b"a" * 10**5) + text(b"latin1")
    + b"\x86q\x01R" + b"0h\x00h\x01R" * 9999 + b".",
    "bytearrays": b"\x80\x03](cbuiltins\nbytearray\nq\x00"
    + b"B" + struct.pack("<I", 10**5) + bytes(10**5)
    + b"\x85q\x01R" + b"h\x00h\x01R" * 9999 + b"e.",
}  # fmt: skip


@pytest.mark.parametrize(
    "part, end",
    [
        (b"(", b"."),
        (b"]", b"a" * 10),
        (b")", b"\x85" * 10),
        (b")\x85", b"."),
        (b"(1", b""),
    ],
)
def test_megabytes_of_containers_are_refused_before_they_are_all_made(
    tmp_path, monkeypatch, part, end
):
    made = 0
    count = PlainUnpickler.dispatch[part[0]]

    def counted(reader):
        nonlocal made
        made += 1
        count(reader)

    monkeypatch.setitem(PlainUnpickler.dispatch, part[0], counted)
    file = tmp_path / "a.pkl"
    file.write_bytes(part * (6_000_000 // len(part)) + end)
    with pytest.raises(MotionError, match="more than 1000000 containers"):
        read_plain_pickle(file)
    assert made <= 1_000_001


@pytest.mark.parametrize("trick", TRICKS)
def test_a_small_file_takes_little(tmp_path, trick):
    file = tmp_path / "a.pkl"
    file.write_bytes(TRICKS[trick])
    tracemalloc.start()
    try:
        with pytest.raises(MotionError, match=r"a\.pkl: .{10,}") as error:
            read_plain_pickle(file)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 40e6
    assert len(str(error.value)) < 400


def test_ordinary_keys_are_read(tmp_path):
    held = {
        "by frame": dict.fromkeys(range(5000)),
        "ordered": OrderedDict([(1.5, "a"), (None, "b"), (b"c", True)]),
        "named by NumPy": {np.str_("a"): 1, np.int64(3): 2},
        "sets": [{1, 2.5}, frozenset(["a"])],
        "same bytes": [bytes(10**5)] * 100,
        "arrays": [np.arange(1000.0) for _ in range(20)],
    }
    for protocol in (0, 2, 5):
        (tmp_path / "a.pkl").write_bytes(pickle.dumps(held, protocol=protocol))
        found = read_plain_pickle(tmp_path / "a.pkl")
        assert all(map(np.array_equal, found.pop("arrays"), held["arrays"]))
        assert found == {key: held[key] for key in found}


def npz(path, header: bytes, method=zipfile.ZIP_STORED):
    """An archive with one array of that header."""
    header = header.ljust(118 - 1) + b"\n"
    array = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(64)
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("joint_pos.npy", array)
    return path


@pytest.mark.filterwarnings("ignore:Passing in a parenthesized:DeprecationWarning")
@pytest.mark.parametrize(
    "header",
    [
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000000,)}",
        b"{'descr': '(1 1)i4,i4', 'fortran_order': False, 'shape': (3,)}",
        b"{'descr': '<f8', 'fortran_order': False, 'shape': ((((",
    ],
)
def test_an_array_that_claims_nonsense(tmp_path, header):
    with pytest.raises(MotionError, match=r"a\.npz: .{10,}"):
        read_npz(npz(tmp_path / "a.npz", header), None, None, None)


@pytest.mark.parametrize(
    "method, place, byte",
    [
        (zipfile.ZIP_STORED, 6, 1),  # encrypted
        (zipfile.ZIP_STORED, 8, 99),  # an unknown way to pack
        (zipfile.ZIP_LZMA, None, 0xFF),
    ],
)
def test_an_archive_that_cannot_be_unpacked(tmp_path, method, place, byte):
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (8,)}"
    path = npz(tmp_path / "a.npz", header, method)
    data = bytearray(path.read_bytes())
    if place is None:  # what is packed, after the name
        start = 30 + len("joint_pos.npy") + 4
        data[start : start + 20] = bytes([byte]) * 20
    else:  # the same field of the file and of the directory
        data[place] = byte
        data[data.index(b"PK\x01\x02") + place + 2] = byte
    path.write_bytes(data)
    with pytest.raises(MotionError, match=r"a\.npz: .{10,}"):
        read_npz(path, None, None, None)
