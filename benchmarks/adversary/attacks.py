"""The attacks: each makes an episode, a clear start and targets for K control steps.

An episode depends on nothing but its case and its lineage, a list of integers: the
first is the seed it was drawn with, the others (of the search) are mutations of the
numbers it is made of.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.adversary import starts
from benchmarks.adversary.judge import Judge
from benchmarks.adversary.targets import (
    Path,
    Turn,
    add,
    approach,
    chirp,
    pack,
    slowed,
    steps,
    waves,
)
from crar_drake.errors import ScenarioError
from crar_drake.law.parameters import (
    LEVELS,
    METRICS,
    LookaheadParameters,
    PaperGains,
    PaperParameters,
    Parameters,
)
from crar_drake.robot.model import ControlModel

GAINS = (0.25, 10.0)  # between which the gains are scaled
POSTURE_GAIN = 50.0  # [1/s^2]
DRAWS = 20  # of parameters that do not go with the period


@dataclass
class Episode:
    """A start, and what the law is given at each of K steps.

    Attributes:
        q, v: (nq,), (nv,) the start.
        tasks: (K, layout.size); prescribed: (K, 3 n_p); posture: (K, n) or (K, 0).
        parameters: of the law.
        switches: step from which on the law has other parameters.
    """

    q: np.ndarray
    v: np.ndarray
    tasks: np.ndarray
    prescribed: np.ndarray
    posture: np.ndarray
    parameters: Parameters
    switches: dict[int, Parameters] = field(default_factory=dict)


class Stage:
    """What attacks are made of: a robot, its places, a clock and dice.

    Attributes:
        model, judge: of the robot.
        parameters: of the law; an attack may replace them.
        time: (K,) of the control steps [s].
        rng: the episode's dice.
        num_points, num_turns: tasks with a position, with an orientation.
        places: (N, 3) middles of all watched shapes at the start [m].
    """

    def __init__(
        self,
        model: ControlModel,
        judge: Judge,
        parameters: Parameters,
        num_steps: int,
        lineage: Sequence[int],
    ) -> None:
        self.model, self.judge = model, judge
        self.lineage = [int(x) for x in lineage]
        self.rng = np.random.default_rng(self.lineage[0])
        # What a robot is asked to do at first: blended in from where it is, or not.
        blend = float(self.rng.choice([0.0, 0.05, 0.5]))
        self.parameters = replace(parameters, blend_time=blend)
        self.time = parameters.period * np.arange(num_steps)
        layout = model.layout
        self.num_points = len(layout.linear_tasks)
        self.num_turns = len(layout.angular_tasks)
        self._place_at(*starts.at_rest(model, judge, self.rng))
        self._look_around()

    def begin(self, kind: str) -> None:
        """Starts "fast", "touching", "singular" or "beyond" limits instead."""
        robot = self.model, self.judge, self.rng
        if kind == "fast":
            found = starts.fast(*robot, self.parameters.T)
        elif kind == "touching":
            found = starts.touching(*robot, self.parameters.safety_distance)
        else:
            found = getattr(starts, kind)(*robot)
        self._place_at(*found)
        self._look_around()

    def _look_around(self) -> None:
        start, end = self.judge.axes(self.q[None])
        self.places = 0.5 * (start[0] + end[0])

    def _place_at(self, q: np.ndarray, v: np.ndarray) -> None:
        layout = self.model.layout
        self.q, self.v = q, v
        here = self.model.tasks_at(q)
        self.points = here[layout.position_entries].reshape(-1, 3)
        self.quaternions = here[layout.quaternion_entries].reshape(-1, 4)

    def inside(self, shape: tuple[int, ...] = ()) -> np.ndarray:
        """Points (*shape, Nl, 3) inside the robot or near it, at random."""
        rng = self.rng
        chosen = self.places[
            rng.integers(len(self.places), size=(*shape, self.num_points))
        ]
        return chosen + rng.normal(scale=0.03, size=chosen.shape)

    def turns(self, frequency: float = 2.0, amplitude: float = 2.0) -> Turn:
        """Frames that swing about random axes."""
        n = self.num_turns
        rng = self.rng
        angle = waves(
            self.time,
            rng.uniform(0.0, amplitude, (n, 1)),
            rng.uniform(0.3, 1.0, (n, 1)) * frequency,
            rng.uniform(0.0, 2.0 * np.pi, (n, 1)),
        )
        return Turn(self.quaternions, self._axes(), angle)

    def jumping_turns(self, times: np.ndarray) -> Turn:
        """Frames that jump to random orientations."""
        values = self.rng.uniform(-np.pi, np.pi, (len(times), self.num_turns))
        return Turn(self.quaternions, self._axes(), steps(self.time, values, times))

    def _axes(self) -> np.ndarray:
        axis = self.rng.normal(size=(self.num_turns, 3))
        return axis / np.linalg.norm(axis, axis=1, keepdims=True)

    def times(self, shortest: float, longest: float) -> np.ndarray:
        """When something changes, from 0 on."""
        end = self.time[-1] + longest
        count = int(end / shortest) + 1
        gaps = self.rng.uniform(shortest, longest, count)
        return np.concatenate([[0.0], np.cumsum(gaps)])

    def jumps(self, shortest: float = 0.02, longest: float = 0.4) -> tuple[Path, Turn]:
        """Targets that jump into the robot, or anywhere near."""
        times = self.times(shortest, longest)
        values = self.inside((len(times),))
        anywhere = self.rng.random(values.shape[:2]) < 0.3
        values[anywhere] += self.rng.normal(scale=0.6, size=(anywhere.sum(), 3))
        return steps(self.time, values, times), self.jumping_turns(times)

    def sines(self, low: float = 1.0, high: float = 10.0) -> tuple[Path, Turn]:
        """Points that swing through the robot, at `low` to `high` [Hz]."""
        rng, n = self.rng, self.num_points
        frequency = np.exp(rng.uniform(np.log(low), np.log(high), (n, 1, 1)))
        swing = waves(
            self.time,
            rng.uniform(0.02, 0.3, (n, 3, 1)),
            np.broadcast_to(frequency, (n, 3, 1)),
            rng.uniform(0.0, 2.0 * np.pi, (n, 3, 1)),
        )
        swing[0][...] += self.inside()
        return swing, self.turns(float(frequency.max()) if n else high)

    def still(self) -> np.ndarray:
        """Prescribed joints (K, 3 n_p) that stay where they start."""
        held = np.concatenate(
            [self.q[self.model.prescribed], np.zeros(2 * self.model.n_p)]
        )
        return np.tile(held, (len(self.time), 1))

    def episode(
        self,
        points: Path,
        turn: Turn,
        prescribed: np.ndarray | None = None,
        posture: np.ndarray | None = None,
    ) -> Episode:
        """Packs it all."""
        return Episode(
            self.q,
            self.v,
            pack(self.model.layout, points, turn),
            self.still() if prescribed is None else prescribed,
            np.zeros((len(self.time), 0)) if posture is None else posture,
            self.parameters,
        )


def teleport(stage: Stage) -> Episode:
    """Targets jump into the body and away, every 20 to 400 ms."""
    return stage.episode(*stage.jumps())


def sine(stage: Stage) -> Episode:
    """Targets swing inside the body at 1 to 10 Hz."""
    return stage.episode(*stage.sines())


def sweep(stage: Stage) -> Episode:
    """Targets swing through the body, faster and faster: 0.5 to 10 Hz."""
    rng, n = stage.rng, stage.num_points
    amplitude = rng.uniform(0.05, 0.4, (n, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (n, 3))
    path = chirp(stage.time, amplitude, 0.5, 10.0, phase)
    path[0][...] += stage.inside()
    return stage.episode(path, stage.turns(5.0))


def smooth(stage: Stage) -> Episode:
    """Smooth targets through the body, at up to 1 m/s (even seeds) or 8 m/s.

    The search keeps the nastiest, and mutates the numbers that they are made of.
    """
    n, W = stage.num_points, 3
    size = n * (2 + 9 * W)
    genes = np.random.default_rng([stage.lineage[0], 1]).random(size)
    for mutation in stage.lineage[1:]:
        rng = np.random.default_rng(mutation)
        width = 10.0 ** rng.uniform(-3.0, -0.5)
        moved = rng.random(size) < rng.choice([0.05, 0.2, 1.0])
        # Reflected at both ends, lest they gather there.
        genes = np.abs(genes + moved * rng.normal(scale=width, size=size))
        genes = 1.0 - np.abs(1.0 - genes % 2.0)
    fastest = 1.0 if stage.lineage[0] % 2 == 0 else 8.0
    place, offset = genes[:n], genes[n : 2 * n]
    amplitude, frequency, phase = genes[2 * n :].reshape(3, n, 3, W)
    highest = 2.0 if fastest == 1.0 else 6.0
    swing = waves(
        stage.time,
        0.35 * amplitude,
        0.2 * (highest / 0.2) ** frequency,
        2.0 * np.pi * phase,
    )
    swing = slowed(swing, fastest)
    at = np.minimum((place * len(stage.places)).astype(int), len(stage.places) - 1)
    swing[0][...] += stage.places[at] + 0.1 * (offset[:, None] - 0.5)
    return stage.episode(swing, stage.turns(1.0))


def fast_start(stage: Stage) -> Episode:
    """The robot is as fast as its clear braking path allows, and is to go on."""
    stage.parameters = replace(stage.parameters, blend_time=0.0)
    stage.begin("fast")
    if stage.rng.random() < 0.5:
        return stage.episode(*stage.jumps(0.1, 0.6))
    model = stage.model
    v = model.evaluate(model.MakeWorkspace(), stage.q, stage.v).v
    ahead = stage.points + stage.rng.uniform(0.1, 0.5) * v[
        model.layout.linear_rows
    ].reshape(-1, 3)
    span = stage.rng.uniform(0.05, 0.3)
    path = approach(stage.time, stage.points, ahead, span)
    return stage.episode(path, stage.turns(3.0))


def touching(stage: Stage) -> Episode:
    """From rest at the floor, to the last digits, jumps or sines."""
    stage.parameters = replace(stage.parameters, blend_time=0.0)
    stage.begin("touching")
    return stage.episode(
        *(stage.jumps() if stage.rng.random() < 0.5 else stage.sines())
    )


def stretched(stage: Stage) -> Episode:
    """From a singular pose, targets beyond the reach and swinging through the pose."""
    stage.begin("singular")
    rng, n = stage.rng, stage.num_points
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    swing = waves(
        stage.time,
        (direction * rng.uniform(0.02, 0.5, (n, 1)))[:, :, None],
        np.broadcast_to(rng.uniform(0.5, 6.0, (n, 1, 1)), (n, 3, 1)),
        np.zeros((n, 3, 1)),
    )
    outwards = rng.choice([0.0, 0.3, 1.0]) * direction
    swing[0][...] += stage.points + outwards
    return stage.episode(swing, stage.turns(4.0))


def several(stage: Stage) -> Episode:
    """All points at once to one place (chest, head, hips, ...), or changing places."""
    rng, n = stage.rng, stage.num_points
    if rng.random() < 0.6 or n < 2:
        aim = np.tile(stage.places[rng.integers(len(stage.places))], (n, 1))
    else:
        aim = np.roll(stage.points, 1, axis=0)
    path = approach(stage.time, stage.points, aim, rng.uniform(0.05, 0.8))
    shake = waves(
        stage.time,
        rng.choice([0.0, 0.03, 0.1]) * rng.uniform(-1.0, 1.0, (n, 3, 1)),
        np.broadcast_to(rng.uniform(0.5, 8.0), (n, 3, 1)),
        rng.uniform(0.0, 2.0 * np.pi, (n, 3, 1)),
    )
    return stage.episode(add(path, shake), stage.turns(2.0))


def squeeze(stage: Stage) -> Episode:
    """Points go back and forth between two parts of the robot, or two posts."""
    rng, n = stage.rng, stage.num_points
    first, second = stage.inside(), stage.inside()
    half = 0.5 * (second - first)
    swing = waves(
        stage.time,
        (half * rng.uniform(0.1, 1.0, (n, 1)))[:, :, None],
        np.broadcast_to(rng.uniform(0.3, 4.0, (n, 1, 1)), (n, 3, 1)),
        rng.uniform(0.0, 2.0 * np.pi, (n, 1, 1)),
    )
    swing[0][...] += 0.5 * (first + second)
    return stage.episode(swing, stage.turns(2.0))


def lost(stage: Stage) -> Episode:
    """Swinging targets that are NaN for a while, again and again."""
    episode = stage.episode(*stage.sines(0.5, 5.0))
    times = stage.times(0.03, 0.5)
    away = np.searchsorted(times, stage.time, side="right") % 2 == 0
    episode.tasks[away] = np.nan
    return episode


def moving(stage: Stage) -> Episode:
    """Prescribed joints swing at up to 3 m/s, the world and the targets do not."""
    return _swinging(stage, 0.3)


def beyond(stage: Stage) -> Episode:
    """Joints start beyond their limits; prescribed ones are there, too, and go on."""
    stage.begin("beyond")
    return _swinging(stage, float(stage.rng.choice([0.0, 0.3, 2.0])))


def _swinging(stage: Stage, farthest: float) -> Episode:
    """Prescribed joints swing by up to `farthest` [rad or m] under jumps or sines."""
    rng, n_p = stage.rng, stage.model.n_p
    frequency = rng.uniform(0.3, 4.0, (n_p, 1))
    amplitude = rng.uniform(0.2, 3.0, (n_p, 1)) / (2.0 * np.pi * frequency)
    swing = waves(
        stage.time,
        np.minimum(amplitude, farthest),
        frequency,
        rng.choice([0.0, np.pi], (n_p, 1)),
    )
    swing[0][...] += stage.q[stage.model.prescribed]
    points, turn = stage.sines(0.3, 4.0) if rng.random() < 0.5 else stage.jumps()
    return stage.episode(points, turn, prescribed=np.hstack(swing))


def switched(stage: Stage) -> Episode:
    """The law is replaced by another in mid-motion, whose T is no longer."""
    rng, p = stage.rng, stage.parameters
    points, turn = stage.jumps() if rng.random() < 0.5 else stage.sines()
    episode = stage.episode(points, turn)
    T, span = p.T, len(stage.time)
    for step in sorted(rng.integers(1, span, int(rng.integers(1, 6))).tolist()):
        T = max(p.period, T * float(rng.choice([1.0, rng.uniform(0.3, 1.0)])))
        other = _drawn(rng, p, T)
        blend = float(rng.choice([0.0, 0.05]))
        episode.switches[step] = replace(other, blend_time=blend)
    return episode


def slow(stage: Stage) -> Episode:
    """Control periods from the case's up to T, and gains that bear them; half of the
    laws that would plan do not, and have a longer T."""
    rng, p = stage.rng, stage.parameters
    if p.plans and rng.random() < 0.5:
        p = replace(p, nominal=PaperGains())
    T = p.T
    share = 1.0 if rng.random() < 0.3 else rng.random()
    period = min(round(p.period * (T / p.period) ** share, 3), T)
    softer = min(1.0, 0.015 / period)

    own = isinstance(p, PaperParameters)
    if not p.plans:
        g = p if own else p.nominal
        g = replace(g, K=g.K * softer, Kp=g.Kp * softer**2, Gv=g.Gv * softer)
        p = g if own else replace(p, nominal=g)
    others = {} if own else {"braking_time": T}
    stage.parameters = replace(p, period=period, **others)
    stage.time = stage.parameters.period * np.arange(len(stage.time))
    points, turn = stage.jumps() if rng.random() < 0.5 else stage.sines(0.3, 4.0)
    return stage.episode(points, turn)


def gains(stage: Stage) -> Episode:
    """All parameters drawn: half of the laws that would plan do so in other ways, the
    others do not, with gains times 0.25 to 10, together or each for itself."""
    rng, p = stage.rng, stage.parameters
    T = max(p.period, 10.0 ** rng.uniform(-3.0, -0.7))
    stage.parameters = _drawn(rng, p, T if rng.random() < 0.5 else None)
    points, turn = stage.jumps() if rng.random() < 0.5 else stage.sines()
    return stage.episode(points, turn)


def _drawn(rng: np.random.Generator, p: Parameters, T: float | None) -> Parameters:
    """Other parameters with that T [s], which go with the period."""
    for _ in range(DRAWS):
        other = _drawn_once(rng, p, T)
        with suppress(ScenarioError):
            other.validate()
            break
    return other


def _drawn_once(rng: np.random.Generator, p: Parameters, T: float | None) -> Parameters:
    if isinstance(p, PaperParameters):
        return _other_gains(rng, p)
    if p.plans and rng.random() < 0.5:
        smoothness = 10.0 ** rng.uniform(-6.0, -3.0)
        if rng.random() < 0.3:
            smoothness = str(rng.choice(["closest", "balanced", "calm"]))
        p = replace(p, preview=float(rng.uniform(0.03, 0.3)), smoothness=smoothness)
    else:
        p = replace(p, nominal=_other_gains(rng, p.gains))
    return replace(
        p,
        braking_time=T,
        margin=10.0 ** rng.uniform(-2.9, -1.5),
        limit_margin=10.0 ** rng.uniform(-3.0, -1.0),
        velocity_scale=float(rng.choice([1.0, rng.uniform(0.1, 1.0)])),
        posture_gain=rng.choice([None, 0.0, 10.0 ** rng.uniform(0.0, 3.0)]),
        effort_limits=bool(rng.random() < 0.5),
    )


def _other_gains(rng: np.random.Generator, p: PaperGains) -> PaperGains:
    """Gains of the paper's, and its other numbers."""
    low, high = np.log(GAINS)
    factor = np.exp(rng.uniform(low, high, 4))
    if rng.random() < 0.5:
        factor[:] = factor[0]
    return replace(
        p,
        level=str(rng.choice(LEVELS)),
        K=p.K * factor[0],
        Kp=p.Kp * factor[1],
        Kv=p.velocity_gain * factor[2],
        Gv=p.Gv * factor[3],
        GvN=rng.choice([None, 10.0 ** rng.uniform(0.0, 2.0)]),
        metric=str(rng.choice(METRICS)),
        damping=10.0 ** rng.uniform(-2.0, -0.5),
        rho=10.0 ** rng.uniform(-5.0, 1.0),
        alpha=10.0 ** rng.uniform(0.5, 2.5),
        beta=float(rng.uniform(0.5, 4.0)),
        limit_share=rng.choice([None, rng.random()]),
    )


