"""The step: the nominal, projected; checked; else corrected; else towards braking.

A state is *safe* over T if each constraint finds that its braking path, on which
q_ddot = -q_dot / T, violates nothing. Braking keeps every constraint (each file of one
opens with why), and leads to a safe state. A step is taken only if each constraint
finds that it violates nothing and leads to a safe state; else the robot brakes. So
every later state is safe, for any set of constraints (`docs/theory/theorem.md`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import NamedTuple, Protocol

import numpy as np

from crar_drake.law.projection import Rows, clipped, project, stacked

# How a step was found.
AS_NOMINAL, CORRECTED, SCALED = 0.0, 1.0, 2.0
# A step is corrected so often before it is scaled; and to one of 2^this shares.
CORRECTIONS, BISECTIONS = 4, 6
# Shares of the nominal that are projected anew where less than the first is left of the
# corrected step: a way out that constraints ask for would be scaled as well.
LESS = (0.25, 0.0625, 0.0)
# A row that lacks less is kept [rad/s or m/s].
_ROW_ROUNDING = 1e-9
# A segment is halved so often before its bound counts: each halving leaves a quarter of
# what curvature takes from a part's bound, seven 1/10,000.
_HALVINGS = 7


_NO_ROOT = np.zeros((0, 0))


@cache
def _unbounded(n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.full(n, -np.inf), np.full(n, np.inf)


@dataclass(eq=False)
class State:
    """The robot at a step; of nv joints the first n are controlled.

    Attributes:
        q, v: (nv,), (nv,) positions and velocities, controlled joints first.
        n: how many are controlled.
        T: braking time constant; `take_T` gives another [s].
        period: of the controller [s].
        plant_step: of the plant, at most the period; 0 if it moves continuously [s].
        known: whether the pairs' braking path over T is known to be collision-free.
        make_nominal: T [s] to `nominal`, when that is first asked for.
        nominal: (n,) s to be as near to as is safe [rad/s or m/s].
        prescribed_acceleration: (nv - n,) of the other joints [rad/s^2 or m/s^2]; None
            for 0. Where they brake along it has no effect.
        prescribed: (nv - n,) s of the other joints.
        along: whether these brake, too, whatever is taken; else they go on as they do,
            but brake along where a step is scaled.
        desired: (nv,) s that is taken bit-identical if it is safe; None if none is.
        lowest, highest: (n,) bounds of s, 0 between them; constraints replace them by
            narrower ones.
        keep_rows: whether rows hold for a step that is safe without them, too: there is
            something to be left, as a constraint says; or the nominal asks for it.
        root: (n, n) L, the projection is the nearest in L L^T; (0, 0) for the identity.
    """

    q: np.ndarray
    v: np.ndarray
    n: int
    T: float
    period: float
    plant_step: float
    make_nominal: Callable[[float], np.ndarray]
    known: bool = False
    prescribed_acceleration: np.ndarray | None = None
    keep_rows: bool = False
    along: bool = False
    desired: np.ndarray | None = None
    root: np.ndarray = field(default_factory=lambda: _NO_ROOT)

    def __post_init__(self) -> None:
        self.lowest, self.highest = _unbounded(self.n)

    def take_T(self, T: float, known: bool) -> None:
        """Replaces T [s]; of the path over it is known what is said."""
        self.T, self.known = T, known
        self.__dict__.pop("nominal", None)

    @cached_property
    def nominal(self) -> np.ndarray:
        return self.make_nominal(self.T)

    @property
    def prescribed(self) -> np.ndarray:
        v = self.v[self.n :]
        if self.along:
            return np.zeros_like(v)
        vdot = self.prescribed_acceleration
        return v if vdot is None else v + self.T * vdot

    def segment(self, s: np.ndarray) -> np.ndarray:
        """(nv,) what leads from q over where a step s (nv,) takes the robot, a period
        on, to where it would come to rest from there [rad or m]: a segment, of a robot
        that moves in steps of the period."""
        after = self.v + self.period / self.T * (s - self.v)
        return (self.period + self.T) * after

    def whole(self, s: np.ndarray, share: float = 1.0) -> np.ndarray:
        """(nv,) s of the controlled joints (n,), and a share of the others'."""
        if self.n == len(self.v):
            return s
        return np.concatenate((s, share * self.prescribed))


