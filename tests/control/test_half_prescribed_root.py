"""The control law of a robot of whose root only the position, or only the orientation,
is prescribed; the tasks move the rest."""

import numpy as np
import pytest
from floating_robots import (
    SLIDES,
    TASKS,
    TURNS,
    description,
    make_floater,
    on_six_joints,
    random_state,
    root_entries,
    stay_apart,
    write_floater,
    wxyz,
)
from floating_runs import (
    FLOOR,
    HORIZON,
    PERIOD,
    SLOW,
    STEP,
    by_drake,
    check_log,
    first_accelerations,
    hands_scenario,
    nearest_in_braking,
)
from scipy.spatial.transform import Rotation

from crar_drake.control.law import ControlLaw
from crar_drake.control.lookahead_parameters import LookaheadParameters
from crar_drake.control.parameters import CrarParameters
from crar_drake.control.records import STATUS_BRAKING
from crar_drake.equations.admission import AS_NOMINAL, SCALED
from crar_drake.equations.kinematics import Measured, evaluate_state
from crar_drake.equations.lookahead_guard import admit
from crar_drake.equations.lookahead_rows import Constraints
from crar_drake.judging.referee import Referee
from crar_drake.results.certificate import Moves
from crar_drake.results.log import SimulationLog
from crar_drake.robot.description import ROOTS, RootPose
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.run import run_scenario
from crar_drake.targets.start_pose import solve_start_pose

POSITION, ORIENTATION = HALVES = ("prescribed_position", "prescribed_orientation")
# Of the root's seven positions and its six velocities, which are prescribed.
GIVEN = {
    POSITION: (slice(4, 7), slice(3, 6)),
    ORIENTATION: (slice(0, 4), slice(0, 3)),
}
OWN = description().pairs[:-1]  # without the post's


def given(model: ControlModel, q, v, a) -> np.ndarray:
    """`desired_prescribed` out of a root's seven positions and six rates."""
    positions, rates = GIVEN[model.description.root]
    return np.concatenate([q[positions], v[rates], a[rates]])


@pytest.mark.parametrize("root", HALVES)
def test_names_and_places(root: str) -> None:
    """Of each half three velocities; held joints come before those prescribed."""
    model = make_floater(root, prescribed_joints={"left_j1": "hold"})
    turns = ["body.wx", "body.wy", "body.wz"]
    slides = ["body.vx", "body.vy", "body.vz"]
    own, told = (turns, slides) if root == POSITION else (slides, turns)
    assert model.prescribed_names == ["left_j1", *told]
    assert model.joint_names[5:] == own and model.n == 8 and model.num_joints == 5
    at, by = root_entries(model)
    assert model.prescribed_size == (12 if root == POSITION else 13)
    # The plant's order and back, and a displacement of what is controlled alone.
    q, v = random_state(model, 3)
    np.testing.assert_array_equal(model.in_plant(*model.in_order(q, v))[0], q)
    np.testing.assert_array_equal(model.in_plant(*model.in_order(q, v))[1], v)
    x = np.zeros(len(v))
    x[model.controlled] = 0.1 * np.arange(1.0, 9.0)
    expected = Moves(model.plant).along(q, x)
    expected[at[:4]] *= np.linalg.norm(q[at[:4]]) if root == ORIENTATION else 1.0
    moved = model.moved(q, x[model.controlled])
    if root == ORIENTATION:
        np.testing.assert_array_equal(moved[at[:4]], q[at[:4]])
    np.testing.assert_allclose(moved, expected, atol=1e-14)
    law = ControlLaw(model, CrarParameters(velocity_limits={"body": 0.7}))
    np.testing.assert_array_equal(law.speed_limits[model.controlled[5:]], 0.7)
    np.testing.assert_array_equal(law.speed_limits[model.prescribed], np.inf)


