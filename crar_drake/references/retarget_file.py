"""People's motions in, a robot's reference motions with their certificates out."""

from __future__ import annotations

import os
import time
from dataclasses import asdict, dataclass, field, replace
from math import degrees
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import CrarError, MotionError
from crar_drake.motion.catalogue import MOTION_SUFFIXES, load_performer, motion_files
from crar_drake.motion.conditioning import angles_between
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import SIDES
from crar_drake.motion.quaternion_spline import sign_continuous
from crar_drake.motion.rates import check_rate
from crar_drake.motion.report import inspect
from crar_drake.motion.robots_own import holds_reference
from crar_drake.references.certificate_files import SUFFIX, file_hash
from crar_drake.references.cleaning import CleaningParameters
from crar_drake.references.contacts import as_extras
from crar_drake.references.faults import find_faults, find_limbs_off
from crar_drake.references.folder_page import Figure
from crar_drake.references.folders import is_table
from crar_drake.references.layouts import layout_named, layouts_of
from crar_drake.references.mesh_rows import MeshRows
from crar_drake.references.pipeline import (
    FIGURES,
    Judged,
    Operation,
    Pipeline,
    Progress,
    Solved,
    WrittenClip,
    check_place,
)
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.smoothness import root_acceleration
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description
from crar_drake.trajectory.performer_targets import LIMBS, PerformerTargets
from crar_drake.trajectory.retargeting import (
    Retargeter,
    RetargetingParameters,
)

# Of the layouts that a file can have, those that are taken if none is named.
_LAYOUTS = {".csv": "xyzw-csv", ".npz": "mjlab-npz", ".pkl": "gmr-pkl"}
RATE = 30.0  # [Hz] that most reference motions have


@dataclass(frozen=True, kw_only=True)
class RetargetedClip(WrittenClip):
    """What became of a person's motion; `seconds` are from the file to the certified
    motion."""

    # of arms and legs, how far the farthest limb is off in direction, in the median
    # [rad]
    limbs_median: float
    limbs_most: float  # and in 95 % of the frames [rad]
    farthest: str  # of all limbs, the one that is the farthest off
    farthest_most: float  # by how much it is, in 95 % of the frames [rad]
    # how much more a knee bends than the person's in the median; negative: less [rad]
    left_knee: float
    right_knee: float
    # the longest way that a foot slips in one contact [m]. It is planted while the
    # performer's heel or ball is on the floor, from the first such frame to the last:
    # in the step in which both leave it is not.
    slip: float
    # the same as `crar-drake judge` has it, which does not know the contacts and takes
    # a foot for planted until it is 30 mm high, or fast [m]
    leaving: float
    lowest: float  # the lowest point of all links, over the floor [m]
    root: float  # how the root accelerates, rms [m/s^2],
    root_peak: float  # and at most [m/s^2]
    persons_root: float  # and the person's, scaled, rms [m/s^2],
    persons_root_peak: float  # and at most [m/s^2]


