"""Calls that each have a process of their own, and batches of them."""

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, contextmanager, nullcontext
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from crar_drake.drake_warnings import recorded_warnings, tell_again
from crar_drake.errors import CrarError

# One thread a process: the matrices are small, and threads would only queue.
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

# What a process prepares takes as long as a short motion, so that it does several; not
# too many, for the last ones to end together.
_MOST = 8

Item = TypeVar("Item")


class FreshProcesses(ThreadPoolExecutor):
    """Runs calls in parallel, each in a new process that ends with it.

    Drake 1.51 does not give back the memory of Python systems that declare ports, so
    that a process must not run many simulations. (`ProcessPoolExecutor` could replace
    its processes after a number of calls, but in Python 3.11 it then stalls.)

    Drake's warnings in a process are reported in this one. A process that dies fails
    its own call only. Leaving the `with` block by an exception ends the processes that
    still run.
    """

    def __init__(self, jobs: int | None = None) -> None:
        """
        Args:
            jobs: number of processes at a time; by default one per core.
        """
        super().__init__(max_workers=jobs or os.cpu_count())
        self._context = multiprocessing.get_context("spawn")
        self._running: set[multiprocessing.process.BaseProcess] = set()
        self._starting = threading.Lock()

    def submit(self, fn: Callable, /, *args: Any, **kwargs: Any) -> Future:
        """Schedules fn(*args, **kwargs); all of it must be picklable."""
        return super().submit(self._run, fn, args, kwargs)

    def __exit__(self, kind, error, trace) -> bool | None:
        if kind is not None:
            self.shutdown(wait=False, cancel_futures=True)
            for process in list(self._running):
                process.terminate()
        return super().__exit__(kind, error, trace)

    def _run(self, fn: Callable, args: tuple, kwargs: dict) -> Any:
        receiver, sender = self._context.Pipe(duplex=False)
        process = self._context.Process(
            target=_call, args=(sender, fn, args, kwargs), daemon=True
        )
        # Read by the libraries when the new process loads them, before any call.
        with self._starting, _environment(_ONE_THREAD):
            process.start()
        self._running.add(process)
        sender.close()
        try:
            succeeded, value, warnings = receiver.recv()
        except EOFError as error:
            process.join()
            raise RuntimeError(
                f"the process of {fn.__name__} ended with code {process.exitcode}"
            ) from error
        finally:
            process.join()
            self._running.discard(process)
            receiver.close()
        tell_again(warnings)
        if not succeeded:
            raise value
        return value


def given_or_fresh(
    executor: Executor | None, jobs: int | None
) -> AbstractContextManager[Executor]:
    """An executor that was given, which is the caller's to close, or a new one."""
    return FreshProcesses(jobs) if executor is None else nullcontext(executor)


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


@contextmanager
def _environment(changes: dict[str, str]) -> Iterator[None]:
    """Sets environment variables for a while."""
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _call(sender: Connection, fn: Callable, args: tuple, kwargs: dict) -> None:
    """What the new process does."""
    with recorded_warnings() as warnings:
        try:
            answer = (True, fn(*args, **kwargs))
        except Exception as error:  # handed to the caller of submit
            answer = (False, error)
    try:
        sender.send((*answer, warnings))
    except Exception as error:  # what cannot be pickled is reported in words
        succeeded, value = answer
        said = error if succeeded else value
        failure = RuntimeError(f"{type(said).__name__}: {said}")
        sender.send((False, failure, warnings))
    sender.close()
