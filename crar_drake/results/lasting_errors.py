"""Tasks that a run never reached: said aloud, for their points are likely wrong."""

import numpy as np

from crar_drake.results.log import SimulationLog
from crar_drake.results.summary import task_layout

# Who is farther from a target than this all the time does not follow it.
_FAR = 0.1  # [m]
_TURNED = 0.5  # [rad]
_LEAST_TIME = 1.0  # [s] that is looked at, at least


def lasting_error_warnings(log: SimulationLog, start: float) -> list[str]:
    """One line for each task whose error never falls below what following is.

    Args:
        start: what is before is left out: the targets are blended in [s].
    """
    rows = (log.time >= log.time[0] + start) & np.isfinite(log.task_error).all(axis=1)
    times = log.time[rows]
    if not len(times) or times[-1] - times[0] < _LEAST_TIME:
        return []
    layout, errors = task_layout(log), log.task_error[rows]
    kinds = (
        (layout.linear_tasks, layout.linear_rows, _FAR, 1e3, "mm"),
        (layout.angular_tasks, layout.angular_rows, _TURNED, 180.0 / np.pi, "deg"),
    )
    found = []
    for tasks, columns, most, scale, unit in kinds:
        for task, of_task in zip(tasks, columns, strict=True):
            least = float(np.linalg.norm(errors[:, of_task], axis=1).min())
            if least > most:
                found.append(
                    f"{layout.names[task]} is never nearer to its target than "
                    f"{scale * least:.0f} {unit}: it may be the wrong point of the "
                    "robot, or the target is out of its reach"
                )
    return found
