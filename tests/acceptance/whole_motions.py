"""Whole motions that the suite has cleaned and retargeted, and figures of the results.

The figures are by the judges of this folder, of the files that were written.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import ezc3d
import mesh_judge
import numpy as np
import person_judge
import product
import pytest
from scipy.spatial.transform import Rotation

RATE = 30.0  # of all motions of robots here [Hz]
G1 = "g1_description/urdf/g1_29dof_rev_1_0.urdf"
SIDES = (("left", 1), ("right", -1))
# Corners of the soles of the G1: where its file has small spheres at the ankle.
SOLE = [
    (x, y, -0.035)
    for x, y in ((-0.05, 0.025), (-0.05, -0.025), (0.12, 0.03), (0.12, -0.03))
]
ON_FLOOR = 0.005  # a corner that is lower stands [m]
BELOW_FLOOR = 0.01  # what a motion may be at most [m]
# What nobody would call a change for the worse, besides 5 % of a recorded figure.
UNNOTICED = {"deg": 0.1, "mm": 1.0, "m/s2": 0.05}

# Name -> file, first and last frame, layout. Links of each are in each other; ankles of
# the last are beyond their limits, too, on either side.
STRETCHES = {
    "boxing": (str(product.ROBOT_MOTION), 1, 76, "w first"),
    "leap": ("leap.csv", 296, 365, "w last"),
    "jumping jack": ("jumpjack.csv", 72, 112, "w first"),
}
# Name -> recording, first and last frame (counted from 1, of 120 a second), format.
PERSONS = {
    "kick": ("11/11_01", 181, 420, "amc"),
    "walk": ("131/131_01", 361, 601, "bvh"),
    "karate": ("135/135_02", 1201, 1440, "c3d"),
}


@dataclass(frozen=True)
class Motion:
    """A motion of the G1, as a table of numbers has it; X_WR: (T, 4, 4) of its root."""

    table: np.ndarray
    X_WR: np.ndarray
    joints: np.ndarray

    @property
    def midway(self) -> np.ndarray:
        """The joints between each two frames."""
        return 0.5 * (self.joints[1:] + self.joints[:-1])


def read(path: Path, w_first: bool) -> Motion:
    """Reads x y z, a quaternion and joints, without a heading."""
    table = np.loadtxt(path, delimiter=",", ndmin=2)
    X = np.tile(np.eye(4), (len(table), 1, 1))
    turn = Rotation.from_quat(table[:, 3:7], scalar_first=w_first)
    X[:, :3, :3], X[:, :3, 3] = turn.as_matrix(), table[:, :3]
    return Motion(table, X, table[:, 7:])


@dataclass(frozen=True)
class Made:
    """What a command has made of a motion."""

    finished: product.Finished
    source: Path
    out: Path
    motion: Motion
    before: Motion | None = None  # what was cleaned


def robots_motion(file: str) -> Path:
    """A file that is shipped, or one in the folder of robots' motions."""
    folder = os.environ.get(product.ROBOT_MOTIONS, "")
    if not folder and not Path(file).is_absolute():
        pytest.skip(f"set {product.ROBOT_MOTIONS} to the folder of robots' motions")
    return Path(folder) / file


def clean(name: str, folder: Path) -> Made:
    """Cleans a stretch of a robot's motion."""
    file, first, last, layout = STRETCHES[name]
    source, out = robots_motion(file), folder / f"{name}.csv".replace(" ", "_")
    done = product.command(
        "clean",
        source,
        robot=product.HUMANOID,
        frames=f"{first}:{last}",
        no_page=True,
        out=out,
    )
    w_first = layout == "w first"
    before = read(source, w_first)
    rows = slice(first - 1, last)
    before = Motion(before.table[rows], before.X_WR[rows], before.joints[rows])
    return Made(done, source, out, read(out, w_first), before)


def retarget(name: str, mocap: Path, folder: Path) -> Made:
    """Retargets a stretch of a person's recording, which is cut out of its file."""
    trial, first, last, kind = PERSONS[name]
    whole = mocap / "subjects" / f"{trial}.{kind}"
    source = folder / whole.name
    amc = whole.with_suffix(".amc")
    (asf,) = amc.parent.glob("*.asf")
    (folder / asf.name).write_bytes(asf.read_bytes())
    CUT["amc"](amc, folder / amc.name, first, last)
    CUT[kind](whole, source, first, last)
    out = folder / f"{name}.csv"
    done = product.command("retarget", source, robot=product.HUMANOID, out=out)
    return Made(done, source, out, read(out, w_first=False))


def figures_of_cleaned(made: Made, judge: mesh_judge.Robot) -> dict[str, float]:
    """How much was changed, and how the result moves."""
    motion, before = made.motion, made.before
    change = np.degrees(motion.joints - before.joints)
    after_poses, poses = (judge.poses(m.joints, m.X_WR) for m in (motion, before))
    moved = {}
    for part, link in (("hands", "rubber_hand"), ("feet", "ankle_roll_link")):
        ways = [
            judge.point(after_poses, f"{side}_{link}")
            - judge.point(poses, f"{side}_{link}")
            for side, _ in SIDES
        ]
        moved[part] = 1e3 * np.sqrt(np.mean(np.sum(np.square(ways), axis=-1)))
    return {
        "changed frames": int(np.any(np.abs(change) > 1e-4, axis=1).sum()),
        "joints rms deg": _rms(change),
        "joints worst deg": np.abs(change).max(),
        "hands rms mm": moved["hands"],
        "feet rms mm": moved["feet"],
        **_figures_of_root_and_feet(motion, judge, {}),
    }