@pytest.mark.parametrize("constraints", ["none", "paper", "lookahead"])
@pytest.mark.parametrize("root", HALVES)
def test_it_is_moved_as_six_joints_would_be(root: str, constraints: str) -> None:
    """Three of them prescribed, and told to accelerate: from rest and not turned, the
    tasks ask the others and the arms for the same."""
    half = make_floater(root, pairs=OWN, root_pose=RootPose())
    jointed = on_six_joints(SLIDES if root == POSITION else TURNS)
    gains = CrarParameters(period=PERIOD, constraints=constraints, blend_time=0.0)
    q, told = stay_apart(half), [0.7, -0.5, 0.9]
    found = first_accelerations(half, jointed, gains, q, told)
    own = slice(-3, None) if root == POSITION else slice(-6, -3)
    assert np.abs(found[0][own]).min() > 1e-3, "the root is not asked for anything"
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("root", HALVES)
def test_a_step_ends_where_it_says_at_any_attitude(root: str) -> None:
    """`position_command` is where Drake's plant goes, the quaternion a unit one; and
    all six of the root's forces are told, whoever decided what they are to do."""
    model = make_floater(root)
    law = ControlLaw(model, CrarParameters(period=PERIOD))
    moves, by = Moves(model.plant), root_entries(model)[1]
    for seed in range(3):
        law.reset()
        q, v = random_state(model, seed)
        goal = model.tasks_at(q)
        goal[:6] += 0.1
        told = np.random.default_rng(seed).normal(size=model.prescribed_size)
        solution = law.step(q, v, goal, told)
        there = np.concatenate(by_drake(moves, model, q, v, solution.acceleration))
        np.testing.assert_allclose(solution.position_command, there, atol=1e-9)
        assert (np.abs(solution.root_force[by]) > 1e-3).all()
        assert np.count_nonzero(solution.root_force) == 6


def ways(model: ControlModel, steps: int):
    """The root's way by Drake's own steps, (q (7,), v, a (6,)) at each control step:
    turns about every axis, and swings."""
    moves, (at, by) = Moves(model.plant), root_entries(model)
    q, v = stay_apart(model), np.zeros(len(model.order))
    found = []
    for k in range(steps):
        t, vdot = k * PERIOD, np.zeros(len(v))
        vdot[by[:3]] = [3.0 * np.cos(2.0 * t), -4.0 * np.cos(1.7 * t), 2.0 * np.cos(t)]
        vdot[by[3:]] = [np.cos(2.0 * t), -0.8 * np.cos(1.5 * t), 0.7 * np.cos(2.5 * t)]
        found.append((q[at], v[by], vdot[by]))
        q, v = by_drake(moves, model, q, v, vdot)
    return found


@pytest.mark.parametrize("beyond", [0.0, 0.7])
@pytest.mark.parametrize("root", HALVES)
def test_one_half_goes_as_it_is_told_and_the_other_where_tasks_are(
    root: str, beyond: float
) -> None:
    """What is prescribed is followed to rounding, by Drake's steps, whatever draws at
    the root; what is not is where its task is, if the others are not out of reach."""
    kind = "orientation" if root == POSITION else "position"
    model = make_floater(root, tasks=[*TASKS, Task(frame="body", kind=kind)], pairs=OWN)
    feedback = LookaheadParameters(preview=0.0)  # a far hand draws at the root
    law = ControlLaw(
        model, CrarParameters(period=PERIOD, blend_time=0.0, lookahead=feedback)
    )
    moves, at = Moves(model.plant), root_entries(model)[0]
    q, v = stay_apart(model), np.zeros(len(model.order))
    start = model.layout.unpack(model.tasks_at(q))
    hands_B = (
        Rotation.from_quat(q[at[[1, 2, 3, 0]]]).inv().apply(start.p[:2] - q[at[4:]])
    )
    told, reached, turned = [], [], []
    for x, x1, x2 in ways(model, 400):
        R, omega, alpha = Rotation.from_quat(x[[1, 2, 3, 0]]), x1[:3], x2[:3]
        arm = R.apply(hands_B + [beyond, 0.0, 0.0])
        p = x[4:] + arm
        p1 = x1[3:] + np.cross(omega, arm)
        p2 = x2[3:] + np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
        if kind == "orientation":
            R_d, rates = R.as_matrix()[None], [(omega, alpha)]
        else:
            R_d, rates, p = np.zeros((0, 3, 3)), [], np.vstack([p, x[4:]])
            p1, p2 = np.vstack([p1, x1[3:]]), np.vstack([p2, x2[3:]])
        # Rows in the order of the tasks: two hands, then the base.
        v_d = np.concatenate([p1.ravel(), *(w for w, _ in rates)])
        a_d = np.concatenate([p2.ravel(), *(w for _, w in rates)])
        solution = law.step(
            q, v, model.layout.pack(R_d, p, v_d, a_d), given(model, x, x1, x2)
        )
        assert solution.admission[0] < SCALED
        gap = (Rotation.from_quat(q[at[[1, 2, 3, 0]]]) * R.inv()).magnitude()
        far = np.linalg.norm(q[at[4:]] - x[4:])
        told.append(far if root == POSITION else gap)
        reached.append(gap if root == POSITION else far)
        turned.append(R.magnitude())
        assert np.linalg.norm(q[at[:4]]) == pytest.approx(1.0, abs=1e-12)
        q, v = by_drake(moves, model, q, v, solution.acceleration)
    assert max(turned) > 2.0
    assert max(told) < 1e-9  # [m] or [rad]
    if beyond:
        assert max(reached) > 0.05, "nothing drew at the root"
    else:
        assert max(reached) < 5e-3  # [rad] or [m]


