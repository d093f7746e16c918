"""Attacks on the filter of joint commands: starts, and policies that want anything.

A policy is asked each period for what it wants, and knows the command before. As an
episode of `attacks`, it depends on nothing but its case and its lineage.
"""

from collections.abc import Callable

import numpy as np

from benchmarks.adversary import starts
from benchmarks.adversary.drive import Drive
from benchmarks.adversary.judge import Judge
from crar_drake.law.safety_filter import NOMINAL, FilterCommand, SafetyFilter
from crar_drake.robot.model import ControlModel
from crar_drake.robot.workspace import Workspace

# What is given to the filter: its keywords.
Wish = dict[str, np.ndarray]
Policy = Callable[[int, np.ndarray, np.ndarray], Wish]

STARTS = ("at_rest", "at_rest", "fast", "touching", "beyond")


class Room:
    """What policies are made of: a robot's joints, a clock and dice.

    Attributes:
        rng: the episode's dice.
        n: number of joints.
        lower, upper: (n,) between which positions are drawn [rad or m].
        period: of the filter [s].
        start: (n,) where the episode begins.
        poses: (8, n) clear poses.
    """

    def __init__(
        self, filter: SafetyFilter, judge: Judge, start: np.ndarray, rng
    ) -> None:
        model = filter.model
        self.rng, self.n, self.period = rng, model.n, filter.period
        self.start = start
        self.lower = np.maximum(model.lower, start - np.pi)
        self.upper = np.minimum(model.upper, start + np.pi)
        self.poses = starts.random_poses(model, judge, rng, 8)

    def anywhere(self) -> np.ndarray:
        """(n,) positions within the limits, and beyond by a fifth of their range."""
        beyond = 0.2 * (self.upper - self.lower)
        return self.rng.uniform(self.lower - beyond, self.upper + beyond)

    def steps(self, least: float, most: float) -> int:
        """A number of periods that last between so many seconds."""
        return max(1, round(self.rng.uniform(least, most) / self.period))


def jumps(room: Room) -> Policy:
    """Anywhere, every 20 to 400 ms."""
    every, wanted = room.steps(0.02, 0.4), room.start

    def policy(k: int, q: np.ndarray, v: np.ndarray) -> Wish:
        nonlocal wanted
        if k % every == 0:
            wanted = room.anywhere()
        return {"q": wanted}

    return policy


def noise(room: Room) -> Policy:
    """A random walk, of 1 mrad to 0.3 rad a step."""
    step, wanted = 10.0 ** room.rng.uniform(-3.0, -0.5), room.start

    def policy(k: int, q: np.ndarray, v: np.ndarray) -> Wish:
        nonlocal wanted
        wanted = wanted + room.rng.normal(0.0, step, room.n)
        return {"q": wanted}

    return policy


def sines(room: Room) -> Policy:
    """Each joint swings at 0.2 to 10 Hz, by up to its range."""
    rng, n = room.rng, room.n
    size = rng.uniform(0.0, 1.0, n) * rng.choice([0.1, 0.5]) * (room.upper - room.lower)
    omega = 2.0 * np.pi * rng.uniform(0.2, 1.0, n) * rng.choice([1.0, 3.0, 10.0])
    phase = rng.uniform(0.0, 2.0 * np.pi, n)

    def policy(k: int, q: np.ndarray, v: np.ndarray) -> Wish:
        now = np.sin(omega * k * room.period + phase) - np.sin(phase)
        return {"q": room.start + size * now}

    return policy


def between(room: Room) -> Policy:
    """Straight from one clear pose to another, through whatever is in between, with
    least jerk, in 50 ms to 1 s; then at once to the next."""
    a, b = room.start, room.poses[0]
    begun, count = 0, room.steps(0.05, 1.0)

    def policy(k: int, q: np.ndarray, v: np.ndarray) -> Wish:
        nonlocal a, b, begun, count
        if k - begun > count:
            a, b = b, room.poses[room.rng.integers(len(room.poses))]
            begun, count = k, room.steps(0.05, 1.0)
        x = (k - begun) / count
        return {"q": a + x**3 * (10.0 - 15.0 * x + 6.0 * x**2) * (b - a)}

    return policy


def velocities(room: Room) -> Policy:
    """Random velocities, held for 10 to 200 ms, with noise."""
    every, size = room.steps(0.01, 0.2), 10.0 ** room.rng.uniform(-1.0, 1.5)
    wanted = np.zeros(room.n)

    def policy(k: int, q: np.ndarray, v: np.ndarray) -> Wish:
        nonlocal wanted
        if k % every == 0:
            wanted = room.rng.normal(0.0, size, room.n)
        return {"v": wanted + room.rng.normal(0.0, 0.1 * size, room.n)}

    return policy


def accelerations(room: Room) -> Policy:
    """Random accelerations of up to some thousand rad/s^2, held for 5 to 100 ms."""
    every, size = room.steps(0.005, 0.1), 10.0 ** room.rng.uniform(0.0, 3.5)
    wanted = np.zeros(room.n)

    def policy(k: int, q: np.ndarray, v: np.ndarray) -> Wish:
        nonlocal wanted
        if k % every == 0:
            wanted = room.rng.normal(0.0, size, room.n)
        return {"a": wanted}

    return policy


