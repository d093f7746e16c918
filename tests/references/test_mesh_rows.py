"""Meshes of links that no capsules hold apart: their rows, and motions that part them.

The robot: a base with a post, an arm that turns about z, and a hand that slides along
the arm's x. The only pair that is watched is of two balls that are far from each other.
"""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_urdfs import joint, link, robot, write

from crar_drake.references.cleaning import Cleaner
from crar_drake.references.mesh_clearance import ClearanceOfMeshes
from crar_drake.references.mesh_rows import MeshRows
from crar_drake.references.uncovered import Uncovered
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description
from crar_drake.trajectory.optimiser import Samples

RATE = 30.0
ASKED = 5e-4  # [m]
WIDE = 'lower="-9" upper="9" effort="9" velocity="9"'
BALL = (
    '<link name="{0}"><collision><geometry><sphere radius="0.01"/></geometry>'
    '</collision></link><joint name="{0}_weld" type="fixed"><parent link="{1}"/>'
    '<child link="{0}"/><origin xyz="0 0 {2}"/></joint>'
)
MOTOR = (
    "<transmission><type>transmission_interface/SimpleTransmission</type>"
    '<joint name="{0}"><hardwareInterface>EffortJointInterface</hardwareInterface>'
    '</joint><actuator name="{0}"/></transmission>'
)
YAML = """\
name: clock
model: clock.urdf
base: post
task_frames: {t: hand}
rest_posture: {turn: 1.5}
pairs: [[above, below]]
"""


def meshes_of(folder: Path, post, hand, limits: str = WIDE) -> ClearanceOfMeshes:
    """Of the robot with these two; limits are those of both joints."""
    for name, mesh in (("post", post), ("hand", hand)):
        mesh.export(folder / f"{name}.obj", digits=12)
    parts = [
        link("post", '<mesh filename="post.obj"/>'),
        link("arm"),
        joint("turn", "post", "arm", "0 0 1", limits=limits),
        link("hand", '<mesh filename="hand.obj"/>'),
        joint("slide", "arm", "hand", "1 0 0", kind="prismatic", limits=limits),
        *(MOTOR.format(name) for name in ("turn", "slide")),
        BALL.format("above", "post", 3.0),
        BALL.format("below", "hand", -3.0),
    ]
    write(folder, robot(parts, "clock"), "clock.urdf")
    (folder / "robot.yaml").write_text(YAML)
    return ClearanceOfMeshes(WholeBody(load_robot_description(folder)))


def box(lower, upper) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[lower, upper])


def wedge(*corners) -> trimesh.Trimesh:
    """A prism along z on a triangle in the plane."""
    points = [[*corner, z] for corner in corners for z in (-0.05, 0.05)]
    return trimesh.convex.convex_hull(np.array(points))


def rows_of(clearance: ClearanceOfMeshes, q: np.ndarray):
    """Of all pairs at frames in a row: distances and gradients."""
    rows = MeshRows(clearance, ["slide", "turn"])
    where = np.full((rows.num_pairs, len(q)), True)
    frames = np.arange(len(q))
    at = Samples(frames, np.zeros(len(q)), np.zeros(len(q)))
    found = rows.near_rows(where, 1)(at, q[:, ::-1], 1.0)
    return found._replace(d=found.d + ASKED, gradient=found.gradient[:, ::-1])


def test_boxes_that_meet_have_closed_forms(tmp_path):
    """Faces 0.2 - slide apart, or so deep in each other; the nearest points are where
    the hand's corner is when it is turned."""
    clearance = meshes_of(
        tmp_path,
        box((0.3, -0.2, -0.2), (0.6, 0.2, 0.2)),
        box((0, -0.1, -0.1), (0.1,) * 3),
    )
    slide = np.array([0.196, 0.199, 0.202, 0.21, 0.23, 0.195])
    turn = np.full(6, 0.05)
    found = rows_of(clearance, np.column_stack([turn, slide]))
    np.testing.assert_array_equal(found.sample, np.arange(6))
    # The corner (0.1 + slide, -0.1) is the farthest along x.
    c, s = np.cos(0.05), np.sin(0.05)
    np.testing.assert_allclose(found.d, 0.3 - (0.1 + slide) * c - 0.1 * s, atol=1e-9)
    by_turn = (0.1 + slide) * s - 0.1 * c
    np.testing.assert_allclose(found.gradient[:, 0], by_turn, atol=1e-6)
    np.testing.assert_allclose(found.gradient[:, 1], -c, atol=1e-6)


