"""The benchmark measures what it says; how fast that is, no test asks."""

import json
import os
import time
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest

from benchmarks import step as command
from benchmarks.plain import as_it_is, plain
from benchmarks.step import (
    HANDS,
    LIMITED,
    MODES,
    BenchSettings,
    find_targets,
    fit_growth,
    main,
    run_bench,
)
from benchmarks.step_compiling import measure_process
from benchmarks.step_report import draw_bench, tables
from benchmarks.step_robots import FAR, PERIOD, make_robot, make_samples
from benchmarks.step_subjects import (
    OVERHEAD,
    PARTS,
    Bound,
    Step,
    StepInParts,
    samples_of_run,
    samples_with_poses,
)
from benchmarks.step_timing import (
    Stopwatch,
    Subject,
    replaced,
    time_side_by_side,
)
from crar_drake.control.parameters import CrarParameters
from crar_drake.equations import capsule_distances, compilation
from crar_drake.errors import CrarError
from crar_drake.judging.referee import Referee
from crar_drake.run import run_scenario
from crar_drake.simulation.scenario import Scenario

SHORT = BenchSettings(
    duration=0.06,
    repeats=1,
    scaling_steps=3,
    measurements=("step", "simulation", "scaling"),
    cases=("wrists", HANDS, LIMITED),
    scaling={
        "pairs": [(7, 1, 5, 0), (7, 1, 9, 0)],
        "joints": [(7, 1, 5, 0), (8, 1, 5, 0)],
    },
)


@pytest.fixture(scope="module")
def result() -> dict:
    return run_bench(SHORT)


@pytest.fixture(scope="module", params=MODES)
def short_run(request):
    """A run of a few steps: its controller's parameters, model and samples."""
    parameters = CrarParameters(constraints=request.param, blend_time=0.01)
    scenario = Scenario(
        motion="dance", experiment="wrists", controller=parameters, duration=0.03
    )
    run = run_scenario(scenario, record=False)
    return parameters, run, samples_of_run(run)


# --- the step ---------------------------------------------------------------------


def test_the_timed_steps_are_those_of_the_simulation(short_run):
    parameters, run, samples = short_run
    step = Step(run.setup.model, parameters, samples)
    for _ in range(2):
        for k in range(len(samples)):
            step.prepare(k)
            step()
            np.testing.assert_array_equal(step.torque, run.log.actuation[k])
        step.restart()


def test_steps_are_taken_in_their_order(short_run):
    parameters, run, samples = short_run
    step = Step(run.setup.model, parameters, samples)
    step.prepare(0)
    with pytest.raises(ValueError, match="step 2 does not follow on step 0"):
        step.prepare(2)


def test_a_step_in_parts_computes_the_same_and_calls_every_part(short_run):
    parameters, run, samples = short_run
    model = run.setup.model
    step = StepInParts(model, parameters, samples)
    step.begin()
    for k in range(len(samples)):
        step.prepare(k)
        step()
        np.testing.assert_array_equal(step.torque, run.log.actuation[k])
    step.end()
    for part in PARTS:
        assert (step.calls[part] >= 1).all(), part
        assert (step.own[part] > 0.0).mean() > 0.9, part
    # All is as it was: nothing of the model is wrapped any more.
    assert (
        not {"measure", "effort_per_acceleration", "inverse_dynamics"}
        & vars(model).keys()
    )
    assert "solve" not in vars(step.controller.law)


def test_the_bound_evaluates_the_distances_of_the_step(short_run):
    """They are those that the simulation logged, in as many configurations as the
    mode looks at; the other one is where the robot would come to rest."""
    parameters, run, samples = short_run
    model = run.setup.model
    bound = Bound(model, parameters, samples)
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    # A row for each pair of shapes, or of those only the nearest of each pair.
    configurations, rows = 1, len(model.pairs)
    nearest = np.arange(rows)[:, np.newaxis]
    if parameters.constraints == "lookahead":
        configurations, nearest = 2, model.pairs.shape_pairs
        rows = nearest.max() + 1
        assert rows > len(model.pairs)
    for k in range(len(samples)):
        bound.prepare(k)
        bound()
        d = bound.d.reshape(configurations, rows)[:, nearest].min(axis=2)
        np.testing.assert_allclose(
            d[0], run.log.signed_distances[k], rtol=1e-12, atol=1e-12
        )
        if configurations == 2:
            resting = samples.q[k] + parameters.braking_horizon * samples.v[k]
            np.testing.assert_allclose(d[1], referee.distances(resting), atol=1e-9)
        shape = (configurations, rows, model.n + model.n_p)
        assert bound.dd_dv.shape == shape


