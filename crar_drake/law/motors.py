"""Motors: torques are within their limits, in the period and in braking after it.

Lemma: braking keeps the torques of braking. By (A1) with s = 0 the states of braking,
k periods on, are

    q + kappa T (1 - w) q_dot,  w q_dot,      w = (1 - period / T)^k,

and so they are of the next braking path, for larger k. A state is safe if on this curve
the torques of q_ddot = -w q_dot / T are within the limits, down to w = 0: what holds
the robot where it comes to rest. The deceleration of prescribed joints is not counted:
no torso has the torque to stop a pelvis that runs within T. A step is safe if its
torques are within the limits now, in the middle and at the end of the period, and it
leads to a safe state. A motor that the present braking path takes beyond its limit
already is taken no farther.

What is asked between places of the curve, and within a period, is observed (see
`docs/measurements/adversary.md`), not proved. Braking more slowly takes less:
`braking_time_constant` chooses T once a step.

Rows, linear in s: each motor's torque is within its limit, and so that braking a period
on needs at most RESERVE of it, or where it needs more already, no more than a period of
braking leaves.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from crar_drake.law.compilation import Held, compiled, hold
from crar_drake.law.dynamics import inertia_matrix, joint_torques
from crar_drake.law.prediction import state_within
from crar_drake.law.projection import Rows, hard_rows
from crar_drake.law.step import SafetyCheck, State
from crar_drake.law.vectors import product, times, to_places
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
# Torques of braking are looked at where a joint has moved by this [rad or m], but in no
# more parts of the way than these.
_APART, _PARTS = 0.12, 8
# A correction takes the share of the speed for no less than this [1].
_LEAST = 0.1
# A correction asks for so much more than is missing [1].
_MORE = 1.2


class Efforts(NamedTuple):
    """What the torques of M motors with limits follow from."""

    dynamics: Held  # of `Dynamics`
    share: np.ndarray  # (M, nv) of each joint's torque, in the plant's order
    order: np.ndarray  # (nv,) of `Robot`
    positions: np.ndarray  # (nv,)
    limits: np.ndarray  # (M,) [Nm or N]
    aimed: np.ndarray  # (M,) of `Motors`
    n: int  # joints whose deceleration is counted: the controlled ones
    period: float  # of the controller [s]
    plant_step: float  # as of `State` [s]


class Motors:
    """The constraint of effort limits, of a robot whose base is fixed.

    Attributes:
        aimed: (M,) what the M motors with limits are aimed to stay below [Nm or N].
    """

    name = "motor"

    def __init__(
        self, model: ControlModel, limits: np.ndarray, period: float, plant_step: float
    ) -> None:
        """
        Args:
            model: whose dynamics.
            limits: (nu,) [Nm or N], infinite where there is none.
            period, plant_step: as of `State` [s].

        Raises:
            ModelError: the plant has a force that is not known.
        """
        some = np.flatnonzero(np.isfinite(limits))
        share, limits = model.effort_of_joints[some], limits[some]
        self.aimed = (1.0 - _INSIDE) * limits
        of = share, model.order, model.positions, limits, self.aimed, model.n
        self._efforts = hold(Efforts(model.dynamics, *of, period, plant_step))
        self._at: tuple[bytes, bytes] | None = None

    def affine(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A (M, nv), b (M,) of `affine_torques` at a state (nv,), (nv,), once a
        step."""
        if (at := (q.tobytes(), v.tobytes())) != self._at:
            self._at, self._affine = at, affine_torques(q, v, self._efforts)
        return self._affine

    def braking_time_constant(
        self,
        state: State,
        vdot: np.ndarray,
        choices: Sequence[float],
        is_clear: Callable[[float], bool],
    ) -> float:
        """The shortest T over which the motors can brake, now and with a reserve after
        the nominal; else the longest over which they can now; else that over which they
        lack the least.

        Args:
            state: whose T is the one that it is known to be safe over [s].
            vdot: (nv,) accelerations of the nominal [rad/s^2 or m/s^2].
            choices: in order, the present T among them [s].
            is_clear: whether the braking path over a longer T violates nothing; one
                over a shorter is a part of the present one.
        """
        q, v = state.q, state.v
        given = *self.affine(q, v), v, vdot, np.array(choices)
        uses = braking_use(*given, self._efforts)
        chosen, least, lacks = None, state.T, np.inf
        for T, (now, then) in zip(choices, uses.tolist(), strict=True):
            if T > state.T and not is_clear(T):
                break
            if now < lacks:
                least, lacks = T, now
            can = now <= 1.0
            if can and T != state.T:
                can = can_brake(q, v, vdot, 0.0, T, self._efforts)
            if can:
                chosen = T
            if can and then <= RESERVE:
                if can_brake(q, v, vdot, 1.0, T, self._efforts):
                    break
        return least if chosen is None else chosen

    def is_safe(self, q: np.ndarray, v: np.ndarray, T: float) -> bool:
        """That T is theirs to choose, see `braking_time_constant`."""
        return True

    def begin(self, state: State) -> None:
        self.affine(state.q, state.v)

    def rows(self, state: State) -> Rows:
        g, least = motor_rows(
            *(*self._affine, state.v, state.prescribed, state.T, self._efforts)
        )
        # What rows lack is to be less than what is asked for ends below the limits.
        rows = hard_rows(g, least)
        return rows._replace(weight=100.0 * rows.weight)

    def examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        safe, left, worst, g, least = check_motors(
            *(state.q, state.v, s, *self._affine, state.T, correct, self._efforts)
        )
        if safe:
            return SafetyCheck(True, left)
        joint = int(np.argmax(self._efforts.value.share[worst]))
        rows = hard_rows(g, least) if correct else None
        return SafetyCheck(False, left, rows, index=joint)


