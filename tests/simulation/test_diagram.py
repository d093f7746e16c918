"""MakeCrarDiagram of a scenario."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

from crar_drake.errors import CrarError, ModelError
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.motion.catalogue import builtin_names
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.task import Task
from crar_drake.simulation.diagram import MakeCrarDiagram, PrepareScenario
from crar_drake.simulation.scenario import (
    Scenario,
    SimulatedRobot,
    load_scenario,
    scenario_names,
)
from crar_drake.targets.keyframes import Keyframe


def runnable(name: str, request) -> Scenario:
    """The shipped scenario; on a real recording where its motion is not shipped.

    A robot that is not imported is skipped: `tests/robot_import` imports and runs it.
    """
    scenario = load_scenario(name)
    try:
        load_robot_description(scenario.robot)
    except ModelError as error:
        if "import-robot" not in str(error):
            raise
        pytest.skip(str(error))
    if scenario.motion and scenario.motion not in builtin_names():
        cmu = request.getfixturevalue("cmu")
        scenario.motion = str(cmu / "subjects" / "05" / "05_02.amc")
    return scenario


@pytest.fixture(scope="module", params=scenario_names())
def built(request) -> tuple[Scenario, Diagram]:
    scenario = runnable(request.param, request)
    return scenario, MakeCrarDiagram(scenario)


def test_it_starts_at_rest_and_valid(built):
    """No pair nearer than 2 cm; or, if it is in the rest posture, than there, or than
    5 mm. The first command is that of a robot at rest, so nothing jumps."""
    scenario, diagram = built
    context = diagram.CreateDefaultContext()
    plant = diagram.GetSubsystemByName("plant")
    model = diagram.GetSubsystemByName("crar_controller").law.model
    plant_context = plant.GetMyContextFromRoot(context)
    assert not plant.GetVelocities(plant_context).any()
    controller = diagram.GetSubsystemByName("crar_controller")
    controller_context = controller.GetMyContextFromRoot(context)
    state = controller.get_input_port_estimated_state().Eval(controller_context)
    q = state[model.controlled_positions]
    assert (q > model.lower).all() and (q < model.upper).all()
    parts = controller.diagnostics(controller_context)
    d = parts["signed_distances"]
    rest = model.evaluate(
        model.MakeWorkspace(), model.rest_positions(), np.zeros(model.n + model.n_p)
    )
    least = np.where(rest.d < 0.02, np.minimum(rest.d, 0.005), 0.02)
    assert (d >= least - 1e-9).all()
    acceleration = diagram.GetOutputPort("desired_acceleration").Eval(context)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-6)
    error = parts["task_error"]
    layout = model.layout
    assert np.isfinite(error).all()
    # One that stands begins as it rests, where it is known to be balanced.
    farthest = 0.3 if scenario.standing is None else 0.5  # [m]
    assert np.abs(error[layout.linear_rows]).max(initial=0.0) < farthest
    # A hand may have to turn far from the rest posture; blending does the rest.
    assert np.abs(error[layout.angular_rows]).max(initial=0.0) < 0.9  # sine


def what_may_touch(diagram):
    """The pairs of shapes that the plant may find in contact, in its own scene."""
    plant = diagram.GetSubsystemByName("plant")
    root = diagram.CreateDefaultContext()
    context = plant.GetMyContextFromRoot(root)
    inspector = plant.get_geometry_query_input_port().Eval(context).inspector()
    in_plant = plant.num_collision_geometries()
    assert inspector.num_geometries() >= in_plant > 0
    return inspector.GetCollisionCandidates()


def test_nothing_hides_a_violation(built):
    """By default the plant has neither contact nor limits; the control model has. A
    robot that stands touches the floor, and nothing else."""
    scenario, diagram = built
    plant = diagram.GetSubsystemByName("plant")
    assert np.isinf(plant.GetPositionUpperLimits()).all()
    assert np.isinf(plant.GetPositionLowerLimits()).all()
    assert np.isinf(plant.GetEffortUpperLimits()).all()
    if scenario.standing is None:
        assert not what_may_touch(diagram)
    else:
        (floor,) = plant.GetCollisionGeometriesForBody(plant.world_body())
        touching = what_may_touch(diagram)
        assert touching and all(floor in pair for pair in touching)
    model = diagram.GetSubsystemByName("crar_controller").law.model
    assert np.isfinite(model.upper).any() and np.isfinite(model.effort_limits).any()
    assert model.scene_graph.model_inspector().GetCollisionCandidates()


def test_it_runs(built):
    scenario, diagram = built
    period = scenario.log_period_for(0.05)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.05)
    root = simulator.get_context()
    sizes = {}
    for name in ("state", "desired_tasks", "diagnostics"):
        log = diagram.GetSubsystemByName(f"log_{name}").FindLog(root)
        sizes[name] = log.num_samples()
        # Of a law without balance that part is missing.
        missing = name == "diagnostics" and scenario.controller.balance is None
        assert np.isfinite(log.data()).all() != missing
    assert set(sizes.values()) == {round(0.05 / period) + 1}


def test_simulated_robot_options():
    """Each is kept when asked for, by itself."""
    scenario = load_scenario("obstacle_arm")
    setup = PrepareScenario(scenario)
    for option in ("contact", "position_limits", "effort_limits"):
        scenario.simulated_robot = replace(SimulatedRobot(), **{option: True})
        diagram = MakeCrarDiagram(scenario, setup=setup)
        plant = diagram.GetSubsystemByName("plant")
        assert bool(what_may_touch(diagram)) == (option == "contact")
        kept = np.isfinite(plant.GetPositionUpperLimits()).all()
        assert kept == (option == "position_limits")
        assert np.isfinite(plant.GetEffortUpperLimits()).all() == (
            option == "effort_limits"
        )


def test_continuous_plant_and_log_period():
    """A scenario may choose both."""
    scenario = load_scenario("obstacle_arm")
    scenario.plant_config.time_step = 0.0
    scenario.plant_config.use_sampled_output_ports = False
    scenario.controller.period = 5e-3
    scenario.log_period = 0.01
    diagram = MakeCrarDiagram(scenario)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.1)
    log = diagram.GetSubsystemByName("log_state").FindLog(simulator.get_context())
    np.testing.assert_allclose(log.sample_times(), np.arange(11) * 0.01, atol=1e-12)


def arm_with(**changes) -> Scenario:
    scenario = load_scenario("obstacle_arm")
    for name, value in changes.items():
        setattr(scenario, name, value)
    return scenario


def still(name: str, xyz=(0.4, 0.0, 0.3)) -> dict[str, list[Keyframe]]:
    return {name: [Keyframe(t, list(xyz)) for t in (0.0, 1.0)]}


@pytest.mark.parametrize(
    "scenario, words",
    [
        (arm_with(robot="obstacle_rm"), ["did you mean 'obstacle_arm'"]),
        (arm_with(tasks=[Task(frame="tol")]), ["tol", "did you mean 'tool'"]),
        (arm_with(keyframes=still("tol")), ["none for task tool"]),
        (arm_with(keyframes=still("tool") | still("x")), ["no task x"]),
        (arm_with(keyframes=still("tool", (0.4, 0.0))), ["tool", "xyz", "three"]),
        (arm_with(keyframes={"tool": [Keyframe()]}), ["tool", "at least two"]),
        (arm_with(keyframes={}, motion="nowhere"), ["tool", "keyframes"]),
        (arm_with(robot="upper_body", tasks=[Task(frame="neck")]), ["prescribed"]),
        (
            arm_with(controller=LookaheadParameters(period=1.5e-3)),
            ["controller.period"],
        ),
    ],
)
def test_refused_scenarios(scenario, words):
    with pytest.raises(CrarError) as caught:
        MakeCrarDiagram(scenario)
    for word in words:
        assert word in str(caught.value)
