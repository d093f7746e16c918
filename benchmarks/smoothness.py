"""How smooth the commanded accelerations are, and whether a robot freezes.

python -m benchmarks.smoothness [--out table.md] [--motion M ...] [--period P]
    [--logs FOLDER] [--before FOLDER]

Every run leaves its log in FOLDER (by default a temporary one), where it is not made
again. It calls nothing but what every version of the package has: run in a checkout of
an earlier version, it makes the logs that `--before` names.
"""

import argparse
import math
import tempfile
from collections.abc import Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import welch

from benchmarks.sweep.cases import find_motions
from benchmarks.tables import markdown_table, write_report
from crar_drake.control.parameters import CrarParameters
from crar_drake.fresh_processes import FreshProcesses
from crar_drake.results.log import SimulationLog
from crar_drake.robot.task import EXPERIMENTS
from crar_drake.run import run_scenario
from crar_drake.simulation.scenario import Scenario

PERIOD = 5e-3  # [s]
ROUGH = 20.0  # [Hz] people move at a few hertz: what is above is the controller's own
# A hand is stuck where for this long [s] it moves slower than this [m/s], farther from
# its target than this [m], though the target is not faster than this [m/s].
STUCK_TIME, STUCK_SPEED, STUCK_ERROR, STUCK_TARGET_SPEED = 0.5, 0.02, 0.05, 0.1


@dataclass(frozen=True)
class Smoothness:
    """The figures of one run.

    Attributes:
        acceleration, jerk: root mean square over time and controlled joints of the
            commanded acceleration [rad/s^2], and of its change from one control step
            to the next over the period [rad/s^3].
        rough: root mean square of the acceleration's part above 20 Hz [rad/s^2], from
            Welch's estimate of its spectrum.
        held_back: longest time in a row in which steps were corrected or scaled [s].
        held_share: share of the steps that were.
        stuck: (task, from, to) [s], see the constants of this module.
    """

    acceleration: float
    jerk: float
    rough: float
    held_back: float
    held_share: float
    stuck: tuple[tuple[str, float, float], ...]


def measure(log: SimulationLog, period: float) -> Smoothness:
    """The figures of a log whose samples are no coarser than the period [s]."""
    steps = _control_steps(log.time, period)
    columns = [list(log.position_names).index(name) for name in log.controlled_names]
    acceleration = log.desired_acceleration[steps][:, columns]
    jerk = np.diff(acceleration, axis=0) / period
    rate = 1.0 / period
    frequency, power = welch(
        acceleration, rate, nperseg=min(256, len(acceleration)), axis=0
    )
    rough = power[frequency > ROUGH].sum(axis=0) * (frequency[1] - frequency[0])
    admission = getattr(log, "admission", np.full((len(log.time), 4), np.nan))[steps]
    held = np.nan_to_num(admission[:, 0]) > 0.0
    return Smoothness(
        acceleration=_rms(acceleration),
        jerk=_rms(jerk),
        rough=float(np.sqrt(rough.mean())),
        held_back=max((b - a for a, b in spells(held)), default=0) * period,
        held_share=float(held.mean()),
        stuck=tuple(_stuck(log, steps, period)),
    )


def spells(held: np.ndarray) -> list[tuple[int, int]]:
    """(first, one after the last) of each stretch of True in (T,) booleans."""
    change = np.diff(np.concatenate([[0], held.astype(int), [0]]))
    return list(
        zip(np.flatnonzero(change > 0), np.flatnonzero(change < 0), strict=True)
    )


def _stuck(log: SimulationLog, steps: np.ndarray, period: float):
    """Yields (task, from, to) [s] where a point stands still away from its target."""
    size = 0
    row = 0
    desired, error = log.desired_tasks[steps], log.task_error[steps]
    # Positions of the tasks in x_d: a pose has its quaternion first.
    for name, kind in zip(log.task_names, log.task_kinds, strict=True):
        size += 4 if kind in ("orientation", "pose") else 0
        row += 3 if kind in ("orientation", "pose") else 0
        if kind == "orientation":
            continue
        target, off = desired[:, size : size + 3], error[:, row : row + 3]
        size, row = size + 3, row + 3
        point = target - off
        speed = np.linalg.norm(np.gradient(point, period, axis=0), axis=1)
        wanted = np.linalg.norm(np.gradient(target, period, axis=0), axis=1)
        still = (
            (speed < STUCK_SPEED)
            & (wanted < STUCK_TARGET_SPEED)
            & (np.linalg.norm(off, axis=1) > STUCK_ERROR)
        )
        for first, last in spells(still):
            if (last - first) * period >= STUCK_TIME:
                yield str(name), log.time[steps[first]], log.time[steps[last - 1]]


