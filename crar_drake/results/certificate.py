"""Whether a log's certificate is true: braking paths, judged by the referee.

In the mode "lookahead" a log says of every control step whether its braking path, the
line from q to where the robot would come to rest, keeps a floor, and how near pairs
come on the next one. Here such lines are sampled and each point is judged by the
referee, which shares nothing with the controller. Samples can refute a bound, not
prove it.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from crar_drake.judging.referee import Referee
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.results.log import SimulationLog
from crar_drake.robot.description import LIMIT_TOLERANCE

# Of a braking path, both ends included.
PATH_POINTS = 21

# By so much a distance may be smaller than what is claimed: what the simulation's own
# rounding does to a state. [m]
DISTANCE_TOLERANCE = 1e-6

# Unless it is said how many: about so many steps evenly over the log, and those that
# the log says are the nearest.
_EVENLY = 300
_NEAREST = 100

# Of a control period, that a sample may be beside its tick.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Place:
    """The nearest that a braking path comes."""

    time: float  # when the path begins [s]
    # on it [m]; some larger one, or infinity, if nothing is as near as was asked
    distance: float = math.inf
    pair: tuple[str, str] | None = None  # of links; None if it is infinite


@dataclass
class PathFigures:
    """What braking paths violate."""

    of: int  # number of samples that they were chosen from
    judged: int = 0  # number of paths
    penetrating: int = 0  # paths with a pair at d < 0
    below_floor: int = 0  # paths with a pair nearer than the floor
    # paths whose end, at rest, is beyond a joint limit by more than 1e-6 rad (or m)
    beyond_limit: int = 0
    # the smallest distance of all
    nearest: Place = field(default_factory=lambda: Place(math.nan))
    largest_excess: float = 0.0  # over the paths' ends [rad or m]; 0 if none is outside
    largest_excess_joint: str = ""  # that joint; "" if none


@dataclass
class CertificateVerdict:
    """What the referee says of a log's certificate."""

    floor: float  # that pairs are to keep on a braking path [m]
    every: int  # one in so many control steps was judged, besides the nearest ones
    steps: PathFigures  # the braking paths of the control steps
    # those of the samples in between, where the log is finer. What the certificate says
    # is said of control steps: in between pairs keep off each other on the way, but
    # paths are not promised to keep the floor.
    between: PathFigures
    reported: int = 0  # control steps in the log that say whether they are clear
    reported_unclear: int = 0  # that say that they are not, and claim nothing
    clearance: float = math.inf  # the smallest that is claimed [m]; infinite if none is
    not_clear: int = 0  # judged paths that are claimed to be clear and are not
    not_clear_worst: Place | None = None
    # judged steps whose next path comes nearer than is claimed, and the worst of them,
    # with what was claimed [m]
    undercut: int = 0
    undercut_worst: Place | None = None
    undercut_claim: float = math.nan

    @property
    def true(self) -> bool:
        """Whether nothing refutes what the log claims."""
        return not self.not_clear and not self.undercut

    @property
    def violated(self) -> bool:
        """Whether a control step's path penetrates, or ends beyond a joint limit."""
        return bool(self.steps.penetrating or self.steps.beyond_limit)


def has_certificate(log: SimulationLog) -> bool:
    """Whether a log says anything of braking paths."""
    return bool(np.isfinite(log.admission[:, 3]).any())


def judge_certificate(
    log: SimulationLog,
    referee: Referee,
    parameters: LookaheadParameters,
    plant_step: float,
    every: int | None = None,
) -> CertificateVerdict:
    """Judges a log's braking paths, and what it says of them.

    Of a control step its own path is judged, and the next: of the next step's state as
    the log has it, or, where the log is too coarse for it, of what the commanded
    acceleration leads to.

    Args:
        log: of a run with the constraints "lookahead", of a robot whose base is fixed,
            so that velocities are the rates of positions.
        referee: of the robot; its velocity limits play no part.
        plant_step: the simulated plant's [s], 0 if it was continuous.
        every: of so many control steps one is judged, and of so many samples in
            between; by default as many as make about 300 of each. The 100 nearest
            control steps by what the log says are judged besides.

    Raises:
        ValueError: a state is not finite, or not of the referee's plant.
    """
    paths = _Paths(log, referee, parameters)
    period = parameters.period
    number = np.round(log.time / period)
    at_tick = np.abs(log.time / period - number) < _ROUNDING
    ticks, between = np.flatnonzero(at_tick), np.flatnonzero(~at_tick)
    claims = _claims(log, period, plant_step)
    sample_of = {int(number[k]): int(k) for k in ticks}
    # How near a path may come without contradicting anything.
    bounds = np.full(len(log.time), max(paths.floor, 0.0))
    for k in ticks:
        _, clearance, clear = claims[k]
        following = sample_of.get(int(number[k]) + 1)
        if clear == 1.0 and following is not None and math.isfinite(clearance):
            bounds[following] = max(bounds[following], clearance)

    stride = every or max(1, math.ceil(len(ticks) / _EVENLY))
    # The nearest first: what is farther apart than the nearest is soon passed over.
    chosen = dict.fromkeys(_nearest(log, claims, ticks) + ticks[::stride].tolist())
    verdict = CertificateVerdict(
        paths.floor, stride, PathFigures(len(ticks)), PathFigures(len(between))
    )
    reported = claims[ticks][np.isfinite(claims[ticks, 0])]
    verdict.reported = len(reported)
    verdict.reported_unclear = int(np.count_nonzero(reported[:, 2] == 0.0))
    verdict.clearance = float(reported[reported[:, 2] == 1.0, 1].min(initial=math.inf))
    for k in chosen:
        place = paths.count(k, bounds[k], verdict.steps)
        _, clearance, clear = claims[k]
        if clear != 1.0:
            continue
        if place.distance < paths.floor - DISTANCE_TOLERANCE:
            verdict.not_clear += 1
            worst = verdict.not_clear_worst
            if worst is None or place.distance < worst.distance:
                verdict.not_clear_worst = place
        following = sample_of.get(int(number[k]) + 1)
        if following is not None:
            after = paths.place(following, bounds[following])
        elif plant_step > 0.0:
            after = paths.predicted(k, clearance, period, plant_step)
        else:
            continue
        if after.distance < clearance - DISTANCE_TOLERANCE:
            verdict.undercut += 1
            by = clearance - after.distance
            worst = verdict.undercut_worst
            if worst is None or by > verdict.undercut_claim - worst.distance:
                verdict.undercut_worst, verdict.undercut_claim = after, clearance
    stride = every or max(1, math.ceil(len(between) / _EVENLY))
    for k in between[::stride].tolist():
        paths.count(k, bounds[k], verdict.between)
    return verdict


