"""Attacks the control law, and counts what it lets through.

    python -m benchmarks.adversary [--quick] [--out out/adversary]
    python -m benchmarks.adversary --robots jaw --attacks moving,squeeze --periods 0.01
    python -m benchmarks.adversary --replay out/adversary/found/FILE.json

Finished cases stand in `cases.jsonl`, so that a stopped run goes on; a case is run
again when the source of the controller or of the attacks has changed. The exit code
is 1 if anything is violated with the exact model, 2 if a case could not be run.
"""

import argparse
import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from multiprocessing import active_children, get_context
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from benchmarks.adversary.cases import (
    PERIODS,
    PLANTS,
    Case,
    Result,
    attacks_on,
    finite,
    law_digest,
    make_cases,
    merged,
    read_results,
)
from benchmarks.adversary.report import (
    markdown,
    not_run,
    plant_tables,
    rich_table,
    verdict_line,
)
from benchmarks.adversary.robots import ASKED_FOR, ROBOTS, load_subject
from benchmarks.adversary.run import play_and_judge, run_case
from benchmarks.page import Part, check_part, machine_line, version_line, write_part
from crar_drake.control.modes import MODES
from crar_drake.errors import CrarError, nearest
from crar_drake.files import check_folder, sole_writer, whole_file, write_whole

LINES = "cases.jsonl"
WHOLE = "adversary.json"
TABLES = "adversary.md"
FOUND = "found"
USUAL = [robot for robot in ROBOTS if robot not in ASKED_FOR]
WIDTH = 180  # of the table where it goes into a file
QUICK_STEPS, EXACT_STEPS, TORQUE_STEPS = 200, 5000, 600


def run_all(
    cases: Sequence[Case], folder: Path, processes: int, console: Console
) -> list[Result]:
    """Runs what is not in the folder yet, and writes all of it there.

    Raises:
        CrarError: another process writes there, or the folder cannot be written to.
    """
    lines = folder / LINES
    with sole_writer(lines):
        done = read_results(lines, law_digest())
        waiting = [case for case in cases if case not in done]
        if len(waiting) < len(cases):
            console.print(f"{len(cases) - len(waiting)} cases are there already")
        with Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            console=console,
            disable=not console.is_terminal,
        ) as progress:
            bar = progress.add_task("cases", total=len(waiting))
            for result in _results(waiting, processes):
                done[result.case] = result
                _append(lines, result)
                progress.advance(bar)
        results = merged(cases, done)
        _write(folder, results)
    return results


def _results(cases: Sequence[Case], processes: int):
    """Runs the cases, and yields results as they come."""
    if processes == 1 or len(cases) < 2:
        yield from map(run_case, cases)
        return
    # Read by the libraries when a new process loads them.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        try:
            for future in as_completed([pool.submit(run_case, c) for c in cases]):
                yield future.result()
        except BaseException:
            # A case may take minutes, and the pool would wait for those under way.
            for process in active_children():
                process.terminate()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _append(lines: Path, result: Result) -> None:
    """A line more; one that a crash has torn is ended first."""
    with open(lines, "ab+") as stream:
        if stream.tell():
            stream.seek(-1, os.SEEK_END)
            if stream.read(1) != b"\n":
                stream.write(b"\n")
        stream.write(result.line().encode() + b"\n")


def _write(folder: Path, results: Sequence[Result]) -> None:
    """The whole of it, as JSON and as tables, and a file per counterexample."""
    write_whole(
        folder / WHOLE,
        json.dumps(
            {
                "law": law_digest(),
                "verdict": verdict_line(results),
                "results": [finite(asdict(r)) for r in results],
            },
            indent=1,
        ),
    )
    write_whole(folder / TABLES, markdown(results))
    for r in results:
        if r.worst is not None:
            case = r.case
            name = f"{case.plant}-{case.robot}-{case.attack}-{1e3 * case.period:g}ms"
            with whole_file(folder / FOUND / f"{name}.json") as temporary:
                found = {"case": asdict(case), **r.worst, "law": r.law}
                temporary.write_text(json.dumps(finite(found), indent=1) + "\n")


def _part(options: argparse.Namespace, results: Sequence[Result]) -> Part:
    """The command, what came of it in a line, and the tables, of one plant."""
    words = ["python -m benchmarks.adversary"]
    for name, default in (
        ("robots", USUAL),
        ("attacks", None),
        ("plants", ["exact"]),
        ("periods", list(PERIODS)),
        ("no_preview", False),
        ("steps", None),
        ("seed", 0),
    ):
        value = getattr(options, name)
        if value != default:
            listed = value if isinstance(value, list) else [value]
            said = "" if value is True else " " + ",".join(map(str, listed))
            words.append(f"--{name.replace('_', '-')}{said}")
    found = f"{verdict_line(results).capitalize()}."
    if lines := not_run(results):
        found += f" Not run: {'; '.join(lines.replace('* ', '').splitlines())}."
    tables = plant_tables(results)
    return Part(" ".join(words), machine_line(), version_line(), tables, found)


