"""Some moments of a run side by side, for a person to say whether it dances."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.robots.catalogue import Subject
from benchmarks.robots.trial import Outcome
from crar_drake.figures import save_figure
from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.performer import PARENTS, Performer
from crar_drake.results import LOG
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import load_logged_robot, load_logged_scenario
from crar_drake.robot.model import ControlModel
from crar_drake.robot_import.link_meshes import read_link_meshes

_MOMENTS = 8
_POINTS = 500  # of a link, at most
_VIEWS = {"front": (1, 1.0), "left": (0, -1.0)}  # across the picture: axis, direction


def write_sheet(subject: Subject, outcome: Outcome, folder: Path, out: Path) -> None:
    """Draws a run's robot at moments evenly apart, from the front and from its left,
    and below it who it follows, if anybody.

    Links are the vertices of their meshes, targets crosses, a performer's bones lines.

    Args:
        subject: the robot.
        outcome: of its run.
        folder: that has the log.
        out: PNG to write.
    """
    log = SimulationLog.load(folder / LOG)
    scenario = load_logged_scenario(log)
    model = ControlModel.FromDescription(load_logged_robot(log), scenario.task_list())
    plant, layout = model.plant, log.layout
    context = plant.CreateDefaultContext()
    rng = np.random.default_rng(0)
    clouds = {}
    for link in read_link_meshes(plant, model.scene_graph):
        points = np.concatenate([part.vertices for part in link.parts])
        few = rng.permutation(len(points))[:_POINTS]
        clouds[link.body] = points[few]
    rows = np.linspace(0, len(log.time) - 1, _MOMENTS + 1).astype(int)[1:]
    performer = load_performer(scenario.motion) if scenario.motion else None
    num_rows = len(_VIEWS) * (1 if performer is None else 2)
    figure = Figure(figsize=(1.5 * _MOMENTS, 2.1 * num_rows), layout="constrained")
    axes = figure.subplots(num_rows, _MOMENTS, sharey="row")
    for column, row in enumerate(rows):
        plant.SetPositions(context, log.q[row])
        p = np.concatenate(
            [
                plant.EvalBodyPoseInWorld(context, plant.get_body(body))
                .multiply(points.T)
                .T
                for body, points in clouds.items()
            ]
        )
        targets = layout.unpack(log.desired_tasks[row]).p
        for ax, (axis, sign) in zip(axes[:, column], _VIEWS.values(), strict=False):
            ax.scatter(sign * p[:, axis], p[:, 2], s=0.2, c="0.35", linewidths=0)
            across = sign * targets[:, axis]
            ax.scatter(across, targets[:, 2], s=18, c="tab:purple", marker="x")
        if performer is not None:
            frame = round(log.time[row] * performer.frame_rate)
            for ax, view in zip(axes[len(_VIEWS) :, column], _VIEWS, strict=True):
                _draw_body(ax, performer, min(frame, performer.num_frames - 1), view)
        for ax in axes[:, column]:
            ax.set_aspect("equal", "datalim")
            ax.tick_params(labelbottom=False, labelsize="x-small")
        axes[0, column].set_title(f"{log.time[row]:.1f} s", fontsize="small")
    for row in range(num_rows):
        view = tuple(_VIEWS)[row % len(_VIEWS)]
        axes[row, 0].set_ylabel(f"{view}: z [m]", fontsize="small")
    error = "" if outcome.error is None else f", {1e3 * outcome.error:.0f} mm rms"
    figure.suptitle(f"{subject.name}: {outcome.task}{error}", fontsize="medium")
    save_figure(figure, out)


def _draw_body(ax, performer: Performer, frame: int, view: str) -> None:
    axis, sign = _VIEWS[view]
    p = {joint: each[frame] for joint, each in performer.positions.items()}
    for joint, parent in PARENTS.items():
        if joint in p and parent in p:
            ends = np.array([p[parent], p[joint]])
            ax.plot(sign * ends[:, axis], ends[:, 2], c="tab:purple", linewidth=1.5)
