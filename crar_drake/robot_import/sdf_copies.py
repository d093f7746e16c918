"""SDF files as Drake reads them without looking at meshes for collisions.

Drake takes OBJ, VTK and glTF alone for what collides, and SDFs often have other
meshes; an import only wants to know where they are. So Drake reads copies of the files,
line for line, in which collisions are visuals of another name. Addresses in them are
absolute, looked for as those of a URDF are.
"""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from pathlib import Path
from xml.sax.saxutils import escape, unescape

from crar_drake.errors import ModelError
from crar_drake.robot_import.robot_files import (
    MeshFinder,
    naming,
    one_number,
    read_xml,
    xml_text,
)
from crar_drake.robot_import.source_urdf import refuse_loops

_MIMIC = ("multiplier", "offset", "reference")

# How the names of the visuals begin that are collisions in the original.
COLLISION = "collision of "

_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_MESH = re.compile(r"<mesh\b.*?</mesh>", re.DOTALL)
_INCLUDE = re.compile(r"<include\b.*?</include>", re.DOTALL)
_URI = re.compile(r"<uri>(.*?)</uri>", re.DOTALL)
_COLLISION_ELEMENT = re.compile(
    r"<collision(\b[^>]*?\bname\s*=\s*['\"])(.*?)</collision>", re.DOTALL
)
# What a collision has and a visual has not.
_PHYSICS = re.compile(
    r"<(surface|max_contacts|drake:proximity_properties)\b.*?</\1>", re.DOTALL
)


class SdfCopies:
    """Copies of an SDF and of what it includes.

    Attributes:
        mimics: joint to the joint that it follows, multiplier and offset [rad or m].
        notes: what is to be said of the files.
    """

    def __init__(self, folder: Path, package_paths: Sequence[Path]) -> None:
        """Makes no copy yet."""
        self._folder, self._package_paths = folder, package_paths
        self._copies: dict[Path, Path] = {}
        self._open: set[Path] = set()  # whose copies are being made
        self.mimics: dict[str, tuple[str, float, float]] = {}
        self.notes: list[str] = []

    def of(self, path: Path) -> Path:
        """The copy of a file.

        Raises:
            ModelError: it, or what it includes, is no XML, or a mesh, model or package
                is not there.
        """
        if path in self._open:
            raise ModelError(f"{path}: it includes itself")
        if path in self._copies:
            return self._copies[path]
        self._open.add(path)
        copy = self._folder / str(len(self._copies)) / path.name
        self._copies[path] = copy
        root = read_xml(path, "an SDF")
        refuse_loops(root, path)
        self._find_mimics(root, path)
        files = MeshFinder(path, self._package_paths)
        text = _COMMENT.sub(_blank, xml_text(path, "an SDF"))
        text = _with_addresses(
            text, _MESH, lambda address, line: files.find(address, line)
        )
        text = _with_addresses(
            text,
            _INCLUDE,
            lambda address, line: self._included(
                files.find(address, line, folder=True)
            ),
        )
        self.notes += files.check()
        copy.parent.mkdir()
        copy.write_text(_COLLISION_ELEMENT.sub(_as_visual, text), encoding="utf-8")
        self._open.discard(path)
        return copy

    def told_of_originals(self, message: str) -> str:
        """A message of Drake's with the names of the originals, in one line."""
        for path, copy in self._copies.items():
            message = message.replace(f"/{copy}", str(path)).replace(
                str(copy), str(path)
            )
        return " ".join(message.replace(COLLISION, "").split())

    def _included(self, path: Path) -> Path:
        """What an include is to be of: a copy of a model's file."""
        if path.is_dir():
            config, files = path / "model.config", []
            if config.is_file():
                files = read_xml(config, "a model's config").findall("sdf")
            path /= (files[-1].text or "").strip() if files else "model.sdf"
        is_sdf = path.is_file() and path.suffix == ".sdf"
        return self.of(path) if is_sdf else path

    def _find_mimics(self, root: ElementTree.Element, path: Path) -> None:
        for joint in root.iter("joint"):
            mimic = joint.find("axis/mimic")
            if mimic is None:
                continue
            with naming(path, "mimic of joint", joint):
                multiplier, offset, reference = (
                    one_number(mimic.findtext(key) or str(default))
                    for key, default in zip(_MIMIC, (1, 0, 0), strict=True)
                )
            offset -= multiplier * reference
            leader = mimic.get("joint", "")
            self.mimics[joint.get("name", "")] = leader, multiplier, offset


def _blank(match: re.Match) -> str:
    """As many lines, and nothing in them."""
    return "\n" * match[0].count("\n")


def _with_addresses(
    text: str, blocks: re.Pattern, found: Callable[[str, str], Path]
) -> str:
    """The text with addresses in such blocks replaced by the files that are `found` of
    an address and its line, "line 7"."""

    def replaced(block: re.Match) -> str:
        def file(uri: re.Match) -> str:
            line = 1 + text.count("\n", 0, block.start() + uri.start())
            path = found(unescape(uri[1].strip()), f"line {line}")
            return f"<uri>{escape(f'file://{path}')}</uri>"

        return _URI.sub(file, block[0])

    return blocks.sub(replaced, text)


def _as_visual(match: re.Match) -> str:
    inner = _PHYSICS.sub(_blank, match[2])
    return f"<visual{match[1]}{COLLISION}{inner}</visual>"
