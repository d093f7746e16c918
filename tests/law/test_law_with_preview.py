"""The law with a preview: whole steps, of all kinds of tasks, and what it is for."""

from dataclasses import replace

import numpy as np
import pytest
from exact_loop import follow

from crar_drake import (
    EXPERIMENTS,
    ControlModel,
    load_robot_description,
    position_tasks,
)
from crar_drake.errors import ScenarioError
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import (
    BalanceParameters,
    LookaheadParameters,
    PaperGains,
)
from crar_drake.robot.task import Task

PERIOD = 5e-3
PREVIEW = LookaheadParameters(period=PERIOD, blend_time=0.0)
MARGIN = 5e-3  # [m]
HANDS = ["left_wrist", "right_wrist"]


def upper_body(tasks) -> ControlModel:
    return ControlModel.FromDescription(
        load_robot_description("upper_body"), tasks, time_step=PERIOD
    )


@pytest.fixture(scope="module")
def model() -> ControlModel:
    return upper_body(position_tasks(HANDS))


def swung(model: ControlModel, seconds: float) -> np.ndarray:
    """Both wrists' targets, to and fro through each other, with their derivatives."""
    p = model.layout.unpack(model.tasks_at(model.rest_positions())).p
    front = p.mean(axis=0) + [0.25, 0.0, 0.2]
    half = np.array([[0.0, 0.2, 0.0], [0.0, -0.2, 0.05]])
    time = np.arange(0.0, seconds, PERIOD)
    omega = 2.0 * np.pi * 0.8
    # From the rest posture to the swing by a smooth step of its own.
    x = np.clip(time / 1.0, 0.0, 1.0)
    w = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    places = (1.0 - w)[:, None, None] * p + w[:, None, None] * (
        front + np.cos(omega * time)[:, None, None] * half
    )
    v = np.gradient(places, PERIOD, axis=0)
    a = np.gradient(v, PERIOD, axis=0)
    none = np.empty((0, 3, 3))
    return np.array(
        [
            model.layout.pack(none, *each)
            for each in zip(
                places,
                v.reshape(len(time), -1),
                a.reshape(len(time), -1),
                strict=True,
            )
        ]
    )


def test_a_target_out_of_reach_is_waited_for_at_rest(model):
    """And one that is within is reached: nothing shakes, nothing is left over. It is
    aside, for straight ahead both arms stretched alike are a saddle."""
    p = model.layout.unpack(model.tasks_at(model.rest_positions())).p
    for away, error in (([0.2, 0.0, 0.2], 1e-3), ([2.0, 0.5, 0.0], None)):
        target = model.layout.pack(np.empty((0, 3, 3)), p + away)
        states, answers = follow(model, PREVIEW, np.tile(target, (600, 1)))
        v = states[:, model.plant.num_positions() :]
        assert np.abs(v[-1]).max() < 0.05
        if error is not None:
            assert np.abs(answers[-1].task_error).max() < error


def test_poses_and_joints_are_followed():
    poses = [Task(frame="left_wrist", kind="pose", orientation_weight=0.2)]
    joint = Task(kind="joint", joint="right_elbow")
    model = upper_body([*poses, joint])
    rest = model.rest_positions()
    goal = rest.copy()
    rng = np.random.default_rng(1)
    goal[model.controlled_positions] += 0.2 * rng.uniform(-1.0, 1.0, model.n)
    goal[model.controlled_positions] = np.clip(
        goal[model.controlled_positions], model.lower + 0.05, model.upper - 0.05
    )
    target = model.tasks_at(goal)
    _, answers = follow(model, PREVIEW, np.tile(target, (500, 1)))
    assert np.abs(answers[0].task_error).max() > 0.02
    assert np.abs(answers[-1].task_error).max() < 2e-3


