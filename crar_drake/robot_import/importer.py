"""The whole way from a robot's file to a folder that the controller can use."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pydrake.common.yaml import yaml_dump_typed
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from crar_drake.errors import ModelError
from crar_drake.files import whole_file, whole_set
from crar_drake.nearest import nearest
from crar_drake.robot.description import (
    GROUND,
    IMPORT_FILE,
    RobotDescription,
    RootPose,
    add_robot,
    find_joint,
)
from crar_drake.robot_import.alarms import (
    floor_alarms,
    joints_between,
    limb_alarms,
    pair_alarms,
)
from crar_drake.robot_import.anatomy import (
    AWAY,
    Anatomy,
    elbow_index,
    find_anatomy,
    guess_rest,
    mirrored_links,
)
from crar_drake.robot_import.capsule_fitting import Fit, coverage
from crar_drake.robot_import.choices import (
    ImportChoices,
    load_choices,
    save_choices,
)
from crar_drake.robot_import.covering import covered
from crar_drake.robot_import.facing import guess_facing, guess_up, turned
from crar_drake.robot_import.fit_cache import FitCache
from crar_drake.robot_import.inertias import Inertia, own_mass, read_inertia, stand_in
from crar_drake.robot_import.joint_groups import DEFAULT_LOCK, guess_locked
from crar_drake.robot_import.leg_and_head_frames import (
    bent_knees,
    guess_leg_and_head_frames,
    has_feet,
)
from crar_drake.robot_import.meshes import (
    Part,
    guess_up_axis,
    link_parts,
    simplified,
    write_obj,
)
from crar_drake.robot_import.optional_packages import require_packages
from crar_drake.robot_import.pair_sampling import CLEAR, Gaps, sample_pairs
from crar_drake.robot_import.picture import draw_robot
from crar_drake.robot_import.source_file import read_robot
from crar_drake.robot_import.source_urdf import (
    PACKAGE_SCHEME,
    WORLD,
    SourceRobot,
    find_urdf,
)
from crar_drake.robot_import.srdf import read_srdf
from crar_drake.robot_import.upper_body_frames import guess_frames, guess_tool
from crar_drake.robot_import.urdf_writer import (
    BASE_JOINTS,
    VisualMesh,
    frame_name,
    write_urdf,
)

URDF, DESCRIPTION, PICTURE, REPORT = (
    "robot.urdf",
    "robot.yaml",
    "picture.png",
    "report.txt",
)

# The folder of the meshes with all their triangles, which `mesh_judge` reads.
TRIANGLES = "triangles"

# How far the ground is below the soles: what pairs keep, if nothing else is said [m].
_BELOW_SOLES = 0.005

# How far arms are from the trunk at rest and how far hips roll outwards, tried in turn
# until nothing touches [rad].
_AWAY = (AWAY, 0.4, 0.6)
_SPREAD = (0.0, 0.1, 0.2)
_SOCKET = 3  # joints of a hip or a shoulder, which what they join is built around

# Module to the package that brings it; trimesh imports the others when it needs them.
_MESH_PACKAGES = {
    "trimesh": "trimesh",
    "collada": "pycollada",
    "networkx": "networkx",
    "fast_simplification": "fast-simplification",
}

# Takes what is being done, and the share that is done.
Progress = Callable[[str, float], None]


@dataclass
class ImportReport:
    """What an import made of a robot.

    Attributes:
        folder: that it wrote.
        choices: all that was decided.
        guessed: key of the import file to how it was guessed, of new ones.
        fits: link to its capsules.
        covered: link without capsules to the link whose capsules enclose it.
        notes: everything else that the user should know, one line each.
        warnings: what is likely to be wrong, or leaves the robot unprotected.
    """

    folder: Path
    choices: ImportChoices
    guessed: dict[str, str] = field(default_factory=dict)
    fits: dict[str, Fit] = field(default_factory=dict)
    covered: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def lines(self) -> list[str]:
        """The report as text."""
        lines = [f"robot {self.choices.name}, from {self.choices.source}", ""]
        lines += ["link: capsules, vertices within 5 mm, volume over the hull's"]
        for link, fit in self.fits.items():
            if link in self.covered:
                lines.append(f"  {link}: none, inside those of {self.covered[link]}")
                continue
            bad = "" if fit.good else "  MISSES 95 % or 1.6"
            lines.append(
                f"  {link}: {len(fit.capsules)}, {100 * fit.coverage:.1f} %, "
                f"{fit.volume_ratio:.2f}{bad}"
            )
        pairs = self.choices.pairs or []
        lines += ["", f"watched pairs: {len(pairs)}"]
        if self.warnings:
            lines += ["", *(f"WARNING: {warning}" for warning in self.warnings)]
        if self.notes:
            lines += ["", *self.notes]
        if self.guessed:
            lines += ["", f"guessed; correct it in {IMPORT_FILE} and import again:"]
            lines += [f"  {key}: {how}" for key, how in self.guessed.items()]
        return lines


def import_robot(
    source: str | os.PathLike[str],
    out: Path,
    *,
    package_paths: tuple[str, ...] = (),
    lock: tuple[str, ...] | None = None,
    cover: bool = False,
    base: str | None = None,
    srdf: str = "",
    posture: str = "",
    progress: Progress | None = None,
) -> ImportReport:
    """Turns a robot's own file into a folder with all that a scenario's `robot` needs.

    The folder then holds import.yaml (what was decided; kept if it is there),
    robot.urdf, robot.yaml, meshes/, picture.png and report.txt.

    Args:
        source: path of a URDF or MJCF, or the name of one in example-robot-data; ""
            where `out` has an import.yaml that says it.
        out: the folder.
        package_paths: folders in which the URDF's packages are looked for.
        lock: groups of joints to lock (`choices.GROUPS`), on a first import.
        cover: whether capsules are grown to hold all triangles, on a first import.
        base: what becomes of the root link (`choices.BASES`), on a first import; None
            is guessed: it floats where legs are there and not locked.
        srdf: path of an SRDF, on a first import (`ImportChoices`).
        posture: which of its postures the robot rests in.
        progress: is told what is being done.

    Nothing of it is written unless all of it can be; only the import file is, where
    what is guessed has to be corrected first.

    Raises:
        ModelError: something in the file or the choices is wrong or not supported,
            or a package of the extra `robots` is missing; the message names it.
    """
    check_installed()
    progress = progress or (lambda what, share: None)
    file = out / IMPORT_FILE
    choices = None
    if file.is_file():
        choices = load_choices(file)
        if source and find_urdf(source)[0] != _locate(choices.source, out):
            raise ModelError(
                f"{file} was made from {choices.source}; to import another robot give "
                "another --out, or remove that file"
            )
        _check_lock(choices, lock, file)
        if cover and not choices.cover:
            raise ModelError(
                f"{file} is there already: write cover: true into it, take out pairs, "
                "and import again without the option"
            )
        for key, value in (("srdf", srdf), ("posture", posture)):
            if value and value != getattr(choices, key):
                raise ModelError(
                    f"{file} is there already: write {key}: {value} into it, take out "
                    "locked, rest_posture and pairs, and import again without the "
                    "option"
                )
    if choices is None:
        path, name = find_urdf(source)
        choices = ImportChoices(source=name, package_paths=list(package_paths))
        choices.lock = None if lock is None else list(lock)
        choices.cover = cover
        choices.base = base
        choices.srdf = str(Path(srdf).resolve()) if srdf else ""
        choices.posture = posture
    elif base is not None and base != choices.base:
        raise ModelError(
            f"{file} is there already: write base: {base} into it, and import again "
            "without the option"
        )
    choices.validate(str(file))
    path = _locate(choices.source, out)
    progress("reading", 0.0)
    robot = read_robot(
        path, [Path(p) for p in (*package_paths, *choices.package_paths)]
    )
    choices = replace(choices, name=choices.name or robot.name)
    robot = _without_world(robot, choices)
    report = ImportReport(out, choices, notes=list(robot.notes))
    if choices.srdf:
        robot = _with_semantics(robot, out / choices.srdf, choices, report)
    if choices.up_axis is None and (guess := guess_up_axis(robot)) is not None:
        choices.up_axis, report.guessed["up_axis"] = guess
    up_axis = choices.up_axis or "z"
    parts = {name: link_parts(link, up_axis) for name, link in robot.links.items()}
    robot = _face(robot, parts, choices, report)
    _guess_structure(robot, parts, choices, report)
    try:
        locked = _check_structure(robot, choices, file)
    except ModelError:
        save_choices(file, choices, report.guessed)  # so that it can be corrected
        raise

    segments = _merge_segments(robot, locked, parts, choices)
    cache = FitCache(out / "meshes" / "fits.json")
    for index, (name, of_segment) in enumerate(segments.items()):
        progress(f"fitting {name}", index / len(segments))
        fit = cache.fit(of_segment, choices.most_capsules)
        if fit is None:
            report.notes.append(f"link {name} is flat: it gets no collision shape")
        else:
            report.fits[name] = fit
    if file.is_file():
        cache.save()  # what is refused below need not be fitted again
    _find_covered(robot, locked, segments, report)
    if choices.cover:
        progress("covering", 1.0)
        _cover(robot, locked, segments, report)
    with whole_set(out, DESCRIPTION) as made:
        _make(made, robot, locked, parts, segments, choices, report, progress, file)
        save_choices(file, choices, report.guessed)
        with whole_file(made / REPORT) as temporary:
            temporary.write_text("\n".join(report.lines()) + "\n", encoding="utf-8")
        _remove_old_triangles(made, out)
    cache.save()
    return report


def _make(
    folder: Path,
    robot: SourceRobot,
    locked: dict[str, float],
    parts: dict[str, list[Part]],
    segments: dict[str, list[Part]],
    choices: ImportChoices,
    report: ImportReport,
    progress: Progress,
    file: Path,
) -> None:
    """Makes the model, its description, meshes and picture in a folder, and the
    choices that need them."""
    capsules = {
        name: fit.capsules
        for name, fit in report.fits.items()
        if name not in report.covered
    }
    inertias = _inertias(robot, locked, parts, report)
    _note_joints(robot, locked, report)
    progress("writing meshes", 1.0)
    visuals, drawn = _write_meshes(folder, parts, choices.faces)
    _guess_rest(robot, locked, parts, capsules, choices, report)
    prescribed = choices.base == "prescribed"
    floating = choices.base == "floating"
    # A robot with a waist stands on the floor, although its base is fixed.
    rest_posture = dict(choices.rest_posture)
    lifted = not prescribed and "waist_z" not in robot.joints
    height = rest_posture.pop("waist_z", 0.0) if lifted else 0.0
    if height and robot.root == WORLD:
        raise ModelError(
            f"{file}: rest_posture: waist_z: the root link is named {WORLD!r} and "
            "cannot be lifted; take waist_z out"
        )
    welded_itself = write_urdf(
        folder / URDF,
        robot,
        choices.name,
        base=choices.base,
        height=height,
        locked=locked,
        frames=choices.frames,
        visuals=visuals,
        capsules=capsules,
        inertias=inertias,
    )
    description = RobotDescription(
        name=choices.name,
        model=URDF,
        base="" if welded_itself else robot.root,
        prescribed_joints={name: by for name, (_, _, by) in BASE_JOINTS.items()}
        if prescribed
        else {},
        root="prescribed" if floating else "fixed",
        root_pose=_root_pose(robot, height) if floating else RootPose(),
        task_frames={point: frame_name(point) for point in choices.frames},
        rest_posture=rest_posture,
        folder=str(folder),
    )
    plant = _parse(description)
    rest = _rest(plant, rest_posture, file)
    report.warnings += limb_alarms(robot, choices.frames)
    anatomy = find_anatomy(robot)
    if anatomy is not None:
        height = choices.rest_posture.get("waist_z", 0.0)
        posture = {**rest_posture, **locked}
        report.warnings += floor_alarms(robot, parts, posture, height, anatomy)
    progress("sampling pairs", 1.0)
    overlapping = _pairs(plant, robot, locked, capsules, rest, choices, report, file)
    report.warnings += pair_alarms(
        robot, locked, segments, rest_posture, choices.pairs, overlapping
    )
    description.pairs = choices.pairs
    _watch_ground(description, plant, rest, capsules, choices, report, file)
    description.validate()
    _write_description(folder, description)
    progress("drawing", 1.0)
    _draw(folder, plant, description, rest, drawn, capsules)


def check_installed() -> None:
    """Imports what meshes are read and changed with.

    They are asked for before anything is read: trimesh would miss the others in the
    middle of an import, each only for some formats and some meshes.

    Raises:
        ModelError: a package of the extra `robots` is not installed, or is broken.
    """
    require_packages(_MESH_PACKAGES, "importing robots")


def _root_pose(robot: SourceRobot, height: float) -> RootPose:
    """Where the root link rests when it is so high above the ground [m]."""
    X_WR = RigidTransform(np.array([0.0, 0.0, height])) @ robot.X_FR
    return RootPose(
        [round(float(x), 9) for x in X_WR.translation()],
        [round(float(x), 9) for x in RollPitchYaw(X_WR.rotation()).vector()],
    )


def _check_lock(
    choices: ImportChoices, lock: tuple[str, ...] | None, file: Path
) -> None:
    """What an import file says about locked joints is changed there, nowhere else."""
    if lock is None or (choices.lock is not None and set(choices.lock) == set(lock)):
        return
    raise ModelError(
        f"{file} is there already: write lock: [{', '.join(lock)}] into it, take out "
        "locked, segments, rest_posture and pairs, and import again without the option"
    )


def _locate(source: str, out: Path) -> Path:
    if source.startswith(PACKAGE_SCHEME) or Path(source).is_absolute():
        return find_urdf(source)[0]
    beside = out / source
    return find_urdf(beside if beside.is_file() else source)[0]


def _without_world(robot: SourceRobot, choices: ImportChoices) -> SourceRobot:
    """A humanoid's root is what stands in the world, not a link of that name."""
    bare = robot.without_world()
    if bare is None:
        return robot
    arms = any(find_anatomy(turned(bare, facing)) for facing in ("+x", "+y"))
    if choices.base not in ("prescribed", "floating") and not arms:
        return robot
    what = "called" if bare.root not in robot.links else "left out: the root is"
    note = f"the root link {WORLD!r} is {what} {bare.root}"
    return replace(bare, notes=(*robot.notes, note))


