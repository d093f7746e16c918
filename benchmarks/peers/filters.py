"""Reference motions cleaned by crar_drake, and filtered by PlaCo, mink and Pink.

    python -m benchmarks.peers.filters g1_whole_body $CRAR_ROBOT_MOTIONS
        [--page docs/measurements/filters.md]

Each peer gets the same robot with the same capsules and watched pairs, its root fixed,
and frame by frame the reference: all joints as a posture task, the feet's poses with
the weights that `crar-drake clean` has, and its own limits and avoidance of collisions.
They begin where ours does: in the first frame or, where that is not clear, in a clear
configuration beside it; from a start in penetration Pink goes farther in, and mink
stays. Every setting of a peer's grid is tried on every motion; of each motion that one
is shown which leaves the fewest frames with capsules in penetration, and of several the
one that changes the joints the least. All are judged as `crar-drake judge` does.
"""

import json
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.cleaning import degrees, lengths
from benchmarks.page import Benchmark, Table, run
from benchmarks.peers.compare import (
    Entry,
    add_peer_options,
    recorded,
)
from benchmarks.peers.peers import MARGIN, Peer, every
from benchmarks.peers.problem import finite_or_none, write_robot
from crar_drake.files import whole_file, write_whole
from crar_drake.references.change import Change, find_change
from crar_drake.references.cleaning import Cleaner, CleaningParameters
from crar_drake.references.folders import find_references
from crar_drake.references.ground_contact import FEET
from crar_drake.references.motion_files import read_motions
from crar_drake.references.reference_judge import ReferenceJudge, ReferenceVerdict
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import (
    RobotDescription,
    find_frame,
    load_robot_description,
)

OURS = "crar-drake clean"
_FEET = {
    "foot": (CleaningParameters.foot_weight,),
    "foot_turn": (CleaningParameters.foot_turn_weight,),
}
_STEPS = (1, 4)  # of 33 ms and of 8 ms at 30 Hz

FILTERS = (
    Peer(
        "PlaCo",
        "filter_placo",
        "placo",
        every(
            steps=_STEPS,
            margin=(MARGIN,),
            trigger=(0.1,),
            priority=("hard",),
            weight=(1.0,),
            **_FEET,
        )
        + every(
            steps=_STEPS,
            margin=(MARGIN,),
            trigger=(0.1,),
            priority=("soft",),
            weight=(1e3, 1e5),
            **_FEET,
        ),
        python=False,
    ),
    Peer(
        "mink",
        "filter_mink",
        "mink",
        every(
            steps=_STEPS,
            # Up to 1 by its documentation; up to the period it is a displacement.
            collision_gain=(0.004, 0.008, 0.015, 0.03, 0.85),
            collision_distance=(MARGIN,),
            detection_distance=(0.1,),
            relaxation=(0.0,),
            **_FEET,
        ),
        python=True,
    ),
    Peer(
        "Pink",
        "filter_pink",
        "pink",
        every(
            steps=_STEPS,
            barrier_gain=(10.0, 20.0, 40.0),
            safe_displacement=(0.0,),
            collision_distance=(MARGIN,),
            pairs=(50,),
            **_FEET,
        ),
        python=True,
    ),
)

HEADER = (
    "motion, filter",
    "frames in penetration, meshes",
    "deepest",
    "frames, capsules",
    "beyond a limit",
    "without an answer",
    "joints, rms / worst",
    "feet, rms / worst",
    "hands, rms / worst",
    "rms jerk",
    "times real time",
)


@dataclass(frozen=True)
class Row:
    """What a filter made of a motion, or the motion itself.

    Attributes:
        motion, name: of the motion, and of the filter; "" for the reference.
        settings: of the filter.
        frames: of the motion.
        mesh_frames, capsule_frames: in penetration.
        judged: frames whose meshes were judged.
        deepest: penetration of meshes [m].
        beyond: frames with a joint beyond its limit or its speed limit.
        no_answer: frames in which the filter had no answer, and stood still.
        change: from the reference.
        times_real_time: by the processor's time.
    """

    motion: str
    name: str
    settings: dict
    frames: int
    judged: int
    mesh_frames: int
    capsule_frames: int
    deepest: float
    beyond: int
    no_answer: int
    change: Change
    times_real_time: float


@dataclass(frozen=True)
class Tried:
    """What a filter made of a motion with some settings.

    Attributes:
        settings: of the filter.
        motion: that came out.
        capsule_frames: frames with capsules in penetration.
        joints_rms: change of the joints [rad].
        no_answer, seconds: see `row`.
    """

    settings: dict
    motion: RobotMotion
    capsule_frames: int
    joints_rms: float
    no_answer: int
    seconds: float


