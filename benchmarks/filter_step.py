"""How long does a step of the filter of joint commands take?

    python -m benchmarks.filter_step [ROBOT] [--page docs/measurements/filter-step.md]

A policy of sines wants 3,000 commands; the robot is a G1 of 29 joints unless it is
named (`crar-drake import-robot g1_whole_body`). Every step is timed as often as
`--repeats` says. Its best time is that of the step by itself: what other programs take
of the processor and its caches is in the others.

Then spheres that move come along with each command: so many in a cloud of points about
the robot, none so near that a command is changed; and one to three people whom the
robot has to slow down for.
"""

import sys
import time
from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np

from benchmarks.page import Benchmark, Table, run
from crar_drake.law.obstacles import Obstacles
from crar_drake.law.safety_filter import FilterCommand, SafetyFilter

STEPS = 3000
# Each policy: by how much joints swing [rad or m] at 0.2 to 1 Hz, and noise on that.
POLICIES = {
    "safe": (0.06, 0.0),
    "safe, with noise": (0.05, 2e-4),
    "reaches into itself at times": (0.15, 0.0),
    "reaches into itself": (0.3, 0.0),
    "wild": (1.0, 0.02),
}
# Spheres, and how far from the middle of the robot they are [m].
CLOUDS = {
    "1 sphere": (1, 1.6, 3.0),
    "10 spheres": (10, 1.6, 3.0),
    "100 spheres": (100, 1.6, 3.0),
    "1000 spheres": (1000, 1.6, 3.0),
    "1000 spheres, half of them far": (1000, 1.6, 20.0),
    "1 person, too near": (1, 0.6, 0.7),
    "3 people, too near": (3, 0.6, 0.7),
    "1000 spheres, some too near": (1000, 0.5, 3.0),
}
CLOUD_STEPS = 600
SPHERE, SPEED = 0.05, 1.0  # their radius [m] and speed [m/s]
CLOUD_HEADER = (
    *("spheres", "period", "nominal / corrected / scaled", "step: median", "p99"),
    "without any: median",
)
HEADER = (
    "policy",
    "period",
    "nominal / corrected / scaled",
    "step: median",
    "p99",
    "p99 over median",
    "nominal steps: median",
    "corrected steps: median",
    "as it came: median",
    "p99 ",
)


class Timed(NamedTuple):
    """A policy's steps: (R, K) processor times [s], and the (K,) commands."""

    times: np.ndarray
    commands: list[FilterCommand]


def wanted_by(filter: SafetyFilter, policy: str) -> np.ndarray:
    """(K, n) positions, within the joint limits; the first is the rest posture."""
    model, (size, noise) = filter.model, POLICIES[policy]
    rng = np.random.default_rng(1)
    n, t = model.n, filter.period * np.arange(STEPS)[:, np.newaxis]
    amplitude = size * rng.uniform(0.3, 1.0, n)
    omega = 2.0 * np.pi * rng.uniform(0.2, 1.0, n)
    phase = rng.uniform(0.0, 2.0 * np.pi, n)
    # Begins at rest.
    share = np.minimum(t / 0.5, 1.0) ** 2 * (3.0 - 2.0 * np.minimum(t / 0.5, 1.0))
    swing = share * amplitude * (np.sin(omega * t + phase) - np.sin(phase))
    swing += share * noise * rng.normal(size=swing.shape)
    gap = np.minimum(0.05, 0.25 * (model.upper - model.lower))
    return np.clip(model.rest_positions() + swing, model.lower + gap, model.upper - gap)


def time_steps(
    filter: SafetyFilter,
    wanted: np.ndarray,
    repeats: int,
    spheres: Obstacles | None = None,
) -> Timed:
    """Times each step of a policy as often as is asked for; among obstacles, which are
    made anew each time, as measurements are."""
    times, commands = np.empty((repeats, len(wanted))), []
    for repeat in range(repeats):
        filter.reset()
        commands = []
        for k, q in enumerate(wanted):
            start = time.thread_time()
            if spheres is None:
                command = filter(q)
            else:
                now = Obstacles(spheres.centres, spheres.radii, spheres.speeds)
                command = filter(q, obstacles=now)
            times[repeat, k] = time.thread_time() - start
            commands.append(command)
    return Timed(times, commands)


