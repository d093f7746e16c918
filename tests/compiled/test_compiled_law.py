"""The compiled control law is the control law; how fast it is, no test asks."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from small_robots import state_about_the_limits

from crar_drake.compiled import compiler
from crar_drake.compiled.distances import Shapes, distances
from crar_drake.compiled.law import CompiledLaw
from crar_drake.control.law import ControlLaw
from crar_drake.equations.capsule_distances import capsule_distances
from crar_drake.errors import ScenarioError
from crar_drake.control.law import make_control_law
from crar_drake.control.parameters import CrarParameters
from crar_drake.robot import ControlModel
from crar_drake.robot_description import load_robot_description
from crar_drake.run import run_scenario
from crar_drake.scenario import load_scenario
from crar_drake.task import EXPERIMENTS, Task, position_tasks

MODES = ("paper", "lookahead")
STATES = 30
FIELDS = (
    "actuation",
    "acceleration",
    "task_error",
    "signed_distances",
    "constraint_weights",
    "position_command",
    "constrained_velocity",
    "resting_margins",
    "status",
    "torque_limit",
)


@pytest.fixture(scope="module", params=[*EXPERIMENTS, "weighed"])
def model(request) -> ControlModel:
    if request.param == "weighed":
        robot = "obstacle_arm"
        tasks = [Task(frame="tool", point=[0.02, 0.0, 0.1], position_weight=0.4)]
    else:
        robot, tasks = "upper_body", position_tasks(EXPERIMENTS[request.param])
    return ControlModel.FromDescription(load_robot_description(robot), tasks)


def steps_of(model: ControlModel, seed: int):
    """Three consecutive states and their targets, about anywhere within the limits and
    a little beyond."""
    rng = np.random.default_rng(seed)
    q, v = state_about_the_limits(model, rng, 0.5)
    state = model.evaluate(model.MakeWorkspace(), q, v)
    for _ in range(3):
        desired = model.layout.pack(
            state.R,
            state.p + 0.05 * rng.normal(size=state.p.shape),
            rng.normal(size=model.m),
            5.0 * rng.normal(size=model.m),
        )
        yield q, v, desired, rng.normal(size=3 * model.n_p)
        q = q + 1e-3 * v
        v = v + 1e-2 * rng.normal(size=len(v))


@pytest.mark.parametrize("blend_time", [0.0, 0.5])
@pytest.mark.parametrize("constraints", MODES)
def test_answers_are_the_control_laws(model, constraints, blend_time):
    """To 1e-9; to 1e-8 where weights above 1e6 multiply the last bit of a gradient."""
    parameters = CrarParameters(constraints=constraints, blend_time=blend_time)
    law, compiled = ControlLaw(model, parameters), CompiledLaw(model, parameters)
    bounds = []
    for seed in range(STATES):
        law.reset()
        compiled.reset()
        largest = 0.0
        for given in steps_of(model, seed):
            expected, found = law.step(*given), compiled.step(*given)
            largest = max(largest, expected.constraint_weights.max())
            bounds.append(1e-9 if largest < 1e6 else 1e-8)
            for name in FIELDS:
                right, value = getattr(expected, name), getattr(found, name)
                scale = np.abs(right).max() if np.isfinite(right).all() else 1.0
                np.testing.assert_allclose(
                    value, right, rtol=0.0, atol=bounds[-1] * scale, err_msg=name
                )
    assert bounds.count(1e-9) >= STATES


def test_distances_are_those_of_the_closed_form_where_axes_are_special():
    x, y = np.eye(3)[:2]
    o, up = np.zeros(3), np.array([0.0, 0.0, 0.1])
    rng = np.random.default_rng(0)
    axes = [
        (o, x, up, x),  # parallel, side by side
        (o, x, up + 0.3 * x, 0.2 * x),
        (o, x, up + 2.0 * x, x),  # one behind the other
        (o, x, up, x + 1e-6 * y),  # nearly parallel
        (o, x, -0.5 * y + 0.4 * x, y),  # they meet
        (o, x, 0.3 * x, x),  # on one line
        (o, o, up, o),  # spheres
        (o, x, up + 0.2 * x, o),
        (o, o, 0.2 * x + y, y),
        (o, o, o, o),
        *rng.normal(size=(40, 4, 3)),
    ]
    p_a, u, p_b, v = (np.array(part) for part in zip(*axes, strict=True))
    N = len(axes)
    radius_a, radius_b = rng.uniform(0.01, 0.1, size=(2, N))
    d, normal, on_a, _ = capsule_distances(
        p_a, p_a + u, radius_a, p_b, p_b + v, radius_b
    )
    shapes = Shapes(
        axis_a=np.arange(N),
        axis_b=N + np.arange(N),
        uu=np.square(np.linalg.norm(u, axis=1)),
        vv=np.square(np.linalg.norm(v, axis=1)),
        radii=radius_a + radius_b,
        pair=np.arange(N),
        moves=np.ones((N, 6)),
    )
    points = np.concatenate([p_a, p_b, u, v]).T[None].copy()
    # With this S a gradient is the wrench [p x n; n].
    found, wrench = distances(points, np.eye(6)[None], shapes)
    np.testing.assert_allclose(found[0], d, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(wrench[0, :, 3:], normal, rtol=0.0, atol=1e-9)
    moment = np.cross(on_a, normal)
    np.testing.assert_allclose(wrench[0, :, :3], moment, rtol=0.0, atol=1e-8)


def test_a_lost_target_brakes_and_comes_back_as_in_the_control_law(model):
    laws = ControlLaw(model), CompiledLaw(model)
    lost = [False, True, True, False]
    given = [*steps_of(model, 0), *steps_of(model, 1)]
    for is_lost, (q, v, tasks, prescribed) in zip(lost, given, strict=False):
        if is_lost:
            tasks = np.full_like(tasks, np.nan)
        expected, found = (law.step(q, v, tasks, prescribed) for law in laws)
        assert found.status == expected.status
        scale = np.abs(expected.actuation).max()
        np.testing.assert_allclose(
            found.actuation, expected.actuation, rtol=0.0, atol=1e-9 * scale
        )


def test_what_is_not_covered_is_refused():
    poses = ControlModel.FromDescription(
        load_robot_description("obstacle_arm"), [Task(frame="tool", kind="pose")]
    )
    with pytest.raises(
        ScenarioError, match="does not cover tasks other than positions"
    ):
        CompiledLaw(poses)
    positions = ControlModel.FromDescription(
        load_robot_description("obstacle_arm"), [Task(frame="tool")]
    )
    with pytest.raises(ScenarioError, match="does not cover level velocity, metric"):
        CompiledLaw(
            positions,
            CrarParameters(level="velocity", constraints="paper", metric="inertia"),
        )


def test_a_whole_run_is_that_of_plain_numpy():
    """Through scenario, controller and plant; chaos has no time to grow."""
    scenario = load_scenario("dance")
    scenario.duration = 0.2
    plain = run_scenario(scenario, record=False).log
    scenario.controller = replace(scenario.controller, arithmetic="compiled")
    run = run_scenario(scenario, record=False)
    np.testing.assert_allclose(run.log.q, plain.q, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(run.log.actuation, plain.actuation, atol=1e-6)


def test_the_parameters_choose_the_law(model, monkeypatch):
    pytest.importorskip("numba")
    compiled = CrarParameters(arithmetic="compiled")
    assert type(make_control_law(model)) is ControlLaw
    assert type(make_control_law(model, compiled)) is CompiledLaw
    monkeypatch.setattr(compiler, "HAS_NUMBA", False)
    with pytest.raises(ScenarioError, match=r"pip install 'crar-drake\[compiled\]'"):
        make_control_law(model, compiled)
    with pytest.raises(ScenarioError, match="controller.arithmetic: 'numpi' is none"):
        make_control_law(model, CrarParameters(arithmetic="numpi"))


def test_compiled_functions_are_kept_apart_by_their_sources(monkeypatch, tmp_path):
    """In a folder of the user's cache; Numba's own setting is left alone."""
    numba = pytest.importorskip("numba")
    monkeypatch.setattr(compiler, "_CACHE_FOLDER", tmp_path / "kept")
    theirs = numba.config.CACHE_DIR
    path = tmp_path / "twice.py"
    path.write_text("def twice(x):\n    return 2.0 * x\n")
    monkeypatch.syspath_prepend(tmp_path)
    import twice

    function = compiler.njit(twice.twice)
    assert function(3.0) == 6.0
    assert list((tmp_path / "kept").rglob("*.nbc"))
    assert numba.config.CACHE_DIR == theirs
    folder = compiler.cache_folder()
    monkeypatch.setattr(compiler, "LIMIT_CLAMP", 1.0)
    assert compiler.cache_folder() != folder
    sys.modules.pop("twice")
