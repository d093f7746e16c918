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
        meshes: that are looked at; None if none are.
        mesh_pairs: pairs of links that are covered by their meshes.
        by_shapes: watched pairs of which the shapes about their links decide: meshes do
            not.
        listed: what is not covered, as a certificate lists it: pairs more than one
            joint apart, neither watched by their capsules nor covered by their meshes;
            and why no meshes are looked at.
    """

    def __init__(self, robot: WholeBody) -> None:
        """
        Args:
            robot: with the pairs of its description watched.

        Raises:
            ModelError: a mesh cannot be read.
        """
        self.description, why_not = robot.description, why_no_meshes(robot)
        self.meshes = None if why_not else ClearanceOfMeshes(robot)
        if self.meshes is None:
            pairs, self.mesh_pairs, not_of = shaped_pairs(robot), [], {}
        else:
            of_meshes = self.meshes.meshes
            pairs = of_meshes.not_of.as_built + of_meshes.not_of.beyond_root
            self.mesh_pairs, not_of = of_meshes.pairs, asdict(of_meshes.not_of)
        watched = self.description.pairs
        covered = {frozenset(pair) for pair in self.mesh_pairs}
        self.by_shapes = [list(x) for x in watched if frozenset(x) not in covered]
        watched = {frozenset(pair) for pair in watched}
        pairs = [pair for pair in pairs if frozenset(pair) not in watched]
        self.listed = {"pairs": pairs, "meshes": why_not or "covered"} | not_of
