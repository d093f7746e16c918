"""What is told of a sweep, from results with round numbers."""

import io
import math

import matplotlib.image
import numpy as np
import pytest
from rich.console import Console

from benchmarks.sweep.cases import Result, _line
from benchmarks.sweep.figures import (
    clip_label,
    compare,
    merge,
    mode_figures,
    without_folders,
)
from benchmarks.sweep.plot import draw_sweep, plot_sweep
from benchmarks.sweep.report import (
    failures,
    headline,
    main,
    markdown_report,
    sweep_tables,
)

FOLDER = "/home/some body/cmu/subjects"


def result(trial: str, constraints: str = "lookahead", **changes) -> Result:
    figures = {
        "motion": f"{FOLDER}/{trial.partition('_')[0]}/{trial}.amc",
        "experiment": "wrists",
        "constraints": constraints,
        "level": "acceleration",
        "period": 1e-3,
        "duration": 10.0,
        "samples": 1000,
        "smallest_distance": 0.02,
        "smallest_pair": "left_hand - torso",
        "largest_excess": 0.0,
        "rms_task_error": 0.05,
        "mean_power": 100.0,
        "peak_torque": 200.0,
        "rms_acceleration": 10.0,
    }
    return Result(**(figures | changes))


def failed(trial: str, constraints: str = "lookahead", **changes) -> Result:
    good = result(trial, constraints)
    names = ("motion", "experiment", "constraints", "level", "period")
    case = {name: getattr(good, name) for name in names} | changes
    return Result(**case, error=f"{good.motion}:7: hips | are no bone")


# Both modes on three clips: on 02_01 the lookahead is better in everything; on 13_29
# the paper's mode violates; on 127_23 it holds, and the lookahead is worse.
LOOKAHEAD = [
    result("02_01", smallest_distance=0.004, smallest_pair="head - left_hand"),
    result("13_29", peak_torque=300.0, rms_task_error=0.08),
    result("127_23", peak_torque=900.0, rms_acceleration=30.0, rms_task_error=0.11),
]
PAPER = [
    result("02_01", "paper", peak_torque=201.0, rms_acceleration=11.0),
    result(
        "13_29",
        "paper",
        peak_torque=300.0,
        rms_acceleration=20.0,
        rms_task_error=0.04,
        penetrating=25,
        beyond_limit=50,
        smallest_distance=-0.015,
        largest_excess=math.radians(2.0),
    ),
    result("127_23", "paper", peak_torque=600.0, rms_acceleration=25.0, period=5e-3),
]
ALL = LOOKAHEAD + PAPER


def printed(results: list[Result]) -> str:
    console = Console(file=io.StringIO(), width=120)
    for table in sweep_tables(results):
        console.print(table)
    return console.file.getvalue()


def row(text: str, name: str, separator: str) -> list[str]:
    """Cells of the only row with that name."""
    (line,) = [
        cells
        for line in text.splitlines()
        if len(cells := [c.strip() for c in line.split(separator)]) > 2
        and cells[1] == name
    ]
    return line[2:-1]


# --- the figures ------------------------------------------------------------------


def test_results_are_in_reading_order_and_once():
    others = [
        result("02_01", "paper", level="velocity"),
        result("02_01", experiment="upper-body"),
        result("02_01", period=5e-3),
        result("05_02", "none"),
    ]
    merged = merge([*others, *reversed(ALL), *LOOKAHEAD])
    assert len(merged) == len(ALL) + len(others)
    assert [
        (r.experiment, r.constraints, r.level, r.period, clip_label(r.motion))
        for r in merged
    ] == [
        ("wrists", "none", "acceleration", 1e-3, "05_02"),
        ("wrists", "paper", "acceleration", 1e-3, "02_01"),
        ("wrists", "paper", "acceleration", 1e-3, "13_29"),
        ("wrists", "paper", "acceleration", 5e-3, "127_23"),
        ("wrists", "paper", "velocity", 1e-3, "02_01"),
        ("wrists", "lookahead", "acceleration", 1e-3, "02_01"),
        ("wrists", "lookahead", "acceleration", 1e-3, "13_29"),
        ("wrists", "lookahead", "acceleration", 1e-3, "127_23"),
        ("wrists", "lookahead", "acceleration", 5e-3, "02_01"),
        ("upper-body", "lookahead", "acceleration", 1e-3, "02_01"),
    ]


def test_the_newest_result_counts_but_not_a_newer_failure():
    old, new = result("02_01", peak_torque=1.0), result("02_01", peak_torque=2.0)
    assert merge([old, new]) == [new]
    assert merge([failed("02_01"), new]) == [new]
    assert merge([new, failed("02_01")]) == [new]


