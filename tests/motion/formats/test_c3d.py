"""C3D files that are cut off are told, and so are names that a terminal obeys."""

import ezc3d
import numpy as np
import pytest

from crar_drake.errors import MotionError, printable
from crar_drake.motion.formats import c3d
from crar_drake.motion.formats.c3d import read_c3d


@pytest.mark.parametrize(
    "cut, message",
    [
        (1, "49 of 50 frames"),
        (1200, "in its data"),
        (3000, "cut off"),
        (3400, "cut off"),
    ],
)
def test_a_file_that_is_cut_off_is_told(tmp_path, cut, message) -> None:
    made = ezc3d.c3d()
    made["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    made["parameters"]["POINT"]["LABELS"]["value"] = ["A", "B"]
    made["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    made["data"]["points"] = np.ones((4, 2, 50))
    file = tmp_path / "a.c3d"
    made.write(str(file))
    assert len(read_c3d(file).positions) == 50
    data = file.read_bytes()
    end = data.rstrip(b"\0") if len(data) % 512 == 0 else data
    whole = 512 * (data[16] - 1) + 50 * 2 * 16
    assert len(end) <= len(data) and whole <= len(data)
    file.write_bytes(data[: whole - cut] if whole > cut else b"")
    with pytest.raises(MotionError, match=message):
        read_c3d(file)


def test_what_a_terminal_obeys_is_escaped() -> None:
    assert printable("\x1b[31mH\u00fcfte\x9b\u202e\n") == (
        "\\x1b[31mH\u00fcfte\\x9b\\u202e\n"
    )


def points_file(path) -> bytes:
    made = ezc3d.c3d()
    made["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    made["parameters"]["POINT"]["LABELS"]["value"] = [f"M{i}" for i in range(20)]
    made["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    made["data"]["points"] = np.ones((4, 20, 50))
    made.write(str(path))
    return path.read_bytes()


@pytest.mark.parametrize(
    "changes",
    [
        # Found by changing bytes at random: each crashes ezc3d, the last keeps it.
        {852: 205},
        {453: 216, 1121: 163},
        {303: 122, 997: 188},
        {1152: 236, 1516: 103},
        {142: 246, 771: 204},
        {557: 234, 699: 156, 1192: 197},
    ],
)
def test_changed_bytes_end_no_process(tmp_path, changes) -> None:
    """Here or in another version of ezc3d: it is read, or refused by name."""
    file = tmp_path / "a.c3d"
    data = bytearray(points_file(file))
    assert read_c3d(file).positions.shape == (50, 20, 3)
    for place, value in changes.items():
        data[place] = value
    file.write_bytes(data)
    try:
        read_c3d(file)
    except MotionError as error:
        assert str(error).startswith(f"{file}: ")


def test_a_reader_that_crashes_or_does_not_end_is_told(tmp_path, monkeypatch) -> None:
    file = tmp_path / "a.c3d"
    points_file(file)
    child = tmp_path / "child.py"
    monkeypatch.setattr(c3d, "_CHILD", child)
    child.write_text("import os; os.abort()")
    with pytest.raises(MotionError, match="a.c3d: .*ezc3d crashes"):
        read_c3d(file)
    child.write_text("import time; time.sleep(1000)")
    with monkeypatch.context() as hasty:
        hasty.setattr(c3d, "_PATIENCE", 0.2)
        with pytest.raises(MotionError, match="a.c3d: .*does not come to an end"):
            read_c3d(file)
    child.write_text("import sys; sys.exit('no points\\x1b in it')")
    with pytest.raises(MotionError, match=r"a.c3d: .*: no points\\x1b in it"):
        read_c3d(file)
