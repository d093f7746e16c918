"""What is put between plant and controller does what it says, and nothing else."""

import numpy as np
import pytest
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource
from small_robots import add_plant, chain_urdf

from crar_drake.errors import ModelError, ScenarioError
from crar_drake.law.tasks import TaskLayout
from crar_drake.simulation.disturbances import (
    AddMeasurement,
    Disturbances,
    Push,
    PushSource,
    ScaleMasses,
    TargetJump,
    TargetStep,
)

STEP = 1e-3  # of the discrete plants [s]
START = np.array([0.3, -0.4, 0.8])
EVERYTHING = Disturbances(position_noise=1e-3, velocity_noise=5e-2)


class Reader(LeafSystem):
    """Reads a port at the controller's ticks, in an update as the controller's."""

    def __init__(self, size: int, period: float) -> None:
        super().__init__()
        self.DeclareVectorInputPort("x", size)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._Read)
        self.seen: list[np.ndarray] = []

    def _Read(self, context: Context, state) -> None:
        self.seen.append(self.get_input_port().Eval(context).copy())


def measure(
    disturbances: Disturbances, time_step: float, period: float, duration: float
) -> tuple[np.ndarray, np.ndarray]:
    """What is measured of a falling chain at each tick, and its state there."""
    builder = DiagramBuilder()
    plant, _ = add_plant(builder, chain_urdf("zyz"), time_step=time_step)
    port = AddMeasurement(builder, plant, disturbances, period)
    zero = builder.AddSystem(ConstantVectorSource(np.zeros(3)))
    builder.Connect(zero.get_output_port(), plant.get_actuation_input_port())
    # As the controller's ticks where the plant's step is another.
    tick = period if period == time_step or not time_step else period * (1.0 - 4e-15)
    readers = []
    for source in (port, plant.get_state_output_port()):
        reader = builder.AddSystem(Reader(6, tick))
        builder.Connect(source, reader.get_input_port())
        readers.append(reader)
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetPositions(context, START)
    simulator.AdvanceTo(duration)
    measured, state = (np.array(reader.seen) for reader in readers)
    assert len(measured) == pytest.approx(duration / period, abs=1.0)
    return measured, state


@pytest.mark.parametrize("periods", [1, 3])
@pytest.mark.parametrize(
    "time_step, period",
    [(STEP, STEP), (STEP, 5 * STEP), (2.5e-3, 12.5e-3), (0.0, STEP), (0.0, 5 * STEP)],
)
def test_delay_is_of_exactly_so_many_periods(time_step, period, periods):
    """Also where multiples of the period and of the plant's step round apart."""
    measured, state = measure(
        Disturbances(delay_periods=periods), time_step, period, 300 * period
    )
    np.testing.assert_array_equal(measured[periods:], state[:-periods])
    np.testing.assert_array_equal(measured[:periods], [state[0]] * periods)
    assert (np.abs(np.diff(state, axis=0)).max(axis=1) > 0.0).all()


def test_noise_is_of_the_stated_deviation_and_white():
    measured, state = measure(EVERYTHING, STEP, 5 * STEP, 10.0)
    noise = measured - state
    for part, deviation in ((noise[:, :3], 1e-3), (noise[:, 3:], 5e-2)):
        assert part.std(axis=0) == pytest.approx(deviation, rel=0.08)
        assert np.abs(part.mean(axis=0)).max() < 4.0 * deviation / np.sqrt(len(part))
        following = (part[1:] * part[:-1]).mean(axis=0) / deviation**2
        assert np.abs(following).max() < 0.1
    across = np.corrcoef(noise.T) - np.eye(6)
    assert np.abs(across).max() < 0.1


def test_noise_is_a_function_of_its_seed():
    def noise(seed: int) -> np.ndarray:
        disturbances = Disturbances(position_noise=1e-3, noise_seed=seed)
        measured, state = measure(disturbances, STEP, STEP, 0.02)
        np.testing.assert_array_equal(measured[:, 3:], state[:, 3:])
        return measured[:, :3] - state[:, :3]

    first = noise(1)
    np.testing.assert_array_equal(first, noise(1))
    assert np.abs(first - noise(2)).min() > 0.0


def test_noise_comes_on_top_of_delay():
    late = Disturbances(position_noise=1e-3, delay_periods=2)
    measured, state = measure(late, STEP, STEP, 0.05)
    np.testing.assert_array_equal(measured[2:, 3:], state[:-2, 3:])
    assert np.abs(measured[2:, :3] - state[:-2, :3]).std() == pytest.approx(
        1e-3 * np.sqrt(1.0 - 2.0 / np.pi), rel=0.25
    )


def test_nothing_lies_between_where_nothing_is_wrong():
    builder = DiagramBuilder()
    plant, _ = add_plant(builder, chain_urdf("z"))
    port = AddMeasurement(builder, plant, Disturbances(mass_scale=1.2), STEP)
    assert port is plant.get_state_output_port()


@pytest.mark.parametrize("scale", [0.8, 1.2])
def test_masses_are_scaled_and_nothing_else(scale):
    plant, _ = add_plant(DiagramBuilder(), chain_urdf("zyx", rail="y", damping=0.3))
    context, other = plant.CreateDefaultContext(), plant.CreateDefaultContext()
    q, v = np.array([0.1, 0.3, -0.4, 0.8]), np.array([0.5, -1.0, 2.0, 0.3])
    for each in (context, other):
        plant.SetPositions(each, q)
        plant.SetVelocities(each, v)
    ScaleMasses(plant, context, scale)

    def compare(function, factor: float) -> None:
        ours, theirs = function(context), function(other)
        assert np.abs(theirs).max() > 0.01
        np.testing.assert_allclose(ours, factor * theirs, rtol=1e-12, atol=1e-14)

    compare(plant.CalcMassMatrix, scale)
    compare(plant.CalcBiasTerm, scale)
    compare(plant.CalcGravityGeneralizedForces, scale)
    compare(plant.CalcCenterOfMassPositionInWorld, 1.0)
    tip = plant.GetFrameByName("tip")
    compare(lambda c: tip.CalcPoseInWorld(c).GetAsMatrix4(), 1.0)


