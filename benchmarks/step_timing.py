"""Timing of short calls, side by side, and of the parts that they consist of."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

IN_A_ROW = 50  # so many samples of one subject, before the next subject's turn
BY_TURNS = 1


class Subject:
    """Something that is timed once per sample."""

    def restart(self) -> None:
        """Called before sample 0, if there were samples already."""

    def begin(self) -> None:
        """Called before a block of samples."""

    def end(self) -> None:
        """Called after a block of samples."""

    def prepare(self, k: int) -> None:
        """Gets everything ready for sample k; not timed."""

    def __call__(self) -> None:
        """What is timed."""
        raise NotImplementedError


@dataclass(frozen=True)
class Timing:
    """Durations of the samples of one subject.

    Attributes:
        wall: (K,) by the clock on the wall [s].
        cpu: (K,) of the thread on its processor [s]: as long, unless other programs
            took the processor away.
        kept: (K,) whether the sample counts: of a row the first does not, for the
            processor's caches are full of another subject's data.
    """

    wall: np.ndarray
    cpu: np.ndarray
    kept: np.ndarray

    def figures(self) -> dict[str, float]:
        """Medians and 99th percentiles [s]."""
        return {
            "median": median(self.wall[self.kept]),
            "p99": float(np.percentile(self.wall[self.kept], 99)),
            "cpu_median": median(self.cpu[self.kept]),
            "cpu_p99": float(np.percentile(self.cpu[self.kept], 99)),
        }


def median(values: np.ndarray) -> float:
    """The median as a plain number."""
    return float(np.median(values))


def time_side_by_side(
    subjects: Mapping[str, Subject], num_samples: int, block: int = IN_A_ROW
) -> dict[str, Timing]:
    """Times every subject on samples 0, 1, ..., a block of one and then of the next.

    So a machine that is slower for a while is slower for all of them. IN_A_ROW each
    subject finds its own code and data in the processor's caches; BY_TURNS it finds
    what the others left there, as between the other parts of a simulation.
    """
    wall = {name: np.empty(num_samples) for name in subjects}
    cpu = {name: np.empty(num_samples) for name in subjects}
    clock, thread_clock = time.perf_counter, time.thread_time
    for start in range(0, num_samples, block):
        for name, subject in subjects.items():
            subject.begin()
            for k in range(start, min(start + block, num_samples)):
                subject.prepare(k)
                cpu_start, wall_start = thread_clock(), clock()
                subject()
                wall_end, cpu_end = clock(), thread_clock()
                wall[name][k] = wall_end - wall_start
                cpu[name][k] = cpu_end - cpu_start
            subject.end()
    kept = np.ones(num_samples, dtype=bool)
    if 1 < block and 1 < num_samples:
        kept[::block] = False
    return {name: Timing(wall[name], cpu[name], kept) for name in subjects}


class Stopwatch:
    """How long functions take without the timed functions that they call.

    What the watch itself takes is measured once and taken off.
    """

    def __init__(self) -> None:
        self._inside = self._outside = 0.0
        self._calibrate()
        self.reset()

    def reset(self) -> None:
        """Forgets what was measured."""
        self.own: dict[str, float] = {}  # name to its time [s]
        self.calls: dict[str, int] = {}  # name to its number of calls
        self._of_children = [0.0]

    def timed(self, name: str, function: Callable) -> Callable:
        """The function, timed under a name."""

        def call(*args, **options):
            of_children = self._of_children
            of_children.append(0.0)
            start = time.perf_counter()
            try:
                return function(*args, **options)
            finally:
                elapsed = time.perf_counter() - start
                own = elapsed - of_children.pop() - self._inside
                self.own[name] = self.own.get(name, 0.0) + own
                self.calls[name] = self.calls.get(name, 0) + 1
                of_children[-1] += elapsed + self._outside

        return call

    def _calibrate(self, calls: int = 4000) -> None:
        """What a timed call costs within the time that is taken, and around it."""

        def nothing() -> None:
            pass

        def duration(function: Callable) -> float:
            rounds = []
            for _ in range(5):
                start = time.perf_counter()
                for _ in range(calls):
                    function()
                rounds.append(time.perf_counter() - start)
            return min(rounds) / calls

        self.reset()
        plain = duration(nothing)
        inside = np.inf
        for _ in range(5):
            self.reset()
            watched = self.timed("nothing", nothing)
            for _ in range(calls):
                watched()
            inside = min(inside, self.own["nothing"] / calls - plain)
        self._inside = float(inside)
        self._outside = max(duration(watched) - plain - self._inside, 0.0)


@contextmanager
def replaced(places: list[tuple[Any, str, Callable]]) -> Iterator[None]:
    """Puts functions in the place of attributes, for a while.

    Args:
        places: per function its owner (an object or a module), the attribute's name
            and what makes the replacement out of the present value.
    """
    before = []
    for owner, name, make in places:
        before.append((owner, name, vars(owner).get(name), name in vars(owner)))
        setattr(owner, name, make(getattr(owner, name)))
    try:
        yield
    finally:
        for owner, name, value, was_there in reversed(before):
            if was_there:
                setattr(owner, name, value)
            else:
                delattr(owner, name)
