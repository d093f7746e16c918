"""What a run leaves behind in `log.npz`."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from crar_drake.errors import CrarError, MotionError
from crar_drake.files import whole_file
from crar_drake.law.tasks import TaskLayout
from crar_drake.motion.array_files import load_arrays, npz_names
from crar_drake.results import LOG
from crar_drake.robot.description import GROUND


def _array(*axes: str) -> Any:
    """A field that is an array with these axes."""
    return field(metadata={"axes": axes})


@dataclass(frozen=True)
class SimulationLog:
    """A simulated run: T samples of the closed loop, and the names of the columns.

    Attributes:
        time: (T,) [s].
        q: (T, nq) positions of the simulated plant [rad or m]; of a free root, a unit
            quaternion and a translation.
        v: (T, nv) its velocities.
        actuation: (T, nu) efforts at that instant, in the plant's actuator order
            [Nm or N]; they change in between where the log is coarser than the torque.
        desired_acceleration: (T, nv) commanded accelerations.
        desired_tasks: (T, layout.size) [x_d; v_d; a_d], see `TaskLayout`.
        task_error: (T, m) Eq. (11) against them [rad, m].
        signed_distances: (T, Nc) per watched pair, from the control model [m].
        constraint_weights: (T, n) diagonal of W, of the controlled joints.
        status: (T, 1) tracking, blending, braking, implausible: `law.solution`.
        admission: (T, 4) how the control step was admitted (0 nominal, 1 corrected,
            2 scaled towards braking), the share of the nominal step, a bound from below
            for all distances on the next braking path [m], and 1 if the present one is
            clear, else 0; all NaN unless "lookahead".
        balance: (T, 3) how the control step was admitted for balance (0 nominal, 1
            corrected, 2 scaled towards braking), the share of it, and what the ground
            has left on the next braking path [m of the weight's arm]; all NaN without
            controller.balance and while the robot brakes without targets.
        obstacles: (T, 4 N) x, y, z and radius of each sphere that moves by itself [m],
            in the order of the scenario's; (T, 0) where there are none.
        torque_limit: (T, 2) share of the nominal step that the effort limits allowed,
            and the excess before clipping, see `Solution`.
        position_names: (nq,) joint of each column of q.
        velocity_names: (nv,) joint of each column of v; the same, unless the root is
            free.
        actuator_names: (nu,) joint that each actuator moves.
        controlled_names: (n,) the controlled joints, without a root.
        controlled_units: (n,) "rad" of joints that turn, "m" of those that slide.
        task_names, task_kinds: (N,) tasks, in the order of the rows.
        pair_names: (Nc,) "link a - link b".
        lower, upper: (nq,) position limits; infinite where there is none, and for
            the prescribed joints.
        velocity_limits: (nv,) the largest speeds that the run allowed [rad/s or m/s];
            infinite likewise.
        effort_limits: (nu,) the largest efforts of the actuators, as the controller's
            model has them, whether or not the run respected them [Nm or N]; infinite
            where there is none.
        scenario: the scenario that was run, as YAML text; a robot that was named by
            a path has its absolute path there.
    """

    time: np.ndarray = _array("T")
    q: np.ndarray = _array("T", "nq")
    v: np.ndarray = _array("T", "nv")
    actuation: np.ndarray = _array("T", "nu")
    desired_acceleration: np.ndarray = _array("T", "nv")
    desired_tasks: np.ndarray = _array("T", "layout")
    task_error: np.ndarray = _array("T", "m")
    signed_distances: np.ndarray = _array("T", "Nc")
    constraint_weights: np.ndarray = _array("T", "n")
    status: np.ndarray = _array("T", "1")
    admission: np.ndarray = _array("T", "4")
    balance: np.ndarray = _array("T", "3")
    torque_limit: np.ndarray = _array("T", "2")
    obstacles: np.ndarray = _array("T", "4N")
    position_names: np.ndarray = _array("nq")
    velocity_names: np.ndarray = _array("nv")
    actuator_names: np.ndarray = _array("nu")
    controlled_names: np.ndarray = _array("n")
    controlled_units: np.ndarray = _array("n")
    task_names: np.ndarray = _array("N")
    task_kinds: np.ndarray = _array("N")
    pair_names: np.ndarray = _array("Nc")
    lower: np.ndarray = _array("nq")
    upper: np.ndarray = _array("nq")
    velocity_limits: np.ndarray = _array("nv")
    effort_limits: np.ndarray = _array("nu")
    scenario: str

    @property
    def above_ground(self) -> np.ndarray:
        """(Nc,) whether a watched pair is one with the ground."""
        ground = [GROUND in name.split(" - ") for name in self.pair_names.tolist()]
        return np.array(ground, dtype=bool)

    @property
    def between_links(self) -> np.ndarray:
        """(Nc,) the pairs that pictures and the smallest distance are about.

        Feet are always near the ground: it counts only where it is penetrated, or if
        nothing else is watched.
        """
        ground = self.above_ground
        if not len(self.time) or ground.all():
            return np.ones(len(ground), dtype=bool)
        return ~ground | (self.signed_distances < 0.0).any(axis=0)

    @property
    def layout(self) -> TaskLayout:
        """The rows of the task errors."""
        names, kinds = self.task_names.tolist(), self.task_kinds.tolist()
        return TaskLayout(tuple(names), tuple(kinds))

    @property
    def torque_limited(self) -> np.ndarray:
        """(T,) bool, whether effort limits took more than a tenth of the nominal step.
        A plan asks for all that motors give, and loses a percent of it now and then."""
        return self.torque_limit[:, 0] < _HELD_BACK

    @property
    def torque_clipped(self) -> np.ndarray:
        """(T,) bool, whether a torque was clipped by more than rounding."""
        return self.torque_limit[:, 1] > _NO_EXCESS

    def control_steps(self, period: float) -> np.ndarray:
        """The samples that are the first of their control step.

        Args:
            period: of the controller [s].

        Returns:
            (N,) indices: where the log is finer than the control period, one of
            several samples; else all.
        """
        # Ticks and the log's times may differ by rounding.
        ticks = np.floor(self.time / period + _ROUNDING)
        return np.flatnonzero(np.diff(ticks, prepend=ticks[0] - 1.0) > 0.0)

    def samples(self, rows: np.ndarray | slice) -> SimulationLog:
        """The log of some samples only, by whatever picks rows of an array."""
        return replace(self, **{name: getattr(self, name)[rows] for name in OVER_TIME})

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a compressed NumPy archive with one array per attribute.

        Raises:
            WriteError: the file cannot be written.
        """
        with whole_file(path) as temporary, temporary.open("wb") as stream:
            self.write(stream)

    def write(self, stream: BinaryIO) -> None:
        """Does what `save` does, into an open file."""
        arrays = {each.name: getattr(self, each.name) for each in fields(self)}
        np.savez_compressed(stream, **arrays)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> SimulationLog:
        """Reads what `save` wrote.

        Raises:
            CrarError: there is no such file, or it cannot be read;
            NoLog: it is not such an archive.
        """
        path = Path(path)
        if path.is_dir():
            raise CrarError(f"{path}: this is a folder; name {path / LOG}")
        if not path.is_file():
            raise CrarError(f"{path}: there is no such log")
        try:
            arrays = _read(path)
            arrays["scenario"] = str(arrays["scenario"])
            log = SimulationLog(**arrays)
            log._check()
            return log
        except _Unfit as error:
            raise NoLog(
                f"{path}: not a log of crar-drake run, or of another version: {error}"
            ) from error

    def _check(self) -> None:
        """Raises _Unfit unless the arrays fit together."""
        sizes: dict[str, int] = {}
        for name, axes in _SHAPES.items():
            array = getattr(self, name)
            text = name.endswith(("names", "kinds", "units"))
            if array.dtype.kind != ("U" if text else "f"):
                raise _Unfit(f"array {name!r} is of type {array.dtype}")
            if array.ndim == len(axes):
                for axis, size in zip(axes, array.shape, strict=True):
                    sizes.setdefault(axis, int(axis) if axis.isdigit() else size)
            if array.shape != tuple(sizes.get(axis) for axis in axes):
                raise _Unfit(f"array {name!r} is of shape {array.shape}")
        if not len(self.time):
            raise _Unfit("it holds no sample")


# Of a control period, that a sample may be beside its tick.
_ROUNDING = 1e-6

# Where limits leave less of the nominal step, they hold the robot back [1].
_HELD_BACK = 0.9
# A torque that is beyond its limit by less is not clipped but for rounding [1].
_NO_EXCESS = 1e-4


def is_log(path: Path) -> bool:
    """Whether a file is a log, of any version, and no motion; by its arrays' names."""
    return {"time", "scenario"} <= npz_names(path)


class NoLog(CrarError):
    """A file is no log of a run."""


class _Unfit(Exception):
    """A file holds no log."""


# Equal letters are equal numbers. (A task's number of rows depends on its kind.)
_SHAPES: dict[str, tuple[str, ...]] = {
    each.name: each.metadata["axes"] for each in fields(SimulationLog) if each.metadata
}

# The arrays that have a row for each sample.
OVER_TIME = tuple(name for name, axes in _SHAPES.items() if axes[0] == "T")


def _read(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a log's archive; _Unfit if it is something else, or damaged."""
    try:
        arrays = load_arrays(path)
    except MotionError as error:
        raise _Unfit(str(error).removeprefix(f"{path}: ")) from error
    known = {each.name for each in fields(SimulationLog)}
    for name in sorted(known.symmetric_difference(arrays)):
        word = "misses" if name in known else "has"
        raise _Unfit(f"it {word} an array {name!r}")
    return arrays
