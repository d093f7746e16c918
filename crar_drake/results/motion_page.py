"""Reference motions side by side in one recorded page, such as before and after, or
beside the person who moved so first.

Each is judged as `crar-drake judge` does. In the frames in which they are inside
another, links are coloured: by the triangles of their meshes, or where these are not
judged by their capsules.
"""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydrake.geometry import Rgba
from pydrake.math import RigidTransform, RotationMatrix

from crar_drake.errors import CrarError
from crar_drake.judging.mesh_judge import PairContact
from crar_drake.motion.performer import Performer
from crar_drake.motion.planted_feet import runs
from crar_drake.references.change import rms
from crar_drake.references.motion_files import read_motion
from crar_drake.references.reference_judge import (
    ReferenceJudge,
    ReferenceVerdict,
)
from crar_drake.references.robot_motion import Frames, RobotMotion, trimmed
from crar_drake.references.whole_body import WholeBody
from crar_drake.results import marks
from crar_drake.results.drawn_person import DrawnPerson
from crar_drake.results.drawn_robot import DrawnRobot
from crar_drake.results.recorded_page import (
    RecordedRun,
    empty_scene,
    figure,
    robot_prefix,
    write_page,
)
from crar_drake.robot.description import (
    RobotDescription,
    find_body,
    find_frame,
    load_robot_description,
)

_GREY = Rgba(0.6, 0.6, 0.6, 1.0)  # of what has no colour of its own

# What is marked on the time line; what comes later is drawn over what comes before.
_LIMITS, _CAPSULES, _MESHES = (
    "beyond a limit",
    "capsules penetrate",
    "meshes penetrate",
)
_SPANS = {
    _LIMITS: marks.TOO_FAST,
    _CAPSULES: marks.NEARNESS[1],
    _MESHES: marks.VIOLATION,
}


def compare_files(
    files: Sequence[str | os.PathLike[str]],
    path: str | os.PathLike[str],
    robot: str,
    *,
    labels: Sequence[str],
    layout: str | None = None,
    rate: float | None = None,
    clip: str | None = None,
    frames: Frames = (1, None),
    meshes: bool = True,
    overlay: bool = False,
    person: Performer | None = None,
) -> list[ReferenceVerdict]:
    """Judges motions of one robot, and writes the page of them; their verdicts.

    Args:
        files: of two motions or more, at most as many as `marks.RUNS`, the first of
            which the others came from; beside a person one will do.
        path: of the .html file; appears whole or not at all.
        labels: what to call each; the person last.
        layout, rate: of the files, where they do not say them (`read_motion`).
        clip: which motion of files that hold several.
        frames: of the first file, that the others were made of.
        meshes: whether to judge by meshes, where the robot has any.
        overlay: whether they are laid over each other when the page opens.
        person: who moved so first, shown before the motions.

    Raises:
        CrarError: there are too few or too many.
        MotionError: a file cannot be read, is of another robot, or holds several
            motions and none was named.
        ModelError: the robot cannot be used, or what reads meshes is not installed.
        WriteError: the page cannot be written.
    """
    count = len(labels)
    if not 2 <= count <= len(marks.RUNS):
        raise CrarError(
            f"{count} motions cannot be compared: name 2 to {len(marks.RUNS)}"
        )
    description = load_robot_description(robot).without_ground()
    whole = WholeBody(description)
    motions = [
        read_motion(file, layout, rate, clip=clip, robot=whole) for file in files
    ]
    motions[0] = trimmed(motions[0], frames)
    judge = ReferenceJudge(description, meshes)
    verdicts = [judge.judge(motion) for motion in motions]
    judged = "meshes" if verdicts[0].meshes is not None else "capsules"
    meshcat, afloat = empty_scene(), WholeBody(_afloat(judge.robot))
    drawn = DrawnRobot(afloat.description, meshcat, robot_prefix(0), _GREY)
    shown = [
        _record(motion, motions[0], verdict, label, afloat, drawn)
        for motion, verdict, label in zip(motions, verdicts, labels, strict=False)
    ]
    if person is not None:
        rate, of = motions[0].rate, motions[0].root_positions
        bones = DrawnPerson(person, meshcat, robot_prefix(1), of, rate)
        shown.insert(0, _record_person(bones, rate, labels[-1]))
    name = Path(files[0]).name
    write_page(
        path,
        meshcat,
        shown,
        title=f"{name}, {clip}" if clip else name,
        subtitle=_subtitle(motions, description.name, judged),
        overlay=overlay,
        spans=_SPANS,
        texts={
            "distance": ("smallest distance of capsules", "capsules"),
            "error": ("largest change of a joint", "change"),
            "inside": f"a link inside another, by {judged}",
        },
    )
    return verdicts


def _subtitle(motions: Sequence[RobotMotion], robot: str, judged: str) -> str:
    parts = [f"robot {robot}", f"coloured where {judged} penetrate"]
    if len({(motion.num_frames, motion.rate) for motion in motions}) == 1:
        parts.append(f"{motions[0].num_frames} frames at {motions[0].rate:g} Hz")
    return " · ".join(parts)


