"""Runs that do not come to their end, or whose files do not fit: what is kept."""

import gc
import json
import re
import resource
import shutil
import signal
import threading
from contextlib import contextmanager
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

import crar_drake.results.plots
import crar_drake.run
from crar_drake.commands import main
from crar_drake.errors import CrarError, InputError, ScenarioError
from crar_drake.law.control_law import ControlLaw
from crar_drake.results.log import SimulationLog
from crar_drake.run import run_scenario
from crar_drake.simulation.scenario import Scenario, load_scenario

FILES = ["log.npz", "plot.png", "recording.html", "summary.json"]
RUN = "run dance_wrists --duration 0.2 --out it".split()
WITHOUT_PAGE = [*RUN, "--no-page"]  # takes half as long
WAIT = 120.0  # [s] longer than any process here needs


def scenario(duration: float = 0.2) -> Scenario:
    loaded = load_scenario("dance_wrists")
    loaded.duration = duration
    return loaded


def names(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module")
def whole() -> SimulationLog:
    """The log of a run that nothing stops."""
    return run_scenario(scenario()).log


@pytest.fixture
def it(tmp_path, monkeypatch):
    """The folder that RUN writes into, where an earlier run has left its files."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "it"
    folder.mkdir()
    for name in FILES:
        (folder / name).write_text("of an earlier run")
    return folder


@pytest.fixture(params=["first run", "an earlier run is there"])
def any_it(request, it):
    """The same, or a folder that is not there yet."""
    if request.param == "first run":
        shutil.rmtree(it)
    return it


def contents(folder) -> dict[str, bytes]:
    if not folder.exists():
        return {}
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def in_the_middle(monkeypatch, action, call: int = 100) -> None:
    """Makes the controller do something in its 100th step."""
    solve, calls = ControlLaw.solve, []

    def solve_until(self, *arguments):
        calls.append(1)
        if len(calls) == call:
            action()
        return solve(self, *arguments)

    monkeypatch.setattr(ControlLaw, "solve", solve_until)


def check_part(
    folder: Path, whole: SimulationLog, stopped: str, page: bool = True
) -> float:
    """That the files are the beginning of the whole run; returns its length [s]."""
    assert names(folder) == [n for n in FILES if page or n != "recording.html"]
    log = SimulationLog.load(folder / "log.npz")
    n = len(log.time)
    assert 50 < n < len(whole.time)
    np.testing.assert_array_equal(log.time, whole.time[:n])
    for name in ("q", "v", "actuation", "desired_tasks", "signed_distances"):
        np.testing.assert_array_equal(getattr(log, name), getattr(whole, name)[:n])
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["samples"] == n
    assert summary["duration"] == log.time[-1]
    assert summary["stopped"] == stopped
    assert matplotlib.image.imread(folder / "plot.png").shape[:2] == (1755, 1245)
    if page:
        text = (folder / "recording.html").read_text()
        assert text.lstrip().lower().startswith("<!doctype html>")
    return log.time[-1]


# --- errors -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "error, told",
    [
        (InputError("desired_tasks is NaN"), "desired_tasks is NaN"),
        (np.linalg.LinAlgError("singular"), "LinAlgError: singular"),
    ],
)
def test_what_came_before_an_error_is_kept(it, monkeypatch, capsys, whole, error, told):
    def fail():
        raise error

    in_the_middle(monkeypatch, fail)
    assert main(RUN) == 2
    until = check_part(it, whole, told)
    output = capsys.readouterr()
    end = re.escape(f"{told} (at {until:.3f} s of 0.2 s); it holds what was simulated")
    assert re.search(f"^crar-drake: error: {end}", output.err, re.MULTILINE)
    assert "Traceback" not in output.err
    for name in FILES:
        assert f"it/{name}" in output.out
    assert "stopped" in output.out


def test_a_defect_is_not_hidden_and_the_part_is_kept(it, monkeypatch, whole):
    def fail():
        raise ZeroDivisionError("a defect of ours")

    in_the_middle(monkeypatch, fail)
    with pytest.raises(ZeroDivisionError, match="a defect of ours") as caught:
        main(WITHOUT_PAGE)
    assert any("it holds what was simulated" in n for n in caught.value.__notes__)
    check_part(it, whole, "ZeroDivisionError: a defect of ours", page=False)


def test_an_error_in_the_first_sample_leaves_all_as_it_was(any_it, monkeypatch, capsys):
    def fail():
        raise InputError("desired_tasks is NaN")

    in_the_middle(monkeypatch, fail, call=1)
    before = contents(any_it)
    assert main(RUN) == 2
    assert "crar-drake: error: desired_tasks is NaN\n" in capsys.readouterr().err
    assert contents(any_it) == before


# --- Ctrl-C -----------------------------------------------------------------------


def interrupt() -> None:
    signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_run_is_kept(
    it, monkeypatch, capsys, whole, usual_signals, number
):
    """By Ctrl-C, by `kill`, or by a terminal that goes away."""
    in_the_middle(monkeypatch, lambda: signal.raise_signal(number))
    page = number == signal.SIGINT
    assert main(RUN if page else WITHOUT_PAGE) == 130
    until = check_part(it, whole, "interrupted", page)
    output = capsys.readouterr()
    told = f"crar-drake: interrupted at {until:.3f} s of 0.2 s; it holds what was"
    assert told in output.err
    assert "it/log.npz" in output.out and "rms task error" in output.out


def test_a_second_interrupt_does_not_wait_for_the_step(
    it, monkeypatch, whole, usual_signals
):
    def twice():
        interrupt()
        interrupt()

    in_the_middle(monkeypatch, twice)
    assert main(WITHOUT_PAGE) == 130
    assert check_part(it, whole, "interrupted", page=False) < 0.101


@pytest.mark.parametrize("first", ["while simulating", "while writing"])
def test_an_interrupt_while_writing_ends_cleanly(
    it, monkeypatch, capsys, usual_signals, first
):
    if first == "while simulating":
        in_the_middle(monkeypatch, interrupt)
    draw = crar_drake.results.plots.draw_run

    def draw_and_interrupt(log):
        figure = draw(log)
        save = figure.savefig

        def savefig(path, **options):
            save(path, **options)
            try:
                interrupt()
            finally:
                interrupt()  # the tidying up is not disturbed

        figure.savefig = savefig
        return figure

    monkeypatch.setattr(crar_drake.results.plots, "draw_run", draw_and_interrupt)
    assert main(RUN) == 130
    # Nothing of an earlier run, no plot, no temporary file.
    assert names(it) == ["log.npz", "summary.json"]
    stopped = json.loads((it / "summary.json").read_text())["stopped"]
    assert stopped == ("interrupted" if first == "while simulating" else "")
    message = capsys.readouterr().err
    assert "while the files were written" in message or "interrupted again" in message
    assert "it holds log.npz, summary.json of this run" in message


def test_a_thread_can_run_a_scenario(tmp_path):
    handler = signal.getsignal(signal.SIGINT)
    results = []
    thread = threading.Thread(
        target=lambda: results.append(run_scenario(scenario(0.01), tmp_path / "it"))
    )
    thread.start()
    thread.join(WAIT)
    assert sorted(path.name for path in results[0].files) == FILES
    assert signal.getsignal(signal.SIGINT) is handler
    # A Meshcat that were left of the page, in a cycle, would abort the process here.
    gc.collect()


def test_a_handler_of_the_callers_stays(tmp_path, monkeypatch):
    signals = []
    before = signal.signal(signal.SIGINT, lambda *_: signals.append(1))
    try:
        in_the_middle(monkeypatch, interrupt)
        result = run_scenario(scenario(), tmp_path, record=False)
    finally:
        signal.signal(signal.SIGINT, before)
    assert signals == [1]
    assert len(result.log.time) == 201


# --- a full disk ------------------------------------------------------------------


_SMALLER_THAN_A_PAGE = 800 * 1024  # [B]; larger than the log and the plot together


@contextmanager
def largest_file(size: int):
    """Limits how large files may become; the error comes from the system.

    Only while the block lasts: pytest itself may be writing into a longer file.
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_the_log_stays_if_the_page_does_not_fit(it, capsys):
    with largest_file(_SMALLER_THAN_A_PAGE):
        assert main(RUN) == 2
    output = capsys.readouterr()
    # An earlier page beside this log would mislead.
    assert names(it) == ["log.npz", "plot.png", "summary.json"]
    assert len(SimulationLog.load(it / "log.npz").time) == 201
    assert "it/recording.html: could not be written: File too large" in output.err
    assert "it holds log.npz, summary.json, plot.png of this run" in output.err
    assert "crar-drake show it/log.npz" in output.err
    assert "Traceback" not in output.err
    assert "rms task error" in output.out and "it/log.npz" in output.out
    assert "recording.html" not in output.out


def test_all_stays_as_it_was_if_the_log_does_not_fit(any_it, capsys):
    before = contents(any_it)
    with largest_file(20_000):
        assert main(RUN) == 2
    assert contents(any_it) == before
    assert any_it.exists() == bool(before), "the folder goes if it was made for this"
    output = capsys.readouterr()
    assert "it/log.npz: could not be written: File too large" in output.err
    assert "nothing was written, it is as it was" in output.err
    assert "rms task error" in output.out, "the figures are known all the same"


def test_a_defect_of_a_writer_leaves_no_older_file(it, monkeypatch):
    def fail(*arguments):
        raise ZeroDivisionError("a defect of ours")

    monkeypatch.setattr(crar_drake.results.plots, "plot_run", fail)
    with pytest.raises(ZeroDivisionError):
        main(RUN)
    assert names(it) == ["log.npz", "summary.json"]


# --- what is too long -------------------------------------------------------------


def test_a_run_that_no_memory_holds_is_refused(tmp_path):
    with pytest.raises(ScenarioError, match="at most 1e.06 s are simulated at once"):
        run_scenario(scenario(1e9), tmp_path / "it")
    with pytest.raises(
        ScenarioError, match="GiB of memory.* or no recording"
    ) as caught:
        run_scenario(scenario(2e5), tmp_path / "it")
    # What it advises is enough.
    advised = scenario(2e5)
    setup = crar_drake.run.PrepareScenario(advised)
    period = re.search(r"publish_period of at least ([\d.]+) s", str(caught.value))
    advised.visualization.publish_period = float(period[1])
    crar_drake.run.check_size(advised, setup, 2e5, record=True)

    dense = scenario(1e5)
    dense.log_period = 1e-3
    with pytest.raises(ScenarioError, match="log_period of at least") as caught:
        crar_drake.run.check_size(dense, setup, 1e5, record=False)
    dense.log_period = float(re.search(r"at least ([\d.]+) s", str(caught.value))[1])
    crar_drake.run.check_size(dense, setup, 1e5, record=False)
    assert not (tmp_path / "it").exists()


def test_the_estimate_of_the_log_is_near_its_size(whole):
    """Of the arrays that a sample holds, 8 bytes a value."""
    values = sum(
        getattr(whole, name)[0].size
        for name in SimulationLog.__dataclass_fields__
        if getattr(getattr(whole, name), "shape", ())[:1] == whole.time.shape
    )
    loaded = scenario(1e5)
    loaded.log_period = 1e-3
    setup = crar_drake.run.PrepareScenario(loaded)
    with pytest.raises(CrarError) as caught:
        crar_drake.run.check_size(loaded, setup, 1e5, record=False)
    told = float(re.search(r"about ([\d.]+) GiB", str(caught.value))[1])
    assert told * 2**30 == pytest.approx(1e8 * 4 * 8 * values, rel=0.5)
