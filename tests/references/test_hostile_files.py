"""Small files that ask for much memory are refused at once."""

import struct
import zipfile

import pytest

from crar_drake.errors import MotionError
from crar_drake.references.motion_files import read_motion


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
        read_motion(npz(tmp_path / "a.npz", header))


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
        read_motion(path)
