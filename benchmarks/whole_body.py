"""Recordings on a whole robot: does it keep clear, and do its feet stand?

    crar-drake import-robot g1_whole_body
    python -m benchmarks.whole_body $CRAR_MOCAP_PATH --out out/whole_body
        [--page docs/measurements/whole-body.md]

Each recording is simulated with the whole body's tasks and judged by programs that
share nothing with the controller: the referee (capsules, limits, speeds) at every
sample, the triangles of the meshes every 50 ms, and `references.footing` (slip of
planted feet, lowest point, what the ground would have to give). Errors and footing
leave out what is blended in at the start. The smallest files come first; a folder of a
recording that has its log is judged, not run again, so that a stopped benchmark can be
continued, and several can share a folder.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.page import Benchmark, Table, run
from benchmarks.sweep.cases import find_motions
from crar_drake.errors import CrarError
from crar_drake.judging.mesh_judge import MeshJudge
from crar_drake.judging.referee import Referee
from crar_drake.references.whole_body import WholeBody
from crar_drake.results import LOG
from crar_drake.results.footing import Footing, footing
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import load_logged_robot, load_logged_scenario
from crar_drake.results.summary import summarize
from crar_drake.robot.model import ControlModel
from crar_drake.run import run_scenario
from crar_drake.simulation.scenario import Scenario, load_scenario

_MESH_PERIOD = 0.05  # [s]
_HEADER = (
    "recording",
    "time",
    "points / feet, rms",
    "capsules",
    "meshes",
    "samples beyond a limit / speed",
    "contacts",
    "slip, median / worst",
    "lowest point",
    "in support",
)


def main(argv: Sequence[str] | None = None) -> None:
    """Runs and judges what the command line says."""
    benchmark = Benchmark("benchmarks.whole_body", __doc__, "whole-body")
    parser = benchmark.parser
    parser.add_argument("motions", nargs="+", help="folders, files or cmu:05_02")
    parser.add_argument("--scenario", default="g1_whole_body_dance")
    parser.add_argument("--duration", type=float, help="of each, at most [s]")
    parser.add_argument("--out", type=Path, default=Path("out/whole_body"))
    parser.add_argument("--judge-only", action="store_true", help="what has a log")
    parser.add_argument("--no-meshes", action="store_true")
    arguments = benchmark.parse(argv, lambda _: "recordings")
    base = load_scenario(arguments.scenario)
    judge, rows, points = None, [], []
    for motion in sorted(find_motions(arguments.motions), key=_size):
        name = Path(motion.removeprefix("cmu:")).stem
        folder = arguments.out / name
        if not (folder / LOG).is_file():
            if arguments.judge_only:
                continue
            scenario = replace(base, motion=motion, duration=arguments.duration)
            if (why := _run(scenario, folder)) is not None:
                rows.append([name, why, *[""] * (len(_HEADER) - 2)])
                continue
        log = SimulationLog.load(folder / LOG)
        if judge is None and not arguments.no_meshes:
            judge = MeshJudge(load_logged_robot(log))
        scenario = load_logged_scenario(log)
        errors = _errors(log, scenario.controller.blend_time, scenario)
        rows.append(_row(name, log, judge))
        points.append([name, *(f"{1e3 * error:.0f}" for error in errors.values())])
        print(rows[-1], flush=True)
    tables = [Table(_HEADER, rows)]
    if points:
        tables.append(Table(["", *errors], points, "Rms errors [mm]"))
    benchmark.report(tables)


def _size(motion: str) -> int:
    """Of a motion's file; 0 of one that is known by name [B]."""
    path = Path(motion)
    return path.stat().st_size if path.is_file() else 0


def _run(scenario: Scenario, folder: Path) -> str | None:
    """Why there is no log, or None."""
    try:
        run_scenario(scenario, folder, record=False)
    except CrarError as error:
        return str(error)
    return None


def _row(name: str, log: SimulationLog, judge: MeshJudge | None) -> list[str]:
    scenario, description = load_logged_scenario(log), load_logged_robot(log)
    model = ControlModel.FromDescription(description, scenario.task_list())
    speeds = scenario.controller.speed_limits(model)
    # Between links: what is below the ground, the lowest point tells.
    pairs = description.without_ground().pairs
    referee = Referee(model.plant, model.scene_graph, pairs, speeds)
    found = referee.violations(log.q, log.v)
    meshes = "not asked"
    if judge is not None:
        period = float(np.median(np.diff(log.time)))
        verdict = judge.judge(log.q[:: max(1, round(_MESH_PERIOD / period))])
        meshes = f"{1e3 * verdict.nearest.distance:.1f} mm"
        if verdict.num_penetrating:
            pairs = ", ".join(" – ".join(each.pair) for each in verdict.penetrations)
            meshes += f", {verdict.num_penetrating} of {verdict.num_samples}: {pairs}"
    start = scenario.controller.blend_time
    points, feet = late_errors(log, start, scenario)
    stood = footing(log, WholeBody(description), start)
    return [
        name,
        f"{log.time[-1]:.1f} s",
        f"{1e3 * points:.0f} / {1e3 * feet:.0f} mm",
        f"{1e3 * found.smallest_distance:.1f} mm, {found.num_penetrating}",
        meshes,
        f"{found.num_beyond_limit} / {found.num_beyond_speed}",
        *_stood(stood),
    ]


def late_errors(
    log: SimulationLog, start: float, scenario: Scenario
) -> tuple[float, float]:
    """Rms errors of the points above the waist and of the feet [m]; NaN for none."""
    squares: dict[bool, list[float]] = {True: [], False: []}
    for task, error in _errors(log, start, scenario).items():
        squares[task.endswith("_foot")].append(error**2)
    return tuple(
        float(np.sqrt(np.mean(squares[feet]))) if squares[feet] else np.nan
        for feet in (False, True)
    )


def _errors(log: SimulationLog, start: float, scenario: Scenario) -> dict[str, float]:
    """Task to its rms error of position from `start` [s] on [m]."""
    tasks = summarize(log.samples(log.time >= start), None, scenario=scenario).tasks
    return {
        task: errors.rms_error
        for task, errors in tasks.items()
        if errors.rms_error is not None
    }


def _stood(stood: Footing) -> list[str]:
    slip = support = "–"
    if stood.contacts:
        slip = f"{1e3 * stood.median_slip:.1f} / {1e3 * stood.worst_slip:.1f} mm"
    if stood.supported_share is not None:
        support = f"{100 * stood.supported_share:.0f} %"
    low = f"{1e3 * stood.lowest:.1f} mm, {stood.lowest_link}"
    return [str(stood.contacts), slip, low, support]


if __name__ == "__main__":
    run(main)
