"""Cases in processes; what came of them is kept, so that a stopped run goes on.

A result is a dataclass with a `case`, which can be hashed, and an `error`, "" if the
case could be run.
"""

import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict
from itertools import chain, count
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

from rich import progress
from rich.console import Console
from rich.table import Column

import crar_drake
from crar_drake.commands.output import continuing
from crar_drake.errors import CrarError
from crar_drake.files import check_file, sole_writer, write_whole

Result = Any  # of a benchmark, see the module


def source_digest(*folders: Path, settings: str = "") -> str:
    """Twelve digits that change with the source of the package or of these folders, and
    with settings that are no part of the cases."""
    digest = hashlib.sha256(settings.encode())
    for folder in (Path(crar_drake.__file__).parent, *folders):
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def run_cases(
    run: Callable[[Any], Result],
    cases: Sequence[Any],
    path: Path,
    pool: AbstractContextManager[Executor | None],
    *,
    made_of: str,
    parse: Callable[[dict], Result],
    failed: Callable[[Any, str], Result],
    is_whole: Callable[[Result], bool] = lambda result: True,
    headline: Callable[[Result], str] = lambda result: "",
) -> list[Result]:
    """Runs the cases that the file has no result of, and keeps each as it comes.

    Args:
        run: makes the result of a case, in another process if there is a pool.
        cases: what to run.
        path: of the file, JSON; results that say another `made_of` do not count: their
            file is renamed to end in .old.json (.old2.json, where that is taken), and
            a line on stderr says so.
        pool: its processes; None: this process, one case after the other.
        made_of: what results depend on beside their cases, see `source_digest`.
        parse: makes a result of its fields, as `dataclasses.asdict` has them.
        failed: makes the result of a case that could not be run, for a reason.
        is_whole: whether what else belongs to a kept result is there, too.
        headline: a line about a result, as it comes.

    Returns:
        The results of all cases, in their order.

    Raises:
        CrarError: the file holds something else; or another process writes to it.
        WriteError: it cannot be written.
    """
    wanted = list(dict.fromkeys(cases))
    check_file(path)
    with continuing(path), sole_writer(path):
        kept = {r.case: r for r in _kept(path, made_of, parse) if is_whole(r)}
        waiting = [case for case in wanted if case not in kept]
        with pool as executor, _bar(len(wanted), len(waiting)) as show:
            for case, make in _begun(run, waiting, executor):
                try:
                    result = make()
                except Exception as error:  # a crash is a finding, and ends no run
                    result = failed(case, in_a_line(error))
                kept[case] = result
                write_results(path, made_of, kept.values())
                show(headline(result))
    return [kept[case] for case in wanted]


def _kept(path: Path, made_of: str, parse: Callable[[dict], Result]) -> list[Result]:
    """The results that a file has, without cases that failed; made of something else,
    the file makes way.

    Raises:
        CrarError: it holds something else.
    """
    if not path.exists():
        return []
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        same, results = kept["made_of"] == made_of, list(kept["results"])
        if same:
            return [r for r in map(parse, results) if not r.error]
    except (ValueError, KeyError, TypeError) as error:
        raise CrarError(
            f"{path} is not a file of results; give another --out"
        ) from error
    names = (path.with_suffix(f".old{n}.json") for n in chain([""], count(2)))
    old = next(name for name in names if not name.exists())
    path.rename(old)
    print(
        f"{path}: its results are of other settings or another source; they are now "
        f"in {old}",
        file=sys.stderr,
    )
    return []


def write_results(path: Path, made_of: str, results: Iterable[Result]) -> None:
    """Writes all of them, a line each."""
    lines = ",\n".join(json.dumps(asdict(result)) for result in results)
    text = f'{{"made_of": {json.dumps(made_of)}, "results": [\n{lines}\n]}}\n'
    write_whole(path, text)


@contextmanager
def workers(count: int) -> Iterator[Executor | None]:
    """A pool of processes that run many cases each; None for one, which is this."""
    if count == 1:
        yield None
        return
    # Read by the libraries when a new process loads them.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
        try:
            yield pool
        except BaseException:
            # A case may take minutes, and the pool would wait for those under way.
            for process in active_children():
                process.terminate()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _begun(run: Callable, cases: Sequence, executor: Executor | None) -> Iterator:
    """Each case as it is finished, and a call that gives or makes its result."""
    if executor is None:
        yield from ((case, lambda case=case: run(case)) for case in cases)
        return
    futures = {executor.submit(run, case): case for case in cases}
    yield from ((futures[each], each.result) for each in as_completed(futures))


def in_a_line(error: Exception) -> str:
    """What a result's `error` says of an exception."""
    known = isinstance(error, crar_drake.CrarError)
    text = f"{error}" if known else f"{type(error).__name__}: {error}"
    return " ".join(text.split())


@contextmanager
def _bar(total: int, waiting: int) -> Iterator[Callable[[str], None]]:
    """Yields what draws on stderr that one more is finished, with a line about it."""
    columns = (
        progress.BarColumn(bar_width=20),
        progress.MofNCompleteColumn(),
        progress.TextColumn("ETA"),
        progress.TimeRemainingColumn(table_column=Column(min_width=7)),
        progress.TextColumn(
            "{task.fields[newest]}",
            markup=False,
            table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis"),
        ),
    )
    # A case takes up to minutes, so that a short average would know no speed.
    with progress.Progress(
        *columns, console=Console(stderr=True), speed_estimate_period=3600, expand=True
    ) as bar:
        task = bar.add_task("", total=total, completed=total - waiting, newest="")
        yield lambda line: bar.update(task, advance=1, newest=line)
