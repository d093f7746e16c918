"""NPZ files of motions that policies are trained on, with T frames.

===============  ============  ====================================================
key              shape         what
===============  ============  ====================================================
fps              (1,) or ()    frames per second [Hz]
joint_pos        (T, n)        joints [rad]; or (T, 7 + n): x y z [m] and w x y z of
                               the root before them
joint_vel        (T, n)        their velocities [rad/s]; or (T, 6 + n): the root's
                               velocity [m/s] and angular velocity [rad/s] before
                               them, both in the world
body_pos_w       (T, B, 3)     origins of the links in the world [m]
body_quat_w      (T, B, 4)     their orientations, w x y z
body_lin_vel_w   (T, B, 3)     velocities of the origins, in the world [m/s]
body_ang_vel_w   (T, B, 3)     angular velocities, in the world [rad/s]
joint_names      (n,)          only with the root in `joint_pos`
body_names       (B,)          the same
===============  ============  ====================================================

Three kinds are in use with these names. `beyondmimic-npz` has joints and links breadth
first, as Isaac Lab has them, and `mjlab-npz` depth first, as MuJoCo has them; link 0 is
the root, and names are in neither. (mjlab trained on the other kind tracks wrong
links.) `holosoma-npz` has the root in `joint_pos`, depth first, and the names.

A fourth, `amp-npz` of Isaac Lab's AMP tasks and of "AMASS Retargeted for G1", has the
same under other names: `dof_names`, `dof_positions`, `dof_velocities`,
`body_positions`, `body_rotations`, `body_linear_velocities`, `body_angular_velocities`;
links are some or all, the first is the root. Source: `motion_loader.py` of the task
`humanoid_amp` in github.com/isaac-sim/IsaacLab.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.files import whole_file
from crar_drake.motion.array_files import load_arrays, npz_names
from crar_drake.references.held_values import check_frames, numbers, stated_rate
from crar_drake.references.locomujoco_npz import LAYOUT as LOCOMUJOCO
from crar_drake.references.locomujoco_npz import read_locomujoco
from crar_drake.references.robot_motion import (
    ORDER_UNKNOWN,
    UNKNOWN_ORDER,
    RobotMotion,
)
from crar_drake.references.root_speeds import difference, turning
from crar_drake.references.whole_body import WholeBody

USUAL_RATE = 50.0  # [Hz]

_BODY_KEYS = ("body_pos_w", "body_quat_w", "body_lin_vel_w", "body_ang_vel_w")
_COMPUTED = ("joint_vel", *_BODY_KEYS)

# Keys of `amp-npz`, which are read and written as the others'.
_AMP = "amp-npz"
_AMP_KEYS = {
    "dof_names": "joint_names",
    "dof_positions": "joint_pos",
    "dof_velocities": "joint_vel",
    "body_positions": "body_pos_w",
    "body_rotations": "body_quat_w",
    "body_linear_velocities": "body_lin_vel_w",
    "body_angular_velocities": "body_ang_vel_w",
}
_AMP_SHAPES = {"dof_positions": 2, "body_positions": 3, "body_rotations": 3}

# Links whose distance to the one before changes less than this hang on it [m]; what
# float32 rounds a few metres to is a tenth of it.
_RIGID = 1e-5

# Depth first, most links hang on the one before; breadth first, few do.
_DEPTH_FIRST_SHARE, _BREADTH_FIRST_SHARE = 0.6, 0.4


def read_npz(
    path: Path,
    layout: str | None,
    rate: float | None,
    joint_names: Sequence[str] | None,
) -> tuple[RobotMotion, ...]:
    """Reads an NPZ file; `layout` None tells the kinds apart.

    Where the file does not tell the two kinds without names apart, `layout` of the
    motion is `UNKNOWN_ORDER`, and its robot has to (`robot_match`).

    Raises:
        MotionError: the file is damaged.
    """
    if layout == LOCOMUJOCO or "qpos" in npz_names(path):
        return read_locomujoco(path, layout, rate)
    arrays = load_arrays(path)
    amp = "dof_positions" in arrays and "joint_pos" not in arrays
    if amp:
        for key, dimensions in _AMP_SHAPES.items():
            numbers(path, arrays, key, *[None] * dimensions)
        if "dof_names" not in arrays:
            raise MotionError(f"{path}: it has no dof_names, the joints' names")
        arrays = {_AMP_KEYS.get(key, key): array for key, array in arrays.items()}
    if "joint_pos" not in arrays:
        log = "; it looks like the log of a run" if "signed_distances" in arrays else ""
        raise MotionError(
            f"{path}: it has no joint_pos, and so is no motion of a robot{log}"
        )
    guesses = []
    if rate is None:
        rate = stated_rate(path, arrays, usual=USUAL_RATE, guesses=guesses)
    q = numbers(path, arrays, "joint_pos", None, None)
    if amp != (layout == _AMP) and layout is not None:
        raise MotionError(f"{path}: its keys are not those of {layout}")
    if not amp and _has_root(path, layout, arrays, q):
        layout = "holosoma-npz"
        p_WR, Q_WR, joints = q[:, :3], q[:, 3:7], q[:, 7:]
        names = tuple(str(name) for name in arrays.get("joint_names", ()))
    else:
        names = ()
        if amp:
            layout, names = _AMP, tuple(str(name) for name in arrays["joint_names"])
        elif layout is None:
            layout, evidence = _guess_order(path, arrays)
            guesses.append(evidence)
        p_WR = numbers(path, arrays, "body_pos_w", None, None, 3)
        Q_WR = numbers(path, arrays, "body_quat_w", None, None, 4)
        links = {"joint_pos": q, "body_pos_w": p_WR, "body_quat_w": Q_WR}
        check_frames(path, links)
        p_WR, Q_WR, joints = p_WR[:, 0], Q_WR[:, 0], q
    return (
        RobotMotion(
            joint_names=names or tuple(joint_names or ()),
            root_positions=p_WR.astype(float),
            root_quaternions=Q_WR.astype(float),
            joint_positions=joints.astype(float),
            rate=float(rate),
            layout=layout,
            source=str(path),
            precision=q.dtype.name,
            guesses=tuple(guesses),
            extras={
                key: value
                for key, value in arrays.items()
                if key not in ("fps", "joint_pos", "joint_names", *_COMPUTED)
            },
            computed={key: arrays[key] for key in _COMPUTED if key in arrays},
        ).as_read(),
    )


def write_npz(
    path: str | os.PathLike[str],
    motion: RobotMotion,
    layout: str,
    robot: WholeBody | None,
) -> None:
    """Writes an NPZ file.

    Velocities are central differences of the samples (one-sided at the ends), as the
    tools that make such files take them; links' poses and velocities are the robot's.

    Args:
        path: of the file.
        motion: its joints in the order of the layout.
        layout: its name.
        robot: that moves; not needed where the file had its links' poses and nothing
            has changed since.

    Raises:
        MotionError: there is no robot to compute links' poses with.
    """
    same = motion.layout == layout
    precision = motion.precision if same and motion.precision else _precision(layout)
    values = dict(motion.computed) if same and motion.is_as_read else {}
    extras = dict(motion.extras) if same else {}
    if not set(_COMPUTED) <= values.keys():
        if robot is None:
            raise MotionError(
                f"{path}: {layout} has the poses of the robot's links, which follow "
                "from its model: say which robot (--robot)"
            )
        links = robot.links_of(motion.joint_names)
        kept = tuple(str(name) for name in extras.pop("body_names", ()))
        if layout == _AMP and kept and all(map(robot.has_link, kept)):
            links = kept  # its first is the root's
        values = {
            key: value.astype(precision)
            for key, value in _computed(motion, layout, robot, links).items()
        }
        if layout in ("holosoma-npz", _AMP):
            extras["body_names"] = np.array(links)
    q = motion.joint_positions
    if layout == "holosoma-npz":
        q = np.hstack([motion.root_positions, motion.root_quaternions, q])
    if layout in ("holosoma-npz", _AMP) and motion.joint_names:
        extras["joint_names"] = np.array(motion.joint_names)
    rate = motion.rate
    fps = np.array([int(rate) if rate == int(rate) else rate])
    arrays = {"fps": fps, "joint_pos": q.astype(precision), **values, **extras}
    if layout == _AMP:
        amp = {ours: theirs for theirs, ours in _AMP_KEYS.items()}
        arrays = {amp.get(key, key): array for key, array in arrays.items()}
    with whole_file(path) as temporary:
        np.savez(temporary, **arrays)


def _precision(layout: str) -> str:
    return "float64" if layout == "holosoma-npz" else "float32"


def _computed(
    motion: RobotMotion, layout: str, robot: WholeBody, links: tuple[str, ...]
) -> dict[str, np.ndarray]:
    """Velocities, and the links' poses and velocities in the world."""
    step = 1.0 / motion.rate
    R_WR = motion.root_rotations
    v_WR, w_WR = difference(motion.root_positions, step), turning(R_WR, step)
    qdot = difference(motion.joint_positions, step)
    columns = robot.columns_in(motion.joint_names)
    q, v = motion.joint_positions[:, columns], qdot[:, columns]
    p_RB, R_RB = robot.poses_in_root(q, links)
    v_RB, w_RB = robot.velocities_in_root(q, v, links)
    R = R_WR.as_matrix()[:, None]
    p_RB_W, v_RB_W, w_RB_W = (
        np.einsum("tlij,tlj->tli", np.broadcast_to(R, R_RB.shape), x)
        for x in (p_RB, v_RB, w_RB)
    )
    turned = np.cross(w_WR[:, None], p_RB_W)
    quaternions = Rotation.from_matrix((R @ R_RB).reshape(-1, 3, 3)).as_quat()
    quaternions = quaternions[:, [3, 0, 1, 2]].reshape(*p_RB.shape[:2], 4)
    # Of the root the samples themselves, not what they are after two conversions.
    quaternions[:, 0] = motion.root_quaternions
    joint_vel = qdot
    if layout == "holosoma-npz":
        joint_vel = np.hstack([v_WR, w_WR, qdot])
    return {
        "joint_vel": joint_vel,
        "body_pos_w": motion.root_positions[:, None] + p_RB_W,
        "body_quat_w": quaternions,
        "body_lin_vel_w": v_WR[:, None] + turned + v_RB_W,
        "body_ang_vel_w": w_WR[:, None] + w_RB_W,
    }


