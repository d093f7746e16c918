"""A robot that follows its command within a bound keeps what the command keeps.

That a robot which errs by all it may stays clear is in `tests/acceptance`; here stands
what an error takes of distances, and what is refused.
"""

import numpy as np
import pytest
from moving_shapes import MovingShapes, shapes_of_every_joint
from pydrake.systems.framework import DiagramBuilder
from small_robots import LINK, add_plant, chain_urdf, make_model

from crar_drake import position_tasks
from crar_drake.errors import ScenarioError
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import LookaheadParameters, PaperGains
from crar_drake.law.tracking_error import distance_losses
from crar_drake.robot.description import RobotDescription, load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

PERIOD = 0.01


def shipped(name: str, frames: list[str]) -> ControlModel:
    return ControlModel.FromDescription(
        load_robot_description(name), position_tasks(frames)
    )


def law_of(model: ControlModel, **ahead) -> ControlLaw:
    parameters = LookaheadParameters(
        period=PERIOD, blend_time=0.0, effort_limits=False, **ahead
    )
    return ControlLaw(model, parameters)


def commands(law: ControlLaw, steps: int, seed: int):
    """Yields the states that the law, on its own command, leads to: (q, v), from rest.

    Every 40 steps all targets jump into a shape that a pair is watched of, and what is
    prescribed jumps, too.
    """
    model, rng = law.model, np.random.default_rng(seed)
    shapes = MovingShapes.of(model)
    q, v = model.rest_positions(), np.zeros(model.plant.num_velocities())
    R, still = model.layout.unpack(model.tasks_at(q)).R, model.prescribed_at(q)
    for step in range(steps):
        if step % 40 == 0:
            ends = shapes.ends(q[model.order])[rng.integers(2)]
            into = ends[rng.integers(len(ends))].mean(axis=0)
            targets = into + 0.02 * rng.normal(size=(len(model.layout.linear_tasks), 3))
            tasks, prescribed = model.layout.pack(R, targets), still.copy()
            jump = rng.uniform(-0.1, 0.6, model.n_p)
            prescribed[: model.n_p] += jump
        solution = law.step(q, v, tasks, prescribed)
        assert solution.admission[3] == 1.0
        q, v = np.split(solution.position_command, [len(q)])
        yield q, v


@pytest.mark.parametrize("nominal", [None, PaperGains()], ids=["plan", "paper"])
def test_no_error_changes_nothing(nominal):
    """To the last bit; and one does."""
    model = shipped("upper_body", ["left_wrist", "right_wrist"])

    def states(**more) -> np.ndarray:
        law = law_of(model, nominal=nominal, **more)
        return np.array([np.concatenate(x) for x in commands(law, 40, 1)])

    without = states()
    zeros = {name: 0.0 for name in ("left_elbow", "torso_yaw")}
    for more in ({"tracking_error": 0.0}, {"tracking_errors": zeros}):
        np.testing.assert_array_equal(states(**more), without)
    assert np.abs(states(tracking_error=5e-3) - without).max() > 1e-4


def test_no_error_takes_more_of_a_distance_than_the_sum_says():
    """Joints of every kind, slides beyond their limits by their error, ..."""
    shapes = shapes_of_every_joint(shipped("obstacle_arm", ["tool"]).robot.value)
    rng = np.random.default_rng(3)
    nv = len(shapes.order)
    share = 0.0
    for _ in range(300):
        E = 0.1 * rng.uniform(0.0, 1.0, nv) * rng.choice([0.0, 1.0], nv)
        losses = distance_losses(E, shapes.reaches)
        q = shapes.random_configuration(rng)
        extremes = rng.random((40, nv)) < 0.5
        errors = E * np.where(extremes, -1.0, 1.0)
        d = shapes.distances(np.concatenate((q[None], q + errors)))
        taken = d[0] - d[1:].min(axis=0)
        assert (taken <= losses + 1e-12).all()
        share = max(share, (taken / np.maximum(losses, 1e-3)).max())
    assert 0.5 < share  # nor does the sum say much more


@pytest.mark.parametrize(
    "joint, of_post, of_base",
    [
        ("j4", LINK - 0.05, LINK - 0.05),  # the capsule's axis ends 5 cm before the tip
        ("j3", 2 * LINK - 0.05, 2 * LINK - 0.05),
        ("j0", 5 * LINK - 0.05, 0.0),  # carries both shapes of the second pair
        ("rail", 1.0, 0.0),
    ],
)
def test_by_hand(joint, of_post, of_base):
    model = make_model(
        chain_urdf("zyzyz", rail="y"),
        prescribed_joints={"rail": "hold"},
        pairs=[["l4", "post"], ["l4", "l0"]],
    )
    radii = []
    for given in ({}, {"tracking_errors": {joint: 1e-3}}):
        shapes = law_of(model, **given)._constraints.pairs.shapes.value
        radii.append(shapes.robot.value.pairs.value.radii)
    expected = 1e-3 * np.array([of_post, of_base])
    np.testing.assert_allclose(radii[1] - radii[0], expected, atol=1e-12)


@pytest.mark.parametrize(
    "given, words",
    [
        ({"tracking_error": 0.2}, ["in the rest posture", "mm apart", "lower all"]),
        ({"tracking_error": 3.0}, ["joint1", "leaves nothing between its limits"]),
        ({"tracking_errors": {"elbow": 0.1}}, ["tracking_errors.elbow", "elbow"]),
        ({"tracking_errors": {"joint1": -0.1}}, ["joint1", "not negative"]),
        ({"tracking_error": np.inf}, ["tracking_error", "finite"]),
    ],
)
def test_errors_that_cannot_be_are_refused(given, words):
    model = shipped("obstacle_arm", ["tool"])
    with pytest.raises(ScenarioError) as caught:
        parameters = LookaheadParameters(**given)
        parameters.validate()
        ControlLaw(model, parameters)
    for word in words:
        assert word in str(caught.value)


def test_what_is_refused_names_an_error_that_is_not():
    """Just above the share that the message names it is refused, just below not."""
    model = shipped("obstacle_arm", ["tool"])
    E = 0.2
    with pytest.raises(ScenarioError) as caught:
        law_of(model, tracking_error=E)
    share = float(str(caught.value).split("lower all errors to ")[1].split()[0])
    law_of(model, tracking_error=0.97 * share * E)
    with pytest.raises(ScenarioError, match="rest posture"):
        law_of(model, tracking_error=1.03 * share * E)


def test_a_slide_without_limits_is_refused_if_what_carries_it_errs():
    urdf = chain_urdf("zyz").replace('"j1" type="revolute"', '"j1" type="prismatic"')
    plant, scene_graph = add_plant(DiagramBuilder(), urdf)
    plant.GetJointByName("j1").set_position_limits([-np.inf], [np.inf])
    pairs = RobotDescription(pairs=[["l2", "post"]])
    model = ControlModel.FromPlant(plant, scene_graph, pairs, [Task(frame="tip")])
    with pytest.raises(ScenarioError, match="joint j1 slides without limits"):
        law_of(model, tracking_error=0.01)
    law_of(model, tracking_errors={"j1": 0.01, "j2": 0.01})  # nor do these carry it
