"""A motion as one least-squares problem with constraints: all frames at once.

With y_k in R^m the unknowns of frame k, over the T frames of a motion:

    minimise    1/2 sum_k [ |r_k(y_k)|^2 + |w (y_k - c_k)|^2
                            + |s (x_(k-1) - 2 x_k + x_(k+1))|^2
                            + |v_k (f(y_(k+1)) - f(y_k) - g_k)|^2 ],       x = y - a
    such that   d((1 - t) y_k + t y_(k+1)) >= asked       at samples (k, t),
                lower <= y_k <= upper,    |y_(k+1) - y_k| <= fastest.

The tasks r, the posture c, the smoothness about a, and the steps g of f (0 of what
stands still), are the caller's: for a reference motion that is to change the least, c =
a is the reference.

*Solver*. An augmented Lagrangian (J. Nocedal and S. J. Wright, "Numerical
Optimization", 2nd ed., Alg. 17.4): with multipliers lambda of rows c(y) >= 0, minimise

    f(y) + sum_i (rho / 2) max(0, lambda_i / rho - c_i(y))^2,

then set lambda_i to max(0, lambda_i - rho c_i). The penalty rho grows in stages: begun
with the last one the minimum is a worse one. Each minimisation takes damped
Gauss-Newton steps; in a step all rows are linearised, and which of them count is found
by iterating, a few times. Unknowns of neighbouring frames alone are coupled, so a
step's time is linear in the frames (`bands`). Each frame has its own damping, more
where rows of distances push: where some go too far, the others are not slowed.

Frames are *live* while rows that concern them, or frames near them, are not settled;
in a minimisation, once most of the others stand still, as long as they move. Others are
held.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from crar_drake.errors import CrarError
from crar_drake.trajectory.bands import (
    Normal,
    add_rows,
    add_squares,
    add_steps,
    along_rows,
)
from crar_drake.trajectory.distance_rows import NearRows, no_rows

# rho of the distances [1/m^2], stage by stage; of joint limits and speeds [1/rad^2].
_PENALTIES = (1e2, 3e3, 1e5)
_PENALTY_OF_JOINTS = 1e5

_STEPS = 40  # Gauss-Newton steps of a minimisation, at most
_ACTIVE_SETS = 3  # in one of them, at most
_HALVINGS = 8  # of a way on which its least is looked for
# Frames on either side of those whose rows change, for which a step is found anew.
_BESIDE = 10
_LOCAL = 5  # frames on either side whose costs say whether a step was of use
_FEW = 0.5  # where fewer of the frames move, the others are left alone
_UPDATES = 10  # of the multipliers under the last penalty, at most
_LONGEST_STEP = 0.5  # of any unknown in a step [rad]
_SETTLED = 1e-3  # a step that changes no unknown by more ends a minimisation [rad]
_GAIN = 1e-2  # as does one by which the merit falls by a smaller share than this,
_NO_COST = 1e-4  # or than this of this
# What rows lack is to fall to this share with an update; else, so often in a row, more
# updates are of no use.
_LESS, _STALLS = 0.8, 2
_LACKS = 1e-4  # a row that lacks less than this is settled [m]
_ARM = 0.2  # what a joint's limit lacks counts as much as this far from its axis [m]

# Rows count that are nearer than what is asked for and this [m], which goes with the
# last step [m/rad].
_LOOK, _NEAREST_LOOK, _FARTHEST_LOOK = 0.3, 0.01, 0.03

# Levenberg's damping, of each frame: first, least, most; by how much it rises where a
# step was of no use, and falls elsewhere.
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING, _RISE, _FALL = 1e-2, 1e-5, 1e4, 8.0, 3.0
# Where rows of distances push, it is multiplied by 1 + this [m] times their force
# [1/m]: they bend, which is not in a linearisation.
_BEND = 30.0


class AtFrames(NamedTuple):
    """What the motion does at L frames."""

    r: np.ndarray  # (L, R) residuals of the tasks,
    J: np.ndarray  # (L, R, m) and their Jacobian
    f: np.ndarray  # (L, F) whose steps from one frame to the next are given,
    G: np.ndarray  # (L, F, m) and its Jacobian


class Tasks(Protocol):
    """What the motion is to do.

    Attributes:
        step_weights: (T - 1, F) v, of the steps from each frame to the next; None if
            there are none.
        steps: (T - 1, F) g.
    """

    step_weights: np.ndarray | None
    steps: np.ndarray

    def at(self, frames: np.ndarray, y: np.ndarray) -> AtFrames:
        """At some frames.

        Args:
            frames: (L,) which of the motion.
            y: (L, m) their unknowns.
        """


@dataclass(frozen=True)
class Samples:
    """Places on the motion where rows are asked for: (1 - t) y_k + t y_(k+1)."""

    frame: np.ndarray  # (S,) k
    share: np.ndarray  # (S,) t, from 0 to less than 1
    asked: np.ndarray  # (S,) what each row keeps there [m]


@dataclass(frozen=True)
class Problem:
    """What is minimised, and the constraints; m unknowns a frame."""

    tasks: Tasks  # of each frame
    posture: np.ndarray  # (T, m) c
    posture_weight: np.ndarray  # (m,) w
    about: np.ndarray  # (T, m) a
    smoothness: np.ndarray  # (m,) s
    lower: np.ndarray  # (m,) limits; minus infinity where there is none
    upper: np.ndarray  # (m,) and infinity
    # (m,) change from a frame to the next, at most; infinity where there is no limit
    fastest: np.ndarray
    # of S samples, counted from the motion's first frame, their y (S, m), and a length:
    # the rows that keep less than that beyond what they are asked, which is what their
    # `d` says
    near_rows: Callable[[Samples, np.ndarray, float], NearRows]
    num_rows: int  # number of rows that a sample may have


@dataclass
class Effort:
    """What solving took: linearisations, and factorisations."""

    linearised: int = 0
    factorised: int = 0


@dataclass
class _Live:
    """Frames that move, and what concerns them; the others' places are -1."""

    moves: np.ndarray
    frames: np.ndarray
    seen: np.ndarray  # these, and if something stands still their neighbours
    own: np.ndarray  # where the live ones are among the seen
    samples: np.ndarray
    left: np.ndarray
    right: np.ndarray
    steps: np.ndarray  # from these frames to the next
    step_left: np.ndarray
    step_right: np.ndarray


