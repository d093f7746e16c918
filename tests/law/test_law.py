"""The control law by itself: theory, weights, posture, prescribed joints, extremes."""

import re

import numpy as np
import pytest
from pydrake.multibody.tree import MultibodyForces
from scipy.spatial.transform import Rotation
from small_robots import chain_urdf, free_of_constraints, make_model, random_state

from crar_drake.errors import InputError, ModelError, ScenarioError
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.pairs import check_pairs
from crar_drake.law.parameters import (
    LookaheadParameters,
    PaperGains,
    PaperParameters,
)
from crar_drake.law.plan import plan_step
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

LEVELS = ("velocity", "acceleration")
BENT = np.array([0.5, 0.7, -0.9, 0.6])  # a pose of four joints without singularity


@pytest.fixture(scope="module")
def planar() -> ControlModel:
    """Four joints in a plane; the tip's three rows have rank two."""
    return make_model(chain_urdf("zzzz"))


@pytest.fixture(scope="module")
def spatial() -> ControlModel:
    """Five joints in space, tip position: two degrees of redundancy, full rank."""
    return make_model(chain_urdf("zyzyz"))


@pytest.fixture(scope="module")
def on_rail() -> ControlModel:
    """Four joints on a prescribed rail."""
    return make_model(chain_urdf("zyzy", rail="y"), prescribed_joints={"rail": "hold"})


def circle(model: ControlModel, centre, t: float, radius=0.08, rate=2.0) -> np.ndarray:
    """[x_d; v_d; a_d] of one position task on a circle in a tilted plane."""
    u, w = np.array([0.8, 0.0, 0.6]), np.array([0.0, 1.0, 0.0])
    c, s = np.cos(rate * t), np.sin(rate * t)
    return model.layout.pack(
        np.empty((0, 3, 3)),
        [centre + radius * (c * u + s * w)],
        radius * rate * (-s * u + c * w),
        radius * rate**2 * (-c * u - s * w),
    )


def hold(model: ControlModel, p, R=None) -> np.ndarray:
    """Targets at rest."""
    return model.layout.pack(np.empty((0, 3, 3)) if R is None else R, p)


def integrate(law: ControlLaw, q, v, targets, duration: float, prescribed=None):
    """Follows the accelerations, exactly for each period: time, q, v, solutions."""
    T = law.parameters.period
    times, qs, vs, solutions = [], [], [], []
    for k in range(round(duration / T)):
        t = k * T
        p = None if prescribed is None else prescribed(t)
        solution = law.step(q, v, targets(t), p)
        times.append(t)
        qs.append(q)
        vs.append(v)
        solutions.append(solution)
        q = q + T * v + 0.5 * T**2 * solution.acceleration
        v = v + T * solution.acceleration
    return np.array(times), np.array(qs), np.array(vs), solutions


def at(model: ControlModel, q, v=None):
    """The model's state, in a workspace of its own."""
    return model.evaluate(
        model.MakeWorkspace(), q, np.zeros_like(q) if v is None else v
    )


def test_nothing_is_compiled_but_once(planar):
    """Neither for another number of tasks, nor for arguments that are read-only."""
    ControlLaw(planar).compile()
    programs = plan_step, check_pairs
    compiled = [len(program.signatures) for program in programs]
    two = make_model(chain_urdf("zyzyz"), tasks=[Task(frame="tip"), Task(frame="l3")])
    for model in (planar, two):
        q, v = random_state(model, 3)
        targets = model.tasks_at(q)
        for array in (q, v, targets):
            array.flags.writeable = False
        ControlLaw(model).step(q, v, targets)
    assert [len(program.signatures) for program in programs] == compiled
    assert min(compiled) > 0


def inertia_by_inverse_dynamics(model: ControlModel, q: np.ndarray) -> np.ndarray:
    """H, column by column: the torque of a unit acceleration at rest, less gravity."""
    plant = model.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    forces = MultibodyForces(plant)
    columns = np.vstack([np.zeros(len(q)), np.eye(len(q))])
    tau = [plant.CalcInverseDynamics(context, vdot, forces) for vdot in columns]
    H = (np.array(tau[1:]) - tau[0]).T
    return H[np.ix_(model.controlled, model.controlled)]


