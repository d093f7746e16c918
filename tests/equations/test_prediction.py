"""The predicted state is the one that a plant reaches."""

import numpy as np
import pytest
from pydrake.multibody.tree import MultibodyForces
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from small_robots import add_plant, chain_urdf

from crar_drake.equations.prediction import next_state, state_ahead

Q, V = np.array([0.3, -0.4, 0.8]), np.array([1.0, -2.0, 3.0])
A = np.array([20.0, -30.0, 50.0])


def advance(plant_step: float, steps: int, duration: float):
    """A plant of Drake's, driven so that it accelerates by A: its q and v at the end.

    Args:
        plant_step: of the plant [s]; 0 for a continuous one.
        steps: how often the torque is computed.
        duration: of all of them [s].
    """
    builder = DiagramBuilder()
    plant, _ = add_plant(builder, chain_urdf("zyz"), time_step=plant_step)
    builder.ExportInput(plant.get_actuation_input_port(), "torque")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    plant.SetPositionsAndVelocities(context, np.r_[Q, V])
    diagram.GetInputPort("torque").FixValue(root, np.zeros(3))
    simulator.Initialize()
    forces = MultibodyForces(plant)
    every = plant_step or duration / steps
    for k in range(steps):
        plant.CalcForceElementsContribution(context, forces)
        tau = plant.CalcInverseDynamics(context, A, forces)
        diagram.GetInputPort("torque").FixValue(root, tau)
        simulator.AdvanceTo((k + 1) * every)
    return plant.GetPositions(context), plant.GetVelocities(context)


@pytest.mark.parametrize("period", [1e-3, 5e-3, 10e-3, 20e-3])
def test_a_discrete_plant_is_there_after_a_period(period):
    q, v = advance(1e-3, round(period / 1e-3), period)
    q_next, v_next = next_state(Q, V, A, period, 1e-3)
    np.testing.assert_allclose(q_next, q, atol=1e-12)
    np.testing.assert_allclose(v_next, v, atol=1e-11)
    # A single step of the period's length would go elsewhere.
    if period > 1e-3:
        assert np.abs(Q + period * v - q).max() > 1e-4


def test_a_continuous_plant_is_there_after_a_period():
    """The parabola, the nearer the more often the torque is computed."""
    period = 5e-3
    predicted = np.concatenate(next_state(Q, V, A, period, 0.0))
    far, near = (
        np.abs(np.concatenate(advance(0.0, steps, period)) - predicted).max()
        for steps in (20, 80)
    )
    assert near < 0.3 * far
    assert near < 1e-3


@pytest.mark.parametrize("plant_step", [1e-3, 2e-3])
def test_a_plant_that_steps_with_the_controller_to_the_last_bit(plant_step):
    """Also where its step is longer than the period, and so counts as the period."""
    q, v = next_state(Q, V, A, 1e-3, plant_step)
    np.testing.assert_array_equal(v, V + 1e-3 * A)
    np.testing.assert_array_equal(q, Q + 1e-3 * v)


def test_the_state_ahead_is_in_the_plants_order():
    """Whatever order the equations have."""
    rng = np.random.default_rng(5)
    positions, order = np.array([6, 7, *range(6)]), rng.permutation(8)
    q, v, a = rng.normal(size=(3, 8))
    q_next, v_next = next_state(q[positions], v[order], a[order], 4e-3, 1e-3)
    found = state_ahead(q, v, a, 4e-3, 1e-3, positions, order)
    np.testing.assert_array_equal(found[:8][positions], q_next)
    np.testing.assert_array_equal(found[8:][order], v_next)
