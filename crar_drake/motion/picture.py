"""A page that shows a motion: the body, its way, heights and speeds."""

import os
import textwrap
from collections.abc import Mapping

import numpy as np

from crar_drake.motion.performer import PARENTS, Performer
from crar_drake.motion.report import describe, inspect

_FACTS_WIDTH = 110  # letters


def plot_motion(performer: Performer, path: str | os.PathLike[str]) -> None:
    """Draws the body, and heights, paths and speeds of the joint centres, on one page.

    The body is seen from the front and from its left, in the frame in which it stands
    most upright; joints that are guesses are hollow. Frames with a flip or a jump are
    marked by vertical lines.

    The figure's suffix (.png, .pdf, .svg) chooses its format.

    Raises:
        MotionError: the motion has no joint centres.
        CrarError: there is no such format, or the file cannot be written.
    """
    centres = performer.centres()
    report = inspect(performer)
    # As long as all else of a motion takes to be imported.
    from matplotlib.figure import Figure

    from crar_drake.figures import save_figure

    figure = Figure(figsize=(8.3, 11.7), layout="constrained")
    grid = figure.add_gridspec(3, 3, height_ratios=[1.0, 1.4, 1.0])
    heights, speeds = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[2, :])
    paths, body = figure.add_subplot(grid[1, :2]), figure.add_subplot(grid[1, 2])
    facts = f"{performer.format}: {'; '.join(str(fact) for fact in performer.facts)}"
    figure.suptitle(
        "\n".join([next(describe(report)), *textwrap.wrap(facts, _FACTS_WIDTH)]),
        fontsize="small",
    )
    _draw_points(performer, centres, heights, paths, speeds)
    _draw_body(performer, body)
    flip_frames = sorted({flip.frame for flip in report.flips})
    jump_frames = sorted({jump.frame for jump in report.jumps})
    for axes in (heights, speeds):
        for frames, colour, label in (
            (flip_frames, "tab:red", "flip"),
            (jump_frames, "tab:orange", "jump"),
        ):
            for index, frame in enumerate(frames):
                axes.axvline(
                    (frame - 1) / performer.frame_rate,
                    color=colour,
                    linewidth=0.6,
                    alpha=0.6,
                    zorder=0,
                    label=label if index == 0 else None,
                )
        axes.set_xlabel("time [s]")
        axes.margins(x=0.0)
    heights.set_ylabel("height [m]")
    heights.legend(ncols=5, fontsize="x-small")
    speeds.set_ylabel("speed [m/s]")
    paths.set_xlabel("y, to the left [m]")
    paths.set_ylabel("x, forward [m]")
    paths.set_title("from above", fontsize="small")
    paths.set_aspect("equal", adjustable="datalim")
    paths.invert_xaxis()  # the left is on the left
    save_figure(figure, path)


def _draw_points(
    performer: Performer, centres: Mapping[str, np.ndarray], heights, paths, speeds
) -> None:
    colours = {"waist": "black", "neck": "tab:gray", "shoulder": "tab:purple"}
    colours |= {"elbow": "tab:green", "wrist": "tab:blue"}
    for name, p_WC in centres.items():
        style = {
            "color": colours[name.rpartition("_")[2]],
            "linestyle": "--" if name.startswith("right") else "-",
            "linewidth": 0.9,
            "label": name.replace("_", " "),
        }
        heights.plot(performer.time, p_WC[:, 2], **style)
        paths.plot(p_WC[:, 1], p_WC[:, 0], **style)
        speed = np.linalg.norm(np.diff(p_WC, axis=0), axis=1) * performer.frame_rate
        speeds.plot(performer.time[1:], speed, **style)


def _draw_body(performer: Performer, axes) -> None:
    """From the front and from the left, turned by the heading."""
    trunk = performer.positions["neck"] - performer.positions["pelvis"]
    length = np.linalg.norm(trunk, axis=1)
    frame = int(np.argmax(trunk[:, 2] / np.where(length > 0.0, length, 1.0)))
    c, s = np.cos(performer.heading[frame]), np.sin(performer.heading[frame])
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    origin = performer.positions["pelvis"][frame] * [1.0, 1.0, 0.0]
    p = {joint: R @ (q[frame] - origin) for joint, q in performer.positions.items()}
    width = max(np.ptp([q[1] for q in p.values()]), 0.5)
    # The front with his left at the right; beside it the left side, facing left.
    for column, shift in ((1, 0.0), (0, width)):
        sign = 1.0 if column == 1 else -1.0
        for joint, q in p.items():
            colour = {"left": "tab:blue", "right": "tab:red"}.get(
                joint.partition("_")[0], "black"
            )
            x = shift + sign * q[column]
            parent = PARENTS[joint]
            if parent in p:
                start = shift + sign * p[parent][column]
                axes.plot([start, x], [p[parent][2], q[2]], color=colour, linewidth=1.2)
            fill = "white" if joint in performer.guessed else colour
            axes.plot(x, q[2], "o", color=colour, markersize=3, markerfacecolor=fill)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(
        f"frame {frame + 1}, from the front\nand from its left (left is blue)",
        fontsize="small",
    )
    axes.set_xticks([])
    axes.tick_params(labelsize="x-small")