def replay(path: Path, console: Console) -> bool:
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
    console.print(
        f"{case.attack} on {case.robot} ({task_set}) at {1e3 * case.period:g} ms, "
        f"{case.plant} plant, {done.steps} steps"
        + (", then it diverged" if done.diverged else "")
    )
    first = "never" if verdict.first is None else f"at state {verdict.first}"
    console.print(
        f"first violation (of distance or limits): {first}\n"
        f"smallest distance {1e3 * verdict.clearance:.3f} mm ({verdict.pair}), on "
        f"braking paths {1e3 * verdict.path_clearance:.3f} mm ({verdict.path_pair})\n"
        f"{verdict.penetrating} states penetrate, {verdict.beyond_limit} are beyond a "
        f"limit, {verdict.ahead} brake to beyond one (worst {verdict.excess:.3g}, "
        f"{verdict.joint or 'none'}), {verdict.too_fast} are too fast (worst "
        f"{verdict.overspeed:.3g} times the limit)"
    )
    return verdict.violated or done.diverged


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """The options; names and numbers are checked."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.adversary", description=__doc__.splitlines()[0]
    )

    def names(known: Sequence[str], what: str):
        def parse_names(text: str) -> list[str]:
            chosen = text.split(",")
            for name in chosen:
                if name not in known:
                    raise argparse.ArgumentTypeError(
                        f"no {what} {name!r}{nearest(name, list(known))}"
                    )
            return chosen

        return parse_names

    def periods(text: str) -> list[float]:
        try:
            values = [float(x) for x in text.split(",")]
        except ValueError:
            values = [0.0]
        if not all(1e-5 <= x <= 0.1 for x in values):
            raise argparse.ArgumentTypeError(
                f"{text!r}: give seconds from 1e-5 to 0.1, with commas between"
            )
        return values

    def count(text: str) -> int:
        if not text.isdecimal() or int(text) < 1:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above 0")
        return int(text)

    def seed(text: str) -> int:
        if not text.isdecimal():
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number")
        return int(text)

    parser.add_argument(
        "--robots",
        type=names(ROBOTS, "robot"),
        default=list(USUAL),
        help=f"by default all but {' and '.join(ASKED_FOR)}",
    )
    parser.add_argument(
        "--attacks",
        type=lambda text: text.split(","),
        help="by default all; those on the filter are others than those on the law",
    )
    parser.add_argument("--periods", type=periods, default=list(PERIODS))
    parser.add_argument(
        "--plants",
        type=names(PLANTS, "plant"),
        default=["exact"],
        help="exact (default), torque, filter, or several",
    )
    parser.add_argument("--constraints", choices=list(MODES), default="lookahead")
    parser.add_argument(
        "--no-preview", action="store_true", help="attack the law without a preview"
    )
    parser.add_argument(
        "--steps",
        type=count,
        help=f"control steps a case, at least; {EXACT_STEPS} by default, "
        f"{TORQUE_STEPS} with torque, {QUICK_STEPS} if --quick",
    )
    parser.add_argument("--seed", type=seed, default=0)
    parser.add_argument("--processes", type=count, default=os.cpu_count())
    parser.add_argument("--quick", action="store_true", help="few steps a case")
    parser.add_argument("--out", type=Path, default=Path("out/adversary"))
    parser.add_argument(
        "--page",
        type=Path,
        help="write the tables into this page, between its marks for what was run",
    )
    parser.add_argument("--replay", type=Path, metavar="FILE")
    options = parser.parse_args(argv)
    known = [attack for plant in options.plants for attack in attacks_on(plant)]
    for name in options.attacks or ():
        if name not in known:
            parser.error(
                f"argument --attacks: no attack {name!r}{nearest(name, known)}"
            )
    return options


def main(argv: Sequence[str] | None = None) -> int:
    """Runs it, prints the tables, and returns the exit code."""
    options = parse(argv)
    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDTH)
    try:
        if options.replay is not None:
            return int(replay(options.replay, console))
        check_folder(options.out)
        part = "+".join(options.plants) + " no preview" * options.no_preview
        if options.page is not None:
            check_part(options.page, part)
        for robot in options.robots:  # better to know now that one is not imported
            load_subject(robot)
        cases = []
        for plant in options.plants:
            default = TORQUE_STEPS if plant == "torque" else EXACT_STEPS
            steps = options.steps or (QUICK_STEPS if options.quick else default)
            cases += make_cases(
                options.robots,
                options.attacks,
                options.periods,
                [plant],
                constraints=options.constraints,
                preview=not options.no_preview,
                steps=steps,
                seed=options.seed,
            )
        results = run_all(cases, options.out, options.processes, console)
        if options.page is not None:
            write_part(options.page, part, _part(options, results))
    except CrarError as error:
        print(f"adversary: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped; the same command goes on", file=sys.stderr)
        return 130
    console.print(rich_table(results))
    console.print(verdict_line(results))
    console.print(f"in {options.out}: {TABLES}, {WHOLE}, {LINES}, {FOUND}/")
    if any(r.unsafe for r in results if r.case.plant != "torque"):
        return 1
    return 2 if any(r.error for r in results) else 0


if __name__ == "__main__":
    sys.exit(main())