def _control_steps(time: np.ndarray, period: float) -> np.ndarray:
    ticks = np.floor(time / period + 1e-6)
    return np.flatnonzero(np.diff(ticks, prepend=-1.0) > 0.0)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def make_log(motion: str, experiment: str, period: float, path: str) -> None:
    """Runs a motion in the lookahead mode, with the defaults, and keeps its log."""
    scenario = Scenario(
        motion=motion,
        experiment=experiment,
        controller=CrarParameters(constraints="lookahead", period=period),
    )
    run_scenario(scenario).log.save(path)


def _name(motion: str, experiment: str, period: float) -> str:
    return f"{Path(motion).stem}-{experiment}-{1e3 * period:g}ms.npz"


def make_logs(
    motions: Sequence[str], period: float, folder: Path, jobs: int | None
) -> None:
    """The logs of all cases that are not in the folder yet.

    Raises:
        RuntimeError: a process died.
        CrarError: a motion cannot be run.
    """
    with FreshProcesses(jobs) as pool:
        waiting = [
            pool.submit(make_log, motion, experiment, period, str(path))
            for motion in motions
            for experiment in EXPERIMENTS
            if not (path := folder / _name(motion, experiment, period)).exists()
        ]
        for done in as_completed(waiting):
            done.result()


def make_report(
    motions: Sequence[str], period: float, logs: Path, before: Path | None
) -> str:
    """A table in Markdown, a row per run; "now (before)" where there are both."""
    rows, ratios = [], []
    for motion in motions:
        for experiment in EXPERIMENTS:
            name = _name(motion, experiment, period)
            now = measure(SimulationLog.load(logs / name), period)
            old = None
            if before is not None and (before / name).exists():
                old = measure(SimulationLog.load(before / name), period)
                ratios.append([getattr(now, k) / getattr(old, k) for k in _COMPARED])
            figures = [
                f"{getattr(now, k):.3g}"
                + (f" ({getattr(old, k):.3g})" if old is not None else "")
                for k in _COMPARED
            ]
            stuck = "; ".join(f"{n} {a:.2f}–{b:.2f} s" for n, a, b in now.stuck)
            rows.append(
                [
                    f"{Path(motion).stem}, {experiment}",
                    *figures,
                    f"{now.held_share:.2%}",
                    f"{1e3 * now.held_back:.0f}",
                    stuck or "–",
                ]
            )
    header = [
        "run",
        "rms acceleration [rad/s²]",
        "rms jerk [rad/s³]",
        "above 20 Hz [rad/s²]",
        "corrected or scaled",
        "longest in a row [ms]",
        "stuck",
    ]
    text = markdown_table(header, rows)
    if ratios:
        median, worst = np.median(ratios, axis=0), np.max(ratios, axis=0)
        text += "\nNow over before, median (largest): " + ", ".join(
            f"{k} {m:.2f} ({w:.2f})"
            for k, m, w in zip(_COMPARED, median, worst, strict=True)
            if math.isfinite(m)
        )
        text += ".\n"
    return text


_COMPARED = ("acceleration", "jerk", "rough")


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--motion", nargs="*", default=["dance", "boxing"])
    parser.add_argument("--period", type=float, default=PERIOD)
    parser.add_argument("--jobs", type=int)
    parser.add_argument("--logs", type=Path)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args(arguments)
    motions = find_motions(given.motion)
    with tempfile.TemporaryDirectory() as temporary:
        logs = given.logs or Path(temporary)
        logs.mkdir(parents=True, exist_ok=True)
        make_logs(motions, given.period, logs, given.jobs)
        write_report(make_report(motions, given.period, logs, given.before), given.out)


if __name__ == "__main__":
    main()
