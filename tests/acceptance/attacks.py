"""Hostile targets for a law of tasks, the exact loop that it is made for, a verdict.

In the exact loop the robot does what is commanded: the acceleration is held for a
period, by a continuous plant or in the steps of a discrete one. Everything between two
steps of the law is judged, too.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import product
from judges import RobotJudge

INSTANTS = 5  # of each period of a continuous plant
ROUNDING = 1e-9  # [m], [rad]; in shares of a speed
TORQUE_ROUNDING = 1e-6  # in shares of a limit
MOTOR_TICK = 1e-3 - ROUNDING  # between two torques that motors are given [s]

# Targets (K, 3, P, 3): positions, velocities, accelerations of P points over time.
Attack = Callable[[np.random.Generator, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def judge_of(
    robot: str | Path, *, stands: bool = False, time_step: float = 0.0
) -> RobotJudge:
    """The judge of a robot: from its model file, and names in its description."""
    told = product.facts(robot, stands=stands)
    return RobotJudge(
        *(told.file, told.pairs),
        base=told.base,
        place=told.place,
        turn=told.turn,
        time_step=time_step,
    )


# --- targets ------------------------------------------------------------------------


def teleports(rng, time, home, inside):
    """They jump into the robot, or about, every 30 to 300 ms."""
    jumps = np.concatenate(([0.0], np.cumsum(rng.uniform(0.03, 0.3, 200))))
    at = inside[rng.integers(len(inside), size=(len(jumps), len(home)))]
    at = at + rng.normal(0.0, 0.03, at.shape)
    about = rng.random(at.shape[:2]) < 0.3
    at[about] += rng.normal(0.0, 0.6, (about.sum(), 3))
    found = np.zeros((len(time), 3, *home.shape))
    found[:, 0] = at[np.searchsorted(jumps, time, side="right") - 1]
    return found


def swings(rng, time, home, inside):
    """They swing through the robot at 1 to 8 Hz, with their true derivatives."""
    middle = inside[rng.integers(len(inside), size=len(home))]
    size = rng.uniform(0.05, 0.4, home.shape)
    omega = 2.0 * np.pi * rng.uniform(1.0, 8.0, home.shape)
    turn = omega * time[:, None, None] + rng.uniform(0.0, 2.0 * np.pi, home.shape)
    sine, cosine = size * np.sin(turn), size * np.cos(turn)
    return np.stack([middle + sine, omega * cosine, -(omega**2) * sine], axis=1)


def wild(rng, time, home, inside):
    """Numbers without sense, of up to 1e6, that change every 40 ms."""
    number = (time / 0.04).astype(int)
    shape = (number[-1] + 1, 3, *home.shape)
    size = 10.0 ** rng.uniform(-2.0, 6.0, (shape[0], 1, 1, 1))
    found = size * rng.uniform(-1.0, 1.0, shape)
    found[:, 0] += home
    return found[number]


def lost(rng, time, home, inside):
    """They swing, and every other 30 to 200 ms some of them are no numbers."""
    found = swings(rng, time, home, inside)
    ends = np.cumsum(rng.uniform(0.03, 0.2, 400))
    away = np.searchsorted(ends, time, side="right") % 2 == 1
    found[away, :, rng.integers(len(home))] = rng.choice([np.nan, np.inf])
    return found


ATTACKS: dict[str, Attack] = {
    "teleports": teleports,
    "swings": swings,
    "wild": wild,
    "lost": lost,
}
# The share of a millisecond's torques, while accelerations are held, that may be beyond
# a limit: where joints are so fast that braking alone takes more than the motors have.
MOST_BEYOND = {"teleports": 0.0, "swings": 0.01, "wild": 0.1, "lost": 0.0}


# --- the exact loop -----------------------------------------------------------------


@dataclass
class Run:
    """What a robot did, at instants of all periods.

    Attributes:
        q, v, a: (K, n) the states, and the acceleration from each of them on.
        instants: of each period.
        tick: between two instants [s].
        steps: what the law answered.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    instants: int
    tick: float
    steps: list[product.LawStep]