@pytest.mark.skipif(not compilation.IS_COMPILED, reason="needs Numba, not disabled")
def test_the_plain_package_is_another_and_compiles_nothing():
    package, ours = plain(), as_it_is()
    assert hasattr(ours.nearest_of_pairs, "signatures")  # Numba's
    assert not hasattr(package.nearest_of_pairs, "signatures")
    assert package.CrarController is not ours.CrarController
    # Whoever imports now gets the first copy, and Numba compiles again.
    assert ours.nearest_of_pairs is capsule_distances.nearest_of_pairs
    assert not compilation.numba.config.DISABLE_JIT


@pytest.mark.parametrize("effort_limits", [False, True])
def test_the_plain_step_computes_the_same(short_run, effort_limits):
    parameters, run, samples = short_run
    parameters = replace(parameters, respect_effort_limits=effort_limits)
    model = run.setup.model
    step = Step(model, parameters, samples)
    other = command._plain_step(model, parameters, samples)
    for k in range(len(samples)):
        step.prepare(k)
        step()
        other.prepare(k)
        other()
        scale = np.abs(step.torque).max()
        np.testing.assert_allclose(other.torque, step.torque, atol=1e-9 * scale)


def test_poses_are_those_that_the_states_have(short_run):
    """So a robot that follows them from state to state has no error."""
    parameters, run, samples = short_run
    model = command._steps_of(SHORT, HANDS, parameters.constraints)[0]
    assert [task.kind for task in model.tasks] == ["pose", "pose"]
    found = samples_with_poses(samples, model, parameters)
    workspace = model.MakeWorkspace()
    for k in (0, 7, len(samples) - 1):
        state = model.evaluate(workspace, samples.q[k], samples.v[k])
        asked = model.layout.pack(state.R, state.p, state.v)[: -model.m]
        np.testing.assert_allclose(found.tasks[k, : -model.m], asked)
    # The desired acceleration is the change of the desired velocity.
    v = found.tasks[:, model.layout.size_x :][:, : model.m]
    a = found.tasks[:, -model.m :]
    moved = (v[11] - v[9]) / (2.0 * parameters.period)
    np.testing.assert_allclose(a[10], moved, rtol=1e-9, atol=1e-9)
    assert np.abs(found.vdot).max() > 0.0


def test_the_mass_matrix_counts_within_effort_limits(short_run, monkeypatch):
    parameters, run, samples = short_run
    model = run.setup.model
    for respected in (False, True):
        limited = replace(parameters, respect_effort_limits=respected)
        bound = Bound(model, limited, samples)
        bound.prepare(1)
        plant = Counting(model.plant)
        with replaced([(model, "plant", lambda _, plant=plant: plant)]):
            bound()
        assert plant.calls.count("CalcMassMatrix") == respected
        assert plant.calls.count("CalcInverseDynamics") == 1


class Counting:
    """A plant that knows which of its methods were called."""

    def __init__(self, plant) -> None:
        self.plant, self.calls = plant, []

    def __getattr__(self, name: str):
        self.calls.append(name)
        return getattr(self.plant, name)


def test_the_bound_visits_every_moving_link_once(short_run):
    parameters, run, samples = short_run
    model = run.setup.model
    bound = Bound(model, parameters, samples)
    plant = model.plant
    moving = {
        min(int(b.index()) for b in plant.GetBodiesWeldedTo(body))
        for body in model.pairs.bodies
        if not plant.IsAnchored(body)
    }
    assert bound.num_links == len(moving)  # the wrists are on links that are watched
    bound.prepare(3)
    bound()
    context = bound._workspace.plant_context
    np.testing.assert_array_equal(plant.GetPositions(context), samples.q[3])


