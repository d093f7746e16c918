"""A robot's motion as files of the field have it: the root's poses and all joints.

`motion_files.read_motion` and `write_motions` are the way from a file and to one; which
columns and keys a layout has is in `layouts`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.rates import check_rate

# A quaternion whose length differs by more from 1 is no rotation.
LENGTH_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class RobotMotion:
    """Samples of a robot's configuration, evenly spaced in time.

    The root R is the robot's root link (a humanoid's pelvis). W is the world, z up.
    """

    # (n,) names in the order of `joint_positions`; () where the layout has none
    joint_names: tuple[str, ...]
    root_positions: np.ndarray  # (T, 3) p_WR [m]
    # (T, 4) of R_WR, order w x y z, of length 1 as far as the file's digits go;
    # `root_rotations` has them exactly so
    root_quaternions: np.ndarray
    joint_positions: np.ndarray  # (T, n) [rad; m of a prismatic joint]
    rate: float  # samples per second [Hz]
    layout: str = ""  # name of the layout that it was read from, or ""
    source: str = ""  # path of the file that it was read from, or ""
    clip: str = ""  # its name, where a file holds several; else ""
    # NumPy type of the numbers in the file ("float32"), or "". Here they are float64,
    # which holds them exactly.
    precision: str = ""
    # what the file did not say and was guessed or assumed, a sentence each
    guesses: tuple[str, ...] = ()
    # what the file had besides and no motion determines (names of bodies, poses of an
    # object), by its key there
    extras: Mapping[str, object] = field(default_factory=dict)
    # what the file had besides that follows from the motion and the robot (velocities,
    # poses of bodies). It is written as it was read only as long as `is_as_read`; else
    # it is computed anew.
    computed: Mapping[str, object] = field(default_factory=dict)
    fingerprint: str = ""  # of the samples that were read; see `is_as_read`

    def __post_init__(self) -> None:
        """
        Raises:
            MotionError: shapes do not fit, a number is not finite, a quaternion is
                not of length 1, a joint is there twice, or no motion has the
                rate.
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
        if off.max() > LENGTH_TOLERANCE:
            row = int(off.argmax())
            raise self._error(
                f"the root's quaternion in frame {row + 1} has length "
                f"{np.linalg.norm(Q[row]):.3g}, and is no rotation"
            )
        names, n = self.joint_names, q.shape[1]
        if names and len(names) != n:
            raise self._error(f"there are {len(names)} joint names but {n} joints")
        for name in sorted({name for name in names if list(names).count(name) > 1}):
            raise self._error(f"joint {name!r} is there more than once")
        try:
            check_rate(self.rate)
        except MotionError as error:
            raise self._error(str(error)) from None

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

    def frames(self, some: slice | np.ndarray) -> RobotMotion:
        """The motion in some frames alone; what the file had for each with them."""
        return replace(
            self,
            root_positions=self.root_positions[some],
            root_quaternions=self.root_quaternions[some],
            joint_positions=self.joint_positions[some],
            extras={
                key: value[some] if has_rows(value, self.num_frames) else value
                for key, value in self.extras.items()
            },
            computed={},
        )

    def as_read(self) -> RobotMotion:
        """The same motion, which `is_as_read` from here on."""
        return replace(self, fingerprint=_fingerprint(self))

    def _error(self, text: str) -> MotionError:
        return MotionError(f"{self.source}: {text}" if self.source else text)


# First and last frame, counted from 1, both included; None for the motion's last.
Frames = tuple[int, int | None]


def trimmed(motion: RobotMotion, frames: Frames) -> RobotMotion:
    """The motion from one frame to another; what has a row for each frame with it.

    A last frame beyond the motion's end is the motion's last.

    Raises:
        MotionError: the motion ends before the first frame.
    """
    first, last = frames
    if first > motion.num_frames:
        raise MotionError(
            f"{motion.source}: has {motion.num_frames} frames, and is to be trimmed to "
            f"those from {first} on; begin earlier"
        )
    if first == 1 and (last is None or last >= motion.num_frames):
        return motion
    return motion.frames(slice(first - 1, last))


def has_rows(value: object, frames: int) -> bool:
    """Whether what a file has besides is an array of numbers, a row for each frame."""
    array = isinstance(value, np.ndarray) and value.ndim > 0
    return array and len(value) == frames and value.dtype.kind in "fiub"


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
