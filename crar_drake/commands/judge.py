"""`crar-drake judge`: a saved log's collisions, passed limits, and its certificate."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from crar_drake.commands.judge_references import (
    add_reference_judge_options,
    is_reference_or_folder,
    run_references,
)
from crar_drake.commands.options import (
    add_command,
    add_reference_options,
    count,
    positive,
)
from crar_drake.commands.output import FAST, counted, final_line
from crar_drake.errors import CrarError, few, plural

if TYPE_CHECKING:
    import numpy as np

    from crar_drake.judging.mesh_judge import MeshVerdict, Nearest, PairContact
    from crar_drake.results.certificate import CertificateVerdict, Place
    from crar_drake.results.log import SimulationLog
    from crar_drake.robot.description import RobotDescription

# Between the samples of a log in which meshes are judged [s].
_MESH_PERIOD = 0.02

# Pairs (and links) that are reported one by one.
_MOST_LINES = 5


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "judge",
        run,
        "Count the collisions and passed joint and speed limits of a saved log, "
        "independently of the controller; of robots with meshes also by the triangles "
        "of these, for all links more than one joint apart. A log with constraints "
        "lookahead says of its every control step how it could brake, and whether that "
        "is true is reported. The last line is OK, or VIOLATED and what, and the exit "
        "code then 1. It also judges reference motions of a whole "
        "robot (.csv, .npz, .pkl, or folders of them): penetration, joint and speed "
        "limits, ground, jumps, slip of planted feet. The exit code is 2 if a file "
        "cannot be used.",
    )
    parser.add_argument(
        "what",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="the log.npz of a run; or reference motions, or folders of them",
    )
    add_reference_options(parser, "; or of a log's, if it is not where it was")
    parser.add_argument(
        "--every",
        type=positive,
        metavar="S",
        help="look at the meshes every S seconds (default: of a log "
        f"{_MESH_PERIOD:g}, of a reference motion every frame)",
    )
    parser.add_argument(
        "--no-meshes",
        action="store_true",
        help="judge by the collision shapes alone, which takes less time",
    )
    parser.add_argument(
        "--paths-every",
        type=count,
        metavar="N",
        help="judge the braking path of every N-th control step, besides the nearest "
        "100 (default: of about 300)",
    )
    add_reference_judge_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Does what the arguments say, for a log or for reference motions.

    Returns:
        The exit code: see `run_log` and `judge_references.run_references`.
    """
    if arguments.certificate:
        from crar_drake.commands.judge_certificate import judge_certificates

        return judge_certificates(arguments)
    if any(is_reference_or_folder(path) for path in arguments.what):
        return run_references(arguments)
    if len(arguments.what) > 1:
        raise CrarError("logs are judged one at a time")
    (arguments.log,) = arguments.what
    return run_log(arguments)


def _load(path: Path) -> SimulationLog:
    """The log of a run.

    Raises:
        CrarError: it is none; nor, as has been asked before, a reference motion.
    """
    from crar_drake.results.log import NoLog, SimulationLog

    try:
        return SimulationLog.load(path)
    except NoLog as error:
        raise CrarError(
            f"{error}; nor is it a reference motion of a robot, by its suffix and "
            "arrays (docs/guides/reference-motions.md#layouts; of a person's motion "
            "`crar-drake retarget` makes one)"
        ) from error


