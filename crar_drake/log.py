"""What a run leaves behind in `log.npz`."""

from __future__ import annotations

import os
import zipfile
import zlib
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from crar_drake.errors import CrarError
from crar_drake.files import whole_file


@dataclass(frozen=True)
class SimulationLog:
    """A simulated run: T samples of the closed loop, and the names of the columns.

    Attributes:
        time: (T,) [s].
        q: (T, nq) positions of the simulated plant [rad or m].
        v: (T, nv) its velocities.
        actuation: (T, nu) efforts, in the plant's actuator order [Nm or N].
        desired_acceleration: (T, nv) commanded accelerations.
        desired_tasks: (T, layout.size) [x_d; v_d; a_d], see `TaskLayout`.
        task_error: (T, m) Eq. (11) against them [rad, m].
        signed_distances: (T, Nc) per watched pair, from the control model [m].
        constraint_weights: (T, n) diagonal of W.
        status: (T, 1) tracking, blending or braking, see `control_law`.
        resting_margins: (T, 2) where the robot would come to rest, smallest distance
            [m] and smallest margin to a limit [rad]; NaN unless "lookahead".
        torque_limit: (T, 2) share of the wish that the effort limits allowed, and
            the excess before clipping, see `control_law.Solution`.
        position_names: (nq,) joint of each column of q and v.
        actuator_names: (nu,) joint that each actuator moves.
        controlled_names: (n,) the controlled joints.
        task_names, task_kinds: (N,) tasks, in the order of the rows.
        pair_names: (Nc,) "link a - link b".
        lower, upper: (nq,) position limits; infinite where there is none, and for
            the prescribed joints.
        scenario: the scenario that was run, as YAML text; a robot that was named by
            a path has its absolute path there.
    """

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    actuation: np.ndarray
    desired_acceleration: np.ndarray
    desired_tasks: np.ndarray
    task_error: np.ndarray
    signed_distances: np.ndarray
    constraint_weights: np.ndarray
    status: np.ndarray
    resting_margins: np.ndarray
    torque_limit: np.ndarray
    position_names: np.ndarray
    actuator_names: np.ndarray
    controlled_names: np.ndarray
    task_names: np.ndarray
    task_kinds: np.ndarray
    pair_names: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    scenario: str

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a compressed NumPy archive with one array per attribute."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        with whole_file(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, **arrays)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> SimulationLog:
        """Reads what `save` wrote.

        Raises:
            CrarError: there is no such file, or it is not such an archive.
        """
        if not Path(path).is_file():
            raise CrarError(f"{path}: there is no such log")
        try:
            with np.load(path, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            arrays["scenario"] = str(arrays["scenario"])
            return SimulationLog(**arrays)
        except (
            TypeError,
            KeyError,
            ValueError,
            OSError,
            EOFError,
            zipfile.BadZipFile,
            zlib.error,
        ) as error:
            raise CrarError(
                f"{path}: not a log of crar-drake run, or of another version: {error}"
            ) from error
