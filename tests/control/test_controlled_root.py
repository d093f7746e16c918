"""The control law of a robot whose root floats, and moves as the tasks need it."""

import numpy as np
import pytest
from floating_robots import (
    TASKS,
    description,
    make_floater,
    on_six_joints,
    random_state,
    root_entries,
    stay_apart,
    write_floater,
)
from floating_runs import (
    FLOOR,
    HORIZON,
    PERIOD,
    by_drake,
    check_log,
    first_accelerations,
    hands_scenario,
    nearest_in_braking,
)
from scipy.spatial.transform import Rotation

from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import CrarParameters
from crar_drake.errors import ModelError
from crar_drake.judging.referee import Referee
from crar_drake.results.certificate import Moves
from crar_drake.results.log import SimulationLog
from crar_drake.robot.description import RootPose
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.run import run_scenario
from crar_drake.targets.start_pose import solve_start_pose


@pytest.fixture(scope="module")
def flying() -> ControlModel:
    return make_floater("controlled")


@pytest.mark.parametrize("constraints", ["none", "paper", "lookahead"])
def test_it_is_moved_as_six_joints_would_be(constraints: str) -> None:
    """From rest and not turned, the tasks ask for the same accelerations."""
    pairs = description().pairs[:-1]
    free = make_floater("controlled", pairs=pairs, root_pose=RootPose())
    gains = CrarParameters(period=PERIOD, constraints=constraints, blend_time=0.0)
    found = first_accelerations(free, on_six_joints(), gains, stay_apart(free))
    assert np.abs(found[0][-6:]).max() > 0.01, "the root is not asked for anything"
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6, atol=1e-8)


def test_a_step_ends_where_it_says_at_any_attitude(flying) -> None:
    """`position_command` is where Drake's plant goes, the quaternion a unit one; the
    force on the root, with the motors, is what the accelerations take."""
    law = ControlLaw(flying, CrarParameters(period=PERIOD))
    moves, by = Moves(flying.plant), root_entries(flying)[1]
    for seed in range(3):
        law.reset()
        q, v = random_state(flying, seed)
        goal = flying.tasks_at(q)
        goal[:6] += 0.1
        solution = law.step(q, v, goal)
        there = np.concatenate(by_drake(moves, flying, q, v, solution.acceleration))
        np.testing.assert_allclose(solution.position_command, there, atol=1e-9)
        assert np.abs(solution.root_force[by]).max() > 1.0
        assert np.count_nonzero(solution.root_force) <= 6


def fly(model: ControlModel, targets, steps: int):
    """The law's own predictions as the plant: states and solutions."""
    law = ControlLaw(model, CrarParameters(period=PERIOD, blend_time=0.0))
    q, v, found = stay_apart(model), np.zeros(len(model.order)), []
    for k in range(steps):
        p, p_dot = targets(k * PERIOD)
        nothing = np.zeros((0, 3, 3))
        tasks = model.layout.pack(nothing, p, p_dot.ravel(), np.zeros(p.size))
        solution = law.step(q, v, tasks)
        found.append((q, v, solution))
        q, v = np.split(solution.position_command, [len(q)])
    return found


def test_it_follows_where_arms_do_not_reach_and_through_every_attitude() -> None:
    """Both hands are carried a metre off, and once over about the robot's y axis."""
    model = make_floater("controlled", pairs=description().pairs[:-1])
    start = model.layout.unpack(model.tasks_at(stay_apart(model))).p
    middle, duration = start.mean(axis=0), 3.0
    # About an axis across the line of both hands: the body has to turn over.
    axis = np.cross(start[0] - start[1], [0.0, 0.0, 1.0])
    omega = 2.0 * np.pi / duration * axis / np.linalg.norm(axis)
    drift = np.array([1.0, 0.5, -0.4]) / duration

    def targets(time):
        arm = Rotation.from_rotvec(time * omega).apply(start - middle)
        return middle + drift * time + arm, drift + np.cross(omega, arm)

    found = fly(model, targets, round(duration / PERIOD))
    errors = np.array([s.task_error for *_, s in found])
    assert np.abs(errors[60:]).max() < 0.01
    at = root_entries(model)[0]
    R = Rotation.from_quat([q[at[[1, 2, 3, 0]]] for q, *_ in found])
    turned = (R * R[0].inv()).magnitude()
    assert turned.max() > 3.0, "it never was upside down"
    assert np.linalg.norm(found[-1][0][at[4:]] - found[0][0][at[4:]]) > 0.7
    quaternions = np.array([q[at[:4]] for q, *_ in found[1:]])
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0)


