"""Whether motors were too weak for what was commanded, by which the proof is lost.

The theorem of `docs/theory/theorem.md` assumes that the plant does what is commanded.
Where not even braking is within the effort limits, torques are clipped, and it does
not.
"""

import numpy as np

from crar_drake.errors import few
from crar_drake.results.log import SimulationLog

# Motors that the line names.
_MOST = 2

# A torque of this share of its limit is at it [1].
_AT_LIMIT = 0.999
# A torque that is beyond its limit by less is not clipped but for rounding [1].
_NO_EXCESS = 1e-4
# Where limits leave less of the nominal step, they hold the robot back [1].
_HELD_BACK = 0.9


def limited_samples(log: SimulationLog) -> np.ndarray:
    """(T,) bool, whether effort limits took more than a tenth of the nominal step. A
    plan asks for all that motors give, and loses a percent of it now and then."""
    return log.torque_limit[:, 0] < _HELD_BACK


def clipped_samples(log: SimulationLog) -> np.ndarray:
    """(T,) bool, whether a torque was clipped by more than rounding."""
    return log.torque_limit[:, 1] > _NO_EXCESS


def clipped_line(log: SimulationLog) -> str:
    """Says in how many samples of a log torques were clipped, since when, and of which
    motors; "" if none was."""
    clipped = clipped_samples(log)
    if not clipped.any():
        return ""
    at_limit = np.abs(log.actuation[clipped]) >= _AT_LIMIT * log.effort_limits
    often = at_limit.sum(axis=0)
    motors = [
        f"{log.actuator_names[i]} ({log.effort_limits[i]:g})"
        for i in np.argsort(-often, kind="stable")
        if often[i]
    ]
    of = f" of {few(motors, _MOST)}" if motors else ""
    return (
        f"torques were clipped in {np.count_nonzero(clipped)} samples, the first at "
        f"{log.time[clipped][0]:.3f} s: not even braking was within the effort limits"
        f"{of}. The robot did not do there what was commanded, and from then on "
        "nothing is proved of it; are these the limits of the real motors, and has it "
        "springs that the model has not?"
    )
