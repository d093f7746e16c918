"""A run's figures as a table for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rich.markup import escape
from rich.table import Table

from crar_drake.motion.report import rate_text

if TYPE_CHECKING:
    from crar_drake.results.summary import Summary


def summary_table(summary: Summary, verbose: bool = False) -> Table:
    """A run's figures as a table for the terminal.

    Args:
        verbose: all of them, else those that say whether the robot was safe and did
            what it was to do.
    """
    table = Table(title=summary.title, title_justify="left", show_header=False)
    table.add_column("quantity", no_wrap=True)
    table.add_column("value", justify="right", no_wrap=True)
    table.add_column("where", overflow="fold")

    def row(quantity: str, value: str, where: str = "", bad: bool = False) -> None:
        table.add_row(quantity, value, where, style="bold red" if bad else "")

    assumed = summary.frame_rate_source == "assumed"
    if summary.frame_rate is not None and (verbose or assumed):
        rate = rate_text(summary.frame_rate, summary.frame_rate_source)
        row("frame rate", rate, "of the motion" + ("; --frame-rate" if assumed else ""))
    if summary.rms_task_error is not None:
        worst = _worst(summary, "rms_error")
        error = f"{1e3 * summary.tasks[worst].rms_error:.1f} mm"
        row(
            "rms task error",
            f"{1e3 * summary.rms_task_error:.1f} mm",
            f"worst {worst}, {error}",
        )
    if summary.rms_orientation_error is not None:
        worst = _worst(summary, "rms_orientation_error")
        angle = f"{summary.tasks[worst].rms_orientation_error:.3f} rad"
        row(
            "rms orientation error",
            f"{summary.rms_orientation_error:.3f} rad",
            f"worst {worst}, {angle}",
        )
    if summary.limb_directions:
        row("limb directions", *_limbs(summary))
    if summary.smallest_distance is not None:
        row(
            "smallest distance",
            f"{1e3 * summary.smallest_distance:.1f} mm",
            f"{summary.smallest_distance_pair}, at "
            f"{summary.smallest_distance_time:.2f} s",
            summary.smallest_distance < 0.0,
        )
    violated = summary.violated_samples
    row("violations", f"{violated}", f"of {summary.samples} samples", violated > 0)
    if summary.penetrating_samples:
        count = f"{summary.penetrating_samples}"
        row("  penetrating", count, _most(summary.penetrating_pairs))
    if summary.beyond_limit_samples:
        farthest = summary.largest_excess_joint
        row(
            "  beyond limits",
            f"{summary.beyond_limit_samples}",
            f"{_most(summary.joints_beyond_limits)}; farthest {farthest}, "
            f"{summary.largest_excess:.3g} {summary.unit_of(farthest)}",
        )
    if summary.beyond_speed_samples:
        # Apart from the violations, as in `Summary`.
        fastest = summary.largest_speed_excess_joint
        row(
            "beyond speed limits",
            f"{summary.beyond_speed_samples}",
            f"{_most(summary.joints_beyond_speed)}; most {fastest}, by "
            f"{summary.largest_speed_excess:.3g} {summary.unit_of(fastest)}/s",
            True,
        )
    for name, figures in summary.obstacles.items():
        nearest = f"{1e3 * figures.smallest_distance:.1f} mm"
        bad = figures.fast_contacts > 0
        row(f"obstacle {escape(name)}", nearest, figures.in_words(), bad)
    if summary.admitted_steps:
        clearance = summary.path_clearance
        nearest = "no pair" if clearance is None else f"{1e3 * clearance:.1f} mm"
        path = _path(summary) + (_admitted(summary) if verbose else "")
        row("braking path", nearest, path, summary.unclear_steps > 0)
    if summary.balanced_steps:
        share = summary.changed_for_balance / summary.balanced_steps
        row(
            "balance",
            f"{1e3 * summary.smallest_balance:.1f} mm",
            "left on braking paths, of the weight's arm, at least; "
            f"{100 * share:.0f} % of the steps changed",
        )
    if verbose:
        row("mean power", f"{summary.mean_power:.1f} W")
    row(
        "peak torque",
        f"{summary.peak_torque:.1f} {summary.peak_torque_unit}",
        f"{summary.peak_torque_joint}, at {summary.peak_torque_time:.2f} s",
    )
    if verbose and summary.torque_limited_samples:
        share = summary.torque_limited_samples / summary.samples
        row(
            "torque limit active",
            f"{100 * share:.1f} %",
            f"of {summary.samples} samples lose over a tenth of the step; clipped in "
            f"{summary.torque_clipped_samples}",
        )
    if verbose:
        count = len(summary.sliding_joints)
        slides = f"{count} that slide, in m/s², among them" if count else ""
        row("rms acceleration", f"{summary.rms_acceleration:.1f} rad/s²", slides)
    if summary.stopped:
        row("stopped", f"{summary.duration:.2f} s", escape(summary.stopped), True)
    if verbose and summary.real_time_factor is not None:
        factor = f"{summary.real_time_factor:.2f} x real time"
        row(
            "wall time",
            f"{summary.wall_time:.1f} s",
            f"for {summary.duration:.2f} s, {factor}",
        )
    return table


def _path(summary: Summary) -> str:
    """Whether braking paths were clear."""
    unclear = summary.unclear_steps
    if unclear:
        return f"not clear at {unclear} step{'s' if unclear > 1 else ''}"
    return "at least, clear at every step"


def _admitted(summary: Summary) -> str:
    """How steps were admitted, in words."""

    def share(count: int) -> str:
        percent = 100.0 * count / summary.admitted_steps
        # Few are not none.
        text = "< 0.1 %" if percent < 0.05 else f"{percent:.1f} %"
        return text if count else "none"

    corrected, scaled = summary.corrected_steps, summary.scaled_steps
    if not corrected + scaled:
        return "; all steps nominal"
    of_steps = " of the steps" if corrected else ""
    return (
        f"; {share(corrected)}{of_steps} corrected, {share(scaled)} scaled, for up to "
        f"{summary.longest_held_back:.3g} s in a row"
    )


def _limbs(summary: Summary) -> tuple[str, str]:
    """The largest median angle, and whose, with its 95 %."""
    angles = summary.limb_directions
    worst = max(angles, key=lambda name: angles[name].median)
    median, most = np.degrees([angles[worst].median, angles[worst].most])
    return (
        f"{median:.0f}°",
        f"off the person's in the median, worst {worst.replace('_', ' ')}; 95 % of "
        f"the time below {most:.0f}°",
    )


def _worst(summary: Summary, which: str) -> str:
    errors = {name: getattr(task, which) for name, task in summary.tasks.items()}
    return max((name for name in errors if errors[name] is not None), key=errors.get)


def _most(counts: dict[str, int]) -> str:
    """The name with most samples, and how many more there are."""
    name = max(counts, key=counts.get)
    others = len(counts) - 1
    return name + (f" and {others} more" if others else "")
