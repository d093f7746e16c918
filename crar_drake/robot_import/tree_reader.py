"""Links and joints of a robot's file as a reader adds them, one by one."""

from collections.abc import Collection
from pathlib import Path

from pydrake.math import RigidTransform

from crar_drake.robot_import.source_robot import WORLD, Joint, Link, SourceRobot, weld


class TreeReader:
    """What the readers of an SDF's plant and of a compiled MJCF have in common."""

    def __init__(self, path: Path, notes: list[str]) -> None:
        self._path, self._notes = path, notes
        self._links: dict[str, Link] = {}
        self._joints: dict[str, Joint] = {}
        # What the model's bodies and joints are called here, by their indices there.
        self._bodies, self._joint_names = {}, {}
        self._taken = {WORLD}  # names of links, also of those to come

    def _tree(self) -> SourceRobot:
        """What is read so far, without a name."""
        return SourceRobot("", self._path, self._links, self._joints)

    def _note_foreign(self, names: Collection[str]) -> None:
        if names:
            what = ", ".join(names)
            self._notes.append(f"left out, since it is not the robot's: {what}")

    def _unique(self, name: str, more: str = "_") -> str:
        """A new link's name, which is made longer where there is such a link."""
        while name in self._taken:
            name += more
        self._taken.add(name)
        return name

    def _add_bare_link(self, name: str, more: str = "_") -> str:
        """One without geometry; its `_unique` name."""
        name = self._unique(name, more)
        self._links[name] = Link(name)
        return name

    def _weld(self, parent: str, child: str, X_PC: RigidTransform) -> None:
        name = f"{child}_weld"
        while name in self._joints or name in self._joint_names.values():
            name += "_"
        self._joints[name] = weld(name, parent, child, X_PC)
