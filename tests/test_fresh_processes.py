"""Every call has a process of its own, with one thread, and may die alone."""

import os
import threading
from concurrent.futures import as_completed

import pytest

from crar_drake.fresh_processes import FreshProcesses


def process_and_threads(_: int) -> tuple[int, str]:
    return os.getpid(), os.environ["OMP_NUM_THREADS"]


def fail() -> None:
    raise ValueError("as it should")


def fail_with_what_cannot_be_sent() -> None:
    raise KeyError(threading.Lock())


def answer_what_cannot_be_sent():
    return threading.Lock()


def die() -> None:
    os._exit(3)


def test_each_call_has_a_process_and_failures_are_told() -> None:
    before = os.environ.get("OMP_NUM_THREADS")
    with FreshProcesses(2) as pool:
        calls = [pool.submit(process_and_threads, i) for i in range(3)]
        failing, dying = pool.submit(fail), pool.submit(die)
        unsent = [
            pool.submit(fail_with_what_cannot_be_sent),
            pool.submit(answer_what_cannot_be_sent),
        ]
        answers = [call.result() for call in as_completed(calls)]
        assert len({pid for pid, _ in answers} | {os.getpid()}) == 4
        assert {threads for _, threads in answers} == {"1"}
        with pytest.raises(ValueError, match="as it should"):
            failing.result()
        with pytest.raises(RuntimeError, match="KeyError: <unlocked"):
            unsent[0].result()
        with pytest.raises(RuntimeError, match="TypeError: cannot pickle"):
            unsent[1].result()
        with pytest.raises(RuntimeError, match="die ended with code 3"):
            dying.result()
    assert os.environ.get("OMP_NUM_THREADS") == before
