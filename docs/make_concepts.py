"""Draws the pictures of `concepts.md`.

    python docs/make_concepts.py

`images/braking-path.svg` is computed: an arm of two links in a plane beside a post,
with the distance of their capsules in closed form, and a step that is scaled as the
admission does. `images/sample-to-torque.svg` is the way of one sample of a motion.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

IMAGES = Path(__file__).resolve().parent / "images"
LENGTHS = 0.30, 0.26  # of the links' axes [m]
RADIUS = 0.035  # of their capsules [m]
POST, POST_RADIUS = np.array([0.28, 0.33]), 0.06  # [m]
FLOOR = 0.02  # the distance that is kept; drawn larger than the program's 4 mm [m]
# Configuration, velocity and the nominal velocity of q_s.
Q, QDOT = np.array([0.12, 0.35]), np.array([2.4, 1.2])  # [rad], [rad/s]
NOMINAL = np.array([11.0, -3.0])  # [rad/s]
HORIZON, PERIOD = 0.12, 0.03  # [s]
BLUE, RED, GREY = "#1f5fa8", "#b3261e", "#7a7a7a"


def joints(q: np.ndarray) -> np.ndarray:
    """(..., 3, 2) shoulder, elbow and tip at configurations q (..., 2)."""
    angles = np.cumsum(q, axis=-1)
    steps = np.stack([np.cos(angles), np.sin(angles)], -1) * np.c_[LENGTHS]
    tips = np.cumsum(steps, axis=-2)
    return np.concatenate([np.zeros_like(tips[..., :1, :]), tips], axis=-2)


def nearest(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of arm and post (...), and the nearest point of an axis (..., 2)."""
    points = joints(q)
    start, along = points[..., :-1, :], np.diff(points, axis=-2)
    share = ((POST - start) * along).sum(-1) / (along**2).sum(-1)
    on_axis = start + np.clip(share, 0.0, 1.0)[..., None] * along
    gaps = np.linalg.norm(on_axis - POST, axis=-1)
    link = gaps.argmin(-1)
    point = np.take_along_axis(on_axis, link[..., None, None], axis=-2)[..., 0, :]
    return gaps.min(-1) - RADIUS - POST_RADIUS, point


