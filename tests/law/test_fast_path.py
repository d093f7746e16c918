"""The control law computes what its equations say: against a plain one, at random."""

import numpy as np
import pytest
from plain_control_law import PlainControlLaw, PlainKinematics
from scipy.spatial.transform import Rotation
from small_robots import chain_urdf, make_model, state_about_the_limits

from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import PaperParameters
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import EXPERIMENTS, Task, position_tasks

TASKS = {
    "wrists": ("upper_body", position_tasks(EXPERIMENTS["wrists"])),
    "upper-body": ("upper_body", position_tasks(EXPERIMENTS["upper-body"])),
    "hand poses": (
        "upper_body",
        [
            Task(
                frame="left_wrist",
                kind="pose",
                point=[0.02, -0.01, 0.05],
                orientation_weight=0.2,
            ),
            Task(frame="right_wrist", kind="orientation"),
            Task(frame="neck", position_weight=0.5),
        ],
    ),
    "tool pose": (
        "obstacle_arm",
        [Task(frame="tool", kind="pose", orientation_weight=0.3)],
    ),
}
MODES = {
    "none, velocity": {"constraints": "none", "level": "velocity"},
    "none, acceleration": {"constraints": "none"},
    "paper, velocity": {"level": "velocity"},
    "paper, acceleration": {},
    "paper, inertia": {"metric": "inertia"},
}
STATES = 18
RAIL = "on a rail"  # a prescribed joint that moves the robot past an obstacle


@pytest.fixture(scope="module", params=[*TASKS, RAIL])
def kinematics(request) -> PlainKinematics:
    if request.param == RAIL:
        model = make_model(
            chain_urdf("zyzyz", rail="y", damping=0.4, limits=(-1.2, 1.3)),
            [Task(frame="tip", kind="pose", orientation_weight=0.4)],
            prescribed_joints={"rail": "hold"},
            pairs=[["l1", "post"], ["l3", "post"], ["l4", "post"], ["l4", "l0"]],
        )
        return PlainKinematics(model)
    robot, tasks = TASKS[request.param]
    return PlainKinematics(
        ControlModel.FromDescription(load_robot_description(robot), tasks)
    )


def random_states(model: ControlModel, period: float, seed: int):
    """Three consecutive states anywhere, some beyond limits, most with penetrations,
    and targets around them."""
    rng = np.random.default_rng(seed)
    q, v = state_about_the_limits(model, rng, 1.0)
    layout = model.layout
    state = model.evaluate(model.MakeWorkspace(), q, v)
    for _ in range(3):
        turned = Rotation.from_rotvec(0.5 * rng.normal(size=(len(state.R), 3)))
        desired = layout.pack(
            turned.as_matrix() @ state.R,
            state.p + 0.05 * rng.normal(size=state.p.shape),
            rng.normal(size=model.m),
            5.0 * rng.normal(size=model.m),
        )
        prescribed = np.concatenate(
            [
                state.q_p + 0.01 * rng.normal(size=model.n_p),
                rng.normal(size=model.n_p),
                5.0 * rng.normal(size=model.n_p),
            ]
        )
        yield q, v, desired, prescribed
        q = q + period * v
        v = v + period * 10.0 * rng.normal(size=len(v))


def deviation(fast: np.ndarray, plain: np.ndarray) -> float:
    """The largest difference, relative to the largest entry."""
    if not np.isfinite(plain).all():
        np.testing.assert_array_equal(fast, plain)
        return 0.0
    return float(np.abs(fast - plain).max() / np.abs(plain).max())


FIELDS = (
    "actuation",
    "acceleration",
    "task_error",
    "signed_distances",
    "constraint_weights",
    "constrained_velocity",
)


@pytest.mark.parametrize("mode", MODES)
def test_the_fast_path_is_the_plain_one(kinematics, mode):
    """To 1e-9; to 1e-8 where a weight is or was above 1e6.

    Weights are that large in deep penetration or at a limit: the slope of the
    potential, up to 2e9 per metre, multiplies the last bit of a distance's gradient,
    which is rounding in either path.
    """
    model = kinematics.model
    parameters = PaperParameters(**MODES[mode], blend_time=0.0)
    bounds, heaviest = [], 0.0
    for seed in range(STATES):
        fast = ControlLaw(model, parameters)
        plain, largest = PlainControlLaw(kinematics, parameters), 0.0
        for given in random_states(model, parameters.period, seed):
            solution, expected = fast.step(*given), plain.step(*given)
            largest = max(largest, expected.constraint_weights.max())
            bounds.append(1e-9 if largest < 1e6 else 1e-8)
            for name in FIELDS:
                found = deviation(getattr(solution, name), getattr(expected, name))
                assert found < bounds[-1], (name, seed, largest)
        heaviest = max(heaviest, largest)
    assert bounds.count(1e-9) >= STATES
    # The constraints had their say, in the states they are for as well.
    assert heaviest == 1.0 if parameters.constraints == "none" else heaviest > 1e4
