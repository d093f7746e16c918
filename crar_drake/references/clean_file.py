"""One file of reference motions in, a cleaned one of the same layout out."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.files import check_file, whole_set
from crar_drake.references.change import Change, find_change, find_frozen
from crar_drake.references.cleaning import Cleaner, CleaningParameters
from crar_drake.references.ground_contact import CarryingHands
from crar_drake.references.layouts import LAYOUTS
from crar_drake.references.mesh_clearance import MeshClearance
from crar_drake.references.motion_certificate import (
    CertifiedClip,
    certificate_path,
    check_certificate_place,
    make_certificate,
    write_certificate,
)
from crar_drake.references.motion_files import read_motions, write_motions
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.uncovered import Uncovered
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import LIMIT_TOLERANCE, load_robot_description
from crar_drake.trajectory.margins import Margins

# A frame counts as changed if a joint is farther from the reference [rad or m].
_CHANGED = 1e-6


@dataclass(frozen=True)
class CleanedClip(Change):
    """What cleaning made of one motion, with how far it changed.

    Attributes:
        clip: its name; "" in files with one motion.
        frames: T.
        rate: [Hz].
        penetrating_before, penetrating: frames with watched capsules in penetration.
        beyond_limit_before, beyond_limit: frames with a joint beyond its limit.
        too_fast_before, too_fast: frames from which a joint goes on beyond its speed
            limit.
        nearest_before, nearest: the smallest distance of watched capsules [m].
        between: no distance on the straight ways between frames is smaller [m].
        changed: frames with a joint that is not where the reference has it.
        near: frames that keep less than the floor, at them or on the way to the next;
            those that penetrate among them.
        frozen: frames that stand still on the way to the next while the reference
            moves.
        meshes_penetrating: frames in which meshes penetrate, those of links that nobody
            watches among them; -1 where there are none to be looked at.
        meshes_unclear: ways to the next frame on which meshes touch, or are not shown
            to be clear; -1 as well.
        seconds: of a processor that cleaning took, asking and parting meshes with it,
            without reading, writing and measuring [s].
        deepest: frame and pair of the deepest penetration, in words; "" without one.
    """

    clip: str
    frames: int
    rate: float
    penetrating_before: int
    penetrating: int
    beyond_limit_before: int
    beyond_limit: int
    too_fast_before: int
    too_fast: int
    nearest_before: float
    nearest: float
    between: float
    changed: int
    near: int
    frozen: int
    meshes_penetrating: int
    meshes_unclear: int
    seconds: float
    deepest: str

    @property
    def times_real_time(self) -> float:
        """How much faster than the motion itself it was cleaned, on one core."""
        return (self.frames - 1) / self.rate / self.seconds if self.seconds else 0.0

    @property
    def violated(self) -> bool:
        """Whether anything is left, or a way between frames not shown to be clear."""
        left = self.penetrating or self.beyond_limit or self.too_fast
        meshes = self.meshes_penetrating > 0 or self.meshes_unclear > 0
        return bool(left or meshes) or not self.between >= 0.0


# What is a number, those of the change last; and whether it is a whole one.
_CHANGE = tuple(field.name for field in fields(Change))
_WHOLE = {field.name: field.type == "int" for field in fields(CleanedClip)}
_TEXTS = ("clip", "deepest")
NUMBERS = (*(name for name in _WHOLE if name not in (*_TEXTS, *_CHANGE)), *_CHANGE)


def number_from(name: str, text: str) -> float:
    """What a table has of one of NUMBERS; ValueError if that is no such number."""
    return int(text) if _WHOLE[name] else float(text)


def clean_file(
    reference: str | os.PathLike[str],
    out: str | os.PathLike[str],
    robot: str,
    parameters: CleaningParameters | None = None,
    *,
    layout: str | None = None,
    rate: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[CleanedClip]:
    """Cleans all motions of a file, and writes them and their certificate, or neither.

    Args:
        reference: the file.
        out: to be written, in the same layout.
        robot: name or folder of the robot.
        parameters: what changing the least means, and what is kept.
        layout, rate: of the file, where it does not say them (`read_motion`).
        progress: is called with the frame that was reached, and of how many.

    Raises:
        MotionError: the file cannot be read, or is of another robot.
        ModelError: the robot is not there, or not one that can be cleaned for.
        WriteError: the file or its certificate cannot be written.
        CrarError: the certificate would take the place of another file's.
    """
    reference, out = Path(reference), Path(out)
    check_file(out)
    check_certificate_place(out)
    if out.exists() and reference.exists() and os.path.samefile(reference, out):
        raise MotionError(f"{out}: is the reference itself; name another file")
    description = load_robot_description(robot).without_ground()
    whole_body = WholeBody(description)
    motions = read_motions(reference, layout, rate, robot=whole_body)
    return clean_motions(
        motions,
        out,
        whole_body,
        parameters or CleaningParameters(),
        reference=reference,
        layout=motions[0].layout,
        options={"layout": layout, "rate": rate},
        progress=progress,
    )


def clean_motions(
    motions: Sequence[RobotMotion],
    out: Path,
    robot: WholeBody,
    parameters: CleaningParameters,
    *,
    reference: Path,
    layout: str,
    options: dict,
    progress: Callable[[int, int], None] | None = None,
    uncovered: Uncovered | None = None,
    part_meshes: bool = True,
) -> list[CleanedClip]:
    """Cleans motions, and writes them and their certificate, or neither.

    Args:
        motions: with their joints in the robot's order.
        out: to be written.
        robot: that moves.
        parameters: what changing the least means, and what is kept.
        reference: the file that they are from.
        layout: of the file to be written.
        options: what the certificate says of how they were read.
        progress: as of `clean_file`.
        uncovered: of the robot, if it is known.
        part_meshes: whether meshes that touch are parted; else that was tried before.

    Raises:
        ModelError, MotionError, WriteError: as `clean_file`.
    """
    description, uncovered = robot.description, uncovered or Uncovered(robot)
    carrying, meshes = CarryingHands(robot), uncovered.meshes if part_meshes else None
    cleaners: dict[float, Cleaner] = {}
    written, seconds = [], []
    for motion in motions:
        if motion.rate not in cleaners:
            cleaners[motion.rate] = Cleaner(
                description, motion.rate, parameters, meshes
            )
        cleaner = cleaners[motion.rate]
        columns = _columns(motion, cleaner)
        began = time.process_time()
        found = cleaner.clean(
            np.ascontiguousarray(motion.joint_positions[:, columns]),
            motion.root_rotations.as_matrix(),
            carrying.shares(motion, cleaner.hands),
            None
            if progress is None
            else lambda k, total=motion.num_frames: progress(k, total),
        )
        seconds.append(time.process_time() - began)
        joints = motion.joint_positions.copy()
        joints[:, columns] = found.q
        written.append(replace(motion, joint_positions=joints))
    to = LAYOUTS[layout]
    # Where the file says it, each motion may have another.
    rate_given = None if to.has_rate else written[0].rate
    place = certificate_path(out)
    with whole_set(out.parent, last=place.name) as folder:
        write_motions(folder / out.name, written, to.name, robot)
        # What is certified is what stands in the file, rounded as its layout does.
        again = read_motions(folder / out.name, to.name, rate_given, robot=robot)
        clips, rows = [], []
        for before, after, took in zip(motions, again, seconds, strict=True):
            cleaner = cleaners[after.rate]
            margins = [_margins(motion, cleaner) for motion in (before, after)]
            meshes = uncovered.look_at(after)
            clips.append(CertifiedClip(after.clip, after.rate, margins[1], meshes))
            rows.append(_row(before, after, margins, meshes, took, cleaner, robot))
        certificate = make_certificate(
            folder / out.name,
            reference,
            description,
            clips,
            parameters.floor,
            uncovered,
        )
        certificate["parameters"] = asdict(parameters)
        certificate["motion"] |= {"layout": to.name, "rate": rate_given}
        certificate["options"] = options
        write_certificate(folder / place.name, certificate)
    return rows


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
    q = np.ascontiguousarray(motion.joint_positions[:, _columns(motion, cleaner)])
    return cleaner.margins(q)


def _row(
    before: RobotMotion,
    after: RobotMotion,
    margins: list[Margins],
    meshes: MeshClearance | None,
    seconds: float,
    cleaner: Cleaner,
    robot: WholeBody,
) -> CleanedClip:
    change = after.joint_positions - before.joint_positions
    was, now = margins
    return CleanedClip(
        clip=after.clip,
        frames=after.num_frames,
        rate=after.rate,
        penetrating_before=_count(was.distance < 0.0),
        penetrating=_count(now.distance < 0.0),
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
            (now.distance < cleaner.parameters.floor)
            | (now.between < cleaner.parameters.floor_between)
        ),
        frozen=_count(find_frozen(before, after)),
        meshes_penetrating=-1 if meshes is None else meshes.num_touching,
        meshes_unclear=-1 if meshes is None else meshes.num_unclear,
        seconds=seconds,
        deepest=_deepest(now, cleaner),
    )


def _deepest(margins: Margins, cleaner: Cleaner) -> str:
    frame = int(margins.distance.argmin())
    depth = -margins.distance[frame]
    if not depth > 0.0:
        return ""
    a, b = cleaner.description.pairs[margins.pair[frame]]
    return f"frame {frame + 1}: {a} - {b}, {1e3 * depth:.1f} mm deep"


def _count(frames: np.ndarray) -> int:
    return int(np.sum(frames))
