"""A person's motions for a humanoid, of three formats; and layouts of its motions."""

import pickle
from pathlib import Path

import mesh_judge
import numpy as np
import product
import pytest
import record
import whole_motions
from scipy.spatial.transform import Rotation
from whole_motions import PERSONS, Made, Motion


@pytest.fixture(params=PERSONS)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def test_it_is_what_it_says(made: Made, name: str):
    whole_motions.assert_written(made)
    _, first, last, _ = PERSONS[name]
    assert len(made.motion.table) == (last - first) // 4 + 1


def test_nothing_goes_through_anything(made: Made, judge: mesh_judge.Robot):
    """By triangles, at all frames and midway between."""
    pairs = judge.pairs(np.zeros(len(judge.joints)))
    assert not judge.penetrating(made.motion.joints, pairs)
    assert not judge.penetrating(made.motion.midway, pairs)


def test_limits_and_floor_are_kept(made: Made, judge: mesh_judge.Robot):
    whole_motions.assert_within_limits(made.motion.joints, judge)
    lowest = judge.lowest(judge.poses(made.motion.joints, made.motion.X_WR))
    assert lowest.min() > -whole_motions.BELOW_FLOOR


def test_it_moves_like_the_person_as_it_did(
    made: Made, judge: mesh_judge.Robot, name: str
):
    figures = whole_motions.figures_of_retargeted(made, judge)
    record.assert_no_worse("motions", name, figures, whole_motions.UNNOTICED)


# --- layouts --------------------------------------------------------------------------


def _named(path: Path) -> Motion:
    """Centimetres and degrees, turned about the world's x, y and z in this order."""
    with path.open() as lines:
        names = lines.readline().strip().split(",")
        rows = np.loadtxt(lines, delimiter=",")
    column = {name: values for name, values in zip(names, rows.T, strict=True)}
    p = np.stack([column[f"root_translate{x}"] for x in "XYZ"], axis=1) / 100.0
    angles = np.stack([column[f"root_rotate{x}"] for x in "XYZ"], axis=1)
    joints = np.stack(
        [v for name, v in column.items() if name.endswith("_dof")], axis=1
    )
    turn = Rotation.from_euler("xyz", angles, degrees=True)
    return _motion(p, turn, np.radians(joints))


def _arrays(path: Path) -> Motion:
    held = np.load(path)
    turn = Rotation.from_quat(held["body_quat_w"][:, 0], scalar_first=True)
    return _motion(held["body_pos_w"][:, 0], turn, held["joint_pos"])


def _breadth_first(path: Path) -> Motion:
    """The joints by their distance from the root, then by their parents."""
    motion = _arrays(path)
    # Of the G1: three chains at the pelvis, and both arms beyond three of the waist.
    chains = [range(6), range(6, 12), [*range(12, 15)]]
    arms = [range(15, 22), range(22, 29)]
    order = [chain[k] for k in range(3) for chain in chains]
    for k in range(7):
        order += [chain[3 + k] for chain in chains[:2] if 3 + k < 6]
        order += [arm[k] for arm in arms]
    joints = np.empty_like(motion.joints)
    joints[:, order] = motion.joints
    return Motion(motion.table, motion.X_WR, joints)


def _pickle(path: Path) -> Motion:
    held = pickle.loads(path.read_bytes())
    turn = Rotation.from_quat(held["root_rot"])
    return _motion(held["root_pos"], turn, held["dof_pos"])


def _motion(p: np.ndarray, turn: Rotation, joints: np.ndarray) -> Motion:
    X = np.tile(np.eye(4), (len(p), 1, 1))
    X[:, :3, :3], X[:, :3, 3] = turn.as_matrix(), p
    return Motion(np.empty(0), X, joints)


# As others read these layouts.
READERS = {
    "w first": lambda path: whole_motions.read(path, w_first=True),
    "named degrees": _named,
    "arrays, depth first": _arrays,
    "arrays, breadth first": _breadth_first,
    "pickle": _pickle,
}


@pytest.mark.parametrize("layout", READERS)
def test_layouts_there_and_back(humanoid: str, tmp_path: Path, layout: str):
    """The shipped motion as others read it, and as it comes back."""
    start = tmp_path / "start.csv"
    name, ending = product.LAYOUTS[layout]
    first, _ = product.LAYOUTS["w last"]
    lines = product.ROBOT_MOTION.read_text().splitlines(keepends=True)[:20]
    w_first = tmp_path / "w_first.csv"
    w_first.write_text("".join(lines))
    convert(w_first, start, to=first)
    there, back = tmp_path / f"there{ending}", tmp_path / "back.csv"
    convert(start, there, to=name)
    convert(there, back, to=first, layout=name)
    expected = whole_motions.read(w_first, w_first=True)
    for found in (READERS[layout](there), whole_motions.read(back, w_first=False)):
        np.testing.assert_allclose(found.joints, expected.joints, atol=1e-5)
        np.testing.assert_allclose(found.X_WR, expected.X_WR, atol=1e-5)


def convert(source: Path, out: Path, **options: str) -> None:
    done = product.command("convert", source, out, robot=product.HUMANOID, **options)
    assert done.code == product.FINE, done.err


def test_another_rate(humanoid: str, tmp_path: Path):
    """Every other frame of twice the rate is a frame of before."""
    out = tmp_path / "fast.csv"
    convert(product.ROBOT_MOTION, out, rate="60")
    slow, fast = (
        whole_motions.read(path, w_first=True) for path in (product.ROBOT_MOTION, out)
    )
    assert len(fast.joints) == 2 * len(slow.joints) - 1
    np.testing.assert_allclose(fast.joints[::2], slow.joints, atol=1e-6)
    between = fast.joints[1::2] - slow.midway
    assert 1e-6 < np.abs(between).max() < 0.1


def test_what_is_no_persons_motion_is_refused(
    humanoid: str, mocap: Path, tmp_path: Path
):
    done = product.command("retarget", tmp_path / "none.bvh", robot=humanoid)
    assert done.code == product.REFUSED and "none.bvh" in done.err
    cut = tmp_path / "cut.bvh"
    text = (mocap / "subjects/131/131_01.bvh").read_text()
    cut.write_text(text[: len(text) // 2])
    out = tmp_path / "out.csv"
    done = product.command("retarget", cut, robot=humanoid, out=out)
    assert done.code == product.REFUSED and "cut.bvh" in done.err and not out.exists()
