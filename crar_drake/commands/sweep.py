"""`crar-drake sweep`: many motions, simulated and counted."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from crar_drake.commands.options import (
    CONSTRAINTS,
    CONSTRAINTS_HELP,
    EXPERIMENT_HELP,
    EXPERIMENTS,
    LEVEL_HELP,
    LEVELS,
    MOTION_HELP,
    WHOLE_BODY,
    UsageError,
    add_command,
    add_duration,
    add_frame_rate,
    add_jobs,
    list_of,
    one_of,
    positive,
)
from crar_drake.commands.output import OUT, continuing, sweep_bar

if TYPE_CHECKING:
    from crar_drake.simulation.scenario import Scenario
    from crar_drake.studies.sweep import Case


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "sweep",
        run,
        "Simulate many motions and count their violations. The same command "
        "continues a sweep that was stopped.",
    )
    parser.add_argument(
        "paths",
        nargs="+",
        metavar="PATH",
        help=f"a folder with .amc files in it or below, or a motion: {MOTION_HELP}",
    )
    parser.add_argument(
        "--experiment",
        choices=(*EXPERIMENTS, WHOLE_BODY, "both"),
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
        help="table of the results; a .png (plot) and a .yaml (what they have in "
        "common) go beside it (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    out: Path = arguments.out
    if out.suffix != ".csv" or out.is_dir():
        raise UsageError(f"--out: {out} must be a file that ends in .csv")

    from crar_drake.files import check_file
    from crar_drake.simulation.scenario import Scenario, load_scenario
    from crar_drake.studies.sweep import (
        find_motions,
        make_cases,
        read_results,
        run_sweep,
        settings_path,
    )

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
    for path in (out, settings_path(out), out.with_suffix(".png")):
        check_file(path)

    from rich.console import Console

    from crar_drake.studies.sweep_plot import plot_sweep
    from crar_drake.studies.sweep_report import failures, sweep_tables

    kept = len(finished.intersection(cases))
    with continuing(out), sweep_bar(kept, len(cases)) as progress:
        results = run_sweep(
            cases, out, scenario=scenario, jobs=arguments.jobs, progress=progress
        )
    console = Console()
    for table in sweep_tables(results):
        console.print(table)
    for line in failures(results):
        print(f"failed: {line}", file=sys.stderr)
    plot = out.with_suffix(".png")
    plot_sweep(results, plot)
    print(out)
    print(plot)


def _check_settings(scenario: Scenario, cases: Iterable[Case]) -> None:
    """A wrong setting is reported before hours of simulation, not by every case."""
    for constraints, level, period in {
        (case.constraints, case.level, case.period) for case in cases
    }:
        controller = replace(
            scenario.controller, constraints=constraints, level=level, period=period
        )
        replace(scenario, controller=controller).validate()
