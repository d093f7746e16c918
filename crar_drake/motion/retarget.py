"""From a performer's joint centres to trajectories that fit a robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from pydrake.trajectories import BsplineTrajectory
from scipy.spatial.transform import Rotation

from crar_drake.errors import ModelError, MotionError
from crar_drake.motion.conditioning import DEFAULT_CUTOFF, low_pass, spline
from crar_drake.motion.performer import Performer, Sampled

# Below this a segment has no direction worth keeping.
_SHORTEST_SEGMENT = 1e-3  # [m]


@dataclass(frozen=True)
class SegmentLengths:
    """Distances between a robot's task points, which replace the performer's.

    A field named a_b (or side_a_b) is the distance from a to b.

    Raises:
        ModelError: a length is not positive and finite.
    """

    waist_neck: float  # [m]
    left_neck_shoulder: float  # [m]
    left_shoulder_elbow: float  # [m]
    left_elbow_wrist: float  # [m]
    right_neck_shoulder: float  # [m]
    right_shoulder_elbow: float  # [m]
    right_elbow_wrist: float  # [m]
    waist_height: float  # above the ground, standing [m]

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value > 0.0):
                raise ModelError(
                    f"the robot's {field.name} must be a positive length, not {value} m"
                )


# (from, to, field of SegmentLengths), from the waist outwards.
SEGMENTS = (
    ("waist", "neck", "waist_neck"),
    ("neck", "left_shoulder", "left_neck_shoulder"),
    ("left_shoulder", "left_elbow", "left_shoulder_elbow"),
    ("left_elbow", "left_wrist", "left_elbow_wrist"),
    ("neck", "right_shoulder", "right_neck_shoulder"),
    ("right_shoulder", "right_elbow", "right_shoulder_elbow"),
    ("right_elbow", "right_wrist", "right_elbow_wrist"),
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

    @property
    def waist(self) -> BsplineTrajectory:
        """Trajectory of the waist's x, y, z [m]."""
        return self.trajectory(["waist"])

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
    lengths: SegmentLengths,
    *,
    cutoff: float = DEFAULT_CUTOFF,
) -> RetargetedMotion:
    """Filters a performer's joint centres and scales them to a robot.

    Directions are kept and lengths replaced, segment by segment from the waist.
    The waist's path is scaled by waist_height over the performer's hip height, and
    starts above the origin.

    Args:
        lengths: the robot's lengths [m].
        cutoff: of the zero-phase low-pass [Hz].

    Raises:
        MotionError: as of `Performer.centres`; or the motion is too short, the cutoff
            too high, or two joint centres coincide, so that a segment has no direction.
    """
    name, rate, raw = performer.name, performer.frame_rate, performer.centres()
    try:
        smooth = {
            centre: low_pass(samples, rate, cutoff) for centre, samples in raw.items()
        }
        heading = low_pass(performer.heading, rate, cutoff)
    except MotionError as error:
        raise MotionError(f"motion {name}: {error}") from error

    waist = smooth["waist"] * (lengths.waist_height / performer.hip_height)
    waist[:, :2] -= waist[0, :2].copy()
    positions = {"waist": waist}
    for start, end, field in SEGMENTS:
        _check_segment(name, raw, start, end)
        norm = _check_segment(name, smooth, start, end)
        direction = (smooth[end] - smooth[start]) / norm[:, None]
        positions[end] = positions[start] + getattr(lengths, field) * direction
    return RetargetedMotion(name, rate, positions, heading)


def _check_segment(
    motion: str, positions: dict[str, np.ndarray], start: str, end: str
) -> np.ndarray:
    """Returns the segment's (T,) lengths [m], none of them nearly zero."""
    norm = np.linalg.norm(positions[end] - positions[start], axis=1)
    frame = int(np.argmin(norm))
    # Written so that a NaN fails, too.
    if not norm[frame] >= _SHORTEST_SEGMENT:
        raise MotionError(
            f"motion {motion}: {start} and {end} coincide in frame {frame + 1}, "
            f"so the segment has no direction to keep; check the skeleton's lengths"
        )
    return norm