def test_inertia_metric_has_the_least_kinetic_energy(on_rail):
    """Of all q_dot that do the task (Karush-Kuhn-Tucker), and H is the robot's own."""
    q, v = random_state(on_rail, 5)
    state, H = at(on_rail, q, v), inertia_by_inverse_dynamics(on_rail, q)
    workspace = on_rail.MakeWorkspace()
    on_rail.evaluate(workspace, q, v)
    np.testing.assert_allclose(on_rail.inertia_matrix(workspace), H, atol=1e-12)

    target = circle(on_rail, np.array([0.8, 0.3, 0.2]), 0.4)
    prescribed = np.concatenate([q[on_rail.prescribed], [0.0, 0.0]])
    gains = free_of_constraints(metric="inertia")
    solution = ControlLaw(on_rail, gains).step(q, v, target, prescribed)
    p_d, v_d, _ = target.reshape(3, 3)
    v_r = v_d + gains.K * (p_d - state.p[0]) - state.J_p @ state.qdot_p
    system = np.block([[H, state.J.T], [state.J, np.zeros((3, 3))]])
    least = np.linalg.solve(system, np.concatenate([np.zeros(4), v_r]))[:4]
    np.testing.assert_allclose(solution.constrained_velocity, least, rtol=1e-5)
    plain = ControlLaw(on_rail, free_of_constraints()).step(q, v, target, prescribed)
    qdot = plain.constrained_velocity
    assert least @ H @ least < 0.99 * qdot @ H @ qdot


def residual_of_eq_32(constraints: str, period: float) -> tuple[float, float, float]:
    """Largest residual and largest coupling term [m/s^2], and e(end) / e(0)."""
    limits = (-2.5, 2.5) if constraints == "none" else (-1e4, 1e4)
    model = make_model(chain_urdf("zyzyz", limits=limits))
    gains = free_of_constraints(constraints=constraints, period=period)
    q = np.array([0.4, -0.5, 0.6, 0.8, -0.3])
    centre = at(model, q).p[0]  # so the run starts 8 cm from its target, at rest
    t, qs, vs, solutions = integrate(
        ControlLaw(model, gains),
        q,
        np.zeros(5),
        lambda t: circle(model, centre, t),
        0.25,
    )
    e = np.array([s.task_error for s in solutions])
    e_dot = (e[2:] - e[:-2]) / (2 * period)
    e_ddot = (e[2:] - 2 * e[1:-1] + e[:-2]) / period**2
    largest = coupling = 0.0
    for k in range(1, len(t) - 1, 20):
        J, qdot_c = at(model, qs[k]).J, solutions[k].constrained_velocity
        pulled = J @ (gains.Gv * (qdot_c - vs[k]))
        residual = e_ddot[k - 1] + gains.velocity_gain * e_dot[k - 1] + pulled
        residual += gains.Kp * e[k]
        largest = max(largest, np.abs(residual).max())
        coupling = max(coupling, np.abs(pulled).max())
    return largest, coupling, np.linalg.norm(e[-1]) / np.linalg.norm(e[0])


@pytest.mark.parametrize("constraints", ["none", "paper"])
def test_error_dynamics_of_eq_32(constraints):
    """e_dd + Kv e_d + Kp e = -J Gv (q_dot_c - q_dot), e differenced from positions.

    The held acceleration leaves a residual of half a period: it halves with it.
    """
    coarse, _, _ = residual_of_eq_32(constraints, 2e-4)
    fine, coupling, left = residual_of_eq_32(constraints, 1e-4)
    assert coupling > 10.0  # m/s^2: the right-hand side is not negligible
    assert fine < 6e-3 * coupling
    assert fine == pytest.approx(0.5 * coarse, rel=0.05)
    assert left < 0.1


