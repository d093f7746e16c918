"""Scaling keeps directions, gives exact lengths, and refuses what has no direction."""

import dataclasses

import numpy as np
import pytest

from crar_drake.errors import ModelError, MotionError
from crar_drake.motion.performer import JOINT_CENTRES, Performer, file_joint
from crar_drake.motion.retarget import retarget

LENGTHS = {
    "waist": 0.6,
    "neck": 0.30,
    "left_shoulder": 0.15,
    "left_elbow": 0.20,
    "left_wrist": 0.18,
    "right_shoulder": 0.16,
    "right_elbow": 0.21,
    "right_wrist": 0.19,
}
SEGMENTS = [
    ("waist", "neck"),
    ("neck", "left_shoulder"),
    ("left_shoulder", "left_elbow"),
    ("left_elbow", "left_wrist"),
    ("neck", "right_shoulder"),
    ("right_shoulder", "right_elbow"),
    ("right_elbow", "right_wrist"),
]


@pytest.fixture
def person() -> Performer:
    """Slow (1 Hz and less), so that the default low-pass leaves it alone."""
    rng = np.random.default_rng(3)
    time = np.arange(600) / 120.0
    rest = {
        "waist": (2.0, 1.0, 0.9),
        "neck": (2.0, 1.0, 1.4),
        "left_shoulder": (2.0, 1.2, 1.4),
        "left_elbow": (2.0, 1.5, 1.4),
        "left_wrist": (2.2, 1.5, 1.4),
        "right_shoulder": (2.0, 0.8, 1.4),
        "right_elbow": (2.0, 0.5, 1.3),
        "right_wrist": (2.0, 0.4, 1.1),
    }
    positions = {}
    for name in JOINT_CENTRES:
        phase = rng.uniform(0.0, 6.0, 3)
        wave = np.sin(2.0 * np.pi * np.outer(time, rng.uniform(0.3, 1.0, 3)) + phase)
        positions[file_joint(name)] = rest[name] + 0.03 * wave
    heading = 0.5 * np.sin(2.0 * np.pi * 0.5 * time)
    return Performer(
        name="waves",
        format="none",
        frame_rate=120.0,
        rate_source="given",
        positions=positions,
        heading=heading,
        hip_height=0.9,
        height=1.7,
    )


def test_lengths_are_exact_and_directions_kept(person: Performer) -> None:
    motion = retarget(person, LENGTHS)
    middle = slice(60, -60)  # the filter's ends aside
    for start, end in SEGMENTS:
        length = LENGTHS[end]
        segment = motion.positions[end] - motion.positions[start]
        np.testing.assert_allclose(np.linalg.norm(segment, axis=1), length, rtol=1e-12)
        raw = person.centres()[end] - person.centres()[start]
        raw /= np.linalg.norm(raw, axis=1, keepdims=True)
        np.testing.assert_allclose(
            segment[middle] / length, raw[middle], atol=1e-4, rtol=0
        )


def test_waist_is_scaled_by_hip_height_and_starts_above_the_origin(
    person: Performer,
) -> None:
    waist = retarget(person, LENGTHS).positions["waist"]
    np.testing.assert_allclose(waist[0, :2], 0.0, atol=0)
    raw = person.positions["pelvis"]
    middle = slice(60, -60)
    ratio = 0.6 / 0.9
    np.testing.assert_allclose(waist[middle, 2], ratio * raw[middle, 2], atol=1e-5)
    travel, raw_travel = (p[500, :2] - p[100, :2] for p in (waist, raw))
    np.testing.assert_allclose(travel, ratio * raw_travel, atol=1e-5)


def test_noise_is_filtered_away(person: Performer) -> None:
    clean = retarget(person, LENGTHS)
    hum = 0.002 * np.sin(2.0 * np.pi * 40.0 * np.arange(600) / 120.0)[:, None]
    noisy = dataclasses.replace(
        person,
        positions={name: p + hum for name, p in person.positions.items()},
    )
    middle = slice(60, -60)
    for name, samples in retarget(noisy, LENGTHS).positions.items():
        # The waist moves to its own first sample; compare shapes.
        shift = samples[300] - clean.positions[name][300]
        np.testing.assert_allclose(
            samples[middle] - shift, clean.positions[name][middle], atol=1e-6
        )


def test_trajectory_stacks_three_rows_a_name(person: Performer) -> None:
    motion = retarget(person, LENGTHS)
    trajectory = motion.trajectory(["right_wrist", "neck"])
    assert (trajectory.rows(), trajectory.cols()) == (6, 1)
    assert trajectory.start_time() == 0.0
    assert trajectory.end_time() == motion.duration == pytest.approx(599 / 120)
    t = motion.time[77]
    np.testing.assert_allclose(
        trajectory.value(t)[:, 0],
        [*motion.positions["right_wrist"][77], *motion.positions["neck"][77]],
        atol=1e-12,
    )
    h = 1e-4
    difference = (trajectory.value(t + h) - trajectory.value(t - h)) / (2.0 * h)
    np.testing.assert_allclose(trajectory.EvalDerivative(t, 1), difference, atol=1e-5)


def test_unknown_joint_centre(person: Performer) -> None:
    motion = retarget(person, LENGTHS)
    with pytest.raises(MotionError, match="left_knee.*left_wrist"):
        motion.trajectory(["neck", "left_knee"])
    with pytest.raises(MotionError, match="no joint centre"):
        motion.trajectory([])


def test_segment_without_length_is_refused(person: Performer) -> None:
    positions = dict(person.positions)
    elbow = positions["left_elbow"].copy()
    elbow[41] = positions["left_shoulder"][41]
    positions["left_elbow"] = elbow
    bad = dataclasses.replace(person, positions=positions)
    with pytest.raises(MotionError, match="waves.*left_shoulder.*left_elbow.*frame 42"):
        retarget(bad, LENGTHS)


def test_too_short_or_too_slow_names_the_motion(person: Performer) -> None:
    short = dataclasses.replace(
        person,
        positions={name: p[:2] for name, p in person.positions.items()},
        heading=person.heading[:2],
    )
    with pytest.raises(MotionError, match="waves.*too few"):
        retarget(short, LENGTHS)
    with pytest.raises(MotionError, match="waves.*60 Hz"):
        retarget(person, LENGTHS, cutoff=70.0)


@pytest.mark.parametrize("value", [0.0, -0.1, float("nan"), float("inf")])
def test_robot_lengths_are_positive(person: Performer, value: float) -> None:
    with pytest.raises(ModelError, match="left_elbow to left_wrist"):
        retarget(person, LENGTHS | {"left_wrist": value})
