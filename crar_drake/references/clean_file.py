"""One file of reference motions in, a cleaned one of the same layout out."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.files import check_file, whole_set
from crar_drake.references.adjusting import (
    Frames,
    check_feet,
    set_on_ground,
    trimmed,
)
from crar_drake.references.certificate_files import (
    certificate_path,
    check_certificate_place,
    write_certificate,
)
from crar_drake.references.change import (
    ANY_CHANGE,
    AtMost,
    Change,
    find_change,
    find_frozen,
)
from crar_drake.references.cleaning import Cleaner, CleaningParameters
from crar_drake.references.faults import Fault, find_faults, left_as_it_was
from crar_drake.references.ground_contact import CarryingHands, Outline
from crar_drake.references.layouts import LAYOUTS, layout_named
from crar_drake.references.mesh_clearance import MeshClearance
from crar_drake.references.motion_certificate import CertifiedClip, make_certificate
from crar_drake.references.motion_files import read_motions, write_motions
from crar_drake.references.resampling import retimed
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.uncovered import Uncovered
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import LIMIT_TOLERANCE, load_robot_description
from crar_drake.trajectory.margins import Margins

# What is wrong with a motion that was written.
Judged = Callable[[RobotMotion], Iterable[Fault]]

# A frame counts as changed if a joint is farther from the reference [rad or m].
_CHANGED = 1e-6


@dataclass(frozen=True, kw_only=True)
class CleanedClip(Change):
    """What cleaning made of one motion, with how far it changed."""

    clip: str  # its name; "" in files with one motion
    frames: int  # T
    rate: float  # [Hz]
    penetrating_before: int  # frames with watched capsules in penetration
    # and after cleaning: with those of pairs of which meshes do not decide
    penetrating: int
    # frames in which these do, or are not shown to be clear on the way to the next
    unclear: int
    beyond_limit_before: int  # frames with a joint beyond its limit
    beyond_limit: int  # and after
    too_fast_before: int  # frames from which a joint goes on beyond its speed limit
    too_fast: int  # and after
    nearest_before: float  # the smallest distance of watched capsules [m]
    nearest: float  # and after [m]
    between: float  # no distance on the straight ways between frames is smaller [m]
    changed: int  # frames with a joint that is not where the reference has it
    # frames that keep less than the floor, at them or on the way to the next, of pairs
    # of which meshes do not decide; those that penetrate among them
    near: int
    # frames that stand still on the way to the next while the reference moves
    frozen: int
    # frames in which meshes penetrate, those of links that nobody watches among them;
    # -1 where there are none to be looked at
    meshes_penetrating: int
    # ways to the next frame on which meshes touch, or are not shown to be clear; -1 as
    # well
    meshes_unclear: int
    # of a processor that cleaning took, asking and parting meshes with it, without
    # reading, writing and measuring [s]
    seconds: float = 0.0
    # by how much it was set on the ground; 0 if that was not asked for [m]
    raised: float = 0.0
    slowed: float = 0.0  # by how much longer it takes; 0 if that was not asked for [s]
    # frame and pair of the deepest penetration, in words; "" without one
    deepest: str = ""
    # what else is wrong with it, and what its reference had, too, and was left as it
    # was, in words; "" if nothing is
    faults: str = ""
    left: str = ""
    # what changed by more than was allowed, in words; "" if nothing did
    exceeded: str = ""
    # what the file did not say and was guessed, in words; of a motion that was
    # retargeted how the person's file was read, and what looks bad in it
    guessed: str = ""

    @property
    def times_real_time(self) -> float:
        """How much faster than the motion itself it was cleaned, on one core."""
        return (self.frames - 1) / self.rate / self.seconds if self.seconds else 0.0

    @property
    def violated(self) -> bool:
        """Whether anything is violated, a way between frames is not shown to be clear,
        something is wrong that was not before, or it changed by more than was
        allowed."""
        shapes = self.penetrating or self.unclear
        meshes = self.meshes_penetrating > 0 or self.meshes_unclear > 0
        limits = self.beyond_limit or self.too_fast
        return bool(shapes or meshes or limits or self.exceeded or self.faults)


def clean_file(
    reference: str | os.PathLike[str],
    out: str | os.PathLike[str],
    robot: str,
    parameters: CleaningParameters | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> list[CleanedClip]:
    """Cleans all motions of a file, and writes them and their certificate, or neither.

    Args:
        reference: the file.
        out: to be written, in the same layout.
        robot: name or folder of the robot.
        parameters: what changing the least means, and what is kept.
        progress: is called with the frame that was reached, and of how many.
        options: see `FileOptions`.

    Raises:
        MotionError: the file cannot be read, is of another robot or of no known layout,
            ends before the frames that are kept, or a joint is beyond its limits by
            more than a turn.
        ModelError: the robot is not there, not one that can be cleaned for, or lacks
            what an option asks for.
        WriteError: the file or its certificate cannot be written.
        CrarError: the certificate would take the place of another file's.
    """
    reference, out, given = Path(reference), Path(out), FileOptions(**options)
    _check_places(reference, out, given)
    return FileCleaner(robot, parameters, given)(reference, out, progress)


@dataclass(frozen=True)
class FileOptions:
    """How files are read and written."""

    layout: str | None = None  # of files that do not say it (`read_motion`)
    rate: float | None = None  # of those that do not say theirs [Hz]
    frames: Frames = (1, None)  # those that are kept
    ground: bool = False  # whether motions are then set on the ground (`set_on_ground`)
    # whether motions are slowed down first where joints are too fast (`retimed`)
    retime: bool = False
    # how far they may change; one that changed by more is written as well
    at_most: AtMost = ANY_CHANGE

    def certified(self) -> dict:
        """What a certificate has of them."""
        kept = list(self.frames)
        return {
            "layout": self.layout,
            "rate": self.rate,
            "frames": kept,
            "ground": self.ground,
            "retime": self.retime,
        }


class FileCleaner:
    """Cleans files of motions of one robot, one after the other."""

    def __init__(
        self,
        robot: str,
        parameters: CleaningParameters | None = None,
        options: FileOptions | None = None,
    ) -> None:
        """
        Args:
            robot, parameters: as of `clean_file`.
            options: of all files.

        Raises:
            ModelError: as `clean_file`.
        """
        self._options = options or FileOptions()
        self._robot = WholeBody(load_robot_description(robot).without_ground())
        self._options.at_most.check(self._robot)
        self._outline = None
        if self._options.ground:
            self._outline = Outline(self._robot)
            check_feet(self._outline, self._robot.description.name)
        self._cleaner = MotionCleaner(
            self._robot,
            parameters or CleaningParameters(),
            retime=self._options.retime,
        )

    def __call__(
        self,
        reference: Path,
        out: Path,
        progress: Callable[[int, int], None] | None = None,
    ) -> list[CleanedClip]:
        """Cleans a file; see `clean_file`."""
        options = self._options
        _check_places(reference, out, options)
        motions = read_motions(
            reference, options.layout, options.rate, robot=self._robot
        )
        motions = [trimmed(motion, options.frames) for motion in motions]
        for motion in motions:
            _check_units(motion, self._robot, options.frames[0])
        return self._cleaner.clean(
            motions,
            out,
            reference=reference,
            layout=motions[0].layout,
            options=options.certified(),
            ground=self._outline,
            at_most=options.at_most,
            progress=progress,
        )


def _check_units(motion: RobotMotion, robot: WholeBody, first: int) -> None:
    """Raises MotionError where a joint is beyond a limit by more than a turn, or as
    many metres: a motion at its limits is not what was meant.

    Args:
        motion: with its joints in the robot's order.
        first: the number of its first frame in the file.
    """
    q = motion.joint_positions
    beyond = np.maximum(robot.lower - q, q - robot.upper)
    frame, joint = np.unravel_index(beyond.argmax(), beyond.shape)
    if beyond[frame, joint] > 2.0 * np.pi:
        raise MotionError(
            f"{motion.source}: {robot.joint_names[joint]} is at {q[frame, joint]:.1f} "
            f"in frame {first + frame}, its limits are {robot.lower[joint]:.2f} and "
            f"{robot.upper[joint]:.2f} [rad, m]: is the file in degrees or millimetres?"
        )


def _check_places(reference: Path, out: Path, options: FileOptions) -> None:
    if options.layout:
        layout_named(options.layout)
    check_file(out)
    check_certificate_place(out)
    if out.exists() and reference.exists() and os.path.samefile(reference, out):
        raise MotionError(f"{out}: is the reference itself; name another file")


class MotionCleaner:
    """Cleans motions of one robot, and writes them with their certificates.

    Attributes:
        uncovered: what certificates do not cover, and the robot's meshes.
    """

    def __init__(
        self,
        robot: WholeBody,
        parameters: CleaningParameters,
        part_meshes: bool = True,
        retime: bool = False,
    ) -> None:
        """
        Args:
            robot: that moves.
            parameters: what changing the least means, and what is kept.
            part_meshes: whether meshes that touch are parted; else that was tried
                before.
            retime: as of `FileOptions`.

        Raises:
            ModelError: as `Cleaner`.
        """
        self._retime = retime
        self._robot, self._parameters = robot, parameters
        self.uncovered, self._carrying = Uncovered(robot), CarryingHands(robot)
        self._outline = Outline(robot)
        self._part_meshes = part_meshes
        self._cleaners: dict[float, Cleaner] = {}

    def _of_rate(self, rate: float) -> Cleaner:
        if rate not in self._cleaners:
            description = self._robot.description
            self._cleaners[rate] = Cleaner(
                description, rate, self._parameters, self.uncovered
            )
        return self._cleaners[rate]

    def clean(
        self,
        motions: Sequence[RobotMotion],
        out: Path,
        *,
        reference: Path,
        layout: str,
        options: dict,
        ground: Outline | None = None,
        at_most: AtMost = ANY_CHANGE,
        judged: Judged | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> list[CleanedClip]:
        """Cleans motions, and writes them and their certificate, or neither.

        Args:
            motions: with their joints in the robot's order.
            out: to be written.
            reference: the file that they are from.
            layout: of the file to be written.
            options: what the certificate says of how they were read.
            ground: of the robot, if motions are to be set on the ground.
            at_most: how far they may change.
            judged: what is wrong with a motion that is of no reference; by default what
                the reference has, too, is left as it was.
            progress: as of `clean_file`.

        Raises:
            ModelError, MotionError, WriteError: as `clean_file`.
        """
        written, seconds, raised = [], [], []
        given = motions
        if self._retime:
            motions = [retimed(motion, self._slower(motion)) for motion in motions]
        for motion in motions:
            kept, took = self._cleaned(motion, progress)
            rise = 0.0
            if ground is not None:
                kept, rise = set_on_ground(kept, ground)
            written.append(kept)
            seconds.append(took)
            raised.append(rise)
        robot, to, place = self._robot, LAYOUTS[layout], certificate_path(out)
        # Where the file says it, each motion may have another.
        rate_given = None if to.has_rate else written[0].rate
        with whole_set(out.parent, last=place.name) as folder:
            write_motions(folder / out.name, written, to.name, robot)
            # What is certified is what stands in the file, rounded as its layout does.
            names = robot.breadth_first if to.breadth_first else robot.joint_names
            again = read_motions(
                folder / out.name, to.name, rate_given, names, robot=robot
            )
            clips, rows = [], []
            for first, before, after, took, rise in zip(
                given, motions, again, seconds, raised, strict=True
            ):
                cleaner = self._of_rate(after.rate)
                margins = [_margins(motion, cleaner) for motion in (before, after)]
                meshes, kept = self.uncovered.look_at(after), margins[1]
                if meshes is not None:
                    kept = cleaner.by_shapes.margins(_controlled(after, cleaner))
                up = before.root_positions + [0.0, 0.0, rise]
                raised_before = replace(before, root_positions=up)
                if judged is None:
                    both = (self._faults(m) for m in (raised_before, after))
                    faults, left = left_as_it_was(*both)
                else:
                    faults, left = list(judged(after)), []
                unclear = _unclear(margins[1])
                excused = unclear & ~_unclear(kept)
                of_clip = after.clip, after.rate, margins[1], meshes, excused
                clips.append(CertifiedClip(*of_clip, faults, left))
                of_row = raised_before, after, [*margins, kept], meshes, cleaner
                row = _row(*of_row, robot, self.uncovered.by_shapes)
                slowed = before.duration - first.duration
                row = replace(
                    row,
                    seconds=took,
                    raised=rise,
                    slowed=slowed,
                    faults="; ".join(map(str, faults)),
                    left="; ".join(map(str, left)),
                )
                rows.append(replace(row, exceeded=at_most.exceeded(row)))
            certificate = make_certificate(
                folder / out.name,
                reference,
                robot.description,
                clips,
                self._parameters.floor,
                self.uncovered,
            )
            certificate["parameters"] = asdict(self._parameters)
            read = [motion for motion in given if motion.layout]  # not retargeted
            guessed = list(dict.fromkeys(g for motion in read for g in motion.guesses))
            of_file = {"layout": to.name, "rate": rate_given, "guessed": guessed}
            certificate["motion"] |= of_file
            certificate["options"] = options
            write_certificate(folder / place.name, certificate)
        return rows

    def _faults(self, motion: RobotMotion) -> list[Fault]:
        return list(find_faults(motion, self._outline.ground_contact(motion)))

    def _cleaned(
        self, motion: RobotMotion, progress: Callable[[int, int], None] | None
    ) -> tuple[RobotMotion, float]:
        """A motion cleaned, and how long a processor took [s]."""
        cleaner = self._of_rate(motion.rate)
        columns = _columns(motion, cleaner)
        carries = self._carrying.shares(motion, cleaner.hands)
        done = None if progress is None else lambda k: progress(k, motion.num_frames)
        began = time.process_time()
        found = cleaner.clean(
            np.ascontiguousarray(motion.joint_positions[:, columns]),
            motion.root_rotations.as_matrix(),
            carries,
            done,
            self._part_meshes,
        )
        joints = motion.joint_positions.copy()
        joints[:, columns] = found.q
        took = time.process_time() - began
        return replace(motion, joint_positions=joints), took

    def _slower(self, motion: RobotMotion) -> Callable[[RobotMotion], np.ndarray]:
        """What `retimed` asks for."""
        cleaner = self._of_rate(motion.rate)
        columns, fastest = _columns(motion, cleaner), cleaner.fastest

        def slower(motion: RobotMotion) -> np.ndarray:
            steps = np.abs(np.diff(motion.joint_positions[:, columns], axis=0))
            return (steps / fastest).max(axis=1)

        return slower


def _columns(motion: RobotMotion, cleaner: Cleaner) -> list[int]:
    """Where the joints that are controlled stand in a motion's.

    Raises:
        MotionError: the motion moves joints that the robot does not control, so that
            distances would not be those of the motion.
    """
    others = sorted(set(motion.joint_names) - set(cleaner.model.joint_names))
    if others:
        raise MotionError(
            f"{motion.source}: robot {cleaner.description.name} does not control "
            f"{', '.join(others[:5])}: import it with --whole-body, or take these out "
            "of its prescribed_joints"
        )
    return [motion.joint_names.index(name) for name in cleaner.model.joint_names]


def _margins(motion: RobotMotion, cleaner: Cleaner) -> Margins:
    return cleaner.margins(_controlled(motion, cleaner))


def _controlled(motion: RobotMotion, cleaner: Cleaner) -> np.ndarray:
    """(T, n) its joints, in the cleaner's order [rad or m]."""
    return np.ascontiguousarray(motion.joint_positions[:, _columns(motion, cleaner)])


