"""What is special about trajectories of LocoMuJoCo (version 1): several in one file.

===============  ============  ====================================================
key              shape         what
===============  ============  ====================================================
joint_names      (1 + n,)      the root's joint and the others, as MuJoCo has them
jnt_type         (1 + n,)      MuJoCo's: 0 is free, 2 slides, 3 turns
njnt             ()            1 + n
qpos, qvel       (N, ...)      of all trajectories, one after the other
split_points     (M + 1,)      where each of M trajectories begins; N
===============  ============  ====================================================

What follows from the motion and MuJoCo's model (`xpos`, `site_xpos` and others) is not
kept: LocoMuJoCo computes it. Its files of version 0, a key for each joint
(`q_left_knee_joint`), are not read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from crar_drake.errors import MotionError

NAME = "locomujoco-npz"

MARKS = {"jnt_type", "split_points"}
# Of the model, whatever it does.
_MODEL = ("body_names", "site_names", "nbody", "nsite") + tuple(
    [f"body_{key}" for key in ("rootid", "weldid", "mocapid")]
    + [f"body_{key}" for key in ("pos", "quat", "ipos", "iquat")]
    + [f"site_{key}" for key in ("bodyid", "pos", "quat")]
)
KEPT = {*MARKS, *_MODEL, "frequency", "joint_names", "qpos", "qvel"}
_FREE, _SINGLE = 0, (2, 3)
_ROOT = "root_joint"  # its name, of our own extras


def trajectories(where: object, held: Mapping[str, np.ndarray]) -> dict[str, dict]:
    """What the file holds of each trajectory, by its name; "" of a single one.

    Raises:
        MotionError: the file is damaged, or its robot has no root that is free or
            joints of several degrees of freedom.
    """
    names = [str(name) for name in np.atleast_1d(held["joint_names"])]
    q, types = held["qpos"], np.atleast_1d(held["jnt_type"])
    numbers = q.ndim == 2 and q.dtype.kind in "fiu" and q.shape[1] == len(names) + 6
    if len(types) != len(names) or not numbers:
        raise MotionError(
            f"{where}: {len(names)} joint names, {len(types)} types, and an array qpos "
            f"{q.shape} of {q.dtype}; it has six columns more than there are names"
        )
    if types[0] != _FREE or not np.isin(types[1:], _SINGLE).all():
        raise MotionError(
            f"{where}: its first joint has to be free and all others of one degree of "
            f"freedom; jnt_type is {types.tolist()}"
        )
    splits = np.ravel(held["split_points"])
    whole = (
        splits.dtype.kind in "iu" and len(splits) > 1 and (np.diff(splits) > 0).all()
    )
    if not whole or splits[0] != 0 or splits[-1] != len(q):
        raise MotionError(
            f"{where}: split_points {splits} do not go from 0 to the {len(q)} samples"
        )
    model = {key: held[key] for key in _MODEL if key in held}
    of_all = {key: held[key] for key in (*MARKS, "frequency")} | model
    of_all |= {_ROOT: names[0], "joint_names": names[1:]}
    v = held.get("qvel")
    rows = {"qpos": q}
    if v is not None and v.shape == (len(q), q.shape[1] - 1):
        rows["qvel"] = v
    return {
        str(k) if len(splits) > 2 else "": of_all
        | {key: values[a:b] for key, values in rows.items()}
        for k, (a, b) in enumerate(zip(splits[:-1], splits[1:], strict=True))
    }


def joined_trajectories(path: object, clips: Sequence[Mapping[str, object]]) -> dict:
    """What a file of those trajectories holds.

    Raises:
        MotionError: rates or joints differ.
    """
    first = clips[0]
    rates = [float(np.ravel(clip["frequency"])[0]) for clip in clips]
    joints = {tuple(map(str, clip["joint_names"])) for clip in clips}
    if len(joints) > 1 or len(set(rates)) > 1:
        raise MotionError(
            f"{path}: trajectories of one file have the same joints and rate; write "
            "them one by one (--clip), at one rate (--rate)"
        )
    names = (str(first.get(_ROOT, "root")), *first["joint_names"])
    # No joint of a humanoid slides; a gripper's would be taken for one that turns.
    return {
        "qpos": np.vstack([clip["qpos"] for clip in clips]),
        "qvel": np.vstack([clip["qvel"] for clip in clips]),
        "split_points": np.cumsum([0, *(len(clip["qpos"]) for clip in clips)]),
        "joint_names": np.array(names),
        "njnt": np.array(len(names)),
        "jnt_type": np.array([_FREE] + [_SINGLE[1]] * (len(names) - 1)),
        "frequency": np.array(rates[0]),
        **{key: first[key] for key in _MODEL if key in first},
    }