class SafetyCheck(NamedTuple):
    """What a constraint finds of a step.

    Attributes:
        safe: whether it violates nothing, and leads to a safe state.
        clearance: what is left at least, in the constraint's unit.
        rows: that correct an unsafe step, if it was asked for and there are any.
        joints: (nv,) bool, those whose motion is unsafe; None for all.
        index: of what is violated the most, for the report: an int, or a tuple of
            them; -1 for nothing.
        reason: what is violated, for the report; "" for the constraint's name.
        share: of the step, which may be safe where larger ones are not; 0 if nothing
            is known of one.
    """

    safe: bool
    clearance: float
    rows: Rows | None = None
    joints: np.ndarray | None = None
    index: int | tuple[int, ...] = -1
    reason: str = ""
    share: float = 0.0


class Constraint(Protocol):
    """Something that braking keeps.

    Attributes:
        name: for the report.
    """

    name: str

    def is_safe(self, q: np.ndarray, v: np.ndarray, T: float) -> bool:
        """Whether the braking path over T [s] from a state (nv,), (nv,) violates
        nothing: only then may T grow."""

    def begin(self, state: State) -> None:
        """Takes in the state of a step; may narrow its bounds, or set `keep_rows`."""

    def rows(self, state: State) -> Rows | None:
        """What keeps the nominal off what it comes near to; None of nothing."""

    def examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        """Whether s (nv,) violates nothing, and leads to a safe state.

        Args:
            state: of the step.
            s: (nv,) to be checked [rad/s or m/s].
            correct: whether rows are asked for if it is not safe.
        """


class Step(NamedTuple):
    """The step that is taken.

    Attributes:
        s: (nv,) q_dot + T q_ddot [rad/s or m/s].
        how: AS_NOMINAL, CORRECTED or SCALED.
        share: of the corrected s; 0 is braking [1].
        objections: what each constraint that objected found first, by its name, in the
            order in which they did.
        clearances: of each constraint, by name, where it is known.
    """

    s: np.ndarray
    how: float
    share: float
    objections: dict[str, SafetyCheck]
    clearances: dict[str, float]


def examine(
    constraints: Sequence[Constraint],
    state: State,
    s: np.ndarray,
    correct: bool = False,
) -> tuple[dict[str, SafetyCheck], dict[str, float]]:
    """Asks each constraint about s (nv,); until one objects, unless rows are wanted.

    Returns:
        Objections and clearances, as of `Step`; safe without any objection.
    """
    objections, clearances = {}, {}
    for constraint in constraints:
        check = constraint.examine(state, s, correct)
        clearances[constraint.name] = check.clearance
        if not check.safe:
            objections[constraint.name] = check
            if not correct:
                break
    return objections, clearances


def step(state: State, constraints: Sequence[Constraint]) -> Step:
    """The step nearest to `state.nominal` that every constraint finds safe.

    `state.desired` is taken bit-identical if it is safe, and where something is to be
    left if it keeps the rows that ask for it. Else the nominal within its bounds is
    examined before any rows are asked for: most steps need none.
    """
    for constraint in constraints:
        constraint.begin(state)
    asked = _rows(state, constraints) if state.keep_rows else None
    objections: dict[str, SafetyCheck] = {}
    desired = state.desired
    if desired is not None and (asked is None or _keeps(asked, desired[: state.n])):
        objections, clearances = examine(constraints, state, desired)
        if not objections:
            return Step(desired, AS_NOMINAL, 1.0, objections, clearances)
    if asked is None:
        s = state.whole(clipped(state.nominal, state.lowest, state.highest))
        if desired is None or not np.array_equal(s, desired):
            found, clearances = examine(constraints, state, s)
            if not found:
                return Step(s, CORRECTED, 1.0, objections, clearances)
            objections = {**found, **objections}
        asked = _rows(state, constraints)
    rows, how = list(asked), AS_NOMINAL
    for k in range(CORRECTIONS + 1):
        s = _projected(state, 1.0, rows)
        found, clearances = examine(constraints, state, s, correct=k < CORRECTIONS)
        if not found:
            return Step(s, how, 1.0, objections, clearances)
        if how == AS_NOMINAL:
            first = s, found
        how, objections = CORRECTED, {**found, **objections}
        more = [each.rows for each in found.values() if each.rows]
        if not more:
            break
        rows += more
    # Corrections that lead nowhere contradict each other.
    s, share, clearances = _towards_braking(state, constraints, *first, asked)
    return Step(s, SCALED, share, objections, clearances)