@dataclass
class _Linearised:
    """The problem about y (P, m), at live frames and samples."""

    y: np.ndarray
    done: AtFrames  # at the frames that are seen
    rows: NearRows  # whose `sample` counts live ones
    merits: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (P,)

    @property
    def merit(self) -> float:
        """Of all frames."""
        return float(self.merits.sum())


@dataclass
class Part:
    """Some frames of a motion in a row, of which some may move."""

    problem: Problem  # of the whole motion
    first: int  # which of its frames is the part's first
    y: np.ndarray  # (P, m) unknowns; `solve` changes them
    # (P,) whether a frame may move. Beside the others, the two at each end are held
    # unless the motion ends there.
    free: np.ndarray
    samples: Samples  # of the part, counted from its first frame
    effort: Effort = field(default_factory=Effort)  # is counted

    def __post_init__(self) -> None:
        some = slice(self.first, self.first + len(self.y))
        self._posture, self._about = (
            self.problem.posture[some],
            self.problem.about[some],
        )
        self._damping = np.full(len(self.y), _DAMPING)
        self._of_rows = np.zeros((len(self.samples.frame), self.problem.num_rows))
        self._of_limits = np.zeros((2, *self.y.shape))
        self._of_speeds = np.zeros((2, len(self.y) - 1, self.y.shape[1]))
        self._stiffness = _second_differences(len(self.y))

    def solve_without_rows(self) -> None:
        """Minimises without rows of distances."""
        self._minimise(self._live(self.free), 0.0)

    def begin(self) -> None:
        """Minimises under the first penalties."""
        live = self._live(self.free)
        for penalty in _PENALTIES[:-1]:
            self._update(live, self._minimise(live, penalty), penalty)

    def solve(self, near: int) -> None:
        """Minimises under the last penalty, until what is asked for is kept or nothing
        more is gained.

        Args:
            near: frames so near to one that is not settled are live.
        """
        live, penalty = self._live(self.free), _PENALTIES[-1]
        least, stalls = np.inf, 0
        for _ in range(_UPDATES):
            at = self._minimise(live, penalty)
            self._update(live, at, penalty)
            lacking, lacks = self._lacking(live, at)
            stalls = stalls + 1 if lacks > _LESS * least else 0
            if not lacking.any() or stalls >= _STALLS:
                return
            least = min(least, lacks)
            live = self._live(self.free & spread(lacking, near))

    def _minimise(self, live: _Live, penalty: float, cost: float = 0.0) -> _Linearised:
        """Changes y of live frames; returns where it is then.

        Args:
            live: the frames.
            penalty: rho of the distances.
            cost: what was minimised with them; a gain is little beside that.

        Raises:
            CrarError: what is minimised is not a number where it begins, from where no
                step leads to one.
        """
        damping, look = self._damping, _FARTHEST_LOOK
        at = self._linearise(self.y, live, penalty, look)
        if not np.isfinite(at.merit):
            frame = self.first + int(np.argmin(np.isfinite(at.merits)))
            raise CrarError(
                f"about frame {frame + 1}: what the robot is to do there is not a "
                "number (NaN or infinite); look for such a value in its model and in "
                "the motion"
            )
        for _ in range(_STEPS):
            step = self._step(at, live, penalty, damping[live.frames])
            worse, gain = live.moves, -np.inf
            if step is not None:
                sizes = np.abs(step).max(axis=1)
                step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(sizes, 1e-300))[
                    :, None
                ]
                size = float(sizes.max(initial=0.0))
                y = at.y.copy()
                y[live.frames] += step
                look = np.clip(_LOOK * size, _NEAREST_LOOK, _FARTHEST_LOOK)
                new = self._linearise(y, live, penalty, look)
                worse = ~(_around(new.merits - at.merits) <= 1e-12)
                gain = at.merit - new.merit
            damping[worse] = np.maximum(_RISE * damping[worse], _DAMPING)
            if not gain >= -1e-12:
                if not damping[worse].min(initial=np.inf) <= _MOST_DAMPING:
                    break
                continue
            damping[~worse] = np.maximum(damping[~worse] / _FALL, _LEAST_DAMPING)
            at, cost = new, max(cost, new.merit)
            little = gain < _GAIN * (_NO_COST + cost) or size < _SETTLED
            if little and size < _LONGEST_STEP:
                break
            moving = np.zeros(len(y), dtype=bool)
            moving[live.frames[sizes > _SETTLED]] = True
            moving = spread(moving, _BESIDE) & live.moves
            if moving.sum() < _FEW * len(live.frames):
                self.y = at.y
                self._minimise(self._live(moving), penalty, cost)
                at = self._linearise(self.y, live, penalty, look)
                break
        np.minimum(damping, _MOST_DAMPING, out=damping)
        self.y = at.y
        return at

    def _live(self, mask: np.ndarray) -> _Live:
        """Of the frames of a mask, whose gaps of one or two frames are closed: frames
        that are coupled are neighbours then."""
        mask = _closed(mask) & self.free
        frames = np.flatnonzero(mask)
        place = np.full(len(mask) + 1, -1)
        place[frames] = np.arange(len(frames))
        k, t = self.samples.frame, self.samples.share
        right = np.where(t > 0.0, np.minimum(k + 1, len(mask) - 1), k)
        samples = np.flatnonzero(mask[k] | mask[right])
        steps = np.flatnonzero(mask[:-1] | mask[1:])
        moving = self.problem.tasks.step_weights is not None
        seen = np.flatnonzero(spread(mask, 1)) if moving else frames
        return _Live(
            mask,
            frames,
            seen,
            np.searchsorted(seen, frames),
            samples,
            place[k[samples]],
            np.where(t[samples] > 0.0, place[right[samples]], -1),
            steps,
            place[steps],
            place[steps + 1],
        )

    def _linearise(
        self, y: np.ndarray, live: _Live, penalty: float, look: float
    ) -> _Linearised:
        self.effort.linearised += 1
        problem, some = self.problem, live.samples
        k, share = self.samples.frame[some], self.samples.share[some]
        t = share[:, None]
        at = (1.0 - t) * y[k] + t * y[np.minimum(k + 1, len(y) - 1)]
        samples = Samples(self.first + k, share, self.samples.asked[some])
        done = problem.tasks.at(self.first + live.seen, y[live.seen])
        rows = no_rows(y.shape[1])
        if penalty:
            rows = problem.near_rows(samples, at, look)
        new = _Linearised(y, done, rows)
        new.merits = self._merits(new, live, penalty)
        return new

    def _limits(self, y: np.ndarray, live: _Live) -> tuple[np.ndarray, np.ndarray]:
        """(2, L, m), (2, K, m) what is left to limits and speeds, either way."""
        problem, here = self.problem, y[live.frames]
        step = y[live.steps + 1] - y[live.steps]
        return (
            np.stack([here - problem.lower, problem.upper - here]),
            np.stack([problem.fastest - step, problem.fastest + step]),
        )

    def _merits(self, at: _Linearised, live: _Live, penalty: float) -> np.ndarray:
        """(P,) each frame's share of what is minimised."""
        problem, y, found = self.problem, at.y, np.zeros(len(at.y))
        posture = problem.posture_weight * (y - self._posture)[live.frames]
        found[live.frames] += _squares(at.done.r[live.own]) + _squares(posture)
        bends = self.problem.smoothness * np.diff(y - self._about, 2, axis=0)
        found[1:-1] += _squares(bends)
        weights, before, steps = self._standing(live, at.done.f)
        found[live.seen[before]] += _squares(weights * steps)
        limits, speeds = self._limits(y, live)
        samples = live.samples[at.rows.sample]
        for rho, lam, c, frames in (
            (
                penalty,
                self._of_rows[samples, at.rows.row],
                at.rows.d,
                self.samples.frame[samples],
            ),
            (_PENALTY_OF_JOINTS, self._of_limits[:, live.frames], limits, live.frames),
            (_PENALTY_OF_JOINTS, self._of_speeds[:, live.steps], speeds, live.steps),
        ):
            lacks = np.maximum(0.0, lam / rho - c)
            squares = lacks * lacks
            if lacks.ndim > 1:
                squares = squares.sum(axis=(0, 2))
            found += rho * np.bincount(frames, squares, minlength=len(y))
        return 0.5 * found

    def _step(
        self, at: _Linearised, live: _Live, penalty: float, damping: np.ndarray
    ) -> np.ndarray | None:
        """(L, m) towards the minimum of the linearised merit, with active sets of its
        own."""
        rows, rho = at.rows, _PENALTY_OF_JOINTS
        left, right = live.left[rows.sample], live.right[rows.sample]
        t = self.samples.share[live.samples[rows.sample]]
        lam = self._of_rows[live.samples[rows.sample], rows.row]
        shift = lam / penalty - at.rows.d
        force = penalty * np.maximum(0.0, shift)
        ends = np.concatenate([left, right]) + 1  # 0: of a frame that is held
        at_ends = np.concatenate([(1.0 - t) * force, t * force])
        pushed = np.bincount(ends, at_ends, minlength=len(damping) + 1)[1:]
        base = self._normal(at, live, damping * (1.0 + _BEND * pushed))
        limits, speeds = self._limits(at.y, live)
        limits = self._of_limits[:, live.frames] / rho - limits
        speeds = self._of_speeds[:, live.steps] / rho - speeds
        frames, m = base.b.shape
        weights = penalty, rho, rho

        def moved(step: np.ndarray) -> tuple[np.ndarray, ...]:
            moving = np.vstack([step, np.zeros(m)])  # -1: a frame that is held
            change = moving[live.step_right] - moving[live.step_left]
            return (
                along_rows(rows.gradient, left, right, t, step),
                np.stack([step, -step]),
                np.stack([-change, change]),
            )

        step, slope = np.zeros((frames, m)), -base.b
        lacks = shift, limits, speeds
        before, share = None, 0.0
        for _ in range(_ACTIVE_SETS):
            on = tuple(c > 0.0 for c in lacks)
            turned = np.full(frames, share < 1.0)
            if share == 1.0:
                other = on[0] != before[0]
                sides = [left[other], right[other]]
                other = (on[2] != before[2]).any(axis=(0, 2))
                sides += [live.step_left[other], live.step_right[other]]
                for side in sides:
                    turned[side[side >= 0]] = True
                turned |= (on[1] != before[1]).any(axis=(0, 2))
                if not turned.any():
                    break
            before = on
            # Where other rows count than before, and about it, the step is other, too.
            some = np.flatnonzero(_closed(spread(turned, _BESIDE)))
            place = np.full(frames + 1, -1)
            place[some] = np.arange(len(some))
            normal = base.of_frames(some, -slope[some])
            near = np.flatnonzero(on[0] & ((place[left] >= 0) | (place[right] >= 0)))
            add_rows(
                normal.H,
                normal.b,
                place[left[near]],
                place[right[near]],
                t[near],
                np.take(rows.gradient, near, axis=0),
                np.full(len(near), penalty),
                lacks[0][near],
            )
            every = np.arange(len(some))
            normal.add_to_diagonal(every, rho * on[1][:, some].sum(axis=0))
            kept = np.maximum(0.0, lacks[1][:, some])
            normal.b += rho * (kept[0] - kept[1])
            ends = place[live.step_left], place[live.step_right]
            _add_speeds(normal, *ends, rho * on[2].sum(axis=0))
            kept = np.maximum(0.0, lacks[2])
            push = rho * (kept[1] - kept[0])
            for places, sign in zip(ends, (-1.0, 1.0), strict=True):
                there = places >= 0
                normal.b[places[there]] += sign * push[there]
            self.effort.factorised += 1
            found = normal.solve()
            if found is None:
                return None
            way = np.zeros((frames, m))
            way[some] = found
            going, pulled = moved(way), base.times(way)
            straight = float(np.vdot(way, slope)), float(np.vdot(way, pulled))
            share = _share_of_way(straight, lacks, going, weights)
            step = step + share * way
            slope = slope + share * pulled
            lacks = tuple(c - share * x for c, x in zip(lacks, going, strict=True))
        return step

    def _normal(self, at: _Linearised, live: _Live, damping: np.ndarray) -> Normal:
        """Of what is minimised, without constraints."""
        problem, some = self.problem, live.frames
        weight, stiff = problem.posture_weight**2, self.problem.smoothness**2
        frames, m = len(some), at.y.shape[1]
        H, b = np.zeros((frames, m, 2 * m + 1)), np.zeros((frames, m))
        add_squares(H, b, np.take(at.done.J, live.own, axis=0), at.done.r[live.own])
        centre, first, second = self._stiffness
        H[:, :, 0] += weight + damping[:, None] + centre[some, None] * stiff
        by_one, by_two = np.diff(some) == 1, (some[2:] - some[:-2]) == 2
        H[:-1, :, m] = np.where(by_one, first[some[:-1]], 0.0)[:, None] * stiff
        H[:-2, :, 2 * m] = np.where(by_two, second[some[:-2]], 0.0)[:, None] * stiff
        bends = np.diff(at.y - self._about, 2, axis=0)
        pull = np.zeros_like(at.y)
        pull[:-2] += bends
        pull[1:-1] -= 2.0 * bends
        pull[2:] += bends
        b -= weight * (at.y - self._posture)[some] + stiff * pull[some]
        normal = Normal(H, b)
        self._add_standing(normal, at, live)
        return normal

    def _standing(
        self, live: _Live, f: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """v and what f's steps lack, from a frame that is seen to the next, (K, F)
        both, and between them (K,) which of the frames that are seen come before."""
        tasks = self.problem.tasks
        if tasks.step_weights is None:
            return np.zeros((0, 0)), np.zeros(0, dtype=int), np.zeros((0, 0))
        before = np.flatnonzero(np.diff(live.seen) == 1)
        k = self.first + live.seen[before]
        lacks = f[before + 1] - f[before] - tasks.steps[k]
        return tasks.step_weights[k], before, lacks

    def _add_standing(self, normal: Normal, at: _Linearised, live: _Live) -> None:
        """Adds the rows v (f_(k+1) - f_k - g_k)."""
        v, before, change = self._standing(live, at.done.f)
        some = v.any(axis=1)
        v, before, change = v[some], before[some], change[some]
        if not len(v):
            return
        place = np.full(len(at.y), -1)
        place[live.frames] = np.arange(len(live.frames))
        weights, G = v[:, :, None], at.done.G
        add_steps(
            normal.H,
            normal.b,
            place[live.seen[before]],
            place[live.seen[before + 1]],
            weights * G[before],
            weights * G[before + 1],
            v * change,
        )

    def _update(self, live: _Live, at: _Linearised, penalty: float) -> None:
        """Of the multipliers."""
        some, rows = live.samples, at.rows
        lam = self._of_rows[some[rows.sample], rows.row]
        self._of_rows[some] = 0.0
        self._of_rows[some[rows.sample], rows.row] = np.maximum(
            0.0, lam - penalty * rows.d
        )
        limits, speeds = self._limits(at.y, live)
        for lam, places, c in (
            (self._of_limits, live.frames, limits),
            (self._of_speeds, live.steps, speeds),
        ):
            lam[:, places] = np.maximum(0.0, lam[:, places] - _PENALTY_OF_JOINTS * c)

    def _lacking(self, live: _Live, at: _Linearised) -> tuple[np.ndarray, float]:
        """Which frames (P,) have rows that lack something, and what all rows lack
        together [m]."""
        d, (limits, speeds) = at.rows.d, self._limits(at.y, live)
        lacking = np.zeros(len(at.y), dtype=bool)
        low = live.samples[at.rows.sample[d < -_LACKS]]
        lacking[self.samples.frame[low]] = True
        lacking[live.frames[(limits < -_LACKS / _ARM).any(axis=(0, 2))]] = True
        lacking[live.steps[(speeds < -_LACKS / _ARM).any(axis=(0, 2))]] = True
        lacks = -np.minimum(d, 0.0).sum()
        lacks -= sum(_ARM * np.minimum(x, 0.0).sum() for x in (limits, speeds))
        return lacking, float(lacks)


def _share_of_way(straight, lacks, going, weights) -> float:
    """How far on a way, from 0 to 1, a u + b u^2 / 2 + sum_i rho_i / 2 max(0, c_i - g_i
    u)^2 is asked for: all of it if that is less at its end, else where it is the least.

    Args:
        straight: a, b: slope and curvature of what has no kinks.
        lacks, going, weights: c, g and rho of several kinds of rows.
    """

    rows = []
    for c, g, rho in zip(lacks, going, weights, strict=True):
        some = np.maximum(c, c - g) > 0.0
        rows.append((c[some], g[some], np.full(np.count_nonzero(some), rho)))
    c, g, rho = (np.concatenate(each) for each in zip(*rows, strict=True))

    def height(u: float) -> float:
        lack = np.maximum(0.0, c - u * g)
        return u * straight[0] + 0.5 * (u * u * straight[1] + rho @ (lack * lack))

    def slope(u: float) -> float:
        return straight[0] + u * straight[1] - (rho * g) @ np.maximum(0.0, c - u * g)

    # It leads to the least of the rows that count at its start; those that it meets
    # count in the next active set.
    if height(1.0) < height(0.0):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if slope(middle) > 0.0 else (middle, high)
    return high


def _squares(rows: np.ndarray) -> np.ndarray:
    """(K,) sums of squares of rows (K, R)."""
    return np.einsum("kr,kr->k", rows, rows)


def _around(values: np.ndarray) -> np.ndarray:
    """(P,) sums of each frame's value and those of so many on either side."""
    sums = np.cumsum(np.concatenate([[0.0], values]))
    k = np.arange(len(values))
    last = np.minimum(k + _LOCAL + 1, len(values))
    return sums[last] - sums[np.maximum(k - _LOCAL, 0)]


def spread(mask: np.ndarray, by: int) -> np.ndarray:
    """Also the `by` frames before and after those of a mask (T,)."""
    if by <= 0 or not len(mask):
        return mask
    return np.convolve(mask, np.ones(2 * by + 1))[by:-by] > 0.5


def _closed(mask: np.ndarray) -> np.ndarray:
    """A mask (T,), and its gaps of one or two frames: what is coupled is together."""
    return ~spread(~spread(mask, 1), 1)


def _second_differences(frames: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The bands of B'B, B the second differences: (P,), (P - 1,), (P - 2,)."""
    centre, first = np.zeros(frames), np.zeros(max(frames - 1, 0))
    second = np.ones(max(frames - 2, 0))
    if frames > 2:
        centre[:-2] += 1.0
        centre[1:-1] += 4.0
        centre[2:] += 1.0
        first[:-1] -= 2.0
        first[1:] -= 2.0
    return centre, first, second


def _add_speeds(
    normal: Normal, left: np.ndarray, right: np.ndarray, much: np.ndarray
) -> None:
    """Adds (K, m) `much` times the squared change in each step, from a frame to the
    next (K,); -1 where that is held."""
    for places in (left, right):
        there = places >= 0
        normal.add_to_diagonal(places[there], much[there])
    both = (left >= 0) & (right >= 0)
    normal.H[left[both], :, much.shape[1]] -= much[both]