# --- timing -----------------------------------------------------------------------


class Sleep(Subject):
    def __init__(self, seconds: float) -> None:
        self.seconds, self.prepared = seconds, []

    def prepare(self, k: int) -> None:
        self.prepared.append(k)

    def __call__(self) -> None:
        time.sleep(self.seconds)


def test_wall_time_counts_waiting_and_processor_time_does_not():
    subjects = {"short": Sleep(1e-3), "long": Sleep(4e-3)}
    timings = time_side_by_side(subjects, 6, block=3)
    assert subjects["long"].prepared == [0, 1, 2, 3, 4, 5]
    assert timings["long"].kept.tolist() == [False, True, True, False, True, True]
    figures = timings["long"].figures()
    assert 4e-3 <= figures["median"] <= figures["p99"]
    assert figures["cpu_median"] < 2e-3
    assert timings["short"].wall.min() >= 1e-3
    assert time_side_by_side(subjects, 2, block=1)["long"].kept.all()


def test_a_stopwatch_tells_a_function_from_those_that_it_calls(monkeypatch):
    """By a clock that goes on where it is told to, a second and a half in all."""
    watch, now = Stopwatch(), 0.0

    def passes(seconds: float) -> None:
        nonlocal now
        now += seconds

    monkeypatch.setattr(time, "perf_counter", lambda: now)
    inner = watch.timed("inner", lambda: passes(0.5))

    def outer() -> None:
        inner()
        passes(0.25)
        inner()

    watch.timed("outer", outer)()
    assert watch.calls == {"inner": 2, "outer": 1}
    # Less what the watch itself takes, which is measured in microseconds.
    assert watch.own == pytest.approx({"inner": 1.0, "outer": 0.25}, abs=1e-3)


def test_replaced_functions_come_back_after_an_error():
    class Owner:
        def method(self):
            return "method"

    owner = Owner()
    owner.own = lambda: "own"
    before = vars(owner).copy()
    with (
        pytest.raises(KeyError),
        replaced([(owner, "method", lambda f: lambda: f() * 2)]),
    ):
        assert owner.method() == "methodmethod"
        raise KeyError
    with replaced([(owner, "own", lambda f: lambda: f() * 2)]):
        assert owner.own() == "ownown"
    assert vars(owner) == before


# --- robots that are made up ------------------------------------------------------


@pytest.mark.parametrize(
    "joints, tasks, near, far",
    [(7, 2, 5, 0), (14, 2, 200, 0), (14, 1, 10, 190), (60, 20, 30, 0)],
)
def test_robots_have_the_numbers_asked_for(joints, tasks, near, far):
    model = make_robot(joints, tasks, near, far)
    assert (model.n, model.n_p) == (joints, 0)
    assert model.m == 3 * tasks
    assert len(model.pairs) == len(set(model.pairs.names)) == near + far


def test_far_pairs_are_beyond_the_influence_distance_and_near_ones_within():
    model = make_robot(14, 2, 200, 190)
    parameters = CrarParameters(period=PERIOD, blend_time=0.0)
    samples = make_samples(model, parameters, 40)
    assert np.abs(samples.v).max() > 0.1
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    influence = parameters.lookahead.influence_distance
    for q, v in zip(samples.q[::8], samples.v[::8], strict=True):
        resting = q + parameters.braking_horizon * v
        for d in (referee.distances(q), referee.distances(resting)):
            assert 0.0 < d[:200].min() and d[:200].max() < influence
            assert d[200:].min() > FAR > influence


def test_a_smaller_robot_watches_a_part_of_the_pairs_of_a_larger():
    small, large = make_robot(14, 2, 20), make_robot(14, 2, 200)
    assert small.pairs.names == large.pairs.names[:20]