def _with_semantics(
    robot: SourceRobot, path: Path, choices: ImportChoices, report: ImportReport
) -> SourceRobot:
    """The robot with a posture and the allowed pairs of an SRDF."""
    semantics = read_srdf(path, robot)
    name, posture = semantics.posture(choices.posture)
    if name:
        report.notes.append(f"rests in the posture {name!r} of {path.name}")
    elif semantics.postures:
        report.notes.append(
            f"no posture of {path.name} was taken; write one as posture: "
            + ", ".join(semantics.postures)
        )
    return replace(robot, posture=posture or robot.posture, allowed=semantics.allowed)


def _face(robot, parts, choices: ImportChoices, report: ImportReport) -> SourceRobot:
    """The robot in a frame whose x axis is its front, its z axis up."""
    if choices.up is None and choices.facing is None:
        up = guess_up(robot)
        if up != "+z":
            choices.up = up
            report.guessed["up"] = "where arms and legs are found as a body has them"
            report.notes.append(f"{up} of the root link points up: it was turned")
    up = choices.up or "+z"
    if choices.facing is None:
        guess = guess_facing(robot, parts, up)
        choices.facing = guess.facing
        report.guessed["facing"] = guess.why
        if guess.doubt:
            report.warnings.append(f"facing: {guess.doubt}")
        if guess.facing != "+x":
            report.notes.append(
                f"the robot faces {guess.facing} of its root link, {guess.why}: it was "
                "turned to face +x"
            )
    if (choices.facing, up) != ("+x", "+z") and robot.root == WORLD:
        raise ModelError(
            f"{report.folder / IMPORT_FILE}: facing: the root link is named {WORLD!r}, "
            "which cannot turn; write +x (up: +z), or rename the link in the URDF"
        )
    return turned(robot, choices.facing, up)


