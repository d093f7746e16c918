"""NPZ files of LocoMuJoCo's trajectories (version 1), with N samples of all of them.

===============  ============  ====================================================
key              shape         what
===============  ============  ====================================================
frequency        ()            samples per second [Hz]
joint_names      (1 + n,)      the root's joint and the others, as MuJoCo has them
jnt_type         (1 + n,)      MuJoCo's: 0 is free, 2 slides, 3 turns
njnt             ()            1 + n
qpos             (N, 7 + n)    x y z [m] and w x y z of the root, then the joints
                               [rad]
qvel             (N, 6 + n)    the root's velocity in the world [m/s] and angular
                               velocity in its own frame [rad/s], then the joints'
split_points     (M + 1,)      where each of M trajectories begins; N
===============  ============  ====================================================

What follows from the motion and MuJoCo's model (`xpos`, `site_xpos` and others) is not
kept when the motion changes: LocoMuJoCo computes it. Its files of version 0, a key for
each joint (`q_left_knee_joint`), are not read. Source: `trajectory/dataclasses.py` of
github.com/robfiras/loco-mujoco.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.files import whole_file
from crar_drake.motion.array_files import load_arrays
from crar_drake.references.held_values import stated_rate
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.root_speeds import difference, turning

LAYOUT = "locomujoco-npz"

_KEYS = ("frequency", "joint_names", "jnt_type", "qpos", "split_points")
# Of the model, whatever it does.
_MODEL = ("body_names", "site_names", "nbody", "nsite") + tuple(
    [f"body_{key}" for key in ("rootid", "weldid", "mocapid")]
    + [f"body_{key}" for key in ("pos", "quat", "ipos", "iquat")]
    + [f"site_{key}" for key in ("bodyid", "pos", "quat")]
)
_FREE, _SINGLE = 0, (2, 3)
_ROOT = "root_joint"  # its name, of our own extras


def read_locomujoco(
    path: Path, layout: str | None, rate: float | None
) -> tuple[RobotMotion, ...]:
    """Reads all trajectories of a file.

    Raises:
        MotionError: the file is damaged, lacks a key, or its robot has no root that is
            free or joints of several degrees of freedom.
    """
    if layout not in (None, LAYOUT):
        raise MotionError(f"{path}: its keys are those of {LAYOUT}, not of {layout}")
    arrays = load_arrays(path, {*_KEYS, "qvel", *_MODEL}, skip_objects=True)
    missing = [key for key in _KEYS if key not in arrays]
    if missing:
        raise MotionError(f"{path}: it has no {', '.join(missing)}, as {LAYOUT} has")
    names = tuple(str(name) for name in np.atleast_1d(arrays["joint_names"]))
    q, types = arrays["qpos"], np.atleast_1d(arrays["jnt_type"])
    numbers = q.ndim == 2 and q.dtype.kind in "fiu" and q.shape[1] == len(names) + 6
    if len(types) != len(names) or not numbers:
        raise MotionError(
            f"{path}: {len(names)} joint names, {len(types)} types, and an array qpos "
            f"{q.shape} of {q.dtype}; it has six columns more than there are names"
        )
    if types[0] != _FREE or not np.isin(types[1:], _SINGLE).all():
        raise MotionError(
            f"{path}: its first joint has to be free and all others of one degree of "
            f"freedom; jnt_type is {types.tolist()}"
        )
    stated = stated_rate(path, arrays, "frequency")
    splits = np.ravel(arrays["split_points"])
    whole = (
        splits.dtype.kind in "iu" and len(splits) > 1 and (np.diff(splits) > 0).all()
    )
    if not whole or splits[0] != 0 or splits[-1] != len(q):
        raise MotionError(
            f"{path}: split_points {splits} do not go from 0 to the {len(q)} samples"
        )
    qvel = arrays.get("qvel")
    kept = qvel is not None and qvel.shape == (len(q), q.shape[1] - 1)
    return tuple(
        RobotMotion(
            joint_names=names[1:],
            root_positions=q[a:b, :3].astype(float),
            root_quaternions=q[a:b, 3:7].astype(float),
            joint_positions=q[a:b, 7:].astype(float),
            rate=float(rate or stated),
            layout=LAYOUT,
            source=str(path),
            clip=str(k) if len(splits) > 2 else "",
            precision=q.dtype.name if q.dtype.kind == "f" else "",
            extras={_ROOT: names[0]}
            | {key: arrays[key] for key in _MODEL if key in arrays},
            computed={"joint_vel": qvel[a:b]} if kept else {},
        ).as_read()
        for k, (a, b) in enumerate(zip(splits[:-1], splits[1:], strict=True))
    )


def write_locomujoco(
    path: str | os.PathLike[str], motions: Sequence[RobotMotion]
) -> None:
    """Writes trajectories of one robot into one file.

    Raises:
        MotionError: joints have no names, or rates or joints differ.
    """
    first = motions[0]
    if not first.joint_names:
        raise MotionError(
            f"{path}: {LAYOUT} has the joints' names, and the motion has none: say "
            "which robot it is (--robot)"
        )
    if len({(motion.joint_names, motion.rate) for motion in motions}) > 1:
        raise MotionError(
            f"{path}: trajectories of one file have the same joints and rate; write "
            "them one by one (--clip), at one rate (--rate)"
        )
    same = all(motion.layout == LAYOUT for motion in motions)
    precision = first.precision if same and first.precision else "float64"
    q = [
        np.hstack([m.root_positions, m.root_quaternions, m.joint_positions])
        for m in motions
    ]
    splits = np.cumsum([0, *map(len, q)])
    root = str(first.extras.get(_ROOT, "root")) if same else "root"
    names = (root, *first.joint_names)
    # No joint of a humanoid slides; a gripper's would be taken for one that turns.
    arrays = {
        "qpos": np.vstack(q).astype(precision),
        "qvel": np.vstack([_speeds(motion) for motion in motions]).astype(precision),
        "split_points": splits,
        "joint_names": np.array(names),
        "njnt": np.array(len(names)),
        "jnt_type": np.array([_FREE] + [_SINGLE[1]] * len(first.joint_names)),
        "frequency": np.array(first.rate),
        **(
            {key: first.extras[key] for key in _MODEL if key in first.extras}
            if same
            else {}
        ),
    }
    with whole_file(path) as temporary:
        np.savez(temporary, **arrays)


def _speeds(motion: RobotMotion) -> np.ndarray:
    """(T, 6 + n) as MuJoCo has them."""
    if motion.layout == LAYOUT and motion.is_as_read and "joint_vel" in motion.computed:
        return motion.computed["joint_vel"]
    step = 1.0 / motion.rate
    w_W = turning(motion.root_rotations, step)
    w_R = motion.root_rotations.inv().apply(w_W)
    v, qdot = (
        difference(x, step) for x in (motion.root_positions, motion.joint_positions)
    )
    return np.hstack([v, w_R, qdot])
