"""Feet that stand where they stand: a performer's steps as poses of a robot's feet.

Two points of a foot's sole can be on the floor: the heel, the middle of its rear edge,
and the ball, the middle of its front edge. Each is found to be so by its height and its
speed, with hysteresis (`planted_feet`). Then, sample by sample:

* While both are on the floor the foot is flat; while one of them is, it does not roll
  sideways, and pitches about that point as the performer's does, but no farther than
  until its frame is above it: people's toes bend, and a sole that does not would tip
  over its edge there.
* A point on the floor stays where it is, and a moment longer at either end of a
  contact: a foot comes down and leaves upright, or it would slide where it is still
  as low as that. What that shifts the foot by is made up for in the air, between one
  contact and the next.
* While a point is on the floor, the foot's lowest point is at the floor; in the air it
  is above it.

Where a contact begins and ends these are blended in and out, twice continuously
differentiable.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.motion.planted_feet import (
    ContactThresholds,
    runs,
    standing,
    without_short,
)
from crar_drake.motion.quaternion_spline import sign_continuous
from crar_drake.motion.smooth_steps import bridge, smooth_flags, soft_positive

# Of a recording: markers and limb lengths are off by a centimetre or two, so that these
# are wider than where a robot's motion is judged.
THRESHOLDS = ContactThresholds(
    height_on=0.025, height_off=0.045, speed_on=0.25, speed_off=0.5
)

# Who does not fall stands on something: where no foot stands otherwise, one that is as
# slow, and no higher than this, does. Its recording is off by more.
_STANDS_HIGH = ContactThresholds(
    height_on=0.08, height_off=0.11, speed_on=0.25, speed_off=0.5
)
_FALLS = 9.81 / 3.0  # [m/s^2] downwards, of the hips of somebody who falls

_SHORTEST = 0.08  # [s] that a contact and a gap last, at least
_BLEND = 0.12  # [s] before and after a contact
_DWELL = 0.05  # [s] before and after a contact, in which the foot stays above its place
_LANDING = 0.05  # [s] in which a foot comes down before a contact, and leaves after
_CLEARANCE = 0.02  # [m] at least, of a foot in the air: robots' soles do not bend
_SOFT = 0.005  # [m] width of that bound
_TURNING = 0.25  # [rad] that a foot turns while it is flat, from which on it pivots
_UPRIGHT = 0.1  # [rad] width of the bound by which a foot does not tip over its edge


@dataclass(frozen=True, eq=False)
class FootMotion:
    """A foot's poses."""

    positions: np.ndarray  # (T, 3) p_WF of its frame [m]
    # (T, 4) quaternions (x y z w) of how it is turned from where it stands flat and
    # faces x
    turns: np.ndarray
    heel: np.ndarray  # (T,) whether the heel is on the floor
    ball: np.ndarray  # (T,) and whether the ball is

    @property
    def planted(self) -> np.ndarray:
        """(T,) whether any point of it is on the floor."""
        return self.heel | self.ball


def twist(turns: Rotation) -> np.ndarray:
    """(T,) angles by which rotations turn about the vertical, unwrapped [rad]."""
    x, y, z, w = turns.as_quat().T
    return np.unwrap(2.0 * np.arctan2(z, w))


def about_vertical(angles: np.ndarray) -> Rotation:
    """Rotations by angles (T,) about the vertical [rad]."""
    return Rotation.from_euler("z", angles[:, None])


def find_contacts(
    positions: np.ndarray,
    turns: Rotation,
    points: np.ndarray,
    floor: float,
    rate: float,
    thresholds: ContactThresholds = THRESHOLDS,
) -> np.ndarray:
    """(T, P) whether each point of a foot is on the floor.

    Args:
        positions: (T, 3) p_WF [m].
        turns: of the foot, T of them.
        points: (P, 3) p_F of heel and ball [m].
        floor: height of the floor [m].
        rate: samples per second [Hz].
        thresholds: of a point that stands.
    """
    shortest = max(1, round(_SHORTEST * rate))
    found = []
    for point in points:
        p = positions + turns.apply(point)
        speed = np.linalg.norm(np.gradient(p, axis=0), axis=1) * rate
        flags = standing(p[:, 2] - floor, speed, thresholds)
        found.append(without_short(flags, shortest))
    contacts = np.array(found).T
    for start, end in runs(~contacts.any(axis=1)):
        if end - start < shortest and 0 < start and end < len(contacts):
            # From its heel on its ball a foot goes by the floor.
            contacts[start:end] = contacts[start - 1]
    return contacts


def find_contacts_of_feet(
    ankles: Mapping[str, np.ndarray],
    turns: Mapping[str, Rotation],
    points: Mapping[str, np.ndarray],
    floor: float,
    rate: float,
    hips: np.ndarray,
) -> dict[str, np.ndarray]:
    """Side to (T, P) whether each point of a foot is on the floor; at least one is as
    long as the hips do not fall, if any may be.

    Args:
        ankles, turns, points, floor, rate: of each foot, as of `find_contacts`.
        hips: (T,) their height [m].
    """
    arguments = {s: (ankles[s], turns[s], points[s], floor, rate) for s in ankles}
    found = {side: find_contacts(*of) for side, of in arguments.items()}
    rises = np.gradient(np.gradient(hips)) * rate**2
    alone = rises > -_FALLS
    alone &= ~np.any([contacts.any(axis=1) for contacts in found.values()], axis=0)
    shortest = max(1, round(_SHORTEST * rate))
    for side, of in arguments.items():
        high = find_contacts(*of, _STANDS_HIGH) & alone[:, None]
        both = (found[side] | high).T
        found[side] = np.array([without_short(flags, shortest) for flags in both]).T
    return found


