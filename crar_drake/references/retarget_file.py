"""A person's motion in, a robot's reference motion with its certificate out."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.files import check_file
from crar_drake.motion.catalogue import load_performer, motion_files
from crar_drake.motion.conditioning import angles_between
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import SIDES
from crar_drake.motion.quaternion_spline import sign_continuous
from crar_drake.motion.rates import check_rate
from crar_drake.motion.report import inspect
from crar_drake.references.certificate_files import check_certificate_place, file_hash
from crar_drake.references.clean_file import CleanedClip, MotionCleaner
from crar_drake.references.cleaning import CleaningParameters
from crar_drake.references.contacts import as_extras
from crar_drake.references.faults import Fault, find_faults, find_limbs_off
from crar_drake.references.ground_contact import Outline
from crar_drake.references.layouts import layout_named, layouts_of
from crar_drake.references.mesh_rows import MeshRows
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
CLEANING = CleaningParameters()  # of what was retargeted


@dataclass(frozen=True, kw_only=True)
class RetargetedClip(CleanedClip):
    """What became of a person's motion; `seconds` are from the file to the certified
    motion.

    What it inherits is of the motion before and after cleaning, both the robot's.
    """

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
class RetargetOptions:
    """How motions are read, retargeted and written."""

    # what is known of a motion beyond its file
    options: MotionOptions = MotionOptions()
    layout: str = ""  # to be written; "": the usual one of the file's suffix
    rate: float = RATE  # frames per second to be written [Hz]
    # what is wanted
    parameters: RetargetingParameters = field(default_factory=RetargetingParameters)
    limits: float = 1.0  # share of joints' ranges, as `RobotDescription.range_share`
    # limbs that are off by more for longer than 0.2 s are a fault [rad]; the head is
    # none of them
    most_off: float = np.pi / 4.0

    def __post_init__(self) -> None:
        check_rate(self.rate)

    def certified(self, motion: str | os.PathLike[str]) -> dict:
        """What a certificate has of them, of one motion.

        Raises:
            MotionError: as `motion_files`.
        """
        _, *besides = motion_files(motion, self.options)
        return {
            "retargeted": asdict(self.parameters),
            "motion": asdict(self.options),
            "read with": {path.name: file_hash(path) for path in besides},
            "layout": self.layout,
            "rate": self.rate,
            "limits": self.limits,
            "most off": self.most_off,
        }


def retarget_file(
    motion: str | os.PathLike[str],
    out: str | os.PathLike[str],
    robot: str,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> RetargetedClip:
    """Retargets a person's motion, and writes it and its certificate, or neither.

    Args:
        motion: a file, `cmu:` and a trial, or a built-in name.
        out: to be written.
        robot: name or folder of a robot with legs, imported as a whole body.
        progress: is called with the frame that was reached, and of how many.
        options: see `RetargetOptions`.

    Raises:
        MotionError: the motion cannot be read, or lacks something that a whole body
            needs; `out` can be of no layout.
        ModelError: the robot is not there, or lacks something.
        WriteError, CrarError: as of `clean_file`.
    """
    out, given = Path(out), RetargetOptions(**options)
    given = replace(given, layout=layout_of(out, given.layout))
    _check_place(out)
    (clip,) = FileRetargeter(robot, given)(motion, out, progress)
    return clip


class FileRetargeter:
    """Retargets motions of people to one robot, one file after the other.

    Attributes:
        retargeter: of the robot.
    """

    def __init__(self, robot: str, options: RetargetOptions) -> None:
        """
        Args:
            robot: as of `retarget_file`.
            options: of all motions; their layout is named.

        Raises:
            ModelError: as `retarget_file`.
        """
        self._options = options
        description = load_robot_description(robot).without_ground()
        description = replace(description, range_share=options.limits)
        self._robot = WholeBody(description)
        self.retargeter = Retargeter(
            description, options.parameters, self._robot.outlines
        )
        self._cleaner = MotionCleaner(self._robot, CLEANING, part_meshes=False)
        self._outline = Outline(self._robot)
        meshes, names = (
            self._cleaner.uncovered.meshes,
            self.retargeter.model.joint_names,
        )
        self._meshes = None if meshes is None else MeshRows(meshes, names)

    def __call__(
        self,
        motion: str | os.PathLike[str],
        out: Path,
        progress: Callable[[int, int], None] | None = None,
    ) -> list[RetargetedClip]:
        """Retargets a motion, the only one of its file; see `retarget_file`."""
        _check_place(out)
        robot, retargeter, options = self._robot, self.retargeter, self._options
        rate, layout = options.rate, options.layout
        began = time.process_time()
        performer = load_performer(motion, options.options)
        frames = int(performer.duration * rate) + 1
        found = retargeter.retarget(
            performer,
            rate,
            None if progress is None else lambda k: progress(k, frames),
            self._meshes,
        )
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
        likeness_of: list = []

        def judged(written: RobotMotion) -> Iterator[Fault]:
            ground = self._outline.ground_contact(written, floor=0.0)
            like = likeness(retargeter, found.targets, written)
            likeness_of.extend((written, ground, *like))
            yield from find_faults(written, ground)
            yield from find_limbs_off(like[0], options.most_off, rate)

        (cleaned,) = self._cleaner.clean(
            [made],
            out,
            reference=motion_files(motion, options.options)[0],
            layout=layout,
            options=options.certified(motion),
            judged=judged,
        )
        seconds = time.process_time() - began
        written, ground, off, knees = likeness_of
        most = {limb: float(np.quantile(by, 0.95)) for limb, by in off.items()}
        farthest = max(most, key=most.__getitem__)
        arms_and_legs = [limb for limb in off if "-" in limb]
        left_knee, right_knee = (float(np.median(knees[side])) for side in SIDES)
        root, root_peak = root_acceleration(written.root_positions, rate)
        persons = root_acceleration(found.targets.root_positions, rate)
        clip = RetargetedClip(
            **asdict(replace(cleaned, seconds=seconds)),
            limbs_median=max(float(np.median(off[limb])) for limb in arms_and_legs),
            limbs_most=max(most[limb] for limb in arms_and_legs),
            farthest=farthest,
            farthest_most=most[farthest],
            left_knee=left_knee,
            right_knee=right_knee,
            slip=self._outline.slip_of_planted(written, planted),
            leaving=max((foot.worst for foot in ground.feet), default=0.0),
            lowest=float(ground.lowest.min()),
            root=root,
            root_peak=root_peak,
            persons_root=persons[0],
            persons_root_peak=persons[1],
        )
        return [clip]


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


def _check_place(out: Path) -> None:
    check_file(out)
    check_certificate_place(out)


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
    names = motion.joint_names
    q = motion.joint_positions[
        :, [names.index(x) for x in retargeter.model.joint_names]
    ]
    ends = [LIMBS[limb][1] for limb in targets.directions]
    ways = dict(
        zip(
            targets.directions,
            retargeter.ways(
                motion.root_positions, motion.root_rotations.as_matrix(), q, ends
            ),
            strict=True,
        )
    )
    off = {
        limb: angles_between(ways[limb], way)
        for limb, way in targets.directions.items()
    }
    knees = {}
    for side in SIDES:
        pair = f"{side}_hip-knee", f"{side}_knee-ankle"
        of_robot, of_person = (
            angles_between(*(of[limb] for limb in pair))
            for of in (ways, targets.directions)
        )
        knees[side] = of_robot - of_person
    return off, knees
