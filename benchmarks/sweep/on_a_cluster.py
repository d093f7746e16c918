"""`python -m benchmarks.sweep` on a cluster of Dask's; here on one machine.

Any executor of `concurrent.futures` does. A cluster's workers need this package and,
for motions that are files, the same paths; the results are written here, as they
come in, and the same call continues a sweep that was stopped.

    python -m pip install -e ".[cluster]"
    python -m benchmarks.sweep.on_a_cluster [results.csv] [seconds of each motion]
"""

import sys

from distributed import Client

from benchmarks.sweep.cases import Result, find_motions, make_cases, run_sweep
from benchmarks.sweep.report import markdown_report
from crar_drake import Scenario


def show(done: int, total: int, newest: Result) -> None:
    print(f"{done} of {total}: {newest.motion}, {newest.constraints}")


def main() -> None:
    out = sys.argv[1] if len(sys.argv) > 1 else "results.csv"
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else None
    cases = make_cases(
        find_motions(["dance", "reaching"]),
        experiments=["wrists"],
        constraints=["paper", "lookahead"],
    )
    common = Scenario(motion="dance", experiment="wrists", duration=seconds)
    # A process per core, each with one thread, since Python's threads would share a
    # core. A cluster elsewhere is Client("tcp://its-scheduler:8786").
    with Client(threads_per_worker=1, dashboard_address=None) as client:
        results = run_sweep(
            cases, out, scenario=common, executor=client.get_executor(), progress=show
        )
    print(markdown_report(results))


if __name__ == "__main__":  # the worker processes import this file, too
    main()
