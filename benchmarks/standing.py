"""Does a robot that stands stay on its feet, in Drake's contact simulation?

    python -m benchmarks.standing [--runs 20] [--seconds 10] [--seed 1] [--page PAGE]

Wrists of robots that nothing but a floor carries are asked for swings of up to 3 Hz and
30 cm, with `balance` and without. The controller believes the model; the robot is as
believed, or a tenth heavier or lighter, on a floor with less friction, or pushed at its
neck with 30 N for a fifth of a second, in each second another way. Each run is one of
`crar-drake run`: a fall, and what touches or is beyond a limit, is found by its log.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.balance import PERIOD, ROBOTS, TRACKED, swings
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


def cells(summaries: Sequence[Summary]) -> list[str]:
    """Of a row, what was seen."""
    stood = [summary.stance for summary in summaries]
    leans = np.degrees([each.lean for each in stood])
    bad = sum(
        bool(each.penetrating_samples or each.beyond_limit_samples)
        for each in summaries
    )
    errors = [each.rms_task_error for each in summaries]
    fell = sum(each.fell is not None for each in stood)
    return [
        *(f"{len(stood)}", f"{fell}", f"{np.median(leans):.1f}°, {leans.max():.1f}°"),
        f"{1e3 * max(each.slide for each in stood):.0f} mm",
        *(f"{bad}", f"{1e3 * np.median(errors):.0f} mm"),
    ]


def main(argv: Sequence[str] | None = None) -> None:
    """Runs all, and prints or writes the table."""
    benchmark = Benchmark("benchmarks.standing", __doc__, "standing")
    parser = benchmark.parser
    parser.add_argument(
        "--runs", type=int, default=20, help="of a robot as believed; a quarter else"
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="of a run")
    parser.add_argument("--seed", type=int, default=1, help="of all dice")
    parser.add_argument("--pelvis", action="store_true", help="sways and squats")
    options = benchmark.parse(argv, lambda options: "swings")
    rows, count = [], 0
    for robot in ROBOTS:
        for condition in CONDITIONS:
            runs = options.runs if condition == AS_BELIEVED else options.runs // 4
            for law in ("balance", "without"):
                found = []
                for k in range(runs):
                    dice = int(np.random.default_rng([options.seed, k]).integers(2**31))
                    try:
                        each = scenario(
                            robot, condition, law == "balance", dice, options.seconds,
                            options.pelvis,
                        )  # fmt: skip
                    except ModelError as error:
                        print(f"left out: {error}", file=sys.stderr)
                        break
                    found.append(run_scenario(each).summary)
                    told = found[-1].stance.line()
                    print(f"{robot}, {condition}, {law}, {k}: {told}", file=sys.stderr)
                if found:
                    rows.append([robot, condition, law, *cells(found)])
                    count += len(found)
    if not rows:
        raise ModelError("benchmarks.standing needs g1_whole_body or talos_whole_body")
    text = f"{count} runs of {options.seconds:g} s."
    benchmark.report([Table(HEADER, rows)], text)


if __name__ == "__main__":
    run(main)
