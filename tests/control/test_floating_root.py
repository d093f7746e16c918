"""The control law of a robot whose prescribed root floats, at any attitude."""

import numpy as np
import pytest
from floating_robots import make_floater, root_entries, stay_apart, wxyz
from floating_runs import FLOOR, HORIZON, PERIOD, SLOW, nearest_in_braking
from scipy.spatial.transform import Rotation
from tumbling import Tumbling

from crar_drake.control.law import ControlLaw
from crar_drake.control.lookahead_parameters import LookaheadParameters
from crar_drake.control.parameters import CrarParameters
from crar_drake.control.records import STATUS_BRAKING, InputError
from crar_drake.judging.referee import Referee
from crar_drake.results.certificate import Moves
from crar_drake.robot.model import ControlModel


@pytest.fixture(scope="module")
def floating() -> ControlModel:
    return make_floater()


def tumbling(model: ControlModel, speed: float = 1.0) -> Tumbling:
    return Tumbling(model.description.rest_pose(), speed)


def in_body(model: ControlModel, q: np.ndarray) -> np.ndarray:
    """(2, 3) the hands in the body's frame."""
    p = model.layout.unpack(model.tasks_at(q)).p
    at = q[root_entries(model)[0]]
    R = Rotation.from_quat(at[[1, 2, 3, 0]])
    return R.inv().apply(p - at[4:])


def tumble(model: ControlModel, root: Tumbling, hands, steps: int, **lookahead):
    """The law's own predictions as the plant: states, solutions and targets.

    Args:
        hands: time to (2, 3) targets in the body, which move slowly in it.
        lookahead: of its parameters.
    """
    gains = LookaheadParameters(**lookahead)
    law = ControlLaw(
        model, CrarParameters(period=PERIOD, blend_time=0.0, lookahead=gains)
    )
    q, v = stay_apart(model), np.zeros(len(model.order))
    at, by = root_entries(model)
    start = root.vector(0.0)
    q[at], v[by] = start[:7], start[7:13]
    found = []
    for k in range(steps):
        time = k * PERIOD
        p, p_dot, p_ddot = root.carried(time, hands(time))
        tasks = model.layout.pack(np.zeros((0, 3, 3)), p, p_dot.ravel(), p_ddot.ravel())
        solution = law.step(q, v, tasks, root.vector(time))
        found.append((q, v, solution))
        q, v = np.split(solution.position_command, [len(q)])
    return found


@pytest.mark.parametrize("constraints", ["none", "paper", "lookahead"])
def test_a_root_that_stands_still_is_a_weld(floating, constraints: str) -> None:
    """The same accelerations, distances, certificate and torque as of the robot whose
    base is welded at the same skew pose."""
    welded = make_floater("fixed")
    laws, states, solutions = [], [], []
    for model in (floating, welded):
        laws.append(
            ControlLaw(model, CrarParameters(period=PERIOD, constraints=constraints))
        )
        states.append((stay_apart(model), np.zeros(len(model.order))))
    goal = welded.tasks_at(stay_apart(welded))
    goal[:6] += [0.3, 0.5, -0.2, -0.3, 0.7, 0.1]  # through each other and the post
    for _ in range(40):
        solutions = []
        for i, (model, law) in enumerate(zip((floating, welded), laws, strict=True)):
            q, v = states[i]
            solution = law.step(q, v, goal, model.prescribed_at(q))
            states[i] = np.split(solution.position_command, [len(q)])
            solutions.append(solution)
        free, fixed = solutions
        c = floating.controlled
        np.testing.assert_allclose(free.acceleration[c], fixed.acceleration, atol=1e-9)
        np.testing.assert_allclose(free.acceleration[root_entries(floating)[1]], 0.0)
        np.testing.assert_allclose(free.actuation, fixed.actuation, atol=1e-9)
        for name in ("signed_distances", "task_error", "admission", "resting_margins"):
            np.testing.assert_allclose(
                getattr(free, name), getattr(fixed, name), atol=1e-9, err_msg=name
            )
    if constraints != "none":
        assert (np.abs(fixed.task_error) > 0.05).any(), "nothing was in the way"


def test_nothing_locks_while_the_root_tumbles(floating) -> None:
    """Targets that move with the body are followed as if it stood still."""
    hands = in_body(floating, stay_apart(floating))

    def sway(time):
        return hands + [[0.03 * np.sin(time), 0.0, 0.02], [0.0, 0.0, -0.02]]

    found = tumble(floating, tumbling(floating, 0.6), sway, 400)
    angles = [
        (Rotation.from_quat(q[root_entries(floating)[0][[1, 2, 3, 0]]]).as_matrix())
        for q, _, _ in found
    ]
    # Each axis of the body has pointed up and down: it turned about all of them.
    up = np.array(angles)[:, 2, :]
    assert (up.max(axis=0) > 0.7).all() and (up.min(axis=0) < -0.7).all()
    errors = np.array([s.task_error for _, _, s in found])
    assert np.abs(errors[20:]).max() < 0.03
    for *_, solution in found:
        assert np.linalg.norm(solution.position_command[:4]) == pytest.approx(1.0)


