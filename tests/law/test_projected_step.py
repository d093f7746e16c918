"""The step: whatever the nominal, nothing is violated, nor gets worse.

Distances are the referee's, at dense samples of the braking paths.
"""

import numpy as np
import pytest
from grounded_robots import above_ground
from moving_shapes import MovingShapes
from pydrake.systems.framework import DiagramBuilder
from small_robots import add_plant, chain_urdf, make_model

from crar_drake import EXPERIMENTS, PaperGains, position_tasks
from crar_drake.judging.referee import Referee
from crar_drake.law.constraints import Braking
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.law.step import SCALED
from crar_drake.robot.description import RobotDescription, load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

T = 2.5 / 30.0  # as long a braking path as there is by default [s]


def safe_paper(period: float, **changes) -> LookaheadParameters:
    given = {"blend_time": 0.0, "nominal": PaperGains(), **changes}
    return LookaheadParameters(period=period, **given)


@pytest.mark.parametrize("period", [0.02, 5e-3])
def test_the_papers_law_goes_under_the_projection(period):
    """The arm is sent through its post: it keeps 4 mm, by SceneGraph, and moves."""
    model = make("obstacle_arm")
    law, rest = ControlLaw(model, safe_paper(period)), model.rest_positions()
    q, v, start = rest, np.zeros(len(rest)), model.tasks_at(rest)
    way = np.array([1.5, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    least, tool = np.inf, [start[4:7]]
    for k in range(300):
        target = model.tasks_at(rest + min(1.0, k * period) * way)
        solution = law.step(q, v, target)
        q_next, v = np.split(solution.position_command, 2)
        for share in (0.5, 1.0):
            d = model.signed_distances(q + share * (q_next - q))
            least = min(least, d.min())
        q = q_next
        tool.append(model.tasks_at(q)[4:7])
    assert least >= 4e-3 - 1e-6
    assert np.linalg.norm(np.array(tool) - tool[0], axis=1).max() > 0.2


# --- steps from clear states lead to clear states ----------------------------------


def on_a_rail() -> ControlModel:
    """A prescribed joint drives the robot past, and into, an obstacle."""
    return make_model(
        chain_urdf("zyzyz", rail="y", limits=(-1.2, 1.3)),
        [Task(frame="tip", kind="pose", orientation_weight=0.4)],
        prescribed_joints={"rail": "hold"},
        pairs=[["l1", "post"], ["l3", "post"], ["l4", "post"], ["l4", "l0"]],
    )


def narrow() -> ControlModel:
    """Joints with a range of a milliradian, with one limit, and with none."""
    plant, scene_graph = add_plant(DiagramBuilder(), chain_urdf("zyzyz"))
    for name, bounds in {
        "j0": (-5e-4, 5e-4),
        "j1": (-np.inf, 0.3),
        "j2": (-0.2, np.inf),
        "j3": (-np.inf, np.inf),
    }.items():
        joint = plant.GetJointByName(name)
        joint.set_position_limits(*(np.array([bound]) for bound in bounds))
    return ControlModel.FromPlant(
        plant,
        scene_graph,
        RobotDescription(pairs=[["l3", "post"], ["l4", "post"], ["l4", "l0"]]),
        [Task(frame="tip")],
    )


def make(name: str) -> ControlModel:
    made = {"rail": on_a_rail, "narrow": narrow, "ground": above_ground}
    if name in made:
        return made[name]()
    tasks, step = [Task(frame="tool", kind="pose")], 1e-3
    if name == "upper_body":
        tasks = position_tasks(EXPERIMENTS["upper-body"])
    if name == "continuous arm":
        name, step = "obstacle_arm", 0.0
    robot = load_robot_description(name)
    return ControlModel.FromDescription(robot, tasks, time_step=step)


class Judge:
    """Whether braking paths are clear and within limits: by the referee's distances."""

    def __init__(self, model: ControlModel, floor: float) -> None:
        self.model, self.floor = model, floor
        pairs = model.description.pairs
        self.referee = Referee(model.plant, model.scene_graph, pairs)

    def worst(self, q, v, samples: int = 50) -> tuple[float, float]:
        """The smallest distance on the path, and by how much a limit is passed."""
        c = self.model.controlled
        path = q + np.linspace(0.0, T, samples)[:, None] * v
        d = self.referee.violations(path).smallest_distance
        return d, max(self.referee.limit_excess(x)[c].max() for x in path[[0, -1]])

    def is_clear(self, q, v) -> bool:
        d, excess = self.worst(q, v)
        return d >= self.floor + 1e-3 and excess == 0.0


def clear_state(model: ControlModel, judge: Judge, rng: np.random.Generator):
    """About the rest posture, and so fast that the path is just clear, or 20 rad/s."""
    rest, c = model.rest_positions(), model.controlled
    lower, upper = np.maximum(model.lower, -2.0), np.minimum(model.upper, 2.0)
    while True:
        q = rest + 0.02 * rng.normal(size=len(rest))
        share = rng.uniform(0.0, 0.7)
        q[c] = (1.0 - share) * rest[c] + share * rng.uniform(lower, upper)
        room = 0.05 * (upper - lower)
        q[c] = np.clip(q[c], lower + room, upper - room)
        if judge.is_clear(q, np.zeros(len(q))):
            break
    v = rng.normal(size=len(q)) * rng.choice([0.3, 3.0, 30.0])
    # Each joint alone within its limits, and then all so slow that nothing is near.
    room = np.where(v[c] > 0.0, model.upper - q[c], q[c] - model.lower)
    v[c] = np.sign(v[c]) * np.minimum(np.abs(v[c]), 0.999 * np.minimum(room / T, 20.0))
    if judge.is_clear(q, v):
        return q, v
    slow, fast = 0.0, 1.0
    for _ in range(10):
        middle = 0.5 * (slow + fast)
        slow, fast = (middle, fast) if judge.is_clear(q, middle * v) else (slow, middle)
    return q, slow * v


def next_state(model: ControlModel, q, v, a, period: float):
    step = min(model.plant.time_step(), period)
    return q + period * v + 0.5 * period * (period + step) * a, v + period * a


PERIODS = {
    "upper_body": (1e-3, 0.02),
    "obstacle_arm": (0.01,),
    "continuous arm": (5e-3,),
    "rail": (0.01,),
    "narrow": (5e-3,),
    "ground": (0.01,),
}
CASES = [(robot, period) for robot, periods in PERIODS.items() for period in periods]


@pytest.mark.parametrize(("robot", "period"), CASES)
def test_steps_from_clear_states_lead_to_clear_states(robot, period):
    """Of nominals of any size that know of nothing."""
    model = make(robot)
    gains = safe_paper(period, effort_limits=False)
    constraints = ControlLaw(model, gains)._constraints
    judge, n, changed = Judge(model, gains.safety_distance), model.n, 0
    for start in range(5):
        rng, braking = np.random.default_rng(start), Braking()
        q, v = clear_state(model, judge, rng)
        for k in range(10):
            if k % 5 == 0:
                s = rng.normal(size=len(q)) * 10.0 ** rng.uniform(0.0, 2.2)
            at, rate = model.in_order(q, v)
            state = constraints.state(
                *(at, rate, braking, lambda T, s=s: s[:n]),
                prescribed_acceleration=(s[n:] - rate[n:]) / T,
                keep_rows=True,
            )
            assert state.T == T
            found, _, _, braking = constraints.step(state, braking)
            assert constraints.pairs.present_is_clear
            assert found.how == SCALED or found.share == 1.0
            changed += np.abs(found.s - s).max() > 1e-6
            _, a = model.in_plant(at, (found.s - rate) / T)
            q, v = next_state(model, q, v, a, period)
            nearest, beyond = judge.worst(q, v)
            assert nearest >= judge.floor - 1e-9 and beyond <= 1e-9
    assert changed > 20


def wishes(model: ControlModel, q, rng: np.random.Generator):
    """Targets metres away, at a million radians per second, and near ones."""
    layout, m = model.layout, model.m
    state = model.evaluate(model.MakeWorkspace(), q, np.zeros(len(q)))
    away = rng.choice([0.02, 0.3, 5.0])
    fast = rng.choice([0.0, 1.0, 1e6])
    tasks = layout.pack(
        state.R,
        state.p + away * rng.normal(size=state.p.shape),
        fast * rng.normal(size=m),
        rng.choice([0.0, 10.0, 1e4]) * rng.normal(size=m),
    )
    n_p = model.n_p
    prescribed = np.concatenate(
        [
            q[model.prescribed] + rng.choice([0.0, 0.1, 1.0]) * rng.normal(size=n_p),
            rng.choice([0.0, 3.0]) * rng.normal(size=n_p),
            np.zeros(n_p),
        ]
    )
    return tasks, prescribed


@pytest.mark.parametrize(
    ("robot", "period"), [("upper_body", 0.02), ("obstacle_arm", 0.01), ("rail", 0.01)]
)
def test_a_start_in_violation_does_not_get_worse(robot, period):
    """From states anywhere: on each next path every pair of shapes keeps the safety
    distance or what it has on the present one, and no limit is passed farther."""
    model, gains = make(robot), safe_paper(period)
    shapes, judge = MovingShapes.of(model), Judge(model, gains.safety_distance)
    order = shapes.order
    for start in range(3):
        rng = np.random.default_rng([7, start])
        law, before = ControlLaw(model, gains), np.ones(1)
        while not -0.1 < before.min() < 0.0:
            q, v = np.empty(len(order)), 2.0 * rng.normal(size=len(order))
            q[order] = shapes.random_configuration(rng)
            before = shapes.on_path(q[order], (q + T * v)[order], 100)
        _, excess = judge.worst(q, v, samples=2)
        wish = wishes(model, q, rng)
        for _ in range(10):
            a = law.step(q, v, *wish).acceleration
            q, v = next_state(model, q, v, a, period)
            after = shapes.on_path(q[order], (q + T * v)[order], 100)
            between = np.abs(np.diff(before, axis=0)).max(axis=0)
            level = np.minimum(judge.floor, before.min(axis=0) - between)
            assert (after.min(axis=0) >= level - 1e-9).all()
            _, beyond = judge.worst(q, v, samples=2)
            assert beyond <= excess + 1e-9
            before, excess = after, max(beyond, 0.0)


def test_another_margin_is_kept():
    """That of the defaults would not be enough."""
    model, smallest = on_a_rail(), np.inf
    gains = safe_paper(0.01, margin=0.026)
    judge = Judge(model, gains.safety_distance)
    for start in range(3):
        rng = np.random.default_rng(start)
        q, v = clear_state(model, judge, rng)
        law = ControlLaw(model, gains)
        tasks, prescribed = wishes(model, q, rng)
        prescribed[0] = 0.9
        for _ in range(25):
            a = law.step(q, v, tasks, prescribed).acceleration
            q, v = next_state(model, q, v, a, 0.01)
            smallest = min(smallest, judge.worst(q, v)[0])
    assert 0.025 - 1e-9 <= smallest < 0.05
