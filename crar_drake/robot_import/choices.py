"""What an import decided about a robot: `import.yaml`, which the user may correct.

A key that is there is kept by every later import; a key that is left out is guessed
again and appended, with a comment.
"""

# YAML loading reads the types of the fields, so no postponed annotations here.
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from crar_drake.errors import ModelError
from crar_drake.files import write_whole
from crar_drake.robot.description import check_soles
from crar_drake.robot_import.source_robot import Poses
from crar_drake.yaml_files import load_yaml, read_text

BASES = ("prescribed", "floating", "fixed")
AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
UP_AXES = ("z", "file")
# Parts of the body whose joints can be locked together.
GROUPS = ("legs", "arms", "hands", "head", "trunk", "other")

_HEADER = """\
# What `crar-drake import-robot` decided about this robot. Correct it and import
# again: what stands here is kept, a key that you remove is guessed anew. Everything
# else in this folder is made from this file and will be overwritten.
"""

# What each key is, as it is written above it.
_COMMENTS = {
    "source": "the robot's own file, URDF, SDF or MJCF",
    "srdf": "its posture is where the robot rests, and its disabled pairs may touch",
    "posture": "which group_state of the SRDF",
    "up_axis": "of DAE meshes: file, as each says; z, z up whatever they say",
    "up": "axis of the root link that points up: +x, -x, +y, -y, +z or -z",
    "facing": "axis of the root link that points ahead: +x, -x, +y, -y, +z or -z",
    "base": "floating: a reference motion says where the root link is; prescribed: a "
    "motion moves it and turns it about z; fixed: welded",
    "lock": f"groups of joints to lock: {', '.join(GROUPS)}",
    "locked": "joint -> position [rad or m] at which it is welded",
    "segments": "link -> links welded to it that share its capsules",
    "frames": "the motion's point -> link, and where in it [m]; rpy [rad] turns it",
    "rest_posture": "joint -> position [rad or m]; those not named are at 0",
    "pairs": "watched segment pairs",
    "soles": "link -> corners of its flat sole, in the link's frame [m]",
    "ground": "height of the ground [m], which all links keep off; -.inf: none",
    "cover": "whether capsules are grown to hold all triangles of their links",
}


@dataclass
class FrameChoice:
    """A point of the motion on the robot."""

    link: str = ""  # that carries it
    # its position in the link's frame [m]
    point: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    # roll, pitch, yaw of its frame in the link's [rad]; matters only to tasks of kind
    # orientation and pose
    rpy: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def place(self, X: Poses) -> np.ndarray:
        """(3,) where it is, in the frame of the links' poses [m]."""
        return X[self.link].multiply(np.array(self.point, dtype=float))


