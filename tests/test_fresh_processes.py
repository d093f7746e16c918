"""Every call has a process of its own, which may die alone; and batches of calls."""

import os
import threading
from concurrent.futures import Future, as_completed

import pytest

from crar_drake.errors import CrarError
from crar_drake.fresh_processes import FreshProcesses, in_batches


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


# --- batches --------------------------------------------------------------------


class Here:
    """Runs each call at once, and keeps what was asked for."""

    def __init__(self):
        self.batches = []

    def submit(self, work, batch, *rest):
        self.batches.append(list(batch))
        future = Future()
        try:
            future.set_result(work(batch, *rest))
        except Exception as error:
            future.set_exception(error)
        return future


def double(items, add=0):
    return [2 * x + add for x in items]


@pytest.mark.parametrize("jobs, sizes", [(2, [5, 4]), (4, [3] * 3), (1, [8, 1])])
def test_each_item_has_its_result(jobs, sizes):
    pool = Here()
    found = dict(in_batches(pool, double, range(9), 1, jobs=jobs))
    assert found == {x: 2 * x + 1 for x in range(9)}
    assert [len(batch) for batch in pool.batches] == sizes
    assert list(in_batches(pool, double, [])) == []


def test_what_a_batch_leaves_over_is_done_anew():
    pool = Here()
    found = list(in_batches(pool, lambda items: double(items)[:2], range(5), jobs=1))
    assert found == [(x, 2 * x) for x in range(5)]
    assert pool.batches == [[0, 1, 2, 3, 4], [2, 3, 4], [4]]


def dies_of_three(items):
    if 3 in items:
        os._exit(7)
    return double(items)


def test_an_item_whose_process_dies_is_told_and_spoils_no_other():
    with FreshProcesses(2) as pool:
        found = dict(in_batches(pool, dies_of_three, range(5), jobs=2))
    died = found.pop(3)
    assert found == {x: 2 * x for x in (0, 1, 2, 4)}
    assert isinstance(died, RuntimeError) and "ended with code 7" in str(died)


def test_what_the_user_can_mend_ends_all():
    def refuse(items):
        raise CrarError("no such robot")

    with pytest.raises(CrarError, match="no such robot"):
        list(in_batches(Here(), refuse, range(3)))