def test_robots_that_cannot_be_made():
    with pytest.raises(ValueError, match="8 tasks need as many links, not 7"):
        make_robot(7, 8, 5)
    with pytest.raises(ValueError, match="7 links have 105 pairs, not 106"):
        make_robot(7, 1, 106)


def test_growth_of_a_power_law():
    sizes = [1.0, 10.0, 100.0]
    grown = fit_growth(sizes, [3e-6 * s**1.5 for s in sizes])
    assert grown["exponent"] == pytest.approx(1.5)
    assert grown["last_exponent"] == pytest.approx(1.5)
    line = fit_growth([0, 10, 30], [5e-6, 6e-6, 8e-6])
    assert line["per_unit"] == pytest.approx(1e-7)
    assert line["last_over_first"] == pytest.approx(1.6)


# --- the results ------------------------------------------------------------------


def test_the_result_has_every_case(result):
    rows = {"wrists": 6, HANDS: 12, LIMITED: 21}
    assert [(e["case"], e["constraints"]) for e in result["step"]] == [
        (case, mode) for case in rows for mode in MODES
    ]
    for e in result["step"]:
        found = (e["joints"], e["task_rows"], e["pairs"])
        assert found == (11, rows[e["case"]], 30)
        assert e["steps"] == 61
        for order in ("in_a_row", "by_turns"):
            timed = e[order]
            for name in ("step", "bound", *["plain step"] * compilation.IS_COMPILED):
                figures = timed[name]
                assert 0.0 < figures["median"] <= figures["p99"]
                assert 0.0 < figures["cpu_median"] <= figures["cpu_p99"]
            step, bound = timed["step"], timed["bound"]
            assert timed["ratio"] == step["median"] / bound["median"]
            assert timed["cpu_ratio"] == step["cpu_median"] / bound["cpu_median"]
            if not compilation.IS_COMPILED:
                assert timed["plain step"] is None
    cases = [
        (e["constraints"], e["plain"], e["recording"]) for e in result["simulation"]
    ]
    assert sorted(cases) == [
        (mode, is_plain, recording)
        for mode in sorted(MODES)
        for is_plain in (False, True)[: 1 + compilation.IS_COMPILED]
        for recording in (False, True)
    ]
    for e in result["simulation"]:
        assert len(e["wall"]) == 1
        assert e["real_time_factor"] == pytest.approx(0.06 / e["wall"][0])
    assert [(e["quantity"], e["sizes"]) for e in result["scaling"][::2]] == [
        ("pairs", [5, 9]),
        ("joints", [7, 8]),
    ]
    json.dumps(result)


def test_the_parts_are_the_whole_step(result):
    for e in result["step"]:
        assert list(e["parts"]) == [*PARTS, OVERHEAD]
        assert sum(e["parts"].values()) == pytest.approx(
            e["in_a_row"]["step"]["median"]
        )
        assert all(e["parts"][part] > 0.0 for part in PARTS)


@pytest.mark.slow
def test_what_a_process_takes_to_be_ready():
    """Here where all is compiled already; `test_compilation` tells first from later."""
    times = measure_process(dict(os.environ), "none")
    assert 0.0 < times["cpu"] and 0.0 < times["wall"]
    with pytest.raises(CrarError, match="cannot be measured: .*'nine'"):
        measure_process(dict(os.environ), "nine")


def test_the_worst_case_decides_on_a_target():
    case = {"case": "wrists", "constraints": "paper"}
    figures = {"median": 1.0, "p99": 1.5, "cpu_median": 1.0, "cpu_p99": 3.0}

    def step(ratio: float) -> dict:
        timed = {"step": figures, "bound": figures, "cpu_ratio": ratio}
        return case | {"in_a_row": timed, "by_turns": timed | {"cpu_ratio": 1.0}}

    simulated = [
        case | {"plain": p, "recording": r, "real_time_factor": f, "cpu_factor": f}
        for p, r, f in (
            (False, False, 1.0),
            (False, True, 3.5),
            (False, True, 3.1),
            (True, True, 1.1),
        )
    ]
    targets = find_targets(
        {
            "step": [step(1.7), step(1.2)],
            "simulation": simulated,
            "compiling": {"first": {"cpu": 46.0}},
            "scaling": [],
        }
    )
    assert [(t["target"], t["value"], t["reached"]) for t in targets] == [
        ("paper: step over bound, in a row, processor time", 1.7, False),
        ("paper: step over bound, by turns, processor time", 1.0, True),
        ("step: 99th percentile over median, wall clock", 1.5, True),
        ("step: 99th percentile over median, processor time", 3.0, False),
        ("simulation: real-time factor with recording, wall clock", 3.1, True),
        ("simulation: real-time factor with recording, processor time", 3.1, True),
        ("first compile, processor time [s]", 46.0, False),
    ]