def _guess_structure(
    robot: SourceRobot, parts, choices: ImportChoices, report: ImportReport
) -> None:
    """Fills in base, locked and frames where the import file leaves them out."""
    anatomy = find_anatomy(robot)
    if choices.base is None:
        if robot.root == WORLD:
            choices.base, why = "fixed", f"the root link is named {WORLD!r}"
        elif anatomy is None:
            choices.base, why = "fixed", "no pair of mirrored arms was found"
        elif (
            choices.lock is not None
            and "legs" not in choices.lock
            and has_feet(robot, anatomy, parts)
        ):
            choices.base, why = "floating", "mirrored arms and legs, none locked"
        else:
            choices.base, why = "prescribed", "two mirrored arms were found"
        report.guessed["base"] = why
    elif choices.base != "fixed" and robot.root == WORLD:
        raise ModelError(
            f"{report.folder / IMPORT_FILE}: base: the root link is named {WORLD!r}, "
            "which cannot move; write fixed, or rename the link in the URDF"
        )
    if choices.locked is None:
        lock = DEFAULT_LOCK if choices.lock is None else choices.lock
        choices.locked = guess_locked(robot, anatomy, parts, lock)
        if choices.srdf:
            stated = {n for n in choices.locked if not robot.joints[n].mimic}
            choices.locked |= {n: p for n, p in robot.posture.items() if n in stated}
        report.guessed["locked"] = _how_locked(choices, anatomy is not None)
    if choices.segments is None:
        group = _groups(robot, choices.locked)
        choices.segments = {}
        X = robot.poses()
        for arm in (anatomy.left, anatomy.right) if anatomy else ():
            hand = arm.hand
            forearm = arm.joints[elbow_index(X, arm)].child
            if group[hand] == group[forearm]:
                continue  # no wrist moves: a forearm is no hand
            others = [a for a in robot.links if group[a] == group[hand] and a != hand]
            others = [a for a in others if not robot.is_bare(a)]
            if others and group[hand] != robot.root:
                choices.segments[hand] = others
        report.guessed["segments"] = "all that is welded to a hand is one with it"
    if choices.frames is None:
        missing = (
            "a motion needs waist, neck and both arms' shoulder, elbow and wrist, "
            "keyframes only what your tasks name"
        )
        if anatomy:
            others, lacking = guess_leg_and_head_frames(robot, anatomy, parts)
            choices.frames = guess_frames(robot, anatomy, parts) | others
            how = "from the axes of the joints"
            if lacking:
                how += f"; not found: {', '.join(lacking)}"
        else:
            choices.frames = guess_tool(robot)
            found = "the tool at the end of the longest chain"
            how = f"{found if choices.frames else 'none'}; {missing}"
        report.guessed["frames"] = how


