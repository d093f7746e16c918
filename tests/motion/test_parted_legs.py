"""Legs that would meet: who is in the air gives way, who stands keeps his place."""

import numpy as np
import pytest

from crar_drake.motion.held_feet import FootMotion
from crar_drake.motion.parted_legs import LegRoom, part_legs
from crar_drake.motion.smooth_steps import smooth_step

RATE = 120.0
COUNT = 300
T = np.arange(COUNT) / RATE


def foot(planted: np.ndarray) -> FootMotion:
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1))
    return FootMotion(np.zeros((COUNT, 3)), turns, planted, planted)


def lacking(middle: float, half: float, most: float) -> np.ndarray:
    return most * (1.0 - smooth_step(np.abs(T - middle) / half))


def legs_that_meet(needed: np.ndarray) -> LegRoom:
    """The left foot parts them to the left (y), and by turning to the left."""
    effect = np.tile([0.05, 0.5, 0.2], (COUNT, 1))
    return LegRoom(needed, {"left": effect, "right": -effect})


def gained(room: LegRoom, moves) -> np.ndarray:
    return sum(np.sum(room.effects[s] * moves[s], axis=1) for s in moves)


def test_a_foot_in_the_air_goes_round_one_that_stands():
    air = (T > 0.8) & (T < 1.8)
    feet = {"left": foot(~air), "right": foot(np.ones(COUNT, bool))}
    room = legs_that_meet(lacking(1.3, 0.2, 0.02))
    moves = part_legs(feet, room, RATE)
    assert (gained(room, moves) >= room.lacking - 1e-9).all()
    np.testing.assert_array_equal(moves["right"], 0.0)
    np.testing.assert_allclose(moves["left"][~air], 0.0, atol=1e-12)
    # 2 cm of 0.5 m/m, and of 0.2 m/rad, which weighs as much as 15 cm: mostly a turn.
    size = 0.02 / (0.05**2 + 0.5**2 + (0.2 / 0.15) ** 2)
    assert moves["left"][:, 1].max() == pytest.approx(0.5 * size, rel=0.01)
    assert moves["left"][:, 2].max() == pytest.approx(0.2 / 0.15**2 * size, rel=0.01)
    assert np.abs(np.diff(moves["left"][:, 1], 2)).max() * RATE**2 < 10.0  # [m/s^2]


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_foot_whose_leg_would_land_in_the_other_comes_down_elsewhere(side):
    """They meet while both stand: the one that came later stands elsewhere."""
    air = (T > 0.5) & (T < 1.2)
    other = {"left": "right", "right": "left"}[side]
    feet = {side: foot(~air), other: foot(np.ones(COUNT, bool))}
    room = legs_that_meet(lacking(1.6, 0.3, 0.02))
    moves = part_legs(feet, room, RATE)
    assert gained(room, moves)[room.lacking > 0.0199].min() >= 0.0199
    np.testing.assert_array_equal(moves[other], 0.0)
    stands = T > 1.21
    assert np.ptp(moves[side][stands], axis=0).max() < 1e-12
    assert np.abs(moves[side][stands][0, 2]) > 0.05
    np.testing.assert_allclose(moves[side][T < 0.49], 0.0, atol=1e-12)


def test_what_hardly_helps_is_not_overdone():
    """A stretched leg: no move of the foot parts the knees."""
    feet = {s: foot(np.zeros(COUNT, bool)) for s in ("left", "right")}
    weak = np.tile([0.0, 1e-3, 0.0], (COUNT, 1))
    room = LegRoom(lacking(1.0, 0.3, 0.03), {"left": weak, "right": -weak})
    for move in part_legs(feet, room, RATE).values():
        assert np.abs(move).max() < 0.01
    none = LegRoom(np.zeros(COUNT), room.effects)
    for move in part_legs(feet, none, RATE).values():
        np.testing.assert_array_equal(move, 0.0)


def test_two_that_are_in_the_air_share_it():
    feet = {s: foot(np.zeros(COUNT, bool)) for s in ("left", "right")}
    room = legs_that_meet(lacking(1.0, 0.3, 0.02))
    moves = part_legs(feet, room, RATE)
    np.testing.assert_allclose(moves["left"], -moves["right"], atol=1e-12)
    assert (gained(room, moves) >= room.lacking - 1e-9).all()
    assert 0.01 < moves["left"][:, 2].max() < 0.1
