"""Markers to joint centres: by hand, through gaps, and against the AMC of the trial."""

from pathlib import Path

import ezc3d
import numpy as np
import pytest
from performed import performed

from crar_drake.errors import MotionError
from crar_drake.motion.catalogue import load_clip
from crar_drake.motion.gaps import fill_gaps
from crar_drake.motion.performer import Performer
from crar_drake.motion.performers.asf_amc import asf_amc_performer

T = 60
RATE = 100.0

# A person who stands, x forward, y left, z up [mm]: the left half and the middle.
LEFT = {
    "LASI": (100, 120, 1000),
    "LPSI": (-60, 50, 1000),
    "LSHO": (0, 180, 1450),
    "LELB": (0, 220, 1150),
    "LWRA": (240, 170, 1150),
    "LWRB": (240, 230, 1150),
    "LFIN": (320, 200, 1150),
    "LKNE": (0, 150, 500),
    "LANK": (0, 150, 80),
    "LHEE": (-60, 100, 40),
    "LTOE": (140, 100, 40),
    "LFHD": (80, 70, 1650),
    "LBHD": (-80, 70, 1650),
}
MIDDLE = {
    "C7": (-60, 0, 1480),
    "CLAV": (60, 0, 1420),
    "T10": (-100, 0, 1200),
    "STRN": (100, 0, 1200),
}


def markers() -> dict[str, np.ndarray]:
    """Marker to (T, 3) of a person who floats forwards at 1 m/s [mm]."""
    still = {name: np.array(p, float) for name, p in (LEFT | MIDDLE).items()}
    for name in LEFT:
        still["R" + name[1:]] = still[name] * [1.0, -1.0, 1.0]
    way = np.zeros((T, 3))
    way[:, 0] = 1000.0 * np.arange(T) / RATE
    return {name: p + way for name, p in still.items()}


def write(path: Path, points: dict[str, np.ndarray], unit: str = "mm") -> str:
    """A C3D; NaN becomes a hidden point."""
    c3d = ezc3d.c3d()
    c3d["parameters"]["POINT"]["RATE"]["value"] = [RATE]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = tuple(points)
    c3d["parameters"]["POINT"]["UNITS"]["value"] = (unit,)
    data = np.ones((4, len(points), T))
    data[:3] = np.stack(list(points.values()), axis=1).transpose(2, 1, 0)
    c3d["data"]["points"] = data
    c3d.write(str(path))
    return str(path)