def _how_locked(choices: ImportChoices, arms: bool) -> str:
    if choices.lock is not None:
        return (
            f"joints of {', '.join(choices.lock) or 'no group'}, and those that cannot "
            "be controlled"
        )
    if arms:
        return "all joints that are not between the root and a hand"
    return "joints that mimic or are mimicked, and fingers"


def _check_structure(
    robot: SourceRobot, choices: ImportChoices, file: Path
) -> dict[str, float]:
    """Checks names and supported joints; returns where each locked joint is."""
    locked = dict(choices.locked)
    for name in locked:
        if name not in robot.joints:
            raise ModelError(
                f"{file}: locked: the robot has no joint {name!r}"
                f"{nearest(name, robot.joints)}"
            )
    for point, frame in choices.frames.items():
        if frame.link not in robot.links:
            raise ModelError(
                f"{file}: frames: {point}: the robot has no link {frame.link!r}"
                f"{nearest(frame.link, robot.links)}"
            )
    group = _groups(robot, locked)
    taken: set[str] = set()
    for name, others in choices.segments.items():
        for link in (name, *others):
            if link not in robot.links:
                raise ModelError(
                    f"{file}: segments: the robot has no link {link!r}"
                    f"{nearest(link, robot.links)}"
                )
            if link in taken:
                raise ModelError(f"{file}: segments: {link!r} is there twice")
            if group[link] != group[name]:
                raise ModelError(
                    f"{file}: segments: {link!r} is not welded to {name!r}"
                )
            taken.add(link)
    for joint in robot.joints.values():
        if joint.kind in ("floating", "planar", "ball") and joint.name not in locked:
            raise ModelError(
                f"{file}: joint {joint.name!r} is {joint.kind}, which the controller "
                "does not support; add it to locked"
            )
        if not joint.mimic:
            continue
        if joint.name not in locked:
            raise ModelError(
                f"{file}: joint {joint.name!r} mimics {joint.mimic!r}: a mimic joint "
                "cannot be controlled; add both to locked"
            )
        if joint.mimic not in locked and robot.joints[joint.mimic].kind != "fixed":
            raise ModelError(
                f"{file}: joint {joint.mimic!r} is mimicked by {joint.name!r}, which "
                "is locked; add it to locked, too"
            )
        if joint.name not in choices.locked or choices.locked[joint.name] == 0.0:
            leader = locked.get(joint.mimic, 0.0)
            locked[joint.name] = joint.multiplier * leader + joint.offset
    for loop in robot.loops:
        if open_joints := [name for name in loop.joints if name not in locked]:
            raise ModelError(
                f"{file}: {loop.name!r} closes a chain, which the controller does not "
                f"support; add to locked: {', '.join(open_joints)}"
            )
    for name, position in locked.items():
        joint = robot.joints[name]
        if not joint.lower - 1e-3 <= position <= joint.upper + 1e-3:
            raise ModelError(
                f"{file}: locked: {name}: {position:g} is beyond the joint's limits, "
                f"{joint.lower:g} to {joint.upper:g} {joint.unit}"
            )
    if all(j.kind == "fixed" or j.name in locked for j in robot.joints.values()):
        raise ModelError(f"{file}: no joint is left to control; take some from locked")
    return locked


