"""The lookahead's presets beside no preview: recordings, and hands that cross.

    python -m benchmarks.presets [--seeds 8] [--first 200] [--page ...]
    python -m benchmarks.presets cmu:05_07 cmu:131_08 [--experiment upper-body]
        [--page docs/measurements/presets.md]

The shipped upper body does exactly as it is commanded, every 5 ms, with its effort
limits; hands cross (`peers.motions.random_crossings`) with at most 150 Nm a joint.
"""

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.kept import seed_number
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
from crar_drake.simulation.diagram import PrepareScenario

PERIOD = 5e-3  # [s]
FIRST = 1.0  # what is before does not count [s]
LATER = 2.0  # from which on there are errors of their own [s]
LONGEST = 12.0  # of a recording [s]
FARTHER = 1.1  # ratio of rms errors from which on a motion is named
EFFORT = 150.0  # of crossings [Nm]
WRISTS = ("left_wrist", "right_wrist")
NO_PREVIEW = "no preview"
PRESETS = {
    NO_PREVIEW: {"preview": 0.0},
    "default (balanced)": {},
    "closest": {"preset": "closest"},
    "calm": {"preset": "calm"},
}  # to fields of `LookaheadParameters`
HEADER = (
    "preset",
    "median rms error",
    "over no preview's, median",
    "largest",
    "median error",
    "rms acceleration",
    "smallest distance",
    "a step, median",
    "99 %",
)
# The part of the page with recordings that so many points follow.
_PARTS = {"wrists": "recordings", "upper-body": "seven points"}
ERRORS = ("rms", "mean", "rms from 2 s")


def main(argv: Sequence[str] | None = None) -> None:
    benchmark = Benchmark("benchmarks.presets", __doc__, "presets")
    parser = benchmark.parser
    parser.add_argument("motions", nargs="*", help="recordings")
    parser.add_argument("--seeds", type=int, default=8, help="how many crossings")
    parser.add_argument(
        "--first", type=seed_number, default=200, help="the first one's seed"
    )
    parser.add_argument(
        "--experiment",
        choices=tuple(_PARTS),
        default="wrists",
        help="which points follow recordings: two wrists, or seven points",
    )
    arguments = benchmark.parse(
        argv,
        lambda given: _PARTS[given.experiment] if given.motions else "crossings",
    )
    if arguments.motions:
        cases = {
            motion: recording(motion, arguments.experiment)
            for motion in arguments.motions
        }
    else:
        cases = crossings(range(arguments.first, arguments.first + arguments.seeds))
    found = {
        name: np.array([figures(*case, settings) for case in cases.values()])
        for name, settings in PRESETS.items()
    }
    base = found[NO_PREVIEW]
    tables = [Table(HEADER, [row(name, each, base) for name, each in found.items()])]
    worse = farther([*cases], found)
    benchmark.report(tables + ([worse] if worse.rows else []))


def recording(motion: str, experiment: str) -> tuple:
    """Model, targets (T, size), prescribed (T, 3 n_p) and start."""
    scenario = Scenario(
        robot=ROBOT,
        motion=motion,
        experiment=experiment,
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


def crossings(seeds: range) -> dict[str, tuple]:
    """The same of hands that cross, with two wrists as tasks, and by name."""
    cases = {}
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
                cases[case] = (model, tasks, nothing, data["q_start"], EFFORT)
    return cases


def figures(model, tasks, prescribed, start, effort, settings) -> list[float]:
    """rms and mean error, and rms error from LATER on [m], median error [m] and rms
    acceleration, all after FIRST, smallest distance [m], median and 99 % of the steps'
    processor times [s]."""
    parameters = CrarParameters(
        period=PERIOD, lookahead=LookaheadParameters(**settings)
    )
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
    first, later = round(FIRST / PERIOD), round(LATER / PERIOD)
    return [
        np.sqrt(np.mean(errors[first:])),
        np.mean(np.sqrt(errors[first:])),
        np.sqrt(np.mean(errors[later:])) if len(errors) > later else np.nan,
        np.median(np.sqrt(errors[first:])),
        np.sqrt(np.mean(accelerations[first:])),
        min(distances),
        np.median(times[20:]),
        np.quantile(times[20:], 0.99),
    ]


def farther(names: Sequence[str], found: dict[str, np.ndarray]) -> Table:
    """The motions in which the default's or closest's rms error is more than FARTHER
    times that of no preview, and the ratios of `ERRORS` there."""
    shown = ("default (balanced)", "closest")
    ratios = np.array([found[name] / found[NO_PREVIEW] for name in shown])
    rows = [
        [
            name.removeprefix("cmu:"),
            *(
                "ends before" if np.isnan(one[0]) else f"{one[0]:.2f}, {one[1]:.2f}"
                for one in of[:, : len(ERRORS)].T
            ),
        ]
        for name, of in zip(names, ratios.swapaxes(0, 1), strict=True)
        if of[:, 0].max() > FARTHER
    ]
    title = f"Motions with more than {FARTHER} times no preview's error"
    return Table(("motion", *(f"{e}: default, closest" for e in ERRORS)), rows, title)


def row(name: str, each: np.ndarray, base: np.ndarray) -> list[str]:
    """Medians over the motions; `base` has those of no preview."""
    ratios = each[:, 0] / base[:, 0]
    return [
        name,
        f"{1e3 * np.median(each[:, 0]):.1f} mm",
        f"{np.median(ratios):.2f}",
        f"{ratios.max():.2f}",
        f"{1e3 * np.median(each[:, 3]):.2g} mm",
        f"{np.median(each[:, 4]):.1f} rad/s²",
        f"{1e3 * each[:, 5].min():.1f} mm",
        f"{1e3 * np.median(each[:, 6]):.2f} ms",
        f"{1e3 * np.median(each[:, 7]):.1f} ms",
    ]


if __name__ == "__main__":
    main()
