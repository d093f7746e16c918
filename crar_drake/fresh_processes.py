"""An executor that runs every call in a process of its own."""

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from multiprocessing.connection import Connection
from typing import Any

from crar_drake.drake_warnings import recorded_warnings, tell_again

# One thread a process: the matrices are small, and threads would only queue.
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


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
