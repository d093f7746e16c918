"""The adversary's attacks on the peers: the same targets and the same judge for all.

    python -m benchmarks.peers.attacked --seeds 12 --out out/attacked
        [--page docs/measurements/attacked.md]

Seven points of the shipped upper body, from a clear start at rest, for a second each.
Left out are the attacks that need what a peer does not have: a start at speed, targets
that are NaN, moving obstacles, other gains, a nominal posture. Every controller keeps
the settings that `compare --tune` chose for hands swung through each other.

The joints of the shipped robot may turn at 30 to 37 rad/s, so that within 5 ms a hand
moves by 10 cm and more: `--fastest 10` bounds them for all controllers alike.
"""

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.adversary.attacks import make_episode
from benchmarks.adversary.judge import Counts, Judge
from benchmarks.page import Benchmark, Table, run
from benchmarks.peers.crossings import entries
from benchmarks.peers.peers import MARGIN
from benchmarks.peers.problem import ROBOT, SAMPLE, describe, write_problem
from benchmarks.peers.runs import PERIOD, add_peer_options, only, recorded
from crar_drake import (
    EXPERIMENTS,
    ControlModel,
    LookaheadParameters,
    load_robot_description,
    position_tasks,
)
from crar_drake.commands.options import count, positive
from crar_drake.files import whole_file

ATTACKS = (
    "teleport",
    "sine",
    "chirp",
    "search",
    "singular",
    "several",
    "squeeze",
    "wild",
)
DURATION = 1.0  # of an episode [s]
ENOUGH = MARGIN - 1e-3  # [m] a distance that counts as the margin kept, but for steps
HEADER = (
    "controller",
    "episodes violated",
    "samples penetrating",
    "beyond a limit",
    "too fast",
    "without an answer",
    "nearer than 4 mm",
    "smallest distance",
    "farthest beyond a limit",
    "most acceleration",
)


@dataclass
class Harm(Counts):
    """What a controller did wrong in episodes; see `Counts` for the other figures.

    Attributes:
        episodes, violated: how many, and those with a penetration or a joint beyond
            its limit.
        no_answer: steps without one.
        near: states with a pair nearer than ENOUGH.
        acceleration: the largest of a joint, as the difference of its velocities over
            a control period [rad/s^2].
    """

    episodes: int = 0
    violated: int = 0
    no_answer: int = 0
    near: int = 0
    acceleration: float = 0.0


class Witness:
    """Judges what the drivers record, by the adversary's judge.

    Args:
        folder: of the problem that `write_problem` wrote.
    """

    def __init__(self, folder: Path) -> None:
        shipped = load_robot_description(ROBOT)
        self.model = ControlModel.FromDescription(
            describe(folder, shipped), position_tasks(EXPERIMENTS["upper-body"])
        )
        self.judge = Judge(self.model.plant, self.model.scene_graph, shipped.pairs)

    def harm(self, result: dict[str, np.ndarray]) -> Harm:
        """Of one episode, as `driver.run` returns it."""
        q, v = result["q"], result["v"]
        step = result["time"][1] - result["time"][0]
        # No braking path: what would follow is not what a peer answers for.
        verdict = self.judge.judge(q, v, 0.0, np.random.default_rng(0))
        beyond = np.maximum(self.judge.lower - q[1:], q[1:] - self.judge.upper)
        harm = Harm(
            episodes=1,
            violated=int(bool(verdict.penetrating + verdict.beyond_limit)),
            no_answer=int(result["no_answer"].sum()),
            near=int((self.judge.nearest(q[1:])[0] < ENOUGH).sum()),
            acceleration=float(np.abs(np.diff(v, axis=0) / step).max()),
        )
        harm.add(verdict)
        harm.excess = max(0.0, float(beyond.max()))  # of states, however they began
        return harm