@pytest.mark.parametrize("kind", ["position", "orientation"])
def test_a_heavy_task_prescribes_a_part_of_its_pose(kind: str) -> None:
    """The base goes, or turns, as it is told, and the hands get what is left."""
    base = Task(frame="body", kind=kind, position_weight=100.0, orientation_weight=100)
    pairs = description().pairs[:-1]
    model = make_floater("controlled", tasks=[*TASKS, base], pairs=pairs)
    law = ControlLaw(model, CrarParameters(period=PERIOD, blend_time=0.0))
    q, v = stay_apart(model), np.zeros(len(model.order))
    start = model.layout.unpack(model.tasks_at(q))
    # The hands are drawn one way, the base is told to go the other, or to turn.
    way = np.array([[0.5, 0.4, -0.3], [0.5, 0.4, -0.3], [-0.3, 0.1, 0.2]])
    axis, by = np.array([0.5, 1.0, -0.7]), root_entries(model)[0]
    way = way[: len(start.p)]
    errors, hands, moved = [], [], []
    for k in range(400):
        s, s1, s2 = (
            0.5 - 0.5 * np.cos(3.0 * k * PERIOD),
            1.5 * np.sin(3.0 * k * PERIOD),
            4.5 * np.cos(3.0 * k * PERIOD),
        )
        turn = Rotation.from_rotvec(s * axis)
        rates = way.ravel() if kind == "position" else np.append(way.ravel(), axis)
        R = np.array([turn.as_matrix() @ R for R in start.R]).reshape(-1, 3, 3)
        tasks = model.layout.pack(R, start.p + s * way, s1 * rates, s2 * rates)
        solution = law.step(q, v, tasks)
        hands.append(np.abs(solution.task_error[:6]).max())
        at, R_WB = q[by[4:]], Rotation.from_quat(q[by[[1, 2, 3, 0]]])
        if kind == "position":
            errors.append(np.linalg.norm(at - start.p[2] - s * way[2]))
        else:
            told = turn * Rotation.from_matrix(start.R[0])
            errors.append((R_WB * told.inv()).magnitude())
        moved.append(s)
        q, v = np.split(solution.position_command, [len(q)])
    assert max(moved) > 0.99
    assert max(errors) < 2e-4  # [m], [rad]
    if kind == "position":
        assert max(hands) > 0.5, "nothing drew at the base"


def swing(model: ControlModel):
    """Targets of hands that swing through each other and through the post."""
    start = model.layout.unpack(model.tasks_at(stay_apart(model))).p
    into = 1.5 * (np.array([0.6, 0.5, 0.2]) - start)

    def targets(time):
        share = 0.5 - 0.5 * np.cos(9.0 * time)
        return start + share * into, 4.5 * np.sin(9.0 * time) * into

    return targets


def test_what_is_claimed_is_true(flying) -> None:
    """Hands that swing through each other and through a post, which the whole robot is
    drawn into: the referee finds no braking path nearer than the certificate says."""
    found = fly(flying, swing(flying), 200)
    pairs = flying.description.pairs
    own, every = (
        Referee(flying.plant, flying.scene_graph, some) for some in (pairs[:-1], pairs)
    )
    moves, nearest = Moves(flying.plant), np.inf
    assert max(s.admission[0] for *_, s in found) > 0.0, "nothing was corrected"
    for k in range(0, len(found) - 1, 4):
        (*_, solution), (q, v, _) = found[k], found[k + 1]
        assert solution.admission[3] == 1.0
        # Against the world to the third order in a period, see docs/theory/theorem.md.
        for judge, slack in ((own, 1e-6), (every, 1e-4)):
            smallest = nearest_in_braking(judge, moves, q, v)
            assert smallest >= FLOOR - slack
        nearest = min(nearest, smallest)
    assert nearest < 0.01, "nothing came near"


