"""The lookahead's presets beside no preview: recordings, and hands that cross.

    python -m benchmarks.presets cmu:05_07 cmu:131_08 [--seeds 8] [--first 200]
        [--page docs/measurements/presets.md]

The shipped upper body does exactly as it is commanded, every 5 ms, with its effort
limits; hands cross (`peers.motions.random_crossings`) with at most 150 Nm a joint.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.page import Benchmark, Table
from benchmarks.peers.problem import (
    ROBOT,
    ROBOTS,
    describe,
    write_crossings,
    write_problem,
)
from crar_drake import (
    ControlLaw,
    ControlModel,
    CrarParameters,
    LookaheadParameters,
    Scenario,
    load_robot_description,
    position_tasks,
)
from crar_drake.control.lookahead_parameters import PRESETS
from crar_drake.simulation.diagram import PrepareScenario

PERIOD = 5e-3  # [s]
LONGEST = 12.0  # of a recording [s]
EFFORT = 150.0  # of crossings [Nm]
WRISTS = ("left_wrist", "right_wrist")
HEADER = (
    "preset",
    "median rms error",
    "over that of none, median",
    "largest",
    "median error",
    "rms acceleration",
    "smallest distance",
    "a step, median",
    "99 %",
)


def main(argv: Sequence[str] | None = None) -> None:
    benchmark = Benchmark("benchmarks.presets", __doc__, "presets")
    parser = benchmark.parser
    parser.add_argument("motions", nargs="*", help="recordings")
    parser.add_argument("--seeds", type=int, default=8, help="how many crossings")
    parser.add_argument("--first", type=int, default=200, help="the first one's seed")
    arguments = benchmark.parse(
        argv, lambda given: "recordings" if given.motions else "crossings"
    )
    if arguments.motions:
        cases = [recording(motion) for motion in arguments.motions]
    else:
        cases = crossings(range(arguments.first, arguments.first + arguments.seeds))
    found = {
        name: np.array([figures(*case, preset) for case in cases])
        for name, preset in [("none", None), *((name, name) for name in PRESETS)]
    }
    benchmark.report(
        [
            Table(
                HEADER, [row(name, each, found["none"]) for name, each in found.items()]
            )
        ]
    )


def recording(motion: str) -> tuple:
    """Model, targets (T, size), prescribed (T, 3 n_p) and start of two wrists."""
    scenario = Scenario(
        robot=ROBOT,
        motion=motion,
        experiment="wrists",
        controller=CrarParameters(period=PERIOD),
    )
    setup = PrepareScenario(scenario)
    model = ControlModel.FromDescription(
        load_robot_description(ROBOT), scenario.task_list(), time_step=PERIOD
    )
    clock = np.arange(0.0, min(LONGEST, setup.motion.duration) - PERIOD, PERIOD)
    tasks = np.array([setup.motion.tasks_at(t) for t in clock])
    q = np.array([setup.motion.prescribed_at(t) for t in clock])
    v = np.gradient(q, PERIOD, axis=0)
    prescribed = np.hstack([q, v, np.gradient(v, PERIOD, axis=0)])
    return model, tasks, prescribed, setup.start_positions, np.inf


def crossings(seeds: range) -> list[tuple]:
    """The same of hands that cross, with two wrists as tasks."""
    cases = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_problem(folder)
        model = ControlModel.FromDescription(
            describe(folder, load_robot_description(ROBOT)),
            position_tasks([*WRISTS]),
            time_step=PERIOD,
        )
        for case in write_crossings(folder, seeds):
            with np.load(folder / f"{case}.npz") as data:
                stride = round(PERIOD / (data["time"][1] - data["time"][0]))
                at = [ROBOTS[ROBOT].index(wrist) for wrist in WRISTS]
                tasks = np.hstack(
                    [
                        data[key][::stride, at].reshape(-1, 3 * len(WRISTS))
                        for key in "pva"
                    ]
                )
                nothing = np.zeros((len(tasks), 0))
                cases.append((model, tasks, nothing, data["q_start"], EFFORT))
    return cases


def figures(model, tasks, prescribed, start, effort, preset) -> list[float]:
    """rms and median error [m] and rms acceleration after the first second, smallest
    distance [m], median and 99 % of the steps' processor times [s]."""
    ahead = LookaheadParameters(preset=preset, preview=None if preset else 0.0)
    parameters = CrarParameters(period=PERIOD, lookahead=ahead)
    law = ControlLaw(model, parameters)
    np.minimum(law.effort_limits, effort, out=law.effort_limits)
    nq = model.plant.num_positions()
    q, v = start, np.zeros(model.plant.num_velocities())
    errors, accelerations, distances, times = [], [], [], []
    for task, given in zip(tasks, prescribed, strict=True):
        begun = time.process_time()
        solution = law.step(q, v, task, given if len(given) else None)
        times.append(time.process_time() - begun)
        q, v = np.split(solution.position_command, [nq])
        errors.append(np.sum(solution.task_error.reshape(-1, 3) ** 2, axis=1))
        accelerations.append(solution.acceleration[model.controlled] ** 2)
        distances.append(solution.signed_distances.min())
    first = round(1.0 / PERIOD)
    return [
        np.sqrt(np.mean(errors[first:])),
        np.median(np.sqrt(errors[first:])),
        np.sqrt(np.mean(accelerations[first:])),
        min(distances),
        np.median(times[20:]),
        np.quantile(times[20:], 0.99),
    ]


def row(name: str, each: np.ndarray, none: np.ndarray) -> list[str]:
    """Medians over the motions."""
    ratios = each[:, 0] / none[:, 0]
    return [
        name,
        f"{1e3 * np.median(each[:, 0]):.1f} mm",
        f"{np.median(ratios):.2f}",
        f"{ratios.max():.2f}",
        f"{1e3 * np.median(each[:, 1]):.2g} mm",
        f"{np.median(each[:, 2]):.1f} rad/s²",
        f"{1e3 * each[:, 3].min():.1f} mm",
        f"{1e3 * np.median(each[:, 4]):.2f} ms",
        f"{1e3 * np.median(each[:, 5]):.1f} ms",
    ]


if __name__ == "__main__":
    main()
