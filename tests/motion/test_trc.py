"""TRC files against C3D and CSV files of the same points."""

from pathlib import Path

import numpy as np
import pytest
from performed import performed
from test_marker_sets import RATE, markers, write

from crar_drake.errors import MotionError
from crar_drake.motion.catalogue import load_clip
from crar_drake.motion.performers.asf_amc import asf_amc_performer

# As Pose2Sim names them; a body's own joints.
NAMES = {
    **{f"{s[0].upper()}{j.capitalize()}": f"{s}_{j}"
       for s in ("right", "left")
       for j in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")},
    "Neck": "neck", "Head": "head",
}  # fmt: skip


def trc_text(points: dict[str, np.ndarray], unit: str = "mm", newline="\n") -> str:
    axes = "\t".join(f"{a}{i + 1}" for i in range(len(points)) for a in "XYZ")
    lines = [
        "PathFileType\t4\t(X/Y/Z)\ta.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate",
        f"{RATE}\t{RATE}\t9\t{len(points)}\t{unit}\t{RATE}\t",
        "Frame#\tTime\t" + "\t\t\t".join(points) + "\t\t",
        f"\t\t{axes}",
        "",
    ]
    rows = np.hstack(list(points.values()))
    for k, row in enumerate(rows):
        cells = ["" if np.isnan(x) else f"{x:.6f}" for x in row]
        lines.append("\t".join([str(k + 1), f"{k / RATE:.3f}", *cells]))
    return newline.join(lines) + newline


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r\r\n"])
def test_markers_are_those_of_a_c3d(newline: str, tmp_path: Path) -> None:
    points = markers()
    points["LELB"][20:23] = np.nan
    truth = performed(write(tmp_path / "a.c3d", points))
    text = trc_text(points, newline=newline)
    (tmp_path / "a.trc").write_bytes(text.encode())
    found = performed(tmp_path / "a.trc")
    assert found.format == "TRC" and found.frame_rate == RATE
    assert found.joints == truth.joints and found.notes == truth.notes
    for joint, p in truth.positions.items():
        np.testing.assert_allclose(found.positions[joint], p, atol=1e-6)
    for hand, R in truth.hands.items():
        np.testing.assert_allclose(found.hands[hand], R, atol=1e-6)


@pytest.mark.parametrize("unit, size", [("m", 1.0), ("mm", 1e3)])
def test_joint_centres_by_their_names(unit: str, size: float, tmp_path: Path) -> None:
    """y up and z ahead, as OpenSim has its files."""
    truth = asf_amc_performer(load_clip("dance"))
    points = {
        name: size * truth.positions[joint][200:260][:, [1, 2, 0]]
        for name, joint in NAMES.items()
    }
    (tmp_path / "a.trc").write_text(trc_text(points, unit))
    found = performed(tmp_path / "a.trc")
    assert found.up == "+y" and found.facing == "+z"
    assert str(found.facts[0]) == f"unit {unit} (of the file)"
    for joint in NAMES.values():
        p = truth.positions[joint][200:260]
        np.testing.assert_allclose(found.positions[joint], p, atol=1e-5)


def changed(line: int, old: str, new: str) -> str:
    lines = trc_text(markers()).split("\n")
    assert old in lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(old, new, 1)
    return "\n".join(lines)


@pytest.mark.parametrize(
    "text, said",
    [
        ("Frame\t1\n" * 9, "no TRC file"),
        ("PathFileType\n", "no TRC file"),
        (changed(3, "mm", "furlong"), "a.trc:3: Units 'furlong'"),
        (changed(3, "100.0", "fast"), "a.trc:3: DataRate 'fast'"),
        (changed(3, "100.0", "-1"), "a.trc:3: DataRate '-1'"),
        (changed(4, "LASI", ""), "a.trc:7: 90 values, but the heading names 29"),
        (changed(9, "120.000000", "x"), "a.trc:9: could not convert"),
        (changed(9, "120.000000", "1e12"), "no unit makes a person"),
        ("\n".join(trc_text(markers()).split("\n")[:5]), "no frames"),
        (trc_text({"LASI": np.zeros((5, 3))}), "no pelvis, neck"),
    ],
)
def test_wrong_files_are_told(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "a.trc").write_text(text)
    with pytest.raises(MotionError, match=said):
        performed(tmp_path / "a.trc")


@pytest.mark.parametrize("points", [markers(), None])
def test_frames_that_are_missing_are_told(points, tmp_path: Path) -> None:
    if points is None:
        dance = asf_amc_performer(load_clip("dance")).positions
        points = {name: 1e3 * dance[joint][200:260] for name, joint in NAMES.items()}
    text = trc_text(points)
    count = len(next(iter(points.values())))
    stated = text.replace("\t9\t", f"\t{count + 5}\t", 1)
    (tmp_path / "a.trc").write_text(stated)
    said = f"{count} of {count + 5} frames are there: cut off?"
    assert said in performed(tmp_path / "a.trc").doubts
    (tmp_path / "a.trc").write_text(text)
    assert not any("cut off" in doubt for doubt in performed(tmp_path / "a.trc").doubts)
