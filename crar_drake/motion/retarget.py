"""From a performer's joint centres to trajectories that fit a robot."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from pydrake.trajectories import BsplineTrajectory
from scipy.spatial.transform import Rotation

from crar_drake.errors import ModelError, MotionError
from crar_drake.motion.conditioning import DEFAULT_CUTOFF, spline
from crar_drake.motion.performer import ARM, SIDES, Performer, Sampled

# Joint centre: the one that it hangs on, from the waist outwards.
HANGS_ON: Mapping[str, str] = MappingProxyType(
    {"neck": "waist"}
    | {
        f"{side}_{end}": f"{side}_{start}" if start in ARM else start
        for side in SIDES
        for start, end in zip(("neck", *ARM), ARM, strict=False)
    }
)


@dataclass(frozen=True)
class RetargetedMotion(Sampled):
    """A motion filtered and scaled to a robot, in the world W: z up, x forward."""

    name: str  # the motion's name
    frame_rate: float  # samples per second [Hz]
    positions: dict[str, np.ndarray]  # joint centre to (T, 3) p_WC [m]
    heading: np.ndarray  # (T,) yaw of the performer's hips, filtered, unwrapped [rad]

    def standing_at(self, waist: np.ndarray) -> RetargetedMotion:
        """The motion as seen from the hips, which stay.

        Args:
            waist: (3,) where the waist stays; the hips face x there [m].
        """
        turn = Rotation.from_euler("z", -self.heading[:, np.newaxis])
        at_hips = {
            name: waist + turn.apply(p - self.positions["waist"])
            for name, p in self.positions.items()
        }
        heading = np.zeros(self.num_frames)
        return RetargetedMotion(self.name, self.frame_rate, at_hips, heading)

    def trajectory(self, names: Sequence[str]) -> BsplineTrajectory:
        """Returns p_WC of the named joint centres, three rows each [m].

        It is twice continuously differentiable over [0, duration].

        Raises:
            MotionError: a name is not one of the motion's joint centres.
        """
        unknown = [name for name in names if name not in self.positions]
        if unknown or not names:
            raise MotionError(
                f"motion {self.name} has no joint centre {', '.join(unknown)!r}; it "
                f"has {', '.join(self.positions)}"
            )
        return spline(self.time, np.hstack([self.positions[name] for name in names]))


def retarget(
    performer: Performer,
    lengths: Mapping[str, float],
    *,
    cutoff: float = DEFAULT_CUTOFF,
) -> RetargetedMotion:
    """Filters a performer's joint centres and scales them to a robot.

    Directions are kept and lengths replaced, segment by segment from the waist.
    The waist's path is scaled by the waist's height over the performer's hip height,
    and starts above the origin.

    Args:
        lengths: the robot's: name of JOINT_CENTRES to its distance from the one that it
            hangs on; of the waist, its height above the ground, standing [m].
        cutoff: of the zero-phase low-pass [Hz].

    Raises:
        ModelError: a length is not positive and finite.
        MotionError: as of `Performer.centres`; or the motion is too short, the cutoff
            too high, or two joint centres coincide, so that a segment has no direction.
    """
    for centre, length in lengths.items():
        if not (math.isfinite(length) and length > 0.0):
            start = HANGS_ON.get(centre, "the ground")
            what = f"length from {start} to {centre}"
            raise ModelError(f"the robot's {what} must be positive, not {length} m")
    raw = performer.centres()
    smooth = performer.smooth({**raw, "heading": performer.heading}, cutoff)
    heading = smooth.pop("heading")
    waist = smooth["waist"] * (lengths["waist"] / performer.hip_height)
    waist[:, :2] -= waist[0, :2].copy()
    positions = {"waist": waist}
    for end, start in HANGS_ON.items():
        performer.directions(start, end, raw[end] - raw[start])
        way = performer.directions(start, end, smooth[end] - smooth[start])
        positions[end] = positions[start] + lengths[end] * way
    return RetargetedMotion(performer.name, performer.frame_rate, positions, heading)
