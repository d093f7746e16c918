"""Speeds, accelerations, jerk and jumps of a motion's samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crar_drake.motion.leaps import leaps
from crar_drake.references.robot_motion import RobotMotion

# A step is a jump where its speed differs by more than this from that of both steps
# beside it: a fast motion has fast neighbours.
_JOINT_JUMP = 15.0  # [rad/s]
_ROOT_JUMP = 3.0  # [m/s]
_ROOT_TURN_JUMP = 15.0  # [rad/s]


@dataclass(frozen=True)
class Jump:
    """A step from one frame to the next that its neighbours do not explain."""

    what: str  # "root position", "root orientation", or a joint's name
    frame: int  # the first frame after it, from 0
    size: float  # of the step, beyond that of its neighbours [m or rad]
    unit: str  # of `size`


def rms(values: np.ndarray) -> float:
    """Root mean square of all entries; 0 of none."""
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def joint_label(motion: RobotMotion, column: int) -> str:
    """A joint's name, or its number from 1 where the file has no names."""
    if motion.joint_names:
        return motion.joint_names[column]
    return f"joint {column + 1}"


def step_speeds(motion: RobotMotion) -> np.ndarray:
    """(T - 1, n) mean speeds from each frame to the next [rad/s or m/s].

    Whatever the motion does between two samples, it is as fast as that once.
    """
    return np.diff(motion.joint_positions, axis=0) * motion.rate


def joint_jerks(motion: RobotMotion) -> np.ndarray:
    """(T - 3, n) third differences over the third power of the step [rad/s^3]."""
    return np.diff(motion.joint_positions, 3, axis=0) * motion.rate**3


def root_acceleration(positions: np.ndarray, rate: float) -> tuple[float, float]:
    """Root mean square and largest size of the second differences of (T, 3) positions
    over the square of the step [m/s^2]; 0 of fewer than three."""
    sizes = np.linalg.norm(np.diff(positions, 2, axis=0), axis=1) * rate**2
    return rms(sizes), float(sizes.max(initial=0.0))


def find_jumps(motion: RobotMotion) -> tuple[Jump, ...]:
    """All jumps, in the order of their frames."""
    jumps = []
    rate = motion.rate
    for column in range(motion.num_joints):
        steps = np.diff(motion.joint_positions[:, column : column + 1], axis=0)
        for frame, size in leaps(steps, _JOINT_JUMP / rate):
            jumps.append(Jump(joint_label(motion, column), frame, size, "rad"))
    for frame, size in leaps(np.diff(motion.root_positions, axis=0), _ROOT_JUMP / rate):
        jumps.append(Jump("root position", frame, size, "m"))
    R = motion.root_rotations
    if len(R) > 1:
        turns = (R[1:] * R[:-1].inv()).as_rotvec()
        for frame, size in leaps(turns, _ROOT_TURN_JUMP / rate):
            jumps.append(Jump("root orientation", frame, size, "rad"))
    return tuple(sorted(jumps, key=lambda jump: (jump.frame, jump.what)))