def _merge_segments(
    robot: SourceRobot,
    locked: dict[str, float],
    parts: dict[str, list[Part]],
    choices: ImportChoices,
) -> dict[str, list[Part]]:
    """What each fit is made of: a link's parts and those of its segment's others, in
    the link's frame."""
    X = robot.poses(locked)
    merged = {name: list(of_link) for name, of_link in parts.items()}
    for name, others in choices.segments.items():
        for other in others:
            X_LO = X[name].inverse() @ X[other]
            merged[name] += [part.moved(X_LO) for part in merged.pop(other)]
    return {name: of_segment for name, of_segment in merged.items() if of_segment}


def _groups(robot: SourceRobot, locked: dict[str, float]) -> dict[str, str]:
    """Link to the first link of those that are welded to it."""
    group = {robot.root: robot.root}
    for link in robot.below(robot.root):
        joint = robot.parent_joint(link)
        if joint is not None:
            welded = joint.kind == "fixed" or joint.name in locked
            group[link] = group[joint.parent] if welded else link
    return group


def _find_covered(robot, locked, parts, report: ImportReport) -> None:
    """Links that lie inside another link's capsules need none of their own."""
    group = _groups(robot, locked)
    X = robot.poses(locked)
    by_size = sorted(
        report.fits, key=lambda name: np.ptp(_vertices(parts[name]), axis=0).max()
    )
    for name in by_size:
        for other in report.fits:
            if other == name or other in report.covered or group[other] != group[name]:
                continue
            X_OL = X[other].inverse() @ X[name]
            p_O = _vertices(parts[name]) @ X_OL.rotation().matrix().T
            p_O += X_OL.translation()
            if coverage(report.fits[other].capsules, p_O) >= 0.995:
                report.covered[name] = other
                break