def swing(model: ControlModel):
    """Targets of hands that swing through each other and through the post, while the
    root is told to swing into the post's way, and to turn."""
    hands = model.layout.unpack(model.tasks_at(stay_apart(model))).p
    into = 1.5 * (np.array([0.6, 0.5, 0.2]) - hands)
    q = stay_apart(model)[root_entries(model)[0]]
    rest, axis = Rotation.from_quat(q[[1, 2, 3, 0]]), np.array([0.5, -0.3, 1.2])
    to = np.array([0.5, 0.7, -0.1])

    def targets(time):
        s = 0.5 - 0.5 * np.cos(9.0 * time)
        s1, s2 = 4.5 * np.sin(9.0 * time), 40.5 * np.cos(9.0 * time)
        tasks = model.layout.pack(
            np.zeros((0, 3, 3)), hands + s * into, (s1 * into).ravel(), np.zeros(6)
        )
        x = np.append(wxyz(Rotation.from_rotvec(s * axis) * rest), q[4:] + s * to)
        rates = np.append(axis, to)
        return tasks, (x, s1 * rates, s2 * rates)

    return targets


@pytest.mark.parametrize("root", HALVES)
def test_what_is_claimed_is_true_and_what_is_given_brakes_along(root: str) -> None:
    """The referee finds no braking path nearer than the certificate says; where a step
    is scaled, so is what is prescribed of the root."""
    # A body that is told to go into the post cannot be evaded with.
    pairs = [*description().pairs, ["body", "post"]]
    model = make_floater(root, pairs=pairs)
    lookahead = LookaheadParameters(preview=0.0, nominal_speed_limit=60.0)
    law = ControlLaw(
        model, CrarParameters(period=PERIOD, blend_time=0.0, lookahead=lookahead)
    )
    gains, targets = law.parameters, swing(model)
    every = Referee(model.plant, model.scene_graph, model.description.pairs)
    own = Referee(model.plant, model.scene_graph, OWN)
    moves, (at, by) = Moves(model.plant), root_entries(model)
    q, v = stay_apart(model), np.zeros(len(model.order))
    scaled, nearest = 0, np.inf
    for k in range(480):
        tasks, (x, x1, x2) = targets(k * PERIOD)
        solution = law.step(q, v, tasks, given(model, x, x1, x2))
        how, share, _, held = solution.admission
        assert held == 1.0
        # What was asked of the root: Eq. (14), of a rotation vector.
        turn = Rotation.from_quat(x[[1, 2, 3, 0]]) * (
            Rotation.from_quat(q[at[[1, 2, 3, 0]]]).inv()
        )
        e = np.append(turn.as_rotvec(), x[4:] - q[at[4:]])
        asked = x2 + gains.velocity_gain * (x1 - v[by]) + gains.Kp * e
        s = share * (v[by] + SLOW * asked)
        half = GIVEN[root][1]
        np.testing.assert_allclose(
            solution.acceleration[by][half],
            ((s - v[by]) / SLOW)[half],
            rtol=1e-9,
            atol=1e-8,
        )
        scaled += how == SCALED
        q, v = by_drake(moves, model, q, v, solution.acceleration)
        if how != SCALED and k % 4:
            continue
        # Against the world to the third order in a period, see docs/theory/theorem.md.
        for judge, slack in ((own, 1e-6), (every, 1e-4)):
            smallest = nearest_in_braking(judge, moves, q, v, SLOW)
            assert smallest >= FLOOR - slack
        nearest = min(nearest, smallest)
    assert scaled > 3, "nothing was scaled"
    assert nearest < 0.01, "nothing came near"


