"""A robot as its own file has it: a tree of links and joints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    Mesh,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant

if TYPE_CHECKING:
    from crar_drake.robot_import.meshes import Looks

WORLD = "world"  # the link that Drake takes for its own world
MOVING = ("revolute", "continuous", "prismatic")  # joints of one axis

Positions = Mapping[str, float]  # joint to position [rad or m]
Poses = Mapping[str, RigidTransform]  # link to its pose


# Vertices (N, 3) [m] and faces (M, 3) of a mesh.
Triangles = tuple[np.ndarray, np.ndarray]

# The kinds of geometry that a link's look is made of.
Geometry = Mesh | Convex | Box | Sphere | Cylinder | Capsule | Ellipsoid


@dataclass(frozen=True)
class Shape:
    """A visual or collision element of a link."""

    X_LG: RigidTransform  # pose of the geometry in the link's frame
    geometry: Geometry | Triangles  # Drake's, or a mesh that was read already
    rgba: tuple[float, ...] | None = None  # colour; None if the file has none

    @property
    def path(self) -> Path | None:
        """The file of a mesh; None of what is not in a file."""
        if (
            isinstance(self.geometry, Mesh | Convex)
            and self.geometry.source().is_path()
        ):
            return Path(self.geometry.source().path())
        return None


@dataclass(frozen=True)
class Inertia:
    """Mass and central inertia of a link."""

    mass: float  # [kg]
    X_LB: RigidTransform  # pose of the central frame in the link's
    moments: np.ndarray  # (3, 3) central inertia in that frame [kg m^2]


@dataclass(frozen=True)
class Link:
    """A link with its shapes and its inertia, if the file gives one."""

    name: str
    visual: tuple[Shape, ...] = ()
    collision: tuple[Shape, ...] = ()
    inertia: Inertia | None = None

    @property
    def mass(self) -> float:
        """What the file gives [kg]; 0 if nothing."""
        return self.inertia.mass if self.inertia else 0.0


@dataclass(frozen=True)
class Joint:
    """A joint as the file says it.

    Attributes:
        kind: as in a URDF, or "ball", "universal" or "screw".
        X_PC: pose of the child link in the parent at position zero.
        axis: unit vector in the child's frame.
        lower, upper: [rad or m]; infinite if continuous.
        effort: [Nm or N]; None if there is none.
        mimic: name of the joint that it follows, "" if none, with its
        multiplier and offset [rad or m].
    """

    name: str
    kind: str
    parent: str
    child: str
    X_PC: RigidTransform
    axis: np.ndarray = field(default_factory=lambda: np.zeros(3))
    lower: float = -np.inf
    upper: float = np.inf
    effort: float | None = None
    velocity: float | None = None
    damping: float = 0.0
    mimic: str = ""
    multiplier: float = 1.0
    offset: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether it has a single axis to move about or along."""
        return self.kind in MOVING

    @property
    def unit(self) -> str:
        """Of its positions: "m" or "rad"."""
        return "m" if self.kind == "prismatic" else "rad"

    def transform(self, position: float) -> RigidTransform:
        """X_PC at a position [rad or m]."""
        if self.kind == "prismatic":
            return self.X_PC @ RigidTransform(position * self.axis)
        if self.moves:
            turn = RotationMatrix(AngleAxis(position, self.axis))
            return self.X_PC @ RigidTransform(turn)
        return self.X_PC


def poses_in(plant: MultibodyPlant, q: np.ndarray, links: Iterable[str]) -> Poses:
    """X_WL of some links of a finalized plant at positions (nq,)."""
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    return {
        name: plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(name))
        for name in links
    }


@dataclass(frozen=True)
class Loop:
    """A closed chain: what ties two links together that joints are between."""

    name: str
    joints: tuple[str, ...]