def on_and_on(room: Room) -> Policy:
    """From the command before it speeds up along a line, as long as that is let
    through, and turns about when it is not: as fast as a wanted command may be."""
    way, growth = room.rng.normal(size=room.n), 10.0 ** room.rng.uniform(0.0, 2.5)
    last = room.start

    def policy(k: int, q: np.ndarray, v: np.ndarray) -> Wish:
        nonlocal way, last
        if not np.array_equal(q, last):
            way = room.rng.normal(size=room.n)
        last = q + room.period * (v + room.period * growth * way)
        return {"q": last}

    return policy


def with_velocity(room: Room) -> Policy:
    """Jumps, with a velocity that has nothing to do with them."""
    jump = jumps(room)

    def policy(k: int, q: np.ndarray, v: np.ndarray) -> Wish:
        return jump(k, q, v) | {"v": room.rng.normal(0.0, 10.0, room.n)}

    return policy


def lost(room: Room) -> Policy:
    """Another policy with NaN and infinities for 1 to 50 periods, again and again."""
    inner = (sines, noise, between, velocities)[room.rng.integers(4)](room)
    until, bad = 0, False

    def policy(k: int, q: np.ndarray, v: np.ndarray) -> Wish:
        nonlocal until, bad
        if k >= until:
            bad, until = not bad, k + int(room.rng.integers(1, 50))
        wish = inner(k, q, v)
        if not bad:
            return wish
        some = room.rng.random(room.n) < 0.3
        some[room.rng.integers(room.n)] = True
        value = room.rng.choice([np.nan, np.inf, -np.inf])
        return {name: np.where(some, value, x) for name, x in wish.items()}

    return policy


def huge(room: Room) -> Policy:
    """Numbers of all sizes, up to 1e308."""

    def policy(k: int, q: np.ndarray, v: np.ndarray) -> Wish:
        name = ("q", "v", "a")[room.rng.integers(3)]
        size = 10.0 ** room.rng.uniform(-10.0, 308.0)
        return {name: size * room.rng.uniform(-1.0, 1.0, room.n)}

    return policy


def changing(room: Room) -> Policy:
    """Another policy every 1 to 40 periods."""
    makers = (jumps, noise, sines, between, velocities, accelerations, on_and_on)
    inner, until = sines(room), 0

    def policy(k: int, q: np.ndarray, v: np.ndarray) -> Wish:
        nonlocal inner, until
        if k >= until:
            inner = makers[room.rng.integers(len(makers))](room)
            until = k + int(room.rng.integers(1, 40))
        return inner(k, q, v)

    return policy


POLICIES: dict[str, Callable[[Room], Policy]] = {
    maker.__name__: maker
    for maker in (
        *(jumps, noise, sines, between, velocities, accelerations),
        *(on_and_on, with_velocity, lost, huge, changing),
    )
}


def drive_filter(
    filter: SafetyFilter, judge: Judge, policy: str, num_steps: int, seed: int
) -> Drive:
    """An episode: a policy in front of the filter, whose state is its own command.

    Args:
        filter: begun anew here.
        judge: of the same robot, all joints of which count.
        policy: one of `POLICIES`.
        num_steps: periods.
        seed: of the dice.

    Raises:
        AssertionError: a command that is said to be the wanted one is another.
    """
    rng = np.random.default_rng(seed)
    model, parameters = filter.model, filter.parameters
    workspace = model.MakeWorkspace()
    kind = STARTS[rng.integers(len(STARTS))]
    of = (model, judge, rng)
    if kind == "fast":
        q, v = starts.fast(*of, parameters.T)
    elif kind == "touching":
        q, v = starts.touching(*of, parameters.safety_distance)
    else:
        q, v = getattr(starts, kind)(*of)
    room = Room(filter, judge, q, rng)
    wants = POLICIES[policy](room)
    filter.reset(q, v)
    states = np.empty((2, num_steps + 1, model.n))
    states[:, 0] = q, v
    done, T, within = Drive(states[0], states[1]), [], False
    with np.errstate(all="ignore"):
        for k in range(num_steps):
            wish = wants(k, states[0, k], states[1, k])
            command = filter(**wish)
            report = command.report
            states[:, k + 1] = command.q, command.v
            T.append(report.T)
            # A start may ask for more than motors can.
            if parameters.effort_limits and within:
                of = states[:, k : k + 2], command.a
                done.overloaded += _overloads(model, workspace, *of)
            if report.how == NOMINAL:
                name = "q" if "q" in wish else "v" if "v" in wish else ""
                if name and not np.array_equal(getattr(command, name), wish[name]):
                    raise AssertionError(f"{name} is said to be the wanted one")
            done.admitted[_kind(command)] += 1
            done.unheld += not report.clear
            within |= report.motor_use <= 1.0
    done.T = np.array([T[0], *T])
    return done


def _overloads(
    model: ControlModel, workspace: Workspace, states: np.ndarray, a: np.ndarray
) -> bool:
    """Whether a torque of a (n,) is beyond a motor's limit at two states (2, 2, n)."""
    most = 0.0
    for x in np.concatenate(states, axis=1):
        model.plant.SetPositionsAndVelocities(workspace.plant_context, x)
        torque = model.inverse_dynamics(workspace, a)
        most = max(most, np.abs(torque / model.actuator_limits).max())
    return not most <= 1.0 + 1e-6


def _kind(command: FilterCommand) -> int:
    """Nominal, corrected, scaled or braking."""
    return {NOMINAL: 0, "corrected": 1}.get(command.report.how, 2)
