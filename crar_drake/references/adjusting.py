"""A motion trimmed to some of its frames, or set down on the floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from crar_drake.errors import ModelError, MotionError
from crar_drake.references.ground_contact import FEET, Outline
from crar_drake.references.robot_motion import RobotMotion, has_rows

# A floor that is as near to z = 0 is there: what files round moves it by less [m].
_ON_THE_GROUND = 1e-5

# How keys of positions in the world end, such as those of an object.
_IN_WORLD = "_pos_w"

# First and last frame, counted from 1, both included; None for the motion's last.
Frames = tuple[int, int | None]


def trimmed(motion: RobotMotion, frames: Frames) -> RobotMotion:
    """The motion from one frame to another; what has a row for each frame with it.

    A last frame beyond the motion's end is the motion's last.

    Raises:
        MotionError: the motion ends before the first frame.
    """
    first, last = frames
    if first > motion.num_frames:
        raise MotionError(
            f"{motion.source}: has {motion.num_frames} frames, and is to be trimmed to "
            f"those from {first} on; begin earlier"
        )
    if first == 1 and (last is None or last >= motion.num_frames):
        return motion
    return motion.frames(slice(first - 1, last))


def set_on_ground(motion: RobotMotion, outline: Outline) -> tuple[RobotMotion, float]:
    """The motion with the floor of its feet at z = 0, and by how much it was raised
    [m]; objects whose positions in the world the file has are raised with it.

    Args:
        motion: with its joints in the order of the robot.
        outline: of the robot, with feet (`check_feet`).
    """
    rise = -outline.ground_contact(motion).floor
    if abs(rise) < _ON_THE_GROUND:
        return motion, 0.0
    up = np.array([0.0, 0.0, rise])
    return replace(
        motion,
        root_positions=motion.root_positions + up,
        extras={
            key: _raised(value, up, motion.num_frames)
            if key.endswith(_IN_WORLD)
            else value
            for key, value in motion.extras.items()
        },
        computed={},
    ), rise


def check_feet(outline: Outline, robot: str) -> None:
    """Raises ModelError unless a robot has feet whose floor can be found."""
    if not outline.feet:
        raise ModelError(
            f"robot {robot}: no foot has a shape, so that nothing says where its floor "
            f"is; add task_frames {' and '.join(FEET)} to its robot.yaml, or leave "
            "--ground away"
        )


def _raised(value: object, up: np.ndarray, frames: int) -> object:
    if not has_rows(value, frames) or value.shape[-1] != 3:
        return value
    return (value + up).astype(value.dtype)
