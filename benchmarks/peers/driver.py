r"""What every peer's driver shares: the problem, the loop, the clock, the result.

Imports NumPy only, so that it runs in each peer's own environment. A driver makes a
`Controller` from (problem, period, settings) and calls `main`:

    python -m benchmarks.peers.run_PEER FOLDER \
        '[{"case": "crossing", "period": 0.005, "settings": {}, "out": "x.npz"}]'

The loop is the same for all. At t_k the controller is given q_k, v_k and the targets,
and answers with joint velocities or accelerations; these are integrated by

    v_{k+1} = v or v_k + period * a,     q_{k+1} = q_k + period * v_{k+1}.

A step without an answer stops the robot: v_{k+1} = 0. The clock runs from handing over
the state to having the answer, with everything that the controller needs to update.
"""

import argparse
import json
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np


class NoAnswer(Exception):
    """The controller has no command for this step."""


@dataclass(frozen=True)
class Targets:
    """What a controller is asked at t_k, for all tasks in order.

    Attributes:
        p, v, a: (tasks, 3) targets at t_k [m, m/s, m/s^2].
        v_step: (tasks, 3) mean velocity of the targets until t_{k+1} [m/s]: the
            feedforward with which a velocity controller has no lag.
    """

    p: np.ndarray
    v: np.ndarray
    a: np.ndarray
    v_step: np.ndarray