def missing(model: ControlModel, v, vdot, period: float, step: float) -> float:
    """What docs/theory/theorem.md says is missing of the floor against the world
    [m]."""
    by, reach = root_entries(model)[1][:3], 0.75  # from the root to the end of an arm
    omega, alpha = v[by], vdot[by]
    speed = max(np.linalg.norm(omega), np.linalg.norm(omega + period * alpha))
    turning = np.linalg.norm(np.cross(omega, alpha))
    return reach * (period**3 * turning + period * step**2 * speed**3) / 12.0


@pytest.mark.parametrize("root", list(ROOTS)[1:])
@pytest.mark.parametrize("period", [5e-3, 0.02])
def test_admission_alone_keeps_states_clear(root: str, period: float) -> None:
    """Whatever velocities, without stage 1 and guard, of every way to share the root:
    next braking paths keep what they are to keep, by samples of the referee, and end
    within the limits of joints."""
    pairs = [*description().pairs, ["body", "post"]]
    model = make_floater(root, pairs=pairs, prescribed_joints={"right_j2": "hold"})
    law = ControlLaw(model, CrarParameters(period=period, blend_time=0.0))
    robot, numbers = law.mode.robot.value, law.mode.numbers.value
    n, T, order = model.n, law.mode.horizon, model.order
    nothing = np.zeros(0)
    none = Constraints(nothing, np.zeros((0, n)), nothing, nothing, nothing)
    moves = Moves(model.plant)
    judges = [
        Referee(model.plant, model.scene_graph, pairs)
        for pairs in (OWN, pairs[len(OWN) :])
    ]

    def nearest(judge, q, v):
        path = moves.along(q, np.outer(np.linspace(0.0, T, 25), v))
        return judge.violations(path).smallest_distance

    joints, positions = model.controlled[: model.num_joints], model.joint_positions
    within = slice(model.num_joints)
    hows, seen = [], np.inf
    for start in range(5):
        rng = np.random.default_rng(start)
        # So fast that the path is just clear, and its end within the limits.
        still = np.zeros(len(order))
        while True:
            q, v = random_state(model, rng.integers(1000))
            at = root_entries(model)[0]
            q[at[4:]] = [0.6, 0.5, 0.2] + 0.4 * q[at[4:]]  # about the post
            q[at[:4]] /= np.linalg.norm(q[at[:4]])
            if min(nearest(judge, q, still) for judge in judges) > 5e-3:
                break
        v *= rng.choice([1.0, 5.0])
        ends = np.abs(q[positions] + T * v[joints]).max()
        while ends > 2.4 or min(nearest(judge, q, v) for judge in judges) < 4.5e-3:
            v *= 0.95
            ends = np.abs(q[positions] + T * v[joints]).max()
        for step in range(10):
            if step % 3 == 0:
                s = rng.normal(size=len(v)) * 10.0 ** rng.uniform(0.5, 2.5)
            both = np.array([q, moves.along(q, T * v)])
            measured = Measured(both, v, np.zeros((0, 7)))
            d = evaluate_state(measured, law.mode.robot).d
            found, s_p, told = admit(
                s[:n],
                s[n:],
                s[:n],
                *model.in_order(q, v),
                d,
                none,
                np.eye(n),
                robot,
                numbers,
            )
            vdot = np.empty(len(v))
            vdot[order] = (np.concatenate([found, s_p]) - v[order]) / T
            before = [nearest(judge, q, v) for judge in judges]
            slack = [1e-9, missing(model, v, vdot, period, STEP) + 1e-9]
            hows.append(told[0])
            for _ in range(round(period / STEP)):
                v = v + STEP * vdot
                q = moves.step(q, v, STEP)
            q[at[:4]] /= np.linalg.norm(q[at[:4]])
            for judge, was, lost in zip(judges, before, slack, strict=True):
                now = nearest(judge, q, v)
                assert now >= min(FLOOR, was) - lost
                seen = min(seen, now)
            ends = q[positions] + T * v[joints]
            assert (ends <= model.upper[within] + 1e-9).all()
            assert (ends >= model.lower[within] - 1e-9).all()
    assert min(hows) == AS_NOMINAL < max(hows)
    assert SCALED in hows or period < 0.02, "nothing was scaled"
    assert seen < 0.01, "nothing came near"


