"""Slip of feet whose way is known."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation
from small_biped import biped

from crar_drake.references.ground_contact import (
    Outline,
    foot_slip,
    least_way,
    longest_slip,
)
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description

RATE = 50.0
SOLE = np.array([[0.1, 0.05, 0], [0.1, -0.05, 0], [-0.1, 0.05, 0], [-0.1, -0.05, 0]])


def sliding(speeds: np.ndarray, heights: np.ndarray | float = 0.0) -> np.ndarray:
    """(T, 4, 3) a flat sole that slides along x at (T - 1,) speeds [m/s]."""
    x = np.concatenate([[0.0], np.cumsum(speeds)]) / RATE
    p = np.repeat(SOLE[None], len(x), axis=0)
    p[..., 0] += x[:, None]
    p[..., 2] += np.broadcast_to(heights, len(x))[:, None]
    return p


def test_slip_adds_up():
    slip = foot_slip("f", [sliding(np.full(20, 0.1))], 0.0, RATE)
    assert slip.planted.all() and slip.num_contacts == 1
    assert slip.total == slip.worst == pytest.approx(20 * 0.1 / RATE)
    assert slip.top_speed == pytest.approx(0.1)
    assert (slip.worst_start, slip.worst_end) == (0, 20)


def test_fast_feet_are_planted_only_if_they_were_slow():
    fast = foot_slip("f", [sliding(np.full(20, 0.3))], 0.0, RATE)
    assert fast.num_contacts == 0 and not fast.planted.any()
    speeds = np.concatenate([np.full(8, 0.1), np.full(8, 0.3), np.full(8, 0.6)])
    slow_first = foot_slip("f", [sliding(speeds)], 0.0, RATE)
    assert slow_first.planted.sum() == 17  # the ends of 16 steps
    assert slow_first.total == pytest.approx((8 * 0.1 + 8 * 0.3) / RATE)


def test_high_feet_are_planted_only_if_they_were_low():
    still = np.zeros(20)
    assert foot_slip("f", [sliding(still, 0.02)], 0.0, RATE).num_contacts == 0
    assert foot_slip("f", [sliding(still, 0.02)], 0.01, RATE).num_contacts == 1
    lifted = np.concatenate([np.zeros(10), np.full(5, 0.02), np.full(6, 0.04)])
    assert foot_slip("f", [sliding(still, lifted)], 0.0, RATE).planted.sum() == 15


def test_contacts_that_are_known_count_alone():
    """Steps between two planted frames do: of contacts of 4 and 3, the 3 and 2 in them;
    one in which it leaves does not, however low the foot is."""
    speeds = np.array([0.1, 0.1, 0.1, 5.0, 5.0, 0.4, 0.4, 5.0])
    planted = np.array([1, 1, 1, 1, 0, 1, 1, 1, 0], dtype=bool)
    p = sliding(speeds)
    assert longest_slip([p], planted) == pytest.approx(0.8 / RATE)
    assert longest_slip([p], planted & (np.arange(9) < 5)) == pytest.approx(0.3 / RATE)
    assert longest_slip([p], np.zeros(9, dtype=bool)) == 0.0


def test_a_foot_that_rolls_over_its_toes_does_not_slip():
    toe = np.array([0.1, 0.0, 0.0])
    p = np.array(
        [
            Rotation.from_rotvec([0, a, 0]).apply(SOLE - toe) + toe
            for a in np.linspace(0.0, 0.6, 20)
        ]
    )
    slip = foot_slip("f", [p], 0.0, RATE)
    assert slip.planted.all() and slip.total == pytest.approx(0.0, abs=1e-12)
    # Its middle moves meanwhile.
    assert np.linalg.norm(p[-1].mean(axis=0) - p[0].mean(axis=0)) > 0.05


def test_a_touch_is_no_contact():
    heights = np.full(20, 0.1)
    heights[8:11] = 0.0
    assert foot_slip("f", [sliding(np.zeros(19), heights)], 0.0, RATE).num_contacts == 0


def test_least_way_is_the_distance_of_the_convex_hull_from_0():
    """Beside a quadratic program by SciPy over the weights of the vertices."""
    rng = np.random.default_rng(0)
    moves = 1e-3 * (rng.normal(size=(40, 7, 2)) + 1.5 * rng.normal(size=(40, 1, 2)))
    there = rng.random((40, 7)) < 0.7
    there[:, 0] = True
    found = least_way(moves, there)
    inside = 0
    for move, counts, way in zip(1e3 * moves, there, 1e3 * found, strict=True):
        d = move[counts]
        best = minimize(
            lambda w, d=d: np.sum((w @ d) ** 2),
            np.full(len(d), 1.0 / len(d)),
            jac=lambda w, d=d: 2.0 * d @ (w @ d),
            bounds=[(0.0, 1.0)] * len(d),
            constraints={"type": "eq", "fun": lambda w: w.sum() - 1.0},
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert best.success
        expected = np.linalg.norm(best.x @ d)
        inside += expected < 1e-4
        assert way == pytest.approx(expected, abs=1e-3)
    assert 3 < inside < 37


def test_a_piece_that_turns_about_a_point_of_its_edge_moves_nowhere_there():
    """Wherever rounding puts 0 beside the segment that it is on."""
    thirds = np.array([[6.0, 3.0], [0.0, -5.0], [-2.0, -1.0]]) / 3.0
    for moves in (thirds, thirds[::-1], thirds[[2, 0, 1]]):
        way = least_way(np.array([moves]), np.ones((1, 3), dtype=bool))
        assert way[0] < 1e-12


def test_a_foot_that_turns_about_a_point_of_its_sole_does_not_slip():
    angles = np.linspace(0.0, 1.0, 200)
    corners = np.array([[-0.1, -0.04], [-0.1, 0.04], [0.12, -0.04], [0.12, 0.04]])
    pivot = np.array([0.06, 0.01])
    turns = np.stack(
        [[np.cos(angles), -np.sin(angles)], [np.sin(angles), np.cos(angles)]]
    )
    p = np.einsum("ijt,vj->tvi", turns, corners - pivot)
    p = np.concatenate([p, np.zeros((200, 4, 1))], axis=2)
    assert foot_slip("f", [p], 0.0, RATE).total < 1e-3
    shifted = p + np.linspace(0.0, 0.02, 200)[:, None, None] * [1.0, 0.0, 0.0]
    # The point that rests moves on: by less than the foot, which can walk so.
    assert foot_slip("f", [shifted], 0.0, RATE).total < 1e-3


@pytest.mark.parametrize("frames", [3, 4, 30])
def test_a_hand_on_the_ground_carries_in_short_motions_too(tmp_path, frames):
    """A foot is called a hand; it stands, and carries by the share of the 5 frames
    about each in which it does."""
    folder = biped(tmp_path / "biped")
    yaml = (folder / "robot.yaml").read_text()
    yaml = yaml.replace("task_frames: {", "task_frames: {left_hand: left_shin, ")
    (folder / "robot.yaml").write_text(yaml)
    robot = WholeBody(load_robot_description(folder))
    motion = RobotMotion(
        joint_names=robot.joint_names,
        root_positions=np.tile([0.0, 0.0, 0.9], (frames, 1)),
        root_quaternions=np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1)),
        joint_positions=np.zeros((frames, 5)),
        rate=20.0,
    )
    shares = Outline(robot).carrying(motion, ("right_hand", "left_hand"))
    k = np.arange(frames)
    there = np.minimum(k + 2, frames - 1) - np.maximum(k - 2, 0) + 1
    np.testing.assert_allclose(shares, np.column_stack([0.0 * k, there / 5.0]))
