"""How long the law takes to be ready, compiling it first or finding it compiled.

`python -m benchmarks.step_compiling [MODE]` prints what this one process took, as JSON.
"""

import json
import os
import subprocess
import sys
import tempfile
import time

from benchmarks.page import ROOT, Table
from crar_drake.errors import CrarError


def measure_compiling() -> Table:
    """What the first process takes, and a later one, without and with a cache.

    Raises:
        CrarError: a process failed.
    """
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = [str(ROOT), os.environ.get("PYTHONPATH", "")]
        environment = os.environ | {
            "NUMBA_CACHE_DIR": folder,
            "PYTHONPATH": os.pathsep.join(filter(None, path)),
        }
        for name in (
            "the first one, which compiles",
            "a later one, which finds what was kept",
        ):
            took = measure_process(environment)
            rows.append([name, f"{took['wall']:.1f}", f"{took['cpu']:.1f}"])
    columns = ("process", "wall clock [s]", "processor time [s]")
    return Table(columns, rows, "Making model and law ready for the first step")


def measure_process(
    environment: dict[str, str], constraints: str = "lookahead"
) -> dict[str, float]:
    """What `measure_here` tells of a process with that environment.

    Raises:
        CrarError: it failed.
    """
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.step_compiling", constraints],
        env=environment,
        capture_output=True,
        text=True,
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["nothing was said"])[-1]
        raise CrarError(f"compiling cannot be measured: {last}")
    return json.loads(done.stdout)


def measure_here(constraints: str) -> dict[str, float]:
    """Wall and processor time [s] of making model and law of the main command's
    scenario, ready for the first step. Imports do not count."""
    from crar_drake.law.control_law import ControlLaw
    from crar_drake.law.parameters import with_constraints
    from crar_drake.simulation.diagram import PrepareScenario
    from crar_drake.simulation.scenario import load_scenario

    wall, cpu = time.perf_counter(), time.process_time()
    scenario = load_scenario("dance")
    scenario.controller = with_constraints(scenario.controller, constraints)
    ControlLaw(PrepareScenario(scenario).model, scenario.controller).compile()
    return {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}


if __name__ == "__main__":
    print(json.dumps(measure_here(*(sys.argv[1:2] or ["lookahead"]))))