def cloud(filter: SafetyFilter, name: str) -> Obstacles:
    """Spheres about the middle of the robot's links."""
    count, near, far = CLOUDS[name]
    rng, model = np.random.default_rng(4), filter.model
    root = model.diagram.CreateDefaultContext()
    context = model.plant.GetMyMutableContextFromRoot(root)
    model.plant.SetPositions(context, model.rest_positions())
    places = [
        model.plant.GetBodyByName(link).EvalPoseInWorld(context).translation()
        for link in filter.links
    ]
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    distance = rng.uniform(near, far, (count, 1))
    return Obstacles(np.mean(places, axis=0) + distance * way, SPHERE, SPEED)


def cloud_rows(filter: SafetyFilter, repeats: int) -> list[list[str]]:
    """A row for each of `CLOUDS`."""
    filter.compile(obstacles=True)
    wanted = wanted_by(filter, "safe")[:CLOUD_STEPS]
    alone = np.median(time_steps(filter, wanted, repeats).times.min(axis=0)[1:])
    rows = []
    for name in CLOUDS:
        timed = time_steps(filter, wanted, repeats, cloud(filter, name))
        best = timed.times.min(axis=0)[1:]
        how = [command.report.how for command in timed.commands[1:]]
        kinds = ("nominal", "corrected", "scaled")
        rows.append(
            [
                name,
                f"{1e3 * filter.period:g} ms",
                " / ".join(f"{how.count(kind):,}" for kind in kinds),
                *map(micro, np.percentile(best, [50, 99])),
                micro(alone),
            ]
        )
    return rows


def row(policy: str, period: float, timed: Timed) -> list[str]:
    """A row of the table."""
    how = np.array([command.report.how for command in timed.commands])
    # The first step looks at all pairs, of a state of which nothing is known.
    best, how, times = timed.times.min(axis=0)[1:], how[1:], timed.times[:, 1:]
    median, p99 = np.percentile(best, [50, 99])

    def of(kind: str) -> str:
        return micro(np.median(best[how == kind])) if (how == kind).any() else "–"

    kinds = ("nominal", "corrected", "scaled")
    return [
        policy,
        f"{1e3 * period:g} ms",
        " / ".join(f"{(how == kind).sum():,}" for kind in kinds),
        micro(median),
        micro(p99),
        f"{p99 / median:.2f}",
        *map(of, kinds[:2]),
        *map(micro, np.percentile(times, [50, 99])),
    ]


def micro(seconds: float) -> str:
    return f"{1e6 * seconds:.0f} µs"


def main(argv: Sequence[str] | None = None) -> None:
    """Times all policies at two periods, and prints or writes the table."""
    benchmark = Benchmark("benchmarks.filter_step", __doc__, "filter-step")
    parser = benchmark.parser
    parser.add_argument("robot", nargs="?", default="g1_whole_body")
    parser.add_argument("--repeats", type=int, default=5, help="of each step")
    options = benchmark.parse(argv, lambda options: "steps")
    rows, among = [], []
    for period in (0.005, 0.02):
        filter = SafetyFilter(options.robot, period)
        filter.compile()
        for policy in POLICIES:
            print(f"{policy}, {1e3 * period:g} ms", file=sys.stderr)
            timed = time_steps(filter, wanted_by(filter, policy), options.repeats)
            rows.append(row(policy, period, timed))
        print(f"obstacles, {1e3 * period:g} ms", file=sys.stderr)
        among += cloud_rows(filter, options.repeats)
    pairs = filter.model.pairs
    found = (
        f"{filter.model.n} joints, {len(pairs):,} watched pairs of "
        f"{len(pairs.pair_of_shapes):,} pairs of shapes; Numba {numba.__version__}."
    )
    tables = [Table(HEADER, rows), Table(CLOUD_HEADER, among, "Among obstacles")]
    benchmark.report(tables, found)


if __name__ == "__main__":
    run(main)
