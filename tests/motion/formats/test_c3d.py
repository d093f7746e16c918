"""C3D files that are cut off are told, and so are names that a terminal obeys."""

import ezc3d
import numpy as np
import pytest

from crar_drake.errors import MotionError, printable
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
    c3d = ezc3d.c3d()
    c3d["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = ["A", "B"]
    c3d["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    c3d["data"]["points"] = np.ones((4, 2, 50))
    file = tmp_path / "a.c3d"
    c3d.write(str(file))
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
