"""The newest messages of each sender, where there are more than can be read."""

from collections import deque
from collections.abc import Hashable, Iterator

# Kept of each sender: it may say several things at once, of the robot and of others.
EACH = 4
# Of so many senders at most: one more takes the place of who was silent longest.
SENDERS = 8


class NewestMessages:
    """Keeps the last `EACH` datagrams of the last `SENDERS` senders.

    However many come: nobody's flood takes the place of another one's messages, unless
    it comes from many addresses, and never that of who drives.
    """

    def __init__(self) -> None:
        self._of: dict[Hashable, deque[bytes]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._of.values()))

    def add(self, data: bytes, sender: Hashable, driver: Hashable) -> int:
        """Keeps a datagram; returns how many others were thrown away for it.

        Args:
            sender: whose it is.
            driver: of all senders who is never forgotten.
        """
        kept = self._of.pop(sender, None)
        lost = 0
        if kept is None:
            kept = deque(maxlen=EACH)
            if len(self._of) >= SENDERS:
                silent = next(each for each in self._of if each != driver)
                lost = len(self._of.pop(silent))
        lost += len(kept) == EACH
        kept.append(data)
        self._of[sender] = kept  # heard of last
        return lost

    def take(self, driver: Hashable) -> Iterator[tuple[Hashable, deque[bytes]]]:
        """Each sender with what is kept, in the order that it came; nothing is left.

        Args:
            driver: who comes first.
        """
        of, self._of = self._of, {}
        for sender in sorted(of, key=lambda each: each != driver):
            yield sender, of[sender]
