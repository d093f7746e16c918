"""From one law to another in the middle of a motion, without a jump.

Another mode, or other gains, ask for other accelerations in the same state. Where one
law takes over from another, the difference at that step is added to what the new one
asks for, and fades away:

    alpha(t) = alpha_new(t) + (1 - s(t)) (alpha_old - alpha_new)(0),

with s of `equations.blending.smooth_step`. At t = 0 that is the acceleration of the
step before, whatever the laws are. Since a law may remember the step before, and the
new one has none of its own at first, t = 0 is at its second step, and the first repeats
the acceleration, too. A mode that holds by proof is then asked once more
whether it allows that acceleration: its constraints come first, so that there may be a
jump where they demand one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crar_drake.control.modes.mode import Mode
from crar_drake.control.parameters import CrarParameters
from crar_drake.control.records import Memory, Solution
from crar_drake.equations.blending import smooth_step
from crar_drake.equations.kinematics import Measured
from crar_drake.equations.references import Targets
from crar_drake.robot.model import ControlModel
from crar_drake.robot.workspace import Workspace

# Several times 1 / Gv, with which the law itself takes away differences [s].
FADE_TIME = 0.2
# A mode's second step is the first that knows the one before [1].
_SETTLING = 2


@dataclass(frozen=True, slots=True)
class Fading:
    """The memory of a mode that takes over, see `FadingMode`."""

    inner: Any  # the memory of the mode itself
    # (n,) accelerations at t = 0, old less new; None when they have faded away
    difference: np.ndarray | None
    steps: int  # that the mode has made


class FadingMode(Mode):
    """A mode that begins with the accelerations of the step before.

    It knows its first step by `kept` that is no `Fading`: that of the mode before,
    which goes on to be used if that is of the same kind.
    """

    def __init__(
        self, mode: Mode, before: Mode, model: ControlModel, period: float
    ) -> None:
        """
        Args:
            mode: that takes over.
            before: the mode that it takes over from.
            model: of the robot.
            period: of the controller [s].
        """
        self._mode, self._model = mode, model
        self._period = period
        if isinstance(before, FadingMode):
            before = before._mode
        self._keeps_memory = type(before) is type(mode)
        self.diagnostics = mode.diagnostics
        self.horizon, self.plans = mode.horizon, mode.plans
        self.brakes_without_targets = mode.brakes_without_targets
        self.keeps_off_obstacles = mode.keeps_off_obstacles
        self.slower = mode.slower

    @staticmethod
    def check(parameters: CrarParameters) -> None:
        """The mode itself was asked."""

    def acceleration_bounds(
        self, measured: Measured
    ) -> tuple[np.ndarray, np.ndarray] | None:
        return self._mode.acceleration_bounds(measured)

    def admit_again(
        self, measured: Measured, vdot: np.ndarray
    ) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        return self._mode.admit_again(measured, vdot)

    def limited(
        self, measured: Measured, vdot: np.ndarray, efforts: np.ndarray
    ) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        return self._mode.limited(measured, vdot, efforts)

    def resolve(
        self,
        workspace: Workspace,
        measured: Measured,
        targets: Targets,
        before: Memory | None,
        **planned: np.ndarray,
    ) -> Solution:
        fading = None if before is None else before.solution.kept
        begins = before is not None and not isinstance(fading, Fading)
        inner = before
        if begins:
            inner = before if self._keeps_memory else None
        elif before is not None:
            inner = _with_kept(before, fading.inner)
        solution = self._mode.resolve(workspace, measured, targets, inner, **planned)
        vdot, controlled = solution.acceleration, self._model.controlled
        if before is None:
            fading = Fading(None, None, 0)
        elif begins or fading.difference is not None and fading.steps < _SETTLING:
            done = 0 if begins else fading.steps
            jump = before.solution.acceleration - vdot
            fading = Fading(None, jump[controlled], done)
        if fading.difference is None:
            solution.kept = Fading(solution.kept, None, 0)
            return solution
        time = max(fading.steps + 1 - _SETTLING, 0) * self._period
        share = 1.0 - smooth_step(time, FADE_TIME)[0]
        difference = fading.difference if share > 0.0 else None
        solution.kept = Fading(solution.kept, difference, fading.steps + 1)
        if difference is None:
            return solution
        vdot = vdot.copy()
        vdot[controlled] += share * difference
        solution.acceleration, reported = self._mode.admit_again(measured, vdot)
        solution.of_mode = {**solution.of_mode, **reported}
        return solution


def _with_kept(memory: Memory, kept: Any) -> Memory:
    return replace(memory, solution=replace(memory.solution, kept=kept))


def without_fading(memory: Memory) -> Memory:
    """The memory as it would be had the mode not taken over from another."""
    if memory.solution is None or not isinstance(memory.solution.kept, Fading):
        return memory
    return _with_kept(memory, memory.solution.kept.inner)