@pytest.mark.parametrize("level", LEVELS)
def test_targets_are_blended_in_from_the_measured_pose(spatial, level):
    """At the first step the error that is acted on is zero, however far the target."""
    q = np.array([0.4, -0.5, 0.6, 0.8, -0.3])
    far = hold(spatial, [[-0.5, 0.3, 0.6]])
    law = ControlLaw(spatial, PaperParameters(level=level, constraints="none"))
    solution = law.step(q, np.zeros(5), far)
    np.testing.assert_allclose(solution.acceleration, 0.0, atol=1e-12)
    assert solution.status == 1.0
    # The diagnostic error is that against the target as given.
    np.testing.assert_allclose(
        solution.task_error, [-0.5, 0.3, 0.6] - at(spatial, q).p[0], atol=1e-14
    )
    law.reset()
    _, _, _, solutions = integrate(law, q, np.zeros(5), lambda t: far, 0.6)
    assert solutions[499].status == 1.0 and solutions[500].status == 0.0
    size = np.array([np.abs(s.acceleration).max() for s in solutions])
    assert size[:5].max() < 0.1 * size.max()


# One square task: two joints and one position row cannot be had, so three joints in
# space with the tip's three rows stand for m = n.
DIMENSIONS = [
    ("zyzyz", [Task(frame="tip")], "m < n"),
    ("zyy", [Task(frame="tip")], "m = n"),
    ("zyy", [Task(frame="tip", kind="pose")], "m > n"),
    ("zyy", [Task(frame="l2"), Task(frame="tip"), Task(frame="l1")], "m > n"),
]


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("axes, tasks, case", DIMENSIONS)
def test_any_number_of_rows_converges(axes, tasks, case, level):
    """To a target that can be reached; the null-space gain acts only if m < n."""
    model = make_model(chain_urdf(axes), tasks)
    assert {"m < n": model.m < model.n, "m = n": model.m == model.n}.get(
        case, model.m > model.n
    )
    rng = np.random.default_rng(0)
    goal = np.array([0.4, -0.5, 0.8, 0.6, -0.3])[: model.n]
    state = at(model, goal)
    target = model.layout.pack(state.R, state.p)
    gains = free_of_constraints(level=level, damping=0.01, period=2e-3)
    start = goal + rng.uniform(-0.2, 0.2, model.n)
    _, _, _, solutions = integrate(
        ControlLaw(model, gains), start, np.zeros(model.n), lambda t: target, 1.5
    )
    assert np.abs(solutions[0].task_error).max() > 0.01
    assert np.abs(solutions[-1].task_error).max() < 1e-4

    v = rng.normal(size=model.n)
    other = free_of_constraints(level=level, damping=0.01, GvN=3.0)
    accelerations = [
        ControlLaw(model, parameters).step(start, v, target).acceleration
        for parameters in (free_of_constraints(level=level, damping=0.01), other)
    ]
    difference = np.abs(accelerations[0] - accelerations[1]).max()
    if level == "acceleration" and case == "m < n":
        assert difference > 0.1
    else:
        assert difference == 0.0


@pytest.fixture(scope="module")
def arm_orientation() -> ControlModel:
    description = load_robot_description("obstacle_arm")
    return ControlModel.FromDescription(
        description, [Task(frame="tool", kind="orientation")]
    )


@pytest.mark.parametrize("degrees", [30, 90, 170])
def test_orientations_converge(arm_orientation, degrees):
    """Eq. (11) on the arm, without blending, the shorter way round."""
    model = arm_orientation
    q = model.rest_positions()
    R = at(model, q).R[0]
    # About the tool's axis: the last joint has the range for it.
    turn = Rotation.from_rotvec([0.0, 0.0, np.radians(degrees)]).as_matrix()
    R_d = R @ turn
    target = model.layout.pack([R_d], np.empty((0, 3)))
    gains = free_of_constraints(damping=0.05, period=2e-3)
    _, qs, vs, solutions = integrate(
        ControlLaw(model, gains), q, np.zeros(7), lambda t: target, 3.0
    )
    angle = [
        Rotation.from_matrix(at(model, x).R[0].T @ R_d).magnitude() for x in qs[::50]
    ]
    assert angle[0] == pytest.approx(np.radians(degrees))
    assert angle[-1] < 1e-4
    assert max(angle) < np.radians(degrees) + 1e-6  # it never goes the long way


