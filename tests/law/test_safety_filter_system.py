"""The filter in diagrams: state in the context, and what is refused."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from crar_drake import InputError, SafetyFilter, SafetyFilterSystem

PERIOD = 0.02


@pytest.fixture(scope="module")
def filter() -> SafetyFilter:
    return SafetyFilter("obstacle_arm", PERIOD)


class Policy(LeafSystem):
    """Emits what a function of the time wants."""

    def __init__(self, size: int, wanted) -> None:
        super().__init__()
        self.DeclareVectorOutputPort(
            "wanted",
            size,
            lambda context, output: output.SetFromVector(wanted(context.get_time())),
        )


def wanted(filter: SafetyFilter, time: float) -> np.ndarray:
    """Through the post and back, and no number for a while."""
    q = filter.model.rest_positions()
    q[0] += 1.2 * np.sin(2.0 * time)
    q[1] += 0.3 * np.sin(2.0 * time)
    if 1.2 < time < 1.3:
        q[3] = np.nan
    return q


def make(filter: SafetyFilter, **sources):
    """A diagram with the filter's ports connected: its simulator, system and log."""
    builder = DiagramBuilder()
    system = builder.AddSystem(SafetyFilterSystem(filter))
    for port, function in sources.items():
        of = system.GetInputPort(port)
        policy = builder.AddSystem(Policy(of.size(), function))
        builder.Connect(policy.get_output_port(), of)
    log = LogVectorOutput(system.get_output_port_command(), builder, PERIOD)
    return Simulator(builder.Build()), system, log


def test_the_state_is_the_contexts(filter):
    """A clone of a context goes its own way; the same steps are the same again."""
    simulator, system, _ = make(
        filter, desired_position=lambda time: wanted(filter, time)
    )
    simulator.AdvanceTo(0.5)
    branch = simulator.get_context().Clone()
    simulator.AdvanceTo(1.0)
    other = Simulator(simulator.get_system(), branch)
    other.AdvanceTo(1.0)
    outputs = [
        system.get_output_port_command().Eval(
            system.GetMyContextFromRoot(s.get_context())
        )
        for s in (simulator, other)
    ]
    np.testing.assert_array_equal(*outputs)


def test_it_begins_at_what_is_measured_or_where_it_is_told(filter):
    here = filter.model.rest_positions() + 0.1
    measured = np.concatenate([here, np.zeros(7)])
    simulator, system, _ = make(
        filter,
        desired_position=lambda time: here,
        measured_state=lambda time: measured - 0.02 * (time > 0.0),
    )
    simulator.AdvanceTo(3 * PERIOD)
    context = system.GetMyContextFromRoot(simulator.get_context())
    command = system.get_output_port_position_command().Eval(context)
    np.testing.assert_array_equal(command, here)
    assert system.report(context).tracking_error == pytest.approx(0.02)
    simulator, system, _ = make(filter, desired_velocity=lambda time: np.zeros(7))
    context = system.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    system.SetStart(context, {"joint2": 0.4})
    assert system.report(context) is None
    simulator.AdvanceTo(PERIOD)
    assert system.get_output_port_position_command().Eval(context)[1] == 0.4


@pytest.mark.parametrize("speeds", [[-1.0], [np.nan], [[1.0]], 1.0, "fast"])
def test_speeds_of_obstacles_that_are_none_are_refused(filter, speeds):
    with pytest.raises(InputError, match="obstacle_speeds"):
        SafetyFilterSystem(filter, obstacle_speeds=speeds)


def test_it_is_made_of_a_filter():
    with pytest.raises(InputError, match="give a SafetyFilter, not str"):
        SafetyFilterSystem("obstacle_arm")


@pytest.mark.parametrize(
    "ports, word",
    [
        ([], "nothing is wanted"),
        (["desired_state", "desired_position"], "leave one out"),
        (["desired_position", "desired_acceleration"], "accelerations"),
    ],
)
def test_ports_that_do_not_go_together_are_refused(filter, ports, word):
    state = {"desired_state": lambda time: np.zeros(14)}
    sources = {port: state.get(port, lambda time: np.zeros(7)) for port in ports}
    simulator, _, _ = make(filter, **sources)
    with pytest.raises(InputError, match=word):
        simulator.AdvanceTo(0.1)