class Problem:
    """The folder that `problem.py` wrote.

    Attributes:
        folder: where the robot's files lie.
        robot: name of the shipped robot that they are made from.
        base: its link that stands in the world.
        joints: (n) names, in the order of all arrays.
        lower, upper: (n,) position limits [rad], infinite where there are none.
        velocity_limits: (n,) [rad/s].
        links: links whose origins are the task points.
        pairs: watched pairs of links.
        rest: (n,) rest posture [rad].
        guarded: links that are kept from obstacles that move, in their scenes.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        data = json.loads((folder / "problem.json").read_text())
        self.robot: str = data["robot"]
        self.base: str = data["base"]
        self.joints: list[str] = data["joints"]
        self.lower = np.array([-np.inf if x is None else x for x in data["lower"]])
        self.upper = np.array([np.inf if x is None else x for x in data["upper"]])
        self.velocity_limits = np.array(data["velocity_limits"])
        self.links: list[str] = data["task_links"]
        self.pairs: list[list[str]] = data["pairs"]
        self.rest = np.array(data["rest"])
        self.guarded: list[str] = data.get("guarded", [])


class Controller:
    """One peer, set up for a problem; drivers override these.

    Attributes:
        packages: distributions whose versions are noted.
        commands: "velocity" or "acceleration".
    """

    packages: tuple[str, ...] = ()
    commands = "velocity"

    def __init__(self, problem: Problem, period: float, settings: dict) -> None:
        raise NotImplementedError

    def reset(self, q: np.ndarray) -> None:
        """Prepares for a run from rest at q (n,)."""

    def solve(self, q: np.ndarray, v: np.ndarray, targets: Targets) -> np.ndarray:
        """The command (n,) for one period; raises NoAnswer."""
        raise NotImplementedError

    def after(
        self, q: np.ndarray, v: np.ndarray, command: np.ndarray | None, period: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """q and v a period after the command; without one (None) the robot stops."""
        if command is None:
            v = np.zeros_like(v)
        elif self.commands == "velocity":
            v = command
        else:
            v = v + period * command
        return q + period * v, v

    def record(
        self, case: Path, period: float, seconds: float | None
    ) -> dict[str, np.ndarray]:
        """Runs a case; what `run` returns."""
        return run(self, case, period, seconds)


def run(
    controller: Controller, case: Path, period: float, seconds: float | None = None
) -> dict[str, np.ndarray]:
    """Drives a controller through a case.

    Returns:
        What `loop` does, and time (T + 1,) and the targets p (T + 1, tasks, 3).
    """
    data = np.load(case)
    stride = round(period / (data["time"][1] - data["time"][0]))
    clock, p, v_d, a_d = (data[key][::stride] for key in ("time", "p", "v", "a"))
    if seconds is not None:
        clock = clock[: round(seconds / period) + 1]

    def asked(k: int, q: np.ndarray) -> Targets:
        return Targets(p[k], v_d[k], a_d[k], (p[k + 1] - p[k]) / period)

    done = loop(controller, data["q_start"], len(clock) - 1, period, asked)
    return done | {"time": clock, "p": p[: len(clock)]}


def loop(
    controller: Controller,
    start: np.ndarray,
    steps: int,
    period: float,
    asked: Callable[[int, np.ndarray], object],
) -> dict[str, np.ndarray]:
    """T steps from rest at start (n,).

    Args:
        controller: whose `solve` is called.
        start, steps, period: positions [rad], T, and [s].
        asked: what it is asked at t_k, where the robot is at q.

    Returns:
        q and v (T + 1, n); step_time (T,) [s], the processor time of all threads in
        the step, which does not count what other programs take; no_answer (T,).
    """
    q = np.empty((steps + 1, len(start)))
    v = np.zeros_like(q)
    q[0] = start
    step_time, no_answer = np.empty(steps), np.zeros(steps, dtype=bool)
    controller.reset(q[0])
    for k in range(steps):
        targets = asked(k, q[k])
        began = time.process_time()
        try:
            command = controller.solve(q[k], v[k], targets)
        except NoAnswer:
            command = None
        step_time[k] = time.process_time() - began
        no_answer[k] = command is None or not np.isfinite(command).all()
        q[k + 1], v[k + 1] = controller.after(
            q[k], v[k], None if no_answer[k] else command, period
        )
    return {"q": q, "v": v, "step_time": step_time, "no_answer": no_answer}


@dataclass(frozen=True)
class Spheres:
    """N obstacles as they are measured at t_k.

    Attributes:
        centres: (N, 3) [m].
        velocities: (N, 3) of the last period [m/s].
        radii, speeds: (N,) and the bounds of their speeds [m], [m/s].
    """

    centres: np.ndarray
    velocities: np.ndarray
    radii: np.ndarray
    speeds: np.ndarray


class Guard(Controller):
    """Passes wanted joint velocities among spheres that move; `solve` answers joint
    velocities.

    A case has time (T,) [s], q_start (n,), the postures that are wanted, q (T, n) [rad
    or m], how fast at most, fastest (n,), and the spheres, as `Spheres` calls them,
    with centres (T, N, 3). What is wanted is the same for all:

        v_d = GAIN (q_wanted - q), each joint at most as fast as that.
    """

    GAIN = 3.0  # [1/s]

    def solve(
        self, q: np.ndarray, v: np.ndarray, targets: tuple[np.ndarray, Spheres]
    ) -> np.ndarray:
        return self.guard(q, *targets)

    def guard(self, q: np.ndarray, v: np.ndarray, spheres: Spheres) -> np.ndarray:
        """The command (n,) in place of v (n,) for one period; raises NoAnswer."""
        raise NotImplementedError

    def record(
        self, case: Path, period: float, seconds: float | None
    ) -> dict[str, np.ndarray]:
        """Runs a case; what `run` returns, without targets."""
        data = dict(np.load(case))
        centres = data["centres"]

        def asked(k: int, q: np.ndarray) -> tuple[np.ndarray, Spheres]:
            moved = (centres[k] - centres[max(k - 1, 0)]) / period
            seen = Spheres(centres[k], moved, data["radii"], data["speeds"])
            wanted = self.GAIN * (data["q"][k] - q)
            return np.clip(wanted, -data["fastest"], data["fastest"]), seen

        steps = len(data["time"]) - 1
        done = loop(self, data["q_start"], steps, period, asked)
        return done | {"time": data["time"]}


def main(make: type[Controller]) -> None:
    """Command line of a driver: runs a list of jobs, one after the other."""
    parser = argparse.ArgumentParser()
    parser.add_argument("problem", type=Path)
    parser.add_argument("jobs", help='JSON: [{"case", "period", "settings", "out"}]')
    arguments = parser.parse_args()
    problem = Problem(arguments.problem)
    for job in json.loads(arguments.jobs):
        controller = make(problem, job["period"], job["settings"])
        result = controller.record(
            arguments.problem / f"{job['case']}.npz", job["period"], job.get("seconds")
        )
        np.savez(
            job["out"],
            versions=json.dumps(
                {"python": platform.python_version()}
                | {name: version(name) for name in make.packages}
            ),
            **result,
        )