def write_references(
    folder: Path,
    description: RobotDescription,
    motions: dict[str, RobotMotion],
    starts: dict[str, np.ndarray],
) -> dict[str, float]:
    """Writes the robot and a case for every motion, for the drivers of filters.

    Args:
        folder: is made.
        description: of the robot.
        motions: by the names of their cases, joints in the robot's order.
        starts: (n,) where each is to begin.

    Returns:
        Their periods [s].
    """
    folder.mkdir(parents=True, exist_ok=True)
    robot = WholeBody(description)
    feet = [
        find_frame(robot.plant, description.task_frames[foot]).body().name()
        for foot in FEET
        if foot in description.task_frames
    ]
    base = write_robot(folder, description, feet)
    rest = dict.fromkeys(robot.joint_names, 0.0) | description.rest_posture
    problem = {
        "robot": description.name,
        "base": base,
        "joints": list(robot.joint_names),
        "lower": finite_or_none(robot.lower),
        "upper": finite_or_none(robot.upper),
        "velocity_limits": robot.speed_limits.tolist(),
        "task_links": feet,
        "pairs": description.pairs,
        "rest": [rest[joint] for joint in robot.joint_names],
    }
    write_whole(folder / "problem.json", json.dumps(problem, indent=1))
    for name, motion in motions.items():
        with whole_file(folder / f"{name}.npz") as temporary:
            clock = np.arange(motion.num_frames) / motion.rate
            q = motion.joint_positions
            np.savez(temporary, time=clock, q=q, q_start=starts[name])
    return {name: 1.0 / motion.rate for name, motion in motions.items()}


def read_references(path: Path, robot: WholeBody) -> dict[str, RobotMotion]:
    """The motions of a file or of a folder, by name, joints in the robot's order.

    Raises:
        CrarError: there is none, or one cannot be read.
    """
    files = find_references(path) if path.is_dir() else [path]
    found = {}
    for file in files:
        for motion in read_motions(file, robot=robot):
            found[f"{file.stem}{f' {motion.clip}' if motion.clip else ''}"] = motion
    return found


def cleaned(
    description: RobotDescription, motion: RobotMotion, columns: Sequence[int]
) -> tuple[RobotMotion, float]:
    """By crar_drake, and the processor's time that it took [s], compiled before.

    Args:
        description: of the robot.
        motion: the reference.
        columns: of the joints that the robot controls, in a motion's.
    """
    reference = np.ascontiguousarray(motion.joint_positions[:, columns])
    cleaner = _cleaner(description, motion.rate)
    start = time.process_time()
    q = motion.joint_positions.copy()
    q[:, columns] = cleaner.clean(reference).q
    took = time.process_time() - start
    return replace(motion, joint_positions=q), took


def row(
    reference: RobotMotion,
    motion: RobotMotion,
    judge: ReferenceJudge,
    name: str = "",
    settings: dict | None = None,
    no_answer: int = 0,
    seconds: float = np.inf,
) -> Row:
    """Judges what a filter made of a reference.

    Args:
        reference, motion: before and after.
        judge: with or without meshes.
        name, settings, no_answer: see `Row`.
        seconds: that the filter took [s].
    """
    verdict: ReferenceVerdict = judge.judge(motion)
    return Row(
        motion="",
        name=name,
        settings=settings or {},
        frames=motion.num_frames,
        judged=len(verdict.mesh_frames) if verdict.meshes else 0,
        mesh_frames=len(verdict.penetrating_frames),
        capsule_frames=len(verdict.capsule_frames),
        deepest=max((pair.depth for pair in verdict.mesh_pairs), default=0.0),
        beyond=len(verdict.beyond_frames),
        no_answer=no_answer,
        change=find_change(reference, motion, judge.robot),
        times_real_time=(motion.num_frames - 1) / motion.rate / seconds,
    )


def penetrating(
    description: RobotDescription, motion: RobotMotion, columns: Sequence[int]
) -> int:
    """Frames in which capsules penetrate.

    Args:
        description: of the robot.
        motion: with its joints in the robot's order.
        columns: of the joints that the robot controls.
    """
    q = np.ascontiguousarray(motion.joint_positions[:, columns])
    cleaner = _cleaner(description, motion.rate)
    return int((cleaner.margins(q).distance < 0.0).sum())


def best(tried: Iterable[Tried]) -> Tried:
    """The fewest frames with capsules in penetration, then the least change."""
    return min(tried, key=lambda one: (one.capsule_frames, one.joints_rms))


