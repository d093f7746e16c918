"""What the lookahead lets an acceleration be, and makes of one that is given."""

import numpy as np
import pytest
from moving_shapes import MovingShapes
from small_robots import chain_urdf, make_model

from crar_drake.control.law import ControlLaw
from crar_drake.control.lookahead_parameters import LookaheadParameters
from crar_drake.control.parameters import CrarParameters
from crar_drake.equations.admission import AS_NOMINAL, SCALED
from crar_drake.equations.kinematics import Measured
from crar_drake.equations.lookahead_rows import with_resting
from crar_drake.equations.prediction import next_state
from crar_drake.equations.within_efforts import guard_acceleration
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

PERIOD, STEP = 0.02, 1e-3
NOTHING = np.zeros((0, 7))


def on_a_rail(pairs: list[list[str]]) -> ControlModel:
    return make_model(
        chain_urdf("zyz", rail="y", limits=(-1.2, 1.3)),
        [Task(frame="tip")],
        prescribed_joints={"rail": "hold"},
        pairs=pairs,
    )


class OnARail:
    """An arm on a prescribed rail beside a post, and the mode of its law."""

    def __init__(self) -> None:
        self.model = on_a_rail([["l1", "post"], ["l2", "post"]])
        self.mode = ControlLaw(self.model, CrarParameters(period=PERIOD)).mode
        self.T, self.floor = self.mode.horizon, self.mode.admission.floor
        self.shapes = MovingShapes.of(self.model)

    def measured(self, q, v) -> Measured:
        robot = self.mode.robot.value
        return Measured(with_resting(q, v, robot, self.T), v, NOTHING)

    def scaled(self, q, v, vdot) -> tuple[np.ndarray, np.ndarray]:
        """What `scale_acceleration` returns."""
        found, told = self.mode.admit_again(self.measured(q, v), vdot)
        return found, told["admission"]

    def guarded(self, q, v, vdot) -> tuple[np.ndarray, np.ndarray]:
        """What `guard_acceleration` returns."""
        numbers = self.mode.numbers.value
        return guard_acceleration(self.measured(q, v), vdot, self.mode.robot, numbers)

    def next_path(self, q, v, vdot) -> tuple[np.ndarray, np.ndarray]:
        """Where it begins and ends, in the plant's order."""
        q, v = next_state(q, v, vdot, PERIOD, STEP)
        return q, q + self.T * v

    def least(self, start, end, samples: int = 200) -> float:
        order = self.model.order
        return float(self.shapes.on_path(start[order], end[order], samples).min())

    def state(self, rng: np.random.Generator, least: float, most: float):
        """Positions and velocities whose braking path keeps a distance between these,
        and the limits."""
        c = self.model.controlled
        while True:
            q = rng.uniform(-1.0, 1.0, len(self.model.order))
            v = rng.normal(size=len(q))
            end = q + self.T * v
            inside = (end[c] > -1.2).all() and (end[c] < 1.3).all()
            if inside and least < self.least(q, end, 12) < most:
                return q, v


@pytest.fixture(scope="module")
def arm() -> OnARail:
    return OnARail()


