"""What a person asks of a robot with legs, and which persons do not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_walker import walker

from crar_drake.errors import MotionError
from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.orientations import hip_turns
from crar_drake.motion.performer import Performer
from crar_drake.trajectory.performer_targets import performer_targets
from crar_drake.trajectory.retargeting import Retargeter, RetargetingParameters

FRAMES, RATE = 180, 30.0  # of the dance, at 60 Hz; and what is wanted


@pytest.fixture(scope="module")
def performer() -> Performer:
    """The beginning of the dance."""
    dance = load_performer("dance")
    parts = {
        name: {joint: x[:FRAMES] for joint, x in getattr(dance, name).items()}
        for name in ("positions", "orientations", "hands")
    }
    return replace(dance, heading=dance.heading[:FRAMES], **parts)


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Retargeter:
    return Retargeter(walker(tmp_path_factory.mktemp("walker")))


def asked(robot: Retargeter, performer: Performer):
    turned = robot._base[1]
    return performer_targets(performer, robot.legs, robot.soles, turned, RATE, 6.0)


def test_legs_are_asked_to_keep_apart(tmp_path, performer):
    """Knees with balls that touch, where they are nearest, if nothing is asked; while a
    foot is in the air."""
    raised = dict(performer.positions)
    hip = raised["left_hip"]
    across = hip - raised["right_hip"]
    across = across / np.linalg.norm(across, axis=1)[:, None]
    ahead = Rotation.from_rotvec(-0.9 * across)
    for joint in ("left_knee", "left_ankle"):
        raised[joint] = hip + ahead.apply(raised[joint] - hip)
    performer = replace(performer, positions=raised)
    radius = 0.06
    thick = walker(tmp_path, knee=radius).without_ground()

    def nearest(between: float) -> float:
        retargeter = Retargeter(thick, RetargetingParameters(between_legs=between))
        found = retargeter.retarget(performer, RATE)
        ways = retargeter.ways(
            found.root_positions,
            found.root_rotations,
            found.q,
            [("left_knee", "right_knee")],
        )
        left = found.targets.feet["left"]
        assert not (left.on_heel | left.on_ball).any()
        return float(np.linalg.norm(ways[0], axis=1).min()) - 2.0 * radius

    free = nearest(0.0)
    assert free > 0.004
    wanted = free + 0.01
    assert nearest(wanted) > wanted


def test_points_relative_to_the_pelvis_are_refused(robot, performer):
    """As of a pose estimator."""
    p = performer.positions
    still = {joint: q - p["pelvis"] + p["pelvis"][0] for joint, q in p.items()}
    with pytest.raises(MotionError, match="the pelvis never moves, although a foot"):
        asked(robot, replace(performer, positions=still))


def test_a_performer_that_lacks_something_is_refused(robot, performer):
    toeless = {k: p for k, p in performer.positions.items() if "toe" not in k}
    with pytest.raises(MotionError, match="no left_toe, right_toe, and so no feet"):
        asked(robot, replace(performer, positions=toeless, orientations={}))
    with pytest.raises(MotionError, match="dance: it does not tell how the pelvis"):
        hip_turns(replace(performer, orientations={}))
