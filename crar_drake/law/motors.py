"""Motors: torques are within their limits, in the period and in braking after it.

Lemma: braking keeps the torques of braking. By (A1) with s = 0 the states of braking,
k periods on, are

    q + kappa T (1 - w) q_dot,  w q_dot,      w = (1 - period / T)^k,

and so they are of the next braking path, for larger k. A state is safe if on this curve
the torques of q_ddot = -w q_dot / T are within the limits, down to w = 0: what holds
the robot where it comes to rest. A step is safe if its torques are within the limits
now, in the middle and at the end of the period, and it leads to a safe state. A motor
that the present braking path takes beyond its limit already is taken no farther.

What is asked between places of the curve, and within a period, is observed (see
`docs/measurements/adversary.md`), not proved. Braking more slowly takes less:
`braking_time_constant` chooses T once a step.

Rows, linear in s: each motor's torque is within its limit, and so that braking a period
on needs at most RESERVE of it, or where it needs more already, no more than a period of
braking leaves.
"""

from collections.abc import Callable, Sequence

import numpy as np

from crar_drake.equations.compilation import compiled
from crar_drake.equations.vectors import times
from crar_drake.law.projection import Rows, hard_rows
from crar_drake.law.step import SafetyCheck, State
from crar_drake.robot.model import ControlModel

# The share of a limit that braking may need in the next step [1]: the rest is for what
# Coriolis forces and gravity change in between.
RESERVE = 0.8
# What is asked for ends so much below a limit [1].
_INSIDE = 8e-3
# Torques that are held are within this share of a limit where they are looked at [1]:
# the rest is for what is between.
_HELD = 0.995
# And those of braking [1].
_OF_PATH = 0.95
# Below this share of all limits no torque is expected to pass one within a period and
# the braking after it [1].
_CALM = 0.5
# Torques of braking are looked at where a joint has moved by this [rad or m], but in no
# more parts of the way than these.
_APART, _PARTS = 0.12, 8
# A correction takes the share of the speed for no less than this [1].
_LEAST = 0.1
# A correction asks for so much more than is missing [1].
_MORE = 1.2


