"""Attacks the control law, and counts what it lets through.

    python -m benchmarks.adversary [--quick] [--out out/adversary]
    python -m benchmarks.adversary --robots jaw --attacks moving,squeeze --periods 0.01
    python -m benchmarks.adversary --replay out/adversary/found/FILE.json

Finished cases stand in `adversary.json`, so that a stopped run goes on; a case is run
again when the source of the package or of the attacks has changed. The exit code
is 1 if anything is violated with the exact model, 2 if a case could not be run.
"""

import argparse
import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.adversary.cases import (
    PERIODS,
    PLANTS,
    Case,
    Result,
    attacks_on,
    make_cases,
)
from benchmarks.adversary.report import tables, told
from benchmarks.adversary.robots import ASKED_FOR, ROBOTS, load_subject
from benchmarks.adversary.run import play_and_judge, run_case
from benchmarks.kept_cases import run_cases, source_digest, workers
from benchmarks.options import list_of, one_of, seed_number
from benchmarks.page import Benchmark, run
from crar_drake.commands.options import count, positive
from crar_drake.errors import CrarError, nearest
from crar_drake.files import check_folder, write_whole
from crar_drake.law.parameters import CONSTRAINTS

WHOLE = "adversary.json"
FOUND = "found"
USUAL = [robot for robot in ROBOTS if robot not in ASKED_FOR]
QUICK_STEPS, EXACT_STEPS, TORQUE_STEPS = 200, 5000, 600


def _write_found(folder: Path, results: Sequence[Result]) -> None:
    """A file per counterexample."""
    for r in results:
        if r.worst is not None:
            case = r.case
            name = f"{case.plant}-{case.robot}-{case.attack}-{1e3 * case.period:g}ms"
            text = json.dumps({"case": asdict(case), **r.worst}, indent=1) + "\n"
            write_whole(folder / FOUND / f"{name}.json", text)


def replay(path: Path) -> bool:
    """Runs a counterexample again, and tells what it violates; whether it does.

    Raises:
        CrarError: the file is not one, or the law refuses its parameters by now.
    """
    try:
        found = json.loads(path.read_text())
        case, task_set = Case(**found["case"]), found["task_set"]
        lineage, num_steps = found["lineage"], found["num_steps"]
    except OSError as error:
        raise CrarError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise CrarError(
            f"{path}: not a counterexample of this benchmark ({error}); take a file of "
            f"the folder {FOUND}/"
        ) from error
    subject = load_subject(case.robot, lineage[0])
    done, verdict = play_and_judge(case, subject, task_set, lineage, num_steps)
    print(
        f"{case.attack} on {case.robot} ({task_set}) at {1e3 * case.period:g} ms, "
        f"{case.plant} plant, {done.steps} steps"
        + (", then it diverged" if done.diverged else "")
    )
    first = "never" if verdict.first is None else f"at state {verdict.first}"
    print(
        f"first violation (of distance or limits): {first}\n"
        f"smallest distance {1e3 * verdict.clearance:.3f} mm ({verdict.pair}), on "
        f"braking paths {1e3 * verdict.path_clearance:.3f} mm ({verdict.path_pair})\n"
        f"{verdict.penetrating} states penetrate, {verdict.beyond_limit} are beyond a "
        f"limit, {verdict.ahead} brake to beyond one (worst {verdict.excess:.3g}, "
        f"{verdict.joint or 'none'}), {verdict.too_fast} are too fast (worst "
        f"{verdict.overspeed:.3g} times the limit)"
    )
    return verdict.violated or done.diverged


def _period(text: str) -> float:
    value = positive(text)
    if not 1e-5 <= value <= 0.1:
        raise argparse.ArgumentTypeError(f"{text!r}: give seconds from 1e-5 to 0.1")
    return value


def parse(
    benchmark: Benchmark, argv: Sequence[str] | None = None
) -> argparse.Namespace:
    """The options; names and numbers are checked."""
    parser = benchmark.parser
    parser.add_argument(
        "--robots",
        type=list_of(one_of(ROBOTS, "robot")),
        default=list(USUAL),
        help=f"by default all but {' and '.join(ASKED_FOR)}",
    )
    parser.add_argument(
        "--attacks",
        type=list_of(str),
        help="by default all; those on the filter are others than those on the law",
    )
    parser.add_argument("--periods", type=list_of(_period), default=list(PERIODS))
    parser.add_argument(
        "--plants",
        type=list_of(one_of(PLANTS, "plant")),
        default=["exact"],
        help="exact (default), torque, filter, or several",
    )
    parser.add_argument("--constraints", choices=CONSTRAINTS, default="lookahead")
    parser.add_argument(
        "--paper", action="store_true", help="attack the paper's law, made safe"
    )
    parser.add_argument(
        "--steps",
        type=count,
        help=f"control steps a case, at least; {EXACT_STEPS} by default, "
        f"{TORQUE_STEPS} with torque, {QUICK_STEPS} if --quick",
    )
    text = "share of the motors' limits that a filter may use; by default no limits"
    parser.add_argument("--motors", type=positive, default=0.0, help=text)
    parser.add_argument("--seed", type=seed_number, default=0)
    parser.add_argument("--processes", type=count, default=os.cpu_count())
    parser.add_argument("--quick", action="store_true", help="few steps a case")
    parser.add_argument("--out", type=Path, default=Path("out/adversary"))
    parser.add_argument("--replay", type=Path, metavar="FILE")
    options = benchmark.parse(
        argv,
        lambda given: (
            "+".join(given.plants)
            + " no preview" * given.paper
            + " motors" * bool(given.motors)
        ),
    )
    known = [attack for plant in options.plants for attack in attacks_on(plant)]
    for name in options.attacks or ():
        if name not in known:
            parser.error(
                f"argument --attacks: no attack {name!r}{nearest(name, known)}"
            )
    return options


def main(argv: Sequence[str] | None = None) -> int:
    """Runs it, prints the tables, and returns the exit code."""
    benchmark = Benchmark("benchmarks.adversary", __doc__, "adversary")
    options = parse(benchmark, argv)
    if options.replay is not None:
        return int(replay(options.replay))
    check_folder(options.out)
    for robot in options.robots:  # better to know now that one is not imported
        load_subject(robot)
    cases = []
    for plant in options.plants:
        default = TORQUE_STEPS if plant == "torque" else EXACT_STEPS
        cases += make_cases(
            options.robots,
            options.attacks,
            options.periods,
            [plant],
            constraints=options.constraints,
            paper=options.paper,
            motors=options.motors,
            steps=options.steps or (QUICK_STEPS if options.quick else default),
            seed=options.seed,
        )
    results = run_cases(
        run_case,
        cases,
        options.out / WHOLE,
        workers(options.processes),
        made_of=source_digest(Path(__file__).parent),
        parse=lambda each: Result(**each | {"case": Case(**each["case"])}),
        failed=lambda case, why: Result(case=case, error=why),
    )
    _write_found(options.out, results)
    benchmark.report(tables(results), told(results))
    print(f"in {options.out}: {WHOLE}, {FOUND}/")
    if any(r.failed for r in results if r.case.plant != "torque"):
        return 1
    return 2 if any(r.error for r in results) else 0


if __name__ == "__main__":
    run(main)