def write_attacks(
    folder: Path, witness: Witness, attacks: Sequence[str], seeds: Iterable[int]
) -> dict[str, list[str]]:
    """Writes a case for every attack and seed, to a folder that has the problem.

    Returns:
        The names of the cases, by attack.
    """
    steps = round(DURATION / SAMPLE) + 1
    names: dict[str, list[str]] = {attack: [] for attack in attacks}
    for seed in seeds:
        for attack in attacks:
            episode = make_episode(
                attack,
                witness.model,
                witness.judge,
                LookaheadParameters(period=SAMPLE),
                steps,
                [seed],
            )
            p, v, a = episode.tasks.reshape(steps, 3, -1, 3).swapaxes(0, 1)
            name = f"{attack}_{seed}"
            with whole_file(folder / f"{name}.npz") as temporary:
                np.savez(
                    temporary,
                    time=SAMPLE * np.arange(steps),
                    q_start=episode.q,
                    p=p,
                    v=v,
                    a=a,
                )
            names[attack].append(name)
    return names


def slow_down(folder: Path, fastest: float) -> None:
    """Bounds the speed of every joint [rad/s] in what `write_problem` wrote."""

    def bounded(found: re.Match) -> str:
        return f'velocity="{min(float(found[1]), fastest):g}"'

    for path in folder.glob("*.urdf"):
        path.write_text(re.sub(r'velocity="([^"]+)"', bounded, path.read_text()))
    path = folder / "problem.json"
    problem = json.loads(path.read_text())
    limits = np.minimum(problem["velocity_limits"], fastest)
    path.write_text(json.dumps(problem | {"velocity_limits": limits.tolist()}))


def main(argv: Sequence[str] | None = None) -> None:
    benchmark = Benchmark("benchmarks.peers.attacked", __doc__, "attacked")
    parser = benchmark.parser
    add_peer_options(benchmark, "out/attacked")
    parser.add_argument("--seeds", type=count, default=12, help="episodes an attack")
    parser.add_argument("--period", type=float, default=PERIOD, help="of control [s]")
    parser.add_argument("--fastest", type=positive, help="of every joint [rad/s]")
    arguments = benchmark.parse(
        argv,
        lambda given: (
            (f"fastest {given.fastest:g}" if given.fastest else "shipped limits")
            + (", some" if given.only else "")
        ),
    )
    if not SAMPLE <= arguments.period <= 0.1:
        parser.error(f"--period {arguments.period}: must be from {SAMPLE} to 0.1 s")
    folder = arguments.out / "problem"
    write_problem(folder)
    if arguments.fastest:
        slow_down(folder, arguments.fastest)
    witness = Witness(folder)
    cases = write_attacks(folder, witness, ATTACKS, range(arguments.seeds))
    found: dict[str, dict[str, Harm]] = {}
    every = [name for names in cases.values() for name in names]
    chosen = only(entries(every), arguments, benchmark)
    for entry, results in recorded(chosen, every, arguments, folder, arguments.period):
        found[entry.name] = {attack: Harm() for attack in cases}
        for attack, names in cases.items():
            for name in names:
                found[entry.name][attack].add(witness.harm(results[name]))
    benchmark.report(make_tables(found))


def make_tables(found: dict[str, dict[str, Harm]]) -> list[Table]:
    """All attacks together, a row a controller; and its smallest distance by attack."""
    whole, parts = [], []
    for name, each in found.items():
        total = Harm()
        for harm in each.values():
            total.add(harm)
        counts = (
            total.penetrating,
            total.beyond_limit,
            total.too_fast,
            total.no_answer,
            total.near,
        )
        whole.append(
            [
                name,
                f"{total.violated} of {total.episodes}",
                *(f"{count:,}" for count in counts),
                f"{1e3 * total.clearance:.1f} mm",
                f"{np.degrees(total.excess):.2f}°",
                f"{total.acceleration:,.0f} rad/s²",
            ]
        )
        parts.append(
            [
                name,
                *(
                    f"{1e3 * harm.clearance:.1f} mm, {harm.violated}"
                    for harm in each.values()
                ),
            ]
        )
    attacks = list(next(iter(found.values())))
    title = "Smallest distance, and episodes violated, attack by attack"
    return [Table(HEADER, whole), Table(["controller", *attacks], parts, title)]


if __name__ == "__main__":
    run(main)
