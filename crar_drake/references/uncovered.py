"""What the certificate of a motion does not cover, and what the meshes say besides."""

from __future__ import annotations

from dataclasses import asdict

from pydrake.multibody.tree import BodyIndex

from crar_drake.errors import ModelError
from crar_drake.judging.judged_pairs import pairs_by_joints
from crar_drake.references.mesh_clearance import ClearanceOfMeshes
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot_import.link_meshes import check_installed, has_meshes


def why_no_meshes(robot: WholeBody) -> str:
    """Why a robot's meshes cannot be looked at; "" if they can."""
    if not has_meshes(robot.plant, robot.scene_graph):
        return "its links have no meshes"
    try:
        check_installed()
    except ModelError as error:
        return str(error)
    return ""


def shaped_pairs(robot: WholeBody) -> list[tuple[str, str]]:
    """Pairs of links with collision shapes that more than one joint is between."""
    plant = robot.plant
    bodies = [
        body
        for body in map(BodyIndex, range(1, plant.num_bodies()))
        if plant.GetCollisionGeometriesForBody(plant.get_body(body))
    ]
    names = [plant.get_body(body).name() for body in bodies]
    beyond, _ = pairs_by_joints(plant, bodies)
    return [(names[i], names[j]) for i, j in beyond]


class Uncovered:
    """Pairs of links of which a certificate does not speak.

    Attributes:
        description: of the robot.
        pairs: more than one joint apart, neither watched by their capsules nor covered
            by their meshes.
        why_not: why no meshes are looked at; "" if they are.
        meshes: that are; None if none are.
    """

    def __init__(self, robot: WholeBody) -> None:
        """
        Args:
            robot: with the pairs of its description watched.

        Raises:
            ModelError: a mesh cannot be read.
        """
        self.meshes: ClearanceOfMeshes | None = None
        self.why_not = why_no_meshes(robot)
        if self.why_not:
            pairs = shaped_pairs(robot)
        else:
            self.meshes = ClearanceOfMeshes(robot)
            not_of = self.meshes.meshes.not_of
            pairs = not_of.as_built + not_of.beyond_root
        self.description = robot.description
        watched = {frozenset(pair) for pair in self.description.pairs}
        self.pairs = [pair for pair in pairs if frozenset(pair) not in watched]

    @property
    def by_shapes(self) -> list[list[str]]:
        """Watched pairs of which the shapes about their links decide: meshes do not."""
        meshes = {frozenset(pair) for pair in self.mesh_pairs}
        watched = self.description.pairs
        return [list(pair) for pair in watched if frozenset(pair) not in meshes]

    @property
    def mesh_pairs(self) -> list[tuple[str, str]]:
        """Pairs of links that are covered by their meshes."""
        return [] if self.meshes is None else self.meshes.meshes.pairs

    def as_listed(self) -> dict:
        """What is not covered, as a certificate lists it."""
        listed = {"pairs": self.pairs, "meshes": self.why_not or "covered"}
        if self.meshes is not None:
            listed |= asdict(self.meshes.meshes.not_of)
        return listed
