"""A pelvis that slides over soles that stand: what is said of all of its box."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from standing_robots import standing_robot

from crar_drake.equations.moving_legs import leg_bounds
from crar_drake.errors import ModelError
from crar_drake.robot.description import LIMIT_TOLERANCE, find_body
from crar_drake.robot.model import ControlModel
from crar_drake.robot.moving_pelvis import SLIDES, WholeCommand
from crar_drake.robot.standing import standing_description
from crar_drake.robot.task import position_tasks

BOX = {"x": (-0.04, 0.04), "y": (-0.03, 0.03), "z": (-0.06, 0.005)}


class Both:
    """The robot as the law sees it, and Drake's own of it with a root that floats."""

    def __init__(self, folder) -> None:
        self.whole = standing_robot(folder)
        self.standing = standing_description(self.whole, BOX)
        self.pelvis = self.standing.pelvis
        tasks = position_tasks(["hand"])
        self.law = ControlModel.FromDescription(self.standing, tasks, time_step=0.0)
        self.floating = ControlModel.FromDescription(
            self.whole.without_ground(), tasks, time_step=0.0
        )
        self.names = list(self.law.position_names)
        self.command = WholeCommand(self.pelvis, self.names)

    def random(self, rng) -> np.ndarray:
        """(nq,) a configuration of the law's, also on the box's faces and corners."""
        q = self.law.rest_positions()
        q[[self.names.index("shoulder"), self.names.index("elbow")]] = rng.normal(
            size=2
        )
        s = np.clip(1.4 * rng.uniform(-1.0, 1.0, 3), -1.0, 1.0)
        slides = [self.names.index(name) for name in SLIDES]
        q[slides] = self.pelvis.middle + self.pelvis.half * s
        return q

    def followed(self, q: np.ndarray) -> np.ndarray:
        """(nq,) of the robot that floats."""
        zero = np.zeros_like(q)
        joints, base = self.command(q, zero, zero)
        found, names = self.floating.rest_positions(), self.floating.position_names
        found[self.floating.root_positions[4:]] += base[0]
        for name, value in zip(self.names, joints[0], strict=True):
            if name not in SLIDES:
                found[list(names).index(name)] = value
        return found


@pytest.fixture(scope="module")
def both(tmp_path_factory) -> Both:
    return Both(tmp_path_factory.mktemp("robot"))


def corners(both: Both, q: np.ndarray) -> np.ndarray:
    """(C, 3) of all soles in the world, by Drake."""
    plant = both.floating.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    return np.hstack(
        [
            plant.EvalBodyPoseInWorld(context, find_body(plant, link))
            @ np.array(sole, dtype=float).T
            for link, sole in both.whole.soles.items()
        ]
    ).T


def test_soles_stand_wherever_the_pelvis_is(both) -> None:
    rng, at_rest = np.random.default_rng(0), both.floating.rest_positions()
    stand, most = corners(both, at_rest), 0.0
    for _ in range(200):
        off = corners(both, both.followed(both.random(rng))) - stand
        most = max(most, np.linalg.norm(off, axis=1).max())
    assert most <= both.pelvis.sole_error < 5e-4
    assert most > 0.02 * both.pelvis.sole_error  # the bound is no idle one


def test_legs_are_within_their_limits_of_place_and_speed(both) -> None:
    rng, model, pelvis = np.random.default_rng(1), both.floating, both.pelvis
    at = [list(model.position_names).index(name) for name in pelvis.joints]
    of = [list(model.velocity_names).index(name) for name in pelvis.joints]
    lower = model.plant.GetPositionLowerLimits()[at]
    upper = model.plant.GetPositionUpperLimits()[at]
    for _ in range(100):
        q = both.random(rng)
        p = q[[both.names.index(name) for name in SLIDES]]
        v = pelvis.speed * rng.choice([-1.0, 1.0], 3)
        theta, rate, _ = pelvis.motion(p, v, np.zeros(3))
        assert (theta > lower - LIMIT_TOLERANCE).all()
        assert (theta < upper + LIMIT_TOLERANCE).all()
        assert (np.abs(rate) <= model.velocity_limits[of]).all()


def test_rates_are_those_of_the_positions(both) -> None:
    p, v, a = np.array([[0.01, -0.02, -0.03], [0.2, 0.1, -0.15], [1.0, -2.0, 3.0]])
    h = 1e-4
    t = h * np.arange(-2, 3)[:, np.newaxis]
    x = both.pelvis.positions(p + t * v + 0.5 * t * t * a)
    found = both.pelvis.motion(p, v, a)
    np.testing.assert_allclose(found[0], x[2], atol=1e-12)
    first = (x[0] - 8.0 * x[1] + 8.0 * x[3] - x[4]) / (12.0 * h)
    second = (-x[0] + 16.0 * x[1] - 30.0 * x[2] + 16.0 * x[3] - x[4]) / (12.0 * h * h)
    np.testing.assert_allclose(found[1], first, atol=1e-8)
    np.testing.assert_allclose(found[2], second, atol=1e-5)


