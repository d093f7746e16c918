"""Does what a standing robot is told ever take what the ground cannot give?

    python -m benchmarks.balance [--steps 100000] [--seeds 1 2 ...] [--pelvis]
                                 [--page PAGE]

Wrists of robots that stand on their soles, or whose base stands on feet of its own, are
asked for anything: swings of up to 3 Hz and 30 cm, jumps, targets out of reach, numbers
that are none or overflow. The law runs on its own command, with `balance`. A violation
is a centre of pressure outside the soles less the margin, a force outside the cone of
friction, a watched pair below its floor, or a joint beyond its limit.

What is judged is Drake's inverse dynamics of the robot with a floating root, at three
instants of each step, and Drake's distances once: nothing of the law takes part. With
`--pelvis` legs follow it; then soles that move by more than half a millimetre count,
too. Episodes alternate with those of the same law without balance. Each seed has as
many steps; what it has is kept in out/balance, or out/balance-pelvis, so that a run
that was stopped goes on.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from scipy.spatial import ConvexHull

from benchmarks.kept import Kept, add_seeds, measured_by
from benchmarks.page import Benchmark, Table, run
from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import BalanceParameters, CrarParameters
from crar_drake.errors import ModelError
from crar_drake.judging.referee import Referee
from crar_drake.references.ground_demand import ground_wrench
from crar_drake.robot.description import (
    GROUND,
    find_body,
    load_robot_description,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.moving_pelvis import WholeCommand
from crar_drake.robot.soles import sole_corners
from crar_drake.robot.standing import standing_description
from crar_drake.robot.task import position_tasks
from crar_drake.simulation.scenario import Pelvis

ROBOTS = ("g1_whole_body", "talos_whole_body")
ON_A_BASE = ("tipping_cell",)  # the base is fixed
PERIOD = 0.005  # [s]
EPISODE = 600  # periods
SOLES_MOVE = 5e-4  # [m] more is none that stand
INSTANTS = (0.0, 0.5, 1.0)  # of each step
TRACKED = ["left_wrist", "right_wrist"]
HEADER = (
    *("robot", "law", "steps", "admitted as nominal, corrected, scaled"),
    *("outside the soles", "farthest outside", "beyond friction", "pairs", "limits"),
    *("rms error", "fastest joint", "soles move"),
)


class Soles:
    """The hull of all soles, each edge a margin farther inside, on one floor.

    Attributes:
        hull: its edges: (x, y, 1) . row is how far a point is outside [m].
        floor: height [m].
    """

    def __init__(self, corners: Sequence[np.ndarray], margin: float) -> None:
        """
        Args:
            corners: of each sole (V, 3) in W [m].
            margin: [m].
        """
        self.hull = ConvexHull(np.concatenate(corners)[:, :2]).equations
        self.hull[:, 2] += margin
        self.floor = float(np.mean([sole[:, 2].mean() for sole in corners]))

    def demand(
        self, plant: MultibodyPlant, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """How far (T,) centres of pressure are outside [m], infinite where there is
        none, and (T,) the slope of the force; of a plant whose root floats."""
        wrench = ground_wrench(plant, q, v, a)
        centres = wrench.centres(self.floor)
        outside = (centres @ self.hull[:, :2].T + self.hull[:, 2]).max(axis=1)
        return np.where(np.isnan(outside), np.inf, outside), wrench.friction


class Subject:
    """A robot that stands, its law, and Drake's own of it with a root that floats."""

    def __init__(
        self,
        name: str,
        balance: BalanceParameters | None,
        pelvis: Mapping[str, Sequence[float]] | None = None,
    ) -> None:
        """
        Args:
            name: of the robot.
            balance: of the law.
            pelvis: the box that it moves in, as of `standing_description`.
        """
        whole = standing = load_robot_description(name)
        if name in ON_A_BASE:
            whole = replace(standing, root="prescribed")
        else:
            standing = standing_description(whole, pelvis)
        tasks = position_tasks(TRACKED)
        self.model = model = ControlModel.FromDescription(
            standing, tasks, time_step=0.0
        )
        self.law = ControlLaw(model, CrarParameters(period=PERIOD, balance=balance))
        self.law.compile()
        margins = balance or BalanceParameters()
        corners = sole_corners(model, standing.soles)
        self._soles = Soles(corners, margins.margin)
        self.friction = margins.friction
        self._floating = floating = ControlModel.FromDescription(whole, tasks)
        pairs = [pair for pair in whole.pairs if GROUND not in pair]
        self.referee = Referee(floating.plant, floating.scene_graph, pairs)
        self._rest = floating.rest_positions()
        ours = list(model.position_names)
        theirs = list(floating.position_names), list(floating.velocity_names)
        joints = [n for n in ours if n in theirs[0]]
        self._at = [ours.index(n) for n in joints]
        self._q_at, self._v_at = ([names.index(n) for n in joints] for names in theirs)
        self._command = WholeCommand(getattr(standing, "pelvis", None), ours)
        self._feet = [
            (find_body(floating.plant, link), np.array(corners, dtype=float).T)
            for link, corners in whole.soles.items()
        ]

    def whole(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions (T, nq), velocities and accelerations (T, nv) of the robot whose
        root floats, of those of the law's."""
        found = np.tile(self._rest, (len(q), 1))
        rates = np.zeros((2, len(q), self._floating.plant.num_velocities()))
        for k, each in enumerate(zip(q, v, a, strict=True)):
            joints, base = self._command(*each)
            joints = joints[:, self._at]
            found[k, self._q_at], rates[0, k, self._v_at] = joints[0], joints[1]
            rates[1, k, self._v_at] = joints[2]
            if base.any():
                found[k, self._floating.root_positions[4:]] += base[0]
                rates[:, k, self._floating.unactuated[3:]] = base[1:]
        return found, rates[0], rates[1]

    def demand(self, q: np.ndarray, v: np.ndarray, a: np.ndarray):
        """How far (T,) centres of pressure are outside the soles less the margin [m],
        and (T,) the slope of the force, of the robot whose root floats."""
        return self._soles.demand(self._floating.plant, q, v, a)

    def feet(self, q: np.ndarray) -> np.ndarray:
        """(T,) how far a sole's corner is from where it stands, at most [m]."""
        plant = self._floating.plant
        context = plant.CreateDefaultContext()
        found = []
        for each in (self._rest, *q):
            plant.SetPositions(context, each)
            corners = [plant.EvalBodyPoseInWorld(context, b) @ c for b, c in self._feet]
            found.append(np.hstack(corners).T)
        return np.linalg.norm(np.array(found[1:]) - found[0], axis=2).max(axis=1)


def swings(
    home: np.ndarray,
    rng: np.random.Generator,
    widths: tuple[float, float] = (0.05, 0.3),
    rates: tuple[float, float] = (0.3, 3.0),
) -> Callable:
    """Each coordinate at a frequency and a width of its own.

    Args:
        home: that is swung about [m].
        rng: the dice.
        widths: least and largest of the widest coordinate [m].
        rates: least and largest frequency [Hz].
    """
    wide = rng.uniform(*widths) * rng.uniform(0.3, 1.0, len(home))
    w = 2.0 * np.pi * rng.uniform(*rates, len(home))
    phase = rng.uniform(0.0, 2.0 * np.pi, len(home))

    def targets(t: float) -> np.ndarray:
        at = w * t + phase
        return np.concatenate(
            (
                home + wide * np.sin(at),
                wide * w * np.cos(at),
                -wide * w * w * np.sin(at),
            )
        )

    return targets


def jumps(home: np.ndarray, rng: np.random.Generator) -> Callable:
    """Stands, and is elsewhere: near, or out of reach."""
    far, every = rng.choice([0.12, 0.3, 1.0, 10.0]), rng.uniform(0.02, 0.6)
    dice = int(rng.integers(2**31))

    def targets(t: float) -> np.ndarray:
        place = np.random.default_rng([dice, int(t / every)])
        at = home + place.normal(0.0, far, len(home))
        return np.concatenate((at, np.zeros(2 * len(home))))

    return targets


def wild(home: np.ndarray, rng: np.random.Generator) -> Callable:
    """Numbers of any size, and some that are none."""
    dice, size = int(rng.integers(2**31)), rng.choice([1.0, 1e3, 1e12, 1e300])

    def targets(t: float) -> np.ndarray:
        place = np.random.default_rng([dice, int(t / 0.05)])
        found = place.normal(0.0, size, 3 * len(home))
        found[: len(home)] += home
        if place.random() < 0.2:
            found[place.integers(len(found))] = np.nan
        return found

    return targets


ATTACKS = {"swings": swings, "jumps": jumps, "wild": wild}


@dataclass
class Tally:
    """What was seen of a robot and a law."""

    steps: int = 0
    hows: list[int] = field(default_factory=lambda: [0, 0, 0])
    outside: int = 0
    farthest: float = -np.inf
    slips: int = 0
    pairs: int = 0
    limits: int = 0
    squares: float = 0.0
    followed: int = 0
    fastest: float = 0.0
    soles: float = 0.0

    @property
    def violations(self) -> int:
        """Of all kinds."""
        found = self.outside + self.slips + self.pairs + self.limits
        return found + int(self.soles > SOLES_MOVE)

    def add(self, other: Tally) -> None:
        """Goes on with what another saw."""
        self.hows = [a + b for a, b in zip(self.hows, other.hows, strict=True)]
        for name in ("farthest", "fastest", "soles"):
            setattr(self, name, max(getattr(self, name), getattr(other, name)))
        for name in ("steps", "outside", "slips", "pairs", "limits", "squares"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.followed += other.followed

    def cells(self, robot: str, law: str) -> list[str]:
        hows = " ".join(f"{n / max(sum(self.hows), 1):.1%}" for n in self.hows)
        error = np.sqrt(self.squares / max(self.followed, 1))
        return [
            *(robot, law, f"{self.steps:,}", hows if law == "balance" else "–"),
            *(f"{self.outside:,}", f"{1e3 * self.farthest:.2f} mm"),
            *(f"{self.slips:,}", f"{self.pairs:,}", f"{self.limits:,}"),
            *(f"{1e3 * error:.0f} mm", f"{self.fastest:.1f} rad/s"),
            f"{1e3 * self.soles:.2f} mm",
        ]


def run_at(subject: Subject, attack: str, seed: int, steps: int = EPISODE) -> Tally:
    """What is seen of an episode from rest.

    Args:
        subject: begun anew here.
        attack: of `ATTACKS`.
        seed: of the dice.
        steps: periods.
    """
    tally = Tally()
    model, law = subject.model, subject.law
    rng = np.random.default_rng(seed)
    q = model.rest_positions()
    v = np.zeros(model.plant.num_velocities())
    home = model.layout.unpack(model.tasks_at(q)).p.ravel().copy()
    targets, prescribed = ATTACKS[attack](home, rng), model.prescribed_at(q)
    law.reset()
    Q, V, A = [], [], []
    with np.errstate(all="ignore"):
        for k in range(steps):
            try:
                solution = law.step(q, v, targets(k * PERIOD), prescribed)
            except FloatingPointError:  # an overflow of the targets is told
                break
            a = solution.acceleration
            for share in INSTANTS:
                t = share * PERIOD
                Q.append(q + t * v + 0.5 * t * t * a)
                V.append(v + t * a)
                A.append(a)
            if "balance" in solution.of_mode:
                tally.hows[int(solution.of_mode["balance"][0])] += 1
            if attack == "swings":
                tally.squares += float(solution.task_error @ solution.task_error)
                tally.followed += len(TRACKED)
            q, v = Q[-1], V[-1]
            tally.fastest = max(tally.fastest, float(np.abs(v).max()))
            tally.steps += 1
    Q, V, A = map(np.array, (Q, V, A))
    whole = subject.whole(Q, V, A)
    outside, slope = subject.demand(*whole)
    tally.outside = int((outside > 1e-8).sum())
    tally.farthest = float(outside.max())
    tally.slips = int((slope > subject.friction * (1.0 + 1e-8)).sum())
    some = whole[0][:: len(INSTANTS)]
    tally.pairs = subject.referee.violations(some).num_violated
    tally.soles = float(subject.feet(some).max())
    at = model.controlled_positions[: model.n]
    beyond = (Q[:, at] < model.lower - 1e-6) | (Q[:, at] > model.upper + 1e-6)
    tally.limits = int(beyond.any(axis=1).sum())
    return tally


def attack_all(
    subjects: dict[tuple[str, str], Subject],
    steps: int,
    seed: int,
    name: str = "balance",
) -> Kept:
    """Episodes of one seed, each robot and attack in turn, from where it was stopped.

    Args:
        subjects: by robot and law, "balance" and "without".
        steps: with balance.
        seed: of all dice.
        name: of what is kept.
    """
    kept, done, episode = Kept(name, seed), 0, 0
    robots = list(dict.fromkeys(robot for robot, _ in subjects))
    while done < steps:
        robot = robots[episode % len(robots)]
        attack = list(ATTACKS)[episode // len(robots) % len(ATTACKS)]
        dice = int(np.random.default_rng([seed, episode]).integers(2**31))
        # The same attack without balance, of some: it is only there to compare.
        for law in ("balance", "without") if episode % 5 == 0 else ("balance",):
            key = f"{episode} {attack} {robot} {law}"
            if key not in kept.results:
                kept.keep({key: asdict(run_at(subjects[robot, law], attack, dice))})
            if law == "balance":
                tally = Tally(**kept.results[key])
                done += tally.steps
                if tally.violations:
                    print(f"violated: seed {seed}, {key}", file=sys.stderr)
        episode += 1
        if episode % 20 == 0:
            print(f"seed {seed}: {episode} episodes, {done:,} steps", file=sys.stderr)
    return kept


def main(argv: Sequence[str] | None = None) -> None:
    """Attacks all robots in turn, and prints or writes the table."""
    benchmark = Benchmark("benchmarks.balance", __doc__, "balance")
    parser = benchmark.parser
    parser.add_argument(
        "--steps", type=int, default=100_000, help="of each seed, with balance"
    )
    add_seeds(parser, "balance")
    parser.add_argument(
        "--pelvis", action="store_true", help="of robots on legs, sways and squats"
    )
    options = benchmark.parse(argv, lambda options: "attacks")
    subjects = {}
    for robot in (*ROBOTS, *ON_A_BASE):
        try:
            for name, given in (("balance", BalanceParameters()), ("without", None)):
                moves = options.pelvis and robot not in ON_A_BASE
                box = Pelvis().box() if moves else None
                subjects[robot, name] = Subject(robot, given, box)
        except ModelError as error:
            print(f"left out: {error}", file=sys.stderr)
    name = "balance-pelvis" if options.pelvis else "balance"
    seeds = [attack_all(subjects, options.steps, seed, name) for seed in options.seeds]
    tallies = {key: Tally() for key in subjects}
    for kept in seeds:
        for key, found in kept.results.items():
            *_, robot, law = key.split()
            if (robot, law) in tallies:
                tallies[robot, law].add(Tally(**found))
    rows = [tally.cells(*key) for key, tally in tallies.items()]
    balanced = [t for (_, name), t in tallies.items() if name == "balance"]
    bad = sum(t.violations for t in balanced)
    episodes = sum(k.endswith("balance") for each in seeds for k in each.results)
    text = (
        f"{episodes:,} episodes, {sum(t.steps for t in balanced):,} steps with "
        f"balance, each judged at {len(INSTANTS)} instants: {bad} violations. Errors "
        f"are of swings. {measured_by(seeds)}"
    )
    benchmark.report([Table(HEADER, rows)], text.strip())


if __name__ == "__main__":
    run(main)
