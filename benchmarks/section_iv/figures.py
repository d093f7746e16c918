"""The figures of Section IV, from outcomes and logs."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.section_iv.plan import (
    EXPERIMENT_1,
    EXPERIMENT_2,
    LABELS,
    REDUNDANCY,
    SERIES,
    VARIANTS,
)
from benchmarks.section_iv.simulate import Outcomes
from benchmarks.sweep.cases import clip_label
from crar_drake.law.parameters import LEVELS
from crar_drake.results.controlled_joints import controlled_joints
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import load_logged_robot
from crar_drake.robot.collision_pairs import shape_axis
from crar_drake.robot.description import LIMIT_TOLERANCE, find_body
from crar_drake.robot.model import ControlModel

COLOURS = {
    "velocity": "tab:orange",
    "acceleration": "tab:green",
    "lookahead": "tab:blue",
    "inertia": "tab:purple",
    "less-damping": "tab:pink",
}
# Fields of results, what they are, and a factor to their units.
ERROR = ("rms_task_error", "rms task error [mm]", 1e3)
POWER = ("mean_power", "average absolute power [W]", 1.0)
_HANDS = "left_hand - right_hand"
_SNAPSHOTS = 8
_POINTS = 600  # of a curve in a figure


@dataclass(frozen=True)
class Snapshot:
    """One moment of Fig. 3.

    Attributes:
        sample: of the log.
        tinted: links that penetrate others at that moment of the raw motion.
    """

    sample: int
    tinted: tuple[str, ...]


def violation_counts(log: SimulationLog) -> np.ndarray:
    """(T,) joints beyond a limit plus penetrating pairs, per sample."""
    beyond = controlled_joints(log).excess > LIMIT_TOLERANCE
    return beyond.sum(axis=1) + (log.signed_distances < 0.0).sum(axis=1)


def frame_samples(log: SimulationLog, frame_rate: float) -> np.ndarray:
    """Indices of the samples nearest to the frames of the motion."""
    frames = np.arange(0.0, log.time[-1] + 1e-9, 1.0 / frame_rate)
    step = (log.time[-1] - log.time[0]) / (len(log.time) - 1)
    return np.minimum(np.round(frames / step).astype(int), len(log.time) - 1)


def draw_violations(log: SimulationLog, frame_rate: float) -> Figure:
    """Fig. 2: constraint violations per frame of the raw dance, Experiment 1.

    Beside it the share of the frames by their number of violations.
    """
    counts = violation_counts(log)[frame_samples(log, frame_rate)]
    figure = Figure(figsize=(8.6, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3.2, 1.0), sharey=True)
    left.stairs(counts, fill=True, color="tab:blue")  # a bar for each frame
    left.set_xlim(0, len(counts))
    left.set_xlabel(f"frame number ({frame_rate:g} frames a second)")
    left.set_ylabel("constraint violations")
    left.annotate(
        "redundancy: fewer than five",
        (0.01, REDUNDANCY),
        xycoords=("axes fraction", "data"),
        xytext=(0, 3),
        textcoords="offset points",
        color="tab:red",
        fontsize="small",
    )
    numbers = np.arange(max(counts.max(), REDUNDANCY) + 2)
    share = [100.0 * (counts == number).mean() for number in numbers]
    right.barh(numbers, share, color="tab:blue", height=0.8)
    right.set_xlabel("share of frames [%]")
    for ax in (left, right):
        ax.axhline(REDUNDANCY, color="tab:red", linewidth=1.0, linestyle="--")
        _clean(ax)
    left.set_ylim(0.0, numbers[-1])
    return figure


def choose_snapshots(raw: SimulationLog, number: int = _SNAPSHOTS) -> list[Snapshot]:
    """Moments for Fig. 3: one from each of `number` equal stretches of time.

    It is where most pairs of the raw motion penetrate, or else the middle.
    """
    penetrating = raw.signed_distances < 0.0
    chosen = []
    for stretch in np.array_split(np.arange(len(raw.time)), number):
        counts = penetrating[stretch].sum(axis=1)
        middle = len(stretch) // 2
        at = stretch[int(np.argmax(counts)) if counts.any() else middle]
        names = raw.pair_names[penetrating[at]].tolist()
        links = sorted({link for name in names for link in name.split(" - ")})
        chosen.append(Snapshot(int(at), tuple(links)))
    return chosen


def draw_distances(
    log: SimulationLog, raw: SimulationLog, title: str, frame_rate: float
) -> Figure:
    """Fig. 3: the distances of all pairs over the dance, under pictures of the robot.

    Args:
        log: of a run in Experiment 2.
        raw: of the raw motion in Experiment 2, whose penetrating segments are
            yellow in the pictures.
        title: what the run is.
        frame_rate: of the motion [1/s].
    """
    figure = Figure(figsize=(8.6, 5.2), layout="constrained")
    above, ax = figure.subplots(2, 1, height_ratios=(1.0, 2.4), sharex=True)
    frames = log.time * frame_rate
    model = ControlModel.FromDescription(load_logged_robot(log), [])
    snapshots = choose_snapshots(raw)
    width = frames[-1] / len(snapshots)
    for i, snapshot in enumerate(snapshots):
        place = above.inset_axes((i / len(snapshots), 0.1, 1 / len(snapshots), 0.9))
        draw_posture(place, model, log.q[snapshot.sample], snapshot.tinted)
        frame = frames[snapshot.sample]
        ax.axvline(frame, color="0.8", linewidth=0.7)
        above.text((i + 0.5) * width, 0.0, f"{frame:.0f}", ha="center", va="bottom")
    above.set_xlim(0.0, frames[-1])
    above.set_ylim(0.0, 1.0)
    above.set_axis_off()

    shown = _spread(len(log.time))
    for i, name in enumerate(log.pair_names.tolist()):
        hands = name == _HANDS
        ax.plot(
            frames[shown],
            log.signed_distances[shown, i],
            color="tab:red" if hands else None,
            linewidth=2.0 if hands else 0.7,
            label="left hand and right hand" if hands else None,
            zorder=3 if hands else 2,
        )
    low = log.signed_distances.min()
    if low < 0.0:
        ax.axhspan(1.2 * low, 0.0, color="tab:red", alpha=0.12, linewidth=0.0)
    ax.axhline(0.0, color="black", linewidth=0.8)
    ax.set_ylim(min(1.2 * low, 0.0), 1.05 * log.signed_distances.max())
    ax.set_xlabel(f"frame number ({frame_rate:g} frames a second)")
    ax.set_ylabel("distance [m]")
    ax.set_title(
        f"{title}: smallest distance {1e3 * low:.1f} mm", loc="left", fontsize="medium"
    )
    if _HANDS in log.pair_names.tolist():
        ax.legend(loc="upper right", fontsize="small", frameon=False)
    _clean(ax)
    return figure


def draw_posture(
    ax: Axes, model: ControlModel, q: np.ndarray, tinted: Collection[str] = ()
) -> None:
    """A robot from the front: the capsules and spheres of its watched links.

    Args:
        ax: to draw into.
        model: of the robot.
        q: (nq,) its positions.
        tinted: links that are yellow.
    """
    plant, inspector = model.plant, model.scene_graph.model_inspector()
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    shapes = []
    for name in {link for pair in model.description.pairs for link in pair}:
        body = find_body(plant, name)
        X_WB = body.EvalPoseInWorld(context)
        for geometry in plant.GetCollisionGeometriesForBody(body):
            X_WG = X_WB.multiply(inspector.GetPoseInFrame(geometry)).GetAsMatrix34()
            axis = shape_axis(inspector.GetShape(geometry), X_WG)
            shapes.append((axis.p_B0, axis.p_B1, axis.radius, name in tinted))
    # What is nearer to the eye, at +x, comes last; its left is on the right.
    half_turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 16)
    for start, end, radius, is_tinted in sorted(
        shapes, key=lambda s: s[0][0] + s[1][0]
    ):
        (y, z), (dy, dz) = start[1:], (end - start)[1:]
        turns = np.arctan2(dz, dy) + half_turn
        turns = np.concatenate([turns, turns + np.pi])
        along = np.repeat([1.0, 0.0], len(half_turn))
        ax.fill(
            y + along * dy + radius * np.cos(turns),
            z + along * dz + radius * np.sin(turns),
            "gold" if is_tinted else "0.8",
            edgecolor="0.3",
            linewidth=0.5,
        )
    ax.set_aspect("equal", "datalim")
    ax.set_axis_off()


def draw_bars(
    data: Outcomes,
    experiment: str,
    quantity: tuple[str, str, float],
    series: Sequence[str] = tuple(SERIES),
) -> Figure:
    """Figs. 4 to 7: a group per motion, a bar per series.

    Args:
        data: every simulation succeeded.
        experiment: EXPERIMENT_1 or EXPERIMENT_2.
        quantity: ERROR or POWER.
        series: keys of LABELS.
    """
    field, label, factor = quantity
    motions = data.plan.motions
    figure = Figure(figsize=(8.6, 3.2), layout="constrained")
    ax = figure.subplots()
    width = 0.8 / len(series)
    for i, name in enumerate(series):
        results = [data.of(motion, experiment, name).result for motion in motions]
        x = np.arange(len(motions)) + (i - 0.5 * (len(series) - 1)) * width
        drawn = ax.bar(
            x,
            [factor * getattr(result, field) for result in results],
            0.9 * width,
            color=COLOURS[name],
            label=LABELS[name],
        )
        ax.bar_label(drawn, fmt="%.0f", fontsize="x-small", padding=1)
    ax.set_xticks(np.arange(len(motions)), map(clip_label, motions))
    ax.set_ylabel(label)
    ax.legend(fontsize="small", frameon=False, ncols=len(series))
    ax.margins(y=0.15)
    _clean(ax)
    return figure


def draw_torque_spikes(velocity: SimulationLog, acceleration: SimulationLog) -> Figure:
    """Why the velocity level takes more power: torque and W about its largest spike.

    From the top: the largest torque of any joint over the whole dance, both levels;
    the same for a fifth of a second about the largest spike; the elements of W of
    the velocity level then.
    """
    logs = {"velocity": velocity, "acceleration": acceleration}
    torque = {
        name: np.abs(controlled_joints(log).torque).max(axis=1)
        for name, log in logs.items()
    }
    figure = Figure(figsize=(8.6, 6.0), layout="constrained")
    whole, near, weights = figure.subplots(3, 1)
    for name, log in logs.items():
        style = {"color": COLOURS[name], "linewidth": 0.7, "label": LABELS[name]}
        whole.plot(log.time, torque[name], **style)
        near.plot(log.time, torque[name], **style | {"linewidth": 1.2})
    at = velocity.time[int(np.argmax(torque["velocity"]))]
    window = (max(at - 0.1, 0.0), min(at + 0.1, velocity.time[-1]))
    inside = (velocity.time >= window[0]) & (velocity.time <= window[1])
    weights.plot(velocity.time[inside], velocity.constraint_weights[inside], lw=1.0)
    for ax in (near, weights):
        ax.set_xlim(window)
    for ax in (whole, near):
        ax.set_yscale("log")
        ax.set_ylim(bottom=1.0)
        ax.set_ylabel("largest torque [Nm]")
    weights.set_yscale("log")
    weights.set_ylabel("diagonal of W,\nvelocity level")
    weights.set_xlabel("time [s]")
    whole.axvspan(*window, color="0.85")
    whole.legend(fontsize="small", frameon=False, ncols=2)
    for ax in (whole, near, weights):
        _clean(ax)
    return figure


def draw_damping(data: Outcomes) -> Figure:
    """The sweep over lambda: task error and power, both levels, with and without W."""
    figure = Figure(figsize=(8.6, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    factors = data.plan.damping_factors
    for level in LEVELS:
        for constraints, style in (("paper", "o-"), ("none", "o:")):
            points = [data.damped(level, constraints, value) for value in factors]
            label = LABELS[level] + ("" if constraints == "paper" else ", W = I")
            for ax, values in (
                (left, [1e3 * p.rms_task_error for p in points]),
                (right, [p.mean_power for p in points]),
            ):
                ax.plot(
                    factors,
                    values,
                    style,
                    color=COLOURS[level],
                    markersize=4,
                    label=label,
                )
    for ax, label in ((left, "rms task error [mm]"), (right, "mean power [W]")):
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xticks(factors, [f"{v:g}" for v in factors])
        ax.minorticks_off()
        ax.set_xlabel("λ [m]")
        ax.set_ylabel(label)
        _clean(ax)
    left.legend(fontsize="small", frameon=False)
    return figure


def all_figures(
    data: Outcomes, log: Callable[[str, str], SimulationLog], frame_rate: float
) -> dict[str, Callable[[], Figure]]:
    """Every figure by the name of its file, drawn when called.

    Args:
        data: of the reproduction.
        log: loads the dance's log of an experiment and a series.
        frame_rate: of the dance [1/s].
    """
    both = ("acceleration", *VARIANTS)
    return {
        "figure-2": lambda: draw_violations(log(EXPERIMENT_1, "raw"), frame_rate),
        **{
            f"figure-3-{name}": lambda name=name: draw_distances(
                *(log(EXPERIMENT_2, name), log(EXPERIMENT_2, "raw")),
                *(LABELS[name], frame_rate),
            )
            for name in SERIES
        },
        "figure-4": lambda: draw_bars(data, EXPERIMENT_1, ERROR),
        "figure-5": lambda: draw_bars(data, EXPERIMENT_1, POWER),
        "figure-6": lambda: draw_bars(data, EXPERIMENT_2, ERROR),
        "figure-7": lambda: draw_bars(data, EXPERIMENT_2, POWER),
        "variants-error": lambda: draw_bars(data, EXPERIMENT_1, ERROR, both),
        "variants-power": lambda: draw_bars(data, EXPERIMENT_1, POWER, both),
        "torque-spikes": lambda: draw_torque_spikes(
            log(EXPERIMENT_1, "velocity"), log(EXPERIMENT_1, "acceleration")
        ),
        "damping": lambda: draw_damping(data),
    }


def _spread(samples: int) -> np.ndarray:
    """Indices of at most _POINTS samples."""
    return np.unique(np.linspace(0, samples - 1, min(samples, _POINTS)).astype(int))


def _clean(ax: Axes) -> None:
    ax.spines[["top", "right"]].set_visible(False)
