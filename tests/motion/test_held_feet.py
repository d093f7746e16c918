"""A made-up step: what is planted stays, on the floor, and nothing is below it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crar_drake.motion.held_feet import (
    dwelling,
    find_contacts,
    find_contacts_of_feet,
    hold_foot,
    twist,
)
from crar_drake.motion.planted_feet import (
    ContactThresholds,
    runs,
    standing,
    without_short,
)

RATE = 120.0
HEEL, BALL = np.array([-0.06, 0.0, -0.05]), np.array([0.12, 0.0, -0.05])
POINTS = np.array([[x, y, -0.05] for x in (-0.06, 0.12) for y in (-0.03, 0.03)])


def step(seed: int, *, noise: float = 0.004):
    """Stands 1 s, strides 0.5 m in 0.6 s with the toe down at first, stands again.

    Recorded as people are: it drifts while it stands, at a wrong height, tilted.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(2.6 * RATE)) / RATE
    s = np.clip((t - 1.0) / 0.6, 0.0, 1.0)
    stride = s - np.sin(2 * np.pi * s) / (2 * np.pi)
    lift = np.sin(np.pi * s) ** 2
    low = sum(
        rng.normal(size=3) * np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0, 6, 3))
        for f in (0.3, 0.7, 1.1)
    )
    p = np.column_stack([0.5 * stride, 0.1 + 0 * t, 0.055 + 0.12 * lift])
    turns = Rotation.from_euler(
        "ZYX",
        np.column_stack([0.2 + 0.1 * s, 0.6 * np.sin(np.pi * s) ** 2, 0.03 + 0 * t]),
    )
    return p + noise * low, turns


def surface(foot) -> np.ndarray:
    """(T, V, 3) its points in the world."""
    R = Rotation.from_quat(foot.turns).as_matrix()
    return foot.positions[:, None] + np.einsum("tij,vj->tvi", R, POINTS)


@pytest.mark.parametrize("seed", range(4))
def test_a_planted_foot_stays_where_it_is(seed):
    positions, turns = step(seed)
    foot = hold_foot(positions, turns, HEEL, BALL, POINTS, RATE)
    contacts = runs(foot.planted)
    assert len(contacts) == 2
    assert contacts[0][1] > 0.9 * RATE and contacts[1][0] < 1.8 * RATE
    p = surface(foot)
    low = p[..., 2].min(axis=1)
    assert low.min() > -1e-9
    np.testing.assert_allclose(low[foot.planted], 0.0, atol=1e-9)
    flat = foot.heel & foot.ball
    assert np.ptp(p[flat][..., 2], axis=1).max() < 1e-9
    for start, end in contacts:
        stands = np.zeros(len(p), dtype=bool)
        stands[start:end] = flat[start:end]
        assert np.count_nonzero(stands) > 0.5 * RATE
        # All of the sole: neither does it slide, nor turn.
        for points in np.split(
            p[stands], np.flatnonzero(np.diff(np.flatnonzero(stands)) > 1) + 1
        ):
            assert np.ptp(points[..., :2], axis=0).max() < 1e-6
        # It was moved no farther than it drifted.
        way = foot.positions[start:end] - positions[start:end]
        assert np.linalg.norm(way[:, :2].mean(axis=0)) < 1e-9
    # In between it clears the floor, and its speed does not jump.
    middle = round(1.3 * RATE)
    assert low[middle] > 0.05
    acceleration = np.diff(foot.positions, 2, axis=0) * RATE**2
    assert np.abs(acceleration).max() < 120.0


def test_on_its_ball_a_foot_pitches_about_it():
    t = np.arange(240) / RATE
    pitch = 0.5 * np.sin(np.pi * np.clip(t - 0.5, 0.0, 1.0)) ** 2  # heel up, and down
    turns = Rotation.from_euler("y", pitch[:, None])
    # The ball drifts while all turns about it.
    positions = np.array([0.0, 0.0, 0.0]) + 0.02 * t[:, None] * [1.0, 0.5, 0.0]
    positions = positions - turns.apply(BALL)
    foot = hold_foot(positions, turns, HEEL, BALL, POINTS, RATE)
    assert foot.ball.all() and not foot.heel.all()
    R = Rotation.from_quat(foot.turns)
    p = foot.positions + R.apply(BALL)
    assert np.ptp(p, axis=0).max() < 1e-6
    raised = R.as_rotvec()[~foot.heel, 1]
    assert raised.max() > 0.45


def on_its_toes(pitch: np.ndarray, yaw: np.ndarray):
    """Its ball on the floor, all turns about that."""
    turns = Rotation.from_euler("ZY", np.column_stack([yaw, pitch]))
    return -turns.apply(BALL), turns


def test_on_its_toes_a_foot_does_not_tip_over_them():
    """A person's toes bend, the heel may be ahead of them; a sole that does not bend
    would stand on what is above its toes."""
    t = np.arange(240) / RATE
    positions, turns = on_its_toes(0.3 + 1.5 * np.sin(np.pi * t / 2) ** 2, 0.0 * t)
    above = np.array([[0.12, y, -0.01] for y in (-0.03, 0.03)])  # of the toes
    points = np.concatenate([POINTS, above])
    low = turns.as_matrix()[:, 2] @ points.T
    assert low.argmin(axis=1).max() > 3  # as the person has it
    foot = hold_foot(positions, turns, HEEL, BALL, points, RATE)
    assert foot.ball.all()
    R = Rotation.from_quat(foot.turns)
    low = R.as_matrix()[:, 2] @ points.T
    assert low.argmin(axis=1).max() <= 3  # its sole
    ahead = R.apply(BALL)[:, 0]
    assert -1e-9 < ahead.min() < 0.01  # the foot's frame comes nearly above it
    # Until there it pitches as the person does, or nearly.
    gentle = t < 0.3
    pitch = R.as_rotvec()[:, 1]
    np.testing.assert_allclose(pitch[gentle], turns.as_rotvec()[gentle, 1], atol=0.01)