def _cover(robot, locked, segments, report: ImportReport) -> None:
    """Grows each link's capsules to hold its triangles, and those of links inside."""
    X, grown = robot.poses(locked), {}
    for name in report.fits:
        if name in report.covered:
            continue
        parts = list(segments[name])
        for other in (o for o, of in report.covered.items() if of == name):
            X_LO = X[name].inverse() @ X[other]
            parts += [part.moved(X_LO) for part in segments[other]]
        report.fits[name], grown[name] = covered(report.fits[name], parts)
    growth = ", ".join(f"{name} {1e3 * by:.1f}" for name, by in grown.items())
    report.notes.append(
        "capsules were grown until they hold all triangles, the radii by at most [mm]: "
        + growth
    )


def _vertices(parts: list[Part]) -> np.ndarray:
    return np.concatenate([part.vertices for part in parts])


def _inertias(robot, locked, parts, report: ImportReport) -> dict[str, Inertia]:
    """The URDF's inertias, and a stand-in where the dynamics need one."""
    group = _groups(robot, locked)
    inertias: dict[str, Inertia] = {}
    wrong: dict[str, str] = {}
    for name, link in robot.links.items():
        inertia, complaint = read_inertia(link)
        if inertia is not None:
            inertias[name] = inertia
        elif own_mass(link) > 0.0:
            inertias[name] = stand_in(parts[name], own_mass(link))
            report.notes.append(
                f"inertia: link {name} {complaint}: taken from its convex hull"
            )
        else:
            wrong[name] = complaint
    massive = {group[name] for name in inertias}
    left_alone, bare = [], []
    for name, complaint in wrong.items():
        if group[name] in massive or group[name] == robot.root:
            left_alone.append(name)
            continue
        inertias[name] = stand_in(parts[name], 0.0)
        massive.add(group[name])
        if not parts[name]:
            bare.append(name)
            continue
        report.notes.append(
            f"inertia: link {name} {complaint} but moves: given "
            f"{inertias[name].mass:.3g} kg from its convex hull"
        )
    if bare:
        report.notes.append(
            "inertia: without mass and geometry but moving, given "
            f"{inertias[bare[0]].mass:g} kg each: {', '.join(bare)}"
        )
    if left_alone:
        report.notes.append(
            "inertia: without mass, and left so since they are welded to links that "
            f"have one: {', '.join(left_alone)}"
        )
    # Drake's own world, which a link of that name is, takes no mass.
    if robot.root not in massive and robot.root != WORLD:
        inertias[robot.root] = stand_in([], 0.0)
    return inertias


