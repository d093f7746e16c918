"""The order of joints, the root, and the links' poses against those by hand."""

import gc
import weakref
from pathlib import Path

import numpy as np
import pytest
from small_biped import (
    BREADTH_FIRST,
    DEPTH_FIRST,
    LIMIT,
    SPEED,
    link_poses,
    moving_samples,
    whole_biped,
)


@pytest.mark.parametrize("base", ["pelvis", "prescribed"])
def test_orders_root_limits_and_poses(tmp_path: Path, base: str):
    robot = whole_biped(tmp_path, base=base)
    assert robot.root == "pelvis" and robot.n == 5
    assert robot.joint_names == DEPTH_FIRST
    assert robot.breadth_first == BREADTH_FIRST
    links = robot.links_of(robot.joint_names)
    assert links[0] == "pelvis" and links[2] == "left_shin"
    assert robot.links_of(("waist", "left_hip")) == ("pelvis", "trunk", "left_thigh")
    assert (robot.upper == LIMIT).all() and (robot.speed_limits == SPEED).all()
    _, _, q = moving_samples(4)
    p, R = robot.poses_in_root(q, links)
    for t in range(4):
        by_hand = link_poses(q[t])
        for i, link in enumerate(links):
            np.testing.assert_allclose(p[t, i], by_hand[link][0], atol=1e-12)
            np.testing.assert_allclose(
                R[t, i], by_hand[link][1].as_matrix(), atol=1e-12
            )
    axes = [[1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    np.testing.assert_allclose(robot.joint_axes, axes, atol=1e-12)


def test_a_robot_that_nobody_needs_is_freed(tmp_path: Path):
    robot = whole_biped(tmp_path)
    plant = weakref.ref(robot.plant)
    del robot
    gc.collect()
    assert plant() is None
