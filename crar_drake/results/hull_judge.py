"""A second judge of a motion: the convex hulls of the robot's real meshes.

The controller and the referee know only capsules. This one asks Drake's SceneGraph
for the distances of the hulls that the import wrote, at samples of a trajectory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.geometry import Convex
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder

from crar_drake.errors import ModelError
from crar_drake.robot.description import RobotDescription, add_robot
from crar_drake.robot_import.importer import hull_file

# Beyond this distance of the links' bounding spheres a pair is not asked for.
_FAR = 0.05  # [m]


def has_hulls(description: RobotDescription) -> bool:
    """Whether a robot was imported, so that there are hulls to judge it by."""
    return any(Path(description.folder).glob("hulls/*.obj"))


@dataclass(frozen=True)
class HullVerdict:
    """What the hulls say of a trajectory.

    Attributes:
        num_samples: that were judged.
        num_penetrating: samples with a pair of hulls in penetration.
        smallest_distance: over pairs and samples [m]; infinite if all stayed far.
        smallest_distance_pair: those two links; None if all stayed far.
        left_out: pairs whose hulls overlap in the rest posture, where the real
            meshes do not touch: hulls fill what is hollow, and can't judge them.
    """

    num_samples: int
    num_penetrating: int
    smallest_distance: float
    smallest_distance_pair: tuple[str, str] | None
    left_out: list[tuple[str, str]]


class HullJudge:
    """Signed distances of the watched pairs between convex hulls of meshes."""

    def __init__(self, description: RobotDescription) -> None:
        """
        Args:
            description: of an imported robot.

        Raises:
            ModelError: its folder has no hulls.
        """
        folder = Path(description.folder)
        links = sorted({link for pair in description.pairs for link in pair})
        files = {link: _hull_files(folder, link) for link in links}
        bare = [link for link in links if not files[link]]
        if bare:
            raise ModelError(
                f"{folder}: there are no convex hulls of {', '.join(bare)}; only "
                "robots of `crar-drake import-robot` have them: import it again"
            )
        builder = DiagramBuilder()
        self._plant, self._scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        add_robot(self._plant, description)
        self._hulls: dict[str, list] = {}
        self._balls: dict[str, tuple[np.ndarray, float]] = {}
        for link in links:
            body = self._plant.GetBodyByName(link)
            corners = np.concatenate([_vertices(file) for file in files[link]])
            centre = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
            radius = float(np.linalg.norm(corners - centre, axis=1).max())
            self._balls[link] = (centre, radius)
            self._hulls[link] = [
                self._plant.RegisterCollisionGeometry(
                    body,
                    RigidTransform(),
                    Convex(str(file)),
                    f"hull_{link}_{index}",
                    CoulombFriction(0.0, 0.0),
                )
                for index, file in enumerate(files[link])
            ]
        self._plant.Finalize()
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self._context = self._plant.GetMyMutableContextFromRoot(self._root)
        self.pairs = [(a, b) for a, b in description.pairs]
        rest = self._plant.GetPositions(self._context)
        for name, value in description.rest_posture.items():
            rest[self._plant.GetJointByName(name).position_start()] = value
        self.left_out = [
            pair
            for pair, d in zip(self.pairs, self.distances(rest), strict=True)
            if d < 0.0
        ]

    def distances(self, q: np.ndarray) -> np.ndarray:
        """Signed distance of each pair [m]; infinite if it is clearly far.

        Args:
            q: (nq,) positions of the plant.
        """
        self._plant.SetPositions(self._context, q)
        query = self._scene_graph.get_query_output_port().Eval(
            self._scene_graph.GetMyContextFromRoot(self._root)
        )
        centres = {
            link: self._plant.EvalBodyPoseInWorld(
                self._context, self._plant.GetBodyByName(link)
            ).multiply(centre)
            for link, (centre, _) in self._balls.items()
        }
        d = np.full(len(self.pairs), np.inf)
        for row, (a, b) in enumerate(self.pairs):
            gap = np.linalg.norm(centres[a] - centres[b])
            if gap - self._balls[a][1] - self._balls[b][1] > _FAR:
                continue
            d[row] = min(
                query.ComputeSignedDistancePairClosestPoints(i, j).distance
                for i in self._hulls[a]
                for j in self._hulls[b]
            )
        return d

    def judge(self, q_trajectory: np.ndarray) -> HullVerdict:
        """Judges every sample of a (T, nq) trajectory."""
        kept = np.array([pair not in self.left_out for pair in self.pairs])
        smallest, pair, penetrating = np.inf, None, 0
        for q in q_trajectory:
            d = np.where(kept, self.distances(q), np.inf)
            nearest = int(np.argmin(d))
            penetrating += d[nearest] < 0.0
            if d[nearest] < smallest:
                smallest, pair = float(d[nearest]), self.pairs[nearest]
        return HullVerdict(
            len(q_trajectory), int(penetrating), smallest, pair, self.left_out
        )


def _hull_files(folder: Path, link: str) -> Sequence[Path]:
    files = []
    while (file := hull_file(folder, link, len(files))).is_file():
        files.append(file)
    return files


def _vertices(file: Path) -> np.ndarray:
    lines = file.read_text().splitlines()
    return np.array(
        [line.split()[1:] for line in lines if line.startswith("v ")], float
    )
