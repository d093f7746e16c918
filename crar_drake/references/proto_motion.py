"""`.motion` files of ProtoMotions: a dict of tensors by `torch.save`; read only.

=====================  ============  ==============================================
key                    shape         what
=====================  ============  ==============================================
fps                    number        frames per second [Hz]
dof_pos                (T, n)        joints [rad], in the order of the robot's MJCF
rigid_body_pos         (T, B, 3)     origins of the links in the world [m]; the
                                     first is the root
rigid_body_rot         (T, B, 4)     their orientations, x y z w
state_conversion       "common"      whose order that is; others are a simulator's
=====================  ============  ==============================================

Source: `simulator_state.py` of github.com/NVlabs/ProtoMotions.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.torch_zip import read_torch_zip
from crar_drake.references.robot_motion import RobotMotion

LAYOUT = "proto-motion"

_SHAPES = {"dof_pos": 2, "rigid_body_pos": 3, "rigid_body_rot": 3}


def read_proto_motion(
    path: Path,
    layout: str | None,
    rate: float | None,
    joint_names: Sequence[str] | None,
) -> tuple[RobotMotion]:
    """Reads a `.motion` file.

    Raises:
        MotionError: it is damaged, holds more than data, lacks a key, or its order is a
            simulator's.
    """
    held = read_torch_zip(path)
    missing = [k for k in _SHAPES if not isinstance(held, dict) or k not in held]
    if missing:
        raise MotionError(f"{path}: it has no {', '.join(missing)}")
    if held.get("state_conversion", "common") != "common":
        raise MotionError(
            f"{path}: its joints are in the order of a simulator (state_conversion "
            f"{held['state_conversion']}); save it in ProtoMotions' common order"
        )
    q, p, turns = (np.asarray(held[key]) for key in _SHAPES)
    for (key, axes), array in zip(_SHAPES.items(), (q, p, turns), strict=True):
        if array.ndim != axes or array.dtype.kind not in "fiu" or 0 in array.shape:
            raise MotionError(
                f"{path}: {key} is an array {array.shape} of {array.dtype}; numbers in "
                f"{axes} dimensions are expected"
            )
    if len({len(q), len(p), len(turns)}) > 1 or (p.shape[2], turns.shape[2]) != (3, 4):
        raise MotionError(
            f"{path}: shapes do not fit: dof_pos {q.shape}, rigid_body_pos {p.shape}, "
            f"rigid_body_rot {turns.shape}"
        )
    fps = np.asarray(held.get("fps"))
    if rate is None and (fps.size != 1 or fps.dtype.kind not in "fiu"):
        raise MotionError(f"{path}: fps is {held.get('fps')}, not one number")
    return (
        RobotMotion(
            joint_names=tuple(joint_names or ()),
            root_positions=p[:, 0].astype(float),
            root_quaternions=turns[:, 0][:, [3, 0, 1, 2]].astype(float),
            joint_positions=q.astype(float),
            rate=float(rate if rate is not None else fps.reshape(())),
            layout=LAYOUT,
            source=str(path),
            precision=q.dtype.name,
        ).as_read(),
    )
