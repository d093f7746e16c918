"""A performer's legs, smoothed: how feet are turned, and how high the floor is."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import unit_vectors
from crar_drake.motion.held_feet import about_vertical, find_contacts, twist
from crar_drake.motion.orientations import smooth_turns
from crar_drake.motion.performer import LEG, SIDES, Performer

_FLAT_HEIGHT = 0.03  # [m] above its lowest, at most, that the ankle of a flat foot is
_FLAT_SPEED = 0.25  # [m/s] of the ankle of a flat foot, at most
_FLAT_TIME = 0.2  # [s] of flat feet that tell how they are turned
_LOWEST_SHARE = 0.1  # of slow samples, that are lower than the floor at most


@dataclass(frozen=True)
class LegShape:
    """A leg, with the robot as it stands at rest; all in the world's axes then."""

    hip: np.ndarray  # (3,) from the base's origin to the centre of the hip [m]
    thigh: float  # its length [m]
    shank: float  # its length [m]
    points: np.ndarray  # (V, 3) of the foot's surface, from the foot's frame [m]
    heel: np.ndarray  # (3,) the middle of the sole's rear edge [m]
    ball: np.ndarray  # (3,) and of its front edge [m]

    @property
    def length(self) -> float:
        """Of thigh and shank [m]."""
        return self.thigh + self.shank


def smooth_legs(performer: Performer, cutoff: float) -> dict[str, np.ndarray]:
    """Joint to (T, 3) positions after a low-pass, of what the legs need [m].

    Args:
        performer: with legs.
        cutoff: of the zero-phase low-pass [Hz].

    Raises:
        MotionError: joints are missing, or the motion cannot be filtered.
    """
    names = [f"{side}_{joint}" for side in SIDES for joint in LEG]
    # How a foot is turned is known, or else seen from where its toes are.
    untold = [s for s in SIDES if f"{s}_ankle" not in performer.orientations]
    names += ["pelvis", "neck", *(f"{side}_toe" for side in untold)]
    missing = [name for name in names if name not in performer.positions]
    if missing:
        raise MotionError(
            f"motion {performer.name}: it has no {', '.join(missing)}, and so no feet "
            "to follow; name them in --joints FILE (crar-drake run --tasks "
            "upper-body needs none)"
        )
    return performer.smooth({name: performer.positions[name] for name in names}, cutoff)


def leg_length(performer: Performer, side: str) -> float:
    """Of a leg, hip to knee to ankle, in the median [m]."""
    p = performer.positions
    total = 0.0
    for a, b in (("hip", "knee"), ("knee", "ankle")):
        way = p[f"{side}_{b}"] - p[f"{side}_{a}"]
        total += float(np.median(np.linalg.norm(way, axis=1)))
    # Written so that a NaN fails, too.
    if not total > 0.05:
        raise MotionError(
            f"motion {performer.name}: its {side} leg is {total:.3f} m long; check the "
            "skeleton's lengths"
        )
    return total


def foot_turns(performer: Performer, p, cutoff: float) -> dict[str, Rotation]:
    """How each foot is turned from where it is flat and faces x."""
    floor = min(np.quantile(p[f"{s}_ankle"][:, 2], 0.05) for s in SIDES)
    found = {}
    for side in SIDES:
        ankle = f"{side}_ankle"
        R = performer.orientations.get(ankle)
        if R is None:
            R = _from_points(p[f"{side}_knee"], p[ankle], p[f"{side}_toe"])
        turns = Rotation.from_quat(
            smooth_turns(
                R,
                performer.frame_rate,
                cutoff,
                f"motion {performer.name}: the {side} foot",
                "take the experiment upper-body",
            )
        )
        speed = np.gradient(p[ankle], axis=0) * performer.frame_rate
        flat = p[ankle][:, 2] < floor + _FLAT_HEIGHT
        flat &= np.linalg.norm(speed, axis=1) < _FLAT_SPEED
        if np.count_nonzero(flat) >= _FLAT_TIME * performer.frame_rate:
            # A skeleton's rest pose need not have flat feet.
            level = about_vertical(-twist(turns[flat])) * turns[flat]
            turns = turns * level.mean().inv()
        found[side] = turns
    return found


def _from_points(knee, ankle, toe) -> np.ndarray:
    """(T, 3, 3) x to the toe, y across the plane of shank and foot."""
    x = unit_vectors(toe - ankle)
    y = unit_vectors(np.cross(knee - ankle, x))
    return np.stack([x, y, np.cross(x, y)], axis=2)


def floor_height(ankles, turns, legs: Mapping[str, LegShape], rate: float) -> float:
    """Height of the soles when they are on the floor [m].

    First where heels and balls are slow, and low among those heights, since a foot may
    be held up as well; then the median of what is in contact with that floor. A foot
    is fast where it is lowest in a run, so that the lowest samples tell less.
    """
    ends, slow = {}, []
    for side in SIDES:
        leg = legs[side]
        for point in (leg.heel, leg.ball):
            p = ankles[side] + turns[side].apply(point)
            speed = np.linalg.norm(np.gradient(p, axis=0), axis=1) * rate
            slow.append(p[speed < _FLAT_SPEED, 2])
        lowest = np.min(turns[side].as_matrix()[:, 2] @ leg.points.T, axis=1)
        ends[side] = ankles[side][:, 2] + lowest
    slow = np.concatenate(slow)
    if len(slow) < _FLAT_TIME * rate:
        slow = np.min(list(ends.values()), axis=0)
    floor = float(np.quantile(slow, _LOWEST_SHARE))
    heights = []
    for side in SIDES:
        points = np.array([legs[side].heel, legs[side].ball])
        found = find_contacts(ankles[side], turns[side], points, floor, rate)
        heights.append(ends[side][found.any(axis=1)])
    heights = np.concatenate(heights)
    return float(np.median(heights)) if len(heights) else floor
