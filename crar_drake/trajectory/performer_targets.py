"""What a performer asks of a robot, frame by frame: directions of limbs, the root, and
feet that stand.

Lengths are the robot's: of the performer's limbs the directions are kept. The hips'
path is scaled by the length of the robot's legs over that of the performer's, and each
foot is placed from its hip as the performer's ankle is from his. Feet on the floor are
held where they stand (`motion.held_feet`). Nothing here knows what the robot can do:
where its legs do not reach, or links would touch, the optimisation decides
(`retargeting`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import low_pass, unit_vectors
from crar_drake.motion.held_feet import find_contacts_of_feet, hold_foot
from crar_drake.motion.orientations import hip_turns, smooth_hands
from crar_drake.motion.performer import SIDES, Performer, pinned_pelvis
from crar_drake.motion.performer_legs import (
    LegShape,
    floor_height,
    foot_turns,
    leg_length,
    smooth_legs,
)
from crar_drake.motion.quaternion_spline import sign_continuous

# From which of the performer's joints to which limbs lead, and of the robot's frames.
_ARM = (("shoulder", "elbow"), ("elbow", "wrist"))
_LEG = (("hip", "knee"), ("knee", "ankle"))
LIMBS = {
    **{
        f"{side}_{a}-{b}": (
            (f"{side}_{a}", f"{side}_{b}"),
            (f"{side}_{a}", f"{side}_{b}".replace("ankle", "foot")),
        )
        for parts in (_ARM, _LEG)
        for side in SIDES
        for a, b in parts
    },
    "trunk": (("pelvis", "neck"), ("waist", "neck")),
    "shoulders": (("left_shoulder", "right_shoulder"),) * 2,
    "head": (("neck", "head"),) * 2,
}


@dataclass(frozen=True, eq=False)
class FootTarget:
    """A foot at T frames."""

    heel: np.ndarray  # (T, 3) where the middle of the sole's rear edge is [m]
    ball: np.ndarray  # (T, 3) and that of its front edge [m]
    on_heel: np.ndarray  # (T,) whether the heel stands on the floor
    on_ball: np.ndarray  # (T,) and whether the ball does
    heights: np.ndarray  # (T, 4) of the sole's corners [m]


@dataclass(frozen=True, eq=False)
class PerformerTargets:
    """T frames at a rate, in the world W: z up, the floor at z = 0."""

    rate: float  # frames per second [Hz]
    root_positions: np.ndarray  # (T, 3) p_WR [m]
    root_rotations: np.ndarray  # (T, 3, 3) R_WR
    directions: Mapping[str, np.ndarray]  # name of LIMBS to (T, 3) unit vectors
    feet: Mapping[str, FootTarget]  # side to its foot
    # "left_hand", "right_hand" to (T, 3, 3) R_WH; empty without
    hands: Mapping[str, np.ndarray]


def performer_targets(
    performer: Performer,
    legs: Mapping[str, LegShape],
    soles: Mapping[str, np.ndarray],
    root_at_rest: np.ndarray,
    rate: float,
    cutoff: float,
) -> PerformerTargets:
    """What a performer asks of a robot with legs.

    Args:
        performer: with legs.
        legs: the robot's, by side.
        soles: (4, 3) the corners of each foot's sole, from the foot's frame as the
            robot stands and faces x: two of the heel, two of the ball [m].
        root_at_rest: (3, 3) R_WR, as the robot stands and faces x.
        rate: frames per second that are wanted [Hz].
        cutoff: of the zero-phase low-pass [Hz].

    Raises:
        MotionError: the performer lacks joints of the legs, does not tell how the hips
            are turned, its points are relative to the pelvis, or the motion cannot be
            filtered.
    """
    if pinned := pinned_pelvis(performer):
        raise MotionError(
            f"motion {performer.name}: {pinned}; a whole body needs a motion that says "
            "where the pelvis is in the room"
        )
    own, p = performer.frame_rate, smooth_legs(performer, cutoff)
    R_W = Rotation.from_quat(hip_turns(performer, cutoff))
    scales = {side: legs[side].length / leg_length(performer, side) for side in SIDES}
    middle = 0.5 * (p["left_hip"] + p["right_hip"]) * np.mean(list(scales.values()))
    middle[:, :2] -= middle[0, :2].copy()
    root = middle - R_W.apply(np.mean([legs[side].hip for side in SIDES], axis=0))
    turns, ankles = foot_turns(performer, p, cutoff), {}
    for side in SIDES:
        leg = p[f"{side}_ankle"] - p[f"{side}_hip"]
        ankles[side] = root + R_W.apply(legs[side].hip) + scales[side] * leg
    floor = floor_height(ankles, turns, legs, own)
    root[:, 2] -= floor
    ends = {side: np.array([leg.heel, leg.ball]) for side, leg in legs.items()}
    contacts = find_contacts_of_feet(ankles, turns, ends, floor, own, middle[:, 2])
    times = np.arange(0.0, performer.duration + 1e-9, 1.0 / rate)
    frames = np.clip(np.round(times * own).astype(int), 0, len(root) - 1)

    def at(samples: np.ndarray) -> np.ndarray:
        if len(samples) < 4:
            return samples[frames]
        return CubicSpline(performer.time, samples)(
            np.minimum(times, performer.duration)
        )

    def turned_at(turned: Rotation) -> np.ndarray:
        quaternions = sign_continuous(turned.as_quat())
        return Rotation.from_quat(at(quaternions)).as_matrix()

    feet, hands = {}, smooth_hands(performer, cutoff) if performer.hands else {}
    for side, leg in legs.items():
        ankle = ankles[side] - [0.0, 0.0, floor]
        sole = leg.heel, leg.ball, leg.points
        held = hold_foot(ankle, turns[side], *sole, own, contacts[side])
        turn = Rotation.from_quat(held.turns)
        points = [leg.heel, leg.ball, *soles[side]]
        heel, ball, *corners = (at(held.positions + turn.apply(p)) for p in points)
        heights = np.stack([corner[:, 2] for corner in corners], axis=1)
        on = held.heel[frames], held.ball[frames]
        feet[side] = FootTarget(heel, ball, *on, heights)
    return PerformerTargets(
        rate,
        at(root),
        turned_at(R_W) @ root_at_rest,
        {name: unit_vectors(at(way)) for name, way in _ways(performer, cutoff).items()},
        feet,
        {hand: turned_at(Rotation.from_quat(turns)) for hand, turns in hands.items()},
    )


def _ways(performer: Performer, cutoff: float) -> dict[str, np.ndarray]:
    """Name of LIMBS to (T, 3) from one end to the other, of those that there are."""
    places = performer.positions
    ends = {name: of for name, (of, _) in LIMBS.items() if set(of) <= set(places)}
    if not ends:
        return {}
    ways = np.stack([places[b] - places[a] for a, b in ends.values()], axis=1)
    ways = low_pass(ways, performer.frame_rate, cutoff)
    found = dict(zip(ends, ways.swapaxes(0, 1), strict=True))
    for name, way in found.items():
        performer.directions(*ends[name], way)
    return found