def test_figures_of_a_mode():
    paper, _, lookahead = mode_figures([*ALL, failed("05_02")])
    assert (paper.mode, len(paper.ran), paper.violated_clips) == ("paper", 2, 1)
    assert paper.total("penetrating") == 25
    assert len(lookahead.ran) == 3
    assert [clip_label(r.motion) for r in lookahead.failed] == ["05_02"]
    assert lookahead.violated_clips == 0
    assert lookahead.mean("rms_task_error") == pytest.approx(0.08)
    assert lookahead.median("peak_torque") == 300.0
    assert lookahead.extreme("smallest_distance", min) == LOOKAHEAD[0]
    assert lookahead.extreme("rms_task_error", max) == LOOKAHEAD[2]


def test_figures_that_are_not_known_do_not_count():
    unknown = result("05_02", rms_task_error=math.nan, smallest_distance=math.inf)
    (figures,) = mode_figures([unknown, LOOKAHEAD[0]])
    assert figures.mean("rms_task_error") == 0.05
    assert figures.extreme("smallest_distance", min) == LOOKAHEAD[0]
    (figures,) = mode_figures([unknown])
    assert math.isnan(figures.mean("rms_task_error"))
    assert figures.extreme("smallest_distance", min) is None
    assert row(printed([unknown]), "worst task error", "│") == ["–"]


def test_a_clip_is_compared_with_the_paper_at_its_own_period_if_there_is_one():
    slow = result("02_01", period=5e-3)
    paper = PAPER[0]
    paper_slow = result("02_01", "paper", period=5e-3)
    paper_slower = result("02_01", "paper", period=1e-2)
    (c,) = compare([slow, paper, paper_slow, paper_slower])
    assert c.paper == paper_slow
    (c,) = compare([slow, paper_slower, paper])
    assert c.paper == paper
    assert compare([slow, failed("02_01", "paper")]) == []
    assert compare([slow, result("02_01", "paper", experiment="upper-body")]) == []
    assert compare([slow, result("02_01", "paper", level="velocity")]) == []


def test_where_the_lookahead_is_not_better():
    assert {clip_label(c.lookahead.motion): c.not_better for c in compare(ALL)} == {
        "02_01": [],  # an equal error is not above the paper's
        "13_29": ["peak_torque"],  # equal; the paper's error is that of a violation
        "127_23": ["peak_torque", "rms_acceleration", "rms_task_error"],
    }


# --- the terminal -----------------------------------------------------------------


def test_the_table_has_a_column_per_mode():
    text = printed([*ALL[:5], failed("05_02")])
    assert "wrists, control period 1 ms" in text
    # paper | lookahead, in the order of the modes
    assert row(text, "clips", "│") == ["2", "3"]
    assert row(text, "clips in violation", "│") == ["1", "0"]
    assert row(text, "samples", "│") == ["2000", "3000"]
    assert row(text, "samples penetrating", "│") == ["25", "0"]
    assert row(text, "samples beyond a limit", "│") == ["50", "0"]
    assert row(text, "smallest distance", "│") == ["-15.0 mm (13_29)", "4.0 mm (02_01)"]
    assert row(text, "of the pair", "│") == ["left_hand - torso", "head - left_hand"]
    assert row(text, "farthest beyond a limit", "│") == ["2.00° (13_29)", "–"]
    assert row(text, "samples beyond a speed limit", "│") == ["0", "0"]
    assert row(text, "most beyond a speed limit", "│") == ["–", "–"]
    assert row(text, "mean task error", "│") == ["45.0 mm", "80.0 mm"]
    assert row(text, "worst task error", "│")[1] == "110.0 mm (127_23)"
    assert row(text, "mean power", "│") == ["100.0 W", "100.0 W"]
    assert row(text, "median peak torque", "│") == ["250 Nm", "300 Nm"]
    assert row(text, "median rms acceleration", "│")[0] == "15.5 rad/s²"
    assert row(text, "failed", "│") == ["0", "1"]


def test_speeds_are_told_apart_from_the_violations():
    fast = result("13_29", beyond_speed=7, largest_speed_excess=1.25)
    text = printed([fast, result("02_01", largest_speed_excess=0.0)])
    assert row(text, "clips in violation", "│") == ["0"]
    assert row(text, "samples beyond a speed limit", "│") == ["7"]
    assert row(text, "most beyond a speed limit", "│") == ["1.25 rad/s (13_29)"]
    assert headline(fast).endswith("error 50.0 mm, beyond a speed limit")
    page = markdown_report([fast])
    assert "| samples beyond a speed limit | 7 |" in page
    assert "speed limits are counted apart" in page


