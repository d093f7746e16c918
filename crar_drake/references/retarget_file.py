"""A person's motion in, a robot's reference motion with its certificate out."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.files import check_file
from crar_drake.motion.catalogue import load_performer, motion_file
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import SIDES
from crar_drake.motion.quaternion_spline import sign_continuous
from crar_drake.references.clean_file import CleanedClip, clean_motions
from crar_drake.references.cleaning import CleaningParameters
from crar_drake.references.ground_contact import Outline
from crar_drake.references.layouts import layout_named, layouts_of
from crar_drake.references.mesh_rows import MeshRows
from crar_drake.references.motion_certificate import check_certificate_place
from crar_drake.references.motion_files import read_motion
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.uncovered import Uncovered
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description
from crar_drake.trajectory.performer_targets import LIMBS, PerformerTargets
from crar_drake.trajectory.retargeting import (
    Retargeted,
    Retargeter,
    RetargetingParameters,
)

# Of the layouts that a file can have, those that are taken if none is named.
_LAYOUTS = {".csv": "xyzw-csv", ".npz": "mjlab-npz", ".pkl": "gmr-pkl"}
RATE = 30.0  # [Hz] that most reference motions have


@dataclass(frozen=True)
class RetargetedClip:
    """What became of a person's motion.

    Attributes:
        cleaned: what cleaning the retargeted motion changed, and what it keeps.
        limbs: limb to the angle between its direction and the person's, median and 95 %
            of the frames [rad].
        knees: side to how much more a knee bends than the person's, in the median
            (negative: less), and how far apart they are in 95 % of the frames [rad].
        slip: the longest way that a planted foot slips [m].
        lowest: the lowest point of all links, over the floor [m].
        seconds: of a processor, from the performer to the certified motion, asking and
            parting meshes with it, without their certificate [s].
    """

    cleaned: CleanedClip
    limbs: dict[str, tuple[float, float]]
    knees: dict[str, tuple[float, float]]
    slip: float
    lowest: float
    seconds: float

    @property
    def times_real_time(self) -> float:
        """How much faster than the motion itself, on one core."""
        duration = (self.cleaned.frames - 1) / self.cleaned.rate
        return duration / self.seconds if self.seconds else 0.0


def retarget_file(
    motion: str | os.PathLike[str],
    out: str | os.PathLike[str],
    robot: str,
    *,
    options: MotionOptions | None = None,
    layout: str | None = None,
    rate: float = RATE,
    parameters: RetargetingParameters | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RetargetedClip:
    """Retargets a person's motion, and writes it and its certificate, or neither.

    Args:
        motion: a file, `cmu:` and a trial, or a built-in name.
        out: to be written.
        robot: name or folder of a robot with legs, imported as a whole body.
        options: what is known of the motion beyond its file.
        layout: of `out`; by default the usual one of its suffix.
        rate: frames per second of `out` [Hz].
        parameters: what is wanted.
        progress: is called with the frame that was reached, and of how many.

    Raises:
        MotionError: the motion cannot be read, or lacks something that a whole body
            needs; `out` can be of no layout.
        ModelError: the robot is not there, or lacks something.
        WriteError, CrarError: as of `clean_file`.
    """
    out = Path(out)
    check_file(out)
    check_certificate_place(out)
    layout = layout or _LAYOUTS.get(out.suffix.lower(), "")
    if not layout or layout_named(layout).name not in layouts_of(out):
        raise MotionError(
            f"{out}: a reference motion is a .csv, .npz or .pkl"
            + (f", and not of layout {layout}" if layout else "")
        )
    performer = load_performer(motion, options)
    description = load_robot_description(robot).without_ground()
    whole_body = WholeBody(description)
    uncovered = Uncovered(whole_body)
    retargeter = Retargeter(description, parameters)
    meshes = uncovered.meshes
    frames = int(performer.duration * rate) + 1
    began = time.process_time()
    found = retargeter.retarget(
        performer,
        rate,
        None if progress is None else lambda k: progress(k, frames),
        None if meshes is None else MeshRows(meshes, retargeter.model.joint_names),
    )
    seconds = time.process_time() - began
    quaternions = Rotation.from_matrix(found.root_rotations).as_quat()
    names = retargeter.model.joint_names
    made = RobotMotion(
        joint_names=whole_body.joint_names,
        root_positions=found.root_positions,
        root_quaternions=sign_continuous(quaternions)[:, [3, 0, 1, 2]],
        joint_positions=found.q[:, [names.index(x) for x in whole_body.joint_names]],
        rate=rate,
    )
    (cleaned,) = clean_motions(
        [made],
        out,
        whole_body,
        CleaningParameters(),
        reference=motion_file(motion, options),
        layout=layout,
        options={"retargeted": str(motion), "rate": rate},
        uncovered=uncovered,
        part_meshes=False,
    )
    given = None if layout_named(layout).has_rate else rate
    written = read_motion(out, layout, given, robot=whole_body)
    ground = Outline(whole_body).ground_contact(written, floor=0.0)
    limbs, knees = _likeness(retargeter, found, written)
    return RetargetedClip(
        cleaned,
        limbs,
        knees,
        max((foot.worst for foot in ground.feet), default=0.0),
        float(ground.lowest.min()),
        seconds + cleaned.seconds,
    )


def _likeness(
    retargeter: Retargeter, found: Retargeted, written: RobotMotion
) -> tuple[dict, dict]:
    """`limbs` and `knees` of a `RetargetedClip`, of what was written."""
    targets: PerformerTargets = found.targets
    names = written.joint_names
    q = written.joint_positions[
        :, [names.index(x) for x in retargeter.model.joint_names]
    ]
    ends = [LIMBS[limb][1] for limb in targets.directions]
    ways = dict(
        zip(
            targets.directions,
            retargeter.ways(
                written.root_positions, written.root_rotations.as_matrix(), q, ends
            ),
            strict=True,
        )
    )
    limbs = {}
    for limb, wanted in targets.directions.items():
        off = _angles(ways[limb], wanted)
        limbs[limb] = float(np.median(off)), float(np.quantile(off, 0.95))
    knees = {}
    for side in SIDES:
        pair = f"{side}_hip-knee", f"{side}_knee-ankle"
        bend = _angles(*(ways[limb] for limb in pair))
        more = bend - _angles(*(targets.directions[limb] for limb in pair))
        knees[side] = float(np.median(more)), float(np.quantile(np.abs(more), 0.95))
    return limbs, knees


def _angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(T,) between (T, 3) vectors [rad]."""
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    return np.arctan2(sine, np.sum(a * b, axis=1))