@dataclass(frozen=True)
class SourceRobot:
    """A tree of links and joints, read from a URDF, an SDF or an MJCF."""

    name: str  # of the robot
    path: Path  # of the file
    links: dict[str, Link]  # by name, in the file's order
    # by name, in the file's order; the links are one tree
    joints: dict[str, Joint]
    notes: tuple[str, ...] = ()  # what was left out, or read otherwise
    warnings: tuple[str, ...] = ()  # what of it is hardly meant
    # pose of the root link in the frame F that all poses are given in: z up, x the
    # robot's front (`facing`)
    X_FR: RigidTransform = field(default_factory=RigidTransform)
    loops: tuple[Loop, ...] = ()  # chains that the file closes; the tree has them open
    # joint to position [rad or m] in a rest posture of the file's own, or of its SRDF
    posture: dict[str, float] = field(default_factory=dict)
    # pairs of links that may touch by its SRDF
    allowed: frozenset[frozenset[str]] = frozenset()
    # link to its real look, of those that have one; all are points until it is read
    looks: Looks = field(default_factory=dict)
    # joint to where it is welded [rad or m], once that is decided
    locked: Positions = field(default_factory=dict)

    @cached_property
    def _parents(self) -> dict[str, Joint]:
        return {joint.child: joint for joint in self.joints.values()}

    @cached_property
    def root(self) -> str:
        """The link without a parent."""
        return next(link for link in self.links if link not in self._parents)

    def parent_joint(self, link: str) -> Joint | None:
        """The joint that carries a link; None for the root."""
        return self._parents.get(link)

    def children(self, link: str) -> list[Joint]:
        """The joints that a link carries."""
        return [joint for joint in self.joints.values() if joint.parent == link]

    @property
    def controlled(self) -> list[Joint]:
        """The joints that move and are not locked."""
        return [j for j in self.joints.values() if j.moves and not self.is_weld(j)]

    def is_weld(self, joint: Joint) -> bool:
        """Whether a joint is fixed or locked."""
        return joint.kind == "fixed" or joint.name in self.locked

    def is_bare(self, link: str) -> bool:
        """Whether a link has no geometry: a mere frame."""
        return not (self.links[link].visual or self.links[link].collision)

    def path_to(self, link: str) -> list[Joint]:
        """The joints from the root to a link, all kinds."""
        way: list[Joint] = []
        while (joint := self.parent_joint(link)) is not None:
            way.append(joint)
            link = joint.parent
        return way[::-1]

    def moving_to(self, link: str) -> list[Joint]:
        """Those of `path_to` that move."""
        return [joint for joint in self.path_to(link) if joint.moves]

    def between(self, a: str, b: str) -> list[Joint]:
        """The joints on the way from one link to the other that are no welds, in the
        file's order."""
        way = {j.name for j in self.path_to(a)} ^ {j.name for j in self.path_to(b)}
        joints = [joint for joint in self.joints.values() if joint.name in way]
        return [joint for joint in joints if not self.is_weld(joint)]

    def poses(self, positions: Positions | None = None) -> Poses:
        """X_FL of every link L, with joints at zero or where `positions` says."""
        positions = positions or {}
        X = {self.root: self.X_FR}
        for link in self.below(self.root):
            if link != self.root:
                joint = self._parents[link]
                at = positions.get(joint.name, 0.0)
                X[link] = X[joint.parent] @ joint.transform(at)
        return X

    def posed(self, positions: Positions | None = None) -> Poses:
        """As `poses`, with locked joints where they are welded."""
        return self.poses({**self.locked, **(positions or {})})

    def below(self, link: str) -> Iterator[str]:
        """A link and everything that it carries, parents first."""
        yield link
        for joint in self.children(link):
            yield from self.below(joint.child)

    def without_world(self) -> SourceRobot | None:
        """The robot without a root link that only says where it stands.

        None where the root is not of that kind: a link named world, without
        geometry, that carries one link by a joint that is fixed or floating. If it
        carries several that are fixed to it, it gets another name instead.
        """
        joints = self.children(self.root)
        if self.root != WORLD or not self.is_bare(self.root) or not joints:
            return None
        if len(joints) > 1:
            welded = all(joint.kind == "fixed" for joint in joints)
            return self._renamed_world() if welded else None
        (joint,) = joints
        if joint.kind not in ("fixed", "floating"):
            return None
        return replace(
            self,
            links={name: v for name, v in self.links.items() if name != self.root},
            joints={name: v for name, v in self.joints.items() if v is not joint},
        )

    def _renamed_world(self) -> SourceRobot:
        """The robot with another name of its root link."""
        name = "mount"
        while name in self.links:
            name += "_"
        joints = {
            key: replace(joint, parent=name) if joint.parent == self.root else joint
            for key, joint in self.joints.items()
        }
        others = {k: v for k, v in self.links.items() if k != self.root}
        links = {name: replace(self.links[self.root], name=name), **others}
        return replace(self, links=links, joints=joints)
