"""What the certificate of a cleaned motion does not cover, and how it is looked at."""

from __future__ import annotations

from dataclasses import dataclass

from pydrake.multibody.tree import BodyIndex

from crar_drake.errors import ModelError
from crar_drake.judging.judged_pairs import pairs_beyond_one_joint
from crar_drake.judging.mesh_judge import MeshJudge
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot_import.link_meshes import check_installed, has_meshes


@dataclass(frozen=True)
class MeshFrames:
    """Frames of a motion in which meshes penetrate.

    Attributes:
        num_penetrating: how many they are.
        pairs: per pair of links that does, the deepest first: both names, and in how
            many frames.
    """

    num_penetrating: int
    pairs: tuple[tuple[str, str, int], ...]

    def __str__(self) -> str:
        frames = "frame" if self.num_penetrating == 1 else "frames"
        reported = f"meshes penetrate in {self.num_penetrating} {frames}"
        if self.pairs:
            a, b, _ = self.pairs[0]
            more = len(self.pairs) - 1
            reported += f" ({a} - {b}{f' and {more} more' if more else ''})"
        return reported


class Uncovered:
    """Pairs of links more than one joint apart that nobody watches.

    Attributes:
        pairs: their names.
        why_not: why no meshes are looked at; "" if they are.
    """

    def __init__(self, robot: WholeBody) -> None:
        """
        Args:
            robot: with the pairs of its description watched.

        Raises:
            ModelError: a mesh cannot be read.
        """
        description = robot.description
        plant, graph = robot.plant, robot.scene_graph
        self._robot, self._judge, self.why_not = robot, None, ""
        if not has_meshes(plant, graph):
            self.why_not = "its links have no meshes"
        else:
            try:
                check_installed()
            except ModelError as error:
                self.why_not = str(error)
            else:
                self._judge = MeshJudge(description)
        if self._judge:
            pairs = self._judge.pairs + self._judge.left_out
        else:
            bodies = [
                body
                for body in map(BodyIndex, range(1, plant.num_bodies()))
                if plant.GetCollisionGeometriesForBody(plant.get_body(body))
            ]
            names = [plant.get_body(body).name() for body in bodies]
            beyond = pairs_beyond_one_joint(plant, bodies)
            pairs = [(names[i], names[j]) for i, j in beyond]
        watched = {frozenset(pair) for pair in description.pairs}
        self.pairs = [pair for pair in pairs if frozenset(pair) not in watched]

    def look_at(self, motion: RobotMotion) -> MeshFrames | None:
        """What the meshes say of each frame, watched or not; None without any."""
        if self._judge is None:
            return None
        verdict = self._judge.judge(self._robot.configurations(motion.joint_positions))
        pairs = tuple(
            (*contact.pair, contact.num_samples) for contact in verdict.penetrations
        )
        return MeshFrames(verdict.num_penetrating, pairs)
