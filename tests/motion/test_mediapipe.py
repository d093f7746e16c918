"""MediaPipe's world landmarks: their JSON, and the travel that they do not have."""

import json
from pathlib import Path

import numpy as np
import pytest

from crar_drake.errors import MotionError
from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import Performer
from crar_drake.motion.point_layouts import LAYOUTS
from crar_drake.motion.travel import pinned_pelvis, travelling

NAMES = LAYOUTS["MediaPipe-33"]
RATE, STEP, STRIDE, LEG = 50.0, 0.5, 0.6, 0.42  # [Hz], [s], [m], thigh and shank [m]


def walk(steps: int = 6) -> dict[str, np.ndarray]:
    """Joint to (T, 3) of a person who walks along x; feet stand and swing in turn.

    By hand: a foot stands while the other goes two strides in a step, lifted by up to
    8 cm; the pelvis goes along at their mean.
    """
    t = np.arange(int(steps * STEP * RATE)) / RATE
    feet = {}
    for side, y, first in (("left", 0.1, 0), ("right", -0.1, 1)):
        number, phase = np.divmod(t / STEP, 1.0)
        swings = number % 2 == first
        done = (number - first + 1) // 2
        ahead = np.where(swings, phase - np.sin(2 * np.pi * phase) / (2 * np.pi), 0.0)
        feet[side] = np.column_stack(
            [
                2 * STRIDE * (done + ahead) - (STRIDE if first == 0 else 0.0),
                np.full_like(t, y),
                np.where(swings, 0.08 * np.sin(np.pi * phase) ** 2, 0.0),
            ]
        )
    middle = (feet["left"] + feet["right"]) / 2.0
    p = {"pelvis": np.column_stack([middle[:, 0], 0 * t, 0.86 + 0.01 * np.cos(9 * t)])}
    up = np.array([0.0, 0.0, 1.0])
    for side, y in (("left", 1.0), ("right", -1.0)):
        across = np.array([0.0, 0.1 * y, 0.0])
        p[f"{side}_hip"] = p["pelvis"] + across
        p[f"{side}_ankle"] = feet[side] + 0.07 * up
        p[f"{side}_toe"] = feet[side] + [0.15, 0.0, 0.0]
        between = (p[f"{side}_hip"] + p[f"{side}_ankle"]) / 2.0
        p[f"{side}_knee"] = between + [0.05, 0.0, 0.0]
        p[f"{side}_shoulder"] = p["pelvis"] + 2.0 * across + 0.5 * up
        p[f"{side}_elbow"] = p[f"{side}_shoulder"] - 0.28 * up
        p[f"{side}_wrist"] = p[f"{side}_elbow"] + [0.1, 0.0, -0.22]
    p["neck"] = p["pelvis"] + 0.5 * up
    p["head"] = p["pelvis"] + 0.65 * up
    return p


def landmarks(p: dict[str, np.ndarray]) -> np.ndarray:
    """(T, 33, 3) as a camera ahead sees them: x right, y down, z away from it."""
    found = dict(p)
    for side in ("left", "right"):
        found[f"{side}_foot_index"] = p[f"{side}_toe"]
        found[f"{side}_ear"] = p["head"]
    points = np.stack([found.get(name, p["head"]) for name in NAMES], axis=1)
    points = points - p["pelvis"][:, None] + [0.002, 0.001, -0.003]
    return np.stack([points[..., 1], -points[..., 2], -points[..., 0]], axis=-1)


def as_dicts(frame: np.ndarray) -> list[dict]:
    return [dict(x=x, y=y, z=z, visibility=0.9) for x, y, z in frame.tolist()]


def performed(path: Path, **options) -> Performer:
    return load_performer(str(path), MotionOptions(**options))


WALK = walk()
SEEN = landmarks(WALK)


def written(folder: Path, held: object) -> Path:
    (folder / "a.json").write_text(json.dumps(held))
    return folder / "a.json"


def in_every_style() -> dict[str, object]:
    frames = [as_dicts(frame) for frame in SEEN]
    times = [1000.0 * k / RATE for k in range(len(SEEN))]
    return {
        "lists": {"fps": RATE, "frames": SEEN.tolist()},
        "dicts": {"frame_rate": RATE, "frames": frames},
        "python": [
            dict(pose_landmarks=None, pose_world_landmarks=[frame], timestamp_ms=t)
            for frame, t in zip(frames, times, strict=True)
        ],
        "javascript": [
            dict(landmarks=[[dict(x=0.5)]], worldLandmarks=[frame], time=t / 1000.0)
            for frame, t in zip(frames, times, strict=True)
        ],
        "protobuf": [
            dict(poseWorldLandmarks={"landmark": frame}, timestamp_ms=t)
            for frame, t in zip(frames, times, strict=True)
        ],
        "people's": {"fps": RATE, "frames": [dict(landmarks=f) for f in frames]},
    }


