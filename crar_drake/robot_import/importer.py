"""The whole way from a robot's file to a folder that the controller can use."""

import os
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from crar_drake.errors import ModelError, nearest
from crar_drake.files import whole_set, write_whole
from crar_drake.resources import require_packages
from crar_drake.robot.description import (
    IMPORT_FILE,
    RobotDescription,
    robot_diagram,
)
from crar_drake.robot_import.alarms import (
    floor_alarms,
    limb_alarms,
    mirrored_range_alarms,
    number_alarms,
    pair_alarms,
)
from crar_drake.robot_import.anatomy import find_anatomy, link_twins
from crar_drake.robot_import.body_plan import frame_alarms, refuse_hand, turned_hands
from crar_drake.robot_import.capsule_fitting import Fit
from crar_drake.robot_import.choices import (
    ImportChoices,
    entry_text,
    load_choices,
    save_choices,
)
from crar_drake.robot_import.import_report import ImportReport, Progress
from crar_drake.robot_import.link_bodies import (
    cover_triangles,
    find_covered,
    find_inertias,
)
from crar_drake.robot_import.link_fits import FitCache, LinkFits
from crar_drake.robot_import.meshes import Looks, guess_up_axis, with_looks
from crar_drake.robot_import.picture import draw_robot
from crar_drake.robot_import.rest_posture import (
    guess_rest_posture,
    rest_positions,
    rest_root_pose,
)
from crar_drake.robot_import.robot_files import PACKAGE_SCHEME, find_urdf
from crar_drake.robot_import.robot_folder import (
    DESCRIPTION,
    PICTURE,
    REPORT,
    URDF,
    remove_old_triangles,
    write_description,
    write_meshes,
)
from crar_drake.robot_import.source_file import read_robot
from crar_drake.robot_import.source_robot import WORLD, SourceRobot
from crar_drake.robot_import.structure import (
    check_structure,
    face_ahead,
    guess_structure,
    merge_segments,
    with_semantics,
    without_world,
)
from crar_drake.robot_import.tightening import tighten
from crar_drake.robot_import.urdf_writer import BASE_JOINTS, frame_name, write_urdf
from crar_drake.robot_import.watched_pairs import choose_pairs, watch_ground

# Module to the package that brings it; trimesh imports the others when it needs them.
_MESH_PACKAGES = {
    "trimesh": "trimesh",
    "collada": "pycollada",
    "networkx": "networkx",
    "fast_simplification": "fast-simplification",
    "fcl": "python-fcl",
}


