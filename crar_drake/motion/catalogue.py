"""What a motion is called, and which files that name stands for.

Everywhere a motion is one of:

- a path to an AMC file: `some/05_02.amc`. Its skeleton is given, or lies beside it:
  `05_02.asf`, `05.asf`, or the only ASF file of the folder.
- a path to a file of another format: BVH, C3D, TRC, MVNX, turns of a body model
  (AMASS, WHAM), or joint positions (NPZ, NPY, CSV).
- a trial of the CMU Graphics Lab database: `cmu:05_02`, looked up in the folders of
  the environment variable CRAR_MOCAP_PATH, which are laid out like the database's own
  site: `subjects/05/05.asf`, `subjects/05/05_02.amc`.
- the name of a motion that this project ships: `dance`.
"""

import difflib
import os
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from crar_drake.errors import MotionError
from crar_drake.motion.formats.asf_amc import Clip, read_amc, read_asf
from crar_drake.motion.formats.bvh import read_bvh
from crar_drake.motion.formats.c3d import read_c3d
from crar_drake.motion.formats.mvnx import mvnx_performer
from crar_drake.motion.formats.point_arrays import read_point_arrays
from crar_drake.motion.formats.smpl import holds_smpl, smpl_performer, wham_performer
from crar_drake.motion.formats.trc import read_trc
from crar_drake.motion.marker_sets import choose_markers
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import Performer
from crar_drake.motion.performers.asf_amc import asf_amc_performer
from crar_drake.motion.performers.bvh import bvh_performer
from crar_drake.motion.performers.points import joints_performer, markers_performer
from crar_drake.motion.robots_own import holds_reference
from crar_drake.motion.text_files import refuse_pointer
from crar_drake.resources import builtin_motions_folder

CMU_PREFIX = "cmu:"
SEARCH_PATH_VARIABLE = "CRAR_MOCAP_PATH"
DATABASE_URL = "http://mocap.cs.cmu.edu"


Load = Callable[[Path, str, MotionOptions], Performer]


def _load_trc(path: Path, name: str, options: MotionOptions) -> Performer:
    """Markers, if they are of a known set, else joint positions."""
    points = read_trc(path)
    try:
        choose_markers(points.names, name)
    except MotionError:
        return joints_performer(points, name, options)
    return markers_performer(points, name, options, format="TRC")


def _of(read: Callable, performer: Callable[..., Performer]) -> Load:
    """What makes the performer of what a reader reads."""
    return lambda path, name, options: performer(read(path), name, options)


# Suffix of a format other than AMC: path, name and options to the performer.
_FORMATS: dict[str, Load] = {
    ".bvh": _of(read_bvh, bvh_performer),
    ".c3d": _of(read_c3d, partial(markers_performer, format="C3D")),
    ".trc": _load_trc,
    ".mvnx": mvnx_performer,
    ".npz": _of(read_point_arrays, joints_performer),
    ".npy": _of(read_point_arrays, joints_performer),
    ".pkl": wham_performer,
    ".csv": _of(read_point_arrays, joints_performer),
}
MOTION_SUFFIXES = (".amc", *_FORMATS)


class MotionFiles(NamedTuple):
    """An AMC motion's two files."""

    amc: Path  # the motion file
    asf: Path  # the file of the skeleton that it moves


def load_performer(
    name: str | os.PathLike[str], options: MotionOptions | None = None
) -> Performer:
    """Reads the motion of that name, of any format; the performer is called so, too.

    Args:
        name: a path, `cmu:` and a trial, or a built-in name.

    Raises:
        MotionError: there is no such motion or skeleton, a file is damaged or has no
            person in it, or an option does not concern its format.
    """
    options = options or MotionOptions()
    text = os.fspath(name)
    suffix = Path(text).suffix.lower() if _is_path(name) else ".amc"
    if _is_path(name):
        refuse_pointer(os.path.expanduser(text))
        refuse_robot_motion(name)
    if suffix not in _FORMATS:
        options.refuse(("unit", "up", "facing", "joints"), f"motion {text} is an AMC")
        clip = load_clip(name, options.skeleton or None, frame_rate=options.frame_rate)
        return asf_amc_performer(clip)
    path = _existing_file(text, suffix, "motion")
    load = _FORMATS[suffix]
    if suffix == ".npz" and holds_smpl(path):
        load = smpl_performer
    if options.skeleton and load not in (smpl_performer, wham_performer):
        raise MotionError(
            f"motion {text} has its own skeleton; leave {options.skeleton} away"
        )
    return load(path, text, options)


