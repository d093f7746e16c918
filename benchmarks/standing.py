"""Does a robot that stands stay on its feet, in Drake's contact simulation?

    python -m benchmarks.standing [--runs 20] [--seeds 1 2 ...] [--pelvis]
                                  [--page PAGE]

Wrists of robots that nothing but a floor carries are asked for swings of up to 3 Hz and
30 cm, with `balance` and without. The controller believes the model; the robot is as
believed, or a tenth heavier or lighter, on a floor with less friction, or pushed at its
neck with 30 N for a fifth of a second, in each second another way. Each run is one of
`crar-drake run`: a fall, and what touches or is beyond a limit, is found by its log.
Each seed has as many runs; what it has is kept in out/standing, or, of a pelvis
that sways and squats, in out/standing-pelvis, so that a benchmark that was stopped goes
on.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.balance import PERIOD, ROBOTS, TRACKED, swings
from benchmarks.kept import Kept, add_seeds, measured_by
from benchmarks.page import Benchmark, Table, run
from crar_drake.control.parameters import BalanceParameters, CrarParameters
from crar_drake.errors import ModelError
from crar_drake.results.summary import Summary
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.standing import standing_description
from crar_drake.robot.task import position_tasks
from crar_drake.run import run_scenario
from crar_drake.simulation.disturbances import Disturbances, Push
from crar_drake.simulation.scenario import Pelvis, Scenario, Standing
from crar_drake.targets.keyframes import Keyframe

FRICTION = 0.8
FRAME = 0.02  # between keyframes [s]
BEGIN = 1.0  # over which swings grow from nothing [s]
AS_BELIEVED = "as believed"
CONDITIONS = (AS_BELIEVED, "masses + 10 %", "masses - 10 %", "friction 0.5", "pushed")
HEADER = (
    *("robot", "it is", "law", "runs", "fell", "lean (median, most)", "soles slide"),
    *("with violations", "rms error (median)"),
)


def keyframes(robot: str, seed: int, seconds: float) -> dict[str, list[Keyframe]]:
    """Swings of each wrist about where it rests, from nothing on."""
    standing = standing_description(load_robot_description(robot))
    model = ControlModel.FromDescription(standing, position_tasks(TRACKED))
    home = model.layout.unpack(model.tasks_at(model.rest_positions())).p.ravel().copy()
    wanted = swings(home, np.random.default_rng(seed))
    frames: dict[str, list[Keyframe]] = {name: [] for name in TRACKED}
    for t in np.arange(0.0, seconds + 0.5 * FRAME, FRAME):
        share = min(1.0, t / BEGIN)
        at = home + share * (wanted(t)[: len(home)] - home)
        for name, xyz in zip(TRACKED, at.reshape(-1, 3), strict=True):
            frames[name].append(Keyframe(time=float(t), xyz=xyz.tolist()))
    return frames


def scenario(
    robot: str,
    condition: str,
    balanced: bool,
    seed: int,
    seconds: float,
    pelvis: bool = False,
) -> Scenario:
    """A run's."""
    rng = np.random.default_rng([seed, 1])
    disturbances, friction = Disturbances(), FRICTION
    if condition.startswith("masses"):
        disturbances.mass_scale = 1.1 if "+" in condition else 0.9
    elif condition.startswith("friction"):
        friction = 0.5
    elif condition == "pushed":
        for start in np.arange(1.0, seconds, 1.0):
            way = rng.uniform(0.0, 2.0 * np.pi)
            force = [float(30.0 * np.cos(way)), float(30.0 * np.sin(way)), 0.0]
            disturbances.pushes.append(Push("neck", force, float(start), 0.2))
    parameters = CrarParameters(
        period=PERIOD,
        velocity_scale=0.9,
        balance=BalanceParameters() if balanced else None,
    )
    return Scenario(
        robot=robot,
        tasks=position_tasks(TRACKED),
        keyframes=keyframes(robot, seed, seconds),
        standing=Standing(friction, Pelvis() if pelvis else None),
        controller=replace(
            parameters,
            lookahead=replace(parameters.lookahead, horizon=0.1, tracking_error=0.003),
        ),
        disturbances=disturbances,
    )


