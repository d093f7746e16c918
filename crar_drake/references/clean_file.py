"""Files of reference motions in, cleaned ones of the same layout out."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, replace
from math import degrees, nan
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from crar_drake.errors import ModelError, MotionError
from crar_drake.references.certificate_files import file_hash
from crar_drake.references.change import AtMost, Change, find_change, find_frozen
from crar_drake.references.cleaning import CleaningParameters
from crar_drake.references.contacts import contacts_path
from crar_drake.references.faults import find_faults, left_as_it_was
from crar_drake.references.folder_page import Figure
from crar_drake.references.folders import find_references
from crar_drake.references.ground_contact import FEET, Outline
from crar_drake.references.layouts import layout_named
from crar_drake.references.motion_files import read_motions
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
from crar_drake.references.resampling import retimed
from crar_drake.references.robot_motion import (
    Frames,
    RobotMotion,
    has_rows,
    trimmed,
)
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import (
    LIMIT_TOLERANCE,
    SPEED_TOLERANCE,
    load_robot_description,
)

# A frame counts as changed if a joint is farther from the reference [rad or m].
_CHANGED = 1e-6
# A floor that is as near to z = 0 is there: what files round moves it by less [m].
_ON_THE_GROUND = 1e-5
# How keys of positions in the world end, such as those of an object.
_IN_WORLD = "_pos_w"


@dataclass(frozen=True, kw_only=True)
class CleanedClip(WrittenClip, Change):
    """What cleaning made of one motion, with how far it changed; `seconds` are without
    reading, writing and measuring."""

    penetrating_before: int  # as `penetrating`, of all watched capsules, and
    beyond_limit_before: int  # as `beyond_limit`,
    too_fast_before: int  # `too_fast`,
    nearest_before: float  # and `nearest`, of the reference [m]
    changed: int  # frames with a joint that is not where the reference has it
    # frames that stand still on the way to the next while the reference moves
    frozen: int
    # by how much it was set on the ground; 0 if that was not asked for [m]
    raised: float
    slowed: float  # by how much longer it takes; 0 if that was not asked for [s]
    left: str
    exceeded: str = ""


@dataclass(frozen=True)
class CleanOptions(Operation):
    """How files are read, cleaned and written."""

    robot: str  # name or folder
    # what changing the least means, and what is kept
    parameters: CleaningParameters = CleaningParameters()
    layout: str | None = None  # of files that do not say it (`read_motion`)
    rate: float | None = None  # of those that do not say theirs [Hz]
    frames: Frames = (1, None)  # those that are kept
    ground: bool = False  # whether motions are then set on the ground (`set_on_ground`)
    # whether motions are slowed down first where joints are too fast (`retimed`)
    retime: bool = False
    # how far they may change; one that changed by more is written as well, and another
    # `at_most` alone makes no file be cleaned again
    at_most: AtMost = AtMost()

    table: ClassVar = "cleaned.csv"
    record: ClassVar = CleanedClip
    figures: ClassVar = (
        Figure("joints changed, at most [deg]", lambda c: degrees(c.joints_worst), 1),
        Figure("rms [deg]", lambda c: degrees(c.joints_rms), 2),
        Figure("feet, at most [mm]", lambda c: 1e3 * c.feet_worst, 1),
        Figure("hands, at most [mm]", lambda c: 1e3 * c.hands_worst, 1),
        Figure("jerk, after / before", lambda c: c.jerk / (c.jerk_before or nan), 2),
        Figure("capsules penetrated in", lambda c: c.penetrating_before),
        *FIGURES,
    )

    def begin(self) -> FileCleaner:
        """See `Operation`."""
        return FileCleaner(self)

    def sources(self, folder: Path) -> list[Path]:
        """See `Operation`."""
        if self.layout:
            layout_named(self.layout)
        self.parameters.validate()
        return find_references(folder)

    def options(self, source: str | os.PathLike[str]) -> dict:
        """See `Operation`; with the hash of labels beside the file, if there are."""
        labels = contacts_path(Path(source))
        return {
            **({"labels": file_hash(labels)} if labels.is_file() else {}),
            "layout": self.layout,
            "rate": self.rate,
            "frames": list(self.frames),
            "ground": self.ground,
            "retime": self.retime,
        }

    def note(self, clip: CleanedClip) -> str:
        """See `Operation`."""
        return clip.exceeded or clip.deepest

    def again(self, clip: CleanedClip) -> CleanedClip:
        """See `Operation`."""
        return replace(clip, exceeded=self.at_most.exceeded(clip))


def clean_file(
    reference: str | os.PathLike[str],
    out: str | os.PathLike[str],
    robot: str,
    parameters: CleaningParameters | None = None,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> list[CleanedClip]:
    """Cleans all motions of a file, and writes them and their certificate, or neither.

    Args:
        reference: the file.
        out: to be written, in the same layout.
        robot, parameters, options: see `CleanOptions`.
        progress: is called with the frame that was reached, and of how many.

    Raises:
        MotionError: the file cannot be read, is of another robot or of no known layout,
            ends before the frames that are kept, or a joint is beyond its limits by
            more than a turn.
        ModelError: the robot is not there, not one that can be cleaned for, or lacks
            what an option asks for.
        WriteError: the file or its certificate cannot be written.
        CrarError: the certificate would take the place of another file's.
    """
    given = CleanOptions(robot, parameters or CleaningParameters(), **options)
    if given.layout:
        layout_named(given.layout)
    reference, out = Path(reference), Path(out)
    check_place(out, reference)
    return FileCleaner(given)(reference, out, progress)


@dataclass(frozen=True)
class _Cleaned(Solved):
    before: RobotMotion  # raised and slowed down alike
    seconds: float  # that cleaning took
    raised: float
    slowed: float


class FileCleaner(Pipeline):
    """Cleans files of motions of one robot, one after the other; see `clean_file`."""

    def __init__(self, options: CleanOptions) -> None:
        """
        Raises:
            ModelError: as `clean_file`.
        """
        robot = WholeBody(load_robot_description(options.robot).without_ground())
        options.at_most.check(robot)
        super().__init__(options, robot)
        if options.ground and not self.outline.feet:
            raise ModelError(
                f"robot {robot.description.name}: no foot has a shape, so that nothing "
                f"says where its floor is; add task_frames {' and '.join(FEET)} to its "
                "robot.yaml, or leave --ground away"
            )

    def solve(self, source: Path, progress: Progress | None) -> list[_Cleaned]:
        """See `Pipeline`."""
        options: CleanOptions = self.operation
        motions = read_motions(source, options.layout, options.rate, robot=self.robot)
        motions = [trimmed(motion, options.frames) for motion in motions]
        for motion in motions:
            _check_units(motion, self.robot, options.frames[0])
        found = []
        for given in motions:
            before, rise = given, 0.0
            if options.retime:
                before = retimed(given, self._slower)
            motion, seconds = self.cleaned(before, progress)
            if options.ground:
                motion, rise = set_on_ground(motion, self.outline)
            slowed = before.duration - given.duration
            up = before.root_positions + [0.0, 0.0, rise]
            before = replace(before, root_positions=up)
            found.append(_Cleaned(motion, before, seconds, rise, slowed))
        return found

    def judge(self, solved: _Cleaned, written: RobotMotion) -> Judged:
        """See `Pipeline`; what the reference has, too, is left as it was."""
        before, cleaner = solved.before, self.cleaner(written.rate)
        both = (
            find_faults(motion, self.outline.ground_contact(motion))
            for motion in (before, written)
        )
        faults, left = left_as_it_was(*both)
        was = cleaner.keeper.margins(cleaner.controlled(before))
        moved = np.abs(written.joint_positions - before.joint_positions).max(axis=1)
        change = find_change(before, written, self.robot)
        more = asdict(change) | {
            "seconds": solved.seconds,
            "penetrating_before": np.count_nonzero(was.distance < 0.0),
            "beyond_limit_before": np.count_nonzero(was.limit < -LIMIT_TOLERANCE),
            "too_fast_before": np.count_nonzero(was.speed > 1.0 + SPEED_TOLERANCE),
            "nearest_before": float(was.distance.min()),
            "changed": np.count_nonzero(moved > _CHANGED),
            "frozen": np.count_nonzero(find_frozen(before, written)),
            "raised": solved.raised,
            "slowed": solved.slowed,
            "left": "; ".join(map(str, left)),
            "exceeded": self.operation.at_most.exceeded(change),
        }
        return Judged(faults, left, more)

    def _slower(self, motion: RobotMotion) -> np.ndarray:
        """What `retimed` asks for."""
        cleaner = self.cleaner(motion.rate)
        steps = np.abs(np.diff(cleaner.controlled(motion), axis=0))
        return (steps / cleaner.fastest).max(axis=1)


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


def set_on_ground(motion: RobotMotion, outline: Outline) -> tuple[RobotMotion, float]:
    """The motion with the floor of its feet at z = 0, and by how much it was raised
    [m]; objects whose positions in the world the file has are raised with it.

    Args:
        motion: with its joints in the order of the robot.
        outline: of the robot, with feet.
    """
    rise = -outline.ground_contact(motion).floor
    if abs(rise) < _ON_THE_GROUND:
        return motion, 0.0
    up, extras = np.array([0.0, 0.0, rise]), dict(motion.extras)
    for key, value in extras.items():
        in_world = key.endswith(_IN_WORLD) and has_rows(value, motion.num_frames)
        if in_world and value.shape[-1] == 3:
            extras[key] = (value + up).astype(value.dtype)
    root = motion.root_positions + up
    return replace(motion, root_positions=root, extras=extras, computed={}), rise
