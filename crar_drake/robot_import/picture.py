"""A picture of a robot's real meshes and of the capsules that stand for them."""

from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.robot.description import RobotDescription
from crar_drake.robot_import.capsule_fitting import Capsules, FittedCapsule
from crar_drake.robot_import.meshes import Looks, triangles_of
from crar_drake.robot_import.source_robot import poses_in

# Name of a view -> the world's axes to the right, up and towards the viewer.
_VIEWS = {
    "front": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "side": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
}
_LIGHT = np.array([0.4, 0.5, 0.8]) / np.linalg.norm([0.4, 0.5, 0.8])


def draw_robot(
    path: Path,
    plant: MultibodyPlant,
    description: RobotDescription,
    rest: np.ndarray,
    looks: Looks,
    capsules: Capsules,
) -> None:
    """Draws front and side view, at rest (nq,): the meshes, and over them the capsules
    and the motion's points."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    from crar_drake.figures import save_figure

    figure = Figure(figsize=(15, 10))
    axes = figure.subplots(1, 4)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, rest)
    poses = poses_in(plant, rest, looks)
    parts = [part.moved(poses[name]) for name in looks for part in looks[name]]
    vertices, faces = triangles_of(parts)
    triangles = vertices[faces]
    rgba = [np.resize(part.rgba, 4) for part in parts]
    colours = np.repeat(rgba, [len(part.faces) for part in parts], axis=0)
    lower, upper = triangles.min(axis=(0, 1)) - 0.1, triangles.max(axis=(0, 1)) + 0.1
    half_width = np.max(upper - lower - [0.0, 0.0, np.inf]) / 2.0
    for column, (name, axis) in enumerate(zip([*_VIEWS] * 2, axes, strict=True)):
        view = np.array(_VIEWS[name], dtype=float)
        seen = triangles @ view.T
        order = np.argsort(seen[:, :, 2].mean(axis=1))
        with_capsules = column >= len(_VIEWS)
        axis.add_collection(
            PolyCollection(
                seen[order][:, :, :2],
                facecolors=_shade(triangles, colours, view)[order],
                edgecolors="none",
            ),
            autolim=False,
        )
        if with_capsules:
            outlines = [
                _outline(poses[link], capsule, view)
                for link in capsules
                for capsule in capsules[link]
            ]
            axis.add_collection(
                PolyCollection(
                    outlines,
                    facecolors=(0.9, 0.3, 0.1, 0.18),
                    edgecolors=(0.8, 0.2, 0.0, 0.9),
                    linewidths=0.8,
                ),
                autolim=False,
            )
            for label, frame in description.task_frames.items():
                X_WP = plant.GetFrameByName(frame).CalcPoseInWorld(context)
                x, y, _ = view @ X_WP.translation()
                axis.plot(x, y, "k+", markersize=7)
                axis.annotate(label, (x, y), fontsize=6, color="black")
        axis.set_aspect("equal")
        middle = np.abs(view[0]) @ (lower + upper) / 2.0
        axis.set_xlim(middle - half_width, middle + half_width)
        axis.set_ylim(lower[2], upper[2])
        axis.set_title(f"{name}{', capsules' if with_capsules else ''}")
        axis.set_xlabel("m")
    count = sum(map(len, capsules.values()))
    figure.suptitle(f"{description.name}: meshes, and {count} capsules")
    figure.tight_layout()
    save_figure(figure, path, dpi=110)


def _shade(triangles, colours, view) -> np.ndarray:
    import trimesh

    normal = trimesh.util.unitize(trimesh.triangles.cross(triangles))
    bright = 0.45 + 0.55 * np.abs((normal @ view.T) @ _LIGHT)
    shaded = colours.copy()
    shaded[:, :3] = np.clip(0.15 + 0.85 * colours[:, :3], 0, 1) * bright[:, None]
    return shaded


def _outline(X_WL: RigidTransform, capsule: FittedCapsule, view: np.ndarray):
    """The capsule's silhouette: two circles and what is between them."""
    from scipy.spatial import ConvexHull

    angles = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    circle = capsule.radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ends = [(view @ X_WL.multiply(p))[:2] for p in (capsule.p_L0, capsule.p_L1)]
    points = np.concatenate([end + circle for end in ends])
    return points[ConvexHull(points).vertices]