def test_tables_and_plot(result, tmp_path):
    for table in tables(result):
        assert table.rows
        assert all(len(row) == len(table.columns) for row in table.rows)
    # Of a run that measured nothing, too.
    nothing = run_bench(BenchSettings(measurements=()))
    for i, measured in enumerate((result, nothing)):
        draw_bench(measured).savefig(tmp_path / f"{i}.png")
    assert matplotlib.image.imread(tmp_path / "0.png").std() > 0.05
    assert nothing["targets"] == []


def test_a_page_without_a_place_for_tables_is_refused_at_once(tmp_path, capsys):
    page = tmp_path / "speed.md"
    page.write_text("# Speed\n")
    with pytest.raises(
        CrarError, match=r"speed\.md: needs the line <!-- step --> once"
    ):
        main(["--page", str(page), "--out", str(tmp_path / "out")])
    assert "measuring" not in capsys.readouterr().err
    assert page.read_text() == "# Speed\n"
    assert not (tmp_path / "out").exists()


def test_a_place_that_cannot_be_written_to_is_refused_at_once(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    with pytest.raises(CrarError, match="name another folder"):
        main(["--out", str(tmp_path / "file/below")])
    assert "measuring" not in capsys.readouterr().err


def test_command(tmp_path, monkeypatch, capsys):
    """What the options become, and what is written."""
    seen = []

    def short(settings, progress):
        seen.append(settings)
        progress("something")
        return run_bench(BenchSettings(measurements=()))

    monkeypatch.setattr(command, "run_bench", short)
    argv = ["--quick", "--only", "scaling,step", "--motion", "boxing"]
    argv += ["--out", str(tmp_path / "b"), "--page", str(tmp_path / "page.md")]
    (tmp_path / "page.md").write_text("# Speed\n\n<!-- step -->\n<!-- end -->\n")
    main(argv)
    assert seen[0].measurements == ("scaling", "step")
    assert (seen[0].motion, seen[0].repeats) == ("boxing", 1)
    assert capsys.readouterr().err == "measuring: something\n"
    written = json.loads((tmp_path / "b/bench.json").read_text())
    assert written["arithmetic"] == compilation.arithmetic()
    assert (tmp_path / "b/bench.png").is_file()
    assert "What is to be reached" in (tmp_path / "page.md").read_text()


def test_a_mistyped_measurement_or_motion(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["--only", "steps", "--out", str(tmp_path)])
    assert "did you mean 'step'?" in capsys.readouterr().err
    argv = ["--only", "step", "--motion", "danse", "--out", str(tmp_path)]
    with pytest.raises(CrarError, match="dance"):
        main(argv)
    assert not list(tmp_path.iterdir())


def test_the_lookahead_is_timed_with_another_preview_or_none_if_asked_for():
    """And no other mode, which has none."""
    settings = replace(SHORT, preview=0.2)
    ahead = command._scenario(settings, "wrists", "lookahead").controller
    assert ahead.plans and ahead.lookahead.preview == 0.2
    paper = command._scenario(settings, "wrists", "paper").controller
    assert paper.posture_gain == 0.0
    by_default = command._scenario(SHORT, "wrists", "lookahead").controller
    assert by_default.plans and by_default.lookahead.preview is None
    without = replace(SHORT, preview=0.0)
    assert not command._scenario(without, "wrists", "lookahead").controller.plans
