"""Points of links: where they are by hand, and how they move by finite differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_walker import leg_points, walker

from crar_drake.trajectory.body_points import ROOT, Placed, skew, turn_jacobian
from crar_drake.trajectory.retargeting import Retargeter

STEP = 1e-6


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return Retargeter(walker(tmp_path_factory.mktemp("walker")))


def unknowns(robot, frames, seed=0):
    """Some within the joints' limits, with roots that are turned much, and hardly."""
    rng = np.random.default_rng(seed)
    y = rng.normal(size=(frames, ROOT + robot.model.n))
    y[:, 3:ROOT] *= np.geomspace(1e-7, 1.0, frames)[:, None]
    joints = rng.uniform(robot.model.lower, robot.model.upper, (frames, robot.model.n))
    y[:, ROOT:] = 0.8 * joints
    roots = Rotation.random(frames, rng=rng).as_matrix()
    return rng.normal(size=(frames, 3)), roots, y


def placed(robot, p, R, y):
    return Placed(robot._poses, robot.rest, robot._base, p, R, y)


def slopes(robot, p, R, y, of):
    """Central differences of `of` of what is placed, along each unknown, last."""
    found = []
    for k in range(y.shape[1]):
        step = STEP * np.eye(y.shape[1])[k]
        ahead, behind = (of(placed(robot, p, R, y + s * step)) for s in (1, -1))
        found.append((ahead - behind) / (2.0 * STEP))
    return np.stack(found, axis=-1)


def test_legs_are_where_they_are_by_hand(robot):
    p, R, y = unknowns(robot, 5)
    frames = [f"{side}_{x}" for side in ("left", "right") for x in ("hip", "knee")]
    frames += ["left_foot", "right_foot"]
    points, _ = placed(robot, p, R, y).points(*robot.frame_points(frames))
    for k in range(len(y)):
        q = dict(zip(robot.model.joint_names, y[k, ROOT:], strict=True))
        root = Rotation.from_rotvec(y[k, 3:ROOT]) * Rotation.from_matrix(R[k])
        for frame, point in zip(frames, points[k], strict=True):
            side, _, name = frame.partition("_")
            by_hand = leg_points(side, q)["ankle" if name == "foot" else name]
            expected = p[k] + y[k, :3] + root.apply(by_hand)
            np.testing.assert_allclose(point, expected, atol=1e-12)


def test_jacobians_are_how_points_heights_and_links_move(robot):
    p, R, y = unknowns(robot, 6)
    links = np.array([0, 3, 7, len(robot._links) - 1])
    offsets = np.random.default_rng(1).normal(size=(4, 3))
    found = placed(robot, p, R, y)

    _, J = found.points(links, offsets)
    moved = slopes(robot, p, R, y, lambda at: at.points(links, offsets)[0])
    np.testing.assert_allclose(J, moved, atol=1e-7)

    frames, some = np.array([0, 2, 5, 5]), links[::-1]
    z, g = found.heights(frames, some, offsets)
    points, J = found.points(some, offsets)
    np.testing.assert_allclose(z, points[frames, range(4), 2], atol=1e-12)
    np.testing.assert_allclose(g, J[frames, range(4), 2], atol=1e-12)

    turns, J = found.turns(links)
    turned = slopes(robot, p, R, y, lambda at: at.R[:, links])
    spin = np.moveaxis(turned, -1, 2) @ turns[:, :, None].swapaxes(-1, -2)
    np.testing.assert_allclose(skew(np.moveaxis(J, -1, 2)), spin, atol=1e-7)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.9e-4, 1.1e-4, 0.3, 3.0, 6.0])
def test_the_jacobian_of_a_turn(angle):
    """omega = J d(turn): what SciPy's rotations do from one turn to the next."""
    axis = np.array([0.6, -0.64, 0.48])
    turn = angle * axis
    J = turn_jacobian(turn[None])[0]
    for k in range(3):
        step = STEP * np.eye(3)[k]
        ahead, behind = (Rotation.from_rotvec(turn + s * step) for s in (1, -1))
        omega = (ahead * behind.inv()).as_rotvec() / (2.0 * STEP)
        np.testing.assert_allclose(J[:, k], omega, atol=1e-8)


def test_a_skew_matrix_is_the_cross_product():
    a, b = np.random.default_rng(2).normal(size=(2, 7, 3))
    np.testing.assert_allclose((skew(a) @ b[..., None])[..., 0], np.cross(a, b))
