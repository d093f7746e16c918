"""Whether a robot's limbs point where the performer's do.

Points may follow their targets closely while an elbow is bent backwards, or stand far
from them while the posture is right. The angle between limbs is another figure than the
error of points, and depends on no length.
"""

from dataclasses import dataclass

import numpy as np

from crar_drake.law.solution import STATUS_TRACKING
from crar_drake.motion.conditioning import angles_between
from crar_drake.motion.performer import SIDES, Performer
from crar_drake.results.log import SimulationLog
from crar_drake.robot.description import find_frame
from crar_drake.robot.model import ControlModel

_MOST_RATE = 100.0  # [Hz] of samples that are looked at

_ARM, _LEG = {"elbow", "wrist", "hand"}, {"knee", "foot"}

# A limb's name; the performer's joints and the robot's task frames at its ends; what a
# task must move for it to count; and the tasks that settle where it points: two wrists
# alone leave the elbows open.
_PARTS = (
    ("upper_arm", ("shoulder", "elbow"), ("shoulder", "elbow"), _ARM, {"elbow"}),
    ("forearm", ("elbow", "wrist"), ("elbow", "wrist"), _ARM, {"elbow", "wrist"}),
    ("thigh", ("hip", "knee"), ("hip", "knee"), _LEG, {"foot"}),
    ("shin", ("knee", "ankle"), ("knee", "foot"), _LEG, {"foot"}),
)


@dataclass(frozen=True)
class LimbDirection:
    """The angle between a limb's direction and the performer's, both in the world."""

    median: float  # over time [rad]
    most: float  # what 95 % of the time are below [rad]
    # whether the tasks settle where it points; two wrists alone, for example, leave the
    # elbows open
    followed: bool


def limb_directions(
    log: SimulationLog, model: ControlModel, performer: Performer | None, start: float
) -> dict[str, LimbDirection]:
    """How far the limbs of a run are off in direction.

    Args:
        performer: whom it follows; None with keyframes.
        start: what is before is left out: the targets are blended in [s].

    Returns:
        "left_upper_arm", ... "right_shin" to its figures, of those limbs of which the
        robot has both ends as task frames, the performer both joints, and that a task
        moves. Samples without targets, and after the motion's end, do not count.
    """
    limbs = [] if performer is None else _limbs(model, performer)
    time = log.time - log.time[0]
    counted = (time >= start) & (log.status[:, 0] == STATUS_TRACKING)
    counted &= np.isfinite(log.q).all(axis=1)
    rows = np.flatnonzero(counted)
    if limbs:
        rows = rows[time[rows] <= performer.duration + 1e-9]
    if not (limbs and len(rows)):
        return {}
    step = np.median(np.diff(log.time)) if len(log.time) > 1 else np.inf
    rows = rows[:: max(1, int(np.ceil(1.0 / (_MOST_RATE * step) - 1e-9)))]

    plant, frames = model.plant, model.description.task_frames
    context = model.MakeWorkspace().plant_context
    points = {
        name: find_frame(plant, frames[name])
        for _, _, ends, _ in limbs
        for name in ends
    }
    places = {name: np.empty((len(rows), 3)) for name in points}
    for i, row in enumerate(rows):
        plant.SetPositions(context, log.q[row])
        for name, frame in points.items():
            places[name][i] = frame.CalcPoseInWorld(context).translation()

    found = {}
    for name, (a, b), (c, d), followed in limbs:
        theirs = performer.positions[b] - performer.positions[a]
        theirs = np.column_stack(
            [np.interp(time[rows], performer.time, column) for column in theirs.T]
        )
        angles = angles_between(theirs, places[d] - places[c])
        angles = angles[np.isfinite(angles)]
        if len(angles):
            median, most = np.quantile(angles, (0.5, 0.95))
            found[name] = LimbDirection(float(median), float(most), followed)
    return found


def _limbs(
    model: ControlModel, performer: Performer
) -> list[tuple[str, tuple[str, str], tuple[str, str], bool]]:
    """Name, the performer's joints and the robot's frames of what can be compared, and
    whether it is followed."""
    frames = model.description.task_frames
    tasks = {task.frame for task in model.tasks}
    found = []
    for side in SIDES:
        for part, joints, ends, moved, needed in _PARTS:
            a, b = (f"{side}_{joint}" for joint in joints)
            c, d = (f"{side}_{end}" for end in ends)
            if (
                {a, b} <= performer.positions.keys()
                and {c, d} <= frames.keys()
                and tasks & {f"{side}_{task}" for task in moved}
            ):
                followed = {f"{side}_{task}" for task in needed} <= tasks
                found.append((f"{side}_{part}", (a, b), (c, d), followed))
    return found