def posture(stage: Stage) -> Episode:
    """A nominal posture that jumps about, within the limits and beyond."""
    rng, model = stage.rng, stage.model
    if isinstance(stage.parameters, LookaheadParameters):
        stage.parameters = replace(stage.parameters, posture_gain=POSTURE_GAIN)
    times = stage.times(0.05, 0.5)
    lower, upper = np.maximum(model.lower, -np.pi), np.minimum(model.upper, np.pi)
    span = upper - lower
    values = rng.uniform(lower - 0.3 * span, upper + 0.3 * span, (len(times), model.n))
    wanted = steps(stage.time, values, times)[0]
    points, turn = stage.sines(0.5, 3.0)
    return stage.episode(points, turn, posture=wanted)


def wild(stage: Stage) -> Episode:
    """Numbers without sense: kilometres, and velocities that contradict positions."""
    rng = stage.rng
    times = stage.times(stage.parameters.period, 0.3)
    shape = (len(times), stage.num_points, 3)
    scale = 10.0 ** rng.uniform(-1.0, 4.0, (len(times), 1, 1))
    p = steps(
        stage.time, stage.inside((len(times),)) + scale * rng.normal(size=shape), times
    )[0]
    v, a = (
        steps(
            stage.time,
            10.0 ** rng.uniform(-1.0, most, shape) * rng.choice([-1, 1], shape),
            times,
        )[0]
        for most in (3.0, 5.0)
    )
    return stage.episode((p, v, a), stage.jumping_turns(times))


ATTACKS: dict[str, Callable[[Stage], Episode]] = {
    "teleport": teleport,
    "sine": sine,
    "chirp": sweep,
    "search": smooth,
    "fast_start": fast_start,
    "touching": touching,
    "singular": stretched,
    "several": several,
    "squeeze": squeeze,
    "lost": lost,
    "moving": moving,
    "beyond": beyond,
    "switched": switched,
    "slow": slow,
    "gains": gains,
    "posture": posture,
    "wild": wild,
}


def make_episode(
    attack: str,
    model: ControlModel,
    judge: Judge,
    parameters: Parameters,
    num_steps: int,
    lineage: Sequence[int],
) -> Episode:
    """The episode of an attack with that lineage; always the same one."""
    return ATTACKS[attack](Stage(model, judge, parameters, num_steps, lineage))