def step(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(A1): the next configuration, and where braking from there would end."""
    e = PERIOD**2 / (2.0 * HORIZON)
    return (
        Q + (PERIOD - e) * QDOT + e * s,
        Q + (HORIZON - e) * QDOT + (PERIOD + e) * s,
    )


def admitted_share() -> float:
    """The largest share k/64 of the nominal step with which the floor is kept.

    Here by samples; the program has bounds instead.
    """
    for k in range(64, -1, -1):
        start, end = step(k / 64.0 * NOMINAL)
        path = start + np.linspace(0.0, 1.0, 200)[:, None] * (end - start)
        if nearest(path)[0].min() >= FLOOR:
            return k / 64.0
    raise AssertionError("braking is on the present path, which is clear")


def draw_arm(ax, q: np.ndarray, colour: str, alpha: float) -> None:
    """The two capsules, as thick as they are."""
    pixels = ax.transData.transform([[0.0, 0.0], [2.0 * RADIUS, 0.0]])
    width = np.diff(pixels[:, 0])[0] * 72.0 / ax.figure.dpi
    ax.plot(
        *joints(q).T,
        color=colour,
        alpha=alpha,
        linewidth=width,
        solid_capstyle="round",
        solid_joinstyle="round",
    )


def prepare_room(ax) -> None:
    """Sets the axes up, before lengths can be turned into the widths of lines."""
    ax.set(aspect="equal", xlim=(-0.08, 0.66), ylim=(-0.09, 0.48))
    ax.set(xlabel="x [m]", ylabel="y [m]")
    ax.set_title("In the room: where it would come to rest")


def draw_room(ax) -> None:
    """The arm on its present braking path."""
    ax.add_patch(Circle(POST, POST_RADIUS + FLOOR, fill=False, ls=":", color=RED))
    ax.add_patch(Circle(POST, POST_RADIUS, color=GREY))
    rest = Q + HORIZON * QDOT
    for u in (0.33, 0.67):
        draw_arm(ax, Q + u * HORIZON * QDOT, BLUE, 0.12)
    draw_arm(ax, rest, BLUE, 0.35)
    draw_arm(ax, Q, BLUE, 1.0)
    for q, name in ((Q, "$d(q)$"), (rest, "$d(q_s)$")):
        _, point = nearest(q)
        outward = (POST - point) / np.linalg.norm(POST - point)
        ends = np.array([point + RADIUS * outward, POST - POST_RADIUS * outward])
        ax.plot(*ends.T, color=RED, linewidth=1.6, marker=".", markersize=6)
        above = (4, 8) if q is rest else (-32, -10)
        ax.annotate(name, ends.mean(0), above, textcoords="offset points", color=RED)
    now, later = joints(Q)[-1], joints(rest)[-1]
    ax.annotate("now: $q$", now, (-12, -36), textcoords="offset points")
    ax.annotate(
        "at rest: $q_s = q + T\\dot{q}$", later, (-16, 30), textcoords="offset points"
    )
    ax.annotate("post", POST, ha="center", va="center", color="white")


def draw_joint_space(ax) -> None:
    """The same in joint space, with the nominal and the admitted next path."""
    q1, q2 = np.meshgrid(np.linspace(-0.1, 1.1, 300), np.linspace(-0.15, 1.05, 300))
    distance, _ = nearest(np.stack([q1, q2], -1))
    ax.contourf(q1, q2, distance, levels=[-1.0, 0.0], colors=[GREY], alpha=0.55)
    ax.contour(q1, q2, distance, levels=[FLOOR], colors=[RED], linestyles=":")
    ax.set(aspect="equal", xlabel="joint 1 [rad]", ylabel="joint 2 [rad]")
    ax.set_title("In joint space: braking paths are straight")
    share = admitted_share()
    paths = [
        ("present braking path", Q, Q + HORIZON * QDOT, BLUE, "-"),
        ("nominal: not safe", *step(NOMINAL), RED, "--"),
        (
            f"taken: {share:.0%} of the nominal step",
            *step(share * NOMINAL),
            "#1b7f4b",
            "-",
        ),
    ]
    for label, start, end, colour, style in paths:
        ends = np.array([start, end])
        ax.plot(*ends.T, style, color=colour, linewidth=2.0, label=label)
        ax.plot(*start, "o", color=colour, markersize=5)
        ax.plot(*end, "s", color=colour, markersize=5)
    ax.annotate("inside\nthe post", (0.72, 0.72), ha="center")
    ax.legend(loc="lower left", fontsize=9, framealpha=0.9)


def draw_braking_path() -> None:
    """Both panels."""
    figure = Figure(figsize=(10.4, 4.6), layout="constrained")
    room, joint_space = figure.subplots(1, 2)
    draw_joint_space(joint_space)
    prepare_room(room)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    draw_room(room)
    figure.savefig(IMAGES / "braking-path.svg", metadata={"Date": None})


# Columns of boxes; the way leads down the first, up the second, down the third.
COLUMNS = {
    "once, beforehand": [
        "motion file:\nangles or points",
        "joint centres [m],\nz up",
        "low-pass, spline",
        "scaled to the\nrobot's segments",
    ],
    "every control period": [
        "safety check: as nominal,\ncorrected or scaled",
        "projection: what the\nconstraints leave, $s$",
        "a plan:\nthe nominal step, $s_0$",
        "targets\n$x_d, v_d, a_d$",
    ],
    "every torque tick": [
        "accelerations,\nheld for the period",
        "inverse dynamics",
        "robot or\nsimulation",
    ],
}
HALF = np.array([1.35, 0.40])  # of a box


def draw_way() -> None:
    """From a motion's sample to torque."""
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    ax = figure.subplots()
    ax.set(xlim=(-1.7, 9.9), ylim=(-4.4, 1.25))
    ax.set_axis_off()
    at = {}
    for column, (title, texts) in enumerate(COLUMNS.items()):
        frame = (4.1 * column - 1.6, -4.3), 3.2, 5.35
        ax.add_patch(Rectangle(*frame, fill=False, ls="--", color="#bbbbbb"))
        ax.annotate(title, (4.1 * column, 0.72), ha="center", color=GREY)
        for row, text in enumerate(texts):
            at[column, row] = centre = np.array([4.1 * column, -1.25 * row])
            corner, (width, height) = centre - HALF, 2.0 * HALF
            box = "round,pad=0.02,rounding_size=0.15"
            style = {"facecolor": "#eef3fa", "edgecolor": BLUE}
            ax.add_patch(FancyBboxPatch(corner, width, height, box, **style))
            ax.annotate(text, centre, ha="center", va="center", fontsize=10)
    down, up, left, right = HALF * [0, -1], HALF * [0, 1], HALF * [-1, 0], HALF * [1, 0]
    for row in range(3):
        draw_arrow(ax, at[0, row] + down, at[0, row + 1] + up)
        draw_arrow(ax, at[1, row + 1] + up, at[1, row] + down)
    draw_arrow(ax, at[0, 3] + right, at[1, 3] + left)
    draw_arrow(ax, at[1, 0] + right, at[2, 0] + left)
    draw_arrow(ax, at[2, 0] + down, at[2, 1] + up)
    torque, back = np.array([-0.5, 0.0]), np.array([0.5, 0.0])
    draw_arrow(ax, at[2, 1] + down + torque, at[2, 2] + up + torque, "torque  ")
    draw_arrow(ax, at[2, 2] + up + back, at[2, 1] + down + back, "", "--")
    draw_arrow(ax, at[2, 2] + left, at[1, 2] + right, "$q, \\dot{q}$", "--")
    figure.savefig(IMAGES / "sample-to-torque.svg", metadata={"Date": None})


def draw_arrow(ax, start, end, text: str = "", style: str = "-") -> None:
    """From one box to another; the text is to the left or above."""
    arrow = {"arrowstyle": "-|>", "color": "#444444", "linestyle": style}
    arrow |= {"shrinkA": 2.0, "shrinkB": 2.0}
    ax.annotate("", end, start, arrowprops=arrow)
    level = start[1] == end[1]
    where = {"ha": "center", "va": "bottom"} if level else {"ha": "right"}
    ax.annotate(text, 0.5 * (start + end), fontsize=10, **where)


if __name__ == "__main__":
    draw_braking_path()
    draw_way()
