"""People who run at a robot whose commands the safety filter passes.

Spheres of bounded speed run at its links: straight at the nearest or the fastest, or
away, with jumps of direction, and from anywhere again after they stood in the robot.
They are measured in every period, or lost for a while. A violation is a contact
(distance at most 0) while the surface of the link is faster there than
`SafetyParameters.contact_speed`.

What is judged are Drake's poses of links, on the straight line between commands, with
distances and speeds of their own (`judging.obstacle_judge`): nothing of the filter
takes part.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from benchmarks.adversary.judge import Judge
from benchmarks.adversary.policies import POLICIES, Policy, Room
from crar_drake.judging.obstacle_judge import ObstacleJudge
from crar_drake.law.obstacles import Obstacles
from crar_drake.law.safety_filter import NOMINAL, SafetyFilter

FASTEST = 2.0  # of people [m/s]
INSTANTS = 4  # that are judged in each period
# Of the start (n,) and the dice.
MakePolicy = Callable[[np.ndarray, np.random.Generator], Policy]
MEASURED = ("exactly", "exactly", "at times")


def witness_of(filter: SafetyFilter) -> ObstacleJudge:
    """The judge of a filter's links."""
    model = filter.model
    return ObstacleJudge(model.plant, model.scene_graph, filter.links)


@dataclass
class Person:
    """A sphere that runs.

    Attributes:
        where: (3,) [m].
        radius: [m].
        fastest: bound of the speed [m/s].
        until, aim: periods until it thinks again; what it then wants.
    """

    where: np.ndarray
    radius: float
    fastest: float
    until: int = 0
    aim: str = "nearest"
    way: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def step(
        self, period: float, witness: ObstacleJudge, seen, index: int, rng
    ) -> None:
        """Runs on for a period [s], at what was seen: distances and speeds."""
        self.until -= 1
        if self.until < 0:
            self.until = int(rng.uniform(0.02, 0.8) / period)
            self.aim = rng.choice(["nearest", "fastest", "straight", "stand", "away"])
            self.way = rng.normal(size=3)
        places, (d, speed) = witness.places(), seen
        if self.aim == "nearest":
            way = places[np.argmin(d[:, index])] - self.where
        elif self.aim == "fastest":
            way = places[np.argmax(speed[:, index])] - self.where
        elif self.aim == "away":
            way = self.where - places[np.argmin(d[:, index])]
        else:
            way = self.way if self.aim == "straight" else np.zeros(3)
        most = self.fastest * period
        # Not beyond what it runs at.
        beyond = self.aim not in ("nearest", "fastest")
        self.where = self.where + _stride(way, most, beyond)


def _stride(way: np.ndarray, most: float, beyond: bool) -> np.ndarray:
    """(3,) along a way [m], at most so far, or `beyond` it just so far [m]."""
    length = np.linalg.norm(way)
    if not length > 1e-9:
        return np.zeros(3)
    return (most if beyond else min(most, length)) / length * way


@dataclass
class Tally:
    """What was seen of a robot."""

    steps: int = 0
    nominal: int = 0
    changed: int = 0
    contacts: int = 0
    harm: float = 0.0
    violations: int = 0
    nearest: float = np.inf

    def judge(self, d: np.ndarray, speed: np.ndarray, allowed: float) -> None:
        touched = d <= 0.0
        self.contacts += int(touched.sum())
        if touched.any():
            self.harm = max(self.harm, float(speed[touched].max()) / allowed)
        fast = speed > allowed * (1.0 + 1e-9)
        self.violations += int((touched & fast).sum())
        if fast.any():
            self.nearest = min(self.nearest, float(d[fast].min()))


def hostile(policy: str, filter: SafetyFilter, judge: Judge) -> MakePolicy:
    """A policy of the adversary, for `run_at`.

    Args:
        policy: its name.
        filter, judge: of the robot, as of its `Room`.
    """
    return lambda start, rng: POLICIES[policy](Room(filter, judge, start, rng))


def run_at(
    filter: SafetyFilter,
    make_policy: MakePolicy,
    num_steps: int,
    seed: int,
    tally: Tally | None = None,
) -> Tally:
    """An episode: people, a policy and the filter, from its rest posture.

    Args:
        filter: begun anew here.
        make_policy: of the start (n,) and the dice.
        num_steps: periods.
        seed: of the dice.
        tally: that is gone on with.
    """
    rng, tally = np.random.default_rng(seed), tally or Tally()
    witness, period = witness_of(filter), filter.period
    filter.reset()
    q, v = filter.model.rest_positions(), np.zeros(filter.model.n)
    wants = make_policy(q, rng)
    middle = _middle(witness, q, v)
    people = []
    while len(people) < rng.integers(1, 5):
        way = rng.normal(size=3)
        where = middle + rng.uniform(0.3, 1.5) * way / np.linalg.norm(way)
        one = Person(where, rng.uniform(0.02, 0.3), rng.uniform(0.1, 1.0) * FASTEST)
        d, _ = witness.look(q, v, where[None], np.array([one.radius]))
        if d.min() > 0.02:
            people.append(one)
    sizes = np.array([one.radius for one in people])
    speeds = np.array([one.fastest for one in people])
    how = MEASURED[rng.integers(len(MEASURED))]
    names = tuple(f"person {i}" for i in range(len(people)))
    names = names if rng.random() < 0.5 else None
    lost = 0
    centres = _centres(people)
    seen = witness.look(q, v, centres, sizes)
    with np.errstate(all="ignore"):
        for k in range(num_steps):
            given = Obstacles(centres, sizes, speeds, names)
            if how == "at times" and k:
                lost = int(rng.integers(1, 30)) if rng.random() < 0.1 else lost - 1
            command = filter(**wants(k, q, v), obstacles=None if lost > 0 else given)
            for i, one in enumerate(people):
                one.step(period, witness, seen, i, rng)
            after = _centres(people)
            for share in np.linspace(0.0, 1.0, INSTANTS + 1)[1:]:
                seen = witness.look(
                    q + share * (command.q - q),
                    (command.q - q) / period,
                    centres + share * (after - centres),
                    sizes,
                )
                tally.judge(*seen, filter.parameters.contact_speed)
            q, v, centres = command.q, command.v, after
            tally.steps += 1
            tally.nominal += command.report.how == NOMINAL
            tally.changed += command.report.obstacle is not None
    return tally


def _centres(people: list[Person]) -> np.ndarray:
    """(N, 3) where they are [m]."""
    return np.array([one.where for one in people])


def _middle(witness: ObstacleJudge, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(3,) the middle of the links."""
    witness.look(q, v, np.zeros((1, 3)), np.zeros(1))
    return witness.places().mean(axis=0)
