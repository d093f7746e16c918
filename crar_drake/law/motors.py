"""Motors: torques are within their limits now, at the period's end, and of braking.

A step asks of each motor tau = A q_ddot + b. It is safe if by the model the torque is
within the limits now and at the period's last tick, where Coriolis forces and gravity
have changed; and if that of braking is, at the state that the step reaches. A motor
that braking takes beyond its limit already is taken no farther.

There is no lemma: braking may need more torque later than it does at first. That no
torque is beyond a limit is observed (`docs/measurements/filter-step.md`), not proved.
Braking more slowly takes less: `braking_time_constant` chooses T once a step.

Rows, linear in s: each motor's torque is within its limit, and so that braking a period
on needs at most RESERVE of it, or where it needs more already, no more than a period of
braking leaves.
"""

from collections.abc import Callable, Sequence

import numpy as np

from crar_drake.equations.compilation import compiled
from crar_drake.equations.vectors import times
from crar_drake.law.projection import HARD, Rows, hard_rows
from crar_drake.law.step import SafetyCheck, State
from crar_drake.robot.model import ControlModel

# The share of a limit that braking may need in the next step [1]: the rest is for what
# Coriolis forces and gravity change in between.
RESERVE = 0.8
# What is asked for ends so much below a limit [1], lest rounding be beyond it.
_INSIDE = 1e-4
# Below this share of all limits no torque is expected to pass one within a period [1].
_CALM = 0.5
# By how much Coriolis forces and gravity may change what is needed in a second, beside
# the reserve [1/s].
_CHANGE = 20.0
# A correction asks for so much more than is missing [1].
_MORE = 1.2