def motion_files(
    name: str | os.PathLike[str], options: MotionOptions | None = None
) -> tuple[Path, ...]:
    """The file of the motion of that name, and those that it is read with: skeleton,
    names of joints. Arguments as of `load_performer`.

    Raises:
        MotionError: there is no such motion or skeleton.
    """
    options = options or MotionOptions()
    if _is_path(name) and Path(name).suffix.lower() in _FORMATS:
        besides = [options.skeleton, options.joints]
        return tuple(Path(p).expanduser() for p in (name, *filter(None, besides)))
    return resolve(name, options.skeleton or None)


def refuse_robot_motion(path: str | os.PathLike[str]) -> None:
    """Raises MotionError if a file holds a motion of a robot's own joints.

    It says which commands take such a motion. A file that is not there is none.
    """
    if holds_reference(path) and Path(path).is_file():
        raise MotionError(
            f"{path} is a motion of a robot's own joints, not of a person: "
            "`crar-drake judge` looks at it, `crar-drake clean` keeps the robot clear "
            "of itself along it, both with --robot ROBOT (a person's points in a CSV "
            "begin with a heading such as left_hip_x, left_hip_y, left_hip_z)"
        )


def load_clip(
    name: str | os.PathLike[str],
    skeleton: str | os.PathLike[str] | None = None,
    *,
    frame_rate: float | None = None,
) -> Clip:
    """Reads the AMC motion of that name; the clip is called `name`, too.

    Args:
        name, skeleton: as of `resolve`.
        frame_rate: samples per second [Hz]; by default what the file states, else
            that of the CMU database, which is assumed of other files, too.

    Raises:
        MotionError: as `resolve`, or a file is damaged.
    """
    text, files = os.fspath(name), resolve(name, skeleton)
    clip = read_amc(files.amc, read_asf(files.asf), frame_rate=frame_rate, name=text)
    if clip.rate_source == "assumed" and text.startswith(CMU_PREFIX):
        clip = replace(clip, rate_source="database")
    return clip


def resolve(
    name: str | os.PathLike[str], skeleton: str | os.PathLike[str] | None = None
) -> MotionFiles:
    """Finds the files of a motion; it does not look into them.

    Args:
        name: a path, `cmu:` and a trial, or a built-in name. A string is a path if
            it has a folder or an extension.
        skeleton: the ASF file of a motion given as a path, if not beside it.

    Raises:
        MotionError: the name is unknown, a file is missing or of another kind, or
            more than one skeleton could be meant.
    """
    text = os.fspath(name)
    if _is_path(name):
        amc = _existing_file(text, ".amc", "motion")
        if skeleton is None:
            return MotionFiles(amc, _skeleton_beside(amc))
        asf = _existing_file(os.fspath(skeleton), ".asf", "skeleton")
        return MotionFiles(amc, asf)
    if skeleton is not None:
        raise MotionError(
            f"motion {text!r} has its own skeleton; leave {os.fspath(skeleton)} away, "
            f"or give the motion as a path to an .amc file"
        )
    if text.startswith(CMU_PREFIX):
        return _resolve_trial(text)
    return _resolve_builtin(text)


def _is_path(name: str | os.PathLike[str]) -> bool:
    """Whether a motion's name is a path: it has a folder or an extension."""
    if not isinstance(name, str):
        return True
    return not name.startswith(CMU_PREFIX) and (
        os.sep in name or Path(name).suffix != ""
    )


# --- paths ------------------------------------------------------------------------


def _existing_file(text: str, suffix: str, kind: str) -> Path:
    path = Path(os.path.expanduser(text))
    if path.suffix.lower() != suffix:
        raise MotionError(
            f"{path}: a {kind} is an {suffix} file"
            + (f", or {', '.join(_FORMATS)}" if suffix == ".amc" else "")
            + "; other kinds are not read"
        )
    if not path.is_file():
        hint = f", or write {CMU_PREFIX}{path.stem}" if _is_trial(path.stem) else ""
        raise MotionError(f"{path}: there is no such {kind} file; check the path{hint}")
    return path