def figures_of_retargeted(made: Made, judge: mesh_judge.Robot) -> dict[str, float]:
    """How the limbs point elsewhere than the person's, and how the result moves."""
    person = person_judge.read(made.source.with_suffix(".amc"), every=4)
    stands = {side: person_judge.stands(person, side, RATE) for side, _ in SIDES}
    poses = judge.poses(made.motion.joints, made.motion.X_WR)
    robot = {}
    for side, y in SIDES:
        ends = {
            "shoulder": judge.point(
                poses, f"{side}_shoulder_pitch_link", (0.0, 0.044 * y, -0.0156)
            ),
            "hip": judge.point(poses, f"{side}_hip_yaw_link", (0.0, 0.0, 0.124)),
        }
        for point, link in (
            ("elbow", "elbow_link"),
            ("wrist", "wrist_pitch_link"),
            ("knee", "knee_link"),
            ("ankle", "ankle_roll_link"),
        ):
            ends[point] = judge.point(poses, f"{side}_{link}")
        for limb, start, end in (
            ("upper arm", "shoulder", "elbow"),
            ("forearm", "elbow", "wrist"),
            ("thigh", "hip", "knee"),
            ("shin", "knee", "ankle"),
        ):
            robot[f"{side} {limb}"] = person_judge.direction(ends[start], ends[end])
    errors = list(person_judge.errors(person_judge.limbs_of(person), robot).values())
    return {
        "farthest limb median deg": np.median(errors, axis=1).max(),
        "farthest limb 95 % deg": np.percentile(errors, 95, axis=1).max(),
        "below floor mm": 1e3 * max(0.0, -judge.lowest(poses).min()),
        **_figures_of_root_and_feet(made.motion, judge, stands),
    }


def _figures_of_root_and_feet(
    motion: Motion, judge: mesh_judge.Robot, stands: dict[str, np.ndarray]
) -> dict[str, float]:
    """Slip is of corners on the floor; where it is known, while the person stands."""
    poses = judge.poses(motion.joints, motion.X_WR)
    acceleration = np.diff(motion.X_WR[:, :3, 3], 2, axis=0) * RATE**2
    slips = [
        _longest_slip(
            judge.point(poses, f"{side}_ankle_roll_link", corner),
            stands.get(side, True),
        )
        for side, _ in SIDES
        for corner in SOLE
    ]
    return {
        "slip mm": 1e3 * max(slips),
        "root acceleration rms m/s2": _rms(np.linalg.norm(acceleration, axis=1)),
    }


def _longest_slip(p: np.ndarray, stands: np.ndarray | bool) -> float:
    """The longest way of a point over the floor while it stands on it [m]."""
    longest = way = 0.0
    low = p[:, 2] < ON_FLOOR
    steps = np.linalg.norm(np.diff(p[:, :2], axis=0), axis=1)
    for step, stays in zip(steps, low[1:] & low[:-1] & stands, strict=True):
        way = way + step if stays else 0.0
        longest = max(longest, way)
    return longest


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


# --- what holds of all that is written ------------------------------------------------


def assert_written(made: Made) -> None:
    """The command says that all is well, and where file and certificate are."""
    done = made.finished
    assert done.code == product.FINE, done.err
    assert done.out.splitlines()[-1].startswith(product.HOLDS)
    assert str(made.out) in done.out and product.certificate_of(made.out).is_file()


def assert_within_limits(q: np.ndarray, judge: mesh_judge.Robot) -> None:
    """Of positions and of speeds."""
    assert np.maximum(judge.lower - q, q - judge.upper).max() < 1e-6
    speeds = np.abs(np.diff(q, axis=0)) * RATE
    assert (speeds - judge.speed).max() < 1e-6


# --- cutting persons' files -----------------------------------------------------------


def _cut_amc(whole: Path, out: Path, first: int, last: int) -> None:
    """Frames `first` to `last` of an AMC, counted from 1 again."""
    head, *frames = _split_amc(whole.read_text())
    kept = [f"{k}\n{text}" for k, text in enumerate(frames[first - 1 : last], start=1)]
    out.write_text(head + "".join(kept))


def _split_amc(text: str) -> list[str]:
    parts = [""]
    for line in text.splitlines(keepends=True):
        if line.strip().isdigit():
            parts.append("")
        else:
            parts[-1] += line
    return parts


def _cut_bvh(whole: Path, out: Path, first: int, last: int) -> None:
    lines = whole.read_text().splitlines()
    (start,) = (k for k, line in enumerate(lines) if line.startswith("Frames:"))
    rows = lines[start + 2 :][first - 1 : last]
    head = [*lines[:start], f"Frames: {len(rows)}", lines[start + 1]]
    out.write_text("\n".join([*head, *rows]) + "\n")


def _cut_c3d(whole: Path, out: Path, first: int, last: int) -> None:
    held = ezc3d.c3d(str(whole))
    rows = slice(first - 1, last)
    held["data"]["points"] = held["data"]["points"][:, :, rows]
    for part in ("residuals", "camera_masks"):
        held["data"]["meta_points"][part] = held["data"]["meta_points"][part][..., rows]
    held.write(str(out))


CUT = {"amc": _cut_amc, "bvh": _cut_bvh, "c3d": _cut_c3d}
