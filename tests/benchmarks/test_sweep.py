"""The sweep: what is run, what is kept, what fails, and in which executors."""

import multiprocessing
import pickle
import re
import resource
import subprocess
import sys
import threading
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import pytest

import benchmarks.sweep.cases as sweep
from benchmarks.sweep.__main__ import main
from benchmarks.sweep.cases import (
    Case,
    Result,
    find_motions,
    make_cases,
    read_results,
    run_case,
    run_sweep,
)
from crar_drake import fresh_processes
from crar_drake.errors import CrarError, WriteError
from crar_drake.motion.catalogue import load_clip
from crar_drake.resources import builtin_motions_folder
from crar_drake.run import run_scenario
from crar_drake.simulation.scenario import Scenario

CASES = make_cases(["a", "b", "c"], constraints=["paper", "lookahead"])
WAIT = 300.0  # [s] longer than any of these threads needs, also on a busy computer


def made_up(case: Case, **changes) -> Result:
    """A result with figures that a file must not round, and words that CSV quotes."""
    figures = {
        "duration": 1.0,
        "samples": 1001,
        "smallest_distance": 0.1 + 0.2,
        "smallest_pair": 'left, "hand" - right',
        "rms_task_error": 1.0 / 3.0,
    }
    return Result(**vars(case), **(figures | changes))


class Inline(Executor):
    """Runs at once, in the caller's thread; no more than an executor must be."""

    def submit(self, function, /, *arguments):
        future = Future()
        future.set_result(function(*arguments))
        return future


class Counting(Inline):
    """Makes results up instead of simulating, and knows what it was asked for."""

    def __init__(self) -> None:
        self.cases: list[Case] = []

    def submit(self, function, case, scenario):
        assert function is run_case
        self.cases.append(case)
        return super().submit(made_up, case)


class Dying(ThreadPoolExecutor):
    """Dies in its third case, once the first two have been told."""

    def __init__(self) -> None:
        super().__init__(max_workers=1)
        self.told = threading.Event()
        self.submitted = 0

    def submit(self, function, case, scenario):
        self.submitted += 1
        return super().submit(self._work, self.submitted, case)

    def _work(self, number: int, case: Case) -> Result:
        if number > 2:
            assert self.told.wait(WAIT)
            raise MemoryError("the worker died")
        return made_up(case)


# --- what is run ------------------------------------------------------------------