@pytest.mark.parametrize("root", HALVES)
def test_lost_targets_make_it_brake(root: str) -> None:
    model = make_floater(root)
    law = ControlLaw(model, CrarParameters(period=PERIOD))
    q, v = stay_apart(model), np.ones(len(model.order))
    goal, told = model.tasks_at(q), model.prescribed_at(q)
    nowhere = np.concatenate([np.zeros(len(told) - 6), told[-6:]])
    # Zeros are a place, but no orientation.
    for given_, lost in ((told, False), (np.nan * told, True), (nowhere, None)):
        law.reset()
        solution = law.step(q, v, goal, given_)
        if lost is None:
            lost = root == ORIENTATION
        assert (solution.status == STATUS_BRAKING) == lost
        if lost:
            np.testing.assert_allclose(solution.acceleration, -v / HORIZON)


@pytest.mark.parametrize("root", HALVES)
def test_a_start_is_found_with_what_is_given(root: str) -> None:
    """Hands turned about, or moved with, a root that may turn, or move, with them."""
    model = make_floater(root, pairs=OWN)
    q = stay_apart(model)
    at = root_entries(model)[0]
    goal = model.tasks_at(q)
    if root == POSITION:
        told = q[at[4:]] + [1.0, -2.0, 0.5]
        turn = Rotation.from_rotvec([0.6, -0.4, 1.5])
        p = told + turn.apply(goal[:6].reshape(2, 3) - q[at[4:]])
    else:
        turn = Rotation.from_rotvec([0.1, 0.2, -0.3])
        told = wxyz(turn * Rotation.from_quat(q[at[[1, 2, 3, 0]]]))
        p = goal[:6].reshape(2, 3) + [1.0, -2.0, 0.5]
    goal[:6] = p.ravel()
    found = solve_start_pose(model, goal, told)
    np.testing.assert_array_equal(found[at][GIVEN[root][0]], told)
    np.testing.assert_allclose(
        model.layout.unpack(model.tasks_at(found)).p, p, atol=0.01
    )


@pytest.mark.parametrize("constraints", ["lookahead", "paper", "none"])
@pytest.mark.parametrize("root", HALVES)
def test_a_run_is_simulated_logged_and_judged(root, constraints, tmp_path) -> None:
    """In closed loop, with Drake's plant: one half stays where it rests, and hands that
    go where arms alone do not reach move the other."""
    write_floater(tmp_path, root, "[0.3, -0.5, 0.8]")
    model = make_floater(root)
    rest = stay_apart(model)
    at = root_entries(model)[0]
    hands = model.layout.unpack(model.tasks_at(rest)).p
    if root == POSITION:
        turn = Rotation.from_rotvec([0.4, -0.3, 1.2])
        then = rest[at[4:]] + turn.apply(hands - rest[at[4:]])
    else:
        then = hands + [0.5, 0.2, 0.3]
    scenario = hands_scenario(tmp_path, hands, then, constraints)
    result = run_scenario(scenario, tmp_path / "out", record=False)
    log = SimulationLog.load(result.files[0])
    # The log's quaternions are unit ones; the given half stays, the other goes.
    np.testing.assert_allclose(np.linalg.norm(log.q[:, :4], axis=1), 1.0, atol=1e-12)
    R = Rotation.from_quat(log.q[:, [1, 2, 3, 0]])
    turned = (R * R[0].inv()).magnitude()
    moved = np.linalg.norm(log.q[:, 4:7] - log.q[0, 4:7], axis=1)
    stays, goes = (moved, turned) if root == POSITION else (turned, moved)
    assert stays.max() < 1e-9
    assert goes[-1] > 0.3
    assert log.controlled_names.tolist() == model.joint_names[:6]
    assert np.abs(log.task_error[-1]).max() < 0.02
    if constraints == "lookahead":
        check_log(result, log, tmp_path)