def figures(summary: Summary) -> dict[str, float | bool]:
    """What is kept of a run."""
    stance = summary.stance
    return {
        "fell": stance.fell is not None,
        "lean": float(stance.lean),
        "slide": float(stance.slide),
        "bad": bool(summary.penetrating_samples or summary.beyond_limit_samples),
        "error": float(summary.rms_task_error),
    }


def cells(runs: Sequence[dict]) -> list[str]:
    """Of a row, what was seen in its runs."""
    leans = np.degrees([each["lean"] for each in runs])
    return [
        *(f"{len(runs)}", f"{sum(each['fell'] for each in runs)}"),
        f"{np.median(leans):.1f}°, {leans.max():.1f}°",
        f"{1e3 * max(each['slide'] for each in runs):.0f} mm",
        f"{sum(each['bad'] for each in runs)}",
        f"{1e3 * np.median([each['error'] for each in runs]):.0f} mm",
    ]


def run_all(runs: int, seconds: float, seed: int, pelvis: bool = False) -> Kept:
    """The runs of one seed, from where it was stopped.

    Args:
        runs: of a robot as believed, with balance; a quarter of each other kind.
        seconds: of a run.
        seed: of all dice.
        pelvis: whether it sways and squats.
    """
    kept = Kept("standing-pelvis" if pelvis else "standing", seed)
    for k in range(runs):
        dice = int(np.random.default_rng([seed, k]).integers(2**31))
        for robot in ROBOTS:
            for condition in CONDITIONS:
                rest = k >= runs // 4
                if condition != AS_BELIEVED and rest:
                    continue
                for law in ("balance",) if rest else ("balance", "without"):
                    key = f"{robot}; {condition}; {law}; {seconds:g} s; {k}"
                    if key in kept.results:
                        continue
                    try:
                        each = scenario(
                            robot, condition, law == "balance", dice, seconds,
                            pelvis,
                        )  # fmt: skip
                    except ModelError as error:
                        print(f"left out: {error}", file=sys.stderr)
                        break
                    summary = run_scenario(each).summary
                    kept.keep({key: figures(summary)})
                    told = summary.stance.line()
                    print(f"seed {seed}: {key}: {told}", file=sys.stderr)
    return kept


def main(argv: Sequence[str] | None = None) -> None:
    """Runs all, and prints or writes the table."""
    benchmark = Benchmark("benchmarks.standing", __doc__, "standing")
    parser = benchmark.parser
    parser.add_argument(
        "--runs", type=int, default=20,
        help="of each seed, of a robot as believed with balance; a quarter else",
    )  # fmt: skip
    parser.add_argument("--seconds", type=float, default=10.0, help="of a run")
    add_seeds(parser, "standing")
    parser.add_argument("--pelvis", action="store_true", help="sways and squats")
    options = benchmark.parse(argv, lambda of: "pelvis" if of.pelvis else "swings")
    seeds = [
        run_all(options.runs, options.seconds, seed, options.pelvis)
        for seed in options.seeds
    ]
    found: dict[tuple[str, str, str], list[dict]] = {
        (robot, condition, law): []
        for robot in ROBOTS
        for condition in CONDITIONS
        for law in ("balance", "without")
    }
    for kept in seeds:
        for key, figure in kept.results.items():
            *kind, length, _ = key.split("; ")
            if length == f"{options.seconds:g} s":
                found[tuple(kind)].append(figure)
    rows = [[*kind, *cells(runs)] for kind, runs in found.items() if runs]
    if not rows:
        raise ModelError("benchmarks.standing needs g1_whole_body or talos_whole_body")
    fell = []
    for name, law in (("with balance", "balance"), ("without", "without")):
        runs = [each for kind, of in found.items() if kind[2] == law for each in of]
        if runs:
            fell.append(f"{name} {sum(r['fell'] for r in runs)} of {len(runs)} fell")
    text = f"Runs of {options.seconds:g} s: {', '.join(fell)}. {measured_by(seeds)}"
    benchmark.report([Table(HEADER, rows)], text.strip())


if __name__ == "__main__":
    run(main)
