"""Accelerations whose torques the motors have, for a whole control period.

Where the nominal accelerations take more than the effort limits, the nearest
accelerations that do not are found, `equations.torque_limit`; then the constraint mode
admits them again.
"""

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from crar_drake.control.modes.mode import Mode
from crar_drake.control.parameters import CrarParameters
from crar_drake.control.records import Solution
from crar_drake.equations.compilation import Held, hold
from crar_drake.equations.kinematics import Measured
from crar_drake.equations.torque_limit import (
    Holding,
    clip_torque,
    held_step,
    nearest_accelerations,
    share_of_nominal,
)
from crar_drake.equations.within_efforts import NO_EXCESS
from crar_drake.robot.model import ControlModel
from crar_drake.robot.workspace import Workspace

# Below this share of all limits no torque is expected to pass one within a period [1].
_CALM = 0.5
# By what a torque passes its limit within a period the limit is lowered, and by so much
# more of it [1], for other accelerations let it grow otherwise; so often at most, and
# at most to this share of the limit [1].
_GROWTH, _TRIES, _MOST_FREE = 1.2, 8, 0.3

_NO_INERTIA = np.zeros((0, 0))


class _Nominal(NamedTuple):
    """The nominal accelerations and what they take."""

    vdot: np.ndarray  # (nv,) accelerations [rad/s^2 or m/s^2]
    actuation: np.ndarray  # (nu,) their torque [Nm or N]
    inertia: np.ndarray  # (nu, nv) change of the torque with the accelerations


class _Candidate(NamedTuple):
    """Accelerations that may be within the limits."""

    vdot: np.ndarray  # (nv,)
    actuation: np.ndarray  # (nu,) their torque, clipped if nothing else helps
    torque_limit: np.ndarray  # (2,) `Solution.torque_limit`
    after: np.ndarray  # (nq + nv,) state that they lead to in a control period
    reported: Mapping[str, np.ndarray] = {}  # by the mode of them, if it was asked