def _has_root(
    path: Path, layout: str | None, arrays: dict[str, np.ndarray], q: np.ndarray
) -> bool:
    """Whether the root is in joint_pos."""
    columns = q.shape[1]
    with_root = layout == "holosoma-npz"
    if "joint_names" in arrays:
        names = len(arrays["joint_names"])
        if columns not in (names, names + 7):
            raise MotionError(
                f"{path}: joint_pos has {columns} columns, but there are {names} joint "
                f"names; {names} columns are expected, or {names + 7} with the root"
            )
        with_root = columns == names + 7
    elif layout is None and "joint_vel" in arrays:
        # A quaternion has one number more than an angular velocity.
        with_root = arrays["joint_vel"].shape[1:] == (columns - 1,)
    if with_root and columns < 8:
        raise MotionError(
            f"{path}: joint_pos has {columns} columns; of {layout} the root has seven, "
            "and there is a joint at least"
        )
    if layout is not None and with_root != (layout == "holosoma-npz"):
        raise MotionError(
            f"{path}: joint_pos has {columns} columns, which is not as {layout} has "
            "it; leave --layout away"
        )
    return with_root


def _guess_order(path: Path, arrays: dict[str, np.ndarray]) -> tuple[str, str]:
    """Which of the kinds without names, by which links hang on the one before."""
    p = numbers(path, arrays, "body_pos_w", None, None, 3).astype(float)
    apart = np.linalg.norm(np.diff(p[:, 1:], axis=1), axis=2)
    share = float((np.ptp(apart, axis=0) < _RIGID).mean()) if apart.size else 1.0
    evidence = f"{100 * share:.0f} % of the links hang on the one before"
    if share > _DEPTH_FIRST_SHARE:
        return "mjlab-npz", f"joints are depth first, as MuJoCo's: {evidence}"
    if share < _BREADTH_FIRST_SHARE:
        return "beyondmimic-npz", f"joints are breadth first, as Isaac's: {evidence}"
    return UNKNOWN_ORDER, (
        f"{ORDER_UNKNOWN}depth first or breadth first cannot be guessed ({evidence})"
    )