def hold_foot(
    positions: np.ndarray,
    turns: Rotation,
    heel: np.ndarray,
    ball: np.ndarray,
    points: np.ndarray,
    rate: float,
    contacts: np.ndarray | None = None,
) -> FootMotion:
    """A foot that stands where it stands, on the floor z = 0.

    Args:
        positions: (T, 3) p_WF as it is retargeted, the floor at about 0 [m].
        turns: of the foot.
        heel, ball: (3,) p_F of these points, from the foot's frame [m].
        points: (V, 3) p_F of the foot's surface [m].
        rate: samples per second [Hz].
        contacts: (T, 2) whether heel and ball are on the floor; by default found.
    """
    if contacts is None:
        contacts = find_contacts(positions, turns, np.array([heel, ball]), 0.0, rate)
    on_heel, on_ball = contacts.T
    steepest = [np.arctan2(abs(point[0]), -point[2]) for point in (heel, ball)]
    turns = _levelled(turns, on_heel, on_ball, steepest, max(1, round(_BLEND * rate)))
    matrices = turns.as_matrix()
    # How high the frame is when the foot's lowest point is at the floor.
    least = -np.min(matrices[:, 2] @ points.T, axis=1)
    planted = on_heel | on_ball
    grounded = smooth_flags(planted, max(1, round(_LANDING * rate)))
    clear = _CLEARANCE + soft_positive(positions[:, 2] - least - _CLEARANCE, _SOFT)
    z = least + (1.0 - grounded) * clear
    kept = dwelling(planted, rate)
    shifts = _shifts(positions, matrices, ball, points, contacts, kept)
    shift = bridge(shifts, kept, rate, _BLEND)
    held = np.column_stack([positions[:, :2] + shift, z])
    return FootMotion(held, sign_continuous(turns.as_quat()), on_heel, on_ball)


def _levelled(
    turns: Rotation,
    on_heel: np.ndarray,
    on_ball: np.ndarray,
    steepest: Sequence[float],
    margin: int,
) -> Rotation:
    """Flat where heel and ball are down, without roll where one of them is, and no
    steeper than its frame is above the heel or the ball [rad]."""
    yaw = twist(turns)
    tilt = (about_vertical(-yaw) * turns).as_rotvec()
    flat = smooth_flags(on_heel & on_ball, margin)
    down = smooth_flags(on_heel | on_ball, margin)
    tilt[:, 0] *= 1.0 - down
    for sense, most in zip((-1.0, 1.0), steepest, strict=True):
        beyond = soft_positive(sense * tilt[:, 1] - most, _UPRIGHT)
        tilt[:, 1] -= sense * down * beyond
    tilt[:, 1] *= 1.0 - flat
    tilt[:, 2] *= 1.0 - down
    for start, end in runs(on_heel & on_ball):
        if np.ptp(yaw[start:end]) < _TURNING:
            stretch = np.zeros(len(yaw), dtype=bool)
            stretch[start:end] = True
            share = smooth_flags(stretch, margin)
            yaw = yaw + share * (yaw[start:end].mean() - yaw)
    return about_vertical(yaw) * Rotation.from_rotvec(tilt)


def dwelling(planted: np.ndarray, rate: float) -> np.ndarray:
    """(T,) whether a foot stays where it is: a moment longer than it is planted.

    Of what is between two contacts half is left, to get from one to the other.

    Args:
        planted: (T,) whether it is on the floor.
        rate: samples per second [Hz].
    """
    kept, margin = planted.copy(), round(_DWELL * rate)
    for start, end in runs(~planted):
        inside = start > 0 and end < len(planted)
        reach = min(margin, (end - start) // 4) if inside else margin
        if start > 0:
            kept[start : start + reach] = True
        if end < len(planted):
            kept[max(start, end - reach) : end] = True
    return kept


def _shifts(positions, matrices, ball, points, contacts, kept) -> np.ndarray:
    """(T, 2) horizontal shifts that keep what is on the floor in its place, in each
    contact as small as they can be in the mean [m]; 0 where a foot is not `kept`.

    Flat, a foot turns about its ball. On its heel or its ball it rolls over whatever is
    lowest of it, and turns about the middle of that.
    """
    p_ball = (positions + matrices @ ball)[:, :2]
    shifts = np.zeros((len(positions), 2))
    planted = contacts.any(axis=1)
    flat = contacts.all(axis=1)
    for start, end in runs(kept):
        heights = matrices[start:end, 2] @ points.T
        lowest = np.argmin(heights[1:] + heights[:-1], axis=1)
        for t in range(start + 1, end):
            if flat[t] and flat[t - 1]:
                way = p_ball[t] - p_ball[t - 1]
            else:
                # It does not roll sideways: the edge is as low all along, and so is
                # its middle, about which a foot turns.
                x, _, z = points[lowest[t - start - 1]]
                point = np.array([x, ball[1], z])
                turned = (matrices[t] - matrices[t - 1]) @ point
                way = (positions[t] - positions[t - 1] + turned)[:2]
            shifts[t] = shifts[t - 1] - way
        shifts[start:end] -= shifts[start:end][planted[start:end]].mean(axis=0)
    return shifts