def test_how_steps_were_admitted_is_told():
    near = result("13_29", corrected=0.02, scaled=0.0, path_clearance=0.004)
    far = result(
        "02_01",
        corrected=0.0,
        scaled=0.005,
        path_clearance=0.01,
        unclear=3,
        longest_held_back=0.125,
    )
    text = printed([near, far])
    assert row(text, "steps corrected", "│") == ["1.00 %"]
    assert row(text, "steps scaled", "│") == ["0.25 %"]
    assert row(text, "steps with a path not clear", "│") == ["3"]
    assert row(text, "smallest path clearance", "│") == ["4.0 mm (13_29)"]
    assert row(text, "longest held back", "│") == ["0.12 s (02_01)"]
    assert headline(far).endswith("mm, braking path not clear at 3 steps")
    assert "braking path" not in headline(near)
    # Modes that admit nothing have nothing to tell.
    assert row(printed([result("13_29")]), "steps corrected", "│") == ["–"]


def test_experiments_and_periods_have_tables_of_their_own():
    others = [
        result("02_01", experiment="upper-body"),
        result("02_01", period=5e-3, constraints="paper", level="velocity"),
    ]
    text = printed([*others, *LOOKAHEAD])
    titles = [line.strip() for line in text.splitlines() if "control period" in line]
    assert titles == [
        "wrists, control period 1 ms",
        "wrists, control period 5 ms",
        "upper-body, control period 1 ms",
    ]
    assert "paper, velocity level" in text


def test_lines_of_single_results():
    assert headline(LOOKAHEAD[0]) == (
        "02_01 wrists lookahead 1 ms: 4.0 mm near, error 50.0 mm"
    )
    assert headline(PAPER[1]).endswith("error 40.0 mm, in violation")
    (line,) = failures([*ALL, failed("05_02")])
    assert line.startswith(f"05_02, wrists, lookahead, 1 ms: {FOLDER}/05/05_02.amc:7:")
    assert "failed: " in headline(failed("05_02"))


# --- the documentation ------------------------------------------------------------


def test_the_page_compares_clips_and_lists_exceptions():
    text = markdown_report(ALL)
    assert text.startswith("# ")
    assert "3 clips, 6 simulations, 60 s of simulated time" in text
    modes = text.partition("## Modes, wrists")[2].partition("##")[0]
    assert "|  | paper, 1 ms | paper, 5 ms | lookahead, 1 ms |" in modes
    assert row(modes, "samples penetrating", "|") == ["25", "0", "0"]
    assert row(modes, "worst task error", "|")[2] == "110.0 mm (127_23)"

    assert "### wrists, 1 ms\n" in text
    assert row(text, "02_01", "|") == [
        "10.0 s",
        "50.0 / 50.0",
        "200 / 201",
        "10.0 / 11.0",
        "4.0 / 20.0",
        "0 / 0",
        "0 / 0",
    ]
    assert row(text, "13_29", "|")[1:3] == ["80.0 / 40.0", "**300** / 300"]
    assert row(text, "13_29", "|")[-2:] == ["0 / 25", "0 / 50"]
    # The other period stands in the title.
    page = text.partition("### wrists, 1 ms / 5 ms\n")[2]
    assert row(page, "127_23", "|")[1] == "**110.0** / 50.0"

    exceptions = text.partition("does not do better\n\n")[2].splitlines()
    assert exceptions == [
        "- `13_29`, wrists, lookahead, 1 ms: peak torque 300 Nm, paper 300 Nm "
        "(+0.0 %); paper violates its constraints",
        "- `127_23`, wrists, lookahead, 1 ms: peak torque 900 Nm, paper 600 Nm "
        "(+50.0 %); rms acceleration 30.0 rad/s², paper 25.0 rad/s² (+20.0 %); task "
        "error 110.0 mm, paper 50.0 mm (+120.0 %); paper holds its constraints",
    ]


def test_reasons_stand_beside_their_exceptions(tmp_path):
    reasons = tmp_path / "reasons.json"
    reasons.write_text('{"13_29, wrists": "it turns"}')
    results = tmp_path / "results.csv"
    results.write_text("".join(map(_line, [None, *ALL])))
    page = tmp_path / "page.md"
    main([str(results), "--reasons", str(reasons), "--out", str(page)])
    text = page.read_text()
    assert "(+0.0 %); paper violates its constraints; it turns\n" in text
    assert text.count("it turns") == 1
    reasons.write_text("{")
    with pytest.raises(SystemExit):
        main([str(results), "--reasons", str(reasons)])


def test_the_page_without_exceptions_and_without_comparison():
    assert "not do better\n\nNowhere.\n" in markdown_report([LOOKAHEAD[0], PAPER[0]])
    text = markdown_report(LOOKAHEAD)
    assert "Modes, wrists" in text and "better" not in text


