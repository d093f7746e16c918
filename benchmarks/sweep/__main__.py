"""Many motions, simulated through many settings and counted.

    python -m benchmarks.sweep $CRAR_MOCAP_PATH --constraints none,paper,lookahead

The same command continues a sweep that was stopped.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from benchmarks.kept_cases import run_cases, source_digest
from benchmarks.options import add_duration, list_of, one_of
from benchmarks.page import Benchmark, run as run_command
from benchmarks.sweep.cases import (
    Result,
    default_scenario,
    failed,
    find_motions,
    make_cases,
    parameters_of,
    run_case,
)
from benchmarks.sweep.tables import failures, headline, sweep_tables
from crar_drake.commands.options import (
    EXPERIMENTS,
    MOTION_HELP,
    UsageError,
    add_frame_rate,
    add_jobs,
    positive,
)
from crar_drake.fresh_processes import given_or_fresh
from crar_drake.law.parameters import CONSTRAINTS, LEVELS
from crar_drake.simulation.scenario import load_scenario


def main(argv: Sequence[str] | None = None) -> None:
    """Runs what is not finished yet, and tells all of it."""
    benchmark = Benchmark("benchmarks.sweep", __doc__, "sweep")
    parser = benchmark.parser
    parser.add_argument(
        "paths",
        nargs="+",
        metavar="PATH",
        help=f"a folder with .amc files in it or below, or a motion: {MOTION_HELP}",
    )
    parser.add_argument(
        "--tasks",
        choices=(*EXPERIMENTS, "both"),
        default="both",
        help="of the paper's experiments (default: %(default)s)",
    )
    for name, convert, text in (
        ("constraints", one_of(CONSTRAINTS), f"of {', '.join(CONSTRAINTS)}"),
        ("level", one_of(LEVELS), f"of the paper's law: {' or '.join(LEVELS)}"),
        ("period", positive, "time between two computations of the torque [s]"),
    ):
        parser.add_argument(
            f"--{name}",
            type=list_of(convert),
            action="extend",
            metavar=f"{name[0].upper()}[,{name[0].upper()}...]",
            help=f"{text}; one or several (default: the scenario's)",
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
        default=Path("out/sweep/results.json"),
        help="the results (default: %(default)s)",
    )
    arguments = benchmark.parse(
        argv, lambda given: Path(given.scenario or "defaults").stem
    )
    scenario = default_scenario()
    if arguments.scenario is not None:
        scenario = load_scenario(arguments.scenario)
    if arguments.duration is not None:
        scenario.duration = arguments.duration
    scenario.frame_rate = arguments.frame_rate  # else it is of the scenario's motion
    controller = scenario.controller
    cases = make_cases(
        find_motions(arguments.paths),
        EXPERIMENTS if arguments.tasks == "both" else [arguments.tasks],
        arguments.constraints or [controller.constraints],
        arguments.level or [controller.level],
        arguments.period or [controller.period],
    )
    if not cases:
        raise UsageError(
            "constraints lookahead work on accelerations; use --level acceleration, "
            "or other --constraints"
        )
    # A wrong setting is reported before hours of simulation, not by every case.
    for case in {replace(case, motion="", experiment="") for case in cases}:
        replace(scenario, controller=parameters_of(case, controller)).validate()
    scenario.skeleton = ""  # it belongs to the scenario's motion
    text = scenario.to_yaml()
    results = run_cases(
        partial(run_case, scenario=text),
        cases,
        arguments.out,
        given_or_fresh(None, arguments.jobs),
        made_of=source_digest(Path(__file__).parent, settings=text),
        parse=lambda each: Result(**each),
        failed=failed,
        headline=headline,
    )
    benchmark.report(sweep_tables(results))
    for line in failures(results):
        print(line, file=sys.stderr)
    print(arguments.out)


if __name__ == "__main__":
    run_command(main)
