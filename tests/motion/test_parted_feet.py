"""Feet that would go through each other pass beside each other; who stands, stands."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crar_drake.motion.held_feet import place_foot
from crar_drake.motion.leg_shape import LegShape
from crar_drake.motion.parted_feet import part_feet

RATE = 120.0
HEEL, BALL = np.array([-0.06, 0.0, -0.05]), np.array([0.12, 0.0, -0.05])
POINTS = np.array([[x, y, -0.05] for x in (-0.06, 0.12) for y in (-0.03, 0.03)])
LEG = LegShape(np.zeros(3), 0.3, 0.3, 0.6, np.eye(3), POINTS, HEEL, BALL)
LEGS = {"left": LEG, "right": LEG}
APART = 0.06 + 0.02  # [m] soles' widths, and most of the room between them


def placed(positions, planted):
    turns = Rotation.from_quat(np.tile([0.0, 0.0, 0.0, 1.0], (len(positions), 1)))
    contacts = np.column_stack([planted, planted])
    return place_foot(positions, turns, contacts, BALL, POINTS, RATE)


def least_distance(feet, shifts) -> np.ndarray:
    """(T,) between the middle lines of both soles, by points along them."""
    along = np.linspace(HEEL, BALL, 40)[:, :2]
    left, right = (
        (feet[s].positions[:, :2] + shifts[s])[:, None] + along
        for s in ("left", "right")
    )
    ways = left[:, :, None] - right[:, None]
    return np.linalg.norm(ways, axis=-1).min(axis=(1, 2))


def stepping_past(across: float, landing: float):
    """The right foot stands at y = 0; the left one strides past it at y = across."""
    t = np.arange(240) / RATE
    s = np.clip((t - 0.6) / 0.7, 0.0, 1.0)
    s = s**3 * (10 - 15 * s + 6 * s**2)
    air = (t > 0.6) & (t < 1.3)
    y = 0.15 + (across - 0.15) * np.sin(np.pi * s) + (landing - 0.15) * s
    lift = 0.05 + 0.06 * np.sin(np.pi * s) ** 2
    left = placed(np.column_stack([-0.3 + 0.6 * s, y, lift]), ~air)
    right = placed(np.tile([0.0, 0.0, 0.05], (len(t), 1)), np.ones(len(t), bool))
    return {"left": left, "right": right}, air


@pytest.mark.parametrize("across", [0.05, 0.02, 0.0])
def test_a_foot_goes_round_the_one_that_stands(across):
    feet, air = stepping_past(across, 0.15)
    before = least_distance(feet, {s: np.zeros((240, 2)) for s in feet})
    assert before.min() < 0.06
    shifts = part_feet(feet, LEGS, RATE)
    assert least_distance(feet, shifts).min() > APART
    np.testing.assert_array_equal(shifts["right"], 0.0)
    np.testing.assert_allclose(shifts["left"][~air], 0.0, atol=1e-12)
    # It is moved smoothly: far from what a jump in a sample would be.
    acceleration = np.diff(shifts["left"], 2, axis=0) * RATE**2
    assert np.abs(acceleration).max() < 60.0  # [m/s^2]


def test_a_foot_that_comes_down_on_the_other_comes_down_beside_it():
    t = np.arange(240) / RATE
    s = np.clip((t - 0.6) / 0.7, 0.0, 1.0)
    air = (t > 0.6) & (t < 1.3)
    x = -0.3 + 0.3 * s**3 * (10 - 15 * s + 6 * s**2)
    left = placed(np.column_stack([x, 0.15 - 0.13 * s, 0.05 + 0.05 * air]), ~air)
    right = placed(np.tile([0.0, 0.0, 0.05], (240, 1)), np.ones(240, bool))
    feet = {"left": left, "right": right}
    shifts = part_feet(feet, LEGS, RATE)
    assert least_distance(feet, shifts).min() > APART
    np.testing.assert_array_equal(shifts["right"], 0.0)
    assert np.ptp(shifts["left"][t > 1.31], axis=0).max() < 1e-12
    assert shifts["left"][-1, 1] > 0.05


def test_feet_that_are_apart_are_left_alone():
    feet, _ = stepping_past(0.15, 0.15)
    for shift in part_feet(feet, LEGS, RATE).values():
        np.testing.assert_array_equal(shift, 0.0)