def run_log(arguments: argparse.Namespace) -> int:
    """Judges a log.

    Returns:
        The exit code: 1 if a constraint or a speed limit is violated, meshes
        penetrate, or what the log says of braking paths is not true; else 0.
    """
    import numpy as np

    from crar_drake.judging.referee import Referee
    from crar_drake.results.certificate import has_certificate, judge_certificate
    from crar_drake.results.logged_robot import check_logged_robot, load_logged_robot
    from crar_drake.results.obstacles import judge_obstacles
    from crar_drake.results.remarks import clipped_line
    from crar_drake.results.standing_run import judged_speed_limits
    from crar_drake.robot.model import ControlModel
    from crar_drake.robot_import.link_meshes import has_meshes
    from crar_drake.simulation.scenario import parse_scenario

    log = _load(arguments.log)
    scenario = parse_scenario(log.scenario, "the log's scenario")
    description = load_logged_robot(log, arguments.robot or "")
    model = ControlModel.FromDescription(description, scenario.task_list())
    check_logged_robot(log, model.plant, description)
    meshes = None
    if not arguments.no_meshes and has_meshes(model.plant, model.scene_graph):
        meshes = _judge_meshes(log, description, arguments.every or _MESH_PERIOD)
    try:
        speeds = judged_speed_limits(scenario, model)
        referee = Referee(model.plant, model.scene_graph, description.pairs, speeds)
        capsules = referee.violations(log.q, log.v)
        verdict = None
        # Of a robot that stands the certificate is of its command, not of it.
        if has_certificate(log) and scenario.standing is None:
            verdict = judge_certificate(
                log,
                referee,
                scenario.law_parameters,
                scenario.plant_config.time_step,
                arguments.paths_every,
            )
    except ValueError as error:
        raise CrarError(f"{arguments.log}: {error}") from error
    print(
        f"referee, collision shapes, {capsules.num_samples} samples: "
        f"{capsules.num_penetrating} in penetration, {capsules.num_beyond_limit} "
        f"beyond a joint limit, "
        + (
            f"{capsules.num_beyond_speed} beyond a speed limit, "
            if np.isfinite(speeds).any()
            else ""
        )
        + f"smallest distance "
        f"{1e3 * capsules.smallest_distance:.1f} mm"
        + _of_pair(capsules.smallest_distance_pair)
    )
    if verdict is not None:
        for line in certificate_lines(verdict):
            print(line)
    if meshes is not None:
        for line in mesh_lines(*meshes):
            print(line)
    touched = judge_obstacles(
        log, scenario, model.plant, model.scene_graph, description.pairs
    )
    for name, figures in touched.items():
        print(
            f"obstacle {name}: smallest distance "
            f"{1e3 * figures.smallest_distance:.1f} mm, {figures.in_words()}"
        )
    if clipped := clipped_line(log):
        print(f"assumption broken: {clipped}")
    violated = [
        *counted(capsules.num_penetrating, "sample", "penetrate{s}"),
        *counted(capsules.num_beyond_limit, "sample", "beyond a joint limit"),
        *counted(capsules.num_beyond_speed, "sample", "beyond a speed limit"),
        *counted(sum(of.fast_contacts for of in touched.values()), "contact", FAST),
    ]
    if verdict is not None:
        figures = verdict.steps
        violated += counted(figures.penetrating, "braking path", "penetrate{s}")
        violated += counted(figures.beyond_limit, "braking path", "beyond a limit")
        violated += [] if verdict.true else ["the certificate is not true"]
    if meshes is not None:
        found = meshes[0].num_penetrating
        violated += counted(found, "sample", "with meshes that penetrate")
    return final_line(violated)


