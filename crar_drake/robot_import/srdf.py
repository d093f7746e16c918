"""The SRDF beside a URDF: postures that have names, and pairs that may touch.

MoveIt's setup assistant writes such files, and many robots ship one. Of it two things
are read: `group_state`, for the rest posture, and `disable_collisions`.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crar_drake.errors import ModelError, nearest
from crar_drake.robot_import.robot_files import naming, one_number, read_xml
from crar_drake.robot_import.source_robot import SourceRobot

# What postures that a robot rests in are called, the first first.
_RESTS = ("half_sitting", "standing", "home", "ready", "neutral", "default")


@dataclass(frozen=True)
class Semantics:
    """What an SRDF says of a robot."""

    path: Path  # of the file
    # name of a posture to its joints' positions [rad or m]; groups of joints whose
    # postures have one name are one posture
    postures: dict[str, dict[str, float]]
    allowed: frozenset[frozenset[str]]  # pairs of links whose collisions are disabled

    def posture(self, name: str) -> tuple[str, dict[str, float]]:
        """A posture and its name.

        Args:
            name: of the posture; "" for that which a robot rests in: of a name that
                says so, or the only one.

        Returns:
            "" and nothing where the file leaves a choice, or has none.

        Raises:
            ModelError: there is none of that name.
        """
        if name:
            if name not in self.postures:
                raise ModelError(
                    f"{self.path}: no group_state {name!r}"
                    f"{nearest(name, self.postures)}; there are: "
                    f"{', '.join(self.postures) or 'none'}"
                )
            return name, self.postures[name]
        known = {known.lower(): known for known in self.postures}
        found = [known[rest] for rest in _RESTS if rest in known]
        if not found and len(known) == 1:
            found = [*self.postures]
        return (found[0], self.postures[found[0]]) if found else ("", {})


def read_srdf(path: Path, robot: SourceRobot) -> Semantics:
    """Reads an SRDF.

    Joints that the robot has not, as the virtual one of its root, are left out, and so
    are those of more numbers than one; positions beyond a limit are taken to it.

    Raises:
        ModelError: the file cannot be read, is no SRDF, or names no joint and no link
            of the robot.
    """
    root = read_xml(path, "an SRDF")
    if root.tag != "robot":
        raise ModelError(f"{path}: not an SRDF: its root element is <{root.tag}>")
    if root.find("link") is not None:
        raise ModelError(f"{path}: not an SRDF, but a URDF: it has links of its own")
    postures: dict[str, dict[str, float]] = {}
    for state in root.iter("group_state"):
        name = state.get("name") or ""
        posture = postures.setdefault(name, {})
        for element in state.findall("joint"):
            joint = robot.joints.get(element.get("name") or "")
            value = element.get("value") or ""
            if joint is None or not joint.moves or len(value.split()) != 1:
                continue
            with naming(path, f"group_state {name!r}: joint", element):
                position = one_number(value)
            posture[joint.name] = float(np.clip(position, joint.lower, joint.upper))
    pairs = {
        frozenset((entry.get("link1") or "", entry.get("link2") or ""))
        for entry in root.iter("disable_collisions")
    }
    known = frozenset(pair for pair in pairs if pair <= set(robot.links))
    postures = {name: posture for name, posture in postures.items() if posture}
    if not known and not postures:
        raise ModelError(
            f"{path}: it has no group_state of a joint of {robot.name} and disables no "
            "collision of its links; is it another robot's?"
        )
    return Semantics(path, postures, known)