@pytest.mark.parametrize("frame", ["tip", "hand", "l1"])
def test_push_accelerates_by_its_generalised_force(frame):
    """M^-1 J^T f, from its start on and up to its end, whatever the frame is called."""
    force = np.array([5.0, -20.0, 50.0])
    builder = DiagramBuilder()
    plant, _ = add_plant(builder, chain_urdf("zyz"), time_step=0.0)
    pushes = builder.AddSystem(
        PushSource(plant, {"hand": "tip"}, [Push(frame, force.tolist(), 0.5, 0.25)])
    )
    builder.Connect(
        pushes.get_output_port(), plant.get_applied_spatial_force_input_port()
    )
    zero = builder.AddSystem(ConstantVectorSource(np.zeros(3)))
    builder.Connect(zero.get_output_port(), plant.get_actuation_input_port())
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    plant.SetPositions(context, START)
    plant.SetVelocities(context, [0.3, 0.2, -0.5])

    def acceleration(time: float) -> np.ndarray:
        root.SetTime(time)
        port = plant.get_generalized_acceleration_output_port()
        return port.Eval(context).copy()

    W = plant.world_frame()
    J = plant.CalcJacobianTranslationalVelocity(
        context,
        JacobianWrtVariable.kV,
        plant.GetFrameByName({"hand": "tip"}.get(frame, frame)),
        np.zeros(3),
        W,
        W,
    )
    expected = np.linalg.solve(plant.CalcMassMatrix(context), J.T @ force)
    assert np.abs(expected).max() > 10.0
    free = acceleration(0.0)
    for time, share in ((0.499, 0), (0.5, 1), (0.7, 1), (0.75, 0), (2.0, 0)):
        np.testing.assert_allclose(
            acceleration(time) - free, share * expected, rtol=1e-9, atol=1e-9
        )


def test_two_pushes_at_once_add_up():
    builder = DiagramBuilder()
    plant, _ = add_plant(builder, chain_urdf("zz"))
    pushes = [Push("tip", [1.0, 0, 0], 0.0, 2.0), Push("l0", [0, 2.0, 0], 1.0, 2.0)]
    source = PushSource(plant, {}, pushes)
    context = source.CreateDefaultContext()
    active = {}
    for time in (0.5, 1.5, 2.5, 3.5):
        context.SetTime(time)
        forces = source.get_output_port().Eval(context)
        active[time] = [tuple(f.F_Bq_W.translational()) for f in forces]
    assert active == {
        0.5: [(1.0, 0.0, 0.0)],
        1.5: [(1.0, 0.0, 0.0), (0.0, 2.0, 0.0)],
        2.5: [(0.0, 2.0, 0.0)],
        3.5: [],
    }


def test_push_on_a_frame_that_is_not_there():
    plant, _ = add_plant(DiagramBuilder(), chain_urdf("z"))
    with pytest.raises(ModelError, match="elbow"):
        PushSource(plant, {"wrist": "tip"}, [Push("elbow", [1.0, 0, 0], 0.0, 1.0)])


def test_target_jump_moves_positions_while_it_lasts():
    layout = TaskLayout(("hand", "head", "tool"), ("position", "orientation", "pose"))
    rng = np.random.default_rng(0)
    p, R = rng.normal(size=(2, 3)), np.array([np.eye(3)] * 2)
    tasks = layout.pack(R, p)
    jump = np.array([1.0, -2.0, 0.5])
    step = TargetStep(layout, TargetJump(jump.tolist(), 0.5, 0.25))
    context = step.CreateDefaultContext()
    step.get_input_port().FixValue(context, tasks)
    for time, share in ((0.0, 0), (0.499, 0), (0.5, 1), (0.74, 1), (0.75, 0)):
        context.SetTime(time)
        displaced = step.get_output_port().Eval(context)
        np.testing.assert_allclose(displaced, layout.pack(R, p + share * jump))
    assert not np.allclose(tasks, layout.pack(R, p + jump))


@pytest.mark.parametrize(
    "disturbances, name",
    [
        (Disturbances(mass_scale=0.0), "mass_scale"),
        (Disturbances(mass_scale=float("nan")), "mass_scale"),
        (Disturbances(position_noise=-1e-3), "position_noise"),
        (Disturbances(velocity_noise=float("inf")), "velocity_noise"),
        (Disturbances(noise_seed=-1), "noise_seed"),
        (Disturbances(delay_periods=-1), "delay_periods"),
        (Disturbances(delay_periods=1.5), "delay_periods"),
        (Disturbances(pushes=[Push("tip", [1.0, 2.0])]), "push on tip: force"),
        (Disturbances(pushes=[Push("tip", start=-1.0)]), "push on tip.start"),
        (
            Disturbances(target_jump=TargetJump([0, 0, float("nan")])),
            "target_jump.offset",
        ),
        (Disturbances(target_jump=TargetJump(duration=-1.0)), "target_jump.duration"),
    ],
)
def test_bad_values_are_named(disturbances, name):
    with pytest.raises(ScenarioError, match=rf"disturbances\.{name}"):
        disturbances.validate()


def test_good_values_pass():
    Disturbances().validate()
    push = Push("tip", [50.0, 0.0, 0.0], 1.0, 0.2)
    Disturbances(0.8, 1e-3, 0.05, 7, 2, [push], TargetJump([1, 0, 0])).validate()
