"""A motion that keeps what it is to keep, and is shown to: windows, parts, certificate.

Only *windows* about frames that violate something are solved, with half a second on
either side, in parts of some ten seconds. Elsewhere the motion stands, bit for bit. A
window of changes that are smoothed over some frames is begun with each n-th alone.

Nothing trusts the solver. Afterwards the margins of each frame and of each straight way
to the next are found (`margins`). Where they are too small, more is asked for, and a
small window is solved again; where that does not help, from a clear straight way that
leads past it. What stays violated is reported.

The meshes of links decide: a stretch of frames in which only the shapes about them are
too near is left as it is, if no meshes touch there. Last, the meshes are asked again.
Where some touch, rows of their nearest points are added, and a small window is solved
again. Where that parts nothing, the motion is left as it was.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from crar_drake.law.compilation import hold
from crar_drake.law.path_balls import Shapes
from crar_drake.motion.planted_feet import runs
from crar_drake.robot.balls import find_balls
from crar_drake.robot.description import LIMIT_TOLERANCE
from crar_drake.robot.model import ControlModel
from crar_drake.robot.reach import find_reaches
from crar_drake.trajectory.distance_rows import (
    NearRows,
    configurations,
    find_near_rows,
    join_rows,
)
from crar_drake.trajectory.margins import Margins, find_margins
from crar_drake.trajectory.optimiser import (
    AtFrames,
    Effort,
    Part,
    Problem,
    Samples,
    Tasks,
    spread,
)

# The solver is asked for so much more than is certified [m], for its tolerance and what
# a file rounds.
_MORE_AT_FRAMES, _MORE_BETWEEN = 3e-4, 2e-3
_WITHIN_LIMITS = 1e-6  # [rad or m]
_SHARE_OF_SPEED = 0.998

# A window reaches so far beyond what violates something, and again beyond what is not
# certified after it was solved [s].
_AROUND, _AROUND_AGAIN = 0.5, 0.3
# Shapes that are deeper in each other are not excused, and their meshes not asked [m].
_DEEP = 0.03
# Frames of a part of a long window, and how long it is solved beyond its end [s].
_PART, _OVERLAP = 300, 0.7
# A motion is found of each so-many-th frame first.
COARSE = 8
_HELD = 2  # frames beside a part that what is minimised in it has to do with
_TRIES = 8
_LACKS = 1e-4  # a row that is not of a distance lacks less [m]
# This try begins anew, with as many samples as were found to be needed: where a motion
# went through an obstacle from one frame to the next, its sides are chosen again. Later
# ones begin from straight ways past it, and the last leaves it there.
_ANEW = 2
# Samples on the way to the next frame: one, three where a joint moves by more than this
# [rad], and twice as many each time that the way is not certified.
_FAST, _MOST_PARTS = 0.12, 16
_ROUNDS = 5  # in which meshes are parted


class Meshes(Protocol):
    """The meshes of P pairs of links, as `references.mesh_rows` has them.

    Attributes:
        num_pairs: P.
    """

    num_pairs: int

    def touching(self, q: np.ndarray) -> np.ndarray:
        """(P, T) which touch at the frames of a motion (T, n), or on the way from or to
        a neighbour, or are not shown to be clear."""

    def near_rows(
        self, where: np.ndarray, parts: int
    ) -> Callable[[Samples, np.ndarray, float], NearRows]:
        """As of `optimiser.Problem`, of joints (S, n).

        Args:
            where: (P, T) at which frames, and on the way to the next, a pair is looked
                at,
            parts: and of how many parts of that way at the ends alone; the more, the
                farther they are to be apart.
        """


@dataclass
class _State:
    """What a motion of T frames is asked for, and what it keeps."""

    at_frames: np.ndarray  # (T,) what is asked at frames [m]
    between: np.ndarray  # (T,) and on the way to the next [m]
    parts: np.ndarray  # (T,) into how many parts samples divide that way
    margins: Margins  # what it keeps
    effort: Effort = field(default_factory=Effort)  # that it took


class Keeper:
    """Keeps watched pairs apart, and joints within limits and speeds, of one robot.

    Attributes:
        model: the robot with its root fixed, and its watched pairs.
        rest: (nq,) its rest posture.
        rate: frames per second [Hz].
        floor: distance that watched pairs keep at each frame [m].
        floor_between: and on each straight way to the next frame [m].
        velocity_scale: share of the robot's velocity limits that may be used.
        room: (num_rows,) by how much farther apart pairs of shapes are asked to be,
            where they can; nothing is certified of it [m].
    """

    def __init__(
        self,
        model: ControlModel,
        rate: float,
        floor: float,
        floor_between: float,
        velocity_scale: float = 1.0,
    ) -> None:
        """
        Args:
            model, rate, floor, floor_between, velocity_scale: see the attributes.
        """
        self.model, self.rate, self.rest = model, rate, model.rest_positions()
        self.floor, self.floor_between = floor, floor_between
        self.velocity_scale = velocity_scale
        plant = model.plant
        reaches = find_reaches(
            *(model.joints, model.pairs, model.order),
            *(plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()),
        )
        balls = find_balls(model)
        self._shapes = hold(Shapes(model.robot, hold(reaches), hold(balls)))
        self.room = np.zeros(self.num_rows)
        # (T,) frames in which the distances of pairs that meshes cover do not count, or
        # None; and (num_rows,) those that meshes cover.
        self._excused: np.ndarray | None = None
        self._covered = np.zeros(self.num_rows, dtype=bool)
        # What was asked last is often asked again. None is equal to nothing.
        self._last: tuple[np.ndarray | None, Margins | None] = None, None

    @property
    def num_rows(self) -> int:
        """Number of pairs of shapes that are watched."""
        return len(self.model.pairs.pair_of_shapes)

    def margins(self, q: np.ndarray) -> Margins:
        """What a motion (T, n) of the controlled joints keeps.

        Speeds are shares of the robot's own limits, whatever share may be used.
        """
        if not np.array_equal(q, self._last[0]):
            margins = find_margins(self.model, self._shapes, q, self.rate)
            self._last = q.copy(), margins
        return self._last[1]

    def near_rows(self, at: Samples, y: np.ndarray, look: float) -> NearRows:
        """See `optimiser.Problem`; of unknowns of which the joints come last."""
        asked, first_joint = at.asked, y.shape[1] - self.model.n
        whole = configurations(self.model, self.rest, y[:, first_joint:])
        whole = np.take(whole, self.model.positions, axis=1)
        rows = NearRows(
            *find_near_rows(whole, asked + look, self.room, first_joint, self._shapes)
        )
        if self._excused is not None:
            some = self._excused[at.frame[rows.sample]] & self._covered[rows.row]
            rows = NearRows(*(x[~some] for x in rows))
        return rows._replace(d=rows.d - asked[rows.sample] - self.room[rows.row])

    def found_without_rows(
        self, problem: Problem, y: np.ndarray, effort: Effort, every: int = 1
    ) -> np.ndarray:
        """The motion (T, m) at its minimum without rows of distances.

        Args:
            problem, y: as of `keep`.
            effort: is added to.
            every: of each so-many-th frame, the changes of the others lie between.
        """
        y, whole = y.copy(), np.ones(len(y), dtype=bool)
        self._solve_each(every, _within(problem), y, whole, effort)
        return y

    def _solve_each(
        self,
        every: int,
        problem: Problem,
        y: np.ndarray,
        some: np.ndarray,
        effort: Effort,
        state: _State | None = None,
    ) -> None:
        """Solves each n-th frame alone, and changes those between them likewise.

        Args:
            every: n.
            problem, y: as of `keep`; y is changed in place.
            some: (T,) the frames that are changed.
            effort: is added to.
            state: of the motion, under the first penalties; without rows by default.
        """
        at = np.arange(0, len(y), every)
        problem, coarse = _of_each(problem, every), y[at]
        for first, last, _ in self._parts(some[at]):
            if state is None:
                part = _part(problem, coarse, first, last, effort=effort)
                part.solve_without_rows()
            else:
                asked = (x[at] for x in (state.at_frames, state.between, state.parts))
                samples = _samples(*asked, first, last)
                part = _part(problem, coarse, first, last, samples, effort)
                part.begin()
            coarse[first:last] = part.y[part.free]
        change, frames = coarse - y[at], np.flatnonzero(some)
        for column, x in zip(y.T, change.T, strict=True):
            column[frames] += np.interp(frames, at, x)

    def keep(
        self,
        problem: Problem,
        y: np.ndarray,
        effort: Effort | None = None,
        progress: Callable[[int], None] | None = None,
        also: np.ndarray | None = None,
        meshes: Meshes | None = None,
        by_shapes: Keeper | None = None,
    ) -> tuple[np.ndarray, np.ndarray, Effort]:
        """The motion at its minimum where it was changed.

        Args:
            problem: of it; its limits and speeds are kept with a little to spare.
            y: (T, m) unknowns, of which the joints come last.
            effort: that it took until then.
            progress: is called with the number of frames that are done.
            also: (T,) frames that are solved even if they violate nothing.
            meshes: are parted as well.
            by_shapes: keeps the same of the pairs of which meshes do not decide; by
                default they decide of none.

        Returns:
            (T, m) the motion; (T,) frames that still violate something, at them or on
            the way to the next; the effort that it took.
        """
        frames, y = len(y), y.copy()
        q = self._joints(y)
        problem = _within(problem)
        margins, self._excused = self.margins(q), None
        if meshes is not None and by_shapes is not None:
            self._let_decide(q, margins, meshes, by_shapes)
        violating = self._violating(margins) | _below(problem, y, self.floor)
        if also is not None:
            violating |= also
        moves = np.abs(np.diff(q, axis=0, append=q[-1:])).max(axis=1)
        state = _State(
            at_frames=np.full(frames, self.floor + _MORE_AT_FRAMES),
            between=np.full(frames, self.floor_between + _MORE_BETWEEN),
            parts=np.where(moves > _FAST, 4, 2),
            margins=margins,
            effort=effort or Effort(),
        )
        self._solve(problem, y, state, violating, range(_TRIES), progress)
        if meshes is not None:
            self._part_meshes(problem, meshes, y, state)
        violating, self._excused = self._violating(state.margins), None
        return y, violating, state.effort

    def _let_decide(
        self,
        q: np.ndarray,
        margins: Margins,
        meshes: Meshes,
        by_shapes: Keeper,
    ) -> None:
        """Excuses stretches of frames in which only shapes about links whose meshes
        decide are too near, and no meshes touch, beyond the windows about what is
        violated."""
        near = self._near(margins)
        if not near.any():
            return
        others = {frozenset(pair) for pair in by_shapes.model.pairs.names}
        covered = [frozenset(pair) not in others for pair in self.model.pairs.names]
        self._covered = np.array(covered)[self.model.pairs.pair_of_shapes]
        excused = near & ~by_shapes._near(by_shapes.margins(q))
        violated = self._violating(margins) & ~excused
        violated |= excused & (margins.distance < -_DEEP)
        violated = self._with_windows(violated, excused)
        for start, end in runs(~spread(violated, round(_AROUND * self.rate))):
            touching = meshes.touching(q[start:end]).any(axis=0)
            violated[start:end] |= touching
        self._excused = excused & ~self._with_windows(violated, excused)

    def _with_windows(self, violated: np.ndarray, excused: np.ndarray) -> np.ndarray:
        """(T,) what is violated, with all stretches that windows about it reach."""
        violated, before = violated.copy(), -1
        while before != violated.sum():
            before = violated.sum()
            windows = spread(violated, round(_AROUND * self.rate))
            for start, end in runs(excused):
                if windows[start:end].any():
                    violated[start:end] = True
        return violated

    def _near(self, margins: Margins) -> np.ndarray:
        """(T,) frames that keep less than is asked for, at them or on the way to the
        next."""
        low = margins.between < self.floor_between
        return (margins.distance < self.floor) | low

    def _joints(self, y: np.ndarray) -> np.ndarray:
        """(T, n) the controlled joints among the unknowns, a view."""
        return y[:, y.shape[1] - self.model.n :]

    def _solve(
        self,
        problem: Problem,
        y: np.ndarray,
        state: _State,
        violating: np.ndarray,
        tries: Sequence[int],
        progress: Callable[[int], None] | None = None,
    ) -> None:
        """Solves windows until nothing is violated, or there is no try left.

        Args:
            problem: of the motion.
            y: (T, m), changed in place, as is the state.
            state: of the motion.
            violating: (T,) frames that windows are about first.
            tries: the numbers of the tries.
            progress: is called in the first try.
        """
        q = self._joints(y)
        for attempt in tries:
            if not violating.any():
                break
            begins = attempt in (0, _ANEW)
            around = _AROUND if begins else _AROUND_AGAIN
            solved = spread(violating, round(around * self.rate))
            if attempt == _ANEW:
                y[solved] = problem.about[solved]
            elif attempt > _ANEW:
                solved |= self._lay_chords(y, violating)
            if begins:
                # Each how many frames say what a change is, as far as it is smoothed.
                every = max(1, int(np.sqrt(problem.smoothness.min())))
                self._solve_each(every, problem, y, solved, state.effort, state)
            for first, last, end in self._parts(solved & (attempt < _TRIES - 1)):
                samples = _samples(
                    state.at_frames, state.between, state.parts, first, last
                )
                part = _part(problem, y, first, last, samples, state.effort)
                part.solve(round(_AROUND_AGAIN * self.rate))
                y[first:last] = part.y[part.free]
                if progress is not None and not attempt:
                    progress(end)
            q[solved] = np.clip(q[solved], self.model.lower, self.model.upper)
            margins = self._margins_again(q, state.margins, solved)
            state.margins, violating = margins, self._violating(margins)
            low = margins.distance < self.floor
            lacks = self.floor - margins.distance[low]
            state.at_frames[low] += 1.2 * lacks + 1e-4
            gaps = margins.between < self.floor_between
            state.between[gaps & (state.parts >= _MOST_PARTS)] += 1e-3
            state.parts[gaps] = np.minimum(2 * state.parts[gaps], _MOST_PARTS)

    def _part_meshes(
        self, problem: Problem, meshes: Meshes, y: np.ndarray, state: _State
    ) -> None:
        """Parts the meshes that touch on a motion.

        Args:
            problem, y, state: as of `_solve`.
        """
        q, before = self._joints(y), y.copy()
        touching = meshes.touching(q)
        where, violated = np.zeros_like(touching), self._violating(state.margins)
        was_worse = touching.any(axis=0) + len(y) * violated
        for number in range(_ROUNDS):
            # Frames that meshes were parted in, or beside, may violate something then.
            some = touching.any(axis=0) | (self._violating(state.margins) & ~violated)
            if not some.any():
                break
            for run in runs(spread(some, round(_AROUND_AGAIN * self.rate))):
                pairs = touching[:, slice(*run)].any(axis=1)
                where[pairs, slice(*run)] = True
            # At first at frames alone: distances of meshes take their time.
            parts = 2**number
            state.parts[some] = np.maximum(state.parts[some], parts)
            more = self._with_meshes(problem, meshes, where, parts)
            more = replace(more, about=y.copy())
            self._solve(more, y, state, some, (1, 1))
            touching = meshes.touching(q)
        changed = (y != before).any(axis=1)
        worse = touching.any(axis=0) + len(y) * self._violating(state.margins)
        for start, end in runs(changed):
            around = slice(max(start - 1, 0), end + 1)
            if worse[around].sum() >= was_worse[around].sum():
                y[start:end] = before[start:end]
        undone = changed & (y == before).all(axis=1)
        if undone.any():
            state.margins = self._margins_again(q, state.margins, undone)

    def _with_meshes(
        self, problem: Problem, meshes: Meshes, where: np.ndarray, parts: int
    ) -> Problem:
        """Also with rows of meshes; where and parts as of `Meshes`."""
        of_meshes = meshes.near_rows(where, parts)

        def near_rows(at: Samples, y: np.ndarray, look: float) -> NearRows:
            rows = of_meshes(at, self._joints(y), look)
            gradient = np.zeros((len(rows.d), y.shape[1]))
            self._joints(gradient)[:] = rows.gradient
            number = problem.num_rows + rows.row
            rows = rows._replace(row=number, gradient=gradient)
            return join_rows(problem.near_rows(at, y, look), rows)

        count = problem.num_rows + meshes.num_pairs
        return replace(problem, near_rows=near_rows, num_rows=count)

    def _lay_chords(self, y: np.ndarray, violating: np.ndarray) -> np.ndarray:
        """Leads the joints past what violates something on straight ways that are
        clear, from a frame before to a frame after: the side of an obstacle on which
        the robot stays is not the reference's then.

        Args:
            y: (T, m), changed in place.
            violating: (T,) which frames are not to stay.

        Returns:
            (T,) the frames that were changed.
        """
        frames, changed = len(y), np.zeros(len(y), dtype=bool)
        q = self._joints(y)
        for first, last in runs(violating):
            for reach in range(1, frames):
                a, b = max(first - reach, -1), min(last - 1 + reach, frames)
                ends = [k for k in (a, b) if 0 <= k < frames]
                if not ends:
                    break
                if violating[ends].any() or not self._is_way(q[ends], b - a):
                    continue
                share = np.linspace(0.0, 1.0, b - a + 1)[1:-1, None]
                q[a + 1 : b] = (1.0 - share) * q[ends[0]] + share * q[ends[-1]]
                changed[a + 1 : b] = True
                break
        return changed

    def _is_way(self, ends: np.ndarray, frames: int) -> bool:
        """Whether all frames on the straight way between two configurations, so many
        apart, violate nothing; of one configuration, whether that does not."""
        margins = self.margins(ends)
        slowed = replace(margins, speed=margins.speed / frames)
        low = margins.between.min() < max(self.floor, self.floor_between)
        return not (low or self._beyond(slowed).any())

    def _violating(self, margins: Margins) -> np.ndarray:
        """(T,) frames that violate something, at them or on the way to the next."""
        near = self._near(margins)
        if self._excused is not None:
            near &= ~self._excused
        return near | self._beyond(margins)

    def _beyond(self, margins: Margins) -> np.ndarray:
        """(T,) frames at which a joint is beyond a limit, or too fast on a way to or
        from them."""
        fast = margins.speed > self.velocity_scale
        fast = fast | np.append(False, fast[:-1])
        return (margins.limit < -LIMIT_TOLERANCE) | fast

    def _margins_again(
        self, q: np.ndarray, margins: Margins, changed: np.ndarray
    ) -> Margins:
        """The margins of a motion of which some frames have changed."""
        found = {name: x.copy() for name, x in vars(margins).items()}
        for first, last in runs(spread(changed, 1)):
            # The last of these frames has no way of its own here.
            for name, x in vars(self.margins(q[first : last + 1])).items():
                found[name][first:last] = x[: last - first]
        return Margins(**found)

    def _parts(self, mask: np.ndarray) -> Iterator[tuple[int, int, int]]:
        """First frame, frame after the last, and how far the motion is done with it;
        the last frames of a part that goes on are solved again by the next."""
        overlap = round(_OVERLAP * self.rate)
        for first, last in runs(mask):
            while last - first > _PART + overlap + _PART // 2:
                yield first, first + _PART + overlap, first + _PART
                first += _PART
            yield first, last, last


class _TasksOfEach:
    """Tasks of each n-th frame; the steps between them are not asked for."""

    step_weights = None

    def __init__(self, tasks: Tasks, every: int) -> None:
        self._tasks, self._every = tasks, every

    def at(self, frames: np.ndarray, y: np.ndarray) -> AtFrames:
        """See `optimiser.Tasks`."""
        return self._tasks.at(self._every * frames, y)


def _part(
    problem: Problem,
    y: np.ndarray,
    first: int,
    last: int,
    samples: Samples | None = None,
    effort: Effort | None = None,
) -> Part:
    """The frames first to last - 1, which may move; without samples what comes after
    them does not matter.

    Args:
        problem, y: of all frames.
        first, last: see above.
        samples: counted from the part's first frame.
        effort: is added to.
    """
    before = max(0, first - _HELD)
    after = last if samples is None else last + _HELD
    y = y[before:after].copy()
    k = np.arange(before, before + len(y))
    if samples is None:
        samples = Samples(np.zeros(0, dtype=int), np.zeros(0), np.zeros(0))
    free = (k >= first) & (k < last)
    return Part(problem, before, y, free, samples, effort or Effort())


def _of_each(problem: Problem, every: int) -> Problem:
    """A motion's problem of each n-th frame alone."""
    if every == 1:
        return problem
    return replace(
        problem,
        tasks=_TasksOfEach(problem.tasks, every),
        posture=problem.posture[::every],
        about=problem.about[::every],
        smoothness=problem.smoothness / every**2,
        fastest=problem.fastest * every,
        near_rows=lambda at, y, look: problem.near_rows(
            replace(at, frame=every * at.frame), y, look
        ),
    )