def test_the_default_posture_is_the_rest_posture(on_rail):
    """Of the joints with limits; without targets of its own, nothing else changes."""
    q, v = np.array([0.1, 0.5, 0.7, -0.9, 0.6]), np.array([0.0, 0.3, -0.4, 0.2, 0.1])
    target, stays = hold(on_rail, at(on_rail, q).p + 0.02), np.zeros(3)

    def acceleration(given=None, **changes):
        gains = {"nominal": PaperGains(), "blend_time": 0.0} | changes
        law = ControlLaw(on_rail, LookaheadParameters(**gains))
        step = law.step(q, v, target, stays, nominal_posture=given)
        return step.acceleration

    rest = on_rail.rest_positions()[on_rail.controlled]
    default = acceleration()
    np.testing.assert_array_equal(default, acceleration(posture_gain=30.0))
    np.testing.assert_array_equal(default, acceleration(rest))
    # In the null space of the point's position, three of four rows.
    assert np.abs(default - acceleration(posture_gain=0.0)).max() > 1.0


def test_the_posture_is_blended_in(on_rail):
    """At rest, on its targets, away from its posture: no jerk at the first step."""
    q, v, stays = np.array([0.1, 0.5, 0.7, -0.9, 0.6]), np.zeros(5), np.zeros(3)
    stays[0] = q[on_rail.prescribed[0]]
    law = ControlLaw(on_rail, LookaheadParameters(blend_time=0.2))
    target, accelerations = on_rail.tasks_at(q), []
    rest = on_rail.rest_positions()[on_rail.controlled]
    for _ in range(250):  # it is held where it is
        step = law.step(q, v, target, stays, nominal_posture=rest)
        accelerations.append(np.abs(step.acceleration).max())
    assert accelerations[0] < 1e-9
    assert max(np.diff(accelerations)) < 0.1 < 1.0 < accelerations[200]
    assert accelerations[-1] == pytest.approx(accelerations[200], rel=1e-3)


def test_a_joint_without_limits_is_not_drawn_back():
    """It may have turned round: there is no posture that is its own."""
    model = ControlModel.FromDescription(
        load_robot_description("upper_body"), [Task(frame="left_hand")]
    )
    law = ControlLaw(model)
    q = model.rest_positions() + 6.5
    first = model.controlled[0]  # the torso's turn, the only one without limits
    expected = model.rest_positions()
    expected[first] += 6.5
    np.testing.assert_array_equal(law.default_posture(q), expected[model.controlled])


def test_prescribed_joint_is_blended_in(on_rail):
    q = np.zeros(5)
    q[on_rail.controlled] = BENT
    law = ControlLaw(on_rail, PaperParameters(constraints="none"))
    solution = law.step(
        q, np.zeros(5), hold(on_rail, at(on_rail, q).p), [0.5, 0.3, 2.0]
    )
    np.testing.assert_allclose(solution.acceleration, 0.0, atol=1e-10)