def certificate_lines(verdict: CertificateVerdict) -> list[str]:
    """The verdict in words."""
    lines = []
    for figures, where in (
        (verdict.steps, "control steps"),
        (verdict.between, "samples between control steps"),
    ):
        if not figures.judged:
            continue
        lines.append(
            f"referee, braking paths, {figures.judged} of {figures.of} {where}: "
            f"{figures.penetrating} in penetration, {figures.beyond_limit} that end "
            f"beyond a joint limit, {figures.below_floor} below the floor of "
            f"{1e3 * verdict.floor:.1f} mm, "
            + _near(figures.nearest, "smallest distance ", "nothing near")
        )
        if figures.beyond_limit:
            lines[-1] += (
                f"; farthest beyond a limit {figures.largest_excess_joint}, "
                f"{figures.largest_excess:.2g} rad"
            )
    clear = verdict.reported - verdict.reported_unclear
    claim = f"{clear} of {verdict.reported} control steps with a clear braking path"
    if math.isfinite(verdict.clearance):
        claim += f", distances of at least {1e3 * verdict.clearance:.1f} mm"
    if verdict.true:
        lines.append(f"certificate: {claim}: nothing refutes it")
        return lines
    lines.append(f"certificate: {claim}: NOT TRUE")
    if verdict.not_clear:
        lines.append(
            f"  {plural(verdict.not_clear, 'braking path')} said to be clear, but "
            "not: " + _near(verdict.not_clear_worst, "worst ")
        )
    if verdict.undercut:
        lines.append(
            f"  {plural(verdict.undercut, 'braking path')} nearer than said: "
            + _near(verdict.undercut_worst, "worst ")
            + f", where at least {1e3 * verdict.undercut_claim:.3f} mm were claimed"
        )
    return lines


def _near(place: Place, before: str, nothing: str = "") -> str:
    if place.pair is None:
        return nothing
    return (
        f"{before}{1e3 * place.distance:.3f} mm{_of_pair(place.pair)}, of the path at "
        f"{place.time:.3f} s"
    )


def _judge_meshes(
    log: SimulationLog, description: RobotDescription, period: float
) -> tuple[MeshVerdict, np.ndarray]:
    """What the meshes say, and when the samples are that were judged [s].

    It is asked for before anything else, for a mesh that cannot be read to be reported
    at once.
    """
    from crar_drake.robot_import.link_meshes import check_installed

    check_installed()
    from crar_drake.judging.mesh_judge import MeshJudge

    steps = max(1, len(log.time) - 1)
    every = max(1, round(period * steps / (log.time[-1] - log.time[0] or period)))
    return MeshJudge(description).judge(log.q, every), log.time


def mesh_lines(verdict: MeshVerdict, times: np.ndarray) -> list[str]:
    """The verdict of the meshes in words.

    Args:
        verdict: on a trajectory of T samples, or some of them.
        times: (T,) of the samples [s].
    """
    judged = (
        f"{plural(len(verdict.frames), 'sample')}, "
        f"{plural(verdict.num_pairs, 'pair')} of links more than one joint apart"
    )
    lines = [
        f"real meshes, triangles, {judged}: {verdict.num_penetrating} in penetration"
        + _nearest(verdict.nearest, times),
    ]
    for contact in verdict.penetrations[:_MOST_LINES]:
        lines.append(
            f"  {contact.pair[0]} - {contact.pair[1]}: meshes penetrate in "
            f"{plural(len(contact.frames), 'sample')}; deepest at "
            f"{times[contact.frame]:.3f} s, where a shift of "
            f"{1e3 * contact.depth:.1f} mm would part them"
        )
    lines += _more(verdict.penetrations, "whose meshes penetrate")
    if verdict.left_out:
        lines.append(
            "left out, since their meshes meet both at zero and in the rest posture: "
            + ", ".join(f"{a} - {b}" for a, b in verdict.left_out)
        )
    if verdict.open_links:
        lines.append(
            "meshes that are not closed, so that what is inside of them is where they "
            f"wind around at least half: {few(verdict.open_links, _MOST_LINES)}"
        )
    return lines


def _nearest(nearest: Nearest, times: np.ndarray) -> str:
    if nearest.pair is None:
        return ""
    return (
        f", smallest distance {1e3 * nearest.distance:.1f} mm"
        f"{_of_pair(nearest.pair)} at {times[nearest.index]:.3f} s"
    )


def _more(contacts: list[PairContact], which: str) -> list[str]:
    more = len(contacts) - _MOST_LINES
    return [f"  and {more} more {which}"] if more > 0 else []


def _of_pair(pair: tuple[str, str] | None) -> str:
    return f" ({pair[0]} - {pair[1]})" if pair else ""
