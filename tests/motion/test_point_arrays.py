"""Joint positions of body models and pose estimators, and files of them."""

import dataclasses

import numpy as np
import pytest
from performed import performed

from crar_drake.errors import MotionError
from crar_drake.motion.catalogue import load_clip
from crar_drake.motion.formats.point_arrays import read_point_arrays
from crar_drake.motion.orientations import hip_turns, smooth_hands
from crar_drake.motion.performer import Performer
from crar_drake.motion.performers.asf_amc import asf_amc_performer
from crar_drake.motion.point_layouts import LAYOUTS


@pytest.fixture(scope="module")
def truth() -> Performer:
    whole = load_clip("dance")
    part = slice(200, 260)
    return asf_amc_performer(
        dataclasses.replace(
            whole,
            root_position=whole.root_position[part],
            root_rotation=whole.root_rotation[part],
            joints={name: values[part] for name, values in whole.joints.items()},
        )
    )


def points_of(truth: Performer, names: tuple[str, ...]) -> np.ndarray:
    """(T, J, 3) of a layout's points; those that say nothing are put at the neck."""
    p = dict(truth.positions)
    ahead = 0.15 * truth.orientations["left_ankle"][:, :, 0]
    for side in ("left", "right"):
        toe = p[f"{side}_ankle"] + ahead
        p |= {f"{side}_foot": toe, f"{side}_ear": p["head"]}
    p["nose"] = p["head"]
    return np.stack([p.get(name, p["neck"]) for name in names], axis=1)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("named", [True, False])
def test_layouts_by_names_and_by_number(layout, named, truth, tmp_path) -> None:
    names = LAYOUTS[layout]
    points = points_of(truth, names)
    if layout == "COCO-17":
        # Nose, eyes and ears.
        points[:, 0] += [0.10, 0.0, 0.0]
        points[:, 1:3] += [[0.08, 0.03, 0.03], [0.08, -0.03, 0.03]]
        points[:, 3:5] += [[0.0, 0.07, 0.0], [0.0, -0.07, 0.0]]
    if named:
        np.savez(tmp_path / "a.npz", positions=points, names=names, frame_rate=60.0)
        performer = performed(tmp_path / "a.npz")
    else:
        np.save(tmp_path / "a.npy", points)
        performer = performed(tmp_path / "a.npy", frame_rate=60.0)
    for joint in ("left_elbow", "right_wrist", "left_knee", "right_ankle", "left_hip"):
        np.testing.assert_allclose(performer.positions[joint], truth.positions[joint])
    assert any(fact.value == layout for fact in performer.facts)
    guessed = {"pelvis", "neck", "head"} if layout == "COCO-17" else ()
    assert performer.guessed == frozenset(guessed)
    assert performer.frame_rate == 60.0
    # By hips and trunk alone the pelvis's heading is that of the fitted one nearly.
    np.testing.assert_allclose(performer.heading, truth.heading, atol=0.35)
    with pytest.raises(MotionError, match="how a hand is turned"):
        smooth_hands(performer)


def test_a_camera_in_mm_whose_origin_is_the_pelvis(truth, tmp_path) -> None:
    """x right, y down, z away from the camera, which the performer faces at first."""
    names = LAYOUTS["H36M-17"]
    p = points_of(truth, names) - truth.positions["pelvis"][:, None]
    camera = np.stack([p[..., 1], -p[..., 2], -p[..., 0]], axis=-1) * 1e3
    np.save(tmp_path / "a.npy", camera)
    performer = performed(tmp_path / "a.npy", frame_rate=60.0)
    assert performer.up == "-y"
    facts = {fact.what: fact for fact in performer.facts}
    assert facts["unit"].value == "mm" and "floor" in facts
    lowest = min(q[:, 2].min() for q in performer.positions.values())
    assert abs(lowest) < 0.1
    arm = performer.positions["left_elbow"] - performer.positions["left_shoulder"]
    expected = truth.positions["left_elbow"] - truth.positions["left_shoulder"]
    np.testing.assert_allclose(
        np.linalg.norm(arm, axis=1), np.linalg.norm(expected, axis=1)
    )
    np.testing.assert_allclose(arm[:, 2], expected[:, 2], atol=1e-9)


def csv_text(truth: Performer, frames: int, time: bool = True) -> str:
    names = LAYOUTS["SMPL-22"]
    points = points_of(truth, names)[:frames]
    heading = [f"{name}_{axis}" for name in names for axis in "xyz"]
    lines = [",".join((["time"] if time else []) + heading)]
    for k, row in enumerate(points):
        cells = [f"{value:.12g}" for value in row.ravel()]
        lines.append(",".join(([f"{k / 60.0:.6f}"] if time else []) + cells))
    return "\n".join(lines) + "\n"


def test_csv_with_time_byte_order_mark_and_a_hidden_point(truth, tmp_path) -> None:
    lines = csv_text(truth, 30).split("\n")
    cells = lines[10].split(",")
    cells[1 + 3 * 18 : 4 + 3 * 18] = ["", "", ""]  # the left elbow
    lines[10] = ",".join(cells)
    (tmp_path / "a.csv").write_bytes(("\ufeff" + "\r\n".join(lines)).encode())
    performer = performed(tmp_path / "a.csv")
    assert performer.frame_rate == pytest.approx(60.0, rel=1e-4)
    np.testing.assert_allclose(
        performer.positions["left_elbow"], truth.positions["left_elbow"][:30], atol=2e-3
    )
    assert "1 gaps of 1 points" in performer.notes[0]


