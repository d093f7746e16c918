"""A robot's motion as files of the field have it: the root's poses and all joints.

`read_motion` and `write_motion` are the way from a file and to one; which columns and
keys a layout has is in the files of the layouts (`csv_layouts`, `npz_layouts`,
`pickle_layouts`), and which layouts there are in `layouts`.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError

if TYPE_CHECKING:
    from crar_drake.references.whole_body import WholeBody

# The layout of a file that does not tell whether its joints are depth first or breadth
# first, until its robot does.
UNTOLD_ORDER = "npz"

# A quaternion whose length differs by more from 1 is no rotation.
_LENGTH_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class RobotMotion:
    """Samples of a robot's configuration, evenly spaced in time.

    The root R is the robot's root link (a humanoid's pelvis). W is the world, z up.

    Attributes:
        joint_names: (n,) names in the order of `joint_positions`; () where the layout
            has none.
        root_positions: (T, 3) p_WR [m].
        root_quaternions: (T, 4) of R_WR, order w x y z, of length 1 as far as the
            file's digits go; `root_rotations` has them exactly so.
        joint_positions: (T, n) [rad; m of a prismatic joint].
        rate: samples per second [Hz].
        layout: name of the layout that it was read from, or "".
        source: path of the file that it was read from, or "".
        clip: its name, where a file holds several; else "".
        precision: NumPy type of the numbers in the file ("float32"), or "". Here they
            are float64, which holds them exactly.
        guesses: what the file did not say and was guessed or assumed, a sentence each.
        extras: what the file had besides and no motion determines (names of bodies,
            poses of an object), by its key there.
        computed: what the file had besides that follows from the motion and the robot
            (velocities, poses of bodies). It is written as it was read only as long as
            `is_as_read`; else it is computed anew.
        fingerprint: of the samples that were read; see `is_as_read`.
    """

    joint_names: tuple[str, ...]
    root_positions: np.ndarray
    root_quaternions: np.ndarray
    joint_positions: np.ndarray
    rate: float
    layout: str = ""
    source: str = ""
    clip: str = ""
    precision: str = ""
    guesses: tuple[str, ...] = ()
    extras: Mapping[str, object] = field(default_factory=dict)
    computed: Mapping[str, object] = field(default_factory=dict)
    fingerprint: str = ""

    def __post_init__(self) -> None:
        """
        Raises:
            MotionError: shapes do not fit, a number is not finite, a quaternion is
                not of length 1, a joint is there twice, or the rate is not positive.
        """
        p, Q, q = self.root_positions, self.root_quaternions, self.joint_positions
        if p.ndim != 2 or p.shape[1] != 3 or len(p) == 0:
            raise self._error(f"root positions are (T, 3) with T > 0, not {p.shape}")
        if Q.shape != (len(p), 4):
            raise self._error(f"root quaternions are {(len(p), 4)}, not {Q.shape}")
        if q.ndim != 2 or len(q) != len(p):
            raise self._error(f"joint positions are ({len(p)}, n), not {q.shape}")
        for what, values in (
            ("root position", p),
            ("root quaternion", Q),
            ("joint position", q),
        ):
            bad = np.argwhere(~np.isfinite(values))
            if len(bad):
                row, column = bad[0]
                raise self._error(
                    f"{what}, frame {row + 1}, column {column + 1} is "
                    f"{values[row, column]}, no finite number"
                )
        off = np.abs(np.linalg.norm(Q, axis=1) - 1.0)
        if off.max() > _LENGTH_TOLERANCE:
            row = int(off.argmax())
            raise self._error(
                f"the root's quaternion in frame {row + 1} has length "
                f"{np.linalg.norm(Q[row]):.3g}, and is no rotation"
            )
        check_joint_names(self.joint_names, q.shape[1], self.source)
        if not (np.isfinite(self.rate) and self.rate > 0.0):
            raise self._error(f"the rate is {self.rate}, not a positive number [Hz]")

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.root_positions)

    @property
    def num_joints(self) -> int:
        """n."""
        return self.joint_positions.shape[1]

    @property
    def duration(self) -> float:
        """From the first sample to the last [s]."""
        return (self.num_frames - 1) / self.rate

    @property
    def times(self) -> np.ndarray:
        """(T,) of the samples, the first at 0 [s]."""
        return np.arange(self.num_frames) / self.rate

    @property
    def root_rotations(self) -> Rotation:
        """R_WR of all T samples; SciPy normalises quaternions that files round."""
        return Rotation.from_quat(self.root_quaternions[:, [1, 2, 3, 0]])

    @property
    def is_as_read(self) -> bool:
        """Whether samples, rate and order of joints are those of the file."""
        return self.fingerprint == _fingerprint(self)

    def as_read(self) -> RobotMotion:
        """The same motion, which `is_as_read` from here on."""
        return replace(self, fingerprint=_fingerprint(self))

    def untold_order(self) -> MotionError:
        """What to say of a motion whose file does not tell the order of its joints."""
        return self._error(
            f"{self.guesses[-1]}; say it with --layout mjlab-npz or beyondmimic-npz, "
            "or which robot it is with --robot"
        )

    def _error(self, text: str) -> MotionError:
        return MotionError(f"{self.source}: {text}" if self.source else text)


def read_motion(
    path: str | os.PathLike[str],
    layout: str | None = None,
    rate: float | None = None,
    joint_names: Sequence[str] | None = None,
    clip: str | None = None,
    robot: WholeBody | None = None,
) -> RobotMotion:
    """Reads the one motion of a file.

    Args:
        path: of the file.
        layout: its name (`layouts.LAYOUTS`); by default what the file looks like.
        rate: samples per second [Hz]; by default what the file says, else the usual
            one of its layout, which is told among the guesses.
        joint_names: (n,) names of its joints in its order, where the file has none.
        clip: which motion, where the file holds several.
        robot: that it is a motion of. With it the joints are checked, put into the
            robot's order (`WholeBody.joint_names`) and named.

    Raises:
        MotionError: the file is not there, damaged or of no known layout, is of
            another robot, or holds several motions and none was named; the message
            names the file.
    """
    motions = read_motions(path, layout, rate, joint_names, robot)
    if clip is not None:
        for motion in motions:
            if motion.clip == clip:
                return motion
        from crar_drake.nearest import nearest

        known = [motion.clip for motion in motions]
        raise MotionError(f"{path}: there is no clip {clip!r}{nearest(clip, known)}")
    if len(motions) > 1:
        names = ", ".join(motion.clip for motion in motions[:5])
        raise MotionError(
            f"{path}: holds {len(motions)} motions; name one of them ({names}"
            + (", ...)" if len(motions) > 5 else ")")
        )
    return motions[0]


def read_motions(
    path: str | os.PathLike[str],
    layout: str | None = None,
    rate: float | None = None,
    joint_names: Sequence[str] | None = None,
    robot: WholeBody | None = None,
) -> tuple[RobotMotion, ...]:
    """Reads all motions of a file, at least one; see `read_motion`."""
    from crar_drake.references.layouts import read_file

    motions = read_file(path, layout, rate, joint_names)
    if robot is None:
        for motion in motions:
            if motion.layout == UNTOLD_ORDER:
                raise motion.untold_order()
        return motions
    from crar_drake.references.robot_match import matched

    return tuple(matched(motion, robot) for motion in motions)


def write_motion(
    path: str | os.PathLike[str],
    motion: RobotMotion,
    layout: str,
    robot: WholeBody | None = None,
) -> None:
    """Writes a motion, whole or not at all.

    Args:
        path: of the file.
        motion: to be written. What it has in `extras` is written if the layout is the
            one that they were read from.
        layout: its name.
        robot: that moves; needed where a layout has what follows from the robot
            (poses of bodies), unless the motion is as it was read.

    Raises:
        MotionError: the layout needs a robot and there is none, or the robot has
            other joints.
        WriteError: the file cannot be written.
    """
    write_motions(path, (motion,), layout, robot)


def write_motions(
    path: str | os.PathLike[str],
    motions: Sequence[RobotMotion],
    layout: str,
    robot: WholeBody | None = None,
) -> None:
    """Writes several motions into one file, if the layout can; see `write_motion`."""
    from crar_drake.references.layouts import write_file

    write_file(path, motions, layout, robot)


def check_joint_names(
    names: Sequence[str], num_joints: int, source: str | os.PathLike[str] = ""
) -> None:
    """Raises MotionError unless names are as many as joints (or none), none twice."""
    where = f"{source}: " if source else ""
    if not names:
        return
    if len(names) != num_joints:
        raise MotionError(
            f"{where}there are {len(names)} joint names but {num_joints} joints"
        )
    doubled = sorted({name for name in names if list(names).count(name) > 1})
    if doubled:
        raise MotionError(f"{where}joint {doubled[0]!r} is there more than once")


def _fingerprint(motion: RobotMotion) -> str:
    digest = hashlib.sha256()
    for values in (
        motion.root_positions,
        motion.root_quaternions,
        motion.joint_positions,
    ):
        digest.update(np.ascontiguousarray(values, dtype=float).tobytes())
    digest.update(repr((float(motion.rate), tuple(motion.joint_names))).encode())
    return digest.hexdigest()
