"""What a step is handed is what it takes."""

import numpy as np
import pytest
from small_robots import chain_urdf, make_model, random_state

from crar_drake.equations.handover import hand_over, take_over
from crar_drake.equations.kinematics import Measured
from crar_drake.equations.lookahead_rows import resting_configuration, with_resting
from crar_drake.equations.references import BlendStart, Targets
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

TASKS = [
    Task(frame="tip", kind="pose"),
    Task(frame="l2", kind="orientation"),
    Task(frame="l3"),
    Task(kind="joint", joint="j2"),
]


def chain(**changes) -> ControlModel:
    return make_model(chain_urdf("zyzyz"), TASKS, **changes)


@pytest.mark.parametrize("prescribed", [{}, {"j1": "hold", "j4": "hold"}])
@pytest.mark.parametrize("posture", [False, True])
def test_every_number_comes_out_where_it_went_in(prescribed, posture: bool) -> None:
    """All are different, so that none can stand in for another."""
    model = chain(prescribed_joints=prescribed)
    numbers = iter(range(10_000))

    def some(*shape: int) -> np.ndarray:
        count = int(np.prod(shape))
        return np.array([next(numbers) for _ in range(count)], float).reshape(shape)

    nq, nv = len(model.positions), len(model.order)
    measured = Measured(some(2, nq), some(nv), np.zeros((0, 7)))
    layout = model.layout
    start = BlendStart(
        some(len(layout.angular_tasks), 3, 3),
        some(len(layout.linear_tasks), 3),
        some(len(model.prescribed_positions)),
        some(len(layout.joint_rows)),
    )
    targets = Targets(
        some(layout.size),
        some(3 * model.n_p),
        some(model.n) if posture else np.zeros(0),
        start,
        (0.25, 0.5, 0.75),
    )
    q, v, asked, *handed = hand_over(measured, targets)
    np.testing.assert_array_equal(q, measured.q[0])
    np.testing.assert_array_equal(v, measured.v)
    np.testing.assert_array_equal(asked, measured.asked)
    found = take_over(*handed)
    assert tuple(found.blend) == targets.blend
    for name in ("tasks", "prescribed", "posture"):
        np.testing.assert_array_equal(getattr(found, name), getattr(targets, name))
    for name in BlendStart._fields:
        np.testing.assert_array_equal(getattr(found.start, name), getattr(start, name))


def test_both_configurations_are_in_the_plants_order() -> None:
    """The one that was handed over, and where it leads to when braking."""
    model = chain(prescribed_joints={"j1": "hold"})
    q, v = random_state(model, 2)
    here, there = with_resting(q, v, model.robot_by_pair.value, 0.15)
    np.testing.assert_array_equal(here, q)
    in_order = resting_configuration(*model.in_order(q, v), 0.15)
    np.testing.assert_array_equal(there[model.positions], in_order)
