"""CSV files with a heading: in centimetres and degrees, turned as they should be."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_biped import BREADTH_FIRST, DEPTH_FIRST, moving_samples, whole_biped

from crar_drake.errors import MotionError
from crar_drake.motion.robots_own import holds_reference
from crar_drake.references.motion_files import read_motion, write_motions
from crar_drake.references.robot_motion import RobotMotion

P, Q, JOINTS = moving_samples()
HEADING = "Frame,root_translateX,root_translateY,root_translateZ"
HEADING += ",root_rotateX,root_rotateY,root_rotateZ"


def about(axis: int, degrees: float) -> np.ndarray:
    """(3, 3) the turn about an axis of the world, from its definition."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    R = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[i, i], R[j, j], R[i, j], R[j, i] = c, c, -s, s
    return R


def write(path: Path, names: tuple[str, ...], rows: np.ndarray) -> Path:
    heading = HEADING + "".join(f",{name}_dof" for name in names)
    lines = [",".join([str(k), *map(repr, row)]) for k, row in enumerate(rows.tolist())]
    path.write_text("\n".join([heading, *lines]) + "\n")
    return path


def test_it_is_read(tmp_path: Path) -> None:
    rows = np.zeros((2, 6 + len(BREADTH_FIRST)))
    rows[:, :6] = 120.0, -30.0, 79.5, 20.0, -35.0, 110.0
    rows[:, 6:] = [10.0, 20.0, 30.0, 40.0, 50.0]
    path = write(tmp_path / "a.csv", BREADTH_FIRST, rows)
    assert holds_reference(path)
    read = read_motion(path)
    assert read.layout == "named-csv" and read.rate == 120.0
    assert read.joint_names == BREADTH_FIRST
    np.testing.assert_allclose(read.root_positions[1], [1.2, -0.3, 0.795])
    R = about(2, 110.0) @ about(1, -35.0) @ about(0, 20.0)
    np.testing.assert_allclose(read.root_rotations.as_matrix()[0], R, atol=1e-12)
    np.testing.assert_allclose(np.degrees(read.joint_positions[0]), rows[0, 6:])
    assert "120 Hz" in read.guesses[0]
    assert read_motion(path, rate=30.0).guesses == ()


def test_it_is_written(tmp_path: Path) -> None:
    motion = RobotMotion(DEPTH_FIRST, P, Q, JOINTS, 120.0)
    write_motions(tmp_path / "a.csv", [motion], "named-csv")
    table = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 1:4], 100.0 * P)
    np.testing.assert_allclose(table[:, 7:], np.degrees(JOINTS), atol=1e-12)
    R = Rotation.from_quat(np.roll(Q, -1, axis=1)).as_matrix()
    for k in (0, len(P) - 1):
        x, y, z = table[k, 4:7]
        np.testing.assert_allclose(
            about(2, z) @ about(1, y) @ about(0, x), R[k], atol=1e-12
        )
    with pytest.raises(MotionError, match="--robot"):
        write_motions(
            tmp_path / "a.csv", [RobotMotion((), P, Q, JOINTS, 1.0)], "named-csv"
        )


def test_an_unchanged_one_comes_back_in_the_robots_order(tmp_path: Path) -> None:
    robot = whole_biped(tmp_path / "biped")
    rows = np.round(np.random.default_rng(1).uniform(-90.0, 90.0, (5, 11)), 6)
    path = write(tmp_path / "a.csv", BREADTH_FIRST, rows)
    read = read_motion(path, robot=robot)
    assert read.is_as_read and read.joint_names == DEPTH_FIRST
    write_motions(tmp_path / "b.csv", [read], "named-csv", robot)
    again = np.loadtxt(tmp_path / "b.csv", delimiter=",", skiprows=1)[:, 1:]
    order = [BREADTH_FIRST.index(name) for name in DEPTH_FIRST]
    assert np.array_equal(again, rows[:, [*range(6), *(6 + i for i in order)]])


@pytest.mark.parametrize(
    "text, said",
    [
        (HEADING + "\n0,1,2,3,4,5,6\n", "no JOINT_dof"),
        (HEADING.replace(",root_rotateY", "") + ",a_dof\n0,1,2,3,4,5,6\n",
         "no root_rotateY"),
        (HEADING + ",a_dof,a_dof\n0,1,2,3,4,5,6,7,8\n", "there twice"),
        (HEADING + ",a_dof\n0,1,2,3,4,5,6\n", "line 2: 7 columns, but 8"),
        (HEADING + ",a_dof\n0,1,2,3,4,5,6,x\n", "line 2: 'x' is no number"),
        (HEADING + ",a_dof\n0,1,2,3,4,5,6,nan\n", "frame 1, column 8: nan"),
        (HEADING + ",a_dof\n", "the file is empty"),
    ],
)  # fmt: skip
def test_wrong_files_are_told(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(MotionError, match=said):
        read_motion(tmp_path / "a.csv")


def test_a_layout_that_is_said_has_to_be_there(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", ("a",), np.zeros((2, 7)))
    with pytest.raises(MotionError, match="it has a heading, which is not as xyzw-csv"):
        read_motion(path, layout="xyzw-csv")
    path.write_text("0,0,0,0,0,0,1,0\n")
    with pytest.raises(MotionError, match="it has no heading, which is not as named"):
        read_motion(path, layout="named-csv")