def _note_joints(robot, locked, report: ImportReport) -> None:
    moving = [j for j in robot.joints.values() if j.moves and j.name not in locked]
    report.notes.append(f"controlled joints: {', '.join(j.name for j in moving)}")
    sliding = [j for j in moving if j.kind == "prismatic"]
    if sliding:
        report.notes.append(
            "joints that slide, with positions in m, speeds in m/s and efforts in N: "
            + ", ".join(f"{j.name} ({j.lower:g} to {j.upper:g} m)" for j in sliding)
        )
    unlimited = [j.name for j in moving if not np.isfinite(j.lower)]
    if unlimited:
        report.notes.append(f"joints without limits: {', '.join(unlimited)}")
    no_effort = [j.name for j in moving if not j.effort]
    if no_effort:
        report.notes.append(f"joints without an effort limit: {', '.join(no_effort)}")
    no_speed = [j.name for j in moving if not j.velocity]
    if no_speed:
        report.notes.append(f"joints without a velocity limit: {', '.join(no_speed)}")
    report.notes.append("every controlled joint was given an actuator of its name")


def _write_meshes(
    out: Path, parts: dict[str, list[Part]], faces: int
) -> tuple[dict[str, list[VisualMesh]], dict[str, list[Part]]]:
    """Returns the files that are drawn, and what is in them."""
    visuals: dict[str, list[VisualMesh]] = {}
    drawn: dict[str, list[Part]] = {name: [] for name in parts}
    for name, of_link in parts.items():
        # One budget a link: parts share it by their number of triangles.
        total = sum(len(part.faces) for part in of_link)
        safe = name.replace("/", "_")
        for index, part in enumerate(of_link):
            share = max(60, round(faces * len(part.faces) / total))
            small = simplified(part, share)
            file = f"meshes/{safe}_{index}.obj"
            write_obj(out / file, small.vertices, small.faces)
            # What is drawn is coarser than what judges.
            write_obj(triangles_file(out / file), part.vertices, part.faces)
            visuals.setdefault(name, []).append(VisualMesh(file, part.rgba))
            drawn[name].append(small)
    return visuals, drawn


def _remove_old_triangles(made: Path, out: Path) -> None:
    """An earlier import's are of no use any more."""
    new = {path.name for path in made.glob(f"{TRIANGLES}/*.obj")}
    for path in out.glob(f"{TRIANGLES}/*.obj"):
        if path.name not in new:
            path.unlink()


def triangles_file(drawn: Path) -> Path:
    """Where all triangles of the mesh lie that is drawn from the file `drawn`."""
    return drawn.parent.parent / TRIANGLES / drawn.name


def _parse(description: RobotDescription) -> MultibodyPlant:
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
    add_robot(plant, description)
    plant.Finalize()
    return plant


def _ground_height(robot, parts, positions) -> float:
    """How high the root link is when the robot stands on the ground [m]."""
    X = robot.poses(positions)
    lowest = [
        (_vertices(of_link) @ X[name].rotation().matrix()[2]).min()
        + X[name].translation()[2]
        for name, of_link in parts.items()
        if of_link
    ]
    return float(-min(lowest, default=0.0))


def _guess_rest(robot, locked, parts, capsules, choices, report) -> None:
    """Fills in the rest posture where the import file leaves it out."""
    if choices.rest_posture is not None:
        return
    anatomy = find_anatomy(robot)
    if choices.srdf and robot.posture:
        posture = robot.posture.items()
        rest = {n: round(p, 4) for n, p in posture if n not in locked and p}
        how = f"a posture of {Path(choices.srdf).name}"
    elif anatomy:
        rest, knees = _clear_rest(robot, anatomy, locked, capsules)
        also = " and knees" if knees else ""
        how = f"arms a little out, elbows{also} bent, standing on the ground"
    else:
        rest = guess_rest(robot, None, locked)
        how = "the middle of each joint's range"
        if robot.posture:
            how = "a keyframe of the file"
    if choices.base == "prescribed" or (anatomy and robot.root != WORLD):
        height = _ground_height(robot, parts, {**locked, **rest})
        rest = {"waist_z": round(height, 4)} | rest
    choices.rest_posture = rest
    report.guessed["rest_posture"] = how


def _clear_rest(
    robot, anatomy: Anatomy, locked, capsules
) -> tuple[dict[str, float], bool]:
    """The first of some rest postures, arms ever farther out and legs farther apart, in
    which the fewest capsules touch that no hip or shoulder joins; and if knees bend."""
    links = [name for name in capsules if capsules[name]]
    pairs = [
        pair
        for pair in itertools.combinations(links, 2)
        if joints_between(robot, locked, *pair) > _SOCKET
    ]
    gaps = Gaps(capsules, pairs)
    found = []
    for away, spread in itertools.product(_AWAY, _SPREAD):
        arms = guess_rest(robot, anatomy, locked, away)
        legs = bent_knees(robot, anatomy, locked, spread)
        rest, touching = arms | legs, 0
        if pairs:
            distances = gaps.distances(robot.poses({**locked, **rest}))
            touching = np.count_nonzero(distances < CLEAR)
        found.append((touching, rest, bool(legs)))
    _, rest, knees = min(found, key=lambda each: each[0])
    return rest, knees