@dataclass
class ImportChoices:
    """The keys of an import file (`_COMMENTS`); None is a key that is left out."""

    # relative to the file, or `example-robot-data:` and its path in that package
    source: str = ""
    # folders in which the URDF's packages are looked for
    package_paths: list[str] = field(default_factory=list)
    name: str = ""  # of the robot
    srdf: str = ""  # relative to the file; counts where posture and pairs are guessed
    posture: str = ""  # "" for the one that a robot rests in
    up_axis: str | None = None  # None where no mesh says anything but z
    up: str | None = None  # None is z
    facing: str | None = None
    base: str | None = None
    # where `locked` is guessed; None is all that no arm needs
    lock: list[str] | None = None
    locked: dict[str, float] | None = None
    segments: dict[str, list[str]] | None = None
    frames: dict[str, FrameChoice] | None = None
    rest_posture: dict[str, float] | None = None
    pairs: list[list[str]] | None = None
    ground: float | None = None
    soles: dict[str, list[list[float]]] = field(default_factory=dict)
    excess: float = 0.02  # that a capsule may stick out of its link's hull [m]
    most_capsules: int = 16  # per link, at most
    cover: bool = False
    # triangles per part that a recording shows, at most about; a whole robot's recorded
    # page is below 10 MB then
    faces: int = 2500

    def validate(self, where: str) -> None:
        """Checks what can be checked without the URDF.

        Raises:
            ModelError: names the file, the key and what it may be.
        """
        for mistake in self._mistakes():
            raise ModelError(f"{where}: {mistake}")
        check_soles(self.soles, where)

    def _mistakes(self) -> Iterator[str]:
        if not self.source:
            yield "source: name the robot's URDF, SDF or MJCF"
        if self.posture and not self.srdf:
            yield "posture: there is no srdf that could have it"
        axes = {"up": AXES, "facing": AXES, "up_axis": UP_AXES}
        for key, known in (axes | {"base": BASES, "lock": GROUPS}).items():
            given = getattr(self, key)
            for value in given if isinstance(given, list) else [given]:
                if value is not None and value not in known:
                    yield f"{key}: {value!r} is none of {', '.join(known)}"
        if self.facing is not None and self.facing[1] == (self.up or "+z")[1]:
            yield (
                f"facing: {self.facing} is along the axis that points up, "
                f"{self.up or '+z'}; write another axis for one of them"
            )
        for key in ("locked", "rest_posture"):
            for joint, value in (getattr(self, key) or {}).items():
                if not math.isfinite(value):
                    yield f"{key}: {joint}: {value} is not finite"
        for point, frame in (self.frames or {}).items():
            if len(frame.point) != 3 or len(frame.rpy) != 3:
                yield f"frames: {point}: point and rpy must be three numbers"
        if self.ground is not None and not -math.inf <= self.ground < math.inf:
            yield (
                f"ground: {self.ground} must be a height in metres, or -.inf for none"
            )
        if not 0.002 <= self.excess <= 1.0:
            yield (
                f"excess: {self.excess} must be 0.002 to 1 m: how far a capsule may "
                "stick out of its link"
            )
        if not 1 <= self.most_capsules <= 32:
            yield f"most_capsules: {self.most_capsules} must be 1 to 32"
        if self.faces < 4:
            yield f"faces: {self.faces} must be at least 4"


def load_choices(path: Path) -> ImportChoices:
    """Reads an import file.

    Raises:
        ModelError: it is not one; the message names file, key and line.
    """
    choices = load_yaml(
        read_text(path, ModelError),
        ImportChoices,
        str(path),
        ModelError,
        manual="docs/guides/your-robot.md",
    )
    choices.validate(str(path))
    return choices


def save_choices(path: Path, choices: ImportChoices, guessed: dict[str, str]) -> None:
    """Writes what is new into the import file, if there is one, and leaves the rest of
    it as it is: keys that were guessed, and how."""
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    if not text:
        text, default = _HEADER, ImportChoices()
        for key in (each.name for each in fields(choices)):
            value = getattr(choices, key)
            if key not in guessed and value != getattr(default, key):
                text += "\n" + _block(key, value, "")
    elif not guessed:
        return
    for key, how in guessed.items():
        text += "\n" + _block(key, getattr(choices, key), how)
    write_whole(path, text)


def _block(key: str, value, how: str) -> str:
    comment = _COMMENTS.get(key)
    text = f"# {comment}\n" if comment else ""
    if how:
        text += f"# GUESSED, check it: {how}\n"
    return text + entry_text(key, value)


def entry_text(key: str, value) -> str:
    """The lines of a key and its value in an import file."""
    if isinstance(value, bool):
        value = str(value).lower()
    if value == -math.inf:
        value = "-.inf"  # as YAML has it
    if isinstance(value, str | int | float):
        return f"{key}: {value}\n"
    if not value:
        return f"{key}: {'{}' if isinstance(value, dict) else '[]'}\n"
    return f"{key}:\n" + "".join(f"  {line}\n" for line in _entries(value))


def _entries(value) -> list[str]:
    if isinstance(value, list):
        return [
            f"- [{', '.join(v)}]" if isinstance(v, list) else f"- {v}" for v in value
        ]
    lines = []
    for name, entry in value.items():
        if isinstance(entry, FrameChoice):
            numbers = _numbers(entry.point)
            turned = f", rpy: {_numbers(entry.rpy)}" if any(entry.rpy) else ""
            lines.append(f"{name}: {{link: {entry.link}, point: {numbers}{turned}}}")
        elif isinstance(entry, list):
            lines.append(f"{name}: [{', '.join(map(str, entry))}]")
        else:
            lines.append(f"{name}: {_number(entry)}")
    return lines


def _numbers(values: list[float]) -> str:
    return f"[{', '.join(map(_number, values))}]"


def _number(value: float) -> str:
    return f"{round(float(value), 5) + 0.0:.5g}" if value else "0.0"