def _figures(
    motion: RobotMotion, first: RobotMotion, verdict: ReferenceVerdict
) -> list[dict]:
    """Of one motion, in the caption."""

    def of_frames(name: str, frames: Sequence[int], all_of: str = "") -> dict:
        count = len(frames)
        return figure(name, f"{count}{all_of}" if count else "none", count > 0)

    figures = []
    of_all = f" of {motion.num_frames} frames"
    if verdict.meshes is not None:
        figures.append(
            of_frames("meshes penetrate in", verdict.penetrating_frames, of_all)
        )
    if verdict.capsules is not None:
        name = "capsules in" if figures else "capsules penetrate in"
        of_all = "" if figures else of_all
        figures.append(of_frames(name, verdict.capsule_frames, of_all))
    deciding = _deciding(verdict)
    if deciding:
        figures.insert(1, figure("by", f"{1e3 * deciding[0].depth:.1f} mm", True))
    figures.append(of_frames("beyond limits", verdict.beyond_frames))
    if motion is not first and motion.num_frames == first.num_frames:
        changed = np.degrees(rms(motion.joint_positions - first.joint_positions))
        figures.append(figure("joints changed by", f"{changed:.2f}° rms"))
    return figures


def _deciding(verdict: ReferenceVerdict) -> Sequence[PairContact]:
    """The pairs that penetrate, the deepest first, by what is judged most exactly."""
    return verdict.mesh_pairs if verdict.meshes is not None else verdict.capsules or ()


def _record(
    motion: RobotMotion,
    first: RobotMotion,
    verdict: ReferenceVerdict,
    label: str,
    whole: WholeBody,
    robot: DrawnRobot,
) -> RecordedRun:
    """What the page shows of a motion, in its own frames."""
    pairs, count = _deciding(verdict), motion.num_frames
    # Where they meet is known of those that penetrate and whose capsules are watched.
    watched = {frozenset(p): i for i, p in enumerate(robot.description.pairs)}
    distances = np.full((count, len(watched)), np.inf)
    for each in pairs:
        if (pair := watched.get(frozenset(each.pair))) is not None:
            distances[list(each.frames), pair] = -np.array(each.depths)
    times, change = np.arange(count) / motion.rate, np.empty(0)
    if motion is not first and count == first.num_frames:
        change = np.abs(motion.joint_positions - first.joint_positions).max(axis=1)
    frames = {_LIMITS: verdict.beyond_frames, _CAPSULES: verdict.capsule_frames}
    frames[_MESHES] = verdict.penetrating_frames
    no_targets = np.empty((count, 0, 3))
    return RecordedRun(
        robot=robot,
        label=label,
        figures=_figures(motion, first, verdict),
        warning_distance=0.0,
        rate=motion.rate,
        **robot.record(_configurations(motion, whole), distances, np.inf),
        pair_names=[" - ".join(pair) for pair in robot.description.pairs],
        curve_time=times,
        distance_curve=verdict.capsule_distances
        if verdict.capsules is not None
        else np.empty(0),
        error_curve=change,
        error_unit="rad",
        spans={
            name: [
                (max(a - 0.5, 0.0) / motion.rate, min(b + 0.5, count - 1) / motion.rate)
                for a, b in _in_a_row(each, count)
            ]
            for name, each in frames.items()
        },
        target_names=(),
        targets=no_targets,
        reached=no_targets,
        penetrating=_penetrating_links(pairs, robot, count),
    )


def _record_person(person: DrawnPerson, rate: float, label: str) -> RecordedRun:
    """What the page shows of a person, at a rate [Hz]."""
    found = person.record()
    nothing = np.empty((len(found["poses"]), 0, 3))
    return RecordedRun(
        robot=person,
        label=label,
        figures=(),
        warning_distance=0.0,
        rate=rate,
        **found,
        pair_names=(),
        curve_time=np.arange(len(nothing)) / rate,
        distance_curve=np.empty(0),
        error_curve=np.empty(0),
        error_unit="",
        spans={name: [] for name in _SPANS},
        target_names=(),
        targets=nothing,
        reached=nothing,
    )


def _penetrating_links(
    pairs: Sequence[PairContact], robot: DrawnRobot, num_frames: int
) -> dict[int, list[tuple[int, int]]]:
    """As `RecordedRun.penetrating`; links that are not drawn are left out."""
    found: dict[int, set[int]] = {}
    for each in pairs:
        for link in each.pair:
            body = find_body(robot.plant, link).index()
            if body in robot.bodies:
                found.setdefault(robot.bodies.index(body), set()).update(each.frames)
    return {
        link: _in_a_row(tuple(frames), num_frames)
        for link, frames in sorted(found.items())
    }


def _in_a_row(frames: Sequence[int], num_frames: int) -> list[tuple[int, int]]:
    """First and last of each stretch of frames without a gap."""
    flags = np.zeros(num_frames, dtype=bool)
    flags[list(frames)] = True
    return [(start, end - 1) for start, end in runs(flags)]


def _afloat(robot: WholeBody) -> RobotDescription:
    """The robot with its base not welded: a motion says where it is."""
    description = robot.description
    if not description.base:
        return description
    base = find_frame(robot.plant, description.base).body()
    return replace(description, base=str(base.scoped_name()), root="prescribed")


def _configurations(motion: RobotMotion, robot: WholeBody) -> np.ndarray:
    """(T, nq) of the plant, its root where the motion has it, if that floats."""
    q, plant = robot.configurations(motion.joint_positions), robot.plant
    if not robot.description.base:
        return q  # the model is welded by itself
    base = find_body(plant, robot.description.base)
    if not base.is_floating_base_body():
        return q  # something else carries it
    context = plant.CreateDefaultContext()
    root = plant.GetBodyByName(robot.root).body_frame()
    rotations = motion.root_rotations.as_matrix()
    for k, (p, R) in enumerate(zip(motion.root_positions, rotations, strict=True)):
        plant.SetPositions(context, q[k])
        X_RB = plant.CalcRelativeTransform(context, root, base.body_frame())
        X_WR = RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), p)
        plant.SetFreeBodyPose(context, base, X_WR @ X_RB)
        q[k] = plant.GetPositions(context)
    return q