class Motors:
    """The constraint of effort limits, of a robot whose base is fixed.

    Attributes:
        limits: (nu,) [Nm or N], infinite where there is none.
        largest_use: of any motor by what was examined last, now or braking [1].
    """

    name = "motor"

    def __init__(self, model: ControlModel, limits: np.ndarray, ticks: int) -> None:
        """
        Args:
            model: whose dynamics.
            limits: (nu,) as of the attribute.
            ticks: how often in a period the torque is computed anew.
        """
        self.limits, self.largest_use = limits, 0.0
        self._model = model
        self._some = np.flatnonzero(np.isfinite(limits))
        self._L = limits[self._some]
        self._aimed = (1.0 - _INSIDE) * self._L
        self._last_tick = 1.0 - 1.0 / ticks
        self._workspace = model.MakeWorkspace()

    def joint_of(self, index: int) -> int:
        """The velocity of the joint that a motor with a limit moves, by the index of a
        `SafetyCheck`."""
        plant, entry = self._model.plant, self._some[index]
        for each in plant.GetJointActuatorIndices():
            actuator = plant.get_joint_actuator(each)
            start = actuator.input_start()
            if start <= entry < start + actuator.num_inputs():
                return actuator.joint().velocity_start() + entry - start
        raise AssertionError(f"no actuator has input {entry}")

    def measure(self, q: np.ndarray, v: np.ndarray) -> None:
        """Takes inertia and bias of a state (nv,), (nv,), controlled joints first."""
        model = self._model
        context = self._workspace.plant_context
        self._x = np.concatenate(model.in_plant(q, v))
        model.plant.SetPositionsAndVelocities(context, self._x)
        A = model.effort_per_acceleration(self._workspace)
        self._A = np.ascontiguousarray(A[np.ix_(self._some, model.order)])
        still = np.zeros(len(v))
        self._b = model.inverse_dynamics(self._workspace, still)[self._some]

    def braking_time_constant(
        self,
        state: State,
        vdot: np.ndarray,
        choices: Sequence[float],
        is_clear: Callable[[float], bool],
    ) -> float:
        """The shortest T over which the motors can brake, now and with a reserve after
        the nominal; else the longest over which they can now; else the longest.

        Args:
            state: whose T is the one that it is known to be safe over [s].
            vdot: (nv,) accelerations of the nominal [rad/s^2 or m/s^2].
            choices: in order, the present T among them [s].
            is_clear: whether the braking path over a longer T violates nothing; one
                over a shorter is a part of the present one.
        """
        found = enough(
            *(self._A, self._b, self._aimed, state.v, vdot, state.n),
            *(np.array(choices), state.period),
        )
        chosen = longest = 0.0
        for T, (now, then) in zip(choices, found, strict=True):
            if T > state.T and not is_clear(T):
                break
            longest = T
            if now:
                chosen = T
            if now and then:
                break
        return chosen or longest

    def begin(self, state: State) -> None:
        self.measure(state.q, state.v)
        self.largest_use = 0.0
        self._braking_now = np.abs(
            self._A @ self._braking(state, np.zeros_like(state.v)) + self._b
        )
        self._after_braking = None

    def rows(self, state: State) -> Rows:
        g, least = motor_rows(
            *(self._A, self._b, self._aimed, state.v, state.prescribed, state.n),
            *(state.T, state.period),
        )
        # What rows lack is to be less than what is asked for ends below the limits.
        return Rows(g, least, np.full(len(least), 100.0 * HARD))

    def examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        with np.errstate(over="ignore", invalid="ignore"):  # beyond all sense
            return self._examine(state, s, correct)

    def _examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        T, period, L = state.T, state.period, self._L
        vdot = (s - state.v) / T
        tau = np.abs(self._A @ vdot + self._b)
        braking = self._braking(state, vdot)
        then = np.abs(self._A @ braking + self._b)
        use, needed = (tau / L).max(), (then / L).max()
        calm = not self._last_tick or use <= _CALM
        if use <= 1.0 and calm and needed <= RESERVE - _CHANGE * period:
            self.largest_use = max(use, needed)
            return SafetyCheck(True, 1.0 - max(use, needed))
        held = tau
        if not calm:
            held = np.abs(self._torque_at(state, vdot, self._last_tick, vdot))
        signed = self._torque_at(state, vdot, 1.0, braking)
        then = np.abs(signed)
        over = np.maximum(tau, held) - L
        beyond = then - self._allowed_of_braking(state, then)
        cannot_brake = (self._braking_now > L).any()
        if cannot_brake:
            beyond[:] = 0.0  # what the motors can do comes first
        self.largest_use = max((np.maximum(tau, held) / L).max(), (then / L).max())
        worst = int(np.argmax(np.maximum(over, beyond) / L))
        if (over <= 0.0).all() and (beyond <= 0.0).all():  # false of a NaN
            return SafetyCheck(True, 1.0 - self.largest_use)
        rows = self._less(state, s, over, signed, beyond) if correct else None
        return SafetyCheck(False, 1.0 - self.largest_use, rows, index=worst)

    def _braking(self, state: State, vdot: np.ndarray) -> np.ndarray:
        """(nv,) accelerations of braking a period after vdot (nv,); of the prescribed
        joints vdot."""
        n, v = state.n, state.v
        after = v[:n] + state.period * vdot[:n]
        return np.concatenate((-after / state.T, vdot[n:]))

    def _allowed_of_braking(self, state: State, then: np.ndarray) -> np.ndarray:
        """The limits; where braking needs more, what it does after braking."""
        if not (then > self._L).any():
            return self._L
        if self._after_braking is None:
            vdot = np.concatenate(
                (-state.v[: state.n] / state.T, np.zeros(len(state.v) - state.n))
            )
            braking = self._braking(state, vdot)
            tau = self._torque_at(state, vdot, 1.0, braking)
            self._after_braking = np.abs(tau)
        return np.maximum(self._L, self._after_braking)

    def _torque_at(
        self, state: State, vdot: np.ndarray, share: float, of: np.ndarray
    ) -> np.ndarray:
        """Torques of the motors with limits, of the accelerations `of`, where vdot
        leads in a share of the period; all (nv,)."""
        model, context = self._model, self._workspace.plant_context
        t = share * state.period
        v = state.v + t * vdot
        q = state.q + t * state.v + 0.5 * t * (t + state.plant_step) * vdot
        x = np.concatenate(model.in_plant(q, v))
        model.plant.SetPositionsAndVelocities(context, x)
        _, in_plant = model.in_plant(q, of)
        tau = model.inverse_dynamics(self._workspace, in_plant)[self._some]
        model.plant.SetPositionsAndVelocities(context, self._x)
        return tau

    def _less(
        self,
        state: State,
        s: np.ndarray,
        over: np.ndarray,
        braking: np.ndarray,
        beyond: np.ndarray,
    ) -> Rows:
        """Rows for smaller torques, and for speeds from which braking takes less.

        Args:
            s: (nv,) that was examined.
            over: (M,) torques beyond the limits now [Nm or N].
            braking, beyond: (M,) of braking a period on, signed; and beyond.
        """
        n, T = state.n, state.T
        A = self._A[:, :n]
        size = np.sqrt((A**2).sum(axis=1)) + 1e-12
        tau = self._A @ ((s - state.v) / T) + self._b
        g, least = [], []
        for sign, by in (
            (-np.sign(tau) * (over > 0.0), over * T),
            (np.sign(braking) * (beyond > 0.0), beyond * T * T / state.period),
        ):
            some = np.flatnonzero(sign)
            rows = sign[some, None] * A[some] / size[some, None]
            g.append(rows)
            least.append(rows @ s[:n] + _MORE * by[some] / size[some])
        return hard_rows(np.concatenate(g), np.concatenate(least))


