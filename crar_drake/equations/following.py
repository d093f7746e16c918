"""A robot that is where the lookahead law's acceleration leads, over many steps.

Nothing is simulated, so that nothing happens between two steps, and all of a frame's
are one call. The law's steps are those of `equations.lookahead`, on the pairs of shapes
that can influence them: those near enough for the whole frame are found once in it, and
of these in each step those near enough for the step (`equations.nearby`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from crar_drake.equations.admission import AS_NOMINAL, step_reach, travel
from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.free_joints import PLAIN
from crar_drake.equations.kinematics import Measured
from crar_drake.equations.lookahead import LookaheadMemory, lookahead_step
from crar_drake.equations.lookahead_rows import with_resting
from crar_drake.equations.nearby import (
    pairs_within,
    reaching_within,
    still_clear,
    watched_nearby,
)
from crar_drake.equations.prediction import next_state
from crar_drake.equations.references import BlendStart, Targets

# Pairs are looked for so much farther away than the first step needs, and this besides
# [rad or m], for the steps that come after.
_AHEAD, _BESIDES = 1.5, 0.01

_NOTHING = np.zeros(0)
_NOTHING_ASKED = np.zeros((0, 7))


class OnTheWay(NamedTuple):
    """A state, and what the step that led there leaves to the next.

    Attributes:
        q, v: (nq,), (nv,) in the plant's order.
        memory: of that step; of a start v itself and zeros.
    """

    q: np.ndarray
    v: np.ndarray
    memory: LookaheadMemory


class FollowerNumbers(NamedTuple):
    """What a follower is made with.

    Attributes:
        robot: holds a `Robot` in two configurations, of a root that does not float,
            with a row for each pair of capsules and spheres.
        law: holds the `LookaheadNumbers` of these.
        prescribed: (nq_p + 2 n_p,) of the prescribed joints, see `Targets`.
        start: of no blending, which is over.
        expected: a step's |s| is first taken to be at most so many times |q_dot|.
        on_it, along_it: nearer to the reference than this is on it [rad or m, and per
            second].
    """

    robot: Held
    law: Held
    prescribed: np.ndarray
    start: BlendStart
    expected: float
    on_it: float
    along_it: float


class Followed(NamedTuple):
    """What some steps led to.

    Attributes:
        end: the state.
        steps: how many were taken.
        asked: how often the law was asked for them.
        how, share, clear: the worst of how they were admitted, of `admit`.
    """

    end: OnTheWay
    steps: int
    asked: int
    how: float
    share: float
    clear: bool


@compiled
def is_on(now: OnTheWay, q: np.ndarray, v: np.ndarray, follower: Held) -> bool:
    """Whether the robot is where, and as fast as, a reference (n,), (n,) is."""
    numbers = follower.value
    r = numbers.robot.value
    for i in range(len(q)):
        # Not the other way round: a NaN is nowhere.
        near = abs(now.q[r.positions[i]] - q[i]) <= numbers.on_it
        if not (near and abs(now.v[r.order[i]] - v[i]) <= numbers.along_it):
            return False
    return True


@compiled
def far_for_a_while(
    q: np.ndarray, v: np.ndarray, to: np.ndarray, numbers: FollowerNumbers
) -> np.ndarray:
    """How far the joints are expected to go till the end of a frame, (nv,) [rad or m].

    Args:
        q, v: (nq,), (nv,) state, in the order of the equations.
        to: (n,) where the reference leads.
        numbers: of the follower.
    """
    law = numbers.law.value
    ahead = law.gains.T + numbers.expected * step_reach(v, law.admission)
    far = ahead * np.abs(v)
    far[: len(to)] += np.abs(to - q[: len(to)])
    return _AHEAD * far + _BESIDES


@compiled
def near_for_a_while(
    q: np.ndarray, far: np.ndarray, numbers: FollowerNumbers
) -> tuple[np.ndarray, Held, Held]:
    """The pairs that can influence steps as long as no joint goes farther than `far`.

    Args:
        q: (nq,) positions in the plant's order.
        far: (nv,) how far the joints go from there, braking paths and the steps that
            are looked at included, in the order of the equations.
        numbers: of the follower.

    Returns:
        (N,) their rows; the robot and the law's numbers of these alone.
    """
    law = numbers.law.value
    least = max(law.gains.influence_distance, law.admission.floor)
    r = numbers.robot.value
    reaches = reaching_within(q[r.positions], far, law.reaches)
    enough = least + travel(far, reaches)
    rows, _, robot, some = pairs_within(q, enough, numbers.robot, numbers.law)
    return rows, robot, some


@compiled
def follow_steps(
    begin: OnTheWay,
    targets: np.ndarray,
    q_d: np.ndarray,
    v_d: np.ndarray,
    until_on_it: bool,
    watched: np.ndarray,
    follower: Held,
) -> Followed:
    """The law's next steps.

    Args:
        begin: the state.
        targets: (K, layout.size) of the tasks, see `TaskLayout`.
        q_d, v_d: (K, n), (K, n) the reference itself.
        until_on_it: whether to end before the first step where the robot is on it.
        watched: (Nr,) bool, which pairs of shapes were looked at by the law: more are
            marked.
        follower: holds `FollowerNumbers`.

    Returns:
        After at most K steps. Where an acceleration is not finite, they end with that.
    """
    numbers = follower.value
    r, law = numbers.robot.value, numbers.law.value
    T, period, n = law.gains.T, law.gains.period, r.n
    q, v, memory = begin.q, begin.v, begin.memory
    how, share, clear, steps, asked = AS_NOMINAL, 1.0, True, 0, 0
    # Of the pairs that are near for a while none has been found yet.
    middle, far = q[r.positions], np.full(len(v), -1.0)
    for k in range(len(targets)):
        now = OnTheWay(q, v, memory)
        if until_on_it and is_on(now, q_d[k], v_d[k], follower):
            break
        here, moving = q[r.positions], v[r.order]
        braking, fastest = T * np.abs(moving), numbers.expected * np.abs(v)
        measured = Measured(with_resting(q, v, r, T), v, _NOTHING_ASKED)
        wanted = Targets(
            targets[k], numbers.prescribed, _NOTHING, numbers.start, (1.0, 0.0, 0.0)
        )
        while True:
            beyond = step_reach(v, law.admission) * fastest[r.order]
            if (np.abs(here - middle) + braking + beyond > far).any():
                middle = here
                far = np.maximum(
                    far_for_a_while(here, moving, q_d[-1], numbers), braking + beyond
                )
                rows, robot, some = near_for_a_while(q, far, numbers)
            near, room, watching, its_law = watched_nearby(q, v, fastest, robot, some)
            watched[rows[near]] = True
            found = lookahead_step(measured, wanted, watching, its_law, memory)
            vdot, _, _, _, slip, _, plan, _, admission, _ = found
            asked += 1
            s = v + T * vdot
            if not np.isfinite(vdot).all():
                return Followed(
                    OnTheWay(q, vdot, memory), steps, asked, how, share, clear
                )
            beyond = step_reach(v, law.admission) * np.abs(s[r.order])
            covered = (np.abs(here - middle) + braking + beyond <= far).all()
            if covered and still_clear(here, moving, s[r.order], room, some):
                break
            fastest = np.maximum(fastest, 2.0 * np.abs(s))
        how, share = max(how, admission[0]), min(share, admission[1])
        clear = clear and admission[3] == 1.0
        # Rows are those of other pairs in the next step: nothing is known of them.
        memory = LookaheadMemory(
            moving[:n], vdot[r.order][:n], slip, memory.weighed, plan
        )
        q, v = next_state(q, v, vdot, period, period, PLAIN)
        steps += 1
    return Followed(OnTheWay(q, v, memory), steps, asked, how, share, clear)