def _row(
    before: RobotMotion,
    after: RobotMotion,
    margins: list[Margins],
    meshes: MeshClearance | None,
    cleaner: Cleaner,
    robot: WholeBody,
    by_shapes: Sequence[Sequence[str]],
) -> CleanedClip:
    change = after.joint_positions - before.joint_positions
    was, now, kept = margins
    return CleanedClip(
        clip=after.clip,
        frames=after.num_frames,
        rate=after.rate,
        penetrating_before=_count(was.distance < 0.0),
        penetrating=_count(kept.distance < 0.0),
        unclear=_count(_unclear(kept)),
        beyond_limit_before=_count(was.limit < -LIMIT_TOLERANCE),
        beyond_limit=_count(now.limit < -LIMIT_TOLERANCE),
        too_fast_before=_count(was.speed > 1.0 + 1e-6),
        too_fast=_count(now.speed > 1.0 + 1e-6),
        nearest_before=float(was.distance.min()),
        nearest=float(now.distance.min()),
        between=float(now.between.min()),
        changed=_count(np.abs(change).max(axis=1) > _CHANGED),
        **asdict(find_change(before, after, robot)),
        near=_count(
            (kept.distance < cleaner.parameters.floor)
            | (kept.between < cleaner.parameters.floor_between)
        ),
        frozen=_count(find_frozen(before, after)),
        meshes_penetrating=-1 if meshes is None else meshes.num_touching,
        meshes_unclear=-1 if meshes is None else meshes.num_unclear,
        deepest=_deepest(kept, by_shapes),
        guessed="; ".join(before.guesses),
    )


def _unclear(margins: Margins) -> np.ndarray:
    """(T,) frames in which shapes penetrate, or are not shown to be clear on the way to
    the next."""
    return (margins.distance < 0.0) | ~(margins.between >= 0.0)


def _deepest(margins: Margins, pairs: Sequence[Sequence[str]]) -> str:
    frame = int(margins.distance.argmin())
    depth = -margins.distance[frame]
    if not depth > 0.0:
        return ""
    a, b = pairs[margins.pair[frame]]
    return f"frame {frame + 1}: {a} - {b}, {1e3 * depth:.1f} mm deep"


def _count(frames: np.ndarray) -> int:
    return int(np.sum(frames))