def test_no_derivative_along_a_motion_is_above_its_bound(both) -> None:
    """Motions of constant acceleration make a polynomial of degree 12 at most."""
    rng, pelvis = np.random.default_rng(2), both.pelvis
    legs = pelvis.legs(np.arange(3), np.arange(3), *np.zeros((2, 0), dtype=int))
    t = np.cos(np.pi * (np.arange(20) + 0.5) / 20)
    for _ in range(20):
        s, end = rng.uniform(-0.7, 0.7, (2, 3))
        a = 0.1 * rng.uniform(-1.0, 1.0, 3) * pelvis.half
        p, v = pelvis.middle + pelvis.half * s, 0.3 * pelvis.half * (end - s)
        x = pelvis.positions(p + t[:, None] * v + 0.5 * t[:, None] ** 2 * a)
        bounds = leg_bounds(np.abs(v) + np.abs(a), np.abs(a), legs)
        for j, values in enumerate(x.T):
            polynomial = Polynomial.fit(t, values, 12)
            for k in range(4):
                derivative = polynomial.deriv(k + 1)(np.linspace(-1.0, 1.0, 50))
                assert np.abs(derivative).max() <= bounds[j, k] + 1e-8


def test_pairs_of_legs_and_base_are_apart_and_left_out(both) -> None:
    left_out = [["left_shin", "right_shin"], ["trunk", "left_shin"]]
    assert not [pair for pair in left_out if pair in both.standing.pairs]
    rng, model = np.random.default_rng(3), both.floating
    workspace = model.MakeWorkspace()
    places = [i for i, pair in enumerate(model.pairs.names) if list(pair) in left_out]
    assert len(places) == 2
    for _ in range(100):
        q = both.followed(both.random(rng))
        d = model.evaluate_distances(workspace, q).d
        assert d[places].min() >= 0.008


def test_true_legs_are_inside_those_that_the_law_sees(both) -> None:
    rng, law, floating = np.random.default_rng(4), both.law, both.floating
    spaces = law.MakeWorkspace(), floating.MakeWorkspace()
    theirs = [list(floating.pairs.names).index(pair) for pair in law.pairs.names]
    assert ("forearm", "left_thigh") in law.pairs.names
    slack = []
    for _ in range(200):
        q = both.random(rng)
        seen = law.evaluate_distances(spaces[0], q).d
        true = floating.evaluate_distances(spaces[1], both.followed(q)).d[theirs]
        assert (seen <= true + 1e-9).all()
        slack.append(
            (true - seen)[list(law.pairs.names).index(("forearm", "left_thigh"))]
        )
    assert min(slack) < 0.5 * max(slack)


def changed(robot, folder, old: str, new: str):
    """The robot with something else in its file."""
    folder.mkdir()
    standing_robot(folder)
    text = (folder / "stander.urdf").read_text()
    assert old in text
    (folder / "stander.urdf").write_text(text.replace(old, new))
    return replace(robot, folder=str(folder))


def test_what_cannot_move_is_told(tmp_path, both) -> None:
    whole = both.whole
    with pytest.raises(ModelError, match="cannot follow to"):
        standing_description(whole, BOX | {"z": (-0.06, 0.2)})
    narrow = changed(whole, tmp_path / "narrow", 'upper="2"', 'upper="0.7"')
    with pytest.raises(ModelError, match="knee would be from .* limits are -2.00 and"):
        standing_description(narrow, BOX)
    wide = changed(whole, tmp_path / "wide", 'radius="0.05"', 'radius="0.118"')
    with pytest.raises(ModelError, match="left_shin and right_shin come within 4 mm"):
        standing_description(wide, BOX)
    soles = {"left_ankle": whole.soles["left_foot"]}
    soles["right_foot"] = whole.soles["right_foot"]
    with pytest.raises(ModelError, match="left_ankle has 5 joints; it needs six"):
        standing_description(replace(whole, soles=soles), BOX)


def test_boxes_of_the_base_are_examined_and_those_of_legs_refused(tmp_path, both):
    """A shin's ball is 48 cm below the trunk's origin where the knees are bent most."""
    ball, of_trunk = '<geometry><sphere radius="0.05"/>', '<origin xyz="0 0 0.2"/>'
    box = '<geometry><box size="0.1 {} {}"/>'
    for name, height in (("above", 1.28), ("beside", 1.4)):
        robot = changed(
            both.whole,
            tmp_path / name,
            of_trunk + ball,
            of_trunk + box.format(0.3, height),
        )
        if name == "above":
            assert standing_description(robot, BOX).pelvis.sole_error < 5e-4
            continue
        with pytest.raises(ModelError, match="trunk and left_shin come within"):
            standing_description(robot, BOX)
    of_leg = '<origin xyz="0 0 -0.2"/>'
    square = changed(
        both.whole, tmp_path / "square", of_leg + ball, of_leg + box.format(0.1, 0.1)
    )
    with pytest.raises(ModelError, match="left_thigh: a box or a mesh cannot be made"):
        standing_description(square, BOX)
