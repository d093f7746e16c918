"""Reference motions side by side in one recorded page, such as before and after.

Each is judged as `crar-drake judge` does. In the frames in which they are inside
another, links are coloured: by the triangles of their meshes, or where these are not
judged by their capsules.
"""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from crar_drake.errors import CrarError
from crar_drake.motion.planted_feet import runs
from crar_drake.references.adjusting import Frames, trimmed
from crar_drake.references.change import rms
from crar_drake.references.motion_files import read_motion
from crar_drake.references.reference_judge import (
    PairFrames,
    ReferenceJudge,
    ReferenceVerdict,
)
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.results import marks
from crar_drake.results.recorded_page import (
    ShownRun,
    empty_scene,
    figure,
    robot_prefix,
    write_page,
)
from crar_drake.results.recorded_run import (
    MOST_NEAR,
    DrawnRobot,
    RecordedRun,
    outermost,
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
) -> list[ReferenceVerdict]:
    """`compare_motions` of files.

    Args:
        files: of motions, the first of which the others came from.
        path, labels, overlay: as of `compare_motions`.
        layout, rate: of the files, where they do not say them (`read_motion`).
        clip: which motion of files that hold several.
        frames: of the first file, that the others were made of.
        meshes: whether to judge by meshes, where the robot has any.

    Raises:
        MotionError: a file cannot be read, is of another robot, or holds several
            motions and none was named.
        ModelError: the robot cannot be used, or what reads meshes is not installed.
        CrarError, WriteError: as of `compare_motions`.
    """
    description = load_robot_description(robot).without_ground()
    whole = WholeBody(description)
    motions = [
        read_motion(file, layout, rate, clip=clip, robot=whole) for file in files
    ]
    motions[0] = trimmed(motions[0], frames)
    name = Path(files[0]).name
    return compare_motions(
        motions,
        path,
        ReferenceJudge(description, meshes),
        labels=labels,
        title=f"{name}, {clip}" if clip else name,
        overlay=overlay,
    )


def compare_motions(
    motions: Sequence[RobotMotion],
    path: str | os.PathLike[str],
    judge: ReferenceJudge,
    *,
    labels: Sequence[str],
    title: str,
    overlay: bool = False,
    meshcat: Meshcat | None = None,
) -> list[ReferenceVerdict]:
    """Judges motions of one robot, and writes the page of them; their verdicts.

    Args:
        motions: at least two and at most as many as `marks.RUNS`, with their joints in
            the robot's order. What became of each is reported against the first.
        path: of the .html file; appears whole or not at all.
        overlay: whether they are laid over each other when the page opens.
        meshcat: to draw into; by default one of its own.

    Raises:
        CrarError: there are too few or too many.
        WriteError: the file cannot be written.
    """
    if not 2 <= len(motions) <= len(marks.RUNS):
        raise CrarError(
            f"{len(motions)} motions cannot be compared: name 2 to {len(marks.RUNS)}"
        )
    verdicts = [judge.judge(motion) for motion in motions]
    meshcat = empty_scene(meshcat)
    whole = WholeBody(_afloat(judge.robot))
    robot = DrawnRobot(whole.description, meshcat, robot_prefix(0), _GREY)
    shown = [
        ShownRun(
            _recorded(
                motion, motions[0], verdict, _configurations(motion, whole), robot
            ),
            0,
            label,
            _figures(motion, motions[0], verdict),
        )
        for motion, verdict, label in zip(motions, verdicts, labels, strict=True)
    ]
    judged = "meshes" if verdicts[0].meshes is not None else "capsules"
    write_page(
        path,
        meshcat,
        [robot],
        shown,
        title=title,
        subtitle=_subtitle(motions, judge.robot.description.name, judged),
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


def _deciding(verdict: ReferenceVerdict) -> Sequence[PairFrames]:
    """The pairs that penetrate, the deepest first, by what is judged most exactly."""
    return verdict.mesh_pairs if verdict.meshes is not None else verdict.capsules or ()


def _recorded(
    motion: RobotMotion,
    first: RobotMotion,
    verdict: ReferenceVerdict,
    q: np.ndarray,
    robot: DrawnRobot,
) -> RecordedRun:
    """What the page shows of a motion, (T, nq) of the plant, in its own frames."""
    pairs = _deciding(verdict)
    near = np.full((motion.num_frames, MOST_NEAR, 8), np.nan)
    penetrating = _by_frame(pairs, robot)
    poses, outline = [], []
    for k in range(motion.num_frames):
        at, points = robot.pose_links(q[k])
        poses.append(at)
        outline.append(outermost(points))
        deepest = sorted(penetrating.get(k, ()))[:MOST_NEAR]
        if deepest:
            points = robot.nearest_points(np.array([pair for *_, pair in deepest]))
            for row, (distance, number, _), at in zip(
                near[k], deepest, points, strict=False
            ):
                row[:] = number, distance, *at
    times = np.arange(motion.num_frames) / motion.rate
    change = np.empty(0)
    if motion is not first and motion.num_frames == first.num_frames:
        change = np.abs(motion.joint_positions - first.joint_positions).max(axis=1)
    frames = {_LIMITS: verdict.beyond_frames, _CAPSULES: verdict.capsule_frames}
    frames[_MESHES] = verdict.penetrating_frames
    return RecordedRun(
        warning_distance=0.0,
        rate=motion.rate,
        time=times,
        poses=np.array(poses),
        targets=np.empty((motion.num_frames, 0, 3)),
        reached=np.empty((motion.num_frames, 0, 3)),
        near=near,
        curve_time=times,
        distance_curve=verdict.capsule_distances
        if verdict.capsules is not None
        else np.empty(0),
        error_curve=change,
        error_unit="rad",
        spans={
            name: [
                (
                    max(a - 0.5, 0.0) / motion.rate,
                    min(b + 0.5, len(times) - 1) / motion.rate,
                )
                for a, b in _in_a_row(each, len(times))
            ]
            for name, each in frames.items()
        },
        pair_names=[" - ".join(each.pair) for each in pairs],
        target_names=[],
        outline=outermost(np.vstack(outline)),
        penetrating=_penetrating_links(pairs, robot, len(times)),
    )


def _penetrating_links(
    pairs: Sequence[PairFrames], robot: DrawnRobot, num_frames: int
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


def _by_frame(
    pairs: Sequence[PairFrames], robot: DrawnRobot
) -> dict[int, list[tuple[float, int, int]]]:
    """Frame to (distance, number, watched pair) of the pairs that penetrate in it, of
    those whose capsules are watched, so that it is known where they meet."""
    watched = {frozenset(p): i for i, p in enumerate(robot.description.pairs)}
    found: dict[int, list[tuple[float, int, int]]] = {}
    for number, each in enumerate(pairs):
        pair = watched.get(frozenset(each.pair))
        if pair is None:
            continue
        for frame, depth in zip(each.frames, each.depths, strict=True):
            found.setdefault(frame, []).append((-depth, number, pair))
    return found


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