@compiled
def torques(
    q: np.ndarray, v: np.ndarray, vdot: np.ndarray, efforts: Efforts
) -> np.ndarray:
    """(M,) of the motors, at a state (nv,), (nv,), of vdot (nv,) [Nm or N]."""
    q = to_places(q, efforts.positions)
    v, vdot = to_places(v, efforts.order), to_places(vdot, efforts.order)
    return times(efforts.share, joint_torques(q, v, vdot, efforts.dynamics.value))


@compiled
def affine_torques(
    q: np.ndarray, v: np.ndarray, efforts: Held
) -> tuple[np.ndarray, np.ndarray]:
    """A (M, nv), b (M,): torques are A q_ddot + b at a state (nv,), (nv,)."""
    of = efforts.value
    H = inertia_matrix(to_places(q, of.positions), of.dynamics.value)
    return product(of.share, H[:, of.order]), torques(q, v, np.zeros(len(v)), of)


@compiled
def braking_torques(
    q: np.ndarray, v: np.ndarray, T: float, efforts: Efforts
) -> tuple[np.ndarray, np.ndarray]:
    """(M,) torques of braking of n joints over T [s] from a state (nv,), (nv,):
    signed, the largest on the way; (M,) the share w of the speed there."""
    period = efforts.period
    kappa, slower = 1.0 - 0.5 * (period + efforts.plant_step) / T, 1.0 - period / T
    M = len(efforts.limits)
    signed, at = np.zeros(M), np.ones(M)
    brakes = v.copy()
    brakes[efforts.n :] = 0.0
    farthest, parts = T * np.abs(v).max(), _PARTS
    if farthest < _PARTS * _APART:
        parts = min(1 + int(farthest / _APART), _PARTS)
    for k in range(parts + 1):
        w = 1.0 - k / parts
        # Each acceleration is held for a period, in which the speed falls.
        for end in range(2):
            left = w * slower if end else w
            if end and w == 0.0:
                break
            there = q + (kappa * T * (1.0 - left)) * v
            tau = torques(there, left * v, (-w / T) * brakes, efforts)
            for m in range(M):
                if not abs(tau[m]) <= abs(signed[m]):  # a NaN stays
                    signed[m], at[m] = tau[m], w
    return signed, at