class Turning(Tumbling):
    """The root's pose over time: evenly about an axis of the world, in place."""

    def __init__(self, rest, axis, turns_per_second: float) -> None:
        super().__init__(rest)
        self._omega = 2.0 * np.pi * turns_per_second * np.asarray(axis, dtype=float)

    def pose(self, time):
        R_WB = Rotation.from_matrix(self._rest.rotation().matrix())
        return Rotation.from_rotvec(time * self._omega) * R_WB, self._rest.translation()


@pytest.mark.parametrize("axis", np.eye(3), ids="xyz")
def test_nothing_jumps_over_several_full_turns(floating, axis) -> None:
    """Hands that stay in the body: joints stay, and every step turns the root alike,
    through every attitude and past every sign of its quaternion."""
    turns, steps = 3, 300
    hands = in_body(floating, stay_apart(floating))
    rate = turns / (steps * PERIOD)
    root = Turning(floating.description.rest_pose(), axis, rate)
    found = tumble(floating, root, lambda time: hands, steps + 1)
    at, by = root_entries(floating)
    states = np.array([q for q, _, _ in found])
    w, x, y, z = states[:, at[:4]].T
    R = Rotation.from_quat(np.column_stack([x, y, z, w]))
    by_step = (R[1:] * R[:-1].inv()).as_rotvec()
    whole = 2.0 * np.pi * turns * axis / steps
    np.testing.assert_allclose(by_step, np.tile(whole, (steps, 1)), atol=1e-3)
    np.testing.assert_allclose((R[-1] * R[0].inv()).magnitude(), 0.0, atol=0.01)
    # What is logged goes on as well: no quaternion is followed by its negative.
    assert (np.sum(states[1:, at[:4]] * states[:-1, at[:4]], axis=1) > 0.99).all()
    controlled = states[:, floating.controlled_positions]
    assert np.abs(controlled - controlled[0]).max() < 0.02
    how, share, *_ = np.array([s.admission for *_, s in found]).T
    assert (how == 0).all() and (share == 1.0).all(), "every step as it was wished"
    # The post comes nearer no faster than what is farthest out moves.
    radius = np.linalg.norm(hands, axis=1).max() + 0.1
    distances = np.array([s.signed_distances for *_, s in found])
    most = radius * 2.0 * np.pi * rate * PERIOD
    assert np.abs(np.diff(distances, axis=0)).max() < most


def test_the_root_is_where_it_is_told_to_be(floating) -> None:
    """From a wrong attitude, by the shorter way, while it tumbles: e'' = -Kp e - Kv e'
    of the rotation vector."""
    root = tumbling(floating, 0.3)
    law = ControlLaw(
        floating, CrarParameters(period=PERIOD, constraints="none", blend_time=0.0)
    )
    at, by = root_entries(floating)
    q, v = stay_apart(floating), np.zeros(len(floating.order))
    R, p = root.pose(0.0)
    q[at] = [*wxyz(Rotation.from_rotvec([2.0, 1.0, -1.0]) * R), *(p + 0.1)]
    tasks = floating.tasks_at(q)
    errors = []
    for k in range(240):
        R, p = root.pose(k * PERIOD)
        gap = (R * Rotation.from_quat(q[at[[1, 2, 3, 0]]]).inv()).magnitude()
        errors.append((gap, np.linalg.norm(p - q[at[4:]])))
        solution = law.step(q, v, tasks, root.vector(k * PERIOD))
        q, v = np.split(solution.position_command, [len(q)])
    assert errors[0] == pytest.approx((np.sqrt(6.0), 0.1 * np.sqrt(3.0)))
    assert max(errors[-1]) < 1e-3
    assert max(gap for gap, _ in errors) < 1.02 * errors[0][0]