def _rows(state: State, constraints: Sequence[Constraint]) -> list[Rows]:
    """What all constraints ask of the nominal."""
    asked = [constraint.rows(state) for constraint in constraints]
    return [rows for rows in asked if rows is not None and len(rows.least)]


def _keeps(asked: Sequence[Rows], s: np.ndarray) -> bool:
    """Whether s (n,) keeps all rows."""
    return all((rows.g @ s >= rows.least - _ROW_ROUNDING).all() for rows in asked)


def _projected(state: State, share: float, rows: Sequence[Rows]) -> np.ndarray:
    """(nv,) nearest to a share of the nominal."""
    nominal = share * state.nominal
    if not rows:
        s = clipped(nominal, state.lowest, state.highest)
    else:
        s = project(nominal, *stacked(rows), state.lowest, state.highest, state.root)
    return state.whole(s, share)


def _towards_braking(
    state: State,
    constraints: Sequence[Constraint],
    s: np.ndarray,
    found: dict[str, SafetyCheck],
    asked: Sequence[Rows],
) -> tuple[np.ndarray, float, dict[str, float]]:
    """A share of s (nv,) that is safe: of the joints whose motion is not, or of all; or
    what the projection makes of less. Braking is safe, and needs no check.

    Returns:
        (nv,) the step; the share; clearances, empty of braking.
    """
    # Who objects is asked first: the others then need not be.
    constraints = sorted(constraints, key=lambda each: each.name not in found)
    scaled, taken, clearances = np.ones(len(s), dtype=bool), np.zeros_like(s), {}
    unsafe = [each.joints for each in found.values()]
    if all(joints is not None for joints in unsafe):
        some = np.any(unsafe, axis=0)
        if not some.all():
            others = np.where(some, 0.0, s)
            lacks, left = examine(constraints, state, others)
            if not lacks:
                scaled, taken, clearances = some, others, left
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        some = np.where(scaled, middle * s, s)
        lacks, left = examine(constraints, state, some)
        if not lacks:
            low, taken, clearances = middle, some, left
        else:
            high = middle
            if high == LESS[0] and (less := _of_less(state, constraints, asked)):
                taken, low, clearances = less
                break
    least = min(each.share for each in found.values())
    if low == 0.0 and least > 0.0:
        lacks, left = examine(constraints, state, least * s)
        if not lacks:
            return least * s, least, left
    return taken, low, clearances


def _of_less(
    state: State, constraints: Sequence[Constraint], asked: Sequence[Rows]
) -> tuple[np.ndarray, float, dict[str, float]] | None:
    """The largest of `LESS` whose projection (nv,) is safe, with the clearances."""
    for less in LESS:
        s = _projected(state, less, asked)
        lacks, left = examine(constraints, state, s)
        if not lacks:
            return s, less, left
    return None


def lowest_on_segment(
    value: Callable[[float], float], curvature: float, level: float
) -> float:
    """How small a smooth function can be on a segment: no value of it on [0, 1] is
    smaller.

    Between a and b it is at least min(f(a), f(b)) - curvature (b - a)^2 / 8. Parts are
    halved until that is at least the level, or an end is below it.

    Args:
        value: the function f; of a place on the segment.
        curvature: |f''| is nowhere larger.
        level: above which nobody asks how small f is.
    """
    least, parts = float("inf"), [(0.0, value(0.0), 1.0, value(1.0), 0)]
    while parts:
        a, of_a, b, of_b, halvings = parts.pop()
        ends = min(of_a, of_b)
        bound = ends - 0.125 * curvature * (b - a) ** 2
        if bound >= level or not ends >= level or halvings == _HALVINGS:
            least = min(least, bound)
            continue
        middle = 0.5 * (a + b)
        of_middle = value(middle)
        parts.append((a, of_a, middle, of_middle, halvings + 1))
        parts.append((middle, of_middle, b, of_b, halvings + 1))
    return least