@compiled
def can_brake(
    q: np.ndarray,
    v: np.ndarray,
    vdot: np.ndarray,
    share: float,
    T: float,
    efforts: Held,
) -> bool:
    """Whether `braking_torques` are within the limits, from where vdot (nv,) leads in a
    share of a period."""
    of = efforts.value
    if share > 0.0:
        q, v = state_within(q, v, vdot, share * of.period, of.plant_step)
    signed, _ = braking_torques(q, v, T, of)
    return (np.abs(signed) <= _OF_PATH * of.limits).all()


@compiled
def check_motors(
    q: np.ndarray,
    v: np.ndarray,
    s: np.ndarray,
    A: np.ndarray,
    b: np.ndarray,
    T: float,
    correct: bool,
    efforts: Held,
) -> tuple[bool, float, int, np.ndarray, np.ndarray]:
    """Whether torques are within the limits, in the period of a step s and in braking
    after it.

    Args:
        q, v, s: (nv,), (nv,), (nv,) state and step, controlled joints first.
        A, b: of `affine_torques`.
        correct: whether rows are asked for.

    Returns:
        Whether they are; the share of a limit that is left at least; the motor that is
        farthest beyond, or -1; g (k, n), least (k,) for smaller torques, and for speeds
        from which braking takes less.
    """
    of = efforts.value
    L, M, n, period = of.limits, len(of.limits), of.n, of.period
    vdot, nothing = (s - v) / T, (np.zeros((0, n)), np.zeros(0))
    there, rate = state_within(q, v, vdot, period, of.plant_step)
    now = times(A, vdot) + b
    tau = np.abs(now)
    middle, halfway = state_within(q, v, vdot, 0.5 * period, of.plant_step)
    tau = np.maximum(tau, np.abs(torques(middle, halfway, vdot, of)))
    tau = np.maximum(tau, np.abs(torques(there, rate, vdot, of)))
    over = tau - _HELD * L
    signed, at = np.zeros(M), np.ones(M)
    if correct or (over <= 0.0).all():
        signed, at = braking_torques(there, rate, T, of)
    then = np.abs(signed)
    beyond = then - _OF_PATH * L
    if not (beyond <= 0.0).all():
        # Where the present braking path needs more, that is allowed.
        needed, _ = braking_torques(q, v, T, of)
        beyond = then - np.maximum(_OF_PATH * L, np.abs(needed))
    left = 1.0 - max((tau / L).max(), (then / L).max())
    if (over <= 0.0).all() and (beyond <= 0.0).all():  # false of a NaN
        return True, left, -1, *nothing
    worst = np.argmax(np.maximum(over, beyond) / L)
    if not correct:
        return False, left, worst, *nothing
    g, least, count = np.zeros((2 * M, n)), np.zeros(2 * M), 0
    for m in range(M):
        size, moves = 1e-12, 0.0
        for i in range(n):
            size += A[m, i] ** 2
            moves += A[m, i] * s[i]
        size = np.sqrt(size)
        for kind in range(2):
            if kind == 0 and over[m] > 0.0:
                sign, by = -np.sign(now[m]), over[m] * T
            elif kind == 1 and beyond[m] > 0.0:
                sign = np.sign(signed[m])
                by = beyond[m] / (at[m] + _LEAST) * T * T / period
            else:
                continue
            for i in range(n):
                g[count, i] = sign * A[m, i] / size
            least[count] = (sign * moves + _MORE * by) / size
            count += 1
    return False, left, worst, g[:count], least[:count]


