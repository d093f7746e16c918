"""`crar-drake judge`: a saved log's collisions and passed joint limits."""

from __future__ import annotations

import argparse
from pathlib import Path

from crar_drake.commands.options import add_command, add_robot, positive
from crar_drake.errors import CrarError


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "judge",
        run,
        "Count the collisions and passed joint limits of a saved log, independently "
        "of the controller; of imported robots also by the hulls of their meshes.",
    )
    parser.add_argument("log", type=Path, metavar="LOG", help="the log.npz of a run")
    add_robot(parser)
    parser.add_argument(
        "--every",
        type=positive,
        default=0.02,
        metavar="S",
        help="look at the meshes' hulls every S seconds (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    from crar_drake.results.hull_judge import HullJudge, has_hulls
    from crar_drake.results.log import SimulationLog
    from crar_drake.results.logged_robot import check_logged_robot, load_logged_robot
    from crar_drake.results.referee import Referee
    from crar_drake.robot.model import ControlModel
    from crar_drake.simulation.scenario import parse_scenario

    log = SimulationLog.load(arguments.log)
    scenario = parse_scenario(log.scenario, "the log's scenario")
    description = load_logged_robot(log, arguments.robot or "")
    model = ControlModel.FromDescription(description, scenario.task_list())
    check_logged_robot(log, model.plant, description)
    try:
        capsules = Referee(
            model.plant, model.scene_graph, description.pairs
        ).violations(log.q)
    except ValueError as error:
        raise CrarError(f"{arguments.log}: {error}") from error
    print(
        f"referee, collision shapes, {capsules.num_samples} samples: "
        f"{capsules.num_penetrating} in penetration, {capsules.num_beyond_limit} "
        f"beyond a joint limit, smallest distance "
        f"{1e3 * capsules.smallest_distance:.1f} mm"
        + _of_pair(capsules.smallest_distance_pair)
    )
    if not has_hulls(description):
        return
    steps = max(1, len(log.time) - 1)
    period = (log.time[-1] - log.time[0]) / steps or arguments.every
    every = max(1, round(arguments.every / period))
    hulls = HullJudge(description).judge(log.q[::every])
    print(
        f"convex hulls of the real meshes, {hulls.num_samples} samples: "
        f"{hulls.num_penetrating} in penetration, smallest distance "
        f"{1e3 * hulls.smallest_distance:.1f} mm"
        + _of_pair(hulls.smallest_distance_pair)
    )
    for a, b in hulls.left_out:
        print(f"left out, since their hulls overlap in the rest posture: {a} - {b}")


def _of_pair(pair: tuple[str, str] | None) -> str:
    return f" ({pair[0]} - {pair[1]})" if pair else ""
