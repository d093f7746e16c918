"""What asks a process to end: Ctrl-C, `kill`, and a terminal that goes away."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupts:
    """Requests to end, as they come by signals.

    The first raises KeyboardInterrupt; after `hold` it waits, to be looked at between
    two steps: Drake is in the middle of one, whose samples would not fit together, or a
    robot moves. Then only Ctrl-C (SIGINT) counts: a terminal that goes away sends
    SIGHUP twice, the shell's and the system's. Another Ctrl-C does not wait, for a step
    that never ends; it raises once, so that further ones do not disturb tidying up.

    Attributes:
        asked: whether any came.
    """

    def __init__(self) -> None:
        self.asked = False
        self._held = self._waits = self._raised = False

    def hold(self) -> None:
        """Lets the next request wait."""
        self._held, self._waits, self._raised = True, False, False

    def release(self) -> None:
        """Lets none wait any more.

        Raises:
            KeyboardInterrupt: one waits that came since `hold`.
        """
        self._raised, self._held = self._waits, False
        if self._waits:
            raise KeyboardInterrupt

    def handle(self, number: int, _: FrameType | None) -> None:
        """Takes a signal."""
        if self.asked and number != signal.SIGINT:
            return
        self.asked = True
        if self._held and not self._waits:
            self._waits = True
        elif not self._raised:
            self._raised = True
            raise KeyboardInterrupt


@contextmanager
def held_interrupts() -> Iterator[Interrupts]:
    """Holds what would raise KeyboardInterrupt, while the block lasts.

    In other threads signals cannot be handled, and an ignored one or a handler of the
    caller's stays.
    """
    interrupts = Interrupts()
    interrupts.hold()

    def raises(handler: object) -> bool:
        return handler is signal.default_int_handler or _of(handler) is not None

    with _handling(interrupts, raises) as before:
        try:
            yield interrupts
        finally:
            for outer in filter(None, map(_of, before)):
                outer.asked |= interrupts.asked


@contextmanager
def all_as_ctrl_c() -> Iterator[None]:
    """SIGTERM and SIGHUP raise KeyboardInterrupt, too, unless they are ignored: whoever
    asks a command to end, what it did till then is kept."""
    with _handling(Interrupts(), lambda handler: handler is signal.SIG_DFL):
        yield


@contextmanager
def undisturbed(doing: str) -> Iterator[None]:
    """Lets what would end the process wait for the end of a block that nothing may
    interrupt, not even a handler of Python's; but a Ctrl-C that is not the first ends
    it at once.

    Args:
        doing: what the block does, for what is said of it.
    """
    waiting, handlers = [], {}

    def wait(number: int, _: FrameType | None) -> None:
        waiting.append(number)
        if len(waiting) > 1:
            return
        # Python's own handlers come only once the block lets them.
        if signal.SIGINT in handlers:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        with suppress(OSError):  # not print, whose lock may be held
            os.write(2, f"ends once this is {doing}; at once by Ctrl-C\n".encode())

    try:
        if threading.current_thread() is threading.main_thread():
            for number in ENDS:
                if callable(signal.getsignal(number)):
                    handlers[number] = signal.signal(number, wait)
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if waiting:
            signal.raise_signal(waiting[0])


@contextmanager
def _handling(
    interrupts: Interrupts, ours: Callable[[object], bool]
) -> Iterator[list[object]]:
    """Handles those of ENDS whose handlers are ours; yields these handlers."""
    before = {}
    if threading.current_thread() is threading.main_thread():
        before = {n: h for n in ENDS if ours(h := signal.getsignal(n))}
    for number in before:
        signal.signal(number, interrupts.handle)
    try:
        yield list(before.values())
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _of(handler: object) -> Interrupts | None:
    """Whose method a handler is; None of others."""
    owner = getattr(handler, "__self__", None)
    return owner if isinstance(owner, Interrupts) else None