EXTREMES = {
    "unlimited joints": (dict(limits=None), np.array([0.3, 0.4, 40.0])),
    "beyond a limit": (dict(limits=(-1.0, 1.0)), np.array([1.2, -1.5, 0.3])),
    "exactly at the limits": (dict(limits=(-1.0, 1.0)), np.array([1.0, -1.0, 0.0])),
    "locked joints": (dict(limits=(0.2, 0.2)), np.array([0.2, 0.3, 0.1])),
    "straight (singular)": (dict(), np.zeros(3)),
    "straight towards the post": (
        dict(),
        np.array([np.arctan2(0.5, 0.2), 0.0, 0.0]),
    ),
    "inside the post": (dict(), np.array([1.19, 0.0, 0.02])),
}


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("case", EXTREMES)
def test_finite_in_every_extreme(case, level):
    """Warnings are errors here, so no hidden division by zero either."""
    robot, q = EXTREMES[case]
    flat_post = chain_urdf("zzz", **robot).replace("0.2 0.5 0.1", "0.2 0.5 0.0")
    model = make_model(flat_post, pairs=[["l1", "post"], ["l2", "post"], ["l0", "l2"]])
    law = ControlLaw(
        model, PaperParameters(constraints="paper", level=level, blend_time=0.0)
    )
    target = hold(model, [[0.2, 0.6, 0.0]])
    rng = np.random.default_rng(0)
    for step in range(4):
        solution = law.step(q, rng.normal(size=3), target)
        for value in (
            solution.actuation,
            solution.acceleration,
            solution.signed_distances,
            solution.constraint_weights,
        ):
            assert np.isfinite(value).all()
        assert np.abs(solution.actuation).max() < 1e5
        if case == "inside the post":
            assert solution.signed_distances.min() < -0.05
        if case == "beyond a limit" and step == 0:
            # The first step counts as approaching; the third joint is inside.
            W = solution.constraint_weights
            assert W[0] > 1e3 and W[1] > 1e3 and W[2] < 10.0
        q = q + rng.uniform(-1e-3, 1e-3, 3)


@pytest.mark.parametrize("level", LEVELS)
def test_pair_exactly_at_touch(level):
    """Two balls, 0.3 m apart, of radii that add up to exactly that."""
    ball = '<sphere radius="0.125"/>'
    post = (
        '<link name="post"><collision><origin xyz="0.15 0.25 0"/><geometry>'
        '<sphere radius="0.125"/></geometry></collision></link>'
        '<joint name="w" type="fixed"><parent link="base"/><child link="post"/></joint>'
    )
    model = make_model(
        chain_urdf("zz", shapes=(ball,), extra=post),
        pairs=[["l0", "post"], ["post", "l1"]],
    )
    law = ControlLaw(model, PaperParameters(constraints="paper", level=level))
    solution = law.step(np.zeros(2), np.ones(2), hold(model, [[0.3, 0.3, 0.0]]))
    assert solution.signed_distances[0] == 0.0
    assert np.isfinite(solution.actuation).all()
    assert np.isfinite(solution.constraint_weights).all()


def test_step_takes_plain_lists(on_rail):
    q = [0.0, 0.5, 0.7, -0.9, 0.6]
    law = ControlLaw(on_rail)
    target = hold(on_rail, [[0.8, 0.3, 0.2]])
    a = law.step(q, [0.0] * 5, list(target), [0.0, 0.0, 0.0])
    law.reset()
    b = law.step(np.array(q), np.zeros(5), target, np.zeros(3))
    np.testing.assert_array_equal(a.actuation, b.actuation)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"q": np.array([0.0, np.nan, 0.0, 0.0, 0.0])}, ["q ", "entries 1"]),
        ({"v": np.array([0.0, 0.0, np.inf, 0.0, 0.0])}, ["v ", "entries 2"]),
        ({"tasks": np.full(9, np.nan)}, ["tasks", "t = 0.002"]),
        ({"prescribed": np.array([np.nan, 0, 0])}, ["prescribed"]),
        ({"q": np.zeros(4)}, ["q ", "(5,)"]),
        ({"tasks": np.zeros((3, 3))}, ["tasks", "(9,)"]),
        ({"prescribed": None}, ["prescribed", "(3,)"]),
        ({"nominal_posture": np.zeros(3)}, ["nominal_posture", "(4,)"]),
        ({"nominal_posture": np.zeros(4)}, ["nominal_posture", "leave it out"]),
    ],
)
def test_step_refuses_bad_arguments(on_rail, change, words):
    """By name, with the time; the memory is as before."""
    safe = "(4,)" in words  # the paper has no nominal posture
    law = ControlLaw(on_rail, LookaheadParameters() if safe else PaperParameters())
    good = {
        "q": np.array([0.0, 0.5, 0.7, -0.9, 0.6]),
        "v": np.zeros(5),
        "tasks": np.zeros(9),
        "prescribed": np.zeros(3),
    }
    law.step(**good)
    law.step(**good)
    with pytest.raises(InputError) as caught:
        law.step(**(good | change))
    for word in words:
        assert word in str(caught.value)
    law.step(**good)


