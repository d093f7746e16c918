"""Requests to end, by signals: what waits, what raises, and what counts once."""

import argparse
import os
import signal
import sys

import pytest

from crar_drake.commands import main
from crar_drake.interrupts import ENDS, held_interrupts

SIGINT, SIGTERM, SIGHUP = ENDS

pytestmark = pytest.mark.usefixtures("usual_signals")


def doing(monkeypatch, command) -> int:
    """Does something as a command of the command line; its exit code."""
    said = argparse.Namespace(command=command, verbose=False)
    monkeypatch.setattr("crar_drake.commands.parse", lambda *_: said)
    return main(["show"])


def test_one_hangup_counts_once(monkeypatch):
    """It comes as two signals; tidying up is not disturbed by the second."""
    tidied = []

    def command(_) -> None:
        try:
            signal.raise_signal(SIGHUP)
        finally:
            signal.raise_signal(SIGHUP)
            signal.raise_signal(SIGTERM)
            tidied.append(True)

    assert doing(monkeypatch, command) == 130 and tidied == [True]


@pytest.mark.parametrize("first", ENDS)
def test_what_is_held_waits_and_only_ctrl_c_again_does_not(monkeypatch, first):
    def command(_) -> None:
        with held_interrupts() as interrupts:
            signal.raise_signal(first)
            assert interrupts.asked
            signal.raise_signal(SIGHUP)
            signal.raise_signal(SIGTERM)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(SIGINT)
            signal.raise_signal(SIGINT)  # once
            # What is kept is kept first: the next one waits until then.
            interrupts.hold()
            signal.raise_signal(SIGHUP)
            signal.raise_signal(SIGINT)
            with pytest.raises(KeyboardInterrupt):
                interrupts.release()
        signal.raise_signal(SIGHUP)  # the second of a terminal that goes away

    assert doing(monkeypatch, command) == 0


def test_without_a_request_nothing_is_raised():
    signal.signal(SIGTERM, signal.SIG_IGN)
    with held_interrupts() as interrupts:
        signal.raise_signal(SIGTERM)  # which the caller ignores
        assert not interrupts.asked
        interrupts.release()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(SIGINT)
    signal.signal(SIGTERM, signal.SIG_DFL)


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_who_does_not_listen_changes_no_exit_code(monkeypatch, stream):
    """As `crar-drake judge log.npz | true`: all is done, and what is violated is."""
    theirs, ours = os.pipe()
    os.close(theirs)
    monkeypatch.setattr(sys, stream, open(ours, "w"))
    done = []

    def command(_) -> int:
        for _ in range(3):
            print("x" * 100_000, file=getattr(sys, stream), flush=True)
            done.append(True)
        return 1

    assert doing(monkeypatch, command) == 1 and len(done) == 3
    getattr(sys, stream).close()
