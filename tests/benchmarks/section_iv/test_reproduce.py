"""A whole reproduction of short built-in motions: the report says what its data say."""

import base64
import csv
import json
import re
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from benchmarks.section_iv.__main__ import main
from benchmarks.section_iv.plan import LABELS, SERIES, VARIANTS, make_plan
from benchmarks.section_iv.reproduce import reproduce
from crar_drake.errors import CrarError
from crar_drake.judging.referee import Referee
from crar_drake.results.log import SimulationLog
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import position_tasks
from crar_drake.simulation.scenario import parse_scenario

DURATION = 0.2  # [s]


@pytest.fixture(scope="module")
def plan():
    return make_plan(
        ["dance", "boxing"], duration=DURATION, damping_factors=(0.1, 0.05)
    )


@pytest.fixture(scope="module")
def made(plan, tmp_path_factory):
    """The reproduction; one thread, since new processes would take as long again."""
    out = tmp_path_factory.mktemp("reproduction")
    with ThreadPoolExecutor(1) as executor:
        return reproduce(plan, out, executor=executor), out


class Page(HTMLParser):
    """Tables (rows of cells), figures, links and texts of the report."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables, self.links, self.images, self.pres = {}, [], {}, []
        self._cells = self._figure = self._pre = None
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        if tag == "table":
            self._rows = self.tables.setdefault(attributes["id"], [])
        elif tag == "tr":
            self._rows.append([])
        elif tag in ("td", "th"):
            self._cells = self._rows[-1]
            self._cells.append("")
        elif tag == "figure":
            self._figure = attributes["id"]
        elif tag == "img":
            self.images[self._figure] = attributes["src"]
        elif tag == "a":
            self.links.append(attributes["href"])
        elif tag == "pre":
            self.pres.append("")
            self._pre = True
        for name in ("src", "href"):
            assert not re.match("https?:|//", attributes.get(name, "")), attributes

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self._cells = None
        elif tag == "pre":
            self._pre = False

    def handle_data(self, data):
        if self._cells is not None:
            self._cells[-1] += data
        if self._pre:
            self.pres[-1] += data


@pytest.fixture(scope="module")
def page(made) -> Page:
    _, out = made
    return Page((out / "report.html").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def referee() -> Referee:
    description = load_robot_description("upper_body")
    model = ControlModel.FromDescription(description, position_tasks(["left_wrist"]))
    return Referee(model.plant, model.scene_graph, description.pairs)


def table(out: Path, name: str) -> list[dict[str, str]]:
    with (out / "tables" / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def dance_log(out: Path, experiment: str, series: str) -> SimulationLog:
    return SimulationLog.load(out / "logs" / f"dance_{experiment}_{series}.npz")


def test_all_figures_are_in_the_page_in_the_papers_order(made, page):
    _, out = made
    assert list(page.images) == [
        "figure-2",
        *(f"figure-3-{name}" for name in SERIES),
        *("figure-4", "figure-5", "figure-6", "figure-7"),
        *("variants-error", "variants-power", "torque-spikes", "damping"),
    ]
    for name, source in page.images.items():
        kind, data = re.fullmatch(r"data:(image/.*);base64,(.*)", source).groups()
        (file,) = (out / "figures").glob(f"{name}.*")
        assert kind == {".svg": "image/svg+xml", ".png": "image/png"}[file.suffix]
        assert base64.b64decode(data) == file.read_bytes()


def test_links_lead_to_files(made, page):
    _, out = made
    assert page.links
    for link in page.links:
        assert (out / link).is_file(), link
    pages = {link for link in page.links if link.startswith("pages/")}
    # Two motions, two experiments in three columns, three variants, and the raw dance.
    assert len(pages) == 2 * (2 * 3 + 3) + 2


def test_results_in_page_and_csv_are_those_of_the_simulations(made, page):
    result, out = made
    rows = {row["name"]: row for row in table(out, "results")}
    assert list(rows) == list(result.outcomes)
    for name, row in rows.items():
        record = json.loads((out / "results" / f"{name}.json").read_text())
        for field in ("rms_task_error", "mean_power", "smallest_distance"):
            assert float(row[field]) == record["result"][field]
    label = {text: series for series, text in LABELS.items()}
    for experiment, series in (
        ("wrists", [*SERIES, *VARIANTS]),
        ("upper-body", list(SERIES)),
    ):
        _, *body = page.tables[f"results-{experiment}"]
        assert [(row[0], label[row[1]]) for row in body] == [
            (motion, name) for motion in ("dance", "boxing") for name in series
        ]
        for row in body:
            data = rows[f"{row[0]}_{experiment}_{label[row[1]]}"]
            assert float(row[2]) == pytest.approx(
                1e3 * float(data["rms_task_error"]), abs=0.05
            )
            assert float(row[3]) == pytest.approx(float(data["mean_power"]), abs=0.05)


@pytest.mark.parametrize(
    "figure, experiment, field, factor",
    [
        ("figure-4", "wrists", "rms_task_error", 1e3),
        ("figure-5", "wrists", "mean_power", 1.0),
        ("figure-6", "upper-body", "rms_task_error", 1e3),
        ("figure-7", "upper-body", "mean_power", 1.0),
    ],
)
def test_bar_charts_show_the_results(made, figure, experiment, field, factor):
    _, out = made
    results = {row["name"]: row for row in table(out, "results")}
    unit = "mm" if factor > 1.0 else "W"
    for row in table(out, figure):
        for series in SERIES:
            data = results[f"{row['motion']}_{experiment}_{series}"]
            assert float(row[f"{series} [{unit}]"]) == pytest.approx(
                factor * float(data[field])
            )


def test_task_error_and_power_are_those_of_the_log(made):
    """From positions alone: targets against forward kinematics, torque times speed."""
    _, out = made
    results = {row["name"]: row for row in table(out, "results")}
    log = dance_log(out, "upper-body", "acceleration")
    description = load_robot_description("upper_body")
    plant = ControlModel.FromDescription(
        description, position_tasks(["left_wrist"])
    ).plant
    context = plant.CreateDefaultContext()
    squares = []
    for q, target in zip(log.q, log.desired_tasks, strict=True):
        plant.SetPositions(context, q)
        for i, name in enumerate(log.task_names.tolist()):
            frame = plant.GetFrameByName(description.task_frames[name])
            p = frame.CalcPoseInWorld(context).translation()
            squares.append(np.sum((target[3 * i : 3 * i + 3] - p) ** 2))
    power = [
        sum(
            abs(tau * v[log.position_names.tolist().index(name)])
            for name, tau in zip(log.actuator_names.tolist(), actuation, strict=True)
            if name in log.controlled_names
        )
        for v, actuation in zip(log.v, log.actuation, strict=True)
    ]
    row = results["dance_upper-body_acceleration"]
    assert float(row["rms_task_error"]) == pytest.approx(np.sqrt(np.mean(squares)))
    assert float(row["mean_power"]) == pytest.approx(np.mean(power))


def test_violations_and_distances_are_the_referees(made, referee):
    _, out = made
    raw = dance_log(out, "wrists", "raw")
    frames = [round(i / 0.06) for i in range(round(60 * DURATION) + 1)]  # 60 Hz
    rows = table(out, "figure-2")
    counts = referee.violations(raw.q[frames]).count
    assert [int(row["violations"]) for row in rows] == counts.tolist()
    for series in ("raw", *SERIES):
        log = dance_log(out, "upper-body", series)
        rows = table(out, f"figure-3-{series}")
        assert len(rows) == len(frames)
        for row, sample in list(zip(rows, frames, strict=True))[::8]:
            shown = [float(row[f"{a} - {b}"]) for a, b in referee.pairs]
            np.testing.assert_allclose(
                shown, referee.distances(log.q[sample]), atol=1e-6
            )


def test_findings_in_page_and_csv_are_those_that_were_tested(made, page):
    result, out = made
    _, *body = page.tables["findings"]
    rows = table(out, "findings")
    assert len(body) == len(rows) == len(result.findings)
    for shown, row, finding in zip(body, rows, result.findings, strict=True):
        assert shown[0] == row["source"] == finding.source
        assert shown[1] == row["statement"] == finding.statement
        assert shown[2] == row["verdict"] == finding.verdict
        assert shown[3] == finding.figures + finding.reason
        assert row["figures"] == finding.figures


def test_every_parameter_is_in_the_page(made, page, plan):
    for text, simulation in zip(page.pres, plan.simulations, strict=True):
        assert text == simulation.scenario
        parse_scenario(text)
    parameters = {row[0]: row[1:] for row in page.tables["parameters"]}
    assert parameters["n, degrees of freedom"] == ["11", "11"]
    assert parameters["segment pairs Nc"] == ["thirty in Fig. 3", "30"]
    assert parameters["λ [m]"] == ["0.1", "0.1"]
    assert parameters["a"][1] == f"{1 / 31:.4f}"


def test_the_page_opens_from_disk_without_a_network(made, tmp_path):
    browser = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
    if browser is None:
        pytest.skip("there is no Chromium to open the page in")
    _, out = made
    script = """<script>addEventListener("load", () => {
      const seen = document.createElement("pre");
      seen.id = "seen";
      seen.textContent = JSON.stringify({
        widths: [...document.images].map(image => image.naturalWidth),
        requests: performance.getEntriesByType("resource").map(e => e.name)
          .filter(name => !name.startsWith("data:")),
      });
      document.body.append(seen);
    });</script>"""
    copy = tmp_path / "copy.html"
    copy.write_text((out / "report.html").read_text(encoding="utf-8") + script)
    command = [
        *(browser, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic"),
        *("--disable-background-networking", "--disable-component-update"),
        *(f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", copy.as_uri()),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    found = re.search(r'<pre id="seen">(.*?)</pre>', done.stdout)
    assert found, done.stderr[-2000:]
    seen = json.loads(found[1])
    assert len(seen["widths"]) == 12 and min(seen["widths"]) > 100
    assert seen["requests"] == []


def test_the_same_command_again_changes_no_data_and_prints_the_findings(
    made, plan, monkeypatch, capsys
):
    _, out = made
    kept = {
        path: path.read_bytes()
        for folder in ("tables", "figures", "results")
        for path in (out / folder).iterdir()
    }
    monkeypatch.setattr(
        "benchmarks.section_iv.__main__.make_plan", lambda *_, **__: plan
    )
    assert main(["--out", str(out), "--jobs", "1"]) == 0
    printed = capsys.readouterr().out
    assert "holds" in printed and "does not hold" in printed
    assert printed.splitlines()[-1] == str(out / "report.html")
    for path, content in kept.items():
        assert path.read_bytes() == content, path.name
    assert "of which this run made 0" in (out / "report.html").read_text()


def test_mistakes_are_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    for command, message in (
        ("--motions danse", "did you mean 'dance'?"),
        ("--motions dance --out file", "file is a file; name another folder"),
        ("--duration 0", "'0' is not a positive number"),
        ("--jobs none", "'none' is not a positive whole number"),
    ):
        assert main(command.split()) == 2
        assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_simulation_that_cannot_be_run_is_named(plan, tmp_path):
    one = plan.simulations[0]
    broken = one.scenario.replace("motion: dance", "motion: gone.amc")
    bad = replace(plan, simulations=(replace(one, scenario=broken),))
    with ThreadPoolExecutor(1) as executor:
        with pytest.raises(CrarError, match="dance_wrists_raw: gone.amc: there is no"):
            reproduce(bad, tmp_path, executor=executor)
    assert not (tmp_path / "report.html").exists()