def _within(problem: Problem) -> Problem:
    """With the limits and speeds that the solver is asked for."""
    inside = np.minimum(_WITHIN_LIMITS, 0.5 * (problem.upper - problem.lower))
    return replace(
        problem,
        lower=problem.lower + inside,
        upper=problem.upper - inside,
        fastest=_SHARE_OF_SPEED * problem.fastest,
    )


def _below(problem: Problem, y: np.ndarray, floor: float) -> np.ndarray:
    """(T,) frames with rows that lack something, distances below a floor with them."""
    frames = np.arange(len(y))
    at = Samples(frames, np.zeros(len(y)), np.full(len(y), floor))
    rows = problem.near_rows(at, y, -_LACKS)
    below = np.zeros(len(y), dtype=bool)
    below[rows.sample] = True
    return below


def _samples(
    asked: np.ndarray,
    between: np.ndarray,
    parts: np.ndarray,
    first: int,
    last: int,
) -> Samples:
    """At the frames first to last - 1, and between these and their neighbours, counted
    from the part's first frame."""
    before, frames = max(0, first - _HELD), len(asked)
    at = np.arange(first, last)
    ways = np.arange(max(first - 1, 0), min(last, frames - 1))
    times = parts[ways] - 1
    k = np.repeat(ways, times)
    number = np.arange(len(k)) - np.repeat(np.cumsum(times) - times, times) + 1
    return Samples(
        np.concatenate([at, k]) - before,
        np.concatenate([np.zeros(len(at)), number / parts[k]]),
        np.concatenate([asked[at], between[k]]),
    )