def test_centres_are_those_of_the_regressions(tmp_path) -> None:
    performer = performed(write(tmp_path / "a.c3d", markers()))
    p = {joint: q[0] for joint, q in performer.positions.items()}
    # Harrington: PW = 240 mm, PD = 160 mm, from the middle of the ASIS at (100, 0).
    hip = [
        100 - 0.24 * 160 - 9.9,
        0.33 * 240 + 7.3,
        1000 - 0.30 * 240 - 10.9,
    ]
    np.testing.assert_allclose(p["left_hip"], np.array(hip) / 1e3, atol=1e-6)
    np.testing.assert_allclose(
        p["right_hip"], np.array(hip) * [1, -1, 1] / 1e3, atol=1e-6
    )
    np.testing.assert_allclose(p["pelvis"], [0.02, 0.0, 1.0], atol=1e-6)
    # Rab: 17 % of the 360 mm between the shoulders, along the trunk, down.
    down = np.array([0.0, 0.0, -1.0])
    shoulder = np.array([0.0, 0.18, 1.45]) + 0.17 * 0.36 * down
    np.testing.assert_allclose(p["left_shoulder"], shoulder, atol=1e-6)
    np.testing.assert_allclose(p["left_wrist"], [0.24, 0.2, 1.15], atol=1e-6)
    # Half the widths, inwards.
    np.testing.assert_allclose(p["left_knee"], [0.0, 0.092, 0.5], atol=1e-6)
    np.testing.assert_allclose(p["right_ankle"], [0.0, -0.108, 0.08], atol=1e-6)
    assert p["left_elbow"][1] == pytest.approx(0.22 - 0.041, abs=0.003)
    np.testing.assert_allclose(performer.heading, 0.0, atol=1e-9)
    # Thumbs up, palms facing each other would be z; here the thumb's side is inwards.
    R_WH = performer.hands["left_hand"][0]
    np.testing.assert_allclose(R_WH[:, 0], [1.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(R_WH[:, 2], [0.0, -1.0, 0.0], atol=1e-9)
    assert performer.frame_rate == RATE and performer.up == "+z"
    assert performer.hip_height == pytest.approx(1.0, abs=0.08)


def test_prefixes_other_subjects_and_strange_points_do_not_matter(tmp_path) -> None:
    plain = performed(write(tmp_path / "a.c3d", markers()))
    points = {f"anna:{name.lower()}": q for name, q in markers().items()}
    points |= {"bob:LASI": points["anna:lasi"] + 500.0, "*21": 0.0 * points["anna:c7"]}
    performer = performed(write(tmp_path / "b.c3d", points))
    for joint, q in plain.positions.items():
        np.testing.assert_allclose(performer.positions[joint], q, atol=1e-9)
    assert any("anna is taken; others: bob" in str(fact) for fact in performer.facts)
    assert not any("subjects" in str(fact) for fact in plain.facts)
    second = {f"P2_{name}": q + 900.0 for name, q in markers().items()}
    performer = performed(write(tmp_path / "c.c3d", markers() | second))
    told = "the first is taken; others have P2_LASI, P2_LPSI, P2_LSHO and 27 more"
    assert any(told in str(fact) for fact in performer.facts)


def test_another_unit_and_axes(tmp_path) -> None:
    plain = performed(write(tmp_path / "a.c3d", markers()))
    y_up = {name: q[:, [1, 2, 0]] / 1e3 for name, q in markers().items()}
    performer = performed(write(tmp_path / "b.c3d", y_up, "m"))
    assert (performer.up, performer.facing) == ("+y", "+z")
    for joint, q in plain.positions.items():
        np.testing.assert_allclose(performer.positions[joint], q, atol=1e-6)


def test_a_wrong_unit_makes_a_giant_and_is_refused(tmp_path) -> None:
    path = write(tmp_path / "a.c3d", markers(), "m")
    with pytest.raises(MotionError, match=r"its unit, m, would make .* --unit cm\|mm"):
        performed(path)
    assert performed(path, unit="mm").height == pytest.approx(1.8, abs=0.15)


def test_gaps_are_filled_and_told(tmp_path) -> None:
    plain = performed(write(tmp_path / "a.c3d", markers()))
    points = markers()
    points["LELB"][10:20] = np.nan  # 0.1 s
    points["RKNE"][15:45] = 0.0  # 0.3 s
    points["LFHD"][:] = np.nan
    points["C7"][:5] = np.nan
    performer = performed(write(tmp_path / "b.c3d", points))
    for joint in ("left_elbow", "right_knee", "left_hip"):
        np.testing.assert_allclose(
            performer.positions[joint][5:], plain.positions[joint][5:], atol=1e-5
        )
    assert any("1 gaps of 1 points, 10 frames" in note for note in performer.notes)
    assert any("RKNE" in d and "frames 16 to 45" in d for d in performer.doubts)
    assert any("C7" in d and "frames 1 to 5" in d for d in performer.doubts)
    assert "head" not in performer.positions


def test_a_spline_follows_what_a_line_would_cut() -> None:
    time = np.arange(100) / 100.0
    truth = np.stack([np.sin(6.0 * time), np.cos(6.0 * time), time], axis=1)
    holed = truth.copy()
    holed[40:55] = np.nan
    filled, (gap,) = fill_gaps(holed, 100.0)
    assert (gap.first, gap.last, gap.filled) == (41, 55, "spline")
    np.testing.assert_allclose(filled, truth, atol=3e-3)
    filled, (gap,) = fill_gaps(holed, 50.0)
    assert gap.filled == "line"
    assert np.abs(filled - truth).max() > 0.05


def test_what_is_no_known_set_lists_its_markers(tmp_path) -> None:
    points = {name: q for name, q in markers().items() if name not in ("C7", "RWRB")}
    with pytest.raises(MotionError) as caught:
        performed(write(tmp_path / "a.c3d", points))
    message = str(caught.value)
    assert "would need C7, RWRB, too" in message
    assert "LASI, LPSI, LSHO" in message and "CMU's 41" in message
    never = markers()
    never["RANK"][:] = np.nan
    with pytest.raises(MotionError, match="would need RANK"):
        performed(write(tmp_path / "b.c3d", never))


def test_files_that_are_none(tmp_path) -> None:
    (tmp_path / "a.c3d").write_text("HIERARCHY\n")
    with pytest.raises(MotionError, match="not a readable C3D"):
        performed(str(tmp_path / "a.c3d"))
    with pytest.raises(MotionError, match="no such motion file"):
        performed(str(tmp_path / "none.c3d"))


# --- real recordings ----------------------------------------------------------------


def medians(a: Performer, b: Performer) -> dict[str, float]:
    """Joint to the median distance between two performers [mm]."""
    return {
        joint: 1e3
        * float(
            np.median(np.linalg.norm(a.positions[joint] - b.positions[joint], axis=1))
        )
        for joint in a.positions
        if joint in b.positions
    }


def test_markers_and_fitted_skeleton_of_one_kata(cmu) -> None:
    """135_02: medians of 43 s; the directions are what scaling to a robot keeps."""
    amc = asf_amc_performer(load_clip("cmu:135_02"))
    c3d = performed(str(cmu / "subjects/135/135_02.c3d"))
    far = medians(amc, c3d)
    most = {"ankle": 15, "knee": 40, "hip": 60, "shoulder": 75, "elbow": 70, "toe": 80}
    for joint, median in far.items():
        assert median < most.get(joint.rpartition("_")[2], 250), joint
    assert np.median(np.abs(np.unwrap(amc.heading - c3d.heading))) < np.radians(1.0)
    for side in ("left", "right"):
        for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee")):
            x, y = (
                p.positions[f"{side}_{b}"] - p.positions[f"{side}_{a}"]
                for p in (amc, c3d)
            )
            cosine = np.sum(x * y, axis=1) / np.prod(
                [np.linalg.norm(v, axis=1) for v in (x, y)], axis=0
            )
            assert np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))) < 10.0


def test_bvh_and_amc_of_one_walk(cmu) -> None:
    """131_01: what converted the BVH left out the thorax's bone, and only that."""
    clip = load_clip("cmu:131_01")
    amc = asf_amc_performer(clip)
    bvh = performed(str(cmu / "subjects/131/131_01.bvh"))
    far = medians(amc, bvh)
    for joint, median in far.items():
        leg = joint.endswith(("pelvis", "hip", "knee", "ankle", "toe"))
        assert median == pytest.approx(0.0 if leg else 112.0, abs=0.1), joint
    thorax = clip.skeleton.bones["thorax"].length
    assert 1e3 * thorax == pytest.approx(112.0, abs=0.1)
    np.testing.assert_allclose(bvh.heading, amc.heading, atol=1e-5)
    for joint in ("left_elbow", "right_wrist"):
        np.testing.assert_allclose(
            bvh.positions[joint] - bvh.positions["neck"],
            amc.positions[joint] - amc.positions["neck"],
            atol=1e-4,
        )
