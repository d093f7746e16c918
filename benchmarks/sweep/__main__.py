"""Many motions, simulated through many settings and counted.

    python -m benchmarks.sweep $CRAR_MOCAP_PATH --constraints none,paper,lookahead

The same command continues a sweep that was stopped.
"""

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.sweep.cases import (
    Case,
    find_motions,
    make_cases,
    parameters_of,
    read_results,
    run_sweep,
    settings_path,
)
from benchmarks.sweep.command import add_duration, list_of, one_of, sweep_bar
from benchmarks.sweep.report import failures, sweep_tables
from crar_drake.commands import answer
from crar_drake.commands.options import (
    CONSTRAINTS,
    CONSTRAINTS_HELP,
    EXPERIMENT_HELP,
    EXPERIMENTS,
    LEVEL_HELP,
    LEVELS,
    MOTION_HELP,
    Parser,
    UsageError,
    add_frame_rate,
    add_jobs,
    add_what_runs,
    positive,
)
from crar_drake.commands.output import OUT, continuing
from crar_drake.files import check_file
from crar_drake.simulation.scenario import Scenario, load_scenario


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; the exit code is as of `crar-drake`."""
    parser = Parser(
        prog="python -m benchmarks.sweep",
        description="Simulate many motions and count their violations. The same "
        "command continues a sweep that was stopped.",
    )
    add_what_runs(parser, run)
    parser.add_argument(
        "paths",
        nargs="+",
        metavar="PATH",
        help=f"a folder with .amc files in it or below, or a motion: {MOTION_HELP}",
    )
    parser.add_argument(
        "--experiment",
        choices=(*EXPERIMENTS, "both"),
        default="both",
        help=f"{EXPERIMENT_HELP}; both: the first two (default: %(default)s)",
    )
    for name, known, text in (
        ("constraints", CONSTRAINTS, CONSTRAINTS_HELP),
        ("level", LEVELS, LEVEL_HELP),
    ):
        parser.add_argument(
            f"--{name}",
            type=list_of(one_of(known)),
            action="extend",
            metavar=f"{name[0].upper()}[,{name[0].upper()}...]",
            help=f"{text}; one or several (default: the scenario's)",
        )
    parser.add_argument(
        "--period",
        type=list_of(positive),
        action="extend",
        metavar="S[,S...]",
        help="time between two computations of the torque [s], one or several "
        "(default: the scenario's)",
    )
    add_duration(parser)
    add_frame_rate(parser)
    parser.add_argument(
        "--scenario",
        metavar="SCENARIO",
        help="a YAML file, or the name of a shipped scenario: everything else",
    )
    add_jobs(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        default=OUT / "sweep" / "results.csv",
        help="table of the results; a .yaml (what they have in common) goes beside it "
        "(default: %(default)s)",
    )
    return answer(parser, argv)


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    out: Path = arguments.out
    if out.suffix != ".csv" or out.is_dir():
        raise UsageError(f"--out: {out} must be a file that ends in .csv")

    if arguments.scenario is None:
        scenario = Scenario(motion="dance", experiment="wrists")
    else:
        scenario = load_scenario(arguments.scenario)
    if arguments.duration is not None:
        scenario.duration = arguments.duration
    scenario.frame_rate = arguments.frame_rate  # else it is of the scenario's motion
    controller = scenario.controller
    cases = make_cases(
        find_motions(arguments.paths),
        EXPERIMENTS if arguments.experiment == "both" else [arguments.experiment],
        arguments.constraints or [controller.constraints],
        arguments.level or [controller.level],
        arguments.period or [controller.period],
    )
    if not cases:
        raise UsageError(
            "constraints lookahead work on accelerations; use --level acceleration, "
            "or other --constraints"
        )
    _check_settings(scenario, cases)
    finished = {result.case for result in read_results(out) if not result.error}
    scenario.skeleton = ""  # it belongs to the scenario's motion
    for path in (out, settings_path(out)):
        check_file(path)

    kept = len(finished.intersection(cases))
    with continuing(out), sweep_bar(kept, len(cases)) as progress:
        results = run_sweep(
            cases, out, scenario=scenario, jobs=arguments.jobs, progress=progress
        )
    for table in sweep_tables(results):
        print(table.markdown())
    for line in failures(results):
        print(f"failed: {line}", file=sys.stderr)
    print(out)


def _check_settings(scenario: Scenario, cases: Iterable[Case]) -> None:
    """A wrong setting is reported before hours of simulation, not by every case."""
    for case in {replace(case, motion="", experiment="") for case in cases}:
        controller = parameters_of(case, scenario.controller)
        replace(scenario, controller=controller).validate()


if __name__ == "__main__":
    sys.exit(main())