def test_motions_are_found_below_folders(tmp_path):
    for name in ("b/02_10.amc", "a/01_01.amc", "b/02.asf", "b/deep/er/03_01.amc"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    one = str(tmp_path / "a/01_01.amc")
    assert find_motions([tmp_path, one, "dance", "cmu:05_02"]) == [
        one,
        str(tmp_path / "b/02_10.amc"),
        str(tmp_path / "b/deep/er/03_01.amc"),
        "dance",
        "cmu:05_02",
    ]
    with pytest.raises(CrarError, match="nowhere: neither a folder, a file nor"):
        find_motions([tmp_path / "a", tmp_path / "nowhere"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(CrarError, match="empty: there is no .amc file below"):
        find_motions([tmp_path / "empty"])
    with pytest.raises(CrarError, match="did you mean 'dance'"):
        find_motions(["danse"])


def test_every_combination_is_a_case_except_impossible_ones():
    cases = make_cases(
        ["a", "b"],
        ["wrists"],
        ["paper", "lookahead"],
        ["velocity", "acceleration"],
        [1e-3, 5e-3],
    )
    assert len(cases) == len(set(cases)) == 2 * (2 * 2 + 1 * 2)
    assert {c.level for c in cases if c.constraints == "lookahead"} == {"acceleration"}
    assert make_cases(["a"], levels=["velocity"]) == []


def test_a_case_is_judged_at_every_step_of_the_plant():
    case = Case("reaching", "wrists", "none", "acceleration", 5e-3)
    # The case replaces the scenario's tasks and modes, and nothing else of it.
    base = Scenario(motion="dance", experiment="upper-body", duration=2.0)
    base.controller.velocity_scale = 0.02  # for the motion to be too fast
    result = run_case(case, base.to_yaml())
    assert result.case == case and not result.error
    assert result.samples == 2001 and result.duration == pytest.approx(2.0)

    base.motion, base.experiment, base.log_period = "reaching", "wrists", 1e-3
    base.controller = replace(base.controller, constraints="none", period=5e-3)
    run = run_scenario(base)
    # The summary has the controller's distances, the result the referee's.
    assert result.violated
    assert result.penetrating == run.summary.penetrating_samples
    assert result.beyond_limit == run.summary.beyond_limit_samples
    distances = run.log.signed_distances
    assert result.smallest_distance == pytest.approx(distances.min(), abs=1e-9)
    assert result.beyond_speed == run.summary.beyond_speed_samples > 0
    assert result.largest_speed_excess == run.summary.largest_speed_excess > 0.0
    assert result.smallest_pair == run.summary.smallest_distance_pair
    assert result.largest_excess == pytest.approx(run.summary.largest_excess)
    for name in ("rms_task_error", "mean_power", "peak_torque", "rms_acceleration"):
        assert getattr(result, name) == getattr(run.summary, name)


# --- what is kept -----------------------------------------------------------------


def test_results_come_back_from_the_file_as_they_were(tmp_path):
    out = tmp_path / "deep/results.csv"
    told = []

    def tell(*progress):
        told.append(progress)

    results = run_sweep(CASES, out, executor=Counting(), progress=tell)
    assert [r.case for r in results] == CASES
    assert sorted((done, total) for done, total, _ in told) == [
        (n, len(CASES)) for n in range(1, len(CASES) + 1)
    ]
    read = {r.case: r for r in read_results(out)}
    for result in results:
        # repr, since NaN is not equal to itself
        assert repr(read[result.case]) == repr(result) == repr(made_up(result.case))


def test_a_sweep_whose_executor_died_repeats_nothing_that_is_finished(tmp_path):
    out = tmp_path / "results.csv"

    with Dying() as dying:

        def tell(done, total, newest):
            if done == 2:
                dying.told.set()

        with pytest.raises(MemoryError, match="the worker died"):
            run_sweep(CASES, out, executor=dying, progress=tell)
    kept = {r.case for r in read_results(out)}
    assert kept == set(CASES[:2])

    counting, told = Counting(), []
    results = run_sweep(
        CASES, out, executor=counting, progress=lambda done, *_: told.append(done)
    )
    assert counting.cases == CASES[2:]
    assert told == list(range(3, len(CASES) + 1))
    assert [r.case for r in results] == CASES

    nothing = Counting()
    run_sweep(CASES, out, executor=nothing)
    assert nothing.cases == []


def test_interrupting_cancels_what_waits(tmp_path):
    out = tmp_path / "results.csv"
    begun = []
    gate = threading.Event()

    class Slow(ThreadPoolExecutor):
        def submit(self, function, case, scenario):
            return super().submit(self.work, case)

        def work(self, case):
            begun.append(case)
            if len(begun) > 1:
                gate.wait(WAIT)
            return made_up(case)

    def interrupt(done, total, newest):
        raise KeyboardInterrupt

    with Slow(max_workers=1) as pool:
        with pytest.raises(KeyboardInterrupt):
            run_sweep(CASES, out, executor=pool, progress=interrupt)
        gate.set()
    assert begun in (CASES[:1], CASES[:2]), "others were cancelled"
    assert [r.case for r in read_results(out)] == CASES[:1]


@pytest.mark.parametrize("cut", [1, 10, 60])
def test_a_line_that_was_cut_off_is_run_again(tmp_path, cut):
    out = tmp_path / "results.csv"
    run_sweep(CASES, out, executor=Counting())
    whole = out.read_text()
    last = read_results(out)[-1].case
    out.write_text(whole[:-cut])
    assert len(read_results(out)) == len(CASES) - 1

    counting = Counting()
    run_sweep(CASES, out, executor=counting)
    assert counting.cases == [last]
    assert out.read_text() == whole


def test_more_cases_are_added_and_other_ones_stay(tmp_path):
    out = tmp_path / "results.csv"
    run_sweep(CASES[:2], out, executor=Counting())
    counting = Counting()
    # A case that is named twice is one case.
    results = run_sweep(CASES[3:0:-1] + CASES[1:2], out, executor=counting)
    assert counting.cases == [CASES[3], CASES[2]]
    assert [r.case for r in results] == CASES[3:0:-1]
    assert {r.case for r in read_results(out)} == set(CASES[:4])


def test_a_case_that_failed_is_tried_again_and_replaced(tmp_path):
    out = tmp_path / "results.csv"
    run_sweep(CASES[:3], out, executor=Counting())
    lines = out.read_text()
    failed = made_up(CASES[3], error='a "bad", file')
    out.write_text(lines + sweep._line(failed))
    assert read_results(out)[-1].error == 'a "bad", file'

    counting = Counting()
    run_sweep(CASES[:4], out, executor=counting)
    assert counting.cases == [CASES[3]]
    assert [r.error for r in read_results(out)] == [""] * 4


@pytest.mark.parametrize(
    "text, expected",
    [
        ("name,age\nx,3\n", "not a sweep's file"),
        ("no table at all", "not a sweep's file"),
        (sweep._line(None) + "dance,wrists,paper\n", "line 2"),
        (sweep._line(None) + sweep._line(made_up(CASES[0])) + "a" + 19 * ",x", "ok"),
        (sweep._line(None).replace("level,", ""), "not a sweep's file"),
    ],
)
def test_other_files_are_refused_and_left_alone(tmp_path, text, expected):
    out = tmp_path / "results.csv"
    out.write_text(text)
    if expected == "ok":  # a line that is cut off is no damage
        assert len(read_results(out)) == 1
        return
    counting = Counting()
    with pytest.raises(CrarError, match=expected):
        run_sweep(CASES, out, executor=counting)
    assert out.read_text() == text
    assert counting.cases == []


# --- two at once ------------------------------------------------------------------

SLOW = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_sweep import CASES, Inline, made_up
from benchmarks.sweep.cases import run_sweep

class Slow(Inline):
    def submit(self, function, case, scenario):
        return super().submit(made_up, case)

def tell(done, total, newest):
    print(done, flush=True)
    sys.stdin.readline()

run_sweep(CASES, sys.argv[2], executor=Slow(), progress=tell)
"""


@pytest.fixture
def other_sweep(tmp_path):
    """Another process that sweeps into results.csv, and waits after its first case."""
    process = subprocess.Popen(
        [sys.executable, "-c", SLOW, Path(__file__).parent, tmp_path / "results.csv"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "1\n"
    yield process
    process.kill()
    process.communicate()


def test_two_sweeps_into_one_file_lose_nothing(tmp_path, other_sweep, pool, capsys):
    out = tmp_path / "results.csv"
    before = out.read_text()
    named = rf"results.csv: process {other_sweep.pid} on .* is writing to it; wait"
    with pytest.raises(CrarError, match=named):
        run_sweep(CASES, out, executor=Counting())
    assert main(["dance", "--out", "results.csv"]) == 2
    assert re.search(named, capsys.readouterr().err)
    assert pool.cases == []
    assert out.read_text() == before
    assert not out.with_suffix(".yaml").exists()

    other_sweep.communicate("\n" * len(CASES), timeout=WAIT)
    assert {r.case for r in read_results(out)} == set(CASES)
    more = make_cases(["d"])
    run_sweep(more, out, executor=Counting())
    assert {r.case for r in read_results(out)} == {*CASES, *more}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["results.csv"]


def test_a_sweep_that_was_killed_is_gone_on_with(tmp_path, other_sweep):
    out = tmp_path / "results.csv"
    other_sweep.kill()
    other_sweep.wait(WAIT)
    counting = Counting()
    run_sweep(CASES, out, executor=counting)
    assert 0 < len(counting.cases) < len(CASES), "what was finished is kept"
    assert {r.case for r in read_results(out)} == set(CASES)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["results.csv"]


def test_a_full_disk_keeps_what_is_finished(tmp_path):
    out = tmp_path / "results.csv"
    run_sweep(CASES[:2], out, executor=Counting())
    before = out.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        # The next line fits only in part.
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 50, limits[1]))
        with pytest.raises(WriteError, match="results.csv: could not be written: File"):
            run_sweep(CASES, out, executor=Counting())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert out.read_bytes() == before
    counting = Counting()
    run_sweep(CASES, out, executor=counting)
    assert counting.cases == CASES[2:]


# --- what fails, and where it runs ------------------------------------------------

TINY = Scenario(motion="dance", experiment="wrists", duration=0.05)


def tiny_cases(folder: Path) -> list[Case]:
    """A built-in motion, and a file that ends in the middle of a frame."""
    shipped = builtin_motions_folder()
    (folder / "performer.asf").write_bytes((shipped / "performer.asf").read_bytes())
    text = (shipped / "reaching.amc").read_text()
    (folder / "cut, off.amc").write_text(text[: len(text) // 2].rpartition(" ")[0])
    return make_cases(find_motions([folder, "dance"]), ["wrists"], periods=[5e-3])


def comparable(results: list[Result]) -> list[str]:
    return [repr(replace(result, wall_time=0.0)) for result in results]


@pytest.mark.slow
def test_any_executor_runs_the_same_sweep_and_a_bad_file_is_not_fatal(tmp_path):
    cases = tiny_cases(tmp_path)
    # Without an executor each case has a process of its own.
    by_default = run_sweep(cases, tmp_path / "d.csv", scenario=TINY, jobs=2)
    bad, good = by_default
    assert bad.case == cases[0]
    assert "cut, off.amc:" in bad.error and "\n" not in bad.error
    assert good.case == cases[1] and not good.error
    assert good.samples == 51
    assert good.resting_distance > 0.0
    assert good.path_clearance > 0.0 and good.unclear == 0
    assert 0.0 <= good.corrected + good.scaled <= 1.0
    assert good.longest_held_back >= 0.0

    spawn = multiprocessing.get_context("spawn")
    for name, executor in {
        "processes": ProcessPoolExecutor(max_workers=1, mp_context=spawn),
        "threads": ThreadPoolExecutor(max_workers=1),
        "inline": Inline(),
    }.items():
        with executor:
            results = run_sweep(
                cases, tmp_path / f"{name}.csv", scenario=TINY, executor=executor
            )
            assert executor.submit(int).result() == 0, "it is the caller's to close"
        assert comparable(results) == comparable(by_default), name


def test_a_simulation_that_diverges_is_not_fatal(tmp_path):
    shipped = builtin_motions_folder()
    (tmp_path / "performer.asf").write_bytes((shipped / "performer.asf").read_bytes())
    text = (shipped / "reaching.amc").read_text()
    # The last frame is a finite number, but no number that can be filtered.
    start, root, end = text.rpartition("\nroot ")
    far = f"{start}{root}1e300 {end.partition(' ')[2]}"
    (tmp_path / "far.amc").write_text(far)
    case = Case(str(tmp_path / "far.amc"), "wrists", "paper", "acceleration", 1e-3)
    result = run_case(case, TINY.to_yaml())
    assert result.case == case
    # An overflow is an error under pytest; elsewhere it is found out later.
    assert result.error.startswith(("RuntimeError: ", "RuntimeWarning: overflow"))


def test_a_process_that_dies_fails_its_own_case_only(tmp_path):
    class Died(Counting):
        def submit(self, function, case, scenario):
            future = super().submit(function, case, scenario)
            if case == CASES[1]:
                future = Future()
                future.set_exception(RuntimeError("the process\nended with code -9"))
            return future

    out = tmp_path / "results.csv"
    results = run_sweep(CASES, out, executor=Died())
    assert [r.error for r in results if r.error] == ["the process ended with code -9"]
    assert results[1].case == CASES[1] and results[1].error
    assert len(read_results(out)) == len(CASES)


def test_case_function_and_result_can_be_sent_to_another_machine():
    function, result = pickle.loads(pickle.dumps((run_case, made_up(CASES[0]))))
    assert function is run_case
    assert repr(result) == repr(made_up(CASES[0]))


# --- the command ------------------------------------------------------------------


@pytest.fixture
def pool(tmp_path, monkeypatch):
    """An empty working folder, and an executor in the place of the processes."""
    monkeypatch.chdir(tmp_path)
    counting = Counting()

    def make(jobs):
        counting.jobs = jobs
        return counting

    monkeypatch.setattr(fresh_processes, "FreshProcesses", make)
    return counting


@pytest.mark.slow
def test_a_frame_rate_is_that_of_all_motions(tmp_path, monkeypatch, capsys):
    """A dance of 7.8 s at 60 Hz lasts half a tenth of a second at 9600 Hz."""
    monkeypatch.chdir(tmp_path)
    argv = "dance --experiment wrists --jobs 1 --period 0.005 --out it/all.csv"
    assert main([*argv.split(), "--frame-rate", "9600"]) == 0
    (result,) = read_results("it/all.csv")
    expected = load_clip("dance").num_frames / 9600.0
    assert result.duration == pytest.approx(expected, abs=2e-3)
    capsys.readouterr()
    assert main(argv.split()) == 2
    assert "--frame-rate (see it/all.yaml)" in capsys.readouterr().err


def test_the_command_simulates_tells_and_continues(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    # What runs cases is tested above.
    monkeypatch.setattr(fresh_processes, "FreshProcesses", ThreadPoolExecutor)
    bad, _ = tiny_cases(tmp_path)
    argv = ["dance", bad.motion, "--experiment", "wrists", "--jobs", "1"]
    argv += ["--duration", "0.1", "--period", "0.005", "--out", "it/all.csv"]
    assert main([*argv, "--constraints", "paper,lookahead"]) == 0
    printed = capsys.readouterr()
    assert "wrists, control period 5 ms" in printed.out
    assert "4/4" in printed.err
    assert printed.err.count("failed: cut, off, wrists, ") == 2
    assert printed.out.splitlines()[-2:] == ["it/all.csv", "it/all.png"]
    assert matplotlib.image.imread("it/all.png").shape[0] > 200
    names = sorted(path.name for path in Path("it").iterdir())
    assert names == ["all.csv", "all.png", "all.yaml"]
    results = [r for r in read_results("it/all.csv") if not r.error]
    assert [r.duration for r in results] == pytest.approx([0.1, 0.1])

    before = Path("it/all.csv").read_text()
    # What differs between the results' scenarios is not in the results.
    argv[argv.index("0.1")] = "0.2"
    assert main(argv) == 2
    assert "another --scenario, --duration or --frame-rate" in capsys.readouterr().err
    assert Path("it/all.csv").read_text() == before


def test_the_command_runs_every_combination_once(pool, capsys):
    argv = "dance boxing --constraints none,paper --constraints lookahead "
    argv += "--period 0.001,0.005 --level acceleration,velocity --jobs 3"
    assert main(argv.split()) == 0
    assert len(pool.cases) == len(set(pool.cases)) == 2 * 2 * 2 * (2 + 2 + 1)
    assert {c.experiment for c in pool.cases} == {"wrists", "upper-body"}
    assert pool.jobs == 3
    assert "out/sweep/results.csv" in capsys.readouterr().out
    pool.cases.clear()
    assert main([*argv.split(), "--experiment", "wrists"]) == 0
    assert pool.cases == []


def test_the_scenario_says_everything_else(pool, tmp_path, monkeypatch):
    (tmp_path / "mine.yaml").write_text(
        "motion: dance\nexperiment: wrists\ncutoff: 3.0\nskeleton: x.asf\n"
        "controller: {constraints: paper, level: velocity, period: 0.002}\n"
    )
    scenarios = []
    submit = pool.submit

    def keep(function, case, text):
        scenarios.append(text)
        return submit(function, case, text)

    monkeypatch.setattr(pool, "submit", keep)
    argv = "reaching --scenario mine.yaml --duration 0.5 --out r.csv"
    assert main(argv.split()) == 0
    modes = {(c.constraints, c.level, c.period) for c in pool.cases}
    assert modes == {("paper", "velocity", 0.002)}
    for text in scenarios:
        assert "cutoff: 3.0" in text and "duration: 0.5" in text
        assert "x.asf" not in text, "it is the skeleton of another motion"


def test_interrupting_the_command_says_how_to_go_on(pool, monkeypatch, capsys):
    def interrupt(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(pool, "submit", interrupt)
    assert main(["dance", "--out", "r.csv"]) == 130
    message = capsys.readouterr().err
    assert "what is finished is in r.csv; the same command continues" in message
    assert "crar-drake: interrupted" in message


@pytest.mark.parametrize(
    "command, expected",
    [
        ("", "required: PATH"),
        ("danse", "did you mean 'dance'?"),
        ("dance --experiment wrist", "did you mean 'wrists'?"),
        ("dance --constraints paper,lookahed", "did you mean 'lookahead'?"),
        ("dance --level velocty", "did you mean 'velocity'?"),
        ("dance --level velocity", "use --level acceleration"),
        ("dance --period 0.001,", "'' is not a positive number"),
        ("dance --period 0.0015", "not a multiple of the plant's time step"),
        ("dance --jobs 0", "'0' is not a positive whole number"),
        ("dance --job 1", "unknown option --job; did you mean '--jobs'?"),
        ("dance --scenario dance_wrist", "did you mean 'dance_wrists'?"),
        ("dance --out results.png", "must be a file that ends in .csv"),
        ("dance --out .", "must be a file that ends in .csv"),
        ("dance --out other.csv", "not a sweep's file"),
    ],
)
def test_the_command_refuses_mistakes(command, expected, pool, tmp_path, capsys):
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    assert main(command.split()) == 2
    output = capsys.readouterr()
    assert output.out == "" and output.err.count("\n") == 1
    assert expected in output.err
    assert pool.cases == []
    assert [path.name for path in tmp_path.iterdir()] == ["other.csv"]