@dataclass(frozen=True)
class RetargetOptions(Operation):
    """How motions are read, retargeted and written."""

    robot: str  # name or folder of a robot with legs, imported as a whole body
    # what is known of a motion beyond its file
    person: MotionOptions = MotionOptions()
    layout: str = _LAYOUTS[".csv"]  # to be written
    rate: float = RATE  # frames per second to be written [Hz]
    # what is desired
    problem: RetargetingParameters = field(default_factory=RetargetingParameters)
    limits: float = 1.0  # share of joints' ranges, as `RobotDescription.range_share`
    # limbs that are off by more for longer than 0.2 s are a fault [rad]; the head is
    # none of them
    most_off: float = np.pi / 4.0

    parameters: ClassVar = CleaningParameters()  # of what was retargeted
    table: ClassVar = "retargeted.csv"
    record: ClassVar = RetargetedClip
    figures: ClassVar = (
        Figure("limbs off, 95 % [deg]", lambda r: degrees(r.limbs_most), 1),
        Figure("median [deg]", lambda r: degrees(r.limbs_median), 1),
        Figure("of all limbs, 95 % [deg]", lambda r: degrees(r.farthest_most), 1),
        Figure("left knee, median [deg]", lambda r: degrees(r.left_knee), 1),
        Figure("right knee [deg]", lambda r: degrees(r.right_knee), 1),
        Figure("feet slip [mm]", lambda r: 1e3 * r.slip, 1),
        Figure("lowest point [mm]", lambda r: 1e3 * r.lowest, 1),
        Figure("root accelerates, rms [m/s²]", lambda r: r.root, 1),
        Figure("the person's [m/s²]", lambda r: r.persons_root, 1),
        *FIGURES,
    )

    def __post_init__(self) -> None:
        check_rate(self.rate)

    def begin(self) -> FileRetargeter:
        """See `Operation`."""
        return FileRetargeter(self)

    def sources(self, folder: Path) -> list[Path]:
        """See `Operation`; skeletons, motions of robots and certificates are none."""
        layout_named(self.layout)
        found = sorted(
            path
            for path in folder.rglob("*")
            if path.suffix.lower() in MOTION_SUFFIXES
            and path.is_file()
            and not path.name.endswith(SUFFIX)
            and not is_table(path)
            and not holds_reference(path)
        )
        if not found:
            suffixes = ", ".join(MOTION_SUFFIXES)
            raise CrarError(
                f"{folder}: no motions of people ({suffixes}) in it or below; of "
                "robots' own there may be some, which crar-drake clean takes"
            )
        return found

    def options(self, source: str | os.PathLike[str]) -> dict:
        """See `Operation`."""
        _, *besides = self.files(source)
        return {
            "retargeted": asdict(self.problem),
            "motion": asdict(self.person),
            "read with": {path.name: file_hash(path) for path in besides},
            "layout": self.layout,
            "rate": self.rate,
            "limits": self.limits,
            "most off": self.most_off,
        }

    def files(self, source: str | os.PathLike[str]) -> list[Path]:
        """See `Operation`; a skeleton is read with an AMC.

        Raises:
            MotionError: as `motion_files`.
        """
        return list(motion_files(source, self.person))

    def place(self, path: Path) -> Path:
        """See `Operation`."""
        return path.with_suffix(layout_named(self.layout).suffix)

    def note(self, clip: RetargetedClip) -> str:
        """See `Operation`."""
        return clip.deepest or clip.faults or f"farthest off: {clip.farthest}"


def retarget_file(
    motion: str | os.PathLike[str],
    out: str | os.PathLike[str],
    robot: str,
    *,
    layout: str = "",
    progress: Progress | None = None,
    **options: Any,
) -> RetargetedClip:
    """Retargets a person's motion, and writes it and its certificate, or neither.

    Args:
        motion: a file, `cmu:` and a trial, or a built-in name.
        out: to be written.
        robot, options: see `RetargetOptions`.
        layout: of `out`; "": the usual one of its suffix.
        progress: is called with the frame that was reached, and of how many.

    Raises:
        MotionError: the motion cannot be read, or lacks something that a whole body
            needs; `out` can be of no layout.
        ModelError: the robot is not there, or lacks something.
        WriteError, CrarError: as of `clean_file`.
    """
    out = Path(out)
    given = RetargetOptions(robot, layout=layout_of(out, layout), **options)
    check_place(out, motion)
    (clip,) = FileRetargeter(given)(motion, out, progress)
    return clip


@dataclass(frozen=True)
class _Retargeted(Solved):
    targets: PerformerTargets  # what the person asks of the robot
    planted: dict[str, np.ndarray]  # foot to (T,) whether it is on the floor