@compiled
def braking_use(
    A: np.ndarray,
    b: np.ndarray,
    v: np.ndarray,
    vdot: np.ndarray,
    choices: np.ndarray,
    efforts: Held,
) -> np.ndarray:
    """(K, 2) the largest share of what is aimed at that braking over each T takes: now;
    and after vdot (nv,), held for a period.

    Args:
        A, b: (M, nv), (M,) of the torques A q_ddot + b.
        v: (nv,) velocities.
        choices: (K,) of T [s].
    """
    n, L, period = efforts.value.n, efforts.value.aimed, efforts.value.period
    found, then = np.empty((len(choices), 2)), v + period * vdot
    v = v.copy()
    v[n:] = then[n:] = 0.0
    for k in range(len(choices)):
        found[k, 0] = (np.abs(times(A, v / -choices[k]) + b) / L).max()
        found[k, 1] = (np.abs(times(A, then / -choices[k]) + b) / L).max()
    return found


@compiled
def motor_rows(A, b, v, prescribed, T, efforts):
    """g (2 M, n), least (2 M,), see the top of the file; arguments as of `braking_use`.

    Args:
        prescribed: (nv - n,) s of the joints that are not controlled.
    """
    of = efforts.value
    M, n, L, share = len(A), of.n, of.aimed, of.period / T
    g, least = np.zeros((2 * M, n)), np.empty(2 * M)
    for i in range(M):
        # The torque of standing still here, of the prescribed joints alone, of braking.
        still, brake, moving, size = b[i], b[i], 0.0, 1e-24
        for j in range(n):
            moving += A[i, j] * v[j]
            size += A[i, j] ** 2
        for j in range(A.shape[1]):
            if j < n:
                brake -= A[i, j] * v[j] / T
            else:
                still += A[i, j] * (prescribed[j - n] - v[j]) / T
        size = np.sqrt(size)
        left = min(abs(brake), abs(brake - share * (brake - b[i])))
        room = max(RESERVE * L[i], left)
        low = min(max(b[i] + (brake - room) / share, -L[i]), L[i])
        high = min(max(b[i] + (brake + room) / share, -L[i]), L[i])
        for j in range(n):
            g[i, j], g[M + i, j] = A[i, j] / size, -A[i, j] / size
        least[i] = (T * (low - still) + moving) / size
        least[M + i] = -(T * (high - still) + moving) / size
    return g, least


@compiled
def share_of_nominal(
    vdot: np.ndarray, nominal: np.ndarray, qdot: np.ndarray, T: float
) -> float:
    """How much is left of the way from braking to the nominal: theta, if it was scaled.

    Args:
        vdot, nominal: accelerations, first those of the joints that brake [rad/s^2].
        qdot: (n,) velocities of the joints that brake [rad/s].
        T: [s].

    Returns:
        1 - |nominal - vdot| / |nominal - braking|, in [0, 1], below 1 if they differ.
    """
    if (vdot == nominal).all():
        return 1.0
    way, lost = 0.0, 0.0
    for i in range(len(qdot)):
        way += (nominal[i] + qdot[i] / T) ** 2
        lost += (nominal[i] - vdot[i]) ** 2
    if lost >= way:  # also where braking is nominal, and there is no way
        return 0.0
    return min(1.0 - np.sqrt(lost / way), 1.0 - 1e-16)


@compiled
def clip_torque(tau: np.ndarray, limits: np.ndarray) -> tuple[np.ndarray, float]:
    """A torque within the effort limits, where the acceleration is not to change.

    Args:
        tau: (nu,) torque [Nm or N].
        limits: (nu,) effort limits, infinite where there is none.

    Returns:
        (nu,) the torque, clipped; and by which share of its limit the worst actuator
        was beyond it [1], 0 if none was.
    """
    excess = np.abs(tau / limits).max() - 1.0
    if excess <= 1e-12:  # a rounding error of the limit is no excess
        excess = 0.0
    return np.minimum(np.maximum(tau, -limits), limits), excess
