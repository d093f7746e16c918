"""How high the root of a robot with legs is: its feet in reach, its trunk and its knees
above the floor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.motion.conditioning import unit_vectors
from crar_drake.motion.held_feet import FootMotion
from crar_drake.motion.leg_shape import LegShape, TrunkShape
from crar_drake.motion.smooth_steps import smooth_bound, smooth_flags
from crar_drake.motion.turns import between

# A straight leg is singular: its knee would turn infinitely fast [1].
_STRETCH = 0.99
_FARTHEST = 0.95  # share of its reach that a foot is taken to be away across, at most
_ABOVE_FLOOR = 0.005  # [m] that trunk and knees stay above it
_ANTICIPATION = 0.25  # [s] before it is needed, the root begins to give way


def settle_root(
    root: np.ndarray,
    R_W: Rotation,
    feet: Mapping[str, FootMotion],
    legs: Mapping[str, LegShape],
    trunk: TrunkShape | None,
    p: Mapping[str, np.ndarray],
    rate: float,
    lifted: np.ndarray,
) -> tuple[np.ndarray, dict[str, FootMotion]]:
    """The root as high as it can be, and the feet, where it takes them along.

    It is lowered where a foot would be out of reach, and lifted where the trunk would
    be below the floor, or a leg that stands be bent too far: smoothly, and beginning
    before it is needed.

    Args:
        root: (T, 3) positions of the base's origin [m].
        R_W: T turns of it from its rest.
        feet: side to the foot's poses.
        legs: the robot's, by side.
        trunk: the robot's, if it is to stay above the floor.
        p: joint to (T, 3) of the performer [m].
        rate: samples per second [Hz].
        lifted: (T,) how much higher it must be besides [m].
    """
    up = np.array([0.0, 0.0, 1.0])
    root = root - _lowering(root, R_W, feet, legs, rate)[:, None] * up
    if trunk is not None:
        lifted = lifted + _lifting(root, R_W, trunk, p, rate)
    root = root + lifted[:, None] * up
    unbent = _unbending(root, R_W, feet, legs, rate)
    root, lifted = root + unbent[:, None] * up, lifted + unbent
    taken = {
        side: _taken_along(feet[side], root + R_W.apply(leg.hip), leg, lifted, rate)
        for side, leg in legs.items()
    }
    return root, taken


def _lowering(root, R_W, feet, legs, rate: float) -> np.ndarray:
    """(T,) how much lower the root must be for both feet to be in reach [m]."""
    needed = np.zeros(len(root))
    for side, leg in legs.items():
        hip = root + R_W.apply(leg.hip)
        needed = np.maximum(needed, _out_of_reach(hip, feet[side].positions, leg))
    return anticipated(needed, rate)


def _unbending(root, R_W, feet, legs, rate: float) -> np.ndarray:
    """(T,) how much higher the root must be for no leg that stands to be bent farther
    than it can, as far as the other one reaches [m]."""
    needed, slack = np.zeros(len(root)), np.full(len(root), np.inf)
    for side, leg in legs.items():
        hip, foot = root + R_W.apply(leg.hip), feet[side]
        way = hip - foot.positions
        across = np.linalg.norm(way[:, :2], axis=1)
        least = np.sqrt(np.maximum(leg.shortest**2 - across**2, 0.0))
        needed = np.maximum(needed, np.where(foot.planted, least - way[:, 2], 0.0))
        reach = _out_of_reach(hip, foot.positions, leg)
        slack = np.where(foot.planted, np.minimum(slack, -reach), slack)
    return anticipated(np.clip(needed, 0.0, np.maximum(slack, 0.0)), rate)


def _out_of_reach(hip: np.ndarray, foot: np.ndarray, leg: LegShape) -> np.ndarray:
    """(T,) how much nearer hip and foot would have to be in height; negative where
    they could be farther from each other [m]."""
    reach = _STRETCH * min(leg.reach, leg.length)
    way = hip - foot
    across = np.minimum(np.linalg.norm(way[:, :2], axis=1), _FARTHEST * reach)
    return way[:, 2] - np.sqrt(reach**2 - across**2)


def _lifting(root, R_W, trunk: TrunkShape, p, rate: float) -> np.ndarray:
    """(T,) how much higher the root must be for the trunk to be above the floor [m].

    What is above the waist is taken to be straight, along the performer's trunk or
    along the pelvis: a robot's waist is somewhere in between.
    """
    way = R_W.inv().apply(p["neck"] - p["pelvis"])
    bend = between(trunk.neck, unit_vectors(way)).as_matrix()
    R = R_W.as_matrix()
    lowest = np.min(R[:, 2] @ trunk.pelvis.T, axis=1, initial=np.inf)
    waist = R[:, 2] @ trunk.waist
    for up in (R[:, 2], np.einsum("ti,tij->tj", R[:, 2], bend)):
        upper = np.min(up @ trunk.upper.T, axis=1, initial=np.inf)
        lowest = np.minimum(lowest, waist + upper)
    needed = np.maximum(_ABOVE_FLOOR - (root[:, 2] + lowest), 0.0)
    return anticipated(needed, rate)


def off_the_floor(knee: np.ndarray, leg: LegShape) -> np.ndarray:
    """(T,) how much higher a knee (T, 3) must be to be above the floor [m]."""
    return np.maximum(leg.knee + _ABOVE_FLOOR - knee[:, 2], 0.0)


def anticipated(needed: np.ndarray, rate: float) -> np.ndarray:
    """(T,) smooth, nowhere below what is needed (T,), and before it is."""
    return smooth_bound(needed, round(_ANTICIPATION * rate))


def _taken_along(
    foot: FootMotion, hip: np.ndarray, leg: LegShape, lifted: np.ndarray, rate: float
) -> FootMotion:
    """A foot that a lifted root takes along: in the air, and out of its reach."""
    if not lifted.any():
        return foot
    on_the_floor = smooth_flags(foot.planted, round(_ANTICIPATION * rate))
    up = (1.0 - on_the_floor) * lifted
    needed = _out_of_reach(hip, foot.positions, leg) - up
    up = up + anticipated(np.where(lifted > 0.0, needed, 0.0).clip(0.0), rate)
    return replace(foot, positions=foot.positions + up[:, None] * [0.0, 0.0, 1.0])


def bent_knee(
    hip: np.ndarray,
    ankle: np.ndarray,
    p: Mapping[str, np.ndarray],
    side: str,
    leg: LegShape,
) -> np.ndarray:
    """(T, 3) where a leg of two lengths has its knee, bent to where the performer's is.

    Args:
        hip, ankle: (T, 3) of the robot [m].
        p: joint to (T, 3) of the performer [m].
        side: of the leg.
        leg: the robot's.
    """
    thigh_p = p[f"{side}_knee"] - p[f"{side}_hip"]
    way = ankle - hip
    d = np.linalg.norm(way, axis=1, keepdims=True)
    along = way / np.maximum(d, 1e-9)
    d = np.clip(d, abs(leg.thigh - leg.shank) + 1e-6, leg.length - 1e-6)
    x = (leg.thigh**2 - leg.shank**2 + d**2) / (2.0 * d)
    out = thigh_p - np.sum(thigh_p * along, axis=1, keepdims=True) * along
    off = np.sqrt(np.maximum(leg.thigh**2 - x**2, 0.0))
    return hip + x * along + off * unit_vectors(out)