def test_no_folder_of_the_machine_reaches_the_page():
    text = markdown_report([*ALL, failed("05_02", "paper")])
    assert text.endswith(
        "## Failed\n\n- `05_02`, 1 case: 05_02.amc:7: hips | are no bone\n"
    )
    assert "home" not in text and "some body" not in text and "subjects" not in text


@pytest.mark.parametrize(
    "text, expected",
    [
        ("/a/b/05.asf:7: length", "05.asf:7: length"),
        ("is in neither (/a/b, ~/c/d) nor", "is in neither (b, d) nor"),
        ("'/a/b/c.amc' is 3 m/s and 1/2", "'c.amc' is 3 m/s and 1/2"),
        ("rel/at/ive.amc: no", "ive.amc: no"),
    ],
)
def test_messages_lose_their_folders(text, expected):
    assert without_folders(text, "rel/at/ive.amc") == expected


def test_labels():
    assert clip_label("/x/05_02.amc") == clip_label("cmu:05_02") == "05_02"
    assert clip_label("dance") == "dance"


def test_the_module_remakes_the_page_from_several_files(tmp_path, capsys):
    files = []
    for i, results in enumerate((LOOKAHEAD, PAPER)):
        files.append(tmp_path / f"{i}.csv")
        files[-1].write_text("".join(map(_line, [None, *results])) + "cut o")
    page, plot = tmp_path / "docs/measurements/sweep.md", tmp_path / "sweep.svg"
    main([*map(str, files), "--out", str(page), "--plot", str(plot)])
    assert page.read_text() == markdown_report(ALL)
    assert page.read_text() in capsys.readouterr().out
    assert "<svg" in plot.read_text()
    with pytest.raises(SystemExit):
        main([str(tmp_path / "nowhere.csv")])
    assert "nowhere.csv: there is no such file" in capsys.readouterr().err
    files[0].write_text(_line(None))
    with pytest.raises(SystemExit):
        main([str(files[0])])
    assert "no results" in capsys.readouterr().err


# --- the plot ---------------------------------------------------------------------


def test_the_plot_has_a_mark_per_clip_and_mode():
    figure = draw_sweep([*ALL, failed("05_02")])
    distance, excess, error, torque = figure.axes
    names = [label.get_text() for label in distance.get_yticklabels()]
    assert names == ["02_01", "05_02", "13_29", "127_23"]
    lines = {line.get_label(): line for line in torque.get_lines()}
    assert set(lines) == {"paper, 1 ms", "paper, 5 ms", "lookahead, 1 ms"}
    np.testing.assert_allclose(lines["lookahead, 1 ms"].get_xdata(), [200, 300, 900])
    lanes = np.round(lines["lookahead, 1 ms"].get_ydata())
    np.testing.assert_allclose(lanes, [0, 2, 3])
    assert (
        lines["paper, 1 ms"].get_ydata()[0] != lines["lookahead, 1 ms"].get_ydata()[0]
    )
    assert lines["paper, 1 ms"].get_color() != lines["lookahead, 1 ms"].get_color()
    assert lines["paper, 1 ms"].get_marker() != lines["paper, 5 ms"].get_marker()
    for ax, expected in (
        (distance, [20.0, -15.0]),
        (excess, [0.0, 2.0]),
        (error, [50.0, 40.0]),
    ):
        line = {line.get_label(): line for line in ax.get_lines()}["paper, 1 ms"]
        np.testing.assert_allclose(line.get_xdata(), expected, atol=1e-12)
        low, high = ax.get_xlim()
        assert all(low < x < high for x in line.get_xdata())
    crosses = [line for line in distance.get_lines() if line.get_marker() == "x"]
    np.testing.assert_allclose(crosses[0].get_ydata(), [1])
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "paper, 1 ms",
        "paper, 5 ms",
        "lookahead, 1 ms",
    ]


def test_the_plot_grows_with_the_clips(tmp_path):
    heights = []
    for count in (5, 40):
        results = [
            result(f"{i:02d}_01", constraints, experiment=experiment)
            for i in range(count)
            for constraints in ("none", "paper", "lookahead")
            for experiment in ("wrists", "upper-body")
        ]
        plot_sweep(results, tmp_path / "plot.png")
        heights.append(matplotlib.image.imread(tmp_path / "plot.png").shape[0])
    # 40 lanes in two rows of axes, readable: 20 pixels or more for each.
    assert heights[1] - heights[0] > 2 * 35 * 20


@pytest.mark.parametrize(
    "results",
    [
        [failed("05_02")],
        [result("05_02", rms_task_error=math.nan, smallest_distance=math.inf)],
    ],
)
def test_the_plot_of_little_or_nothing(results, tmp_path):
    plot_sweep(results, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 1000
