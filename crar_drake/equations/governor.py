"""A governor for targets: bounds on their speed and acceleration.

The law takes a target at its word: one that jumps asks for as much torque as the jump
is far. The governor stands before it. Of the target [x_d; v_d; a_d] of each task it
makes a governed one [p; v; a] with |v| <= V and |a| <= A (norms over the three
components; of a pose the orientation and the position each for itself), which follows
the given one as fast as that allows, and is the given one itself wherever it can be.

Its only state is what it said one period h before, [p0; v0; a0].

1. *Pass.* The target is passed as it is, bit for bit, if an admissible step leads
   there: |v_d| <= V, |a_d| <= A, and

       |x_d - p0| <= V h,              |v_d - v0| <= A h,
       |x_d - p0 - h v0| <= A h^2/2,   |x_d - p0 - h v_d| <= A h^2/2.

   By Taylor's theorem every motion within the bounds fulfils all of them, at any
   period: it goes through without lag. Conversely, whatever is passed has second
   differences of its positions within A.

2. *Chase.* Else the governed target is where it said that it would be,

       p = p0 + h v0 + h^2/2 a0,   v = v0 + h a0,

   and says an acceleration a that leads onto the target. With x^, v^ the target one
   period on, and G = x^ - p - h (v + v^)/2 the gap then if v^ were the velocity then,
   it wants the velocity v^ + r G/|G| at the end of the period, where

       r^2 + c h r = 2 c |G|.

   This is the switching curve r^2 = 2 c d of the time-optimal double integrator (see
   e.g. Bryson and Ho, Applied Optimal Control, 3.9) for the gap d = |G| - h r/2 at the
   end of the period, not at its beginning: a state on the curve is on the curve again
   a period later, so that it neither chatters nor overshoots, and it meets rule 1 in
   its last step. (Zanasi, Lo Bianco and Tonielli, Nonlinear filters for the generation
   of smooth trajectories, Automatica 36, 2000, and Han's tracking differentiator do
   the like for scalars.) c = 0.9 (A - |a_d|), but at least A/10, is how fast the
   governed target brakes relative to the given one; the rest of A is a reserve for
   velocities across the gap.
   r is lessened where the velocity would be beyond V, and the change of the velocity
   where it would be beyond A h.

Where it chases, what it says is consistent: a step's position and velocity are the
integral of what the step before said (if that was the target's and leads beyond V, of
as much of it as does not). For the step onto the target it says the mean acceleration.
On the sphere, G is a rotation vector, by the shorter way; from 180 degrees it takes one
of the two ways, and keeps it.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.equations.compilation import compiled
from crar_drake.equations.quaternions import turn_between, turned, turned_on
from crar_drake.equations.tasks import TaskRows, num_rows
from crar_drake.equations.vectors import dot

# Bounds that a target keeps but for rounding are kept.
_ROUNDING = 1e-6
# Of positions [m] and of rotation vectors [rad], for each unit of their size.
_RESOLUTION = 1e-14
# The shares of the acceleration that brake: of what the target leaves, and at least.
_SHARE, _LEAST_SHARE = 0.9, 0.1


class TargetBounds(NamedTuple):
    """What a governed target keeps to; infinite for no bound, but not all of them."""

    speed: float  # [m/s]
    acceleration: float  # [m/s^2]
    angular_speed: float  # [rad/s]
    angular_acceleration: float  # [rad/s^2]


@compiled
def govern_tasks(
    desired: np.ndarray,
    before: np.ndarray,
    rows: TaskRows,
    bounds: TargetBounds,
    h: float,
) -> np.ndarray:
    """The governed targets of this instant, (size,) [x; v; a].

    Args:
        desired: (size,) [x_d; v_d; a_d] as given, see `TaskLayout`. Where it has a
            quaternion of zero length, that task is left as it is.
        before: (size,) what this function returned one period before; or
            `start_governor`.
        rows: which rows belong to which task; joints are passed as they are.
        h: control period [s].
    """
    governed = desired.copy()
    m = num_rows(rows)
    at_v = len(desired) - 2 * m
    # The entries of a task are side by side.
    V, A = bounds.speed, bounds.acceleration
    if np.isfinite(V) or np.isfinite(A):
        for i in range(0, len(rows.linear_rows), 3):
            at_x, k = rows.position_entries[i], at_v + rows.linear_rows[i]
            x, v, a = slice(at_x, at_x + 3), slice(k, k + 3), slice(k + m, k + m + 3)
            governed[x], governed[v], governed[a] = govern_position(
                desired[x], desired[v], desired[a], before[x], before[v], before[a],
                V, A, h,
            )  # fmt: skip
    V, A = bounds.angular_speed, bounds.angular_acceleration
    if np.isfinite(V) or np.isfinite(A):
        for i in range(len(rows.angular_rows) // 3):
            at_x, k = rows.quaternion_entries[4 * i], at_v + rows.angular_rows[3 * i]
            x, v, a = slice(at_x, at_x + 4), slice(k, k + 3), slice(k + m, k + m + 3)
            if not np.any(desired[x]):
                continue
            governed[x], governed[v], governed[a] = govern_orientation(
                desired[x], desired[v], desired[a], before[x], before[v], before[a],
                V, A, h,
            )  # fmt: skip
    return governed


@compiled
def start_governor(
    pose: np.ndarray,
    velocity: np.ndarray,
    rows: TaskRows,
    bounds: TargetBounds,
    h: float,
) -> np.ndarray:
    """What the governor would have said a period before, to be here now.

    Args:
        pose: (size,) [x; 0; 0] of the tasks as measured, see `TaskLayout.pack`.
        velocity: (m,) of the tasks [rad/s, m/s]; what is beyond the bounds is cut.
        rows, bounds, h: as of `govern_tasks`.

    Returns:
        (size,) the argument `before` of `govern_tasks`.
    """
    before = pose.copy()
    at_v = len(pose) - 2 * len(velocity)
    for i in range(len(rows.linear_rows) // 3):
        x = rows.position_entries[3 * i : 3 * i + 3]
        at = rows.linear_rows[3 * i : 3 * i + 3]
        v = _at_most(velocity[at], bounds.speed)
        before[at_v + at] = v
        before[x] = pose[x] - h * v
    for i in range(len(rows.angular_rows) // 3):
        x = rows.quaternion_entries[4 * i : 4 * i + 4]
        at = rows.angular_rows[3 * i : 3 * i + 3]
        v = _at_most(velocity[at], bounds.angular_speed)
        before[at_v + at] = v
        before[x] = turned(pose[x], -h * v)
    return before


@compiled
def govern_position(
    x_d: np.ndarray,
    v_d: np.ndarray,
    a_d: np.ndarray,
    p0: np.ndarray,
    v0: np.ndarray,
    a0: np.ndarray,
    V: float,
    A: float,
    h: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The governed target of a position: p, v, a (3,).

    Args:
        x_d, v_d, a_d: (3,) target [m], its velocity and its acceleration.
        p0, v0, a0: (3,) what this function returned one period before.
        V, A: bounds on speed and acceleration; one of them may be infinite.
        h: control period [s].
    """
    size = _length(x_d) + _length(p0)
    if _is_within(v_d, a_d, V, A) and _is_step(
        x_d - p0, x_d - p0 - h * v0, x_d - p0 - h * v_d, v_d - v0, size, 0.0, V, A, h
    ):
        return x_d, v_d, a_d
    a0, v = _go_on(v0, a0, V, h)
    p = p0 + h * v0 + (0.5 * h * h) * a0
    v_next, a_next = _at_most(v_d, V), _at_most(a_d, A)
    x_next = x_d + h * v_next + (0.5 * h * h) * a_next
    v_next = _at_most(v_next + h * a_next, V)
    gap = x_next - p
    if _is_step(gap, gap - h * v, gap - h * v_next, v_next - v, size, 0.0, V, A, h):
        return p, v, (v_next - v) / h
    G = gap - (0.5 * h) * (v + v_next)
    return p, v, _chase(G, v, v_next, _length(a_next), V, A, h)