@pytest.mark.parametrize("seed", range(5))
def test_at_its_bounds_an_acceleration_leads_to_the_limits(arm, seed) -> None:
    """To them, and no farther, the next braking path ends."""
    rng = np.random.default_rng(seed)
    q, v = arm.state(rng, -1.0, 1.0)
    lowest, highest = arm.mode.acceleration_bounds(arm.measured(q, v))
    c = arm.model.controlled
    for bound, limit in ((lowest, -1.2), (highest, 1.3)):
        vdot = np.zeros(len(q))
        vdot[c] = bound
        np.testing.assert_allclose(arm.next_path(q, v, vdot)[1][c], limit, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_an_acceleration_beyond_limits_is_scaled_to_the_first(arm, seed) -> None:
    """As a whole, towards braking, the prescribed joint with the others."""
    rng = np.random.default_rng(seed)
    q, v = arm.state(rng, 0.4, 2.0)
    vdot = rng.normal(size=len(q))
    same, told = arm.scaled(q, v, vdot)
    np.testing.assert_array_equal(same, vdot)
    assert told[[0, 1, 3]].tolist() == [AS_NOMINAL, 1.0, 1.0]
    assert told[2] <= arm.least(q, q + arm.T * v)
    c, vdot = arm.model.controlled, 40.0 / PERIOD * vdot
    found, told = arm.scaled(q, v, vdot)
    share = told[1]
    assert told[0] == SCALED and 0.0 < share < 1.0 and told[3] == 1.0
    np.testing.assert_allclose(v + arm.T * found, share * (v + arm.T * vdot))
    end = arm.next_path(q, v, found)[1][c]
    room = np.minimum(end + 1.2, 1.3 - end)
    assert room.min() >= -1e-9
    # Unless the post was in the way, at less than the first limit.
    clear = arm.least(*arm.next_path(q, v, 1.05 * found)) > arm.floor
    assert not clear or room.min() < 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_an_acceleration_towards_a_post_is_scaled_till_it_is_clear(arm, seed) -> None:
    rng = np.random.default_rng(seed)
    while True:
        q, v = arm.state(rng, arm.floor + 2e-3, 0.05)
        vdot = 20.0 * rng.normal(size=len(q))
        start, end = arm.next_path(q, v, vdot)
        c = arm.model.controlled
        inside = (end[c] > -1.2).all() and (end[c] < 1.3).all()
        if inside and arm.least(start, end, 12) < arm.floor - 2e-3:
            break
    found, told = arm.scaled(q, v, vdot)
    assert told[0] == SCALED and (64.0 * told[1]) % 1.0 == 0.0 and told[3] == 1.0
    np.testing.assert_allclose(v + arm.T * found, told[1] * (v + arm.T * vdot))
    least = arm.least(*arm.next_path(q, v, found))
    assert arm.floor - 1e-9 <= told[2] <= least + 1e-9
    # Of a share more it would not be.
    more = (told[1] + 1.0 / 64.0) * (v + arm.T * vdot)
    path = arm.next_path(q, v, (more - v) / arm.T)
    assert arm.least(*path) < arm.floor + 2e-3


@pytest.mark.parametrize("seed", range(5))
def test_a_guarded_acceleration_is_changed_where_a_limit_asks_for_it(arm, seed) -> None:
    """One joint heads far beyond its limit: the others go on, and it ends within."""
    rng = np.random.default_rng(seed)
    c = arm.model.controlled
    q, v = arm.state(rng, 0.4, 2.0)
    vdot = -v / arm.T  # which stays where it comes to rest
    joint = c[seed % 3]
    vdot[joint] += 40.0 / PERIOD
    found, told = arm.guarded(q, v, vdot)
    assert arm.next_path(q, v, vdot)[1][joint] > 1.3 + 0.1
    # Unless the post is in the way, which concerns all of them.
    end = arm.next_path(q, v, found)[1]
    assert end[joint] < 1.3 + 1e-9
    assert arm.least(*arm.next_path(q, v, found)) > arm.floor - 1e-9
    assert told[3] == 1.0
    if told[0] == AS_NOMINAL:
        others = np.delete(c, seed % 3)
        np.testing.assert_allclose(found[others], vdot[others], atol=1.0)
        assert found[joint] < vdot[joint]
    calm, _ = arm.guarded(q, v, -v / arm.T)
    np.testing.assert_allclose(calm, -v / arm.T, atol=1e-9)


def test_a_path_that_is_not_clear_is_told(arm) -> None:
    rng = np.random.default_rng(0)
    for least, most, clear in ((-0.1, arm.floor - 1e-3, 0.0), (0.02, 0.1, 1.0)):
        q, v = arm.state(rng, least, most)
        brake = -v / arm.T
        found, told = arm.scaled(q, v, brake)
        assert told[3] == clear
        np.testing.assert_allclose(found, brake, atol=1e-12)


def test_prescribed_joints_are_scaled_with_the_others(arm) -> None:
    """By the share that is told: against a law that watches no pair, and whose
    prescribed joint accelerates as it is asked."""
    parameters = CrarParameters(
        period=PERIOD, blend_time=0.0, respect_effort_limits=False
    )
    rng, scaled = np.random.default_rng(3), 0
    rail = arm.model.prescribed
    for _ in range(80):
        q, v = arm.state(rng, arm.floor + 1e-3, 0.05)
        there = arm.model.layout.unpack(arm.model.tasks_at(q))
        tasks = arm.model.layout.pack(there.R, there.p + 3.0 * rng.normal(size=3))
        prescribed = np.array([q[rail][0] + 0.5 * rng.normal(), *rng.normal(size=2)])
        found, free = (
            ControlLaw(model, parameters).step(q, v, tasks, prescribed)
            for model in (arm.model, on_a_rail([]))
        )
        how, share = found.of_mode["admission"][:2]
        wish = v[rail] + arm.T * free.acceleration[rail]
        s = v[rail] + arm.T * found.acceleration[rail]
        np.testing.assert_allclose(s, share * wish, atol=1e-9)
        scaled += how == SCALED and 0.0 < share
    assert scaled > 2


@pytest.mark.parametrize("gain", [0.0, 20.0])
def test_a_plan_leads_to_the_nominal_posture_if_there_is_a_gain(gain: float) -> None:
    """From rest, with the targets there: nearer to it, and the task stays; or not.

    The posture is a given one, that at rest: by default there is none off the limits.
    """
    model = make_model(chain_urdf("zzzz", extra=""))
    parameters = CrarParameters(
        blend_time=0.0,
        respect_effort_limits=False,
        nominal_posture_gain=gain,
        lookahead=LookaheadParameters(preview=0.3),
    )
    q, still = np.array([0.3, 0.4, -0.5, 0.6]), np.zeros(4)
    law = ControlLaw(model, parameters)
    rest = model.rest_positions()
    a = law.step(q, still, model.tasks_at(q), np.zeros(0), rest).acceleration
    J = model.evaluate(model.MakeWorkspace(), q, still).J
    towards = a @ (rest - q)
    if gain == 0.0:
        np.testing.assert_allclose(a, 0.0, atol=1e-9)
    else:
        assert towards > 1.0 and np.abs(J @ a).max() < 0.01 * np.abs(a).max()