class _Paths:
    """The braking paths of a log's samples, each judged once."""

    def __init__(
        self, log: SimulationLog, referee: Referee, parameters: LookaheadParameters
    ) -> None:
        self.floor = parameters.safety_distance
        self._log, self._referee = log, referee
        self._horizon = parameters.T
        # Prescribed joints go where they are sent.
        self._limited = np.isin(referee.joint_names, log.controlled_names)
        self._known: dict[int, Place] = {}
        self._smallest = math.inf

    def place(self, k: int, bound: float) -> Place:
        """The nearest of sample k's path, if it is nearer than `bound` [m]."""
        if k not in self._known:
            log = self._log
            self._known[k] = self._nearest(log.time[k], log.q[k], log.v[k], bound)
        return self._known[k]

    def predicted(self, k: int, bound: float, period: float, step: float) -> Place:
        """The same of the state a period after sample k, which the log does not have.

        The plant's steps of the semi-implicit Euler rule, one after the other.
        """
        log = self._log
        q, v = log.q[k], log.v[k]
        for _ in range(max(1, round(period / step))):
            v = v + step * log.desired_acceleration[k]
            q = q + step * v
        return self._nearest(log.time[k] + period, q, v, bound)

    def count(self, k: int, bound: float, figures: PathFigures) -> Place:
        """Adds sample k's path to the figures."""
        place = self.place(k, bound)
        rest = self._log.q[k] + self._horizon * self._log.v[k]
        excess = np.where(self._limited, self._referee.limit_excess(rest), 0.0)
        figures.judged += 1
        figures.penetrating += place.distance < 0.0
        figures.below_floor += place.distance < self.floor - DISTANCE_TOLERANCE
        figures.beyond_limit += bool((excess > LIMIT_TOLERANCE).any())
        if place.distance < figures.nearest.distance:
            figures.nearest = place
        if excess.max() > figures.largest_excess:
            figures.largest_excess = float(excess.max())
            joint = self._referee.joint_names[int(np.argmax(excess))]
            figures.largest_excess_joint = joint
        return place

    def _nearest(
        self, time: float, q: np.ndarray, v: np.ndarray, bound: float
    ) -> Place:
        found, pair = math.inf, None
        bound = max(bound, self._smallest)
        ahead = np.linspace(0.0, 1.0, PATH_POINTS) * self._horizon
        for there in q + np.outer(ahead, v):
            d, which = self._referee.nearest(there, min(bound, found))
            if d < found:
                found, pair = d, which
        self._smallest = min(self._smallest, found)
        return Place(float(time), found, pair)


def _claims(log: SimulationLog, period: float, plant_step: float) -> np.ndarray:
    """(T, 3) how, clearance [m] and clear, of the step that begins at each sample."""
    claims = log.admission[:, [0, 2, 3]].copy()
    if plant_step == 0.0:
        # Of a continuous plant, loggers see the step before, see `CrarController`;
        # the first sample has none before.
        claims[:-1] = claims[1:]
        apart = np.diff(log.time) > period * (1.0 + _ROUNDING)
        claims[np.append(apart, True)] = np.nan
    return claims


def _nearest(log: SimulationLog, claims: np.ndarray, ticks: np.ndarray) -> list[int]:
    """The ticks where the log says that something is nearest."""
    near = np.where(np.isnan(claims[ticks, 1]), math.inf, claims[ticks, 1])
    if log.signed_distances.shape[1]:
        near = np.minimum(near, log.signed_distances[ticks].min(axis=1))
    return ticks[np.argsort(near, kind="stable")[:_NEAREST]].tolist()
