"""The one motion that a robot makes of a performer's, whoever asks for it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.performer import Performer
from crar_drake.robot.description import RobotDescription
from crar_drake.trajectory.retargeting import (
    Retargeted,
    Retargeter,
    RetargetingParameters,
)

RATE = 30.0  # [Hz] that most reference motions have

# A process that asks for more motions than this computes them anew.
_KEPT = 8
_known: dict[tuple, tuple[Retargeter, Retargeted]] = {}


def retargeted_motion(
    description: RobotDescription,
    performer: Performer,
    rate: float = RATE,
    parameters: RetargetingParameters | None = None,
    progress: Callable[[int], None] | None = None,
) -> tuple[Retargeter, Retargeted]:
    """A performer's motion on a whole robot; what was asked for before is known.

    Args:
        description: of a robot with legs and arms; a ground does not count.
        performer: with legs.
        rate: frames per second [Hz].
        parameters: what is wanted.
        progress: is called with the number of frames that are done.

    Returns:
        Whoever retargets to the robot, and the motion.

    Raises:
        MotionError: the performer lacks something, its points are relative to the
            pelvis, or it is too short.
        ModelError: the robot lacks something.
    """
    if performer.duration * rate < 1.0 - 1e-9:
        raise MotionError(
            f"motion {performer.name}: {performer.duration:.3f} s are too short: two "
            f"frames at {rate:g} Hz are needed"
        )
    description = description.without_ground()
    parameters = parameters or RetargetingParameters()
    key = repr(description), _fingerprint(performer), rate, parameters
    if key not in _known:
        retargeter = Retargeter(description, parameters)
        found = retargeter.retarget(performer, rate, progress)
        while len(_known) >= _KEPT:
            del _known[next(iter(_known))]
        _known[key] = retargeter, found
    return _known[key]


def _fingerprint(performer: Performer) -> bytes:
    """Of all that retargeting looks at."""
    digest = hashlib.sha256(repr((performer.name, performer.frame_rate)).encode())
    for part in (performer.positions, performer.orientations, performer.hands):
        for name in sorted(part):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(part[name]).tobytes())
    return digest.digest()
