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

from crar_drake.errors import MotionError
from crar_drake.motion.torch_zip import read_torch_zip
from crar_drake.references.held_values import check_frames, numbers, stated_rate
from crar_drake.references.robot_motion import RobotMotion

LAYOUT = "proto-motion"

_SHAPES = {
    "dof_pos": (None, None),
    "rigid_body_pos": (None, None, 3),
    "rigid_body_rot": (None, None, 4),
}


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
    held = held if isinstance(held, dict) else {}
    q, p, turns = (numbers(path, held, key, *shape) for key, shape in _SHAPES.items())
    if held.get("state_conversion", "common") != "common":
        raise MotionError(
            f"{path}: its joints are in the order of a simulator (state_conversion "
            f"{held['state_conversion']}); save it in ProtoMotions' common order"
        )
    check_frames(path, dict(zip(_SHAPES, (q, p, turns), strict=True)))
    if rate is None:
        rate = stated_rate(path, held)
    return (
        RobotMotion(
            joint_names=tuple(joint_names or ()),
            root_positions=p[:, 0].astype(float),
            root_quaternions=turns[:, 0][:, [3, 0, 1, 2]].astype(float),
            joint_positions=q.astype(float),
            rate=float(rate),
            layout=LAYOUT,
            source=str(path),
            precision=q.dtype.name,
        ).as_read(),
    )