def import_robot(
    source: str | os.PathLike[str],
    out: Path,
    *,
    progress: Progress | None = None,
    **given,
) -> ImportReport:
    """Turns a robot's own file into a folder with all that a scenario's `robot` needs.

    The folder then holds import.yaml (what was decided; kept if it is there),
    robot.urdf, robot.yaml, meshes/, picture.png and report.txt.

    Args:
        source: path of a URDF, SDF or MJCF, or the name of one in
            example-robot-data; "" where `out` has an import.yaml that says it.
        out: the folder.
        progress: is told what is done.
        given: keys of the import file (`ImportChoices`) that are decided already, on a
            first import; `package_paths` on any. What is not given is guessed. Where
            there is an import file a value must be the default or the file's.

    Nothing of it is written unless all of it can be; only the import file is, where
    what is guessed has to be corrected first.

    Raises:
        ModelError: something in the file or the choices is wrong or not supported,
            or a package of the extra `robots` is missing; the message names it.
    """
    check_installed()
    progress = progress or (lambda what, share: None)
    file = out / IMPORT_FILE
    wanted = _wanted(given)
    if wanted.srdf:  # an option's path is relative to where one is
        wanted.srdf = str(Path(wanted.srdf).resolve())
    if file.is_file():
        choices = load_choices(file)
        if source and find_urdf(source)[0] != _locate(choices.source, out):
            raise ModelError(
                f"{file} was made from {choices.source}; to import another robot give "
                "another --out, or remove that file"
            )
        _check_wanted(wanted, choices, file)
    else:
        choices = replace(wanted, source=find_urdf(source)[1])
    choices.validate(str(file))
    progress("reading", 0.0)
    folders = [Path(p) for p in (*wanted.package_paths, *choices.package_paths)]
    robot = read_robot(_locate(choices.source, out), folders)
    choices = replace(choices, name=choices.name or robot.name)
    robot = without_world(robot, choices)
    notes, warnings = list(robot.notes), list(robot.warnings)
    report = ImportReport(out, choices, notes=notes, warnings=warnings)
    if choices.srdf:
        robot = with_semantics(robot, report)
    if choices.up_axis is None and (guess := guess_up_axis(robot)) is not None:
        choices.up_axis, report.guessed["up_axis"] = guess
    robot = face_ahead(with_looks(robot, choices.up_axis or "z"), report)
    refuse_hand(robot)
    guess_structure(robot, report)
    try:
        robot = check_structure(robot, report)
    except ModelError:
        save_choices(file, choices, report.guessed)  # so that it can be corrected
        raise

    segments = merge_segments(robot, choices)
    cache = FitCache(out / "meshes" / "fits.json")
    fits = LinkFits(robot, segments, link_twins(robot), cache)
    found: dict[str, Fit | None] = {}
    for index, name in enumerate(segments):
        if name not in found:
            progress(f"fitting {name}", index / len(segments))
            found |= fits.fit([name], choices.excess, choices.most_capsules)
    for name in (name for name, fit in found.items() if fit is None):
        report.notes.append(f"link {name} is flat: it gets no collision shape")
    # In the order of the links, which that of the pairs is.
    report.fits = {name: found[name] for name in segments if found[name] is not None}
    if file.is_file():
        cache.save()  # what is refused below need not be fitted again
    find_covered(robot, segments, report)
    if choices.cover:
        progress("covering", 1.0)
        cover_triangles(robot, segments, report)
    with whole_set(out, DESCRIPTION) as made:
        _make(made, robot, segments, fits, report, progress)
        save_choices(file, choices, report.guessed)
        write_whole(made / REPORT, "\n".join(report.lines()) + "\n")
        remove_old_triangles(made, out)
    cache.save()
    return report


def _make(
    folder: Path,
    robot: SourceRobot,
    segments: Looks,
    fits: LinkFits,
    report: ImportReport,
    progress: Progress,
) -> None:
    """Makes the model, its description, meshes and picture in a folder, and the
    choices that need them."""
    choices, file = report.choices, report.file
    inertias = find_inertias(robot, report)
    _note_joints(robot, report)
    progress("writing meshes", 1.0)
    visuals, drawn = write_meshes(folder, robot.looks, choices.faces)
    guess_rest_posture(robot, report)
    # A robot with a waist stands on the floor, although its base is fixed.
    rest_posture = dict(choices.rest_posture)
    lifted = choices.base != "prescribed" and "waist_z" not in robot.joints
    height = rest_posture.pop("waist_z", 0.0) if lifted else 0.0
    if height and robot.root == WORLD:
        raise ModelError(
            f"{file}: rest_posture: waist_z: the root link is named {WORLD!r} and "
            "cannot be lifted; take waist_z out"
        )

    def write() -> bool:
        return write_urdf(
            folder / URDF,
            robot,
            choices.name,
            base=choices.base,
            height=height,
            frames=choices.frames,
            visuals=visuals,
            capsules=report.capsules(),
            inertias=inertias,
        )

    description = RobotDescription(
        name=choices.name,
        model=URDF,
        base="" if write() else robot.root,
        task_frames={point: frame_name(point) for point in choices.frames},
        rest_posture=rest_posture,
        soles=choices.soles,
        folder=str(folder),
    )
    if choices.base == "prescribed":
        driven = {name: by for name, (_, _, by) in BASE_JOINTS.items()}
        description.prescribed_joints = driven
    elif choices.base == "floating":
        description.root = "prescribed"
        description.root_pose = rest_root_pose(robot, height)
    _, plant, _ = robot_diagram(description)
    rest = rest_positions(plant, rest_posture, file)
    # With all triangles held there is nothing to be closer.
    if not choices.cover:
        progress("comparing capsules with meshes", 1.0)
        if tighten(plant, robot, segments, rest, fits, report):
            write()
            _, plant, _ = robot_diagram(description)
    anatomy = find_anatomy(robot)
    report.warnings += limb_alarms(robot, choices.frames)
    floating = choices.base == "floating"
    report.warnings += frame_alarms(robot, anatomy, choices.frames, floating)
    report.notes += turned_hands(robot, choices.frames)
    report.warnings += number_alarms(robot)
    report.warnings += mirrored_range_alarms(robot, anatomy)
    if anatomy is not None:
        height = choices.rest_posture.get("waist_z", 0.0)
        report.warnings += floor_alarms(robot, rest_posture, height, anatomy)
    progress("sampling pairs", 1.0)
    overlapping = choose_pairs(plant, robot, rest, report)
    report.warnings += pair_alarms(
        robot, segments, rest_posture, choices.pairs, overlapping
    )
    description.pairs = choices.pairs
    watch_ground(description, plant, rest, report)
    description.validate()
    write_description(folder, description)
    progress("drawing", 1.0)
    draw_robot(folder / PICTURE, plant, description, rest, drawn, report.capsules())