def test_weak_motors_are_not_asked_for_more(flying) -> None:
    """The root has no motor and no limit; the joints' motors keep theirs, and what they
    cannot do the robot does not."""
    weak = make_floater("controlled")
    weak.actuator_limits[:] = 15.0  # [Nm]; at rest the arms take up to 9
    strong, limited = (fly(model, swing(flying), 100) for model in (flying, weak))
    torque = [
        np.abs([s.actuation for *_, s in found]).max() for found in (strong, limited)
    ]
    assert torque[0] > 45.0 and torque[1] <= 15.0
    limits = np.array([s.torque_limit for *_, s in limited])
    assert (limits[:, 0] < 1.0).sum() > 50 and limits[:, 1].max() < 1e-9
    referee = Referee(weak.plant, weak.scene_graph, weak.description.pairs)
    workspace, moves = weak.MakeWorkspace(), Moves(weak.plant)
    for (q, v, solution), (q_next, v_next, _) in zip(
        limited[::10], limited[1::10], strict=False
    ):
        assert solution.admission[3] == 1.0
        weak.evaluate(workspace, q, v)
        at = (workspace, solution.acceleration)
        np.testing.assert_allclose(
            weak.inverse_dynamics(*at), solution.actuation, atol=1e-9
        )
        np.testing.assert_allclose(weak.root_force(*at), solution.root_force, atol=1e-9)
        nearest = nearest_in_braking(referee, moves, q_next, v_next)
        assert nearest >= FLOOR - 1e-4


def test_lost_targets_make_it_brake(flying) -> None:
    law = ControlLaw(flying, CrarParameters(period=PERIOD))
    q, v = stay_apart(flying), np.ones(len(flying.order))
    solution = law.step(q, v, flying.tasks_at(q) + np.nan)
    np.testing.assert_allclose(solution.acceleration, -v / HORIZON)


def test_nothing_draws_it_anywhere(flying) -> None:
    """Without an error it stays: the rest posture has no say about the root."""
    q, still = stay_apart(flying), np.zeros(len(flying.order))
    q[root_entries(flying)[0][4:]] += [0.8, -3.0, 2.0]
    gains = CrarParameters(period=PERIOD, blend_time=0.0, nominal_posture_gain=9.0)
    law = ControlLaw(flying, gains)
    q[flying.controlled_positions[:6]] = 0.0  # the arms' rest posture
    solution = law.step(q, still, flying.tasks_at(q))
    np.testing.assert_allclose(solution.acceleration, 0.0, atol=1e-8)


def test_a_start_is_found_beyond_the_arms_reach(flying) -> None:
    goal = flying.tasks_at(stay_apart(flying))
    goal[:6] += [-1.0, 0.2, 0.6, -1.0, 0.2, 0.6]
    q = solve_start_pose(flying, goal, np.zeros(0))
    p = flying.layout.unpack(flying.tasks_at(q)).p
    np.testing.assert_allclose(p.ravel(), goal[:6], atol=0.01)


def test_names_and_sizes(flying) -> None:
    assert flying.n == 12 and flying.num_joints == 6 and flying.n_p == 0
    assert flying.prescribed_size == 0
    assert flying.joint_names[6:] == [
        f"body.{v}" for v in ("wx", "wy", "wz", "vx", "vy", "vz")
    ]
    assert len(flying.lower) == 12 and np.isinf(flying.lower[6:]).all()
    with pytest.raises(ModelError, match="'body.vx' is no controlled joint"):
        make_floater("controlled", tasks=[Task(kind="joint", joint="body.vx")])
    with pytest.raises(ModelError, match="left_j0: the root floats, and goes where"):
        make_floater("controlled", prescribed_joints={"left_j0": "waist.x"})


def test_a_run_is_simulated_logged_and_judged(flying, tmp_path) -> None:
    """In closed loop, with Drake's plant: what pushes the root is connected."""
    write_floater(tmp_path, "controlled", "[0.3, -0.5, 0.8]")
    hands = flying.layout.unpack(flying.tasks_at(stay_apart(flying))).p
    then = hands + [0.5, 0.2, 0.3]
    scenario = hands_scenario(tmp_path, hands, then)
    result = run_scenario(scenario, tmp_path / "out", record=False)
    log = SimulationLog.load(result.files[0])
    assert log.controlled_names.tolist() == flying.joint_names[:6]
    np.testing.assert_allclose(np.linalg.norm(log.q[:, :4], axis=1), 1.0, atol=1e-12)
    assert np.linalg.norm(log.q[-1, 4:7] - log.q[0, 4:7]) > 0.3
    assert np.abs(log.task_error[-1]).max() < 0.02
    check_log(result, log, tmp_path)
