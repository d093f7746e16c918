"""The report: one HTML file with figures, findings, tables and parameters.

Figures are in the page itself; playback pages and CSV files are linked beside it.
"""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from benchmarks.page import describe_machine
from benchmarks.section_iv.csv_tables import TABLES
from benchmarks.section_iv.findings import Finding
from benchmarks.section_iv.plan import (
    EXPERIMENT_1,
    EXPERIMENT_2,
    LABELS,
    SERIES,
    VARIANTS,
    Plan,
)
from benchmarks.section_iv.simulate import Outcome, page_path
from benchmarks.sweep.figures import clip_label
from crar_drake.control.parameters import CrarParameters
from crar_drake.equations.composite_weight import composite_index
from crar_drake.files import write_whole
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import EXPERIMENTS, position_tasks
from crar_drake.simulation.scenario import Scenario
from crar_drake.version import __version__

REPORT = "report.html"
FIGURES = "figures"

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1d2329; margin: 0 auto;
       max-width: 76rem; padding: 1.5rem; }
h1 { margin-bottom: 0; } h2 { margin-top: 2.5rem; }
figure { margin: 1.5rem 0; display: grid; gap: 1rem 2rem;
         grid-template-columns: minmax(0, 5fr) minmax(0, 2fr); align-items: start; }
figure img { width: 100%; }
figcaption p { margin-top: 0; }
table { border-collapse: collapse; font-size: 0.86rem; margin: 1rem 0; }
th, td { border-bottom: 1px solid #d5dadf; padding: 0.3rem 0.6rem; text-align: left;
         vertical-align: top; }