def test_a_plan_that_went_astray_is_left(model):
    """Whatever the last plan was: else one led the next on, to 1e29 rad/s^2."""
    p = model.layout.unpack(model.tasks_at(model.rest_positions())).p
    target = model.layout.pack(np.empty((0, 3, 3)), p + [0.2, 0.0, 0.2])
    law, rng = ControlLaw(model, PREVIEW), np.random.default_rng(7)
    q = model.rest_positions()
    still, v = model.prescribed_at(q), np.zeros(model.plant.num_velocities())
    for k in range(400):
        solution = law.step(q, v, target, still)
        command = solution.position_command
        q, v = command[: len(q)], command[len(q) :]
        if k == 20:
            kept = law._memory.kept.copy()
            kept[-5 * model.n :] = 1e8 * rng.normal(size=5 * model.n)
            law._memory.kept = kept
    assert np.abs(solution.task_error).max() < 1e-3
    assert np.abs(solution.acceleration).max() < 1.0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"preview": -0.1}, "preview"),
        ({"smoothness": 0.0}, "smoothness: 0.0 must be"),
        ({"smoothness": 1e-8}, "smoothness: 1e-08 must be.* at least 1e-06"),
        ({"smoothness": "close"}, "smoothness: close must be closest, balanced, calm"),
        (
            {"nominal": PaperGains(), "preview": 0.1},
            "controller.preview: .*controller.nominal",
        ),
        ({"nominal": PaperGains(), "smoothness": "calm"}, "controller.smoothness"),
        ({"nominal": PaperGains(Kp=-1.0)}, "controller.nominal.Kp"),
        ({"period": 0.1, "braking_time": 0.05}, "controller.period: 0.1 s .* 0.05 s"),
        ({"margin": 1e-3}, "controller.margin: 0.001 m"),
        ({"margin": 0.3}, "controller.margin: 0.3 m"),
    ],
)
def test_what_makes_no_sense_is_refused(changes, said):
    with pytest.raises(ScenarioError, match=said):
        replace(PREVIEW, **changes).validate()


def test_with_the_least_smoothness_there_is_a_plan(model):
    """Of wrists whose targets jump by 30 cm; with less the law finds none."""
    law = ControlLaw(model, replace(PREVIEW, smoothness=1e-6))
    q = model.rest_positions()
    v, targets = np.zeros(model.plant.num_velocities()), model.tasks_at(q)
    for k in range(60):
        targets[[1, 2, 4]] += [0.3, 0.2, -0.3] if k in (20, 40) else [0.0, 0.0, 0.0]
        solution = law.step(q, v, targets, model.prescribed_at(model.rest_positions()))
        assert np.isfinite(solution.acceleration).all()
        q, v = np.split(solution.position_command, [len(q)])
    assert np.abs(v).max() > 0.0 and solution.admission[3] == 1.0


def test_what_is_not_given_follows_from_the_period_and_the_nominal():
    """A short braking time and slower plans; what is given stays."""
    paper = replace(PREVIEW, nominal=PaperGains())
    assert PREVIEW.T == 0.012
    assert replace(PREVIEW, period=0.02).T == pytest.approx(0.032)
    assert PREVIEW.longest_T == paper.T == pytest.approx(2.5 / 30.0)
    assert PREVIEW.among_obstacles().T == paper.T
    assert replace(PREVIEW, balance=BalanceParameters()).T == paper.T
    assert replace(PREVIEW, braking_time=0.05).T == 0.05
    found, crowded = PREVIEW.resolved(), PREVIEW.resolved(crowded=True)
    assert (found.stiffness, found.damping) == (40.0, 20.0)
    assert (crowded.stiffness, crowded.damping) == (1.0, 3.0)
    assert (paper.resolved().stiffness, paper.resolved().damping) == (30.0, 30.0)
    assert replace(PREVIEW, posture_gain=11.0).resolved(True).stiffness == 11.0
    assert found.others[-1] == pytest.approx(PREVIEW.longest_T)
    assert paper.resolved().others == replace(PREVIEW, braking_time=0.05).resolved()[1]