class FileRetargeter(Pipeline):
    """Retargets motions of people to one robot, one file after the other.

    Attributes:
        retargeter: of the robot.
    """

    part_meshes = False

    def __init__(self, options: RetargetOptions) -> None:
        """
        Raises:
            ModelError: as `retarget_file`.
        """
        description = load_robot_description(options.robot).without_ground()
        description = replace(description, range_share=options.limits)
        robot = WholeBody(description)
        self.retargeter = Retargeter(description, options.problem, robot.outlines)
        super().__init__(options, robot)
        meshes, names = self.uncovered.meshes, self.retargeter.model.joint_names
        self._meshes = None if meshes is None else MeshRows(meshes, names)

    def __call__(
        self,
        source: str | os.PathLike[str],
        out: Path,
        progress: Progress | None = None,
    ) -> list[RetargetedClip]:
        """Retargets a motion, the only one of its file; see `retarget_file`."""
        began = time.process_time()
        (clip,) = super().__call__(source, out, progress)
        return [replace(clip, seconds=time.process_time() - began)]

    def solve(
        self, source: str | os.PathLike[str], progress: Progress | None
    ) -> list[_Retargeted]:
        """See `Pipeline`."""
        robot, retargeter, rate = self.robot, self.retargeter, self.operation.rate
        performer = load_performer(source, self.operation.person)
        frames = int(performer.duration * rate) + 1
        done = None if progress is None else lambda k: progress(k, frames)
        found = retargeter.retarget(performer, rate, done, self._meshes)
        quaternions = Rotation.from_matrix(found.root_rotations).as_quat()
        names = retargeter.model.joint_names
        planted = {
            f"{side}_foot": foot.on_heel | foot.on_ball
            for side, foot in found.targets.feet.items()
        }
        made = RobotMotion(
            joint_names=robot.joint_names,
            root_positions=found.root_positions,
            root_quaternions=sign_continuous(quaternions)[:, [3, 0, 1, 2]],
            joint_positions=found.q[:, [names.index(x) for x in robot.joint_names]],
            rate=rate,
            guesses=inspect(performer).remarks,
            extras=as_extras(planted),
        )
        motion, _ = self.cleaned(made)
        return [_Retargeted(motion, found.targets, planted)]

    def judge(self, solved: _Retargeted, written: RobotMotion) -> Judged:
        """See `Pipeline`; of the written motion, which has no reference."""
        ground = self.outline.ground_contact(written, floor=0.0)
        off, knees = likeness(self.retargeter, solved.targets, written)
        rate = self.operation.rate
        faults = [
            *find_faults(written, ground),
            *find_limbs_off(off, self.operation.most_off, rate),
        ]
        most = {limb: float(np.quantile(by, 0.95)) for limb, by in off.items()}
        farthest = max(most, key=most.__getitem__)
        arms_and_legs = [limb for limb in off if "-" in limb]
        left_knee, right_knee = (float(np.median(knees[side])) for side in SIDES)
        root, root_peak = root_acceleration(written.root_positions, rate)
        persons = root_acceleration(solved.targets.root_positions, rate)
        more = {
            "seconds": 0.0,  # is known when it is written
            "limbs_median": max(float(np.median(off[limb])) for limb in arms_and_legs),
            "limbs_most": max(most[limb] for limb in arms_and_legs),
            "farthest": farthest,
            "farthest_most": most[farthest],
            "left_knee": left_knee,
            "right_knee": right_knee,
            "slip": self.outline.slip_of_planted(written, solved.planted),
            "leaving": max((foot.worst for foot in ground.feet), default=0.0),
            "lowest": float(ground.lowest.min()),
            "root": root,
            "root_peak": root_peak,
            "persons_root": persons[0],
            "persons_root_peak": persons[1],
        }
        return Judged(faults, [], more)


def layout_of(out: Path, layout: str) -> str:
    """The layout of a file that is to be written, if there is such a one.

    Raises:
        MotionError: there is none.
    """
    layout = layout or _LAYOUTS.get(out.suffix.lower(), "")
    if layout:
        layout_named(layout)
    if not layout or layout not in layouts_of(out):
        raise MotionError(
            f"{out}: a reference motion is a .csv, .npz or .pkl"
            + (f", and not of layout {layout}" if layout else "")
        )
    return layout


def likeness(
    retargeter: Retargeter, targets: PerformerTargets, motion: RobotMotion
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """How like the person a robot moves: limb to (T,) how far its direction is off, and
    side to (T,) how much more its knee bends [rad].

    Args:
        retargeter: of the robot.
        targets: what the person asks of it, at the motion's frames.
        motion: the robot's.
    """
    names, persons = motion.joint_names, targets.directions
    columns = [names.index(name) for name in retargeter.model.joint_names]
    p_WR, R_WR = motion.root_positions, motion.root_rotations.as_matrix()
    ends = [LIMBS[limb][1] for limb in persons]
    ways = retargeter.ways(p_WR, R_WR, motion.joint_positions[:, columns], ends)
    robots = dict(zip(persons, ways, strict=True))
    off = {limb: angles_between(robots[limb], way) for limb, way in persons.items()}
    knees = {}
    for side in SIDES:
        pair = f"{side}_hip-knee", f"{side}_knee-ankle"
        bent, persons_bent = (
            angles_between(*(of[limb] for limb in pair)) for of in (robots, persons)
        )
        knees[side] = bent - persons_bent
    return off, knees