td.number { text-align: right; white-space: nowrap; }
.holds { color: #11692f; font-weight: 600; white-space: nowrap; }
.not { color: #a8230f; font-weight: 600; white-space: nowrap; }
pre { font-size: 0.8rem; background: #f3f5f7; padding: 0.8rem; overflow: auto; }
@media (max-width: 50rem) { figure { grid-template-columns: 1fr; } }
"""

# Per figure: number and title, what the paper says of it, what is shown here.
_CAPTIONS = {
    "figure-2": (
        "Fig. 2. Constraint violations of the raw dance",
        "The number exceeds five in periods of the latter half: there Experiment 1 "
        "has no redundancy.",
        "Joints beyond a limit plus penetrating pairs, per frame, without constraints "
        "(W = I), two wrists, acceleration level; right, the share of the frames.",
    ),
    "figure-3-velocity": (
        "Fig. 3. Distances of the pairs over the dance, velocity level",
        "Three peaks, arms away from the body, and three valleys with self-collisions "
        "of the raw motion; all minimum distances stay positive.",
        "Experiment 2. Pictures: the simulated robot at the grey lines, frame numbers "
        "below; yellow segments penetrate in the raw motion then.",
    ),
    "figure-3-acceleration": (
        "Fig. 3. The same, acceleration level",
        "(The paper shows one plot, and does not say of which level.)",
        "Below the red line segments penetrate.",
    ),
    "figure-3-lookahead": ("Fig. 3. The same, lookahead", "", "Not in the paper."),
    "figure-4": (
        "Fig. 4. Task error, Experiment 1",
        "No significant difference between the levels.",
        "Root of the mean over time and tasks of the squared distance from the target.",
    ),
    "figure-5": (
        "Fig. 5. Average absolute power, Experiment 1",
        "Less at the acceleration level: no spikes from a numerical derivative, and "
        "more damping by W.",
        "Mean over time of the sum over the controlled joints of |torque × velocity|, "
        "gravity included.",
    ),
    "figure-6": (
        "Fig. 6. Task error, Experiment 2",
        "Larger than in Experiment 1; no significant difference between the levels.",
        "Seven points.",
    ),
    "figure-7": (
        "Fig. 7. Average absolute power, Experiment 2",
        "Much less than in Experiment 1; slightly less at the acceleration level.",
        "",
    ),
    "torque-spikes": (
        "Why the velocity level takes more power",
        "The numerical derivative of the constrained joint rates may introduce torque "
        "spikes.",
        "The largest torque of any joint over the dance in Experiment 1; the same "
        "about the largest spike; the elements of W at the velocity level then. The "
        "joint rates of Eq. 15 jump where W does.",
    ),
    "damping": (
        "Damping factor, dance, Experiment 1",
        "Lower damping factors can generally be tolerated at the acceleration level, "
        "which improves its task error.",
        "Solid: the paper's W; dotted: W = I, without constraints.",
    ),
    "variants-error": (
        "The paper's own improvements: task error, Experiment 1",
        "A dynamically consistent weight and a smaller λ are proposed.",
        "Each changes one thing of the acceleration level (green).",
    ),
    "variants-power": (
        "The paper's own improvements: power, Experiment 1",
        "The dynamically consistent weight is proposed to improve the energetics.",
        "",
    ),
}


@dataclass(frozen=True)
class Reproduction:
    """Everything that the report tells.

    Attributes:
        plan, outcomes, findings: see there.
        figures: files below the report's folder, by name, in reading order.
        tables: names of the CSV files.
        wall_time: that this call took for how many simulations [s].
        simulated: number of simulations that it ran; the others were there.
    """

    plan: Plan
    outcomes: Mapping[str, Outcome]
    findings: Sequence[Finding]
    figures: Mapping[str, Path]
    tables: Sequence[str]
    wall_time: float
    simulated: int


def report_path(out: Path) -> Path:
    """Where the report of a reproduction is."""
    return out / REPORT


def write_report(reproduction: Reproduction, out: Path) -> Path:
    """Writes `out`/report.html; it opens from disk, without a network."""
    path = report_path(out)
    write_whole(path, _page(reproduction, out))
    return path


def _page(r: Reproduction, out: Path) -> str:
    motions = ", ".join(clip_label(motion) for motion in r.plan.motions)
    held = sum(finding.holds for finding in r.findings)
    length = "whole" if r.plan.duration is None else f"{r.plan.duration:g} s of each"
    parts = [
        "<h1>Constrained Resolved Acceleration Control: Section IV reproduced</h1>",
        f"<p>crar-drake {__version__} on {escape(motions)} ({length}; the "
        f"first is the dance). {len(r.outcomes)} simulations, of which this run made "
        f"{r.simulated} in {r.wall_time:.0f} s. {escape(_machine())}.</p>",
        f"<p>{held} of {len(r.findings)} findings hold. Where one does not, its row "
        "says what the data show.</p>",
        "<h2>The paper's findings</h2>",
        _findings_table(r.findings),
        "<h2>The paper's figures</h2>",
    ]
    for name, path in r.figures.items():
        if name == "torque-spikes":
            parts.append("<h2>What the paper does not show</h2>")
        parts.append(_figure(name, path))
    for experiment, series, title in (
        (EXPERIMENT_1, (*SERIES, *VARIANTS), "Experiment 1, two wrists, m = 6"),
        (EXPERIMENT_2, tuple(SERIES), "Experiment 2, seven points, m = 21"),
    ):
        parts += [f"<h2>{title}</h2>", _results_table(r, experiment, series, out)]
    raw = [
        _playback(o, out) for o in r.outcomes.values() if o.simulation.series == "raw"
    ]
    parts.append(f"<p>The raw dance: {' and '.join(raw)}.</p>")
    links = ", ".join(f'<a href="{TABLES}/{n}.csv">{n}.csv</a>' for n in r.tables)
    parts.append(f"<p>All numbers, in SI units: {links}.</p>")
    parts += ["<h2>Parameters</h2>", _parameter_table(), _scenarios(r.outcomes)]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Section IV reproduced: {escape(motions)}</title>"
        f"<style>{_STYLE}</style></head><body>\n"
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def _findings_table(findings: Sequence[Finding]) -> str:
    rows = [
        "<tr>"
        f"<td>{escape(f.source)}</td><td>{escape(f.statement)}</td>"
        f'<td class="{"holds" if f.holds else "not"}">{f.verdict}</td>'
        f"<td>{escape(f.figures)}"
        + (f"<br><em>{escape(f.reason)}</em>" if f.reason else "")
        + f"</td><td>{escape(f.criterion)}</td></tr>"
        for f in findings
    ]
    header = ("paper", "finding", "here", "figures", "criterion")
    return _table(header, rows, "findings")


def _figure(name: str, path: Path) -> str:
    title, paper, here = _CAPTIONS[name]
    data = base64.b64encode(path.read_bytes()).decode()
    kind = {".png": "image/png", ".svg": "image/svg+xml"}[path.suffix]
    caption = f"<p><strong>{escape(title)}</strong></p>"
    if paper:
        caption += f"<p>Paper: {escape(paper)}</p>"
    if here:
        caption += f"<p>Here: {escape(here)}</p>"
    return (
        f'<figure id="{name}"><img alt="{escape(title)}" '
        f'src="data:{kind};base64,{data}"><figcaption>{caption}</figcaption></figure>'
    )


def _results_table(
    r: Reproduction, experiment: str, series: Sequence[str], out: Path
) -> str:
    header = (
        *("motion", "controller", "rms task error [mm]", "mean power [W]"),
        *("smallest distance [mm]", "samples in violation [%]", "peak torque [Nm]"),
        *("rms acceleration [rad/s²]", ""),
    )
    rows = []
    for motion in r.plan.motions:
        for outcome in r.outcomes.values():
            s, result = outcome.simulation, outcome.result
            if (s.motion, s.experiment) != (
                motion,
                experiment,
            ) or s.series not in series:
                continue
            violated = outcome.details.violated_share if outcome.details else np.nan
            cells = (
                f"{1e3 * result.rms_task_error:.1f}",
                f"{result.mean_power:.1f}",
                f"{1e3 * result.smallest_distance:.1f}",
                f"{100 * violated:.1f}",
                f"{result.peak_torque:.0f}",
                f"{result.rms_acceleration:.1f}",
            )
            rows.append(
                f"<tr><td>{escape(clip_label(motion))}</td><td>{LABELS[s.series]}</td>"
                + "".join(f'<td class="number">{cell}</td>' for cell in cells)
                + f"<td>{_playback(outcome, out, 'play')}</td></tr>"
            )
    return _table(header, rows, f"results-{experiment}")


def _playback(outcome: Outcome, out: Path, text: str = "") -> str:
    path = page_path(outcome.simulation, out).relative_to(out).as_posix()
    label = text or f"{outcome.simulation.experiment}"
    return f'<a href="{escape(path)}">{escape(label)}</a>'


def _parameter_table() -> str:
    """What Section IV prints, and what was simulated."""
    gains, scenario = CrarParameters(constraints="paper"), Scenario()
    description = load_robot_description(scenario.robot)
    model = ControlModel.FromDescription(
        description, position_tasks(EXPERIMENTS[EXPERIMENT_1])
    )
    pairs = len(model.pairs)
    rows = [
        ("n, degrees of freedom", "11", f"{model.n}"),
        ("segment pairs Nc", "thirty in Fig. 3", f"{pairs}"),
        ("K [1/s]", "30", f"{gains.K:g}"),
        ("Kp [1/s²]", "300", f"{gains.Kp:g}"),
        ("Kv [1/s]", "2 √Kp", f"{gains.velocity_gain:.2f}"),
        ("Gv, GvN [1/s]", "30", f"{gains.Gv:g}, {gains.null_space_gain:g}"),
        (
            "ρ, β, α [1/m]",
            "1, 2, 50",
            f"{gains.rho:g}, {gains.beta:g}, {gains.alpha:g}",
        ),
        ("λ [m]", "0.1", f"{gains.damping:g}"),
        ("a", "1/(Nc + 1)", f"{composite_index(pairs):.4f}"),
        ("control period [s]", "not stated", f"{gains.period:g}"),
        ("plant's time step [s]", "not stated", f"{scenario.plant_config.time_step:g}"),
        ("low-pass of the motion [Hz]", "not stated", f"{scenario.cutoff:g}"),
        ("targets are blended in over [s]", "not stated", f"{gains.blend_time:g}"),
        ("robot", "a Honda humanoid", escape(scenario.robot)),
    ]
    body = [
        f"<tr><td>{name}</td><td>{paper}</td><td>{here}</td></tr>"
        for name, paper, here in rows
    ]
    return _table(("parameter", "paper", "here"), body, "parameters")


def _scenarios(outcomes: Mapping[str, Outcome]) -> str:
    """Every parameter of every simulation."""
    return "\n".join(
        f"<details><summary>{escape(name)}</summary>"
        f"<pre>{escape(outcome.simulation.scenario)}</pre></details>"
        for name, outcome in outcomes.items()
    )


def _table(header: Sequence[str], rows: Sequence[str], name: str) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "\n".join(rows)
    return (
        f'<table id="{name}"><thead><tr>{head}</tr></thead>\n'
        f"<tbody>{body}</tbody></table>"
    )


def _machine() -> str:
    """Processor, cores and versions."""
    m = describe_machine()
    return (
        f"Machine: {m['cpu']}, {m['cores']} cores; Python {m['python']}, Drake "
        f"{m['drake']}, NumPy {m['numpy']}"
    )
