"""Files in, certified files out, one way for motions that are cleaned or retargeted.

A source is *read*, its *problem* is *solved*; then what stands in the written file is
*measured*, and *written* are both, the motion and its certificate, or neither.
"""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from crar_drake.errors import CrarError, MotionError
from crar_drake.files import check_file, whole_set
from crar_drake.references.certificate_files import (
    certificate_path,
    read_certificate,
    write_certificate,
)
from crar_drake.references.cleaning import Cleaner, CleaningParameters
from crar_drake.references.contacts import contacts_path, remove_beside
from crar_drake.references.faults import Fault
from crar_drake.references.folder_page import Figure
from crar_drake.references.ground_contact import Outline
from crar_drake.references.layouts import LAYOUTS
from crar_drake.references.motion_certificate import certified_clip, make_certificate
from crar_drake.references.motion_files import read_motions, write_motions
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.uncovered import Uncovered
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import LIMIT_TOLERANCE, SPEED_TOLERANCE
from crar_drake.trajectory.margins import Margins

# Is called with the frame that was reached, and of how many.
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class WrittenClip:
    """What holds of a motion that was written."""

    clip: str  # its name; "" in files with one motion
    frames: int  # T
    rate: float  # [Hz]
    # frames with watched capsules in penetration, of pairs of which meshes do not
    # decide
    penetrating: int
    # frames in which these do, or are not shown to be clear on the way to the next
    unclear: int
    beyond_limit: int  # frames with a joint beyond its limit
    too_fast: int  # frames from which a joint goes on beyond its speed limit
    nearest: float  # the smallest distance of watched capsules [m]
    between: float  # no distance on the straight ways between frames is smaller [m]
    # frames that keep less than the floor, at them or on the way to the next, of pairs
    # of which meshes do not decide; those that penetrate among them
    near: int
    # frames in which meshes penetrate, those of links that nobody watches among them;
    # -1 where there are none to be looked at
    meshes_penetrating: int
    # ways to the next frame on which meshes touch, or are not shown to be clear; -1 as
    # well
    meshes_unclear: int
    seconds: float  # of a processor that it took [s]
    # frame and pair of the deepest penetration, in words; "" without one
    deepest: str
    faults: str  # what else is wrong with it, in words; "" if nothing is
    # what the file did not say and was guessed, in words; of a person's file how it was
    # read, and what looks bad in it
    guessed: str

    # in words, where that can be: what its reference had, too, and was left as it was,
    # and what changed by more than was allowed
    left: ClassVar[str] = ""
    exceeded: ClassVar[str] = ""

    @property
    def times_real_time(self) -> float:
        """How much faster than the motion itself it was made, on one core."""
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


# What the page of a folder shows of them.
FIGURES = (
    Figure("frames", lambda c: c.frames),
    Figure("capsules penetrate in", lambda c: c.penetrating, bad=True),
    Figure("meshes in", lambda c: max(c.meshes_penetrating, 0), bad=True),
    Figure("ways not clear", lambda c: max(c.meshes_unclear, 0), bad=True),
    Figure("beyond limits in", lambda c: c.beyond_limit, bad=True),
    Figure("too fast in", lambda c: c.too_fast, bad=True),
    Figure("nearest [mm]", lambda c: 1e3 * c.nearest, 1),
    Figure("x real time", lambda c: c.times_real_time, 1),
)