def test_what_is_claimed_while_the_root_tumbles_is_true(floating) -> None:
    """Hands that are to go through each other, the body and the post: the referee finds
    nothing nearer than the certificate says, on any braking path."""
    hands = in_body(floating, stay_apart(floating))

    def through(time):
        swing = 0.5 - 0.5 * np.cos(9.0 * time)
        return hands + swing * np.array([[-0.1, -0.6, 0.1], [0.1, 0.6, -0.2]])

    # What a plan sees coming needs no correction, nor does a slow wish.
    found = tumble(
        *(floating, tumbling(floating), through, 200),
        **{"preview": 0.0, "nominal_speed_limit": 30.0},
    )
    referee = Referee(floating.plant, floating.scene_graph, floating.description.pairs)
    moves, nearest = Moves(floating.plant), np.inf
    own = Referee(floating.plant, floating.scene_graph, floating.description.pairs[:-1])
    hows = [s.admission[0] for *_, s in found]
    assert max(hows) > 0.0, "nothing had to be corrected"
    for k in range(0, len(found) - 1, 2):
        (*_, solution), (q, v, _) = found[k], found[k + 1]
        assert solution.admission[3] == 1.0
        for judge, floor in ((own, solution.admission[2]), (referee, 0.0)):
            smallest = nearest_in_braking(judge, moves, q, v, SLOW)
            assert smallest >= max(floor, FLOOR) - 1e-6
        nearest = min(nearest, smallest)
        rest = (q[floating.controlled_positions], v[floating.controlled])
        ends = rest[0] + SLOW * rest[1]
        assert (ends <= floating.upper + 1e-9).all()
        assert (ends >= floating.lower - 1e-9).all()
    assert nearest < 0.03, "nothing came near"


def test_position_commands_are_where_the_plant_goes(floating) -> None:
    """Drake's plant, whose rate of the quaternion is its own, over one period."""
    law = ControlLaw(floating, CrarParameters(period=PERIOD))
    root = tumbling(floating)
    q, v = stay_apart(floating), np.zeros(len(floating.order))
    at, by = root_entries(floating)
    start = root.vector(0.4)
    q[at], v[by] = start[:7], start[7:13]
    solution = law.step(q, v, floating.tasks_at(q), start)
    moves = Moves(floating.plant)
    for _ in range(5):
        v = v + 1e-3 * solution.acceleration
        q = moves.step(q, v, 1e-3)
    q[at[:4]] /= np.linalg.norm(q[at[:4]])
    np.testing.assert_allclose(
        solution.position_command, np.concatenate([q, v]), atol=1e-12
    )


def test_lost_targets_make_the_root_brake_along(floating) -> None:
    law = ControlLaw(floating, CrarParameters(period=PERIOD))
    q, v = stay_apart(floating), np.ones(len(floating.order))
    prescribed = tumbling(floating).vector(0.0)
    lost = {
        "nan": prescribed + np.nan,
        "no length": np.concatenate([np.zeros(4), prescribed[4:]]),
    }
    for given in lost.values():
        law.reset()
        solution = law.step(q, v, floating.tasks_at(q), given)
        assert solution.status == STATUS_BRAKING
        np.testing.assert_allclose(solution.acceleration, -v / HORIZON)


def test_quaternions_of_no_length_are_refused(floating) -> None:
    q, v = stay_apart(floating), np.zeros(len(floating.order))
    tasks, still = floating.tasks_at(q), floating.prescribed_at(q)
    nowhere = q.copy()
    nowhere[root_entries(floating)[0][:4]] = 0.0
    law = ControlLaw(floating, CrarParameters())
    law.step(q, v, tasks, still)
    for call in (
        lambda: law.step(nowhere, v, tasks, still),
        lambda: law.torque(nowhere, v),
    ):
        with pytest.raises(InputError, match="quaternion of zero length at t = "):
            call()
    strict = ControlLaw(floating, CrarParameters(constraints="paper"))
    still[:4] = 0.0
    with pytest.raises(InputError, match="prescribed has a quaternion of zero length"):
        strict.step(q, v, tasks, still)
    with pytest.raises(InputError, match=r"prescribed has shape \(18,\).*\(19,\)"):
        strict.step(q, v, tasks, still[1:])


def test_any_length_and_sign_of_a_quaternion_is_the_same(floating) -> None:
    q, v = stay_apart(floating), 0.3 * np.ones(len(floating.order))
    at, _ = root_entries(floating)
    tasks, prescribed = floating.tasks_at(q), tumbling(floating).vector(0.02)
    found = []
    for length in (1.0, -1.0, 7.0):
        scaled, given = q.copy(), prescribed.copy()
        scaled[at[:4]] *= length
        given[:4] *= -length
        law = ControlLaw(floating, CrarParameters())
        found.append(law.step(scaled, v, tasks, given))
    for other in found[1:]:
        for name in ("acceleration", "actuation", "root_force", "admission"):
            np.testing.assert_allclose(
                getattr(other, name), getattr(found[0], name), atol=1e-8
            )