def swing(frames: int, reach: float) -> np.ndarray:
    """(T, 2) the arm turns to an angle and back."""
    t = np.linspace(0.0, 1.0, frames)
    return np.column_stack([reach * np.sin(np.pi * t) ** 4 - 0.5, np.zeros(frames)])


@pytest.fixture(scope="module")
def beside_a_wedge(tmp_path_factory) -> ClearanceOfMeshes:
    """The hand turns towards an edge of the post, that is half as far out."""
    return meshes_of(
        tmp_path_factory.mktemp("wedge"),
        wedge((0.4, 0.05), (0.5, 0.2), (0.3, 0.2)),
        box((0.3, -0.05, -0.03), (0.6, 0.05, 0.03)),
    )


def cleaner_of(clearance: ClearanceOfMeshes, parting: bool = True) -> Cleaner:
    uncovered = Uncovered(clearance.robot) if parting else None
    return Cleaner(clearance.robot.description, RATE, None, uncovered)


def test_a_motion_that_meets_is_parted_and_changed_the_least(beside_a_wedge):
    clearance, q = beside_a_wedge, swing(90, 0.53)
    before = clearance.find(q)
    assert 5 < before.num_touching < 40
    np.testing.assert_array_equal(cleaner_of(clearance, False).clean(q).q, q)
    found = cleaner_of(clearance).clean(q).q
    after = clearance.find(found)
    assert after.num_touching == after.num_unclear == 0
    # The hand's upper side is 0.05 from the arm's axis; the edge is 0.05 above y = 0
    # at x = 0.4, and so many radians before the arm is at zero they meet.
    meet = np.arctan2(0.05, 0.4) - np.arcsin((0.05 + ASKED) / np.hypot(0.4, 0.05))
    most = q[:, 0].max() - meet
    change = np.abs(found - q)
    assert 0.99 * most < change.max() < 1.1 * most
    touching = np.flatnonzero(before.touch_at.any(axis=0))
    outside = np.ones(90, dtype=bool)
    outside[touching[0] - 11 : touching[-1] + 12] = False
    assert outside.sum() > 20 and (change[outside] == 0.0).all()


def test_what_is_clear_comes_back_to_the_last_bit(beside_a_wedge):
    q = swing(60, 0.45)
    assert beside_a_wedge.find(q).num_unclear == 0
    found = cleaner_of(beside_a_wedge).clean(q)
    np.testing.assert_array_equal(found.q, q)
    assert found.effort.linearised == 0


def test_parted_twice_is_parted_once(beside_a_wedge):
    cleaner = cleaner_of(beside_a_wedge)
    once = cleaner.clean(swing(90, 0.53)).q
    np.testing.assert_array_equal(cleaner.clean(once).q, once)


def test_a_way_that_cuts_a_corner_leads_around_it(tmp_path):
    """Both frames are clear of the post; in between its corner is cut."""
    clearance = meshes_of(
        tmp_path,
        box((0.5, -0.1, -0.1), (0.6, 0.07, 0.1)),
        box((0.4, -0.01, -0.01), (0.45, 0.01, 0.01)),
    )
    q = np.repeat([[0.0, 0.02], [0.28, 0.2]], 20, axis=0)
    before = clearance.find(q)
    assert before.num_touching == 0 and before.num_unclear == 1
    found = cleaner_of(clearance).clean(q).q
    assert clearance.find(found).num_unclear == 0
    assert np.abs(found - q).max() < 0.12


def test_what_cannot_be_parted_is_left_and_reported(tmp_path):
    """The hand is held in the post by its joints' limits."""
    near = 'lower="-0.01" upper="0.01" effort="9" velocity="9"'
    clearance = meshes_of(
        tmp_path,
        box((0.3, -0.2, -0.2), (0.6, 0.2, 0.2)),
        box((0.2, -0.1, -0.1), (0.4, 0.1, 0.1)),
        near,
    )
    q = np.column_stack([np.linspace(-0.01, 0.01, 12), np.zeros(12)])
    assert clearance.find(q).touch_at[0].all()
    found = cleaner_of(clearance).clean(q)
    np.testing.assert_array_equal(found.q, q)
    assert not found.violating.any()  # of what capsules say