def check_installed() -> None:
    """Imports what meshes are read and changed with.

    They are asked for before anything is read: trimesh would miss the others in the
    middle of an import, each only for some formats and some meshes.

    Raises:
        ModelError: a package of the extra `robots` is not installed, or is broken.
    """
    require_packages(_MESH_PACKAGES, "importing robots")


# Keys of an import file, and what in it was guessed by them.
_STALE = {
    "lock": "locked, segments, rest_posture and pairs",
    "cover": "pairs",
    "srdf": "locked, rest_posture and pairs",
    "posture": "locked, rest_posture and pairs",
}


def _check_wanted(wanted: ImportChoices, choices: ImportChoices, file: Path) -> None:
    """What an import file says is changed there, by no option."""
    default = ImportChoices()
    for key in _keys():
        value, known = getattr(wanted, key), getattr(choices, key)
        if value == getattr(default, key):
            continue
        text = entry_text(key, value)
        entry = text.strip() if text.count("\n") == 1 else f"your {key}"
        if key == "lock":
            value, known = set(value), None if known is None else set(known)
            entry = f"lock: [{', '.join(wanted.lock)}]"
        elif key == "srdf" and known:
            known = str((file.parent / known).resolve())
        # Numbers are rounded where they are written.
        if value != known and (known is None or text != entry_text(key, known)):
            take_out = f", take out {_STALE[key]}," if key in _STALE else ""
            raise ModelError(
                f"{file} is there already: write {entry} into it{take_out} and import "
                "again without the option"
            )


def _wanted(given: dict) -> ImportChoices:
    """The choices with what is given, tuples in it as lists, as the file has them."""
    for key in given:
        if key not in (known := (*_keys(), "package_paths")):
            raise ModelError(
                f"import_robot: {key}: unknown key of an import{nearest(key, known)}"
            )
    return ImportChoices(**{key: _listed(value) for key, value in given.items()})


def _keys() -> list[str]:
    """Of an import file, those that every import of the robot shares."""
    names = (each.name for each in fields(ImportChoices))
    return [name for name in names if name not in ("source", "package_paths")]


def _listed(value):
    if isinstance(value, list | tuple):
        return [*map(_listed, value)]
    if isinstance(value, dict):
        return {key: _listed(entry) for key, entry in value.items()}
    return value


def _locate(source: str, out: Path) -> Path:
    if source.startswith(PACKAGE_SCHEME) or Path(source).is_absolute():
        return find_urdf(source)[0]
    beside = out / source
    return find_urdf(beside if beside.is_file() else source)[0]


def _note_joints(robot: SourceRobot, report: ImportReport) -> None:
    moving = robot.controlled
    report.note("controlled joints", [j.name for j in moving])
    sliding = [j for j in moving if j.kind == "prismatic"]
    report.note(
        "joints that slide, with positions in m, speeds in m/s and efforts in N",
        [f"{j.name} ({j.lower:g} to {j.upper:g} m)" for j in sliding],
    )
    lacking = {
        "limits": [j.name for j in moving if not np.isfinite(j.lower)],
        "an effort limit": [j.name for j in moving if not j.effort],
        "a velocity limit": [j.name for j in moving if not j.velocity],
    }
    for what, names in lacking.items():
        report.note(f"joints without {what}", names)
    report.notes.append("every controlled joint was given an actuator of its name")