def test_a_law_without_tasks_is_refused():
    with pytest.raises(ModelError, match="at least one task"):
        ControlLaw(make_model(chain_urdf("zz"), []))


def test_zero_quaternion_is_refused():
    """An orientation target that was never set."""
    model = make_model(chain_urdf("zyz"), [Task(frame="tip", kind="pose")])
    law = ControlLaw(model, PaperParameters(constraints="paper"))
    with pytest.raises(InputError, match="quaternion"):
        law.step(np.zeros(3), np.zeros(3), np.zeros(model.layout.size))


@pytest.mark.parametrize("lost", ["quaternion", "tasks", "nominal_posture"])
def test_lost_targets_brake_under_lookahead(lost):
    """Whatever is missing, the torque is finite and slows every joint down."""
    model = make_model(chain_urdf("zyz"), [Task(frame="tip", kind="pose")])
    gains = LookaheadParameters(posture_gain=5.0)
    law = ControlLaw(model, gains)
    q, v = random_state(model, 1)
    target = model.layout.pack([np.eye(3)], [[0.5, 0.3, 0.2]])
    posture = np.zeros(3)
    assert law.step(q, v, target, nominal_posture=posture).status == 1.0
    if lost == "quaternion":
        target = np.zeros_like(target)
    elif lost == "tasks":
        target = np.full_like(target, np.nan)
    else:
        posture = np.array([0.0, np.nan, 0.0])
    solution = law.step(q, v, target, nominal_posture=posture)
    assert solution.status == 2.0
    assert np.isfinite(solution.actuation).all()
    assert (solution.acceleration * v < 0.0).all()


@pytest.mark.parametrize(
    "change",
    [
        dict(level="position"),
        dict(constraints="qp"),
        dict(metric="inertai"),
        dict(period=0.0),
        dict(damping=-0.1),
        dict(Kp=float("nan")),
        dict(Kv=-1.0),
        dict(limit_share=1.5),
        dict(blend_time=-1.0),
    ],
)
def test_parameters_out_of_range_are_refused(planar, change):
    name = next(iter(change))
    with pytest.raises(ScenarioError, match=f"controller.{name}"):
        ControlLaw(planar, PaperParameters(**change))


# --- effort limits ----------------------------------------------------------------


def limited_model(effort: float) -> ControlModel:
    text, count = re.subn("<limit ", f'<limit effort="{effort}" ', chain_urdf("zyzyz"))
    assert count == 5
    return make_model(text)


def test_wide_effort_limits_change_nothing():
    model = limited_model(1e6)
    q, v = random_state(model, 3)
    targets = hold(model, at(model, q).p + 0.1)
    a, b = (
        ControlLaw(model, LookaheadParameters(effort_limits=respect)).step(
            q, v, targets
        )
        for respect in (False, True)
    )
    np.testing.assert_allclose(a.actuation, b.actuation, rtol=1e-13)
    np.testing.assert_array_equal(a.acceleration, b.acceleration)


@pytest.mark.parametrize("safe", [False, True])
def test_effort_limits_are_respected_by_default_with_the_lookahead_alone(safe):
    """The paper's laws are to the letter, unless they are told otherwise."""
    model = limited_model(170.0)
    q = np.array([0.5, 0.7, -0.9, 0.6, 0.2])
    targets = hold(model, at(model, q).p + 0.3)

    def step(**changes):
        gains = PaperParameters(blend_time=0.0, Kp=1e3, **changes)
        if safe:
            nominal = PaperGains(Kp=1e3)
            gains = LookaheadParameters(blend_time=0.0, nominal=nominal, **changes)
        return ControlLaw(model, gains).step(q, np.zeros(5), targets)

    free, limited = (step(effort_limits=value) for value in (False, True))
    assert np.abs(free.actuation).max() > 170.0 >= np.abs(limited.actuation).max()
    expected = limited if safe else free
    np.testing.assert_array_equal(step().actuation, expected.actuation)
    np.testing.assert_array_equal(step().torque_limit, expected.torque_limit)


