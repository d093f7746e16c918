"""A performer's hips and feet on a robot with legs, the root of which floats.

The hips' path is scaled by the length of the robot's legs over that of the performer's,
and each foot is placed from its hip as the performer's ankle is from his, scaled by the
lengths of that leg. Feet on the floor are then held (`held_feet`), and the root is
lowered where a foot would be out of the leg's reach, and lifted where the trunk or a
knee would be below the floor (`root_height`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import low_pass, unit_vectors
from crar_drake.motion.held_feet import (
    FootMotion,
    about_vertical,
    find_contacts,
    hold_foot,
    place_foot,
    twist,
)
from crar_drake.motion.leg_shape import LegShape, TrunkShape
from crar_drake.motion.parted_feet import part_feet
from crar_drake.motion.parted_legs import LegRoom, part_legs
from crar_drake.motion.performer import LEG, SIDES, Performer
from crar_drake.motion.root_height import (
    anticipated,
    bent_knee,
    off_the_floor,
    settle_root,
)
from crar_drake.motion.turns import hip_turns, smooth_turns

_FLAT_HEIGHT = 0.03  # [m] above its lowest, at most, that the ankle of a flat foot is
_FLAT_SPEED = 0.25  # [m/s] of the ankle of a flat foot, at most
_FLAT_TIME = 0.2  # [s] of flat feet that tell how they are turned
# In which knees are lifted off the floor, legs are parted and feet turned as they can
# be, each of which may ask for another.
_ROUNDS = 6
_TURNED = 0.01  # [rad] that feet need not be turned any more
_NEAR = 1e-3  # [m] that legs may lack
_LOWEST_SHARE = 0.1  # of slow samples, that are lower than the floor at most


@dataclass(frozen=True, eq=False)
class LegsMotion:
    """The root and the legs of a robot, in the world W, the floor at z = 0.

    Attributes:
        root_positions: (T, 3) of the base's origin [m].
        root_turns: (T, 4) quaternions (x y z w) of how it is turned from its rest: as
            the hips, and as far as the trunk cannot lean from them.
        knees: side to (T, 3) [m].
        feet: side to the foot's poses.
    """

    root_positions: np.ndarray
    root_turns: np.ndarray
    knees: Mapping[str, np.ndarray]
    feet: Mapping[str, FootMotion]


# Takes side, root's positions and turns and the foot's poses; returns how the foot can
# be turned there, and where the knee is then, (T, 3) [m].
Attainable = Callable[
    [str, np.ndarray, Rotation, FootMotion], tuple[Rotation, np.ndarray]
]

# Takes the root's turns; returns how near the legs are that were asked about last.
Room = Callable[[Rotation], LegRoom]


def retarget_legs(
    performer: Performer,
    legs: Mapping[str, LegShape],
    cutoff: float,
    attainable: Attainable | None = None,
    trunk: TrunkShape | None = None,
    room: Room | None = None,
) -> LegsMotion:
    """Hips, knees and feet of a performer on a robot.

    Args:
        performer: with legs.
        legs: the robot's, by side.
        cutoff: of the zero-phase low-pass [Hz].
        attainable: how a foot can be turned, within the limits of its leg's joints; it
            is then turned so, and stands on what of it is lowest. By default any way,
            and a knee is bent as the performer's.
        trunk: what of the robot must stay above the floor by the root's height, and
            how far it can lean from the root.
        room: between the legs; where it is lacking, feet are moved. By default soles
            alone are kept apart.

    Raises:
        MotionError: the performer lacks joints of the legs, or does not tell how the
            hips are turned, or the motion cannot be filtered.
    """
    p = smooth_legs(performer, cutoff)
    rate = performer.frame_rate
    root_turns = hip_turns(performer, cutoff, trunk)
    R_W = Rotation.from_quat(root_turns)
    scales = {side: legs[side].length / leg_length(performer, side) for side in SIDES}
    middle = 0.5 * (p["left_hip"] + p["right_hip"]) * np.mean(list(scales.values()))
    middle[:, :2] -= middle[0, :2].copy()
    p_BM = np.mean([legs[side].hip for side in SIDES], axis=0)
    root = middle - R_W.apply(p_BM)
    ankles, turns = {}, foot_turns(performer, p, cutoff)
    for side in SIDES:
        way = p[f"{side}_ankle"] - p[f"{side}_hip"]
        ankles[side] = root + R_W.apply(legs[side].hip) + scales[side] * way
    floor = floor_height(ankles, turns, legs, rate)
    root[:, 2] -= floor
    for side in SIDES:
        ankles[side] = ankles[side] - [0.0, 0.0, floor]
    feet = {
        side: hold_foot(ankles[side], turns[side], leg.heel, leg.ball, leg.points, rate)
        for side, leg in legs.items()
    }
    for side, shift in part_feet(feet, legs, rate).items():
        ankles[side][:, :2] += shift
        feet[side] = _placed(ankles[side], feet[side], None, legs[side], rate)

    def settled(lifted: np.ndarray) -> tuple[np.ndarray, dict[str, FootMotion]]:
        return settle_root(root, R_W, feet, legs, trunk, p, rate, lifted)

    lifted, knees = np.zeros(len(root)), {}
    for _ in range(_ROUNDS if attainable else 0):
        high, near = settled(lifted)
        needed, turned = np.zeros(len(root)), 0.0
        for side, leg in legs.items():
            turns, knees[side] = attainable(side, high, R_W, near[side])
            away = turns * Rotation.from_quat(near[side].turns).inv()
            turned = max(turned, away.magnitude().max())
            feet[side] = _placed(ankles[side], feet[side], turns, leg, rate)
            needed = np.maximum(needed, off_the_floor(knees[side], leg))
        between = room(R_W) if room else None
        crowded = between is not None and between.lacking.max() > _NEAR
        if crowded:
            for side, move in part_legs(feet, between, rate).items():
                ankles[side][:, :2] += move[:, :2]
                before = Rotation.from_quat(feet[side].turns)
                turns = about_vertical(move[:, 2]) * before
                feet[side] = _placed(ankles[side], feet[side], turns, legs[side], rate)
        if needed.any():
            lifted = lifted + anticipated(needed, rate)
        elif not crowded and turned < _TURNED:
            break
    root, feet = settled(lifted)
    for side, leg in legs.items():
        if attainable:
            _, knees[side] = attainable(side, root, R_W, feet[side])
        else:
            hip = root + R_W.apply(leg.hip)
            knees[side] = bent_knee(hip, feet[side].positions, p, side, leg)
    return LegsMotion(root, root_turns, knees, feet)


def smooth_legs(performer: Performer, cutoff: float) -> dict[str, np.ndarray]:
    names = [f"{side}_{joint}" for side in SIDES for joint in LEG]
    # How a foot is turned is known, or else seen from where its toes are.
    untold = [s for s in SIDES if f"{s}_ankle" not in performer.orientations]
    names += ["pelvis", "neck", *(f"{side}_toe" for side in untold)]
    missing = [name for name in names if name not in performer.positions]
    if missing:
        raise MotionError(
            f"motion {performer.name}: it has no {', '.join(missing)}, and so no feet "
            "to follow; take the experiment upper-body, or another motion"
        )
    try:
        return {
            name: low_pass(performer.positions[name], performer.frame_rate, cutoff)
            for name in names
        }
    except MotionError as error:
        raise MotionError(f"motion {performer.name}: {error}") from error


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


def _placed(
    ankle: np.ndarray,
    foot: FootMotion,
    turns: Rotation | None,
    leg: LegShape,
    rate: float,
) -> FootMotion:
    """The foot on another way, or turned otherwise, with the contacts that it has."""
    turns = Rotation.from_quat(foot.turns) if turns is None else turns
    contacts = np.column_stack([foot.heel, foot.ball])
    return place_foot(ankle, turns, contacts, leg.ball, leg.points, rate)
