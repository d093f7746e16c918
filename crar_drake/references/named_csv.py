"""CSV files with a heading, as BONES-SEED has them: columns by name, in any order.

=============================  ======================================================
columns                        what
=============================  ======================================================
Frame                          a number, not read
root_translateX, ...Y, ...Z    the root in the world [cm]
root_rotateX, ...Y, ...Z       its orientation [deg]: turned about the world's x by the
                               first, then about its y, then about its z
JOINT_dof                      the joint JOINT [deg]
=============================  ======================================================

The rate is not in the file; it is 120 Hz in the data set. Sources: the data set's card
(huggingface.co/datasets/bones-studio/seed); `convert_g1_csv_to_proto.py` of
ProtoMotions and `models.ts` of bones-studio/seed-viewer, which agree on the order of
the angles.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError, printable
from crar_drake.files import whole_file
from crar_drake.motion.robots_own import NAMED_ROOT
from crar_drake.references.robot_motion import RobotMotion

USUAL_RATE = 120.0  # [Hz]

_ROOT = (*NAMED_ROOT, *(f"root_rotate{axis}" for axis in "XYZ"))
_JOINT = "_dof"
_EULER = "xyz"  # SciPy's small letters: about axes that stay
_CENTIMETRE = 0.01  # [m]


def read_named_csv(
    path: Path, heading: Sequence[str], table: np.ndarray, rate: float | None
) -> tuple[RobotMotion]:
    """The motion of a table with a heading.

    Args:
        path: of the file, for errors.
        heading: (C,) names of the columns.
        table: (T, C) finite numbers.
        rate: samples per second [Hz]; None for the usual one.

    Raises:
        MotionError: columns are missing, or there is no joint.
    """
    columns = {name.strip(): i for i, name in enumerate(heading)}
    missing = [name for name in _ROOT if name not in columns]
    joints = [name for name in columns if name.endswith(_JOINT)]
    if missing or not joints or len(columns) != len(heading):
        wrong = f"no {', '.join(missing)}" if missing else "a column there twice"
        raise MotionError(
            f"{path}: its heading has {wrong if joints else 'no JOINT_dof'}; such "
            f"files have {', '.join(_ROOT)} [cm, deg], and JOINT_dof [deg] of a joint "
            f"(found: {printable(', '.join(list(columns)[:8]))})"
        )
    rows = table[:, [columns[name] for name in (*_ROOT, *joints)]]
    root, degrees = rows[:, : len(_ROOT)], rows[:, len(_ROOT) :]
    turns = Rotation.from_euler(_EULER, root[:, 3:], degrees=True).as_quat()
    guesses = ()
    if rate is None:
        rate = USUAL_RATE
        guesses = (f"{rate:g} Hz, the rate of BONES-SEED, as files do not say it",)
    return (
        RobotMotion(
            joint_names=tuple(name.removesuffix(_JOINT) for name in joints),
            root_positions=_CENTIMETRE * root[:, :3],
            root_quaternions=turns[:, [3, 0, 1, 2]],
            joint_positions=np.radians(degrees),
            rate=float(rate),
            layout="named-csv",
            source=str(path),
            guesses=guesses,
            # Degrees in radians and back are not the same to the last bit.
            computed={"rows": rows},
        ).as_read(),
    )


def write_named_csv(path: str | os.PathLike[str], motion: RobotMotion) -> None:
    """Writes such a file; the motion's joints have names.

    Raises:
        MotionError: they have none.
    """
    if not motion.joint_names:
        raise MotionError(
            f"{path}: named-csv has the joints' names, and the motion has none: say "
            "which robot it is (--robot)"
        )
    if motion.layout == "named-csv" and motion.is_as_read:
        rows = motion.computed["rows"]
    else:
        turns = motion.root_rotations.as_euler(_EULER, degrees=True)
        joints = np.degrees(motion.joint_positions)
        rows = np.hstack([motion.root_positions / _CENTIMETRE, turns, joints])
    heading = ["Frame", *_ROOT, *(name + _JOINT for name in motion.joint_names)]
    with whole_file(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(",".join(heading) + "\n")
        for frame, row in enumerate(rows.tolist()):
            file.write(f"{frame}," + ",".join(map(repr, row)) + "\n")
