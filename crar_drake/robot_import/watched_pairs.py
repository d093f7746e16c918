"""Which links are watched against each other and against the ground."""

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.errors import ModelError, nearest
from crar_drake.robot.description import GROUND, RobotDescription
from crar_drake.robot_import.anatomy import (
    elbow_index,
    find_anatomy,
    link_twins,
    longest_chains,
)
from crar_drake.robot_import.capsule_fitting import Capsules
from crar_drake.robot_import.import_report import ImportReport
from crar_drake.robot_import.pair_sampling import sample_pairs
from crar_drake.robot_import.source_robot import SourceRobot, poses_in
from crar_drake.robot_import.structure import welded_groups

# How far the ground is below the soles: what pairs keep, if nothing else is said [m].
_BELOW_SOLES = 0.005


def choose_pairs(
    plant: MultibodyPlant, robot: SourceRobot, rest: np.ndarray, report: ImportReport
) -> list[list[str]]:
    """Fills in the watched pairs; returns those left out since they touch at rest
    (nq,). The plant is finalized and has the report's capsules."""
    choices, capsules = report.choices, report.capsules()
    for link in itertools.chain(*(choices.pairs or ())):
        if link not in capsules:
            raise ModelError(
                f"{report.file}: pairs: {link!r} has no collision shape"
                f"{nearest(link, set(capsules))}"
            )
    if choices.pairs is not None:
        return []
    found = sample_pairs(
        plant,
        capsules,
        rest,
        candidate_pairs(robot, capsules),
        twins=link_twins(robot),
        always_watched=_hands_together(robot),
    )
    allowed = _allowed(robot, capsules, choices.segments)
    choices.pairs = [p for p in found.watched if frozenset(p) not in allowed]
    overlapping = [p for p in found.overlapping if frozenset(p) not in allowed]
    report.guessed["pairs"] = (
        "all that came within 2 cm, sampled and minimised, their mirror images, and "
        f"one forearm and hand with the other; {found.never} never did"
    )
    if left_out := [p for p in found.watched if frozenset(p) in allowed]:
        report.warnings.append(
            f"pairs: {', '.join(map(' - '.join, left_out))}: NOT watched, since "
            f"{Path(choices.srdf).name} lets them touch, although they came within "
            "2 cm"
        )
    for why, pairs in (
        ("touch in the rest posture", overlapping),
        ("nearly always touch", found.always),
    ):
        report.note(f"not watched, since they {why}", [*map(" - ".join, pairs)])
    return overlapping


def watch_ground(
    description: RobotDescription,
    plant: MultibodyPlant,
    rest: np.ndarray,
    report: ImportReport,
) -> None:
    """Links that move are kept above the ground; guessed for a root that floats.

    Not those whose capsules are below at rest (nq,), as feet's are if they are thicker
    than the soles are high: they would be lifted.
    """
    choices = report.choices
    if choices.ground is None and description.root == "prescribed":
        choices.ground = -_BELOW_SOLES
        if plant.HasBodyNamed(GROUND):
            choices.ground = -math.inf  # that name is taken
        report.guessed["ground"] = (
            "as far below the soles as pairs keep apart, so that feet stand on it"
        )
    if choices.ground is None or math.isinf(choices.ground):
        return
    if plant.HasBodyNamed(GROUND):
        raise ModelError(
            f"{report.file}: ground: the robot has a link {GROUND!r} of its own; say "
            "-.inf"
        )
    X_W = poses_in(plant, rest, report.capsules())
    fixed = {body.name() for body in plant.GetBodiesWeldedTo(plant.world_body())}
    watched, below = [], []
    for link, capsules in report.capsules().items():
        if link in fixed:
            continue
        lowest = min(
            X_W[link].multiply(end)[2] - capsule.radius
            for capsule in capsules
            for end in (capsule.p_L0, capsule.p_L1)
        )
        (watched if lowest >= choices.ground + _BELOW_SOLES - 1e-6 else below).append(
            link
        )
    description.ground = choices.ground if watched else None
    description.pairs = [*choices.pairs, *([link, GROUND] for link in watched)]
    report.notes.append(
        f"ground at {1e3 * choices.ground:.0f} mm: {len(watched)} links are watched "
        "against it"
        + (f", but not {', '.join(below)}: capsules too low at rest" if below else "")
    )


def _allowed(
    robot: SourceRobot, capsules: Capsules, segments: Mapping[str, Sequence[str]]
) -> set[frozenset[str]]:
    """Pairs of links with capsules, of all whose shapes an SRDF disables collisions."""
    if not robot.allowed:
        return set()
    inside = {
        name: [n for n in (name, *segments.get(name, ())) if not robot.is_bare(n)]
        for name in capsules
    }
    return {
        frozenset((a, b))
        for a, b in itertools.combinations(capsules, 2)
        if all(
            frozenset(pair) in robot.allowed
            for pair in itertools.product(inside[a], inside[b])
        )
    }


def _hands_together(robot: SourceRobot) -> set[frozenset[str]]:
    """One forearm, wrist and hand with the other's, whatever was found of them."""
    sides = []
    anatomy, X = find_anatomy(robot), robot.poses()
    if anatomy is not None:
        elbows = [arm.joints[elbow_index(X, arm)] for arm in anatomy]
        sides = [{*robot.below(elbow.child)} for elbow in elbows]
    elif len(ends := longest_chains(robot)) == 2:
        ways = [robot.moving_to(end) for end in ends]
        if not {j.name for j in ways[0]} & {j.name for j in ways[1]}:
            sides = [{*robot.below(w[min(3, len(w) - 1)].child)} for w in ways if w]
    if len(sides) != 2:
        return set()
    return {frozenset(pair) for pair in itertools.product(*sides)}


def candidate_pairs(
    robot: SourceRobot, capsules: Collection[str]
) -> list[tuple[str, str]]:
    """Pairs of links with shapes that are neither welded nor joined, be it through bare
    links."""
    group, joined = welded_groups(robot), set()
    for link in capsules:
        above = (joint.parent for joint in reversed(robot.path_to(link)))
        joined.add((next((name for name in above if name in capsules), None), link))
    return [
        (a, b)
        for a, b in itertools.combinations(capsules, 2)
        if group[a] != group[b] and not {(a, b), (b, a)} & joined
    ]