@compiled
def enough(A, b, L, v, vdot, n, choices, period):
    """(K, 2) bool, whether motors can brake over each T: now; and after vdot (nv,),
    held for a period, with a reserve, while the prescribed joints go on by it.

    Args:
        A, b: (M, nv), (M,) of the torques A q_ddot + b, and
        L: (M,) what is aimed at [Nm or N].
        v: (nv,) velocities, of which the first n are controlled.
        choices: (K,) of T [s].
        period: [s].
    """
    braking, found = vdot.copy(), np.zeros((len(choices), 2), dtype=np.bool_)
    for k in range(len(choices)):
        T = choices[k]
        braking[:n] = -v[:n] / T
        now = np.abs(times(A, braking) + b)
        braking[:n] -= (period / T) * vdot[:n]
        then = np.abs(times(A, braking) + b)
        found[k, 0] = (now <= L).all()
        found[k, 1] = (then <= RESERVE * L).all()
    return found


@compiled
def motor_rows(A, b, L, v, prescribed, n, T, period):
    """g (2 M, n), least (2 M,), see the top of the file; arguments as of `enough`.

    Args:
        prescribed: (nv - n,) s of the joints that are not controlled.
    """
    M, share = len(A), period / T
    g, least = np.zeros((2 * M, n)), np.empty(2 * M)
    for i in range(M):
        still, moving, size = b[i], 0.0, 1e-24
        for j in range(n):
            moving += A[i, j] * v[j]
            size += A[i, j] ** 2
        for j in range(n, A.shape[1]):
            still += A[i, j] * (prescribed[j - n] - v[j]) / T
        size = np.sqrt(size)
        brake = still - moving / T
        left = min(abs(brake), abs(brake - share * (brake - still)))
        room = max(RESERVE * L[i], left)
        low = min(max(still + (brake - room) / share, -L[i]), L[i])
        high = min(max(still + (brake + room) / share, -L[i]), L[i])
        for j in range(n):
            g[i, j], g[M + i, j] = A[i, j] / size, -A[i, j] / size
        least[i] = (T * (low - still) + moving) / size
        least[M + i] = -(T * (high - still) + moving) / size
    return g, least
