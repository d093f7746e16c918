"""How far one motion of a robot is from another, and how smooth both are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crar_drake.errors import ModelError
from crar_drake.references.ground_contact import FEET, HANDS
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.smoothness import joint_jerks, rms
from crar_drake.references.whole_body import WholeBody

# A joint that is faster moves [rad/s]; to this share of its speed it stands still.
_MOVES, _STILL = 0.5, 0.02


@dataclass(frozen=True)
class Change:
    """What became of a motion."""

    joints_rms: float  # of the joints [rad]
    joints_worst: float  # [rad]
    feet_rms: float  # of the positions of the feet's links in W [m]; NaN without feet
    feet_worst: float  # [m]
    hands_rms: float  # of those of the hands' links [m]; NaN without hands
    hands_worst: float  # [m]
    jerk_before: float  # root mean square of the joints' [rad/s^3]
    jerk: float  # and after the change


@dataclass(frozen=True)
class AtMost:
    """How far a motion may change."""

    joints: float = np.inf  # any joint at any frame [rad]
    feet: float = np.inf  # any foot's link [m]
    hands: float = np.inf  # any hand's [m]

    def check(self, robot: WholeBody) -> None:
        """Raises ModelError if the robot lacks what is asked about."""
        for part, frames in (("feet", FEET), ("hands", HANDS)):
            there = set(frames) & set(robot.description.task_frames)
            if getattr(self, part) < np.inf and not there:
                raise ModelError(
                    f"robot {robot.description.name} has no task_frames "
                    f"{' and '.join(frames)}, whose change is limited: add them to its "
                    f"robot.yaml, or leave {part} away"
                )

    def exceeded(self, change: Change) -> str:
        """What changed by more, in words; "" if nothing did."""
        found = []
        for part, scale, unit in (
            ("joints", 180.0 / np.pi, "deg"),
            ("feet", 1e3, "mm"),
            ("hands", 1e3, "mm"),
        ):
            worst, most = getattr(change, f"{part}_worst"), getattr(self, part)
            if worst > most:
                found.append(
                    f"{part} by {scale * worst:.1f} {unit} where {scale * most:g} "
                    f"{unit} is allowed"
                )
        return ", ".join(found)


def find_change(before: RobotMotion, after: RobotMotion, robot: WholeBody) -> Change:
    """From one motion to another of as many frames.

    Args:
        before, after: with their joints in the robot's order.
        robot: that moves.
    """
    joints = after.joint_positions - before.joint_positions
    feet, hands = (_moved(before, after, robot, of) for of in (FEET, HANDS))
    return Change(
        joints_rms=rms(joints),
        joints_worst=float(np.abs(joints).max()),
        feet_rms=rms(feet),
        feet_worst=float(feet.max()),
        hands_rms=rms(hands),
        hands_worst=float(hands.max()),
        jerk_before=rms(joint_jerks(before)),
        jerk=rms(joint_jerks(after)),
    )


def _moved(
    before: RobotMotion, after: RobotMotion, robot: WholeBody, frames: Sequence[str]
) -> np.ndarray:
    """(T, L) how far the links of task frames are apart [m]; NaN without any."""
    links = robot.links_at(frames)
    was, now = (
        robot.poses_in_world(
            m.root_positions, m.root_rotations, m.joint_positions, links
        )[0]
        for m in (before, after)
    )
    return np.linalg.norm(now - was, axis=2) if links else np.full((1, 1), np.nan)


def find_frozen(before: RobotMotion, after: RobotMotion) -> np.ndarray:
    """(T,) whether all joints stand still on the way to the next frame while they move
    before.

    Args:
        before, after: of as many frames.
    """
    was, now = (
        np.abs(np.diff(m.joint_positions, axis=0, append=m.joint_positions[-1:])).max(
            axis=1, initial=0.0
        )
        for m in (before, after)
    )
    return (was * before.rate > _MOVES) & (now < _STILL * was)