class EffortLimits:
    """What the effort limits of a robot make of nominal accelerations.

    Attributes:
        limits: (nu,) effort limits, infinite where there is none [Nm or N].
        finite: whether there is any.
    """

    def __init__(self, model: ControlModel, mode: Mode, gains: CrarParameters) -> None:
        self.limits = gains.effort_limits(model)
        # What is found may be NO_EXCESS beyond what is asked for, and is not to be
        # clipped: then the robot would not do what was admitted.
        self._aimed = (1.0 - NO_EXCESS) * self.limits
        # Without limits the inertias would be computed for nothing.
        self.finite = bool(np.isfinite(self.limits).any())
        self._model, self._period = model, float(gains.period)
        # Who gives way where limits are passed: the controlled joints; then all.
        self._giving_way = [model.controlled]
        if model.n_p:
            self._giving_way.append(model.order)
        self._mode, self._horizon = mode, float(gains.braking_horizon)
        plant_step = float(model.plant.time_step())
        self._holdings = [
            hold(
                Holding(
                    joints,
                    self._horizon,
                    self._period,
                    plant_step,
                    model.positions,
                    model.order,
                )
            )
            for joints in self._giving_way
        ]
        # Of what `held_step` returns.
        nv = model.plant.num_velocities()
        self._still = np.zeros(nv)
        nu = model.plant.num_actuated_dofs()
        ends = (0, nv, nv + nu, nv + nu + 2)
        self._parts = (*(slice(a, b) for a, b in pairwise(ends)), slice(ends[-1], None))
        ticks = gains.torque_ticks(plant_step)
        # After the control tick.
        self._torque_times = [self._period * k / ticks for k in range(1, ticks)]

    def compile(
        self, workspace: Workspace, measured: Measured, vdot: np.ndarray
    ) -> None:
        """Compiles what has yet to be, at the workspace's state."""
        if self._mode.slower:
            self._mode.limited(measured, vdot, self.rows(workspace))
            return
        actuation = self._model.inverse_dynamics(workspace, vdot)
        nominal = self._effort(workspace, vdot, actuation)
        joints = self._model.controlled
        self._nearest(workspace, measured, nominal, self._aimed, joints)

    def limit(
        self,
        workspace: Workspace,
        measured: Measured,
        solution: Solution,
        rows: np.ndarray | None = None,
    ) -> None:
        """Changes a solution's accelerations to the nearest that are within the limits
        and the mode's bounds, in this period's torque ticks, too; and adds what follows
        from them.

        Args:
            workspace: at the state of the control step, where it is left.
            measured: of the same state.
            solution: of the mode.
            rows: `rows` of the state, if they are known.
        """
        vdot = solution.acceleration
        if self.finite and self._mode.slower:
            if rows is None:
                rows = self.rows(workspace)
            found = self._within_ticks(
                workspace,
                measured,
                lambda limits: self._of_mode(measured, vdot, rows, limits),
            )
        else:
            actuation = self._model.inverse_dynamics(workspace, vdot)
            if self.finite:
                nominal = self._effort(workspace, vdot, actuation)
                found = self._within_ticks(
                    workspace,
                    measured,
                    lambda limits: self._within(workspace, measured, nominal, limits),
                )
            else:
                found = self._unlimited(measured, vdot, actuation, self._period)
        actuation, torque_limit = found.actuation, found.torque_limit
        if torque_limit[1] > 0.0:  # it was clipped to what was asked for
            actuation = self._model.inverse_dynamics(workspace, found.vdot)
            actuation, torque_limit[1] = self.clipped(actuation)
        solution.acceleration, solution.actuation = found.vdot, actuation
        solution.torque_limit, solution.position_command = torque_limit, found.after
        if found.reported:
            solution.of_mode = {**solution.of_mode, **found.reported}

    def rows(self, workspace: Workspace) -> np.ndarray:
        """What accelerations take of the motors.

        Args:
            workspace: at the state of the control step.

        Returns:
            (nu, nv + 2) A, b and the most that |A q_ddot + b| is to be, for
            accelerations in the robot's order; (0, nv + 2) if no motor has a limit.
        """
        model = self._model
        if not self.finite:
            return np.zeros((0, len(model.order) + 2))
        rows = np.empty((len(self.limits), len(model.order) + 2))
        A = model.effort_per_acceleration(workspace)
        np.take(A, model.order, axis=1, out=rows[:, :-2])
        rows[:, -2] = model.inverse_dynamics(workspace, self._still)
        rows[:, -1] = self._aimed
        return rows

    def within(self, workspace: Workspace, vdot: np.ndarray) -> bool:
        """Whether accelerations (nv,) take no more than the limits, at the workspace's
        state."""
        if not self.finite:
            return True
        actuation = self._model.inverse_dynamics(workspace, vdot)
        return bool(np.all(np.abs(actuation) <= self.limits))

    def take(
        self,
        workspace: Workspace,
        measured: Measured,
        vdot: np.ndarray,
        solution: Solution,
    ) -> None:
        """Gives a solution other accelerations (nv,), and what follows from them.

        Args:
            workspace: at the state of the control step.
            measured: of the same state.
            vdot: that are decided; a torque beyond the limits is clipped.
            solution: that is changed; its share of the nominal accelerations stays.
        """
        actuation = self._model.inverse_dynamics(workspace, vdot)
        found = self._unlimited(measured, vdot, actuation, self._period)
        solution.acceleration, solution.position_command = vdot, found.after
        solution.actuation = actuation
        if self.finite:
            solution.actuation, excess = self.clipped(actuation)
            share = solution.torque_limit[0]
            solution.torque_limit = np.array([share, excess])

    def _within_ticks(
        self,
        workspace: Workspace,
        measured: Measured,
        within: Callable[[np.ndarray], _Candidate],
    ) -> _Candidate:
        """What is within the limits (nu,) at this period's torque ticks, too, by what
        `within` finds of limits at the control tick."""
        limits = self._aimed
        found = within(limits)
        for _ in range(_TRIES):
            excess = self._excess_to_come(workspace, measured, found)
            if excess is None:
                break
            # From what it is now, for the limit itself need not bind yet.
            lowered = np.minimum(limits, np.abs(found.actuation)) - _GROWTH * excess
            lowered = np.maximum(lowered, _MOST_FREE * self._aimed)
            limits = np.where(excess > 0.0, lowered, limits)
            again = within(limits)
            if again.torque_limit[1] > NO_EXCESS:
                break
            found = again
        return found

    def _of_mode(
        self,
        measured: Measured,
        vdot: np.ndarray,
        rows: np.ndarray,
        limits: np.ndarray,
    ) -> _Candidate:
        """What the mode finds within limits (nu,), over the horizon that it chooses."""
        if limits is not self._aimed:
            rows = rows.copy()
            rows[:, -1] = limits
        found, reported = self._mode.limited(measured, vdot, rows)
        return _Candidate(*map(found.__getitem__, self._parts), reported)

    def clipped(self, actuation: np.ndarray) -> tuple[np.ndarray, float]:
        """`clip_torque`, for accelerations that are decided already."""
        return clip_torque(actuation, self.limits)

    def _effort(
        self, workspace: Workspace, vdot: np.ndarray, actuation: np.ndarray
    ) -> _Nominal:
        return _Nominal(vdot, actuation, self._model.effort_per_acceleration(workspace))

    def _within(
        self,
        workspace: Workspace,
        measured: Measured,
        nominal: _Nominal,
        limits: np.ndarray,
    ) -> _Candidate:
        """The nominal accelerations, or the nearest within these limits (nu,) that the
        mode admits.

        The nearest of the controlled joints, or where that is not enough, of all; or a
        share of the nominal accelerations, if that is more than the mode leaves of the
        nearest.
        """
        slowed = self._slowed(measured, nominal, limits)
        share, excess = slowed.torque_limit.tolist()  # an array is slow to unpack
        if share == 1.0 and excess == 0.0:
            return slowed  # which the mode has admitted as its own
        for joints in self._giving_way:
            near = self._nearest(workspace, measured, nominal, limits, joints)
            found = self._admitted(workspace, measured, nominal, limits, near)
            if found.torque_limit[1] <= NO_EXCESS:
                break
        if excess == 0.0 and share > found.torque_limit[0]:
            scaled = self._admitted(workspace, measured, nominal, limits, slowed)
            if scaled.torque_limit[0] > found.torque_limit[0]:
                return scaled
        return found

    def _nearest(
        self,
        workspace: Workspace,
        measured: Measured,
        nominal: _Nominal,
        limits: np.ndarray,
        joints: np.ndarray,
    ) -> _Candidate:
        """The nearest accelerations within the limits of those joints that give way, or
        what is left of them."""
        model, n = self._model, self._model.n
        bounds = np.full((2, len(joints)), np.inf)
        bounds[0] = -np.inf
        bounds[:, :n] = self._mode.acceleration_bounds(measured) or bounds[:, :n]
        near = nearest_accelerations(
            nominal.vdot,
            nominal.actuation,
            nominal.inertia,
            measured.v,
            joints,
            limits,
            bounds[0],
            bounds[1],
            self._horizon,
            self._period,
        )
        found = nominal._replace(
            vdot=near, actuation=model.inverse_dynamics(workspace, near)
        )
        return self._slowed(measured, found, limits)

    def _admitted(
        self,
        workspace: Workspace,
        measured: Measured,
        nominal: _Nominal,
        limits: np.ndarray,
        slowed: _Candidate,
    ) -> _Candidate:
        """What the mode admits of accelerations within the limits."""
        model = self._model
        actuation, limit, after = slowed.actuation, slowed.torque_limit, slowed.after
        vdot, reported = self._mode.admit_again(measured, slowed.vdot)
        if not np.array_equal(vdot, slowed.vdot):
            actuation = model.inverse_dynamics(workspace, vdot)
            actuation, limit[1] = clip_torque(actuation, limits)
            after = self._unlimited(measured, vdot, actuation, self._period).after
        limit[0] = share_of_nominal(
            vdot[model.order],
            nominal.vdot[model.order],
            measured.v[model.controlled],
            self._horizon,
        )
        return _Candidate(vdot, actuation, limit, after, reported)

    def _slowed(
        self,
        measured: Measured,
        nominal: _Nominal,
        limits: np.ndarray,
    ) -> _Candidate:
        """`limit_torque` at the state. Where the prescribed joints ask for more than
        the motors have, whatever the others do, they brake along."""
        for holding in self._holdings:
            found = self._held(measured, nominal, limits, self._period, holding)
            if found.torque_limit[1] == 0.0:
                break
        return found

    def _unlimited(
        self, measured: Measured, vdot: np.ndarray, actuation: np.ndarray, time: float
    ) -> _Candidate:
        """The same accelerations and torque, and what they lead to after `time` [s]."""
        nominal = _Nominal(vdot, actuation, _NO_INERTIA)
        return self._held(measured, nominal, self.limits, time, self._holdings[0])

    def _held(
        self,
        measured: Measured,
        nominal: _Nominal,
        limits: np.ndarray,
        time: float,
        holding: Held,
    ) -> _Candidate:
        q, v = measured.q[0], measured.v
        found = held_step(q, v, *nominal, limits, time, holding)
        return _Candidate(*map(found.__getitem__, self._parts))

    def _excess_to_come(
        self, workspace: Workspace, measured: Measured, found: _Candidate
    ) -> np.ndarray | None:
        """By how much (nu,) torques will be beyond the limits at this period's torque
        ticks, while the accelerations are held; None if none will.

        Coriolis forces and gravity change within a period.
        """
        limits = self.limits
        if not self._torque_times:
            return None
        if np.all(np.abs(found.actuation) <= _CALM * limits):
            return None
        plant, context = self._model.plant, workspace.plant_context
        here = plant.GetPositionsAndVelocities(context)
        most = np.zeros(len(limits))
        for time in self._torque_times:
            there = self._unlimited(measured, found.vdot, found.actuation, time)
            plant.SetPositionsAndVelocities(context, there.after)
            tau = self._model.inverse_dynamics(workspace, found.vdot)
            most = np.maximum(most, np.abs(tau))
        plant.SetPositionsAndVelocities(context, here)
        return np.maximum(most - limits, 0.0) if np.any(most > limits) else None
