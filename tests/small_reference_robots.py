"""A small robot in a folder, and references that it cannot follow."""

from pathlib import Path

import numpy as np
from small_robots import SPHERE_POST, chain_urdf

YAML = """\
name: chain
model: chain.urdf
base: base
task_frames: {left_foot: tip}
pairs:
- [post, l1]
- [post, l2]
- [base_shape, l2]
"""
# A shape that is fixed to the base, for the arm to fold onto.
BASE_SHAPE = """
  <link name="base_shape"><collision><geometry><sphere radius="0.05"/></geometry>
  </collision></link><joint name="shape_weld" type="fixed"><parent link="base"/>
  <child link="base_shape"/></joint>
"""
SPEED = 6.0  # [rad/s]


def write_robot(folder: Path) -> Path:
    """Three links in a plane, that can reach a ball and their own base."""
    urdf = chain_urdf("zzz", extra=SPHERE_POST + BASE_SHAPE)
    urdf = urdf.replace('upper="2.5"/>', f'upper="2.5" effort="0" velocity="{SPEED}"/>')
    (folder / "chain.urdf").write_text(urdf.replace('effort="0" ', ""))
    (folder / "robot.yaml").write_text(YAML)
    return folder


def reaching(frames: int, rate: float, reach: float) -> np.ndarray:
    """(T, 3) joints that swing towards the ball; with reach 1 through it."""
    t = np.arange(frames) / rate
    swing = 0.5 - 0.5 * np.cos(2.0 * np.pi * t / t[-1])
    return np.column_stack(
        [0.9 * reach * swing, 0.4 * reach * swing, 0.1 + 0.2 * swing]
    )


def write_csv(path: Path, joints: np.ndarray) -> Path:
    """A CSV of the layout x y z, w x y z, joints."""
    rows = np.zeros((len(joints), 7 + joints.shape[1]))
    rows[:, 2], rows[:, 3], rows[:, 7:] = 0.8, 1.0, joints
    # Turned about z, for the order of the quaternion to be seen.
    angle = np.linspace(0.0, 0.5, len(joints))
    rows[:, 3], rows[:, 6] = np.cos(angle / 2.0), np.sin(angle / 2.0)
    np.savetxt(path, rows, delimiter=",", fmt="%.10g")
    return path
