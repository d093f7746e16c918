"""How much the commanded acceleration changes for a tiny change of the state.

python -m benchmarks.continuity [--motion M ...] [--period P] [--every N]
    [--duration S] [--preview S] [--page docs/measurements/continuity.md]

A jump here would be chatter on a robot whose sensors have noise. The robot follows the
motion by the exact model; at every N-th control step the same step is taken once more
from a state that differs by 1e-9 in a random direction, everything else equal.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.page import Benchmark, Table, run
from benchmarks.preview_option import (
    add_preview_option,
    defaults_or_preview,
    lookahead_defaults,
)
from benchmarks.sweep.cases import find_motions
from crar_drake.control.law import ControlLaw
from crar_drake.control.records import Memory
from crar_drake.equations.references import Targets
from crar_drake.fresh_processes import FreshProcesses
from crar_drake.robot.task import EXPERIMENTS
from crar_drake.simulation.diagram import PrepareScenario
from crar_drake.simulation.scenario import Scenario

PERIOD = 5e-3  # [s]
NUDGE = 1e-9  # [rad] and [rad/s]
MANNERS = ("nominal", "corrected", "scaled")


@dataclass(frozen=True)
class Continuity:
    """What came of one motion.

    Attributes:
        steps: (3,) compared, by how they were admitted: nominal, corrected, scaled.
        largest: (3,) largest change of an acceleration among them [rad/s^2].
        changed: steps that were admitted in another manner from the other state; they
            count with the one that was further from the wish.
    """

    steps: tuple[int, ...]
    largest: tuple[float, ...]
    changed: int


def run_case(
    motion: str,
    experiment: str,
    period: float,
    every: int,
    duration: float | None = None,
    seed: int = 0,
    preview: float | None = None,
) -> Continuity:
    """Follows the motion with the defaults, and nudges every `every`-th step.

    With another preview [s], if one is given.
    """
    scenario = Scenario(
        motion=motion,
        experiment=experiment,
        controller=lookahead_defaults(preview, period=period),
    )
    setup = PrepareScenario(scenario)
    model, wanted = setup.model, setup.motion
    law = ControlLaw(model, scenario.controller)
    workspace = model.MakeWorkspace()
    source = None
    if wanted.MakePrescribedSource is not None:
        source = wanted.MakePrescribedSource()
        context = source.CreateDefaultContext()
    q, v = setup.start_positions, np.zeros(model.plant.num_velocities())
    memory, random = Memory(), np.random.default_rng(seed)
    steps, largest, changed = [0, 0, 0], [0.0, 0.0, 0.0], 0
    posture = law.default_posture(q)
    for tick in range(int(min(duration or np.inf, wanted.duration) / period)):
        time = tick * period
        prescribed = np.zeros(0)
        if source is not None:
            context.SetTime(time)
            prescribed = source.get_output_port().Eval(context)
        targets = Targets(wanted.tasks_at(time), prescribed, posture)
        step = law.solve(workspace, memory, tick, time, q, v, targets)
        if tick and tick % every == 0:
            nudge = random.standard_normal(2 * len(q))
            nudge *= NUDGE / np.abs(nudge).max()
            other = law.solve(
                workspace,
                memory,
                tick,
                time,
                q + nudge[: len(q)],
                v + nudge[len(q) :],
                targets,
            )
            manners = [int(s.solution.admission[0]) for s in (step, other)]
            manner = max(manners)
            changed += manners[0] != manners[1]
            difference = other.solution.acceleration - step.solution.acceleration
            steps[manner] += 1
            largest[manner] = max(largest[manner], float(np.abs(difference).max()))
        q, v = np.split(step.solution.position_command, [len(q)])
        memory = step
    return Continuity(tuple(steps), tuple(largest), changed)


def make_table(results: dict[str, Continuity]) -> Table:
    """A row per run, and one of all."""
    header = ["run"]
    for manner in MANNERS:
        header += [f"steps {manner}", "largest change [rad/s²]"]
    columns = range(len(MANNERS))
    everything = Continuity(
        tuple(sum(result.steps[k] for result in results.values()) for k in columns),
        tuple(max(result.largest[k] for result in results.values()) for k in columns),
        sum(result.changed for result in results.values()),
    )
    rows = []
    for name, result in {**results, "all": everything}.items():
        row = [name]
        for count, change in zip(result.steps, result.largest, strict=True):
            row += [str(count), f"{change:.1e}" if count else "–"]
        rows.append([*row, str(result.changed)])
    return Table([*header, "another manner"], rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    benchmark = Benchmark("benchmarks.continuity", __doc__, "continuity")
    parser = benchmark.parser
    parser.add_argument("--motion", nargs="*", default=["dance", "boxing"])
    parser.add_argument("--period", type=float, default=PERIOD)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--duration", type=float, help="of each, at most [s]")
    add_preview_option(parser)
    parser.add_argument("--jobs", type=int)
    given = benchmark.parse(arguments, defaults_or_preview)
    with FreshProcesses(given.jobs) as pool:
        waiting = {
            f"{Path(motion).stem}, {experiment}": pool.submit(
                run_case,
                motion,
                experiment,
                given.period,
                given.every,
                given.duration,
                preview=given.preview,
            )
            for motion in find_motions(given.motion)
            for experiment in EXPERIMENTS
        }
        results = {name: future.result() for name, future in waiting.items()}
    benchmark.report([make_table(results)])


if __name__ == "__main__":
    run(main)