class Motors:
    """The constraint of effort limits, of a robot whose base is fixed.

    Attributes:
        limits: (nu,) [Nm or N], infinite where there is none.
    """

    name = "motor"

    def __init__(self, model: ControlModel, limits: np.ndarray) -> None:
        """
        Args:
            model: whose dynamics.
            limits: (nu,) as of the attribute.
        """
        self.limits, self._model = limits, model
        self._some = np.flatnonzero(np.isfinite(limits))
        self._L = limits[self._some]
        self._aimed, self._held = (1.0 - _INSIDE) * self._L, _HELD * self._L
        self._of_path = _OF_PATH * self._L
        self._workspace = model.MakeWorkspace()
        self._state: State | None = None

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

    def _measure(self, state: State) -> None:
        """Takes inertia and bias, once a step."""
        if state is self._state:
            return
        self._state, q, v, model = state, state.q, state.v, self._model
        context = self._workspace.plant_context
        x = np.concatenate(model.in_plant(q, v))
        model.plant.SetPositionsAndVelocities(context, x)
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
        the nominal; else the longest over which they can now; else the present one.

        Args:
            state: whose T is the one that it is known to be safe over [s].
            vdot: (nv,) accelerations of the nominal [rad/s^2 or m/s^2].
            choices: in order, the present T among them [s].
            is_clear: whether the braking path over a longer T violates nothing; one
                over a shorter is a part of the present one.
        """
        self._measure(state)
        found = enough(
            *(self._A, self._b, self._aimed, state.v, vdot, state.n),
            *(np.array(choices), state.period),
        )
        chosen, (q, v) = state.T, self._after(state, state.q, state.v, vdot)
        for T, (now, then) in zip(choices, found, strict=True):
            if T > state.T and not is_clear(T):
                break
            if now and T != state.T:
                now = self._can_brake(state, state.q, state.v, vdot, T)
            if now:
                chosen = T
            if now and then and self._can_brake(state, q, v, vdot, T):
                break
        return chosen

    def _can_brake(self, state, q, v, vdot, T: float) -> bool:
        """Whether torques of `_of_braking` are within the limits."""
        braking, _ = self._of_braking(state, q, v, vdot, T)
        return bool((np.abs(braking) <= self._of_path).all())

    def begin(self, state: State) -> None:
        self._measure(state)
        self._allowed: np.ndarray | None = None

    def rows(self, state: State) -> Rows:
        g, least = motor_rows(
            *(self._A, self._b, self._aimed, state.v, state.prescribed, state.n),
            *(state.T, state.period),
        )
        # What rows lack is to be less than what is asked for ends below the limits.
        rows = hard_rows(g, least)
        return rows._replace(weight=100.0 * rows.weight)

    def examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        with np.errstate(over="ignore", invalid="ignore"):  # beyond all sense
            return self._examine(state, s, correct)

    def _examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        L, vdot = self._L, (s - state.v) / state.T
        q, v = self._after(state, state.q, state.v, vdot)
        tau = np.abs(self._A @ vdot + self._b)
        use = (tau / L).max()
        if use <= _CALM:
            braking = np.concatenate((-v[: state.n] / state.T, vdot[state.n :]))
            use = max(use, (np.abs(self._A @ braking + self._b) / L).max())
        if use <= _CALM:
            return SafetyCheck(True, 1.0 - use)
        for at, rate in (self._after(state, state.q, state.v, vdot, 0.5), (q, v)):
            tau = np.maximum(tau, np.abs(self._torques(at, rate, vdot)))
        over = tau - self._held
        signed, at = np.zeros(len(L)), np.ones(len(L))
        if correct or (over <= 0.0).all():
            signed, at = self._of_braking(state, q, v, vdot, state.T)
        then = np.abs(signed)
        beyond = then - self._of_path
        if not (beyond <= 0.0).all():
            beyond = then - self._allowed_of_braking(state)
        left = 1.0 - max((tau / L).max(), (then / L).max())
        if (over <= 0.0).all() and (beyond <= 0.0).all():  # false of a NaN
            return SafetyCheck(True, left)
        worst = int(np.argmax(np.maximum(over, beyond) / L))
        rows = self._less(state, s, over, signed, beyond, at) if correct else None
        return SafetyCheck(False, left, rows, index=worst)

    def _of_braking(
        self, state: State, q: np.ndarray, v: np.ndarray, vdot: np.ndarray, T: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """(M,) torques of braking over T [s] from a state (nv,), (nv,): signed, the
        largest on the way; (M,) the share w of the speed there.

        Args:
            vdot: (nv,) of which prescribed joints go on by theirs.
        """
        n, period = state.n, state.period
        kappa, slower = 1.0 - 0.5 * (period + state.plant_step) / T, 1.0 - period / T
        signed, at = np.zeros(len(self._L)), np.ones(len(self._L))
        q, v_there, braking, whole = q.copy(), v.copy(), vdot.copy(), v[:n]
        start = q[:n].copy()
        # Each acceleration is held for a period, in which the speed falls.
        farthest = T * np.abs(whole).max(initial=0.0)
        parts = min(1 + int(farthest / _APART), _PARTS)
        for w in np.linspace(1.0, 0.0, parts + 1).tolist():
            braking[:n] = (-w / T) * whole
            for there in (w, w * slower):
                q[:n] = start + (kappa * T * (1.0 - there)) * whole
                v_there[:n] = there * whole
                tau = self._torques(q, v_there, braking)
                # A torque that is none (NaN) stays.
                more = ~(np.abs(tau) <= np.abs(signed))
                signed[more], at[more] = tau[more], w
        return signed, at

    def _allowed_of_braking(self, state: State) -> np.ndarray:
        """The limits; where the present braking path needs more, that."""
        if self._allowed is None:
            still = np.zeros_like(state.v)
            needed, _ = self._of_braking(state, state.q, state.v, still, state.T)
            self._allowed = np.maximum(self._of_path, np.abs(needed))
        return self._allowed

    def _after(
        self,
        state: State,
        q: np.ndarray,
        v: np.ndarray,
        vdot: np.ndarray,
        share: float = 1.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """(nv,), (nv,) where vdot (nv,) leads from a state in a share of a period."""
        t = share * state.period
        return q + t * v + 0.5 * t * (t + state.plant_step) * vdot, v + t * vdot

    def _torques(self, q: np.ndarray, v: np.ndarray, vdot: np.ndarray) -> np.ndarray:
        """(M,) of the motors with limits, at a state (nv,), (nv,), of vdot (nv,)."""
        model, context = self._model, self._workspace.plant_context
        x = np.concatenate(model.in_plant(q, v))
        model.plant.SetPositionsAndVelocities(context, x)
        _, in_plant = model.in_plant(q, vdot)
        return model.inverse_dynamics(self._workspace, in_plant)[self._some]

    def _less(
        self,
        state: State,
        s: np.ndarray,
        over: np.ndarray,
        braking: np.ndarray,
        beyond: np.ndarray,
        at: np.ndarray,
    ) -> Rows:
        """Rows for smaller torques, and for speeds from which braking takes less.

        Args:
            s: (nv,) that was examined.
            over: (M,) torques beyond the limits in the period [Nm or N].
            braking, beyond, at: (M,) of braking after it, signed; beyond; and at which
                share of the speed.
        """
        n, T = state.n, state.T
        A = self._A[:, :n]
        size = np.sqrt((A**2).sum(axis=1)) + 1e-12
        tau = self._A @ ((s - state.v) / T) + self._b
        g, least = [], []
        for sign, by in (
            (-np.sign(tau) * (over > 0.0), over * T),
            (
                np.sign(braking) * (beyond > 0.0),
                beyond / (at + _LEAST) * T * T / state.period,
            ),
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