@pytest.mark.parametrize("style", in_every_style())
def test_every_style_is_read_and_travels(style: str, tmp_path: Path) -> None:
    found = performed(written(tmp_path, in_every_style()[style]))
    assert found.frame_rate == pytest.approx(RATE) and found.up == "-y"
    assert found.facing == "-z"
    facts = {fact.what: str(fact) for fact in found.facts}
    assert "from feet that stand" in facts["travel"]
    assert not pinned_pelvis(found)
    way = found.positions["pelvis"][:, 0]
    truth = WALK["pelvis"][:, 0]
    error = np.abs(way - way[0] - (truth - truth[0])).max()
    assert error < 0.05 * np.ptp(truth)
    assert np.ptp(truth) > 3.0
    lowest = np.min([found.positions[f"{s}_toe"][:, 2] for s in ("left", "right")], 0)
    np.testing.assert_allclose(lowest, 0.0, atol=1e-9)
    # What stands does: the left foot in the second step.
    step = slice(int(STEP * RATE) + 3, int(2 * STEP * RATE) - 3)
    assert np.ptp(found.positions["left_toe"][step, 0]) < 0.03


def test_arrays_and_tables_travel_too(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", SEEN)
    expected = performed(tmp_path / "a.npy", frame_rate=RATE).positions["left_wrist"]
    heads = {
        "names": [f"{name.upper()}_{a}" for name in NAMES for a in "xyz"],
        "numbers": [f"landmark_{i}_{a}" for i in range(33) for a in "xyz"],
    }
    for heading in heads.values():
        rows = [
            ",".join(map(repr, row)) for row in SEEN.reshape(len(SEEN), -1).tolist()
        ]
        (tmp_path / "a.csv").write_text("\n".join([",".join(heading), *rows]))
        found = performed(tmp_path / "a.csv", frame_rate=RATE)
        np.testing.assert_allclose(found.positions["left_wrist"], expected)
    assert np.ptp(expected[:, 0]) > 3.0
    # Points that go along by themselves stay where they are.
    moving = SEEN.copy()
    moving[..., 2] -= WALK["pelvis"][:, None, 0]
    np.save(tmp_path / "b.npy", moving)
    found = performed(tmp_path / "b.npy", frame_rate=RATE)
    assert not any(fact.what == "travel" for fact in found.facts)


def test_who_stands_does_not_travel() -> None:
    p = {joint: points[:1].repeat(20, axis=0) for joint, points in WALK.items()}
    rng = np.random.default_rng(1)
    noisy = {j: q + 0.003 * rng.standard_normal(q.shape) for j, q in p.items()}
    found = travelling(noisy, RATE)["pelvis"]
    assert np.ptp(found[:, :2], axis=0).max() < 0.03


def test_frames_without_a_person_are_gaps(tmp_path: Path) -> None:
    frames = SEEN.tolist()
    frames[10], frames[11] = None, []
    found = performed(written(tmp_path, {"fps": RATE, "frames": frames}))
    assert found.num_frames == len(SEEN)
    assert "gaps of 33 points" in found.notes[0]


@pytest.mark.parametrize(
    "held, said",
    [
        ("[1,", "a.json:1: no JSON"),
        ({}, "no list of frames"),
        ([], "no list of frames"),
        ([None, {}], "no frame has landmarks"),
        ([SEEN[0].tolist(), SEEN[1][:, :2].tolist()], "frame 2: no 33 landmarks"),
        ([[dict(x=1.0)] * 33], "frame 1: no 33 landmarks"),
        ([[["a", 0, 0]] * 33], "frame 1: no 33 landmarks"),
        ([[[1, 2, 3]] * 32], "frame 1: no 33 landmarks"),
        ([SEEN[0].tolist()] * 3, "--frame-rate HZ"),
        ((SEEN[:3] + 0.5).tolist(), "landmarks of the picture"),
        ({"fps": "fast", "frames": SEEN.tolist()}, "one positive number"),
    ],
)
def test_wrong_files_are_told(held: object, said: str, tmp_path: Path) -> None:
    text = held if isinstance(held, str) else json.dumps(held)
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(MotionError, match=said):
        performed(tmp_path / "a.json")