@compiled
def govern_orientation(
    x_d: np.ndarray,
    v_d: np.ndarray,
    a_d: np.ndarray,
    p0: np.ndarray,
    v0: np.ndarray,
    a0: np.ndarray,
    V: float,
    A: float,
    h: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The governed target of an orientation.

    Args:
        x_d: (4,) target, a quaternion (w, x, y, z) of any length but zero; v_d, a_d
            (3,) its angular velocity [rad/s] and acceleration [rad/s^2], in W.
        p0, v0, a0: (4,), (3,), (3,) what this function returned one period before.
        V, A: bounds on speed and acceleration; one of them may be infinite.
        h: control period [s].

    Returns:
        Quaternion (4,), angular velocity (3,) and acceleration (3,), in W.
    """
    # Seen from a frame that turns, an acceleration is another: A h^2/2 and so much.
    turn = h * (_length(v0) + _length(v_d))
    if _is_within(v_d, a_d, V, A) and _is_step(
        turn_between(p0, x_d),
        turn_between(turned(p0, h * v0), x_d),
        turn_between(turned(p0, h * v_d), x_d),
        v_d - v0,
        np.pi,
        turn,
        V,
        A,
        h,
    ):
        return x_d, v_d, a_d
    a0, v = _go_on(v0, a0, V, h)
    p = turned_on(p0, v0, a0, h)
    v_next, a_next = _at_most(v_d, V), _at_most(a_d, A)
    x_next = turned_on(x_d, v_next, a_next, h)
    v_next = _at_most(v_next + h * a_next, V)
    if _is_step(
        turn_between(p, x_next),
        turn_between(turned(p, h * v), x_next),
        turn_between(turned(p, h * v_next), x_next),
        v_next - v,
        np.pi,
        h * (_length(v) + _length(v_next)),
        V,
        A,
        h,
    ):
        return p, v, (v_next - v) / h
    G = turn_between(turned(p, (0.5 * h) * (v + v_next)), x_next)
    return p, v, _chase(G, v, v_next, _length(a_next), V, A, h)


@compiled
def _is_within(v: np.ndarray, a: np.ndarray, V: float, A: float) -> bool:
    """Whether a target's own velocity and acceleration are within the bounds."""
    slack = 1.0 + _ROUNDING
    return _length(v) <= slack * V and _length(a) <= slack * A


@compiled
def _is_step(
    move: np.ndarray,
    from_v0: np.ndarray,
    from_v1: np.ndarray,
    change: np.ndarray,
    size: float,
    turn: float,
    V: float,
    A: float,
    h: float,
) -> bool:
    """Whether a step of a period is one of a motion within the bounds.

    Args:
        move: (3,) from its start to its end [m or rad].
        from_v0, from_v1: (3,) less h times the velocity at its start and its end.
        change: (3,) of the velocity.
        size: of the numbers that the first three are differences of.
        turn: share by which A h^2/2 may be more.
    """
    slack, rounding = 1.0 + _ROUNDING, _RESOLUTION * size
    bend = slack * (1.0 + turn) * 0.5 * A * h * h + rounding
    return (
        _length(change) <= slack * A * h
        and _length(move) <= slack * V * h + rounding
        and _length(from_v0) <= bend
        and _length(from_v1) <= bend
    )


@compiled
def _go_on(
    v0: np.ndarray, a0: np.ndarray, V: float, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """The acceleration of the last period, and the velocity at its end.

    A target that was passed may have said one that leads beyond V.
    """
    v = v0 + h * a0
    if _length(v) <= V:
        return a0, v
    v = _at_most(v, V)
    return (v - v0) / h, v


@compiled
def _chase(
    G: np.ndarray,
    v: np.ndarray,
    v_next: np.ndarray,
    a_target: float,
    V: float,
    A: float,
    h: float,
) -> np.ndarray:
    """The acceleration (3,) that leads onto the target, see the module.

    Args:
        G: (3,) gap at the end of the period if the velocity then is the target's.
        v: (3,) velocity now.
        v_next: (3,) of the target at the end of the period, within V.
        a_target: magnitude of the target's acceleration, within A.
    """
    # More than this is never needed: any velocity becomes any other in a period.
    A = min(A, 4.0 * V / h)
    distance = _length(G)
    w = v_next
    if distance > 0.0:
        n = G / distance
        c = max(_SHARE * (A - a_target), _LEAST_SHARE * A)
        # The positive root, without the difference of nearly equal numbers.
        b = 0.5 * c * h
        r = 2.0 * c * distance / (b + np.sqrt(b * b + 2.0 * c * distance))
        along = dot(v_next, n)
        room = max(V * V - dot(v_next, v_next), 0.0)
        r = min(r, np.sqrt(along * along + room) - along)
        w = v_next + r * n
    return _at_most((_at_most(w, V) - v) / h, A)


@compiled
def _length(x: np.ndarray) -> float:
    return np.sqrt(dot(x, x))


@compiled
def _at_most(x: np.ndarray, bound: float) -> np.ndarray:
    """x (3,), shortened to the bound where it is longer."""
    length = _length(x)
    return x * (bound / length) if length > bound else x
