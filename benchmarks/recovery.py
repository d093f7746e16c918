"""Starts in a violation: how fast, and how gently, the lookahead leaves it.

python -m benchmarks.recovery [--preview S] [--page docs/measurements/recovery.md]
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.systems.primitives import ConstantVectorSource

from benchmarks.options import (
    add_preview_option,
    defaults_or_preview,
    lookahead_defaults,
)
from benchmarks.page import Benchmark, Table, run
from crar_drake.errors import CrarError, nearest
from crar_drake.results.log import SimulationLog
from crar_drake.results.summary import controlled_joints
from crar_drake.robot.description import LIMIT_TOLERANCE
from crar_drake.robot.model import ControlModel
from crar_drake.run import make_log
from crar_drake.simulation.diagram import (
    MakeCrarDiagram,
    MakeSimulator,
    PrepareScenario,
    Setup,
)
from crar_drake.simulation.scenario import Scenario
from crar_drake.targets.desired_motion import DesiredMotion

PENETRATION = 0.015  # [m]
EXCESS = np.deg2rad(5.0)  # [rad]
_DURATION = 2.0  # [s]
_SETTLED = 0.5  # [s] by which a violation must have been left


@dataclass(frozen=True)
class Start:
    """A start in violation.

    Attributes:
        name: what is violated.
        pairs: pairs that penetrate by PENETRATION.
        joints: joints that are EXCESS beyond the limit, with its side (+1 upper).
        inside: whether the targets stay where the violation is; else they are
            those of the rest posture.
    """

    name: str
    pairs: tuple[str, ...] = ()
    joints: tuple[tuple[str, int], ...] = ()
    inside: bool = True


@dataclass(frozen=True)
class Recovery:
    """How a start in violation was left.

    Attributes:
        start: it.
        depth: penetration at the start [m]; excess: beyond limits [rad].
        time: until no constraint is violated any more, for good [s]; inf if never.
        effort_share: largest |torque| over its joint's effort limit, until then.
        later_effort_share: the same, afterwards, on the way to the target.
        smallest_distance: from `_SETTLED` on [m].
    """

    start: Start
    depth: float
    excess: float
    time: float
    effort_share: float
    later_effort_share: float
    smallest_distance: float


STARTS = (
    Start("hand in the torso", pairs=("left_hand - torso",)),
    Start("hand in hand", pairs=("left_hand - right_hand",)),
    Start(
        "hand in hand and a hand in the torso",
        pairs=("left_hand - right_hand", "left_hand - torso"),
    ),
    Start("hand in the head", pairs=("right_hand - head",)),
    Start("left elbow beyond its limit", joints=(("left_elbow", -1),)),
    Start(
        "an elbow, a shoulder and the torso beyond their limits",
        joints=(("right_elbow", -1), ("left_shoulder_yaw", 1), ("torso_pitch", 1)),
    ),
)


def violating_posture(model: ControlModel, start: Start) -> np.ndarray:
    """Positions (nq,) that violate what `start` says, and nothing else.

    From random postures (the same ones every time), Newton's steps along the
    gradients of the named pairs' distances, all at once; the first posture in which
    every other pair keeps a centimetre is taken.

    Raises:
        CrarError: there is no such pair or joint, or no such posture was found, so
            that the start asks for the impossible.
    """
    names = [f"{a} - {b}" for a, b in model.pairs.names]
    for known, wanted in (
        (names, start.pairs),
        (model.joint_names, [joint for joint, _ in start.joints]),
    ):
        for name in wanted:
            if name not in known:
                raise CrarError(f"start {start.name!r}: {name}{nearest(name, known)}")
    rows = np.array([names.index(pair) for pair in start.pairs], dtype=int)
    others = np.setdiff1d(np.arange(len(names)), rows)
    joints = {model.joint_names.index(joint): side for joint, side in start.joints}
    rng = np.random.default_rng(0)
    c = model.controlled
    lower = np.maximum(model.lower + 0.05, -np.pi)
    upper = np.minimum(model.upper - 0.05, np.pi)
    workspace, still = model.MakeWorkspace(), np.zeros(len(model.order))
    for _ in range(2000):
        q = model.rest_positions()
        q[c] = rng.uniform(lower, upper)
        for i, side in joints.items():
            q[c[i]] = model.upper[i] + EXCESS if side > 0 else model.lower[i] - EXCESS
        near = model.evaluate(workspace, q, still)
        for _ in range(60 if len(rows) else 0):
            gap = near.d[rows] + PENETRATION
            if np.abs(gap).max() < 1e-6:
                break
            step = -np.linalg.pinv(near.dd_dq[rows]) @ gap
            step *= min(1.0, 0.1 / max(np.abs(step).max(), 1e-9))
            q[c] = np.clip(q[c] + step, lower, upper)
            near = model.evaluate(workspace, q, still)
        reached = np.abs(near.d[rows] + PENETRATION).max(initial=0.0) < 1e-6
        if reached and near.d[others].min() > 0.01:
            return q
    raise CrarError(f"no posture was found that has {start.name} and nothing else")


def recover(start: Start, base: Scenario) -> Recovery:
    """Simulates one start.

    Args:
        start: how it begins.
        base: robot, tasks and controller; its motion is replaced by a fixed target.
    """
    setup = PrepareScenario(base)
    model = setup.model
    q = violating_posture(model, start)
    aim = q if start.inside else model.rest_positions()
    there = model.evaluate(model.MakeWorkspace(), aim, np.zeros(len(q)))
    tasks = model.layout.pack(there.R, there.p)
    prescribed = model.prescribed_at(q)
    motion = DesiredMotion(
        _DURATION,
        lambda: ConstantVectorSource(tasks),
        lambda: ConstantVectorSource(prescribed),
    )
    setup = Setup(model, motion, q)
    diagram = MakeCrarDiagram(base, setup=setup)
    simulator = MakeSimulator(base, diagram)
    simulator.AdvanceTo(_DURATION)
    log = make_log(base, setup, diagram, simulator.get_context())
    return judge(start, log, model)


def judge(start: Start, log: SimulationLog, model: ControlModel) -> Recovery:
    """The figures of a run that began in violation."""
    joints = controlled_joints(log)
    excess = joints.excess.max(axis=1)
    smallest = log.signed_distances.min(axis=1)
    violated = np.flatnonzero((smallest < 0.0) | (excess > LIMIT_TOLERANCE))
    after = 0 if not len(violated) else violated[-1] + 1
    clear = after < len(log.time)
    efforts = model.effort_limits[model.controlled]
    share = (np.abs(joints.torque) / efforts).max(axis=1)
    return Recovery(
        start=start,
        depth=max(0.0, -float(smallest[0])),
        excess=max(0.0, float(excess[0])),
        time=float(log.time[after]) if clear else float("inf"),
        effort_share=float(share[: after + 1].max()),
        later_effort_share=float(share[after:].max()) if clear else float("nan"),
        smallest_distance=float(smallest[log.time >= _SETTLED].min()),
    )


def default_scenario(
    experiment: str = "upper-body", preview: float | None = None
) -> Scenario:
    """The upper body under the library's default constraints.

    Two seconds of blending, since a target far away is to be reached gently: what is
    judged is how the violation is left. With another preview [s], if one is given.
    """
    controller = lookahead_defaults(preview, blend_time=_DURATION)
    return Scenario(motion="dance", experiment=experiment, controller=controller)


def make_table(results: Sequence[tuple[str, Recovery]]) -> Table:
    """A row for each (experiment, recovery)."""
    return Table(
        [
            "start",
            "experiment",
            "target",
            "depth or excess",
            "left after",
            "peak torque / effort limit until then",
            "and later",
            f"smallest distance after {_SETTLED:g} s",
        ],
        [
            [
                r.start.name,
                experiment,
                "stays inside" if r.start.inside else "rest posture",
                f"{1e3 * r.depth:.1f} mm"
                if r.start.pairs
                else f"{np.rad2deg(r.excess):.1f}°",
                f"{r.time:.2f} s",
                f"{100 * r.effort_share:.0f} %",
                f"{100 * r.later_effort_share:.0f} %",
                f"{1e3 * r.smallest_distance:.1f} mm",
            ]
            for experiment, r in results
        ],
    )


def main(argv: Sequence[str] | None = None) -> None:
    """Runs every start in both experiments, with the target inside and outside."""
    benchmark = Benchmark("benchmarks.recovery", __doc__, "recovery")
    add_preview_option(benchmark.parser)
    arguments = benchmark.parse(argv, defaults_or_preview)
    results = [
        (
            experiment,
            recover(
                replace(start, inside=inside),
                default_scenario(experiment, arguments.preview),
            ),
        )
        for experiment in ("wrists", "upper-body")
        for start in STARTS
        for inside in (True, False)
    ]
    benchmark.report([make_table(results)])


if __name__ == "__main__":
    run(main)
