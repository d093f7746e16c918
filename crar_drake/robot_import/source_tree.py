"""A robot's tree of links and joints, as the reader of each format builds it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform

from crar_drake.errors import ModelError, nearest
from crar_drake.robot_import.source_robot import (
    WORLD,
    Joint,
    Link,
    Loop,
    SourceRobot,
)

_TINY = 1e-9  # [m]


class SourceTree:
    """Links and joints, added one by one; `finished` checks the robot that they are.

    Attributes:
        path: of the file.
        notes, warnings: as those of a `SourceRobot`.
        links, joints: by name.
        taken, reserved: names of links, and of joints, that are still to come.
    """

    def __init__(self, path: Path, notes: Sequence[str] = ()) -> None:
        """An empty one."""
        self.path, self.notes = path, list(notes)
        self.warnings: list[str] = []
        self.links: dict[str, Link] = {}
        self.joints: dict[str, Joint] = {}
        self.taken, self.reserved = {WORLD}, set[str]()

    def unique(self, name: str, more: str = "_") -> str:
        """A new link's name, which is made longer where there is such a link."""
        while name in self.taken:
            name += more
        self.taken.add(name)
        return name

    def add_link(self, link: Link) -> None:
        """Adds one with its shapes; ModelError if there is one of its name."""
        if link.name in self.links:
            raise ModelError(f"{self.path}: two links are named {link.name!r}")
        self.links[link.name] = link

    def add_frame(self, link: str, name: str, more: str, X_LF: RigidTransform) -> None:
        """Adds a frame of a link: a link without geometry, of a `unique` name."""
        name = self.add_bare_link(name, more)
        self.weld(link, name, X_LF)

    def add_bare_link(self, name: str, more: str = "_") -> str:
        """Adds one without geometry; its `unique` name."""
        name = self.unique(name, more)
        self.links[name] = Link(name)
        return name

    def add_joint(self, joint: Joint, X_MC: RigidTransform | None = None) -> None:
        """Adds a joint; ModelError if there is one of its name.

        Args:
            joint: its X_PC and axis are those of the joint's frame M.
            X_MC: pose of its child there, if that is another one. Where the child's
                origin is beside the axis, M gets a link without geometry.
        """
        if joint.name in self.joints:
            raise ModelError(f"{self.path}: two joints are named {joint.name!r}")
        X_MC, child = X_MC or RigidTransform(), joint.child
        beside = np.linalg.norm(np.cross(joint.axis, X_MC.translation())) > _TINY
        if beside and joint.kind in ("revolute", "continuous"):
            joint = replace(joint, child=self.add_bare_link(f"{joint.name}_link"))
        else:
            axis = X_MC.rotation().inverse() @ joint.axis
            joint = replace(joint, X_PC=joint.X_PC @ X_MC, axis=axis)
        self.joints[joint.name] = joint
        if joint.child != child:
            self.weld(joint.child, child, X_MC)

    def stand(
        self, link: str, X_WL: RigidTransform, mounted: bool
    ) -> tuple[str, RigidTransform]:
        """What carries a link that stands in the world, and its pose there.

        A root link is taken to have z up. If it is turned in the world, a link that is
        not carries it. Else the world does, if the link is `mounted` in it, or nothing,
        which is called "".
        """
        X_UL = RigidTransform(X_WL.rotation())
        if X_UL.IsNearlyIdentity(1e-6):
            return (WORLD, X_WL) if mounted else ("", RigidTransform())
        upright = self.add_bare_link(f"{link}_upright")
        if mounted:
            self.weld(WORLD, upright, RigidTransform(X_WL.translation()))
        return upright, X_UL

    def note_foreign(self, names: Collection[str]) -> None:
        """Says what of the file is not the robot."""
        if names:
            what = ", ".join(names)
            self.notes.append(f"left out, since it is not the robot's: {what}")

    def robot(self) -> SourceRobot:
        """The links and joints so far, which are one tree; it has no name.

        Raises:
            ModelError: they are none, or a joint names what is not there.
        """
        robot = SourceRobot("", self.path, self.links, self.joints)
        _check_tree(robot)
        return robot

    def finished(
        self,
        name: str,
        loops: Sequence[Loop] = (),
        posture: Mapping[str, float] | None = None,
    ) -> SourceRobot:
        """The whole robot; an infinite limit of speed or effort is none.

        Raises:
            ModelError: as of `robot`; or a joint's limits are NaN, reversed, negative
                or on one side.
        """
        joints = {n: self._checked_limits(joint) for n, joint in self.joints.items()}
        return replace(
            self.robot(),
            name=name,
            joints=joints,
            notes=tuple(self.notes),
            warnings=tuple(self.warnings),
            loops=tuple(loops),
            posture=dict(posture or {}),
        )

    def weld(self, parent: str, child: str, X_PC: RigidTransform) -> None:
        """Adds a joint that does not move, which is called after the child."""
        name = f"{child}_weld"
        while name in self.joints or name in self.reserved:
            name += "_"
        self.joints[name] = Joint(name, "fixed", parent, child, X_PC)

    def _checked_limits(self, joint: Joint) -> Joint:
        if not joint.moves:
            return joint
        where = f"{self.path}: joint {joint.name!r}"
        most = {"effort": joint.effort, "velocity": joint.velocity}
        for key, value in most.items():
            if value is not None and not value >= 0.0:
                raise ModelError(
                    f"{where}: {key} is {value:g}; give a positive number, or none"
                )
        lower, upper = joint.lower, joint.upper
        wrong = ""
        if lower > upper:
            wrong = "lower is above upper"
        elif not np.isfinite(upper - lower) and (lower, upper) != (-np.inf, np.inf):
            wrong = "give both limits or none"
        if wrong:
            raise ModelError(
                f"{where}: its range is {lower:g} to {upper:g} {joint.unit}: {wrong}"
            )
        return replace(
            joint, **{key: None if v == np.inf else v for key, v in most.items()}
        )


def _check_tree(robot: SourceRobot) -> None:
    """Raises ModelError: the links are not one tree, or a name is of nothing."""
    path, links, joints = robot.path, robot.links, robot.joints
    if not links:
        raise ModelError(f"{path}: it has no links")
    parents: dict[str, Joint] = {}
    for joint in joints.values():
        for end in (joint.parent, joint.child):
            if end not in links:
                raise ModelError(
                    f"{path}: joint {joint.name!r} names the link {end!r}, which is "
                    f"not there{nearest(end, links)}"
                )
        if joint.child in parents:
            raise ModelError(
                f"{path}: link {joint.child!r} hangs on the joints "
                f"{parents[joint.child].name!r} and {joint.name!r}: a closed chain, "
                "which is not supported; remove one of them"
            )
        parents[joint.child] = joint
        if joint.mimic and joint.mimic not in joints:
            raise ModelError(
                f"{path}: joint {joint.name!r} mimics {joint.mimic!r}, which is not "
                f"there{nearest(joint.mimic, joints)}"
            )
    tops = [name for name in links if name not in parents]
    if len(tops) != 1:
        raise ModelError(
            f"{path}: the links are not one tree; these have no parent: "
            f"{', '.join(tops) or 'none (a closed chain)'}"
        )
    # A ring of joints beside the tree leaves links that no way leads to.
    tree = set(robot.below(tops[0]))
    if lost := [name for name in links if name not in tree]:
        raise ModelError(
            f"{path}: these links form a closed chain, which is not supported: "
            f"{', '.join(lost)}"
        )
