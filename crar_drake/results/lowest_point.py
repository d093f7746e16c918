"""What of a run was lowest over the floor."""

from dataclasses import replace

import numpy as np

from crar_drake.references.ground_contact import Outline
from crar_drake.references.whole_body import WholeBody
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_motion import motion_of_log

_MOST_RATE = 100.0  # [Hz] of samples that are looked at


def lowest_point(
    log: SimulationLog, robot: WholeBody, start: float = 0.0
) -> tuple[float, str, float]:
    """Height over the floor z = 0 [m], link and time [s] of what was lowest in a run.

    Args:
        log: of a robot the root of which a motion moves.
        start: what is before is left out, such as blending in [s].

    Raises:
        MotionError, CrarError: as of `motion_of_log`.
    """
    motion = motion_of_log(log, robot)
    first = int(np.searchsorted(log.time, start - 1e-9))
    first = min(first, motion.num_frames - 2)
    every = max(1, int(np.ceil(motion.rate / _MOST_RATE - 1e-9)))
    rows = slice(first, None, every)
    seen = replace(motion.frames(rows), rate=motion.rate / every)
    contact = Outline(robot).ground_contact(seen, floor=0.0)
    low = int(contact.lowest.argmin())
    time = float(log.time[rows][low])
    return float(contact.lowest[low]), contact.lowest_links[low], time