def test_what_the_motion_asks_of_a_prescribed_joint_is_no_limit():
    """The law cannot do anything about it but ruin the motion of the others."""
    text = chain_urdf("zyzy", rail="y").replace("<limit ", '<limit effort="1e4" ')
    text = text.replace('effort="1e4" lower="-3"', 'effort="5" lower="-3"')
    model = make_model(text, prescribed_joints={"rail": "hold"})
    assert sorted(model.effort_limits) == [5.0, 1e4, 1e4, 1e4, 1e4]
    targets = hold(model, at(model, np.r_[0.0, BENT]).p)
    prescribed = np.array([0.0, 0.0, 20.0])  # 20 m/s^2 of more than 5 kg
    limited, free = (
        ControlLaw(
            model, LookaheadParameters(effort_limits=value, blend_time=0.0)
        ).step(np.r_[0.0, BENT], np.zeros(5), targets, prescribed)
        for value in (True, False)
    )
    assert np.abs(free.actuation[model.prescribed]) > 50.0
    np.testing.assert_allclose(limited.actuation, free.actuation, rtol=1e-13)
    np.testing.assert_array_equal(limited.torque_limit, [1.0, 0.0])


# --- speed limits -----------------------------------------------------------------


@pytest.fixture(scope="module")
def fast_on_rail() -> ControlModel:
    """Four joints, two of which state a largest speed, on a prescribed rail."""
    return make_model(
        chain_urdf("zyzy", rail="y"),
        prescribed_joints={"rail": "hold"},
        velocity_limits={"rail": 1.0, "j0": 2.0, "j2": 4.0},
    )


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, (2.0, np.inf, 4.0, np.inf)),
        ({"velocity_scale": 0.25}, (0.5, np.inf, 1.0, np.inf)),
        ({"velocity_scale": np.inf}, (np.inf,) * 4),
        # What is named is what was meant, without a scale.
        (
            {"velocity_scale": 0.5, "velocity_limits": {"j1": 3.0, "j2": np.inf}},
            (1.0, 3.0, np.inf, np.inf),
        ),
    ],
)
def test_speed_limits_of_robot_and_scenario(fast_on_rail, changes, expected):
    limits = ControlLaw(fast_on_rail, LookaheadParameters(**changes)).speed_limits
    by_name = dict(zip(fast_on_rail.position_names, limits, strict=True))
    # The prescribed joint's speed is the motion's.
    assert by_name == dict(zip(("j0", "j1", "j2", "j3"), expected, strict=True)) | {
        "rail": np.inf
    }
    assert fast_on_rail.velocity_limits[fast_on_rail.prescribed] == 1.0  # untouched


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"velocity_limits": {"ral": 1.0}},
            r"velocity_limits\.ral: .*did you mean 'rail'",
        ),
        ({"velocity_limits": {"rail": 1.0}}, "rail: the joint is prescribed"),
        ({"velocity_limits": {"tip_weld": 1.0}}, "tip_weld: the joint is fixed"),
        ({"velocity_limits": {"j0": 0.0}}, r"velocity_limits\.j0: 0.0 must be posit"),
        ({"velocity_limits": {"j0": np.nan}}, "j0: nan must be positive"),
        ({"velocity_scale": 0.0}, "velocity_scale: 0.0 must be positive$"),
        ({"velocity_scale": -1.0}, "velocity_scale: -1.0 must be positive$"),
        ({"velocity_scale": np.nan}, "velocity_scale: nan must be positive$"),
    ],
)
def test_refused_speed_limits(fast_on_rail, changes, message):
    with pytest.raises(ScenarioError, match=message):
        ControlLaw(fast_on_rail, LookaheadParameters(**changes))
