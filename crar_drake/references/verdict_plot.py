"""A reference motion's verdict over time, on one page."""

from __future__ import annotations

import os

import numpy as np
from matplotlib.figure import Figure

from crar_drake.figures import save_figure
from crar_drake.references.reference_judge import ReferenceVerdict
from crar_drake.references.verdict_report import name_of


def plot_verdict(verdict: ReferenceVerdict, path: str | os.PathLike[str]) -> None:
    """Draws distances, limits, speeds and heights over time.

    Args:
        verdict: of the motion.
        path: the figure's file; its suffix (.png, .pdf, .svg) chooses the format.

    Raises:
        CrarError: there is no such format, or the file cannot be written.
    """
    motion = verdict.motion
    times = motion.times
    figure = Figure(figsize=(8.3, 11.7), layout="constrained")
    pairs, limits, speeds, ground = figure.subplots(4, 1, sharex=True)
    found = ", ".join(verdict.violations) or "clean"
    figure.suptitle(f"{name_of(verdict)}: {found}", fontsize="medium", wrap=True)
    pairs.plot(times, 1e3 * verdict.capsule_distances, label="capsules", linewidth=0.8)
    if verdict.meshes is not None:
        depths = -1e3 * verdict.mesh_depths()
        pairs.plot(
            times[verdict.meshes.frames],
            np.where(depths < 0.0, depths, np.nan),
            "r.",
            markersize=3.0,
            label="meshes, where they penetrate",
        )
    pairs.axhline(0.0, color="black", linewidth=0.6)
    pairs.set_ylabel("smallest distance [mm]")
    pairs.legend(fontsize="x-small")
    limits.plot(times, verdict.limit_excess, linewidth=0.8)
    limits.axhline(0.0, color="black", linewidth=0.6)
    limits.set_ylabel("beyond a joint limit [rad]")
    speeds.plot(times[1:], verdict.speed_ratio, linewidth=0.8)
    speeds.axhline(1.0, color="black", linewidth=0.6)
    speeds.set_ylabel("share of a speed limit")
    ground.plot(times, 1e3 * verdict.ground.lowest, color="black", linewidth=0.8)
    ground.axhline(0.0, color="black", linewidth=0.6)
    low, high = ground.get_ylim()
    for row, foot in enumerate(verdict.ground.feet):
        bottom = low - (0.06 * (row + 1)) * (high - low)
        ground.fill_between(
            times,
            bottom,
            bottom + 0.04 * (high - low),
            where=foot.planted,
            color=("tab:blue", "tab:orange")[row % 2],
            label=f"{foot.foot} planted",
        )
    ground.set_ylabel("lowest point [mm]")
    ground.set_xlabel("time [s]")
    if verdict.ground.feet:
        ground.legend(fontsize="x-small")
    for jump in verdict.jumps:
        for axes in (pairs, limits, speeds, ground):
            axes.axvline(
                jump.frame / motion.rate, color="tab:red", linewidth=0.6, alpha=0.6
            )
    pairs.margins(x=0.0)
    save_figure(figure, path)