def main(argv: Sequence[str] | None = None) -> None:
    benchmark = Benchmark("benchmarks.peers.filters", __doc__, "filters")
    parser = benchmark.parser
    add_peer_options(parser, "out/filters")
    parser.add_argument("robot", help="name or folder, imported as a whole body")
    parser.add_argument(
        "motions", type=Path, help="a robot motion, or a folder of such"
    )
    parser.add_argument("--only", default="", help="filters whose names contain this")
    arguments = benchmark.parse(argv, lambda _: "filters")
    description = load_robot_description(arguments.robot).without_ground()
    robot = WholeBody(description)
    references = read_references(arguments.motions, robot)
    controlled = Cleaner(description, 50.0).model.joint_names
    columns = [robot.joint_names.index(joint) for joint in controlled]
    ours = {}
    for name, reference in references.items():
        cleaned(description, _first_frames(reference), columns)  # compiles
        ours[name] = cleaned(description, reference, columns)
    out = arguments.out.resolve()
    starts = {name: motion.joint_positions[0] for name, (motion, _) in ours.items()}
    periods = write_references(out / "problem", description, references, starts)
    tried: dict[str, dict[str, list[Tried]]] = {}
    versions: dict[str, str] = {}
    peers = [peer for peer in FILTERS if arguments.only in peer.name]
    grids = [
        Entry(f"{peer.name} {i}", peer, dict.fromkeys(references, one))
        for peer in peers
        for i, one in enumerate(peer.grid)
    ]
    for entry, found in recorded(grids, periods, arguments, out / "problem", keep=True):
        of_peer = tried.setdefault(entry.peer.name, {name: [] for name in references})
        for name, result in found.items():
            versions |= json.loads(str(result["versions"]))
            after = replace(references[name], joint_positions=result["q"])
            of_peer[name].append(
                Tried(
                    entry.settings[name],
                    after,
                    penetrating(description, after, columns),
                    find_change(references[name], after, robot).joints_rms,
                    int(result["no_answer"].sum()),
                    float(result["step_time"].sum()),
                )
            )
    judge = ReferenceJudge(description)
    made: dict[str, list[Row]] = {}
    for name, reference in references.items():
        after, seconds = ours[name]
        made[name] = [
            row(reference, reference, judge),
            row(reference, after, judge, OURS, seconds=seconds),
        ]
        for peer, of_peer in tried.items():
            taken = best(of_peer[name])
            made[name].append(
                row(
                    reference,
                    taken.motion,
                    judge,
                    peer,
                    taken.settings,
                    taken.no_answer,
                    taken.seconds,
                )
            )
    benchmark.report(*tables_and_versions(made, versions))


def tables_and_versions(
    made: dict[str, list[Row]], versions: dict[str, str]
) -> tuple[list[Table], str]:
    """What was measured and with which settings; and how many were tried, of what."""
    whole = [HEADER, *(cells(name, r) for name, each in made.items() for r in each)]
    if not any(r.judged for each in made.values() for r in each):
        whole = [[*line[:1], *line[3:]] for line in whole]  # nothing of meshes
    chosen = [
        [name, r.name, f"`{json.dumps(r.settings)}`"]
        for name, each in made.items()
        for r in each
        if r.settings
    ]
    sizes = ", ".join(f"{len(peer.grid)} of {peer.name}" for peer in FILTERS)
    packages = ", ".join(
        f"{name} {number}" for name, number in sorted(versions.items())
    )
    tables = [
        Table(whole[0], whole[1:]),
        Table(["motion", "filter", "settings"], chosen, "Settings taken"),
    ]
    return tables, f"Settings tried: {sizes}. Versions: {packages}."


def cells(motion: str, row: Row) -> list[str]:
    """A row as text, in the order of HEADER."""
    change = row.change
    if not row.name:
        return [
            f"**{motion}**, {row.frames} frames",
            _meshes(row, f" of {row.judged}"),
            _depth(row.deepest),
            str(row.capsule_frames),
            str(row.beyond),
            *["–"] * 4,
            f"{change.jerk:.0f} rad/s³",
            "–",
        ]
    return [
        row.name,
        _meshes(row),
        _depth(row.deepest),
        str(row.capsule_frames),
        str(row.beyond),
        str(row.no_answer),
        degrees(change.joints_rms, change.joints_worst),
        lengths(change.feet_rms, change.feet_worst),
        lengths(change.hands_rms, change.hands_worst),
        f"{change.jerk:.0f} rad/s³",
        f"{row.times_real_time:.1f}",
    ]


_FOLLOWERS: dict[float, Cleaner] = {}  # of the one robot, by their rates


def _cleaner(description: RobotDescription, rate: float) -> Cleaner:
    if rate not in _FOLLOWERS:
        _FOLLOWERS[rate] = Cleaner(description, rate)
    return _FOLLOWERS[rate]


def _first_frames(motion: RobotMotion) -> RobotMotion:
    """A few of them, twice: standing still, so that they can be cleaned."""
    first = np.tile(motion.joint_positions[:1], (motion.num_frames, 1))
    return replace(motion, joint_positions=first)


def _meshes(row: Row, more: str = "") -> str:
    """Frames in penetration; nothing where meshes were not judged."""
    return f"{row.mesh_frames}{more}" if row.judged else "–"


def _depth(depth: float) -> str:
    return f"{1e3 * depth:.1f} mm" if depth else "none"


if __name__ == "__main__":
    run(main)