def _rest(
    plant: MultibodyPlant, rest_posture: dict[str, float], file: Path
) -> np.ndarray:
    q = plant.GetPositions(plant.CreateDefaultContext())
    for name, value in rest_posture.items():
        try:
            joint = find_joint(plant, name)
        except ModelError as error:
            raise ModelError(f"{file}: rest_posture: {error}") from error
        if joint.num_positions() != 1:
            raise ModelError(f"{file}: rest_posture: joint {name!r} is locked")
        q[joint.position_start()] = value
    return q


def _pairs(
    plant, robot, locked, capsules, rest, choices, report, file
) -> list[list[str]]:
    """Fills in the watched pairs; returns those left out since they touch at rest."""
    known = set(capsules)
    for pair in choices.pairs or []:
        for link in pair:
            if link not in known:
                raise ModelError(
                    f"{file}: pairs: {link!r} has no collision shape"
                    f"{nearest(link, known)}"
                )
    if choices.pairs is not None:
        return []
    twins = mirrored_links(robot, find_anatomy(robot))
    adjacent = _adjacent(robot, locked, capsules)
    found = sample_pairs(plant, capsules, rest, adjacent, twins=twins)
    allowed = _allowed(robot, capsules, choices.segments)
    choices.pairs = [p for p in found.watched if frozenset(p) not in allowed]
    overlapping = [p for p in found.overlapping if frozenset(p) not in allowed]
    report.guessed["pairs"] = (
        f"all that came within 2 cm in sampled configurations; {found.never} never did"
    )
    if left_out := [p for p in found.watched if frozenset(p) in allowed]:
        report.warnings.append(
            f"pairs: {', '.join(map(' - '.join, left_out))}: NOT watched, since "
            f"{Path(choices.srdf).name} lets them touch, although they came within "
            "2 cm in sampled configurations"
        )
    if overlapping:
        report.notes.append(
            "not watched, since they touch in the rest posture: "
            + ", ".join(map(" - ".join, overlapping))
        )
    if found.always:
        report.notes.append(
            "not watched, since they nearly always touch: "
            + ", ".join(" - ".join(pair) for pair in found.always)
        )
    return overlapping


def _watch_ground(description, plant, rest, capsules, choices, report, file) -> None:
    """Links that move are kept above the ground; guessed for a root that floats.

    Not those whose capsules are below at rest, as feet's are if they are thicker than
    the soles are high: they would be lifted.
    """
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
            f"{file}: ground: the robot has a link {GROUND!r} of its own; say -.inf"
        )
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, rest)
    fixed = {body.name() for body in plant.GetBodiesWeldedTo(plant.world_body())}
    watched, below = [], []
    for link in capsules:
        if link in fixed:
            continue
        X_WL = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(link))
        lowest = min(
            X_WL.multiply(end)[2] - capsule.radius
            for capsule in capsules[link]
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


def _allowed(robot, capsules, segments) -> set[frozenset[str]]:
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


def _adjacent(robot, locked, capsules) -> set[frozenset[str]]:
    """Pairs of links with shapes that are joined, be it through bare links."""
    pairs = set()
    for link in capsules:
        joint = robot.parent_joint(link)
        while joint is not None:
            if joint.parent in capsules:
                pairs.add(frozenset((link, joint.parent)))
                break
            joint = robot.parent_joint(joint.parent)
    return pairs


def _write_description(out: Path, description: RobotDescription) -> None:
    written = replace(description, folder="")
    text = (
        f"# Made by crar-drake import-robot from {IMPORT_FILE}; change that one.\n"
        + yaml_dump_typed(written)
    )
    with whole_file(out / DESCRIPTION) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _draw(out, plant, description, rest, parts, capsules) -> None:
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, rest)
    poses = {
        name: plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(name))
        for name in parts
    }
    points = {
        point: plant.GetFrameByName(frame).CalcPoseInWorld(context).translation()
        for point, frame in description.task_frames.items()
    }
    draw_robot(
        out / PICTURE,
        f"{description.name}: meshes, and {sum(map(len, capsules.values()))} capsules",
        poses,
        parts,
        capsules,
        points,
    )