def _skeleton_beside(amc: Path) -> Path:
    """Returns the skeleton in the motion's folder that it belongs to."""
    subject = amc.stem.partition("_")[0]
    found = {
        path.stem: path
        for path in sorted(amc.parent.iterdir())
        if path.suffix.lower() == ".asf" and path.is_file()
    }
    for stem in (amc.stem, subject):
        if stem in found:
            return found[stem]
    names = ", ".join(path.name for path in found.values())
    if not found:
        raise MotionError(
            f"{amc}: no skeleton lies beside this motion; put {subject}.asf into its "
            f"folder or name the skeleton file"
        )
    if len(found) > 1:
        raise MotionError(
            f"{amc}: more than one skeleton could be this motion's: {names}; name the "
            f"right one"
        )
    # All skeletons of the database have the same bones: the motion would load on
    # another performer's, with wrong lengths and no error.
    if _is_trial(amc.stem) and next(iter(found)).isdigit():
        raise MotionError(
            f"{amc}: the skeleton beside this motion, {names}, is another subject's; "
            f"put {subject}.asf there, or name {names} if it is meant"
        )
    return next(iter(found.values()))


# --- trials of the database -------------------------------------------------------


def trial_id(text: str) -> str:
    """Returns the trial's number, `05_02`, from `05_02` or `cmu:05_02`.

    Raises:
        MotionError: it is not subject_trial, with two digits at least.
    """
    trial = text.removeprefix(CMU_PREFIX)
    numbers = re.fullmatch(r"([0-9]{1,3})_([0-9]{1,3})(\.amc)?", trial)
    if numbers is None:
        raise MotionError(
            f"{text!r} names no trial of the CMU database; write the subject's and the "
            f"trial's number, such as 05_02"
        )
    usual = f"{int(numbers[1]):02d}_{int(numbers[2]):02d}"
    if trial != usual:
        raise MotionError(f"trial {trial!r} is written {usual!r} in the CMU database")
    return trial


def _is_trial(text: str) -> bool:
    try:
        trial_id(text)
    except MotionError:
        return False
    return not text.startswith(CMU_PREFIX)


def trial_files(folder: Path, trial: str) -> MotionFiles:
    """Returns where a trial's files are in a folder laid out like the database."""
    subject = trial.partition("_")[0]
    place = folder / "subjects" / subject
    return MotionFiles(place / f"{trial}.amc", place / f"{subject}.asf")


def search_path() -> list[Path]:
    """Returns the folders that trials are looked for in."""
    listed = os.environ.get(SEARCH_PATH_VARIABLE, "").split(os.pathsep)
    return [Path(os.path.expanduser(folder)) for folder in listed if folder]


def _resolve_trial(text: str) -> MotionFiles:
    trial, folders = trial_id(text), search_path()
    there = [trial_files(folder, trial) for folder in folders]
    there = [files for files in there if files.amc.is_file()]
    for files in there:
        if files.asf.is_file():
            return files
    if there:
        raise MotionError(
            f"{text}: the motion is there, but its skeleton {there[0].asf} is missing; "
            f"get it from {DATABASE_URL}"
        )
    amc, asf = trial_files(Path(), trial)
    places = ", ".join(str(folder) for folder in folders) or "not set"
    raise MotionError(
        f"{text} is not in {SEARCH_PATH_VARIABLE} ({places}); get {amc} and "
        f"{asf} from {DATABASE_URL}, and name the folder that has subjects/ in it"
    )


def available_trials() -> dict[str, Path]:
    """Name of each trial that can be used now to its AMC file, by number."""
    found: dict[tuple[int, ...], Path] = {}
    for folder in search_path():
        for path in folder.glob("subjects/*/*.amc"):
            if _is_trial(path.stem) and all(
                file.is_file() for file in trial_files(folder, path.stem)
            ):
                number = tuple(map(int, path.stem.split("_")))
                found.setdefault(number, trial_files(folder, path.stem).amc)
    return {CMU_PREFIX + found[number].stem: found[number] for number in sorted(found)}


# --- built-in motions -------------------------------------------------------------


def builtin_names() -> list[str]:
    """Returns the names of the motions that this project ships."""
    return sorted(path.stem for path in builtin_motions_folder().glob("*.amc"))


def _resolve_builtin(name: str) -> MotionFiles:
    names = builtin_names()
    if name in names:
        amc = builtin_motions_folder() / f"{name}.amc"
        return MotionFiles(amc, _skeleton_beside(amc))
    nearest = [CMU_PREFIX + name] if _is_trial(name) else []
    nearest += difflib.get_close_matches(name.lower(), names, n=1)
    question = f"; did you mean {nearest[0]!r}?" if nearest else "."
    raise MotionError(
        f"there is no motion {name!r}{question} Built in: "
        f"{', '.join(names) or 'none'}. Others: a path to a file "
        f"({', '.join(MOTION_SUFFIXES)}), or "
        f"{CMU_PREFIX}05_02 for a trial of the CMU database"
    )
