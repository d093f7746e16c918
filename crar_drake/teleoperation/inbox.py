"""Lines that wait for the next step, where there may be more than can be read."""

from collections import deque
from collections.abc import Callable, Hashable
from itertools import count, zip_longest
from typing import NamedTuple

# Of a period so much is read: lines, and bytes, which take 2.4 ms at worst.
LINES, BYTES = 64, 32_768


class Line(NamedTuple):
    """One that arrived."""

    number: int  # in the order of arrival
    text: bytes
    sender: Hashable
    arrived: float  # [s]


class Inbox:
    """Keeps the last `LINES` lines of as many senders, and hands out the newest.

    However many come: nobody's flood takes the place of another one's lines, unless it
    comes from very many addresses, and never of those of who drives.
    """

    def __init__(self) -> None:
        self._of: dict[Hashable, deque[Line]] = {}
        self._number = count()

    def __len__(self) -> int:
        return sum(map(len, self._of.values()))

    def put(self, data: bytes, sender: Hashable, now: float, driver: Hashable) -> int:
        """Keeps the lines of a datagram; returns how many others are lost for it.

        Args:
            now: when it arrived [s].
            driver: whose lines make no room for others.
        """
        before = len(self)
        kept = self._of.pop(sender, None) or deque(maxlen=LINES)
        if len(self._of) >= LINES:  # who was silent longest makes room
            del self._of[next(each for each in self._of if each != driver)]
        lines = [line for line in data.split(b"\n") if line.strip()] or [data]
        kept.extend(Line(next(self._number), line, sender, now) for line in lines)
        self._of[sender] = kept
        return before + len(lines) - len(self)

    def take(self, rank: Callable[[Hashable], object]) -> tuple[list[Line], int]:
        """The newest lines, in the order that they came, and how many others are lost.

        Nothing is left. Senders take turns, so that the newest of each are read first.

        Args:
            rank: of a sender; the lowest has the first turn.
        """
        waiting, self._of = self._of, {}
        turns = zip_longest(
            *(reversed(waiting[each]) for each in sorted(waiting, key=rank))
        )
        newest = [line for turn in turns for line in turn if line is not None]
        taken, size = [], 0
        for line in newest:
            if len(taken) < LINES and size + len(line.text) <= BYTES:
                taken.append(line)
                size += len(line.text)
        return sorted(taken), len(newest) - len(taken)
