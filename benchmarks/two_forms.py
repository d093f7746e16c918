"""What the second forms of the equations' functions are worth without Numba.

    python -m benchmarks.two_forms

A function of `equations` may stand twice: in NumPy, and in loops that Numba compiles.
Without Numba the NumPy form runs. This measures a control step in plain NumPy, seven
points of the upper body on their way into the trunk, and how much longer it is if one
of the functions runs its loops instead. A few minutes; ratios of medians.
"""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

STEPS = 120


def names() -> list[str]:
    """The loops of all functions with two forms."""
    folder = Path(__file__).resolve().parents[1] / "crar_drake" / "equations"
    text = "".join(path.read_text() for path in sorted(folder.glob("*.py")))
    return sorted(set(re.findall(r"compiled\(loops=(_\w+)\)", text)))


def median_step(loops: str) -> float:
    """The median time of a step [s] if these loops run in Python, in this process."""
    from crar_drake.equations import compilation

    def compiled(function=None, *, loops=None):
        if function is None:
            return lambda decorated: compiled(decorated, loops=loops)
        return loops if callable(loops) and loops.__name__ == slow else function

    slow, compilation.compiled = loops, compiled
    from crar_drake import ControlLaw, ControlModel, CrarParameters
    from crar_drake.robot.description import load_robot_description
    from crar_drake.robot.task import EXPERIMENTS, position_tasks

    description = load_robot_description("upper_body")
    tasks = position_tasks(EXPERIMENTS["upper-body"])
    model = ControlModel.FromDescription(description, tasks)
    law = ControlLaw(model, CrarParameters(period=0.005, blend_time=0.0))
    q, v = model.rest_positions(), np.zeros(model.plant.num_velocities())
    targets, prescribed = model.tasks_at(q), model.prescribed_at(q)
    points = targets[: 3 * len(tasks)].reshape(-1, 3)
    points[:, :2] *= 0.1  # into the trunk
    times = []
    for _ in range(STEPS):
        start = time.process_time()
        solution = law.step(q, v, targets, prescribed)
        times.append(time.process_time() - start)
        q, v = np.split(solution.position_command, [len(q)])
    return float(np.median(times[1:]))


def main() -> None:
    if len(sys.argv) > 1:
        print(median_step(sys.argv[1]))
        return
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}

    def measure(loops: str) -> float:
        command = [sys.executable, "-m", "benchmarks.two_forms", loops]
        run = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True
        )
        return float(run.stdout)

    print("a step takes, with these loops in Python, times as long as without:")
    for loops in names():
        base = min(measure("none"), measure("none"))
        print(f"{min(measure(loops), measure(loops)) / base:6.2f}  {loops}", flush=True)


if __name__ == "__main__":
    main()