class Operation(ABC):
    """What is done with files, in which way: all that another process is told.

    Attributes:
        robot: name or folder of the robot.
        parameters: of cleaning.
        layout: of what is written; None: that of the source.
        table: name of the CSV of a folder, with a `record` for each motion.
        figures: what its page shows; the first says which motion is the worst.
    """

    robot: str
    parameters: CleaningParameters
    layout: str | None
    table: ClassVar[str]
    record: ClassVar[type[WrittenClip]]
    figures: ClassVar[Sequence[Figure]]

    @abstractmethod
    def begin(self) -> Pipeline:
        """What works on one file after the other.

        Raises:
            ModelError: the robot is not there, or lacks something.
        """

    @abstractmethod
    def sources(self, folder: Path) -> list[Path]:
        """Files in a folder and below on which it can work, in order of their names.

        Raises:
            CrarError: there is none.
            MotionError, ScenarioError: an option is none.
        """

    @abstractmethod
    def options(self, source: str | os.PathLike[str]) -> dict:
        """What a certificate has of them, of one file."""

    def files(self, source: Any) -> list[Path]:
        """The file that a motion is in, and those that are read with it."""
        return [Path(source)]

    def place(self, path: Path) -> Path:
        """What is made of a file of that name is called so."""
        return path

    def note(self, clip: Any) -> str:
        """What else a folder's page says of a motion."""
        return clip.deepest

    def again(self, clip: Any) -> Any:
        """What becomes of a record that is kept of a file that is not done again."""
        return clip


@dataclass(frozen=True)
class Solved:
    """A motion that was solved, and is not yet written."""

    motion: RobotMotion  # with its joints in the robot's order


@dataclass(frozen=True)
class Judged:
    """What is found of a motion that was written."""

    faults: Sequence[Fault]  # what is wrong with it besides,
    left: Sequence[Fault]  # and what was so before, and left as it was
    more: dict[str, Any]  # of its `record`, beside what holds of any `WrittenClip`