def test_wrong_files_are_told(truth, tmp_path) -> None:
    def refusal(name: str, **options) -> str:
        with pytest.raises(MotionError) as caught:
            performed(tmp_path / name, **options)
        return str(caught.value)

    text = csv_text(truth, 5, time=False)
    (tmp_path / "a.csv").write_text(text)
    assert "--frame-rate HZ" in refusal("a.csv")
    lines = text.splitlines()
    (tmp_path / "a.csv").write_text("\n".join([*lines[:3], lines[3] + ",1"]))
    assert "a.csv:4: 67 values, but the heading has 66" in refusal("a.csv")
    (tmp_path / "a.csv").write_text("\n".join([*lines[:2], "x" + lines[2]]))
    assert "a.csv:3: " in refusal("a.csv")
    (tmp_path / "a.csv").write_text("\n".join(lines[1:]))
    assert "begin with a heading such as left_hip_x" in refusal("a.csv")
    (tmp_path / "a.csv").write_text(lines[0] + "\n")
    assert "no frames" in refusal("a.csv")
    np.save(tmp_path / "a.npy", np.zeros((10, 19, 3)))
    assert "19 points without names" in refusal("a.npy", frame_rate=30.0)
    np.save(tmp_path / "a.npy", np.zeros((10, 66)))
    assert "must be numbers of shape (T, J, 3)" in refusal("a.npy", frame_rate=30.0)
    (tmp_path / "a.npz").write_bytes(b"PK\x03\x04 and no more")
    assert "it is no NPZ file" in refusal("a.npz")
    np.savez(tmp_path / "a.npz", poses=np.zeros((10, 156)), mocap_framerate=120.0)
    assert "the file holds poses (10, 156)" in refusal("a.npz")
    names = LAYOUTS["SMPL-22"]
    points = points_of(truth, names)
    np.savez(tmp_path / "a.npz", positions=points, names=names[1:], fps=60)
    assert "21 names for 22 points" in refusal("a.npz")
    np.savez(
        tmp_path / "a.npz", positions=100.0 * points, names=names, fps=60, unit="m"
    )
    assert "its unit, m, would make a person of 16" in refusal("a.npz")
    keep = [i for i, name in enumerate(names) if not name.endswith("elbow")]
    few = [names[i] for i in keep]
    np.savez(tmp_path / "a.npz", positions=points[:, keep], names=few, fps=60)
    assert "no left_elbow, right_elbow among its points: pelvis" in refusal("a.npz")
    np.savez(tmp_path / "a.npz", positions=points[:1], names=names, fps=60)
    assert "single frame" in refusal("a.npz")


def test_a_frame_that_says_no_orientation_is_named(truth, tmp_path) -> None:
    """Lost ones are often written as zeros; in another hips alone coincide."""
    names = LAYOUTS["SMPL-22"]
    zeros = points_of(truth, names)
    hips = zeros.copy()
    zeros[30] = 0.0
    hips[40, names.index("right_hip")] = hips[40, names.index("left_hip")]
    for points, name in ((zeros, "zeros"), (hips, "hips")):
        archive = tmp_path / f"{name}.npz"
        np.savez(archive, positions=points, names=names, frame_rate=60.0)
    with pytest.raises(MotionError, match="the hips: no orientation in frame 31"):
        hip_turns(performed(tmp_path / "zeros.npz"))
    with pytest.raises(MotionError, match="both hips are in one place in frame 41"):
        performed(tmp_path / "hips.npz")


def test_comments_encodings_and_escapes_of_a_csv(truth, tmp_path) -> None:
    names = LAYOUTS["SMPL-22"]
    text = "# made by a tool\n" + csv_text(truth, 5).replace("\n", "\n# and so on\n", 1)
    path = tmp_path / "a.csv"
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        path.write_bytes(text.encode(encoding))
        assert performed(path).num_frames == 5
    path.write_text(text.replace(names[0], "\x1b[31m" + names[0]))
    told = read_point_arrays(path).names[0]
    assert told == r"\x1b[31m" + names[0]
    path.write_text("\n".join(text.split("\n")[:4] + ["1,2"]))
    with pytest.raises(MotionError, match="a.csv:5: 2 values, but the heading has"):
        performed(path)


@pytest.mark.parametrize("suffix", ["npz", "npy"])
def test_changed_bytes_of_an_archive_are_refused(suffix, truth, tmp_path) -> None:
    """NumPy's and Python's readers raise a dozen kinds of errors at them."""
    points = points_of(truth, LAYOUTS["SMPL-22"])[:3]
    path = tmp_path / f"a.{suffix}"
    if suffix == "npz":
        np.savez(path, positions=points, frame_rate=30.0)
    else:
        np.save(path, points)
    data, rng = path.read_bytes(), np.random.default_rng(5)
    refused = 0
    for _ in range(300):
        changed = bytearray(data)
        for place in rng.choice(len(data), 3):
            # Mostly where it says what is in it.
            place = place % 150 if rng.random() < 0.7 else place
            changed[place] = rng.integers(256)
        path.write_bytes(changed)
        try:
            performed(path, frame_rate=30.0)
        except MotionError as error:
            assert str(path) in str(error) or "motion a" in str(error)
            refused += 1
    assert refused > 100