def test_how_smoothly_is_planned_has_names(model):
    """To the last bit those of their numbers."""
    numbers = {"closest": 5.7e-5, "balanced": 8e-5, "calm": 2.3e-4}
    targets = swung(model, 0.3)
    reached = []
    for name, number in numbers.items():
        states, same = (
            follow(model, replace(PREVIEW, smoothness=value), targets)[0]
            for value in (name, number)
        )
        np.testing.assert_array_equal(states, same)
        reached.append(states)
    assert np.abs(reached[0] - reached[1]).max() > 1e-5
    assert np.abs(reached[1] - reached[2]).max() > 1e-5
    np.testing.assert_array_equal(reached[1], follow(model, PREVIEW, targets)[0])


def test_a_violation_is_left_at_the_retreat_speed(model):
    """Links in one another that are to stay: not at once, with all that motors have."""
    rng = np.random.default_rng(5)
    still, started = np.zeros(model.plant.num_velocities()), 0
    while started < 5:
        q, v = model.rest_positions(), still
        q[model.controlled_positions] = rng.uniform(
            np.maximum(model.lower, -1.5), np.minimum(model.upper, 1.5)
        )
        smallest = [model.signed_distances(q).min()]
        if not -0.02 < smallest[0] < -0.01:
            continue
        started += 1
        law = ControlLaw(model, PREVIEW)
        tasks = model.tasks_at(model.rest_positions())
        for _ in range(40):
            solution = law.step(
                q, v, tasks, model.prescribed_at(model.rest_positions())
            )
            q, v = np.split(solution.position_command, [len(q)])
            smallest.append(model.signed_distances(q).min())
        assert smallest[1] - smallest[0] < 0.3 * (MARGIN - smallest[0])
        assert smallest[-1] > 4e-3


def test_an_arm_stays_where_it_is_until_a_joint_nears_its_limit(model):
    """Both hands are held where they are. What tasks leave free is drawn to the rest
    posture where one asks for it, and otherwise only from near a limit, until there is
    room again."""
    rest = model.rest_positions()
    at = model.position_names.index("left_shoulder_yaw")
    limit = model.upper[model.controlled_positions.tolist().index(at)]

    def share_left(share: float, **given) -> float:
        law, q = ControlLaw(model, PREVIEW), rest.copy()
        q[at] += share * (limit - rest[at])
        targets, stays = model.tasks_at(q), model.prescribed_at(q)
        v = np.zeros(model.plant.num_velocities())
        for _ in range(600):
            answer = law.step(q, v, targets, stays, **given)
            q, v = np.split(answer.position_command, [len(q)])
        assert np.abs(answer.task_error).max() < 1e-3
        return (q[at] - rest[at]) / (limit - rest[at])

    assert share_left(0.45) == pytest.approx(0.45, abs=1e-6)
    asked = share_left(0.45, nominal_posture=rest[model.controlled_positions])
    assert asked < 0.3
    assert 0.45 < share_left(0.8) < 0.6


def test_crowded_tasks_are_not_pulled_aside_by_the_posture():
    """Seven points that can be reached exactly, by a robot that bends so far that it is
    drawn back: what the null space is pulled by would be their error."""
    model = upper_body(position_tasks(EXPERIMENTS["upper-body"]))
    assert model.m >= model.n
    rest = model.rest_positions()
    bent = rest.copy()
    for joint, angle in {"left_elbow": -1.5, "left_shoulder_roll": 0.3}.items():
        bent[model.position_names.index(joint)] += angle
    time = np.arange(0.0, 3.0, PERIOD)
    x = np.clip(time / 1.0, 0.0, 1.0)
    w = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    targets = np.array([model.tasks_at(rest + share * (bent - rest)) for share in w])
    errors = {}
    for name, changes in {
        "default": {},
        "as where tasks leave a choice": {"posture_gain": 40.0},
    }.items():
        states, _ = follow(model, replace(PREVIEW, **changes), targets)
        q = states[-1][: len(rest)]
        e = model.tasks_at(q) - targets[-1]
        errors[name] = np.abs(e[: 3 * len(EXPERIMENTS["upper-body"])]).max()
    assert errors["default"] < 0.3 * errors["as where tasks leave a choice"]