def run(
    law: product.Law,
    targets: np.ndarray,
    *,
    plant_step: float = 0.0,
    prescribed: np.ndarray | None = None,
    instants: int = INSTANTS,
) -> Run:
    """The exact loop from rest, a row of targets a period.

    Args:
        targets: (K, 3, P, 3).
        plant_step: of the plant [s], 0 if it is continuous.
        prescribed: (K, 3, n_p) of the prescribed joints; else they stay.
        instants: of each period that are kept, of a continuous plant.
    """
    law.restart()
    q, v = law.rest.copy(), np.zeros(len(law.rest))
    if prescribed is not None:
        q[law.prescribed], v[law.prescribed] = prescribed[0, :2]
    count = round(law.period / plant_step) if plant_step else instants
    part = law.period / count
    Q, V, A, steps = [], [], [], []
    for k, row in enumerate(targets):
        given = None if prescribed is None else prescribed[k]
        with np.errstate(over="ignore", invalid="ignore"):
            step = law.step(q, v, *row, prescribed=given)
        steps.append(step)
        for i in range(count):
            Q.append(q)
            V.append(v)
            A.append(step.a)
            if plant_step:
                v = v + part * step.a
                q = q + part * v
            else:
                t = (i + 1) * part
                q = Q[-1 - i] + t * V[-1 - i] + 0.5 * t * t * step.a
                v = V[-1 - i] + t * step.a
        # What the law says of its own step is what comes of it.
        scale = 1.0 + np.abs(v).max()
        assert np.abs(step.next_q - q).max() < ROUNDING * scale
        assert np.abs(step.next_v - v).max() < ROUNDING * scale
    return Run(np.array(Q), np.array(V), np.array(A), count, part, steps)


def attack(
    law: product.Law,
    judge: RobotJudge,
    kind: str,
    seed: int,
    count: int,
    *,
    plant_step: float = 0.0,
    prescribed: np.ndarray | None = None,
) -> Run:
    """An episode of `count` periods under one of ATTACKS."""
    rng = np.random.default_rng([seed, list(ATTACKS).index(kind)])
    inside = judge.segments(law.rest[None]).reshape(-1, 3)
    time = law.period * np.arange(count)
    targets = ATTACKS[kind](rng, time, law.home, inside)
    return run(law, targets, plant_step=plant_step, prescribed=prescribed)


# --- the verdict --------------------------------------------------------------------


def assert_nothing_is_violated(judge: RobotJudge, law: product.Law, found: Run) -> None:
    """Of watched distances, position limits and speed limits, at all instants; and the
    distances that are told are the true ones."""
    assert_apart(judge, found.q)
    told = np.array([step.distances for step in found.steps])
    true = judge.distances(found.q[:: found.instants])
    beyond = told - true  # SceneGraph searches, and stops a little early
    assert beyond.min() > -ROUNDING and beyond.max() < product.MEASURED_WITHIN
    c = law.controlled
    low, high = judge.lower[c] - ROUNDING, judge.upper[c] + ROUNDING
    beyond = (found.q[:, c] < low) | (found.q[:, c] > high)
    assert not beyond.any(), [judge.joints[c[i]] for i in np.argwhere(beyond)[:3, 1]]
    fast = np.abs(found.v[:, c]) / judge.speeds[c]
    assert fast.max() <= 1.0 + ROUNDING, f"{fast.max()} of a speed limit"


def assert_apart(judge: RobotJudge, q: np.ndarray) -> None:
    """All watched pairs keep the safety distance at positions (N, n)."""
    d = judge.distances(q)
    k, pair = np.unravel_index(np.argmin(d), d.shape)
    assert d[k, pair] >= product.SAFETY_DISTANCE - ROUNDING, (
        f"{judge.pairs[pair]}: {1e3 * d[k, pair]:.4f} mm in state {k} of {len(d)}"
    )


def assert_torques_are_kept(
    judge: RobotJudge, law: product.Law, found: Run, kind: str
) -> None:
    """By Drake's inverse dynamics, of joints that are not prescribed: at each step of
    the law, unless it says otherwise, and nearly always while accelerations are held.

    What the law says its motors do is what the accelerations take.
    """
    c, starts = law.controlled, slice(None, None, found.instants)
    efforts = judge.efforts[c]
    taken = judge.torques(found.q, found.v, found.a)[:, c]
    told = np.array([step.torques[c] for step in found.steps])
    kept = np.clip(taken[starts], -efforts, efforts)
    assert np.abs(told - kept).max() < 1e-8 * efforts.max()
    clipped = np.array([step.clipped for step in found.steps])
    beyond = (np.abs(taken) / efforts).max(axis=1) > 1.0 + TORQUE_ROUNDING
    assert not (beyond[starts] & (clipped == 0.0)).any()
    if found.tick >= MOTOR_TICK:
        assert beyond.mean() <= MOST_BEYOND[kind]


def worst_of(judge: RobotJudge, q: np.ndarray, E: float) -> np.ndarray:
    """States (N, n) within E of those given: towards a contact of the nearest pairs."""
    h = 1e-6
    d = judge.distances(q)
    moved = judge.distances(
        (q[:, None] + h * np.eye(q.shape[1])).reshape(-1, q.shape[1])
    )
    towards = np.sign(moved.reshape(*q.shape, -1) - d[:, None])
    near = np.argsort(d, axis=1)[:, :3]
    signs = np.take_along_axis(towards, near[:, None], axis=2)
    return (q[:, None] - E * signs.swapaxes(1, 2)).reshape(-1, q.shape[1])