class Pipeline(ABC):
    """Works on files for one robot, one after the other.

    Attributes:
        operation: what is done.
        robot: that moves.
        outline: of the robot.
        uncovered: what certificates do not cover, and the robot's meshes.
        part_meshes: whether meshes that touch are parted when a motion is cleaned; else
            that was tried before.
    """

    part_meshes = True

    def __init__(self, operation: Operation, robot: WholeBody) -> None:
        """
        Raises:
            ModelError: a mesh cannot be read.
        """
        self.operation, self.robot, self.outline = operation, robot, Outline(robot)
        self.uncovered = Uncovered(robot)
        self._cleaners: dict[float, Cleaner] = {}

    @abstractmethod
    def solve(self, source: Any, progress: Progress | None) -> Sequence[Solved]:
        """Reads the motions of a file, and solves their problems."""

    @abstractmethod
    def judge(self, solved: Any, written: RobotMotion) -> Judged:
        """What is wrong with a motion besides collisions and limits.

        Args:
            solved: as `solve` made it.
            written: as it stands in the file.
        """

    def __call__(
        self, source: Any, out: Path, progress: Progress | None = None
    ) -> list[Any]:
        """Works on a file, and writes what is made of it and its certificate, or
        neither.

        Returns:
            A `record` for each of its motions.

        Raises:
            ModelError, MotionError, WriteError: as of `clean_file`, `retarget_file`.
        """
        check_place(out, source)
        solved = self.solve(source, progress)
        robot, place, records, clips = self.robot, certificate_path(out), [], []
        to = LAYOUTS[self.operation.layout or solved[0].motion.layout]
        # Where the file says it, each motion may have another.
        rate = None if to.has_rate else solved[0].motion.rate
        with whole_set(out.parent, last=place.name) as folder:
            file = folder / out.name
            write_motions(file, [each.motion for each in solved], to.name, robot)
            # What is certified is what stands in the file, rounded as its layout does.
            names = robot.breadth_first if to.breadth_first else robot.joint_names
            again = read_motions(file, to.name, rate, names, robot=robot)
            for each, written in zip(solved, again, strict=True):
                record, clip = self._measured(each, written)
                records.append(record)
                clips.append(clip)
            read = [s.motion for s in solved if s.motion.layout]  # not retargeted
            guessed = list(dict.fromkeys(g for motion in read for g in motion.guesses))
            certificate = make_certificate(
                file,
                self.operation.files(source)[0],
                clips,
                self.uncovered,
                self.operation.parameters,
                {"layout": to.name, "rate": rate, "guessed": guessed},
                self.operation.options(source),
            )
            write_certificate(folder / place.name, certificate)
            labelled = contacts_path(file).exists()
        if not labelled:
            remove_beside(out)
        return records

    def _measured(
        self, solved: Solved, written: RobotMotion
    ) -> tuple[WrittenClip, dict]:
        """What holds of a motion in the file, for the user and for its certificate."""
        cleaner = self.cleaner(written.rate)
        q = cleaner.controlled(written)
        now = kept = cleaner.keeper.margins(q)
        meshes = self.uncovered.meshes
        if meshes is not None:
            meshes = meshes.find(written.joint_positions)
            kept = cleaner.by_shapes.margins(q)
        excused = _unclear(now) & ~_unclear(kept)
        judged, p = self.judge(solved, written), cleaner.parameters
        near = (kept.distance < p.floor) | (kept.between < p.floor_between)
        certified = certified_clip(
            *(written, now, meshes, excused, judged.faults, judged.left),
            self.robot.description.pairs,
        )
        record = self.operation.record(
            clip=written.clip,
            frames=written.num_frames,
            rate=written.rate,
            penetrating=np.count_nonzero(kept.distance < 0.0),
            unclear=np.count_nonzero(_unclear(kept)),
            beyond_limit=np.count_nonzero(now.limit < -LIMIT_TOLERANCE),
            too_fast=np.count_nonzero(now.speed > 1.0 + SPEED_TOLERANCE),
            nearest=float(now.distance.min()),
            between=float(now.between.min()),
            near=np.count_nonzero(near),
            meshes_penetrating=-1 if meshes is None else meshes.num_touching,
            meshes_unclear=-1 if meshes is None else meshes.num_unclear,
            deepest=_deepest(kept, self.uncovered.by_shapes),
            faults="; ".join(map(str, judged.faults)),
            guessed="; ".join(solved.motion.guesses),
            **judged.more,
        )
        return record, certified

    def cleaner(self, rate: float) -> Cleaner:
        """Of motions of so many frames per second [Hz].

        Raises:
            ModelError, ScenarioError: as `Cleaner`.
        """
        if rate not in self._cleaners:
            of = self.robot.description, rate, self.operation.parameters, self.uncovered
            self._cleaners[rate] = Cleaner(*of)
        return self._cleaners[rate]

    def cleaned(
        self, motion: RobotMotion, progress: Progress | None = None
    ) -> tuple[RobotMotion, float]:
        """A motion cleaned, and how long a processor took [s]."""
        cleaner = self.cleaner(motion.rate)
        carries = self.outline.carrying(motion, cleaner.hands)
        done = None if progress is None else lambda k: progress(k, motion.num_frames)
        began = time.process_time()
        found = cleaner.clean(
            cleaner.controlled(motion),
            motion.root_rotations.as_matrix(),
            carries,
            done,
            self.part_meshes,
        )
        joints = motion.joint_positions.copy()
        joints[:, cleaner.columns(motion)] = found.q
        took = time.process_time() - began
        return replace(motion, joint_positions=joints), took


def check_place(out: Path, source: str | os.PathLike[str]) -> None:
    """Asks whether a motion and its certificate can be written, before long work.

    Raises:
        WriteError: one of them cannot.
        CrarError: the certificate would take the place of another file's: dance.csv
            and dance.npz in one folder would have one.
        MotionError: it is the source itself.
    """
    place = certificate_path(out)
    check_file(out)
    check_file(place)
    try:
        other = read_certificate(place)["motion"]["file"]
    except CrarError:
        other = out.name  # none of a motion: it is replaced
    if other != out.name and (out.parent / other).is_file():
        raise CrarError(
            f"{out}: {place.name} beside it is the certificate of {other}; write to "
            "another name or folder"
        )
    if out.exists() and os.path.exists(source) and os.path.samefile(source, out):
        raise MotionError(f"{out}: is the reference itself; name another file")


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
