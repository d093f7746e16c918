"""Many things worked on in an executor, several at a time."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from typing import Any, TypeVar

from crar_drake.errors import CrarError

Item = TypeVar("Item")

# What a process prepares takes as long as a short motion, so that it does several; not
# too many, for the last ones to end together.
_MOST = 8


def in_batches(
    pool: Executor,
    work: Callable[..., Sequence[Any]],
    items: Sequence[Item],
    *rest: Any,
    jobs: int | None = None,
) -> Iterator[tuple[Item, Any]]:
    """Yields each item with its result, as they come.

    Those of a batch whose process died are done again one by one; of one that dies by
    itself the result is the error.

    Args:
        work: from items to their results, or to those of the first ones, if the others
            are to be done anew.
        rest: what `work` is called with besides.
        jobs: how many batches are worked on at a time; by default one per core.

    Raises:
        CrarError: `work` did; what concerns one item alone is to be in its result.
    """
    jobs = jobs or os.cpu_count() or 1
    size = max(1, min(_MOST, -(-len(items) // jobs)))
    running: dict[Future, Sequence[Item]] = {}

    def submit(batch: Sequence[Item]) -> None:
        running[pool.submit(work, batch, *rest)] = batch

    for i in range(0, len(items), size):
        submit(items[i : i + size])
    try:
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                batch = running.pop(future)
                try:
                    results = future.result()
                except CrarError:
                    raise
                except Exception as error:  # which item was it?
                    results = [error]
                    if len(batch) > 1:
                        for item in batch:
                            submit([item])
                        continue
                yield from zip(batch, results, strict=False)
                if len(results) < len(batch):
                    submit(batch[len(results) :])
    finally:
        for future in running:
            future.cancel()
