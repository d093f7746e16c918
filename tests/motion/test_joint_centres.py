"""Joint centres against the markers that the same trial was recorded with."""

import ezc3d
import numpy as np
import pytest

from crar_drake.errors import MotionError
from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.formats.asf_amc import (
    Bone,
    Clip,
    Skeleton,
    bone_end,
    clip_tree,
    read_amc,
    read_asf,
)
from crar_drake.motion.performer import JOINT_CENTRES, Performer
from crar_drake.motion.performers.asf_amc import asf_amc_performer, robot_frame


def _skeleton(*, leave_out: tuple[str, ...] = ()) -> Skeleton:
    """A body of straight bones: legs 0.9 m, trunk 0.5 m, T-posed arms."""
    bones = [
        ("leg", "root", (0, -1, 0), 0.9),
        ("trunk", "root", (0, 1, 0), 0.5),
        ("lowerneck", "trunk", (0, 1, 0), 0.1),
        ("lclavicle", "trunk", (1, 0, 0), 0.2),
        ("lhumerus", "lclavicle", (1, 0, 0), 0.3),
        ("lradius", "lhumerus", (1, 0, 0), 0.25),
        ("lwrist", "lradius", (1, 0, 0), 0.05),
        ("rclavicle", "trunk", (-1, 0, 0), 0.2),
        ("rhumerus", "rclavicle", (-1, 0, 0), 0.3),
        ("rradius", "rhumerus", (-1, 0, 0), 0.25),
        ("rwrist", "rradius", (-1, 0, 0), 0.05),
    ]
    return Skeleton(
        "straight",
        {
            name: Bone(name, parent, np.array(direction, float), length, np.zeros(3))
            for name, parent, direction, length in bones
            if name not in leave_out
        },
    )


def _clip(root_rotation: np.ndarray, skeleton: Skeleton | None = None) -> Clip:
    frames = len(root_rotation)
    return Clip(
        name="turn",
        skeleton=skeleton or _skeleton(),
        frame_rate=100.0,
        root_position=np.tile([0.3, 1.0, 2.0], (frames, 1)),
        root_rotation=root_rotation,
        joints={},
    )


@pytest.mark.parametrize(
    "motion", ["dance", "boxing", "cmu:05_02", "cmu:02_01", "cmu:127_23"]
)
def test_a_pelvis_is_not_between_the_hips(motion, request) -> None:
    """Nor is the waist of a robot, which follows it: docs/guides/your-robot.md."""
    if motion.startswith("cmu:"):
        request.getfixturevalue("cmu")
    p = load_performer(motion).positions
    hips = (p["left_hip"] + p["right_hip"]) / 2.0
    trunk = p["neck"] - hips
    share = ((p["pelvis"] - hips) * trunk).sum(axis=1) / (trunk**2).sum(axis=1)
    assert 0.14 < np.median(share) < 0.24


def test_rest_pose_in_the_robot_frame() -> None:
    person = asf_amc_performer(_clip(np.zeros((4, 3))))
    assert tuple(person.centres()) == JOINT_CENTRES
    assert person.hip_height == pytest.approx(0.9)
    np.testing.assert_allclose(person.time, [0.0, 0.01, 0.02, 0.03])
    expected = {  # x forward, y left, z up
        "waist": (2.0, 0.3, 1.0),
        "neck": (2.0, 0.3, 1.5),
        "left_shoulder": (2.0, 0.5, 1.5),
        "left_elbow": (2.0, 0.8, 1.5),
        "left_wrist": (2.0, 1.05, 1.5),
        "right_shoulder": (2.0, 0.1, 1.5),
        "right_elbow": (2.0, -0.2, 1.5),
        "right_wrist": (2.0, -0.45, 1.5),
    }
    for name, p_WC in expected.items():
        np.testing.assert_allclose(person.centres()[name][3], p_WC, atol=1e-12)


def test_heading_follows_turns_beyond_half_a_turn() -> None:
    yaw = np.linspace(0.2, 14.0, 60)
    still = np.zeros_like(yaw)
    person = asf_amc_performer(_clip(np.stack([still, yaw, still], axis=1)))
    np.testing.assert_allclose(person.heading, yaw, atol=1e-12)
    # A positive heading turns the left arm backwards, as about z upwards.
    p_WE, p_WS = person.positions["left_elbow"], person.positions["left_shoulder"]
    arm = np.stack([-np.sin(yaw), np.cos(yaw), still], axis=1)
    np.testing.assert_allclose(p_WE - p_WS, 0.3 * arm, atol=1e-12)


def test_heading_survives_bending_over() -> None:
    """The belly points straight down; the hips still face where they faced."""
    bend = np.linspace(0.0, 1.9, 50)  # beyond 90 degrees
    yaw = np.full_like(bend, 0.8)
    # Rz Ry Rx of the file: first the bend about the left, then the yaw about up.
    person = asf_amc_performer(_clip(np.stack([bend, yaw, 0 * bend], axis=1)))
    np.testing.assert_allclose(person.heading, 0.8, atol=1e-12)


def test_missing_bones_are_named() -> None:
    skeleton = _skeleton(leave_out=("lwrist", "rradius", "rwrist"))
    with pytest.raises(MotionError, match="turn.*straight.*lwrist, rradius, rwrist"):
        asf_amc_performer(_clip(np.zeros((3, 3)), skeleton)).centres()


