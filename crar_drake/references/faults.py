"""What is wrong with a motion besides penetration, limits and speeds.

Commands that judge, clean or retarget ask the same of the file that they look at. What
is wrong with a file that was written stands in its certificate; what its reference had,
too, and cleaning is not asked to change, was *left as it was*.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from crar_drake.motion.planted_feet import lasting
from crar_drake.references.ground_contact import GroundContact
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.smoothness import find_jumps

# What is wrong for longer than this is a fault [s].
_LASTS = 0.2
# A kind that only who knows the person can find.
LIMBS_OFF = "limbs off"
# Who is higher than this throughout does not jump: the root is in another place, or in
# another unit [m].
_AIRBORNE = 0.5
# Nothing carries a robot that is so high over the floor of its feet [m] while its root
# falls by less than this [m/s^2].
_IN_THE_AIR, _FALLS = 0.03, 9.81 / 3.0


@dataclass(frozen=True)
class Tolerances:
    """What is still no violation."""

    below_ground: float = 0.01  # depth of the lowest point [m]
    # way of a foot in one contact [m]; infinite: slip is reported, but violates nothing
    slip: float = np.inf


class Fault(NamedTuple):
    """Something wrong with a motion."""

    kind: str  # in a few words, the same for all motions
    where: str  # how much, and in which frames, counted from 1; "" for all

    def __str__(self) -> str:
        return f"{self.kind}: {self.where}" if self.where else self.kind


def find_faults(
    motion: RobotMotion, ground: GroundContact, tolerances: Tolerances | None = None
) -> Iterator[Fault]:
    """Yields what is wrong with a motion's root on the ground, and where it jumps.

    Args:
        motion: of a robot.
        ground: its contact with the ground.
        tolerances: what is still none.
    """
    tolerances = tolerances or Tolerances()
    deep = ground.lowest < -tolerances.below_ground
    if deep.any():
        depth = f"{-1e3 * ground.lowest.min():.0f} mm, "
        yield Fault("below the ground", depth + in_frames(deep))
    high = ground.lowest - ground.floor > _IN_THE_AIR
    if ground.feet and ground.lowest.min() > _AIRBORNE:
        yield Fault("never on the ground", "")
    elif ground.feet:
        z = np.pad(motion.root_positions[:, 2], 1, mode="reflect", reflect_type="odd")
        falls = np.diff(z, 2) * motion.rate**2 < -_FALLS
        for where in where_lasting(high & ~falls, motion.rate):
            yield Fault("nothing carries the robot", where)
    jumps = find_jumps(motion)
    if jumps:
        first = jumps[0]
        more = f" and {len(jumps) - 1} more" if len(jumps) > 1 else ""
        yield Fault("jumps", f"{first.what} to frame {first.frame + 1}{more}")
    slips = max((foot.worst for foot in ground.feet), default=0.0)
    if slips > tolerances.slip:
        yield Fault("feet slip", f"{1e3 * slips:.0f} mm")


def find_limbs_off(
    off: Mapping[str, np.ndarray], most: float, rate: float
) -> Iterator[Fault]:
    """Yields which limbs point elsewhere than the person's; the head may.

    Args:
        off: limb to (T,) how far [rad].
        most: that is no fault yet [rad].
        rate: frames per second [Hz].
    """
    for limb, by in off.items():
        for where in where_lasting(by > most, rate) if limb != "head" else ():
            more = f"by more than {math.degrees(most):g} deg"
            yield Fault(LIMBS_OFF, f"{limb.replace('_', ' ')} {more} in {where}")


def where_lasting(flags: np.ndarray, rate: float) -> Iterator[str]:
    """Yields in which frames flags (T,) are set for longer than 0.2 s, if any are."""
    flags = lasting(flags, int(_LASTS * rate) + 1)
    if flags.any():
        yield in_frames(flags)


def left_as_it_was(
    before: Iterable[Fault], after: Iterable[Fault]
) -> tuple[list[Fault], list[Fault]]:
    """The faults of a changed motion that are new, and those of a kind that it had
    before."""
    kinds, after = {fault.kind for fault in before}, list(after)
    return (
        [fault for fault in after if fault.kind not in kinds],
        [fault for fault in after if fault.kind in kinds],
    )


def in_frames(flags: np.ndarray) -> str:
    """Where flags (T,) are set, as "frames 3-7, 12"."""
    return f"frames {spans(np.flatnonzero(flags))}"


def spans(frames: Sequence[int]) -> str:
    """Frames, counted from 1, as "3-7, 12"; the first three stretches."""
    cuts = np.flatnonzero(np.diff(frames) > 1) + 1
    found = [
        f"{s[0] + 1}-{s[-1] + 1}" if len(s) > 1 else f"{s[0] + 1}"
        for s in np.split(np.asarray(frames), cuts)
    ]
    return ", ".join(found[:3]) + (", ..." if len(found) > 3 else "")