def test_on_its_toes_a_foot_turns_about_their_middle():
    """At one pitch, so that no edge of it is the lowest but that of the toes."""
    t = np.arange(240) / RATE
    positions, turns = on_its_toes(0.5 + 0.0 * t, 0.6 * np.sin(np.pi * t / 2) ** 2)
    drift = 0.02 * t[:, None] * [1.0, 0.5, 0.0]
    foot = hold_foot(positions + drift, turns, HEEL, BALL, POINTS, RATE)
    assert foot.ball.all() and not foot.heel.any()
    R = Rotation.from_quat(foot.turns)
    assert np.ptp(twist(R)) > 0.5
    assert np.ptp(foot.positions + R.apply(BALL), axis=0).max() < 1e-6


def test_from_its_heel_on_its_ball_a_foot_goes_by_the_floor():
    """It rolls from 0.3 rad on the heel to 0.3 rad on the ball in 0.1 s, lifted by 4 cm
    for 40 ms between: neither end of it is low and slow then."""
    T = 120
    time = np.arange(T) / RATE
    pitch = np.interp(time, [0.4, 0.5], [-0.3, 0.3])
    turns = Rotation.from_euler("y", pitch[:, None])
    low = (turns.as_matrix()[:, 2] @ POINTS.T).min(axis=1)
    up = np.where(np.abs(time - 0.45) < 0.02, 0.04, 0.0)
    p = np.column_stack([np.zeros(T), np.zeros(T), up - low])
    points = np.array([HEEL, BALL])
    found = find_contacts(p, turns, points, 0.0, RATE)
    assert found.any(axis=1).all()
    assert found[: T // 3, 0].all() and found[-T // 3 :, 1].all()
    # A longer gap is a step.
    p[:, 2] += np.where(np.abs(time - 0.45) < 0.08, 0.04, 0.0)
    found = find_contacts(p, turns, points, 0.0, RATE)
    assert not found.any(axis=1).all()


@pytest.mark.parametrize("falls", [False, True])
def test_who_does_not_fall_stands_on_a_foot(falls):
    """One foot at rest 5 cm too high, the other one in the air: it stands, unless the
    hips fall; and not if it is as high as a stool."""
    t = np.arange(120) / RATE
    hips = 0.8 - 0.5 * 9.81 * t**2 * falls

    def found(height: float) -> dict[str, np.ndarray]:
        ankles = {
            side: np.tile([0.0, y, z - HEEL[2]], (120, 1))
            for side, y, z in (("left", 0.1, height), ("right", -0.1, 0.3))
        }
        turns = dict.fromkeys(ankles, Rotation.identity(120))
        points = dict.fromkeys(ankles, np.array([HEEL, BALL]))
        return find_contacts_of_feet(ankles, turns, points, 0.0, RATE, hips)

    contacts = found(0.05)
    assert contacts["left"].all() != falls and contacts["left"].any() != falls
    assert not contacts["right"].any() and not found(0.2)["left"].any()


def test_a_twist_is_the_turn_about_the_vertical():
    yaw = np.linspace(0.0, 9.0, 50)
    turns = Rotation.from_euler("Z", yaw[:, None]) * Rotation.from_euler("y", [[0.7]])
    np.testing.assert_allclose(twist(turns), yaw, atol=1e-9)


def test_hysteresis_and_short_stretches():
    limits = ContactThresholds(0.01, 0.03, 0.2, 0.5)
    height = np.array([0.02, 0.005, 0.02, 0.02, 0.04, 0.02, 0.005])
    speed = np.array([0.0, 0.1, 0.4, 0.4, 0.0, 0.0, 0.3])
    assert standing(height, speed, limits).tolist() == [0, 1, 1, 1, 0, 0, 0]
    flags = np.array([1, 1, 1, 0, 1, 1, 1, 0, 0, 0, 1, 0, 0, 0], dtype=bool)
    kept = without_short(flags, 2)
    assert kept.tolist() == [1] * 7 + [0] * 7


@pytest.mark.parametrize("seed", range(4))
def test_a_foot_comes_down_and_leaves_upright(seed):
    """Where it is as low as 2 mm it does not slide, also before and after a contact."""
    positions, turns = step(seed)
    foot = hold_foot(positions, turns, HEEL, BALL, POINTS, RATE)
    p = surface(foot)
    low = p[..., 2].min(axis=1) < 0.002
    assert np.count_nonzero(low) > np.count_nonzero(foot.planted)
    ways = np.linalg.norm(np.diff(p[..., :2], axis=0), axis=2).min(axis=1)
    assert ways[low[1:] & low[:-1]].max() < 1e-4  # [m] in a sample


def test_a_foot_dwells_no_longer_than_a_quarter_of_a_gap():
    planted = np.ones(40, dtype=bool)
    planted[15:23] = planted[30:] = False
    kept = dwelling(planted, RATE)
    assert np.flatnonzero(~kept).tolist() == [17, 18, 19, 20, *range(36, 40)]
    np.testing.assert_array_equal(dwelling(~np.ones(5, bool), RATE), False)