def test_skeleton_without_legs() -> None:
    skeleton = _skeleton(leave_out=("leg",))
    with pytest.raises(MotionError, match="legs"):
        asf_amc_performer(_clip(np.zeros((3, 3)), skeleton)).centres()


# --- against 135_02.c3d -----------------------------------------------------------


@pytest.fixture(scope="module")
def karate(cmu) -> Clip:
    folder = cmu / "subjects" / "135"
    return read_amc(folder / "135_02.amc", read_asf(folder / "135.asf"))


@pytest.fixture(scope="module")
def person(karate) -> Performer:
    return asf_amc_performer(karate)


@pytest.fixture(scope="module")
def markers(cmu) -> dict[str, np.ndarray]:
    """Marker to (T, 3) position [m]; NaN where it was hidden."""
    c3d = ezc3d.c3d(str(cmu / "subjects" / "135" / "135_02.c3d"))
    point = c3d["parameters"]["POINT"]
    assert point["UNITS"]["value"] == ["mm"]
    data = np.moveaxis(c3d["data"]["points"][:3], 0, -1) / 1000.0
    hidden = c3d["data"]["meta_points"]["residuals"][0] < 0
    data[hidden | np.all(data == 0.0, axis=-1)] = np.nan
    labels = [label.rpartition(":")[2] for label in point["LABELS"]["value"]]
    return dict(zip(labels, data, strict=True))


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances at the frames where both points are seen [m]."""
    assert len(a) == len(b)
    distance = np.linalg.norm(a - b, axis=1)
    seen = np.isfinite(distance)
    assert np.mean(seen) > 0.9
    return distance[seen]


# The fitted skeleton's trunk and forearm are short of the markers: its neck lies at
# the clavicles' common start, low in the chest, and its "wrist" bone is the forearm's
# last third. So the medians differ, but each must be steady in a kata that travels
# over 4 m, kicks, and turns by three full turns.
@pytest.mark.parametrize(
    ("centre", "names", "median", "spread"),
    [
        ("waist", ("LFWT", "RFWT", "LBWT", "RBWT"), 0.06, 0.02),
        ("neck", ("C7",), 0.25, 0.02),
        ("left_shoulder", ("LSHO",), 0.11, 0.025),
        ("right_shoulder", ("RSHO",), 0.11, 0.025),
        ("left_elbow", ("LELB",), 0.10, 0.025),
        ("right_elbow", ("RELB",), 0.10, 0.025),
        ("left_wrist", ("LWRA", "LWRB"), 0.14, 0.04),
        ("right_wrist", ("RWRA", "RWRB"), 0.14, 0.04),
    ],
)
def test_markers_stay_where_they_were_stuck(
    person, markers, centre, names, median, spread
) -> None:
    marker = np.mean([markers[name] for name in names], axis=0)
    distance = _distances(marker, person.centres()[centre])
    assert np.median(distance) < median
    assert np.std(distance) < spread


@pytest.mark.parametrize("side", ["left", "right"])
def test_forearms_point_along_their_markers(person, markers, side) -> None:
    """What scaling keeps: the direction from elbow to wrist."""
    s = side[0].upper()
    marker = (markers[f"{s}WRA"] + markers[f"{s}WRB"]) / 2 - markers[f"{s}ELB"]
    ours = person.positions[f"{side}_wrist"] - person.positions[f"{side}_elbow"]
    marker /= np.linalg.norm(marker, axis=1, keepdims=True)
    ours /= np.linalg.norm(ours, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip(np.sum(marker * ours, axis=1), -1, 1)))
    assert np.nanmedian(angle) < 7.0
    assert np.nanpercentile(angle, 95) < 13.0


@pytest.mark.parametrize("side", ["left", "right"])
def test_thumb_sides_are_those_of_the_markers(person, markers, side) -> None:
    """Markers WRA and WRB sit at the thumb's and the other side of the wrist."""
    s = side[0].upper()
    across = markers[f"{s}WRA"] - markers[f"{s}WRB"]
    thumb = np.einsum("tji,tj->ti", person.hands[f"{side}_hand"], across)
    thumb /= np.linalg.norm(thumb, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip(thumb[:, 2], -1.0, 1.0)))
    assert np.nanpercentile(angle, 95) < 40.0
    assert np.nanmedian(angle) < 20.0


@pytest.mark.parametrize("side", ["L", "R"])
def test_ankles_agree_to_millimetres(karate, markers, side) -> None:
    """The legs are fitted tightly: scale, axes and timing are all proved here."""
    bone = f"{side.lower()}tibia"
    ankle = robot_frame(bone_end(karate.skeleton, clip_tree(karate), bone))
    distance = _distances(markers[f"{side}ANK"], ankle)
    assert 0.04 < np.median(distance) < 0.06
    assert np.std(distance) < 0.002


def test_pirouette_turns_the_hips_once(cmu) -> None:
    folder = cmu / "subjects" / "05"
    clip = read_amc(folder / "05_02.amc", read_asf(folder / "05.asf"))
    heading = np.degrees(asf_amc_performer(clip).heading)
    turn = heading[180:] - heading[:-180]  # within 1.5 s
    assert np.abs(turn).max() == pytest.approx(350.0, abs=10.0)
