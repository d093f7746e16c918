"""NPY files: PHUMA's, with a dict, and the AMASS motions of the G1, with a table.

`phuma-npy`, of PHUMA, is a pickled dict in a file of NumPy:

===============  =========  ========================================================
key              shape      what
===============  =========  ========================================================
root_trans       (T, 3)     x y z of the root in the world [m]
root_ori         (T, 4)     its orientation, x y z w
dof_pos          (T, n)     joints [rad], in the order of the robot's model
fps              number     frames per second [Hz]
===============  =========  ========================================================

`amass-npy`, of "Retargeted AMASS for robotics", is a table (T, 7 + n): x y z of the
root [m], its orientation x y z w, the joints [rad] depth first. The rate is a number
in the file's name (`walk_poses_120_jpos.npy`). Heights of the G1's root there are those
above its first pose: 0.793 m, where its model stands, are added.

Sources: `motion_adaptation.py` of github.com/DAVIAN-Robotics/PHUMA;
huggingface.co/datasets/fleaven/Retargeted_AMASS_for_robotics, and of the height the
players of that data set, as github.com/KyrieYoung926/AMASS_G1_Viewer.
"""

from __future__ import annotations

import os
import pickle
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.files import whole_file
from crar_drake.motion.array_files import load_arrays, npy_header
from crar_drake.motion.plain_pickle import (
    PlainUnpickler,
    RefusedPickle,
    for_any_numpy,
)
from crar_drake.references.pickle_layouts import clip_of_motion, motion_of_clip
from crar_drake.references.robot_motion import RobotMotion

USUAL_RATE = 120.0  # of `amass-npy` [Hz]

_RATE = re.compile(r"_(\d{2,3})_jpos$")
_G1_COLUMNS, _G1_HEIGHT = 36, 0.793  # [m]


def read_npy(
    path: Path,
    layout: str | None,
    rate: float | None,
    joint_names: Sequence[str] | None,
) -> tuple[RobotMotion]:
    """Reads an NPY file; whether it holds a dict tells the layout.

    Raises:
        MotionError: it is damaged, holds more than data, or is of another layout.
    """
    _, dtype, offset = npy_header(path)
    found = "phuma-npy" if dtype.hasobject else "amass-npy"
    if layout is not None and layout != found:
        raise MotionError(f"{path}: what it holds is of {found}, not of {layout}")
    if found == "amass-npy":
        return (_motion_of_table(path, rate, joint_names),)
    try:
        held = PlainUnpickler(path.read_bytes()[offset:]).load()
        held = held.item() if isinstance(held, np.ndarray) and not held.ndim else held
    except RefusedPickle as error:
        raise MotionError(f"{path}: {error}") from None
    return (motion_of_clip(path, held, found, rate, joint_names),)


def write_npy(path: str | os.PathLike[str], motion: RobotMotion, layout: str) -> None:
    """Writes an NPY file."""
    with whole_file(path) as temporary, temporary.open("wb") as file:
        if layout == "amass-npy":
            np.save(file, _table_of_motion(motion))
            return
        held = np.array(None, dtype=object)
        held[()] = clip_of_motion(path, motion, layout, None)
        header = {"descr": "|O", "fortran_order": False, "shape": ()}
        np.lib.format.write_array_header_1_0(file, header)
        file.write(for_any_numpy(pickle.dumps(held, protocol=3)))


def _motion_of_table(
    path: Path, rate: float | None, joint_names: Sequence[str] | None
) -> RobotMotion:
    rows = load_arrays(path)[""]
    if rows.ndim != 2 or rows.shape[1] < 8 or rows.dtype.kind not in "fiu":
        raise MotionError(
            f"{path}: it is an array {rows.shape} of {rows.dtype}; a robot's motion "
            "has rows of x, y, z, the four of a quaternion, and at least one joint"
        )
    named, guesses = _RATE.search(path.stem), []
    if rate is None and named:
        rate = float(named[1])
    elif rate is None:
        rate = USUAL_RATE
        guesses.append(f"{rate:g} Hz, the usual rate of such files: its name has none")
    table = rows.astype(float)
    if table.shape[1] == _G1_COLUMNS:
        table[:, 2] += _G1_HEIGHT
        guesses.append(
            f"with {_G1_COLUMNS} columns it is a G1: its heights are those above its "
            f"first pose, {_G1_HEIGHT:g} m"
        )
    return RobotMotion(
        joint_names=tuple(joint_names or ()),
        root_positions=table[:, :3],
        root_quaternions=table[:, [6, 3, 4, 5]],
        joint_positions=table[:, 7:],
        rate=float(rate),
        layout="amass-npy",
        source=str(path),
        precision=rows.dtype.name if rows.dtype.kind == "f" else "",
        guesses=tuple(guesses),
        computed={"rows": rows},
    ).as_read()


def _table_of_motion(motion: RobotMotion) -> np.ndarray:
    if motion.layout == "amass-npy" and motion.is_as_read:
        return motion.computed["rows"]
    root = motion.root_positions.copy()
    if 7 + motion.num_joints == _G1_COLUMNS:
        root[:, 2] -= _G1_HEIGHT
    quaternions = motion.root_quaternions[:, [1, 2, 3, 0]]
    rows = np.hstack([root, quaternions, motion.joint_positions])
    same = motion.layout == "amass-npy" and motion.precision
    return rows.astype(motion.precision) if same else rows
