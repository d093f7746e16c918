"""`crar-drake reproduce`: the paper's Section IV."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from crar_drake.commands.options import add_command, add_duration, add_jobs, list_of
from crar_drake.commands.output import OUT, continuing, motion_label, sweep_bar


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "reproduce",
        run,
        "Repeat the experiments of the paper's Section IV and write a report. The "
        "same command continues one that was stopped.",
    )
    parser.add_argument(
        "--motions",
        type=list_of(str),
        action="extend",
        metavar="M[,M...]",
        help="builtin (the four built-in motions), cmu (the CMU recordings 05_02, "
        "13_29, 14_07 and 13_17), or names of motions, the first of them a dance "
        "(default: builtin)",
    )
    add_duration(parser)
    add_jobs(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for report.html and its files (default: out/reproduce/NAME, "
        "where NAME says which motions)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from crar_drake.files import check_folder
    from crar_drake.studies.section_iv.plan import MOTION_SETS, make_plan
    from crar_drake.studies.section_iv.report import report_path
    from crar_drake.studies.section_iv.reproduce import reproduce
    from crar_drake.studies.section_iv.simulate import finished
    from crar_drake.studies.sweep import find_motions

    chosen = arguments.motions or ["builtin"]
    motions = [m for name in chosen for m in MOTION_SETS.get(name, (name,))]
    found = find_motions(motions)
    labels = [motion_label(name).replace(os.sep, "_") for name in chosen]
    out = arguments.out or OUT / "reproduce" / "-".join(labels)
    check_folder(out)
    plan = make_plan(found, duration=arguments.duration)

    kept = len(finished(plan, out))
    with continuing(out), sweep_bar(kept, len(plan.simulations)) as show:
        result = reproduce(
            plan,
            out,
            jobs=arguments.jobs,
            progress=lambda done, total, newest: show(done, total, newest.result),
        )
    table = Table(title="The paper's findings", title_justify="left")
    for column in ("paper", "finding", "here"):
        table.add_column(column)
    for finding in result.findings:
        style = "green" if finding.holds else "red"
        table.add_row(
            finding.source, finding.statement, Text(finding.verdict, style=style)
        )
    Console().print(table)
    print(report_path(out))
