"""How long the law takes to be ready, compiling it first or finding it compiled.

`python -m benchmarks.step_compiling [MODE]` prints what this one process took, as JSON.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace

from benchmarks.page import ROOT
from crar_drake.errors import CrarError


def measure_compiling(constraints: str = "lookahead") -> dict[str, dict[str, float]]:
    """What the first process takes, and a later one, each without and with a cache.

    Args:
        constraints: of the law; the paper's take half as long to compile.

    Returns:
        "first" and "later": "wall" and "cpu" [s], see `measure_here`.

    Raises:
        CrarError: a process failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = [str(ROOT), os.environ.get("PYTHONPATH", "")]
        environment = os.environ | {
            "NUMBA_CACHE_DIR": folder,
            "PYTHONPATH": os.pathsep.join(filter(None, path)),
        }
        return {
            name: measure_process(environment, constraints)
            for name in ("first", "later")
        }


def measure_process(environment: dict[str, str], constraints: str) -> dict[str, float]:
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
    from crar_drake.control.law import ControlLaw
    from crar_drake.simulation.diagram import PrepareScenario
    from crar_drake.simulation.scenario import load_scenario

    wall, cpu = time.perf_counter(), time.process_time()
    scenario = load_scenario("dance")
    scenario.controller = replace(scenario.controller, constraints=constraints)
    ControlLaw(PrepareScenario(scenario).model, scenario.controller).compile()
    return {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}


if __name__ == "__main__":
    print(json.dumps(measure_here(*(sys.argv[1:2] or ["lookahead"]))))
